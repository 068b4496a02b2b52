//! Speed of this machine, memory, and what a plan will take.

use rayon::prelude::*;
use std::time::{Duration, Instant};
use stemgen::engine::{Cost, Plan};
use stemgen::fft::Fft2;

/// How long the speed is measured.
const MEASURED: Duration = Duration::from_millis(400);

/// Nominal floating-point operations per second of transforms of the plan's wave grid, on all
/// threads at once.
fn speed(plan: &Plan) -> f64 {
    let (ny, nx) = plan.wave_grid.shape();
    let fft = Fft2::new(ny, nx);
    let run = |_: usize| {
        let (mut data, mut scratch) = (fft.buffer(), fft.scratch());
        let begun = Instant::now();
        let mut done = 0.0;
        while done == 0.0 || begun.elapsed() < MEASURED {
            fft.forward(&mut data, &mut scratch);
            fft.inverse(&mut data, &mut scratch);
            done += 2.0 * fft.nominal_flops();
        }
        done / begun.elapsed().as_secs_f64()
    };
    (0..threads()).into_par_iter().with_max_len(1).map(run).sum()
}

/// Estimated time in seconds for `runs` simulations that each cost so much.
pub fn seconds(plan: &Plan, cost: &Cost, runs: usize) -> f64 {
    if runs == 0 {
        return 0.0;
    }
    runs as f64 * cost.nominal_flops() / speed(plan)
}

/// Number of threads that compute.
pub fn threads() -> usize {
    rayon::current_num_threads()
}

/// Memory that is free for use, in bytes; unknown where the system does not say.
pub fn available_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    kib.checked_mul(1024)
}

/// What to say when the arrays will not fit.
pub fn memory_warning(needed: u64, remedy: &str) -> Option<String> {
    let available = available_memory().filter(|a| needed > *a)?;
    Some(format!(
        "about {} of memory are needed and {} are free; {remedy}",
        super::text::bytes(needed),
        super::text::bytes(available)
    ))
}
