//! Makes the block of amorphous carbon that comes with the program: a periodic cube of 7 nm at 2.0 g/cm3, quenched
//! from the melt. Takes about 3 minutes on two cores; the same bytes every time.
//!
//!     cargo run --release --example amorphous_carbon structures/amorphous-carbon.bin

use stemgen::models::carbon::{Melt, block};

/// Steps of molecular dynamics, 0.7 fs each.
const STEPS: usize = 10_000;

fn main() {
    let Some(path) = std::env::args().nth(1) else {
        eprintln!("usage: amorphous_carbon FILE");
        std::process::exit(2);
    };
    let mut melt = Melt::new(1, block::EDGE_ANGSTROM, block::DENSITY);
    for tenth in 1..=10 {
        melt.run(tenth * STEPS / 10, STEPS);
        eprintln!("{} of {STEPS} steps", tenth * STEPS / 10);
    }
    if let Err(e) = std::fs::write(&path, block::encode(&melt.finish())) {
        eprintln!("{path}: cannot write: {e}");
        std::process::exit(1);
    }
}
