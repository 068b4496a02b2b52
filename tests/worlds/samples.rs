//! Images on turned rasters, and labelled samples on them.

use std::sync::{Arc, LazyLock};

use ndarray::Array2;
use stemgen::engine::{Algorithm, Expansion};
use stemgen::imaging::{
    Cache, DirectImager, MosaicImager, PixelRect, RegionImager, SharedLibrary, Simulator,
    TurnedRaster, turned_image,
};
use stemgen::progress::Silent;
use stemgen::recipe::{CheckedRecipe, Difficulty, Recipe};
use stemgen::specimen::{Specimen, specimen};
use stemgen::world::{SampleOptions, training_sample};

/// SrTiO3 as thin and with a detector as narrow as to take seconds, with a grain boundary.
const RECIPE: &str = r#"
    version = 1
    id = "thin"
    structure = "grains"
    zone_axis = "[001]"
    y_axis = "[010]"
    crystal = "srtio3"
    seed = 3
    field = { fov_nm = [6.2, 6.2], grid = [3, 3], tile_px = 106, overlap_px = 4, thickness_nm = 0.8 }
    boundaries = { count = 1, misorientation_deg = 36.87, sigma = 5, min_distance_angstrom = { Sr-Sr = 2.2 } }
    vacancies = { element = "O", rate = 0.1, cluster_fraction = 0.0, cluster_sigma_nm = 1.0, max_probability = 0.3 }
    phonons = { configurations = 2, sigma_angstrom = { Sr = 0.084, Ti = 0.060, O = 0.085 } }
    optics = { energy_kv = 200.0, convergence_mrad = 21.0 }
    detector = { inner_mrad = 50.0, outer_mrad = 90.0 }
    dose = { electrons_per_angstrom2 = 1e5 }
"#;

struct Field {
    recipe: CheckedRecipe,
    specimen: Arc<dyn Specimen>,
    direct: DirectImager,
    mosaic: MosaicImager,
}

/// All tests of this file look at the same field: its library takes a while.
static FIELD: LazyLock<Field> = LazyLock::new(|| {
    let recipe = Recipe::from_toml_str("thin.toml", RECIPE, None).unwrap().checked().unwrap();
    let specimen = specimen(&recipe).unwrap();
    let simulator = Simulator::new(&recipe, Algorithm::Window { width_angstrom: 7.8 });
    // Windows so wide that their own error, which depends on where they lie, is below that of interpolation.
    let wide = Simulator::new(&recipe, Algorithm::Window { width_angstrom: 15.6 })
        .with_expansion(Expansion::Off);
    let direct = DirectImager::new(&recipe, &specimen, wide).unwrap();
    let mut mosaic = MosaicImager::new(&recipe, &specimen, simulator, Cache::none()).unwrap();
    mosaic.prepare(&Silent).unwrap();
    Field { recipe, specimen, direct, mosaic }
});

/// The raster of the pixels of a rectangle.
fn raster(field: &Field, pixels: &PixelRect) -> TurnedRaster {
    let pixel_nm = field.recipe.field.pixel_nm();
    let middle = [1, 0].map(|k| pixels.first[k] as f64 + 0.5 * (pixels.shape[k] as f64 - 1.0));
    let centre_nm = middle.map(|p| p * pixel_nm);
    TurnedRaster { centre_nm, pixel_nm, angle_rad: 0.0, shape: pixels.shape }
}

/// Rms difference in per cent of the contrast: of the standard deviation of the image.
fn difference(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
    assert_eq!(a.dim(), b.dim());
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    100.0 * (squares / a.len() as f64).sqrt() / b.std(0.0)
}

#[test]
fn a_straight_raster_has_the_pixels_of_the_field_and_a_turned_one_its_places() {
    let field = &*FIELD;
    let pixels = PixelRect::new([100, 90], [20, 26]);
    let straight = raster(field, &pixels);
    let imagers: [&dyn RegionImager; 2] = [&field.direct, &field.mosaic];
    for (imager, most) in imagers.into_iter().zip([0.5, 1e-6]) {
        let image =
            |raster: &TurnedRaster| turned_image(&field.recipe, imager, raster, &Silent).unwrap();
        let ours = image(&straight);
        let field_pixels = imager.mean_of(&pixels, 2, &Silent).unwrap();
        let worst = difference(&ours, &field_pixels);
        assert!(worst < most, "{}: {worst} %", imager.facts().name);
        // By a quarter turn rows become columns; the places are the same but for rounding.
        let shape = [straight.shape[1], straight.shape[0]];
        let quarter = TurnedRaster { angle_rad: 0.5 * std::f64::consts::PI, shape, ..straight };
        let mut turned = image(&quarter).reversed_axes();
        turned.invert_axis(ndarray::Axis(1));
        let worst = difference(&turned, &ours);
        assert!(worst < 1e-3, "{}, turned: {worst} %", imager.facts().name);
        // Every second pixel of a raster twice as fine.
        let fine = TurnedRaster {
            pixel_nm: 0.5 * straight.pixel_nm,
            shape: straight.shape.map(|n| 2 * n - 1),
            angle_rad: 0.3,
            ..straight
        };
        let coarse = image(&TurnedRaster { angle_rad: 0.3, ..straight });
        let every_second = image(&fine).slice(ndarray::s![..;2, ..;2]).to_owned();
        let worst = difference(&every_second, &coarse);
        assert!(worst < 1e-3, "{}, fine: {worst} %", imager.facts().name);
    }
}

fn options() -> SampleOptions {
    SampleOptions {
        size_px: 64,
        pixel_nm: [0.015, 0.025],
        angle_rad: [-3.2, 3.2],
        dose: [1e3, 1e6],
        sigma_px: 2.0,
        seed: 7,
        all_detectors: false,
    }
}

/// Samples of a recipe with several detectors: the main image as without the others, which show the same place.
#[test]
#[ignore = "long"]
fn samples_have_the_images_of_all_detectors_where_they_are_wanted() {
    let changes = [
        "detector=[{name=\"HAADF\",inner_mrad=68.0,outer_mrad=200.0},{name=\"MAADF\",inner_mrad=50.0,outer_mrad=150.0},\
         {name=\"S\",inner_mrad=50.0,outer_mrad=150.0,sectors=2}]",
        "field.thickness_nm=0.4",
    ];
    let changes = changes.map(|c| c.parse().unwrap());
    let recipe = Recipe::load("srtio3", Difficulty::Easy).unwrap().with_overrides(&changes);
    let recipe = recipe.unwrap().checked().unwrap();
    let specimen = stemgen::specimen::specimen(&recipe).unwrap();
    let simulator = Simulator::new(&recipe, Algorithm::Window { width_angstrom: 7.8 });
    let imager = DirectImager::new(&recipe, &specimen, simulator).unwrap();
    let sample = |all_detectors: bool| {
        let options = SampleOptions { size_px: 24, all_detectors, ..options() };
        training_sample(&recipe, &*specimen, &imager, &options, 3, &Silent).unwrap()
    };
    let (main, all) = (sample(false), sample(true));
    assert!(main.others.is_empty());
    assert_eq!((&main.clean, &main.counts), (&all.clean, &all.counts));
    let names: Vec<&str> = all.others.iter().map(|other| other.name.as_str()).collect();
    assert_eq!(names, ["MAADF", "S_0", "S_1"]);
    let [maadf, first, second] = &all.others[..] else { panic!() };
    let of = |image: &Array2<f32>| image.mapv(f64::from);
    let sum = of(&first.clean) + of(&second.clean);
    assert!(difference(&sum, &of(&maadf.clean)) < 0.5);
    // They show one place: a detector that begins lower is brighter, where the main one is bright.
    let (a, b) = (of(&all.clean), of(&maadf.clean));
    let [mean_a, mean_b] = [&a, &b].map(|image| image.mean().unwrap());
    assert!(mean_b > mean_a);
    let covariance = ((&a - mean_a) * (&b - mean_b)).mean().unwrap();
    assert!(covariance / (a.std(0.0) * b.std(0.0)) > 0.9);
    // Each has electrons of its own.
    let electrons = mean_b * all.electrons_per_pixel * 576.0;
    let counted: f64 = maadf.counts.iter().map(|n| f64::from(*n)).sum();
    assert!((counted - electrons).abs() < 5.0 * electrons.sqrt(), "{counted} {electrons}");
}

#[test]
fn samples_depend_on_their_number_alone_and_their_labels_on_what_they_show() {
    let field = &*FIELD;
    let sample = |index: u64| {
        let Field { recipe, specimen, mosaic, .. } = field;
        training_sample(recipe, &**specimen, mosaic, &options(), index, &Silent).unwrap()
    };
    let all: Vec<_> = (0..4).map(sample).collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(pool.install(|| sample(2)), all[2]);
    for (n, one) in all.iter().enumerate() {
        assert!((0.015..=0.025).contains(&one.raster.pixel_nm) && (1e3..=1e6).contains(&one.dose));
        assert!(all[..n].iter().all(|other| other.raster.centre_nm != one.raster.centre_nm));
        assert!(one.positions_px.nrows() > 5 && one.positions_px.nrows() == one.columns.nrows());
        // The counts are those of the dose, and bright places those of the heaviest columns.
        let expected = f64::from(one.clean.sum()) * one.electrons_per_pixel;
        let counted = one.counts.iter().map(|n| f64::from(*n)).sum::<f64>();
        assert!((counted - expected).abs() < 5.0 * expected.sqrt(), "{counted} {expected}");
        let mean = one.clean.mean().unwrap();
        for (place, facts) in one.positions_px.outer_iter().zip(one.columns.outer_iter()) {
            let [column, row] = [place[0], place[1]].map(|v| v.round() as i64);
            if !(1..63).contains(&row) || !(1..63).contains(&column) {
                continue;
            }
            let at = [row as usize, column as usize];
            assert!(one.heat_map[at] > 0.8 && i32::from(one.class_mask[at]) == facts[0]);
            assert!(facts[4] != 38 || one.clean[at] > 1.5 * mean, "Sr at {at:?}");
        }
    }
}

#[test]
fn impossible_samples_are_refused() {
    let field = &*FIELD;
    let printed = |options: SampleOptions| {
        options.check(&field.recipe.field).expect_err("refused").to_string()
    };
    assert!(printed(SampleOptions { size_px: 400, ..options() }).contains("does not fit"));
    assert!(printed(SampleOptions { dose: [5.0, 1.0], ..options() }).contains("the lower first"));
    assert!(printed(SampleOptions { pixel_nm: [0.0, 1.0], ..options() }).contains("0.0001"));
    assert!(printed(SampleOptions { sigma_px: 0.0, ..options() }).contains("heat maps"));
    let outside =
        TurnedRaster { centre_nm: [0.1, 3.0], pixel_nm: 0.02, angle_rad: 0.0, shape: [32, 32] };
    let printed = turned_image(&field.recipe, &field.mosaic, &outside, &Silent).unwrap_err();
    assert!(printed.to_string().contains("the full field"), "{printed}");
}
