//! Simulates the HAADF image of a crystal from a CIF file and prints it as numbers.
//!
//!     cargo run --release -p stemgen --no-default-features --example simulate_cif [FILE.cif]
//!
//! Takes `structures/srtio3.cif` unless a file is named. Prints the grid and the slices of the plan, then the intensity of each
//! probe position of one unit cell in per cent of the beam: a row of the image on each line.

use std::path::Path;

use stemgen::engine::{Phonons, Plan, Scan, Settings, simulate};
use stemgen::progress::Silent;
use stemgen::structure::{self, Sigmas};

/// Probe positions along each edge of the unit cell.
const PROBES: usize = 8;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let own = std::env::args().nth(1);
    run(Path::new(own.as_deref().unwrap_or("structures/srtio3.cif")))
}

/// Simulates a crystal along [001] and prints its image.
pub fn run(path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let cell = structure::read(path)?.oriented([0, 0, 1], None)?;
    let [width, height, depth] = cell.orthogonal_box()?;

    // About 12 x 12 A wide, so that the probe has room, and 20 A thick.
    let copies = |edge: f64, length: f64| (length / edge).ceil() as usize;
    let specimen = cell.repeat([copies(width, 12.0), copies(height, 12.0), copies(depth, 20.0)])?;
    let sites = specimen.sites(&Sigmas::All(0.08))?; // Angstrom

    let phonons = Some(Phonons { configurations: 2, seed: 1 });
    let settings = Settings { phonons, ..Settings::default() };
    let heights: Vec<f64> = sites.iter().map(|site| site.position[2]).collect();
    let plan = Plan::new(&settings, specimen.orthogonal_box()?, &heights)?;
    println!("{} atoms, {} slices, {}", sites.len(), plan.slices.len(), wave_grid(&plan));

    let step_angstrom = [width, height].map(|edge| edge / PROBES as f64);
    let scan = Scan { origin_angstrom: [0.0, 0.0], step_angstrom, shape: [PROBES, PROBES] };
    let images = simulate(&plan, &sites, &scan, &Silent)?;
    for row in images.image(0, 0).rows() {
        let words: Vec<String> = row.iter().map(|value| format!("{:6.3}", 100.0 * value)).collect();
        println!("{}", words.join(" "));
    }
    Ok(())
}

fn wave_grid(plan: &Plan) -> String {
    let [nx, ny] = plan.wave_grid.points;
    format!("{nx} x {ny} points, scattering carried to {:.0} mrad", plan.band_limit_mrad)
}
