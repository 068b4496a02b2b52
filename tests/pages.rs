//! `stemgen view --html` and `stemgen simulate --html` in headless Chromium.

mod common;

use common::Spots;
use stemgen::progress::Silent;
use stemgen::world::{BuildOptions, Difficulty, Recipe, build};

/// Builds `full.h5`, the whole field of SrTiO3 with a stand-in for the engine, in `$STEMGEN_LOOK`.
#[test]
#[ignore = "makes a large file to measure with"]
fn a_world_of_full_size() {
    let folder = std::env::var_os("STEMGEN_LOOK").expect("STEMGEN_LOOK names a folder");
    let material = std::env::var("STEMGEN_MATERIAL").unwrap_or_else(|_| "srtio3".into());
    let recipe = Recipe::load(&material, Difficulty::Easy).unwrap();
    let options = BuildOptions { keep_clean: true, overwrite: true, ..BuildOptions::default() };
    let path = std::path::Path::new(&folder).join(format!("{material}_full.h5"));
    build(&recipe, &Spots::new(), &path, &options, &Silent).unwrap();
}
