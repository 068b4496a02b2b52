//! The library that comes along with the program: it holds what the worlds of its own crystalline recipes need, nothing else, and what this
//! version of the program simulates.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use stemgen::imaging::mosaic::supplied_images::digest;
use stemgen::imaging::{Cache, MosaicImager, SuppliedLibrary};
use stemgen::numerics::NUMERICS_VERSION;
use stemgen::progress::Silent;
use stemgen::recipe::{Difficulty, Recipe};
use stemgen::world::{BuildOptions, WorldBuild};

const MATERIALS: [&str; 4] = ["batio3", "gan", "sige", "srtio3"];
const REMEDY: &str = "the library is not that of this version of the numerics, or of these recipes: `sh library/make.sh`";
const MOST_BYTES: u64 = 30_000_000;

fn supplied() -> SuppliedLibrary {
    SuppliedLibrary::at(Path::new(env!("CARGO_MANIFEST_DIR")).join("library"))
}

fn mosaic(material: &str, tier: Difficulty) -> MosaicImager {
    let recipe = Recipe::load(material, Some(tier)).unwrap().checked().unwrap();
    let cache = Cache::none().with_supplied(supplied());
    let options = BuildOptions { cache, ..BuildOptions::default() };
    WorldBuild::new(&recipe, &options).unwrap().library().unwrap().expect("a mosaic")
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
        let text =
            std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
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
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/imaging/mosaic/supplied_images.bin");
    if std::env::var_os("STEMGEN_UPDATE").is_some() {
        std::fs::write(&path, digests.as_flattened()).unwrap();
    }
    assert!(std::fs::read(path).unwrap() == digests.as_flattened(), "{REMEDY}");
}

/// Another one each time: `STEMGEN_DRAW` names that of a failure.
#[test]
fn an_image_drawn_by_chance_is_what_the_program_simulates() {
    let now = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs();
    let draw = std::env::var("STEMGEN_DRAW").map_or_else(|_| now(), |d| d.parse().unwrap());
    let material = MATERIALS[(draw / 3) as usize % MATERIALS.len()];
    let tiers = Recipe::tiers(material).unwrap();
    let tier = tiers[draw as usize % tiers.len()];
    let found = mosaic(material, tier).recomputed(1, draw, &Silent).unwrap();
    println!("STEMGEN_DRAW={draw}: {material} {tier:?}, {found:?}");
    assert_eq!(found.len(), 1);
    assert!(found[0].agrees(), "STEMGEN_DRAW={draw}: {material} {tier:?}, {found:?}: {REMEDY}");
}
