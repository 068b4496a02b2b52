//! Comparison with arrays that abTEM 1.0.11 computed; see `golden/README.md`.

use ndarray::{Array1, Array2, Array3, Axis};
use ndarray_npy::NpzReader;
use serde_json::Value;
use std::fs::File;
use std::path::PathBuf;
use stemgen::detect::Detector;
use stemgen::engine::settings::EXACT_BAND_FRACTION;
use stemgen::engine::{
    Algorithm, BeyondLimit, GridChoice, Plan, Scan, Settings, Site, diffraction, simulate,
};
use stemgen::optics::{Aberration, Aberrations};
use stemgen::potential::projected::{PlacedAtom, Projector, Shape};
use stemgen::potential::scattering::{Parametrization, ScatteringFactor};
use stemgen::potential::slices::Slicing;
use stemgen::progress::Silent;
use stemgen::structure;

struct Golden {
    name: &'static str,
    json: Value,
    sites: Vec<Site>,
    cell: [f64; 3],
}

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden")
}

impl Golden {
    fn load(name: &'static str) -> Self {
        let text = std::fs::read_to_string(folder().join(format!("{name}.json"))).unwrap();
        let json: Value = serde_json::from_str(&text).unwrap();
        let atoms = structure::read(&folder().join(json["atoms"].as_str().unwrap())).unwrap();
        let cell = atoms.orthogonal_box().unwrap();
        let sites = atoms.atoms.iter().enumerate().map(|(i, a)| Site {
            position: a.position,
            number: a.number,
            sigma_angstrom: 0.0,
            key: i as u64,
        });
        Golden { name, sites: sites.collect(), cell, json }
    }

    fn array3(&self, name: &str) -> Array3<f32> {
        let file = File::open(folder().join(format!("{}.npz", self.name))).unwrap();
        NpzReader::new(file).unwrap().by_name(&format!("{name}.npy")).unwrap()
    }

    fn array2(&self, name: &str) -> Array2<f32> {
        let file = File::open(folder().join(format!("{}.npz", self.name))).unwrap();
        NpzReader::new(file).unwrap().by_name(&format!("{name}.npy")).unwrap()
    }

    fn pair(&self, value: &Value) -> [f64; 2] {
        [value[0].as_f64().unwrap(), value[1].as_f64().unwrap()]
    }

    /// abTEM's settings: its grid, its slices, `exp` on the grid itself. abTEM focuses on the plane
    /// of the first slice, we on the entrance surface half a slice before it.
    fn settings(&self) -> Settings {
        let slice = self.json["slice_thickness_A"].as_f64().unwrap();
        let points = self.pair(&self.json["gpts_xy"]).map(|n| n as usize);
        let mut settings = Settings {
            detectors: four(self),
            grid: GridChoice::Points(points),
            slicing: Slicing::Thickness(slice),
            oversampling: Some(1),
            band_taper: 0.02,
            band_fraction: EXACT_BAND_FRACTION,
            ..Settings::default()
        };
        settings.optics.aberrations = Aberrations::defocus(slice / 2.0);
        settings
    }

    fn scan(&self) -> Scan {
        let scan = &self.json["scan"];
        let [nx, ny] = self.pair(&scan["points_xy"]).map(|n| n as usize);
        Scan {
            origin_angstrom: self.pair(&scan["start_A"]),
            step_angstrom: self.pair(&scan["step_xy_A"]),
            shape: [ny, nx],
        }
    }

    fn plan(&self, settings: &Settings) -> Plan {
        let z: Vec<f64> = self.sites.iter().map(|s| s.position[2]).collect();
        Plan::new(settings, self.cell, &z).unwrap()
    }

    /// Largest difference of each detector's image in units of its maximum.
    fn errors(&self, settings: &Settings, reference: &str) -> Vec<f32> {
        let expected = self.array3(reference);
        let images = simulate(&self.plan(settings), &self.sites, &self.scan(), &Silent).unwrap();
        let error = |d: usize| {
            let (ours, theirs) = (images.image(0, d), expected.index_axis(Axis(0), d));
            assert_eq!(ours.dim(), theirs.dim());
            let top = theirs.iter().fold(0.0_f32, |m, v| m.max(*v));
            ours.iter().zip(theirs).map(|(a, b)| (a - b).abs() / top).fold(0.0, f32::max)
        };
        let errors: Vec<f32> = (0..4).map(error).collect();
        println!(
            "{} {reference}: BF, ABF, ADF, HAADF off by {errors:.6?} of the maximum",
            self.name
        );
        errors
    }

    fn check(&self, settings: &Settings, reference: &str, tolerance: f32) {
        let errors = self.errors(settings, reference);
        assert!(errors.iter().all(|e| *e < tolerance), "{} {reference}: {errors:?}", self.name);
    }
}

fn four(g: &Golden) -> Vec<Detector> {
    let detector = |name| {
        let [inner, outer] = g.pair(&g.json["detectors_mrad"][name]);
        Detector::new(name, inner, outer)
    };
    ["bf", "abf", "adf", "haadf"].map(detector).to_vec()
}

/// The promise is 0.2 %.
const TOLERANCE: f32 = 2e-4;

fn prism(f: usize) -> Algorithm {
    Algorithm::Prism { interpolation: [f, f] }
}

#[test]
fn srtio3_multislice_and_prism() {
    let g = Golden::load("srtio3_001");
    g.check(&g.settings(), "multislice", TOLERANCE);
    g.check(&Settings { algorithm: prism(1), ..g.settings() }, "prism_f1", TOLERANCE);
}

#[test]
fn srtio3_with_missing_atoms_by_prism_f2() {
    let g = Golden::load("srtio3_prism_f2");
    g.check(&g.settings(), "multislice", TOLERANCE);
    g.check(&Settings { algorithm: prism(2), ..g.settings() }, "prism_f2", 2e-3);
}

#[test]
fn si_110() {
    let g = Golden::load("si_110");
    g.check(&g.settings(), "multislice", TOLERANCE);
    // without interpolation PRISM is multislice: no array of its own is needed
    g.check(&Settings { algorithm: prism(1), ..g.settings() }, "multislice", TOLERANCE);
}

#[test]
fn si_110_with_missing_atoms_by_prism_f2() {
    let g = Golden::load("si_110_prism_f2");
    // In windows of 10.9 x 11.5 A with a quarter of the atoms missing HAADF is 0.84 % off (BF 0.01 %, ABF 0.02 %, ADF
    // 0.24 %); why is not known. Keeping exit waves on abTEM's grid or moving windows by a pixel changes nothing.
    let settings = Settings { algorithm: prism(2), ..g.settings() };
    let errors = g.errors(&settings, "prism_f2");
    for (error, tolerance) in errors.iter().zip([1e-3, 1e-3, 5e-3, 1.2e-2]) {
        assert!(*error < tolerance, "{errors:?}");
    }
}

/// abTEM as shipped sharpens potentials to make up for spreading atoms over pixels, also those on grid
/// points. The same correction reproduces its images; without it they differ by up to 1.3 %.
#[test]
fn abtem_as_shipped() {
    for name in ["srtio3_001", "si_110"] {
        let g = Golden::load(name);
        let sharpened = Settings { abtem_pixel_correction: true, ..g.settings() };
        g.check(&sharpened, "multislice_as_shipped", TOLERANCE);
        let errors = g.errors(&g.settings(), "multislice_as_shipped");
        assert!((2e-3..2e-2).contains(&errors[3]), "{errors:?}");
    }
}

#[test]
fn aberrated_probes() {
    let g = Golden::load("srtio3_001_aberrated");
    for set in ["perfect", "third_order", "all_orders"] {
        let mut settings = g.settings();
        let coefficients = g.json["aberrations_A_rad"][set].as_object().unwrap();
        for (name, value) in coefficients.iter().filter(|(name, _)| name.starts_with('C')) {
            let azimuth =
                coefficients.get(&name.replace('C', "phi")).map_or(0.0, |v| v.as_f64().unwrap());
            let text = format!("{name}={}@{azimuth}", value.as_f64().unwrap());
            settings.optics.aberrations.0.push(Aberration::parse(&text).unwrap());
        }
        if set != "perfect" {
            assert!(settings.optics.aberrations.0.len() > 3, "{coefficients:?}");
        }
        g.check(&settings, set, TOLERANCE);
        // PRISM is right with aberrations too
        g.check(&Settings { algorithm: prism(1), ..settings }, set, TOLERANCE);
    }
}

#[test]
fn diffraction_pattern_pixel_by_pixel() {
    let g = Golden::load("exit_intensity");
    let expected = g.array2("intensity");
    let plan = g.plan(&g.settings());
    let pattern = diffraction(&plan, &g.sites, g.pair(&g.json["position_A"]), &Silent).unwrap();
    let (ny, nx) = pattern.dim();
    let half = expected.nrows() as i64 / 2;
    let top = expected.iter().fold(0.0_f32, |m, v| m.max(*v));
    for ((y, x), e) in expected.indexed_iter() {
        let iy = (y as i64 - half).rem_euclid(ny as i64) as usize;
        let ix = (x as i64 - half).rem_euclid(nx as i64) as usize;
        let error = (pattern[[iy, ix]] - e).abs() / top;
        assert!(error < 1e-5, "{y},{x}: {} {e}", pattern[[iy, ix]]);
    }
}

/// Projected potentials of single planes and of atoms off the grid.
#[test]
fn projected_potentials() {
    let g = Golden::load("potential_srtio3");
    let place = |&(number, x, y): &(u8, f64, f64)| PlacedAtom { position: [x, y, 0.0], number };
    let plane = |upper: bool| -> Vec<PlacedAtom> {
        let atoms = g.sites.iter().filter(|s| (s.position[2] > 2.0) == upper);
        atoms.map(|s| PlacedAtom { position: s.position, number: s.number }).collect()
    };
    let loose = [(38, 0.513, 0.171), (22, 2.207, 3.049), (8, 3.333, 1.618)].map(|a| place(&a));
    let (square, oblong) = (([3.905, 3.905], plane(false)), ([4.0, 5.0], loose.to_vec()));
    let cases = [
        ("sr_o_lobato", Parametrization::Lobato, &square, Shape::AsIs),
        ("sr_o_kirkland", Parametrization::Kirkland, &square, Shape::AsIs),
        ("sr_o_peng", Parametrization::Peng, &square, Shape::AsIs),
        ("sr_o_lobato_as_shipped", Parametrization::Lobato, &square, Shape::AbtemPixelCorrection),
        ("ti_o2_lobato", Parametrization::Lobato, &([3.905, 3.905], plane(true)), Shape::AsIs),
        ("off_grid", Parametrization::Lobato, &oblong, Shape::AsIs),
    ];
    for (name, parametrization, (extent, atoms), shape) in cases {
        let expected = g.array2(name);
        let elements = [8, 22, 38];
        let projector =
            Projector::new(expected.dim(), *extent, parametrization, &elements, shape).unwrap();
        let (mut out, mut scratch) = (projector.fft().buffer(), projector.scratch());
        projector.infinite(atoms, &mut out, &mut scratch);
        let top = expected.iter().fold(0.0_f32, |m, v| m.max(*v));
        for ((y, x), e) in expected.indexed_iter() {
            let v = out[y * projector.fft().stride() + x].re;
            assert!((v - e).abs() < 1e-5 * top, "{name} at {y},{x}: {v} {e}");
        }
    }
}

/// The tables as abTEM evaluates them, hydrogen in closed form, and Doyle & Turner's fits.
#[test]
fn scattering_factors() {
    let text = std::fs::read_to_string(folder().join("scattering_factors.csv")).unwrap();
    let mut counts = [0; 2];
    for line in text.lines().filter(|l| !l.starts_with('#') && !l.starts_with("source")) {
        let fields: Vec<&str> = line.split(',').collect();
        let [source, table, number, _, q, expected] = fields[..] else { panic!("{line}") };
        let parametrization = match table {
            "kirkland" => Parametrization::Kirkland,
            "peng" => Parametrization::Peng,
            _ => Parametrization::Lobato,
        };
        let (q, expected): (f64, f64) = (q.parse().unwrap(), expected.parse().unwrap());
        let factor = ScatteringFactor::new(parametrization, number.parse().unwrap()).unwrap();
        let error = (factor.at(q * q) / expected - 1.0).abs();
        let (tolerance, kind) = if source == "abtem" { (1e-7, 0) } else { (0.04, 1) };
        assert!(error < tolerance, "{line}: {error}");
        counts[kind] += 1;
    }
    assert!(counts[0] > 500 && counts[1] > 20, "{counts:?}");
}

/// Potentials on a finer grid, limited after the exponential.
#[test]
fn oversampled_transmission_functions() {
    let g = Golden::load("displaced_bandlimit");
    let expected = g.array2("t_960_limited");
    let slice = g.json["slice_thickness_A"].as_f64().unwrap();
    let mut settings = Settings {
        detectors: four(&g),
        beyond_limit: BeyondLimit::Warn,
        grid: GridChoice::Points([480, 480]),
        slicing: Slicing::Thickness(slice),
        oversampling: Some(2),
        band_taper: 0.02,
        band_fraction: EXACT_BAND_FRACTION,
        ..Settings::default()
    };
    settings.optics.aberrations = Aberrations::defocus(slice / 2.0);
    let plan = g.plan(&settings);
    for (i, p) in g.json["positions_A"].as_array().unwrap().iter().enumerate() {
        let scan = Scan { origin_angstrom: g.pair(p), step_angstrom: [1.0; 2], shape: [1, 1] };
        let images = simulate(&plan, &g.sites, &scan, &Silent).unwrap();
        for d in 0..4 {
            let (ours, theirs) = (images.data[[0, d, 0, 0]], expected[[i, d]]);
            assert!(
                (ours / theirs - 1.0).abs() < 1e-3,
                "position {i}, detector {d}: {ours} {theirs}"
            );
        }
    }
}

/// HAADF of displaced atoms against abTEM refined in the grid.
#[test]
fn displaced_atoms_on_the_default_grid() {
    let g = Golden::load("displaced_refined");
    let positions: Vec<[f64; 2]> =
        g.json["positions_A"].as_array().unwrap().iter().map(|p| g.pair(p)).collect();
    let slice = g.json["slice_thickness_A"].as_f64().unwrap();
    let mut base = Settings { slicing: Slicing::Thickness(slice), ..Settings::default() };
    base.optics.aberrations = Aberrations::defocus(slice / 2.0);
    let haadf = |settings: &Settings| -> Array1<f32> {
        let plan = g.plan(settings);
        let one = |p: &[f64; 2]| {
            let scan = Scan { origin_angstrom: *p, step_angstrom: [1.0; 2], shape: [1, 1] };
            simulate(&plan, &g.sites, &scan, &Silent).unwrap().data[[0, 0, 0, 0]]
        };
        positions.iter().map(one).collect()
    };
    let show = |name: &str, values: &Array1<f32>, reference: &Array1<f32>| {
        let percent = |(v, r): (&f32, &f32)| 100.0 * (v / r - 1.0);
        let errors: Vec<f32> = values.iter().zip(reference).map(percent).collect();
        println!("{name:>24}: {errors:.2?} %");
        errors
    };
    // Towards an infinitely fine grid: the error of `exp` on the grid falls with the square of the
    // pixel.
    let (coarse, fine) = (g.array2("exact_960"), g.array2("exact_1920"));
    let limit = (&fine.column(3) * 4.0 - coarse.column(3)) / 3.0;
    println!("{:>24}  {limit:.5?}", "limit");
    for name in ["as_shipped_480", "as_shipped_960", "as_shipped_1920", "as_shipped_2400"] {
        show(&format!("abTEM {name}"), &g.array2(name).column(3).to_owned(), &limit);
    }
    for name in ["exact_480", "exact_960", "exact_1920"] {
        show(&format!("abTEM {name}"), &g.array2(name).column(3).to_owned(), &limit);
    }
    let default = haadf(&base);
    let errors = show("default", &default, &limit);
    assert!(errors.iter().all(|e| e.abs() < 0.15), "{errors:?}");
    for (factor, name) in [(2, "potentials x2"), (4, "potentials x4")] {
        show(name, &haadf(&Settings { oversampling: Some(factor), ..base.clone() }), &limit);
    }
    for width_angstrom in [7.8, 11.7, 15.6] {
        let windows = Settings { algorithm: Algorithm::Window { width_angstrom }, ..base.clone() };
        show(&format!("window {width_angstrom}"), &haadf(&windows), &limit);
    }
}
