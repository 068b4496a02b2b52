//! GFLOP/s of the propagation loop beside those of its Fourier transforms alone.
//!
//! `cargo bench --bench propagation [-- SIZE ...] [band=F]`. Nominal operations, `5 N log2 N` a transform: skipping
//! columns beyond the band limit lets the loop exceed the plain transforms. The band limit is 0.8 of Nyquist, as on
//! full grids; windows have 0.95 and more.

use std::time::Duration;
use stemgen::detect::Detector;
use stemgen::engine::{
    Algorithm, DEFAULT_BAND_FRACTION, GridChoice, Plan, Settings, measure_speed,
};
use stemgen::potential::Slicing;

const SIZES: [usize; 15] =
    [128, 160, 192, 256, 320, 384, 480, 512, 540, 640, 768, 960, 1152, 1400, 1536];

fn main() {
    let asked: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let band = std::env::args().find_map(|a| a.strip_prefix("band=")?.parse().ok());
    let band_fraction = band.unwrap_or(DEFAULT_BAND_FRACTION);
    let sizes = if asked.is_empty() { SIZES.to_vec() } else { asked };
    println!(
        "{:>14} {:>8} {:>14} {:>14} {:>7}",
        "grid", "threads", "loop GFLOP/s", "FFT GFLOP/s", "ratio"
    );
    for n in sizes {
        for threads in [1, 2] {
            let settings = Settings {
                grid: GridChoice::Points([n, n]),
                detectors: vec![Detector::new("d", 0.0, 60.0)],
                slicing: Slicing::Thickness(1.0),
                algorithm: Algorithm::Multislice,
                oversampling: Some(1),
                band_fraction,
                ..Settings::default()
            };
            let side = n as f64 * 0.05;
            let plan = Plan::new(&settings, [side, side, 2.0], &[]).expect("a valid plan");
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let speed =
                pool.expect("threads").install(|| measure_speed(&plan, Duration::from_secs(1)));
            println!(
                "{:>14} {threads:>8} {:>14.1} {:>14.1} {:>7.2}",
                format!("{n} x {n}"),
                speed.step_gflops,
                speed.fft_gflops,
                speed.step_gflops / speed.fft_gflops
            );
        }
    }
}
