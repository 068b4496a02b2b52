//! `stemgen view --html`, of worlds and of patterns, and `stemgen simulate --html`, used in headless Chromium by the scripts in
//! `tests/browser`, which compare what the pages say with the files.
//!
//! Without Chromium and chromedriver these tests say that they are skipped; with
//! `STEMGEN_REQUIRE_BROWSER` set they fail.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use crate::common::{Spots, build};
use crate::skipped::skipped;
use stemgen::progress::Silent;
use stemgen::recipe::{Difficulty, Recipe};
use stemgen::world::BuildOptions;

/// A file of this repository.
fn file(name: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join(name)
}

/// Whether there is a browser.
fn browser() -> bool {
    let script = file("tests/browser/webdriver.py");
    let run = std::process::Command::new(crate::python::with_h5py()).arg(script).output().unwrap();
    if run.status.success() {
        return true;
    }
    let printed = String::from_utf8_lossy(&run.stdout).trim().to_owned();
    let required = std::env::var_os("STEMGEN_REQUIRE_BROWSER").is_some();
    assert!(!required, "{printed}: apt-get install chromium chromium-driver");
    skipped(&format!("the page was not opened: {printed}"));
    false
}

fn check(script: &str, arguments: &[impl AsRef<OsStr>]) {
    if !browser() {
        return;
    }
    let script = file(&format!("tests/browser/{script}"));
    let run = std::process::Command::new(crate::python::with_h5py())
        .arg(script)
        .args(arguments)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&run.stdout) + String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{text}");
}

fn stemgen(folder: &Path, arguments: &[&str]) {
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_stemgen"));
    let run = command.current_dir(folder).args(arguments).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
}

/// Builds a world with a stand-in for the engine, makes its page and explores it. World, page and a
/// screenshot stay in `$STEMGEN_LOOK`, if that is set.
fn explore(recipe: &Recipe, sigma: f64) {
    let temporary = tempfile::tempdir().unwrap();
    let look = std::env::var_os("STEMGEN_LOOK").map(|look| Path::new(&look).join(&recipe.id));
    let folder = look.as_deref().unwrap_or(temporary.path());
    std::fs::create_dir_all(folder).unwrap();
    let world = folder.join("world.h5");
    let options = BuildOptions { keep_clean: true, overwrite: true, ..BuildOptions::default() };
    build(recipe, &Spots { sigma, ..Spots::new() }, &world, &options, &Silent).unwrap();
    stemgen(folder, &["view", "world.h5", "--html", "--overwrite", "--quiet"]);
    let page = folder.join("world.html");
    check("check_world.py", &[page.as_path(), &world, folder]);
    let text = std::fs::read(&page).unwrap();
    let cut = folder.join("cut.html");
    std::fs::write(&cut, &text[..text.len() * 3 / 5]).unwrap();
    check("check_cut.py", &[&cut]);
}

/// InGaN: wells, substitutions, more than one tile of the pyramid.
#[test]
#[ignore = "long"]
fn the_page_of_wells_says_what_the_file_says() {
    let recipe = Recipe::load("gan", Difficulty::Easy).unwrap().with_grid(4, 5).unwrap();
    explore(&recipe, 0.5);
}

/// Platinum on carbon: particles, vacancies, columns without order.
#[test]
fn the_page_of_particles_says_what_the_file_says() {
    explore(&particles(), 0.3);
}

#[test]
fn a_page_opens_as_the_options_say() {
    let folder = tempfile::tempdir().unwrap();
    let world = folder.path().join("world.h5");
    let options = BuildOptions::default();
    build(&particles(), &Spots::new(), &world, &options, &Silent).unwrap();
    let wanted = [
        ["--region", "3.5,0.5,5.5,2.5"],
        ["--colormap", "viridis"],
        ["--contrast", "1,99"],
        ["--overlay", "defects,particles"],
    ];
    let mut arguments = vec!["view", "world.h5", "--html", "--quiet"];
    arguments.extend(wanted.iter().flatten());
    stemgen(folder.path(), &arguments);
    let page = folder.path().join("world.html");
    let values = wanted.iter().map(|[_, value]| OsStr::new(value));
    check("check_start.py", &[page.as_os_str()].into_iter().chain(values).collect::<Vec<_>>());
}

/// A field of 6 nm with one particle.
fn particles() -> Recipe {
    let mut recipe = Recipe::load("pt", Difficulty::Easy).unwrap();
    recipe.field.fov_nm = [6.0, 6.0];
    recipe.field.grid = [4, 4];
    recipe.field.thickness_nm = 1.0;
    let particles = recipe.particles.as_mut().unwrap();
    particles.count = 1;
    particles.diameter_nm = [2.5, 3.0];
    recipe
}

#[test]
fn the_page_of_simulated_images_says_what_the_file_says() {
    let folder = tempfile::tempdir().unwrap();
    let structure = file("structures/si.cif").display().to_string();
    let arguments = [
        "simulate",
        &structure,
        "--scan-end=2.7155,5.431",
        "--sampling=0.1",
        "--thicknesses=2.7,5.431",
        "--detector=ADF=40-80",
        "--detector=BF=0-10",
        "--html",
        "--quiet",
    ];
    stemgen(folder.path(), &arguments);
    check("check_images.py", &[&folder.path().join("si.html"), &folder.path().join("si.h5")]);
}

#[test]
fn the_page_of_a_recording_says_what_the_file_says() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = file("tests/cli/tiny.toml").display().to_string();
    let how = "--no-cache --dose 1e4 --frames 2 --keep-frames -o r.h5 --quiet".split(' ');
    let arguments: Vec<&str> = ["acquire", &recipe].into_iter().chain(how).collect();
    stemgen(folder.path(), &arguments);
    stemgen(folder.path(), &["view", "r.h5", "--html", "--quiet"]);
    check("check_recording.py", &[&folder.path().join("r.html"), &folder.path().join("r.h5")]);
    // One frame is a page too.
    stemgen(folder.path(), &["view", "r.h5", "--html", "--index", "0", "-o", "one.html"]);
    let page = std::fs::read_to_string(folder.path().join("one.html")).unwrap();
    assert!(page.contains(r#""number":0"#) && !page.contains(r#""number":1"#));
}

#[test]
fn the_page_of_patterns_says_what_the_files_say() {
    let temporary = tempfile::tempdir().unwrap();
    let look = std::env::var_os("STEMGEN_LOOK").map(|look| Path::new(&look).join("patterns"));
    let folder = look.as_deref().unwrap_or(temporary.path());
    std::fs::create_dir_all(folder).unwrap();
    let structure = file("structures/si.cif").display().to_string();
    let scan = "--repeat=4,4,2 --scan-start=8,8 --scan-end=10,9.5 --scan-points=4,3";
    let detector = "--pixels=24 --max-angle=50 --overwrite --quiet";
    let made = |name: &str, more: &[&str]| {
        let mut arguments = vec!["patterns", &structure, "-o", name];
        arguments.extend(scan.split(' ').chain(detector.split(' ')).chain(more.iter().copied()));
        stemgen(folder, &arguments);
    };
    made("si.emd", &[]);
    let images = ["--annulus=ring=15-32.5", "--com", "--overwrite", "--quiet"];
    stemgen(folder, &[&["integrate", "si.emd"], &images[..]].concat());
    stemgen(folder, &["view", "si.emd", "--html", "--overwrite", "--quiet"]);
    let page = folder.join("si.html");
    let mut files = vec![page.clone(), folder.join("si.emd"), folder.join("si_images.h5")];
    files.extend(look.iter().map(|look| look.join("si.png")));
    check("check_patterns.py", &files);
    let text = std::fs::read_to_string(&page).unwrap();
    let cut = folder.join("cut.html");
    std::fs::write(&cut, text.split_once("id=\"b2\"").unwrap().0).unwrap();
    check("check_cut.py", &[&cut]);
    // Counted electrons are kept as they are.
    made("counts.emd", &["--dose=1e4"]);
    stemgen(folder, &["view", "counts.emd", "--html", "--overwrite", "--quiet"]);
    let text = std::fs::read_to_string(folder.join("counts.html")).unwrap();
    assert!(text.contains("\"square\":false") && text.contains("\"scale\":1.0"));
    stemgen(folder, &["view", "counts.emd", "-o", "mean.png", "--overwrite", "--quiet"]);
    assert!(std::fs::metadata(folder.join("mean.png")).unwrap().len() > 1000);
}

/// Builds `MATERIAL_full.h5`, the whole field of `$STEMGEN_MATERIAL` with a stand-in for the engine,
/// in `$STEMGEN_LOOK`, to measure pages with (`benches/page.py`).
#[test]
#[ignore = "makes a large file to measure with"]
fn a_world_of_full_size() {
    let folder = std::env::var_os("STEMGEN_LOOK").expect("STEMGEN_LOOK names a folder");
    let material = std::env::var("STEMGEN_MATERIAL").unwrap_or_else(|_| "srtio3".into());
    let recipe = Recipe::load(&material, Difficulty::Easy).unwrap();
    let options = BuildOptions { keep_clean: true, overwrite: true, ..BuildOptions::default() };
    let path = Path::new(&folder).join(format!("{material}_full.h5"));
    build(&recipe, &Spots::new(), &path, &options, &Silent).unwrap();
}
