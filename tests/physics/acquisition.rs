//! Every stage of a recording against a brute force that does the same slowly.

use ndarray::Array2;
use stemgen::acquisition::{
    Acquisition, DetectorChain, Exposure, Profile, Recorder, ScanFrame, ScanPath, SourceImage,
};

/// Highest frequency of images at 200 kV and 21 mrad, in 1/Angstrom.
const BAND_LIMIT: f64 = 2.0 * 0.021 / 0.025_079_3;
const EDGE_ANGSTROM: f64 = 9.0;

/// Waves (kx, ky, amplitude, phase) of a specimen of random atoms, seen through a round aperture.
fn waves() -> Vec<[f64; 4]> {
    let reach = (BAND_LIMIT * EDGE_ANGSTROM) as i64;
    let mut state = 9_u64;
    let mut random = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1_u32 << 31)
    };
    let mut waves = Vec::new();
    for ny in -reach..=reach {
        for nx in 1..=reach {
            let (kx, ky) = (nx as f64 / EDGE_ANGSTROM, ny as f64 / EDGE_ANGSTROM);
            let q = kx.hypot(ky) / BAND_LIMIT;
            if q < 1.0 {
                let transfer = q.acos() - q * (1.0 - q * q).sqrt();
                waves.push([kx, ky, transfer, std::f64::consts::TAU * random()]);
            }
        }
    }
    waves
}

/// The image of the waves, from 0.02 to 0.1 of the beam or so, at a place in nm.
fn exact(waves: &[[f64; 4]], [x, y]: [f64; 2]) -> f64 {
    let term =
        |w: &[f64; 4]| w[2] * (std::f64::consts::TAU * 10.0 * (w[0] * x + w[1] * y) + w[3]).cos();
    0.06 + 1e-3 * waves.iter().map(term).sum::<f64>()
}

fn source(waves: &[[f64; 4]], pixel_nm: f64) -> SourceImage {
    let n = (2.3 / pixel_nm) as usize;
    let values = Array2::from_shape_fn((n, n), |(row, column)| {
        exact(waves, [column, row].map(|p| p as f64 * pixel_nm + 0.1)) as f32
    });
    SourceImage::new(values, pixel_nm, [0.1; 2], BAND_LIMIT).unwrap()
}

fn frame() -> ScanFrame {
    ScanFrame { shape: [40, 40], pixel_nm: 0.03, origin_nm: [0.5, 0.7] }
}

/// The image where the beam is, of which only the interpolation is inexact: below 0.1 % of the maximum for pixels of worlds.
#[test]
fn interpolation_is_right_to_a_thousandth_of_the_maximum() {
    let waves = waves();
    let settings = Profile::Poor.acquisition();
    for pixel_nm in [0.0201, 0.025] {
        let source = source(&waves, pixel_nm);
        let path = ScanPath::new(&settings, frame(), 3);
        let exposure = Exposure::of_dose(1e4, settings.dwell_us, 1, 0.3).unwrap();
        let recorder = Recorder::new(&settings, path, exposure, 3);
        let rows = recorder.rows(0, 0..40, &source, &mut 0.0);
        let (mut worst, mut most) = (0.0_f64, 0.0_f64);
        for ((row, column), value) in rows.moved.indexed_iter() {
            let right = exact(&waves, recorder.path().place_nm(0, row, column));
            worst = worst.max((f64::from(*value) - right).abs());
            most = most.max(right);
        }
        println!("pixel {pixel_nm} nm: worst {:.4} % of the maximum", 100.0 * worst / most);
        assert!(worst < 1e-3 * most, "{worst} of {most}");
    }
}

/// The place of the beam by the formulas of the documentation, at any time of a pixel's dwell (0 to 1).
fn place_at(s: &Acquisition, hum_phase: f64, row: usize, column: usize, part: f64) -> [f64; 2] {
    let f = frame();
    let line_s = 1e-6 * (f.shape[1] as f64 * s.dwell_us + s.flyback_us);
    let in_line_us = (column as f64 + part) * s.dwell_us;
    let t = row as f64 * line_s + 1e-6 * in_line_us;
    let hum = (std::f64::consts::TAU * s.hum_hz * t + hum_phase).sin();
    let over = -0.1 * s.overshoot_angstrom * (-in_line_us / s.overshoot_decay_us).exp();
    let x = column as f64 * f.pixel_nm;
    let y = row as f64 * f.pixel_nm;
    let (dx, dy) = (x - 19.5 * f.pixel_nm, y - 19.5 * f.pixel_nm);
    [
        f.origin_nm[0]
            + x
            + 0.01 * (s.scale_percent[0] * dx + s.shear_percent * dy)
            + over
            + 0.1 * s.hum_angstrom[0] * hum
            - s.drift_nm_per_s[0] * t,
        f.origin_nm[1] + y + 0.01 * s.scale_percent[1] * dy + 0.1 * s.hum_angstrom[1] * hum
            - s.drift_nm_per_s[1] * t,
    ]
}

/// The beam is taken to stand still during the dwell time, at the place of its middle: against the mean over the dwell time.
#[test]
fn standing_still_during_the_dwell_time_is_right_to_a_thousandth() {
    let waves = waves();
    let settings = Acquisition {
        line_jitter_angstrom: 0.0,
        drift_random_nm_per_sqrt_s: 0.0,
        dwell_us: 20.0,
        ..Profile::Poor.acquisition()
    };
    let path = ScanPath::new(&settings, frame(), 3);
    // The phase of the hum is random: found from one pixel, checked at all others.
    let off = |phase: f64| {
        let (a, b) = (path.place_nm(0, 30, 5), place_at(&settings, phase, 30, 5, 0.5));
        let (c, d) = (path.place_nm(0, 3, 35), place_at(&settings, phase, 3, 35, 0.5));
        (a[0] - b[0]).abs() + (c[0] - d[0]).abs()
    };
    let steps = 100_000;
    let phase = (0..steps)
        .map(|k| std::f64::consts::TAU * k as f64 / steps as f64)
        .min_by(|a, b| off(*a).total_cmp(&off(*b)))
        .unwrap();
    let (mut worst, mut most, mut astray) = (0.0_f64, 0.0_f64, 0.0_f64);
    for row in 0..40 {
        for column in 0..40 {
            let place = path.place_nm(0, row, column);
            let own = place_at(&settings, phase, row, column, 0.5);
            astray = astray.max((place[0] - own[0]).abs()).max((place[1] - own[1]).abs());
            let value = exact(&waves, place);
            let parts = 16;
            let mean: f64 = (0..parts)
                .map(|k| (k as f64 + 0.5) / parts as f64)
                .map(|part| exact(&waves, place_at(&settings, phase, row, column, part)))
                .sum::<f64>()
                / parts as f64;
            worst = worst.max((value - mean).abs());
            most = most.max(value);
        }
    }
    println!("dwell of 20 us: worst {:.4} % of the maximum", 100.0 * worst / most);
    assert!(astray < 1e-5, "the path is not that of the formulas: {astray} nm");
    assert!(worst < 1e-3 * most, "{worst} of {most}");
}

/// Late light pixel by pixel, against many steps within each pixel.
#[test]
fn late_light_is_that_of_continuous_time() {
    for (dwell_us, afterglow_us) in [(10.0, 20.0), (1.0, 30.0), (10.0, 2.0)] {
        let settings = Acquisition {
            dwell_us,
            afterglow_us,
            afterglow_share: 0.3,
            flyback_us: 15.0,
            ..Profile::Ideal.acquisition()
        };
        let exposure = Exposure::of_dose(1e4, dwell_us, 1, 0.2).unwrap();
        let chain = DetectorChain::new(&settings, &exposure, 1);
        let lines: Vec<Vec<f64>> = (0..3)
            .map(|row| (0..30).map(|c| f64::from((c * 7 + row * 3) % 11)).collect())
            .collect();
        let (mut stored, mut slow_stored) = (0.0, 0.0);
        let steps = 2000;
        let step_us = dwell_us / f64::from(steps);
        for line in &lines {
            let mut fast = line.clone();
            chain.spread_late(&mut fast, &mut stored);
            let mut slow = Vec::new();
            for light in line {
                let mut seen = 0.7 * light;
                for _ in 0..steps {
                    slow_stored += 0.3 * light / f64::from(steps);
                    let given = slow_stored * step_us / afterglow_us;
                    slow_stored -= given;
                    seen += given;
                }
                slow.push(seen);
            }
            slow_stored *= (-15.0_f64 / afterglow_us).exp();
            for (fast, slow) in fast.iter().zip(&slow) {
                assert!(
                    (fast - slow).abs() < 1e-3 * 10.0,
                    "{dwell_us} {afterglow_us}: {fast} {slow}"
                );
            }
        }
    }
}

/// No light is lost but that of the fly-back.
#[test]
fn late_light_is_all_seen() {
    let settings =
        Acquisition { afterglow_share: 0.4, afterglow_us: 25.0, ..Profile::Ideal.acquisition() };
    let exposure = Exposure::of_dose(1e4, settings.dwell_us, 1, 0.2).unwrap();
    let chain = DetectorChain::new(&settings, &exposure, 1);
    let mut line = vec![0.0; 400];
    line[3] = 100.0;
    let mut stored = 0.0;
    chain.spread_late(&mut line, &mut stored);
    assert!((line.iter().sum::<f64>() + stored - 100.0).abs() < 1e-9);
    assert!(line[3] > 60.0 && line[4] > 5.0 && line[2] == 0.0, "{:?}", &line[..8]);
}

/// Recorded in bands or at once, on one thread or several: the same numbers.
#[test]
fn bands_and_threads_change_nothing() {
    let waves = waves();
    let source = source(&waves, 0.0201);
    let settings = Profile::Poor.acquisition();
    let recorded = |bands: &[std::ops::Range<usize>], threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let path = ScanPath::new(&settings, frame(), 5);
            let exposure = Exposure::of_current(40.0, settings.dwell_us, 1, 0.3).unwrap();
            let recorder = Recorder::new(&settings, path, exposure, 5);
            let mut late = 0.0;
            let rows = bands.iter().map(|band| recorder.rows(0, band.clone(), &source, &mut late));
            rows.flat_map(|rows| rows.values.into_raw_vec_and_offset().0).collect::<Vec<f32>>()
        })
    };
    let at_once = recorded(std::slice::from_ref(&(0..40)), 1);
    assert_eq!(at_once, recorded(&[0..7, 7..8, 8..40], 3));
    assert!(at_once.iter().any(|v| *v > 20.0));
}
