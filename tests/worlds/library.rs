//! The library that comes along with the program: it holds what the worlds of its own crystalline recipes need, nothing else, and what this
//! version of the program simulates.

use std::collections::BTreeSet;
use std::path::Path;

use ndarray::{Array2, ArrayView2, s};
use stemgen::benchmark::{BenchmarkWorld, RecipeSource, TileView};
use stemgen::imaging::supplied_images::digest;
use stemgen::imaging::{
    Cache, DetectorChoice, MosaicImager, RasterDetail, RegionImager, SharedLibrary,
    SuppliedLibrary, TurnedRaster,
};
use stemgen::numerics::NUMERICS_VERSION;
use stemgen::progress::Silent;
use stemgen::recipe::{Difficulty, Recipe};
use stemgen::world::{BuildOptions, WorldBuild};

const MATERIALS: [&str; 7] = ["batio3", "gan", "graphene", "mos2", "sige", "srtio3", "wse2"];
const REMEDY: &str = "the library is not that of this version of the numerics, or of these recipes: `sh library/make.sh`";
const MOST_BYTES: u64 = 40_000_000;

fn supplied() -> SuppliedLibrary {
    SuppliedLibrary::at(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join("library"))
}

fn options() -> BuildOptions {
    BuildOptions { cache: Cache::none().with_supplied(supplied()), ..BuildOptions::default() }
}

fn mosaic(material: &str, tier: Difficulty) -> MosaicImager {
    let recipe = Recipe::load(material, Some(tier)).unwrap().checked().unwrap();
    WorldBuild::new(&recipe, &options()).unwrap().library().unwrap().expect("a mosaic")
}

#[test]
fn it_holds_what_the_recipes_need_and_nothing_else() {
    let mut bytes = 0;
    for material in MATERIALS {
        let mut needed = BTreeSet::new();
        for tier in Recipe::tiers(material).unwrap() {
            let mosaic = mosaic(material, tier);
            assert_eq!(mosaic.mosaic_cost().missing, 0, "{material} {tier:?}: {REMEDY}");
            needed.extend(mosaic.image_keys());
        }
        let held: BTreeSet<String> = supplied().keys(material).into_iter().collect();
        let others: Vec<&String> = held.difference(&needed).collect();
        assert!(others.is_empty(), "{material}: no recipe needs {others:?}");
        let path = supplied().folder().join(format!("{material}.stemlib"));
        bytes += std::fs::metadata(path).unwrap().len();
    }
    assert!(bytes <= MOST_BYTES, "{bytes} bytes");
    assert_eq!(supplied().verified(&Silent).unwrap().len(), MATERIALS.len());
    for file in ["library/pyproject.toml", "python/pyproject.toml"] {
        let text = std::fs::read_to_string(
            Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join(file),
        )
        .unwrap();
        let words =
            [format!("version = \"{NUMERICS_VERSION}."), format!("library=={NUMERICS_VERSION}.*")];
        assert!(words.iter().any(|w| text.contains(w)), "{file}: {REMEDY}");
    }
}

/// `STEMGEN_UPDATE=1` renews it.
#[test]
fn the_program_knows_its_images_by_heart() {
    let of = |material: &str| {
        let keys = supplied().keys(material).into_iter();
        keys.map(|key| digest(material, &key)).collect::<Vec<_>>()
    };
    let mut digests: Vec<[u8; 8]> = MATERIALS.into_iter().flat_map(of).collect();
    digests.sort();
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .join("src/imaging/mosaic/supplied_images.bin");
    if std::env::var_os("STEMGEN_UPDATE").is_some() {
        std::fs::write(&path, digests.as_flattened()).unwrap();
    }
    assert!(std::fs::read(path).unwrap() == digests.as_flattened(), "{REMEDY}");
}

/// Another one for each version of the numerics; `STEMGEN_DRAW` names others.
#[test]
#[ignore = "long"]
fn an_image_drawn_by_chance_is_what_the_program_simulates() {
    let usual = u64::from(NUMERICS_VERSION);
    let draw = std::env::var("STEMGEN_DRAW").map_or(usual, |d| d.parse().unwrap());
    let material = MATERIALS[(draw / 3) as usize % MATERIALS.len()];
    let tiers = Recipe::tiers(material).unwrap();
    let tier = tiers[draw as usize % tiers.len()];
    let found = mosaic(material, tier).recomputed(1, draw, &Silent).unwrap();
    println!("STEMGEN_DRAW={draw}: {material} {tier:?}, {found:?}");
    assert_eq!(found.len(), 1);
    assert!(found[0].agrees(), "STEMGEN_DRAW={draw}: {material} {tier:?}, {found:?}: {REMEDY}");
}

/// Rms of the difference of two images, in per cent of the mean of the second.
fn rms_percent(found: ArrayView2<'_, f64>, exact: ArrayView2<'_, f64>) -> f64 {
    let square = (&found - &exact).mapv(|d| d * d).mean().unwrap();
    100.0 * square.sqrt() / exact.mean().unwrap()
}

/// Means over squares of so many pixels along an edge.
fn means(image: ArrayView2<'_, f64>, edge: usize) -> Array2<f64> {
    let block = |i: usize, j: usize| {
        image.slice(s![i * edge..(i + 1) * edge, j * edge..(j + 1) * edge]).mean().unwrap()
    };
    Array2::from_shape_fn((image.nrows() / edge, image.ncols() / edge), |(i, j)| block(i, j))
}

/// What is left out of overviews (phonons of single columns, and ramps between them) is little beside the image at the same places.
#[test]
fn overviews_are_the_image_but_for_details() {
    for (material, pixel_nm, places, most_percent) in [
        ("srtio3", 0.161, 3, 3.5),
        ("batio3", 0.161, 3, 4.0),
        ("gan", 0.258, 4, 2.5),
        ("sige", 0.161, 3, 2.0),
    ] {
        let mut mosaic = mosaic(material, Difficulty::Hard);
        mosaic.prepare(&Silent).unwrap();
        let raster = TurnedRaster {
            centre_nm: [20.0, 30.0],
            pixel_nm: pixel_nm / f64::from(places),
            angle_rad: 0.0,
            shape: [20 * places as usize; 2],
        };
        let main = DetectorChoice::Main;
        let made = |detail| {
            mosaic.images_at(&raster, detail, main, 16, &Silent).unwrap().unwrap().remove(0)
        };
        let (exact, overview) = (made(RasterDetail::Full), made(RasterDetail::Overview));
        let of_places = rms_percent(overview.view(), exact.view());
        let [overview, exact] = [overview, exact].map(|i| means(i.view(), places as usize));
        let of_pixels = rms_percent(overview.view(), exact.view());
        println!("{material}: places {of_places:.2} %, pixels {of_pixels:.2} %");
        assert!(of_pixels < most_percent, "{material}: {of_pixels}");
    }
}

/// Places in a pixel of an overview are fewer than the pixels of the field that it averages, which shows at sharp columns.
#[test]
fn overviews_are_about_the_means_of_pixels() {
    for (material, most_percent) in [("srtio3", 7.5), ("gan", 4.0), ("batio3", 7.5), ("sige", 4.5)]
    {
        // Next to no noise.
        let bright = ["dose.electrons_per_angstrom2=1e12".parse().unwrap()];
        let recipe = Recipe::load(material, Some(Difficulty::Hard)).unwrap();
        let recipe = recipe.with_overrides(&bright).unwrap().checked().unwrap();
        let source = RecipeSource::new(&recipe, &options(), &Silent).unwrap();
        let world = source.world(1).unwrap();
        let overview = world.overview([0.5; 2], 64, &Silent).unwrap().mapv(f64::from);
        let facts = world.facts().clone();
        // The window about the middle: its pixels 24 to 40 are those of a tile.
        let middle = facts.shape_px().map(|n| n / 16 - 8);
        let view = TileView { first_px: middle.map(|n| 8 * n), ..facts.view_at([0.5; 2], 1.0) };
        let tile = world.clean(&view, &Silent).unwrap();
        let mean = means(tile.mapv(|v| f64::from(v) / facts.scaling[0]).view(), 8);
        let [error, shifted] =
            [0, 1].map(|n| rms_percent(overview.slice(s![24..40, 24 + n..40 + n]), mean.view()));
        println!("{material}: {error:.2} % of the mean, one pixel off {shifted:.1} %");
        assert!(error < most_percent, "{material}: {error}");
        assert!(shifted > 2.0 * error, "{material}: {shifted}");
    }
}
