//! A detector that counts more of the electrons at some angles than at others: the sum of thin annuli, each times its share.

use std::path::Path;

use stemgen::detect::Detector;
use stemgen::engine::{
    Algorithm, Images, Plan, ProbeBox, Scan, Settings, SingleScattering, simulate,
};
use stemgen::imaging::Cache;
use stemgen::io::WorldFile;
use stemgen::progress::Silent;
use stemgen::recipe::{CheckedRecipe, Recipe};
use stemgen::structure::Site;
use stemgen::world::{BuildMethod, BuildOptions, build};

/// Width of the annuli in mrad, and how many there are.
const WIDTH_MRAD: f64 = 4.0;
const ANNULI: usize = 16;
const INNER_MRAD: f64 = 50.0;

fn response() -> Vec<[f64; 2]> {
    vec![[50.0, 0.2], [70.0, 1.0], [90.0, 0.9], [110.0, 0.3]]
}

/// The whole detector with its response, and the annuli that it consists of.
fn detectors() -> Vec<Detector> {
    let outer = INNER_MRAD + WIDTH_MRAD * ANNULI as f64;
    let whole = Detector::new("whole", INNER_MRAD, outer).with_response(response());
    let annulus = |n: usize| {
        let inner = INNER_MRAD + WIDTH_MRAD * n as f64;
        Detector::new(&format!("a{n}"), inner, inner + WIDTH_MRAD)
    };
    std::iter::once(whole).chain((0..ANNULI).map(annulus)).collect()
}

fn shares() -> Vec<f64> {
    let whole = &detectors()[0];
    (0..ANNULI).map(|n| whole.response_at(INNER_MRAD + WIDTH_MRAD * (n as f64 + 0.5))).collect()
}

/// The greatest difference of the image from the sum of its parts, in parts of its maximum; and of a detector without the response.
fn apart(images: &Images) -> [f64; 2] {
    let whole = images.image(0, 0);
    let most = whole.iter().fold(0.0_f64, |m, v| m.max(f64::from(*v)));
    let mut found = [0.0_f64; 2];
    for ((y, x), value) in whole.indexed_iter() {
        let parts = shares().into_iter().enumerate();
        let [weighted, plain] = parts.fold([0.0; 2], |[w, p], (n, share)| {
            let part = f64::from(images.image(0, n + 1)[[y, x]]);
            [w + share * part, p + part]
        });
        for (found, sum) in found.iter_mut().zip([weighted, plain]) {
            *found = found.max((f64::from(*value) - sum).abs() / most);
        }
    }
    found
}

#[test]
fn every_engine_counts_the_shares() {
    let sites: Vec<Site> = (0..6)
        .map(|n| Site {
            position: [3.9 + 0.3 * n as f64, 4.1, 2.0 * n as f64 + 1.0],
            number: [38, 22, 8][n % 3],
            sigma_angstrom: 0.0,
            anisotropy: None,
            key: n as u64,
        })
        .collect();
    let heights: Vec<f64> = sites.iter().map(|s| s.position[2]).collect();
    let scan = Scan { origin_angstrom: [3.0, 3.0], step_angstrom: [0.4; 2], shape: [6, 8] };
    let algorithms = [
        Algorithm::Multislice,
        Algorithm::Prism { interpolation: [1, 1] },
        Algorithm::Window { width_angstrom: 7.8 },
    ];
    for algorithm in algorithms {
        let prism = matches!(algorithm, Algorithm::Prism { .. });
        let large = (!prism).then_some(ProbeBox::Large);
        let settings =
            Settings { algorithm, detectors: detectors(), probe_box: large, ..Settings::default() };
        let plan = Plan::new(&settings, [12.0, 12.0, 13.0], &heights).unwrap();
        let [with, without] = apart(&simulate(&plan, &sites, &scan, &Silent).unwrap());
        // Annuli are little wider than pixels of the diffraction pattern (3 mrad).
        assert!(with < 5e-3, "{algorithm:?}: {with}");
        assert!(without > 0.2, "{algorithm:?}: {without}");
    }
}

/// The images of carbon, and the tail of windows, are those of cross sections.
#[test]
fn independent_atoms_count_the_shares() {
    let image = |detector: &Detector| {
        let settings = Settings { detectors: vec![detector.clone()], ..Settings::default() };
        let raster = SingleScattering::new(&settings, 0.25, [120, 120]).unwrap();
        let mut map = raster.map(6, [0.0, 10.0]).unwrap();
        map.add(&[[15.0, 15.0, 5.0]], 1.0);
        map.image(0.0)
    };
    let all = detectors();
    let whole = image(&all[0]);
    let mut sum = ndarray::Array2::<f64>::zeros(whole.dim());
    for (detector, share) in all[1..].iter().zip(shares()) {
        sum += &(image(detector) * share);
    }
    let most = whole.iter().fold(0.0_f64, |m, v| m.max(*v));
    let apart = whole.iter().zip(&sum).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
    // Integrals over thin annuli have a quadrature of their own.
    assert!(apart < 0.01 * most, "{}", apart / most);
}

fn recipe(detector: &str) -> stemgen::Result<CheckedRecipe> {
    let tiny = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/cli/tiny.toml"));
    Recipe::from_file(tiny, None)?.with_overrides(&[detector.parse()?])?.checked()
}

#[test]
fn worlds_have_the_response_of_their_recipe() {
    let folder = tempfile::tempdir().unwrap();
    let image = |name: &str, detector: &str| {
        let path = folder.path().join(name);
        let options = BuildOptions {
            cache: Cache::none(),
            method: BuildMethod::Window,
            keep_clean: true,
            audit_regions: 0,
            ..BuildOptions::default()
        };
        build(&recipe(detector).unwrap(), &path, &options, &Silent).unwrap();
        let world = WorldFile::open(&path).unwrap();
        let text = world.metadata().recipe.clone().unwrap();
        (world.clean_tile(0, 0).unwrap(), text)
    };
    let (plain, text) = image("plain.h5", "detector={inner_mrad=68.0,outer_mrad=110.0}");
    assert!(!text.contains("response"));
    let half = "detector={inner_mrad=68.0,outer_mrad=110.0,response=[[90.0, 0.5]]}";
    let (half, text) = image("half.h5", half);
    assert!(text.contains("response"), "{text}");
    let most = plain.iter().fold(0.0_f32, |m, v| m.max(*v));
    assert!(plain.iter().zip(&half).all(|(a, b)| (0.5 * a - b).abs() < 1e-6 * most));
}

#[test]
fn bad_responses_are_refused() {
    for bad in [
        "[[90, 1.5]]",
        "[[90, -0.1]]",
        "[[90, 1], [80, 1]]",
        "[[90, 1], [90, 0.5]]",
        "[[-1, 1]]",
        "[[90, 0.0], [100, 0.0]]",
        "[[90, nan]]",
    ] {
        for table in [
            format!("detector={{inner_mrad=68.0,outer_mrad=110.0,response={bad}}}"),
            format!("detector=[{{name=\"A\",inner_mrad=68.0,outer_mrad=110.0,response={bad}}}]"),
        ] {
            let printed = recipe(&table).unwrap_err().to_string();
            assert!(printed.contains("response") && printed.contains("0 to 1"), "{printed}");
        }
    }
    let printed = recipe("detector={inner_mrad=68.0,outer_mrad=110.0,respose=[]}").unwrap_err();
    assert!(printed.to_string().contains("did you mean `response`"), "{printed}");
}
