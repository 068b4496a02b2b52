//! Tiles and live worlds of layers with an edge, and of a user's own atoms.

use std::path::Path;

use super::{file, json, stderr, stemgen};

const QUICK: [&str; 10] = [
    "--set",
    "phonons.configurations=1",
    "--set",
    "field.fov_nm=[2.4,2.4]",
    "--set",
    "field.grid=[3,3]",
    "--set",
    "field.tile_px=48",
    "--set",
    "field.overlap_px=12",
];

/// Rows of gold, one of which lacks an atom.
fn write_atoms(path: &Path) {
    let mut lines = Vec::new();
    for (i, j, k) in (0..200).map(|n| (n / 20, n / 2 % 10, n % 2)) {
        let atom = if (i, j, k) == (4, 4, 0) { "X 0 vacancy_Au" } else { "Au 1 none" };
        let (symbol, rest) = atom.split_once(' ').unwrap();
        lines.push(format!("{symbol} {} {} {} {rest}\n", 3 * i, 3 * j, 3 * k));
    }
    let columns = "Properties=species:S:1:pos:R:3:occupancy:R:1:defect:S:1";
    let head = format!("{}\nLattice=\"30 0 0 0 30 0 0 0 10\" {columns}\n", lines.len());
    std::fs::write(path, head + &lines.concat()).unwrap();
}

#[test]
#[ignore = "long: each specimen is simulated without a library"]
fn tiles_and_live_worlds_show_stacks_and_own_atoms() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write_atoms(&here.join("own.xyz"));
    let layer = file("examples/stacks/mos2_edge.toml");
    let specimens = [
        (layer.as_str(), "stack.vacancy_lines=[]", "S"),
        ("own.xyz", "phonons.sigma_angstrom={Au=0.08}", "Au"),
    ];
    for (recipe, change, element) in specimens {
        let specimen = |command: &str| {
            let mut run = stemgen(here);
            run.env("STEMGEN_CACHE", here.join("cache")).args([command, "--recipe", recipe]);
            run.args(["--set", change]).args(QUICK);
            run
        };
        let mut tiles = specimen("tiles");
        tiles.args(["-n", "2", "--size", "32", "--random-dose", "1e5,1e6", "--quiet"]);
        let run = tiles.args(["-o", &format!("{element}.npz")]).output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        let damage = format!("damage.radiolysis_barn.{element}=2000");
        let mut live = specimen("live");
        live.args(["--set", &damage, "--at", "1.2,1.2", "--zoom", "1", "--dose", "2e4"]);
        let shown = json(live.args(["--dose-series", "2", "-o", "s.h5", "--overwrite", "--quiet"]));
        assert!(shown["lost"][element].as_u64().unwrap() > 0, "{shown}");
    }
}
