//! Errors of diffraction patterns from windows, against the full grid: SrTiO3 [001], 200 kV, 21 mrad, one phonon configuration,
//! 64 x 64 pixels to 100 mrad.
//!
//!     cargo bench --bench patterns -- [THICKNESS_CELLS] [DEFOCUS_ANGSTROM]

use ndarray::{Array2, Axis};
use stemgen::detect::{Detector, PixelatedDetector};
use stemgen::engine::{
    Algorithm, Expansion, PatternSettings, Phonons, Plan, ProbeBox, Scan, Settings,
    simulate_patterns,
};
use stemgen::optics::Aberrations;
use stemgen::progress::Silent;
use stemgen::structure::{Sigmas, Site, crystals};

const CELLS: usize = 16;
const EDGE: f64 = 3.905;

fn main() {
    let numbers: Vec<f64> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let cells = numbers.first().map_or(10, |n| *n as usize);
    let defocus = numbers.get(1).copied().unwrap_or(0.0);
    let crystal = crystals::crystal("srtio3").expect("a crystal of the program");
    let specimen = crystal.repeat([CELLS, CELLS, cells]).expect("a repeat");
    let table = [(38, 0.084), (22, 0.060), (8, 0.085)].into();
    let sites = specimen.sites(&Sigmas::ByElement(table)).expect("sites");
    let size = specimen.orthogonal_box().expect("a box");
    let scan = Scan {
        origin_angstrom: [8.0 * EDGE, 8.0 * EDGE + 0.1],
        step_angstrom: [0.45, 0.5],
        shape: [3, 5],
    };
    let dense = Scan {
        origin_angstrom: [8.0 * EDGE, 8.0 * EDGE + 0.1],
        step_angstrom: [0.225, 0.25],
        shape: [5, 9],
    };
    let run = |algorithm, coherent_tail, expansion, dense_scan: bool, probe_box| {
        let settings = Settings {
            algorithm,
            expansion,
            probe_box,
            detectors: vec![Detector::new("pattern", 0.0, 100.0)],
            angle_margin: numbers.get(2).copied().unwrap_or(1.2),
            phonons: Some(Phonons { configurations: 1, seed: 3 }),
            ..Settings::default()
        };
        let mut settings = settings;
        settings.optics.aberrations = Aberrations::defocus(defocus);
        patterns(&settings, (&sites, size), if dense_scan { &dense } else { &scan }, coherent_tail)
    };
    let exact = run(Algorithm::Multislice, true, Expansion::Auto, false, Some(ProbeBox::Large));
    println!("exact: {:.1} s, sum of the first {:.4}", exact.1, exact.0[0].sum());
    let large = run(Algorithm::Multislice, true, Expansion::Auto, false, Some(ProbeBox::Cell));
    report("exact, probe of the cell", &large, &exact.0);
    for width in [7.8, 11.7, 15.6] {
        let window = Algorithm::Window { width_angstrom: width };
        for (name, tail, expansion, is_dense) in [
            ("each, no tail", false, Expansion::Off, false),
            ("each, tail", true, Expansion::Off, false),
            ("expanded, tail", true, Expansion::Auto, true),
        ] {
            let mut found = run(window, tail, expansion, is_dense, None);
            if is_dense {
                let every_other =
                    |i: &usize| (i / 9).is_multiple_of(2) && (i % 9).is_multiple_of(2);
                found.0 = (0..45).filter(every_other).map(|i| found.0[i].clone()).collect();
            }
            report(&format!("{width} A, {name}"), &found, &exact.0);
        }
    }
}

/// The patterns of a scan, and the seconds that they took.
fn patterns(
    settings: &Settings,
    (sites, size): (&[Site], [f64; 3]),
    scan: &Scan,
    coherent_tail: bool,
) -> (Vec<Array2<f32>>, f64) {
    let heights: Vec<f64> = sites.iter().map(|site| site.position[2]).collect();
    let plan = Plan::new(settings, size, &heights).expect("a plan");
    let detector = PixelatedDetector { pixels: 64, max_angle_mrad: 100.0 };
    let started = std::time::Instant::now();
    let mut all = Vec::new();
    let mut take = |rows: stemgen::engine::PatternRows<'_>| {
        let last = rows.data.index_axis(Axis(0), 0);
        for row in last.outer_iter() {
            all.extend(row.outer_iter().map(|pattern| pattern.to_owned()));
        }
        Ok(())
    };
    let settings = PatternSettings { detector: detector.into(), coherent_tail };
    simulate_patterns(&plan, &[sites], scan, settings, &mut take, &Silent).expect("patterns");
    (all, started.elapsed().as_secs_f64())
}

fn report(name: &str, (found, seconds): &(Vec<Array2<f32>>, f64), exact: &[Array2<f32>]) {
    let most = exact.iter().map(|p| p.iter().copied().fold(0.0, f32::max)).sum::<f32>()
        / exact.len() as f32;
    let (mut square, mut count) = (0.0, 0.0);
    let (mut off, mut centre, mut norm) = (0.0, 0.0, 0.0);
    let (mut bright, mut bright_sum) = ([0.0; 2], 0.0);
    let (mut dark, mut dark_sum) = (0.0, 0.0);
    for (a, b) in found.iter().zip(exact) {
        for ((y, x), v) in b.indexed_iter() {
            let (w, v) = (f64::from(a[[y, x]]), f64::from(*v));
            square += (w - v).powi(2);
            count += 1.0;
            let angle = (x as f64 - 32.0).hypot(y as f64 - 32.0) * 3.125;
            if angle < 21.0 {
                bright[0] += w - v;
                bright[1] += (w - v).abs();
                bright_sum += v;
            } else if angle > 24.0 {
                dark += w - v;
                dark_sum += v;
            }
        }
        let (p, q) = (mass(a), mass(b));
        off += (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
        centre += q[0].powi(2) + q[1].powi(2);
        norm += b.sum();
    }
    println!(
        "{name:28} rms / max {:.3} %  bright field {:+.2} % (L1 {:.2} %)  dark field {:+.2} %  centre of mass {:.2} % of its rms  {seconds:.2} s, mean sum {:.4}",
        100.0 * f64::sqrt(square / count) / f64::from(most),
        100.0 * bright[0] / bright_sum,
        100.0 * bright[1] / bright_sum,
        100.0 * dark / dark_sum,
        100.0 * f64::sqrt(off / centre),
        norm / exact.len() as f32,
    );
}

/// The centre of mass in pixels (x, y).
fn mass(pattern: &Array2<f32>) -> [f64; 2] {
    let mut sums = [0.0; 3];
    for ((y, x), v) in pattern.indexed_iter() {
        let v = f64::from(*v);
        sums[0] += v * (x as f64 - 32.0);
        sums[1] += v * (y as f64 - 32.0);
        sums[2] += v;
    }
    [sums[0] / sums[2], sums[1] / sums[2]]
}
