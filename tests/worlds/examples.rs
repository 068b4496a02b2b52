//! The programs of `examples/` run and write what they say.

#[allow(dead_code)]
#[path = "../../examples/build_world.rs"]
mod build_world;
#[allow(dead_code)]
#[path = "../../examples/simulate_cif.rs"]
mod simulate_cif;
#[allow(dead_code)]
#[path = "../../examples/tile_with_truth.rs"]
mod tile_with_truth;

use std::path::Path;

use stemgen::io::WorldFile;

#[test]
fn a_cif_is_simulated() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    simulate_cif::run(&root.join("structures/srtio3.cif")).unwrap();
}

#[test]
fn a_world_is_built() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("example.h5");
    build_world::run(&path).unwrap();
    assert_eq!(WorldFile::open(&path).unwrap().metadata().seed, Some(7));
}

#[test]
fn a_tile_is_made_with_its_truth() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tile.png");
    tile_with_truth::run(&path).unwrap();
    assert!(std::fs::read(&path).unwrap().starts_with(b"\x89PNG"));
}
