//! The images of the present version of the numerics: what is kept on disk under that version must stay right.
//!
//! `tests/numerics/images.json` holds points of a mosaic's image, a film's and one of windows. If they change by more than
//! 1e-5 of the brightest, caches and work folders of users hold other images than the program would make now, and the
//! version has to be raised with the change.

use std::path::PathBuf;
use std::sync::Arc;

use crate::common::specimen;
use ndarray::Array2;
use serde_json::{Value, json};
use stemgen::imaging::{Cache, ImagingChoice, MethodChoice, PixelRect, RegionImager};
use stemgen::numerics::NUMERICS_VERSION;
use stemgen::progress::Silent;
use stemgen::recipe::{CheckedRecipe, Difficulty, Override, Recipe};
use stemgen::specimen::Specimen;
use stemgen::world::BuildOptions;

/// Largest change, of the brightest point, that two processors may make.
const MOST: f64 = 1e-5;
/// Set to write the file again.
const WRITE: &str = "STEMGEN_WRITE_NUMERICS";

fn recipe(material: &str, changes: &[&str]) -> CheckedRecipe {
    let changes: Vec<Override> = changes.iter().map(|c| c.parse().unwrap()).collect();
    let recipe = Recipe::load(material, Difficulty::Easy).unwrap();
    recipe.with_overrides(&changes).unwrap().checked().unwrap()
}

/// Every eighth pixel of a rectangle, made as `stemgen build` would with this method.
fn points(recipe: &CheckedRecipe, method: MethodChoice, first: [usize; 2]) -> Array2<f64> {
    let specimen: Arc<dyn Specimen> = specimen(recipe).unwrap();
    let policy = BuildOptions { cache: Cache::none(), ..BuildOptions::default() }.policy(recipe);
    let choice = ImagingChoice { method, ..policy.unwrap().imaging };
    let mut imager: Box<dyn RegionImager> = choice.imager(recipe, &specimen).unwrap();
    imager.prepare(&Silent).unwrap();
    let pixels = PixelRect::new(first, [64, 64]).every(8);
    let configurations = recipe.phonons.configurations;
    imager.mean_of(&pixels, configurations, &Silent).unwrap()
}

fn images() -> Vec<(&'static str, Array2<f64>)> {
    let thin = [
        "field={fov_nm=[6.2, 6.2], grid=[3, 3], tile_px=106, overlap_px=4, thickness_nm=0.8}",
        "phonons.configurations=2",
        "detector={inner_mrad=50.0, outer_mrad=90.0}",
        "vacancies.cluster_fraction=0.0",
    ];
    let crystal = recipe("srtio3", &thin);
    let film = [
        "field={fov_nm=[8.0, 8.0], grid=[5, 5], tile_px=132, overlap_px=4, thickness_nm=1.0}",
        "phonons.configurations=1",
        "particles.count=1",
        "particles.diameter_nm=[1.2, 1.6]",
    ];
    let film = recipe("pt", &film);
    let particle = specimen(&film).unwrap().particles()[0].centre_nm;
    let pixel = film.field.pixel_nm();
    let first = [1, 0].map(|k| (particle[k] / pixel) as usize - 20);
    vec![
        ("mosaic", points(&crystal, MethodChoice::Mosaic, [120, 120])),
        ("window", points(&crystal, MethodChoice::Direct, [120, 120])),
        ("film", points(&film, MethodChoice::Auto, first)),
    ]
}

#[test]
fn images_are_those_of_this_version() {
    let file = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .join("tests/numerics/images.json");
    let images = images();
    if std::env::var_os(WRITE).is_some() {
        let mut all = serde_json::Map::from_iter([("version".to_owned(), NUMERICS_VERSION.into())]);
        let rows = |a: &Array2<f64>| -> Vec<Vec<f64>> {
            let rounded = |v: &f64| (v * 1e9).round() * 1e-9;
            a.outer_iter().map(|row| row.iter().map(rounded).collect()).collect()
        };
        all.extend(images.iter().map(|(name, image)| ((*name).to_owned(), json!(rows(image)))));
        let text = serde_json::to_string_pretty(&Value::Object(all)).unwrap();
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(&file, text + "\n").unwrap();
    }
    let text = std::fs::read_to_string(&file).unwrap();
    let kept: Value = serde_json::from_str(&text).unwrap();
    let version = kept["version"].as_u64().unwrap() as u32;
    assert_eq!(
        version,
        NUMERICS_VERSION,
        "the images of version {NUMERICS_VERSION} are not written yet: run this test once with {WRITE}=1 set, \
         look at the change, and commit {}",
        file.display()
    );
    for (name, image) in &images {
        let kept: Vec<Vec<f64>> = serde_json::from_value(kept[name].clone()).unwrap();
        let kept: Vec<f64> = kept.into_iter().flatten().collect();
        assert_eq!(kept.len(), image.len(), "{name}");
        let top = kept.iter().copied().fold(0.0, f64::max);
        let off = image.iter().zip(&kept).map(|(a, b)| (a - b).abs() / top).fold(0.0, f64::max);
        println!("{name}: off by {off:.1e} of the brightest point");
        assert!(
            off < MOST,
            "the image `{name}` has changed by {off:.1e} of its brightest point, but NUMERICS_VERSION is still \
             {NUMERICS_VERSION}. If that is meant, raise NUMERICS_VERSION in src/numerics.rs by one, run this test once \
             with {WRITE}=1 set, and commit the file that it writes: caches and work folders of the old version are then \
             left alone"
        );
    }
}
