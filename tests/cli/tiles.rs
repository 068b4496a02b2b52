//! `stemgen tiles`.

use super::{fails, file, json, python, stderr, stemgen};
use std::path::Path;
use std::process::Command;

fn tiles(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = stemgen(folder);
    command.env("STEMGEN_CACHE", folder.join("cache")).arg("tiles").args(arguments);
    command.args(["-n", "6", "--size", "16", "--random-dose", "1e5,1e7", "--quiet"]);
    command
}

#[test]
fn tiles_come_with_labels_and_are_those_of_the_world() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let vacancies = "vacancies={element=\"O\", rate=0.3, cluster_fraction=0.0, cluster_sigma_nm=1.0, max_probability=0.5}";
    let recipe = file("tests/cli/tiny.toml");
    let own = [recipe.as_str(), "--set", vacancies];
    let run = tiles(here, &[&own[..], &["-o", "a.npz"]].concat()).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    assert_eq!(python("check_tiles.py", &[&here.join("a.npz")]).trim(), "True");
    // The same tiles from a world that was built of the recipe.
    let mut build = stemgen(here);
    build.args(["build", "--recipe"]).args(own).args(["-o", "w.h5", "--no-png", "--quiet"]);
    assert!(build.status().unwrap().success());
    assert!(tiles(here, &["w.h5", "-o", "b.npz"]).status().unwrap().success());
    let read = |name: &str| std::fs::read(here.join(name)).unwrap();
    assert!(read("a.npz") == read("b.npz"), "the tiles differ");
    // 28 x 28 pixels have room for one tile of 16.
    let mut many = stemgen(here);
    many.args(["tiles", "w.h5", "-o", "d.npz", "--size", "16", "-n", "5", "--dry-run"]);
    let printed = stderr(&many.output().unwrap());
    assert!(
        printed.contains("5 tiles are asked for") && printed.contains("has room for 1 of"),
        "{printed}"
    );
    let plan = json(&mut tiles(here, &[&own[..], &["-o", "p.npz", "--dry-run"]].concat()));
    assert_eq!((&plan["tiles"], &plan["size_px"]), (&6.into(), &16.into()), "{plan}");
    assert!(plan["image"]["estimated_range_s"][1].as_f64().unwrap() > 0.0, "{plan}");
    assert!(!here.join("p.npz").exists());
    let printed = fails(&mut tiles(here, &["w.h5", "-o", "b.h5"]));
    assert!(printed.contains("did you mean b.npz?"), "{printed}");
    let printed = fails(tiles(here, &["w.h5", "-o", "c.npz"]).args(["--heat-sigma", "999"]));
    assert!(printed.contains("0.3 to 50 pixels"), "{printed}");
}
