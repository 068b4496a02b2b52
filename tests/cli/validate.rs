//! `stemgen validate`.

use super::{fails, file, json, stderr, stdout, stemgen};
use ndarray::{Array2, Array3};
use ndarray_npy::WriteNpyExt;
use std::path::Path;
use std::process::Command;

fn reference(name: &str) -> String {
    file(&format!("tests/references/{name}"))
}

/// Compares with a reference, with abTEM's own numerics.
fn against(folder: &Path, image: &str, arguments: &[&str]) -> Command {
    let mut command = stemgen(folder);
    command.args(["validate", "--reference", image, "--structure", &reference("srtio3.xyz")]);
    command.args([
        "--like-abtem",
        "--gpts",
        "200,200",
        "--slice-thickness",
        "1.9525",
        "--overwrite",
    ]);
    command.args(arguments);
    command
}

fn array_npy(path: &Path, array: &Array2<f64>) {
    array.write_npy(std::fs::File::create(path).unwrap()).unwrap();
}

/// The image of `square.npy`, [x, y].
fn square() -> Array2<f64> {
    let array = stemgen::io::arrays::read(Path::new(&reference("square.npy")), None).unwrap();
    array.data.into_dimensionality().unwrap()
}

const HALF_CELL: [&str; 4] = ["--scan-start", "0,0", "--scan-end", "3.905,1.9525"];

#[test]
fn the_suite_runs_without_the_repository() {
    let folder = tempfile::tempdir().unwrap();
    let cases =
        ["--case", "kirkland-5-12", "--case", "abtem-potentials", "--case", "refined-image"];
    let report = json(stemgen(folder.path()).arg("validate").args(cases));
    assert_eq!(report["verdict"], "pass");
    assert_eq!(report["cases"].as_array().unwrap().len(), 3);
    let summary = report["summary"].as_str().unwrap();
    assert!(summary.contains("3 of 3 cases passed"), "{summary}");
    let darkest =
        &report["cases"].as_array().unwrap().iter().find(|c| c["name"] == "kirkland-5-12").unwrap()
            ["checks"][0];
    assert!((darkest["value"].as_f64().unwrap() - 0.72).abs() < 0.01, "{darkest}");
    let page = std::fs::read_to_string(folder.path().join("validation.html")).unwrap();
    for part in
        ["<svg", "data:image/png;base64,", "Kirkland", "refined answer", "fraction of the beam"]
    {
        assert!(page.contains(part), "no `{part}`");
    }
    // nothing from elsewhere
    for foreign in ["src=\"http", "href=\"http", "@import", "<script", "NaN"] {
        assert!(!page.contains(foreign), "`{foreign}`");
    }
    let printed = fails(stemgen(folder.path()).arg("validate").args(cases));
    assert!(
        printed.contains("validation.html: exists") && printed.contains("--overwrite"),
        "{printed}"
    );
}

#[test]
fn cases_are_listed_and_unknown_ones_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run = stemgen(folder.path()).args(["validate", "--list"]).output().unwrap();
    assert!(stdout(&run).contains("slice-boundaries") && stdout(&run).contains("quick"));
    let listed = json(stemgen(folder.path()).args(["validate", "--list", "--quick"]));
    assert!(listed.as_array().unwrap().iter().all(|c| c["quick"] == true));
    let printed = fails(stemgen(folder.path()).args(["validate", "--case", "nonsense"]));
    assert!(printed.contains("nonsense") && printed.contains("kirkland-5-12"), "{printed}");
    let printed = fails(stemgen(folder.path()).args(["validate", "--defocus", "10"]));
    assert!(printed.contains("without a reference"), "{printed}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// Numbers of a comparison that passes.
fn largest(command: &mut Command) -> f64 {
    let report = json(command);
    assert_eq!(report["verdict"], "pass");
    let check = &report["cases"][0]["checks"][0];
    assert!(check["what"].as_str().unwrap().starts_with("largest difference"), "{check}");
    check["value"].as_f64().unwrap()
}

#[test]
fn an_image_of_abtem_is_reproduced() {
    let folder = tempfile::tempdir().unwrap();
    // zarr tells axes and pixels
    let zarr = largest(&mut against(folder.path(), &reference("haadf.zarr"), &[]));
    assert!(zarr < 0.01, "{zarr} %");
    let scan = HALF_CELL;
    let square_npy = reference("square.npy");
    let npy = largest(against(folder.path(), &square_npy, &["--axes", "xy"]).args(scan));
    assert!(npy < 0.01, "{npy} %");
    // the same as a matrix, in other units, in an archive
    let turned = square().t().mapv(|v| 100.0 * v);
    array_npy(&folder.path().join("t.npy"), &turned.as_standard_layout().to_owned());
    let percent = ["--axes", "yx", "--units", "percent"];
    let same = largest(against(folder.path(), "t.npy", &percent).args(scan));
    assert!((same - npy).abs() < 1e-4, "{same} {npy}");
    let fitted =
        largest(against(folder.path(), "t.npy", &["--axes", "yx", "--units", "fitted"]).args(scan));
    assert!(fitted < 0.01, "{fitted}");
}

#[test]
fn a_tiff_of_abtem_tells_its_axes() {
    let folder = tempfile::tempdir().unwrap();
    let error = largest(&mut against(folder.path(), &reference("haadf.tif"), &[]));
    assert!(error < 0.01, "{error} %");
}

#[test]
fn our_own_file_is_reproduced() {
    let folder = tempfile::tempdir().unwrap();
    let options = ["--scan-points", "4,3", "--detector", "ADF=40-90"];
    let structure = reference("srtio3.xyz");
    let mut command = stemgen(folder.path());
    let run =
        command.args(["simulate", &structure, "-o", "s.h5", "--quiet"]).args(options).status();
    assert!(run.unwrap().success());
    let mut command = stemgen(folder.path());
    command.args([
        "validate",
        "--reference",
        "s.h5",
        "--structure",
        &structure,
        "--detector",
        "ADF=40-90",
    ]);
    assert_eq!(largest(&mut command), 0.0);
}

#[test]
fn a_different_image_fails_with_3_and_says_what_may_be_wrong() {
    let folder = tempfile::tempdir().unwrap();
    // transposed, and said to be right
    let image = reference("square.npy");
    let mut command = against(folder.path(), &image, &["--axes", "yx", "--json"]);
    let run = command.args(HALF_CELL).output().unwrap();
    assert_eq!(run.status.code(), Some(3), "{}", stderr(&run));
    let report: serde_json::Value = serde_json::from_str(&stdout(&run)).unwrap();
    assert_eq!(report["verdict"], "fail");
    let note = report["cases"][0]["notes"][0].as_str().unwrap();
    assert!(note.contains("the reference transposed (x and y exchanged) explains"), "{note}");
    let summary = report["summary"].as_str().unwrap();
    let cited = "differs from square.npy (HAADF, 68 to 200 mrad, of srtio3.xyz";
    assert!(summary.contains(cited) && summary.contains("(allowed: at most 1 %)"), "{summary}");
    let page = std::fs::read_to_string(folder.path().join("validation.html")).unwrap();
    assert!(
        page.contains("Colours of the difference end at")
            && page.contains("the largest difference")
    );
    // another microscope
    let mut command =
        against(folder.path(), &image, &["--axes", "xy", "--defocus", "60", "--quiet"]);
    assert_eq!(command.args(HALF_CELL).status().unwrap().code(), Some(3));
}

/// What is wrong most often is tried first, on a few probes.
#[test]
fn a_wrong_setting_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let scan = ["--scan-end", "3.905,3.905", "--scan-points", "6,6", "--detector", "ADF=40-90"];
    let structure = reference("srtio3.xyz");
    let mut simulate = stemgen(folder.path());
    simulate.args(["simulate", &structure, "-o", "s.h5", "--defocus", "60", "--quiet"]);
    assert!(simulate.args(scan).status().unwrap().success());
    let compared = |more: &[&str]| {
        let mut command = stemgen(folder.path());
        command.args(["validate", "--reference", "s.h5", "--structure", &structure]);
        command.args(["--overwrite"]).args(more);
        report_of_a_failure(&mut command)
    };
    let (note, numbers) = compared(&["--detector", "ADF=40-90", "--defocus=-60"]);
    let explained = "defocus 60 A in place of -60 A explains the difference: rms 0.00 %";
    assert!(note.starts_with(explained), "{note}");
    assert!(numbers.iter().any(|(what, _)| what.contains("keV in place of 200 keV, at 24")));
    let wrong = ["--detector", "ADF=40-90", "--defocus", "60", "--energy", "100"];
    let (note, _) = compared(&wrong);
    assert!(note.starts_with("energy 200 keV in place of 100 keV explains"), "{note}");
    let (note, _) = compared(&["--detector", "ADF=80-180", "--defocus", "60"]);
    assert!(note.starts_with("a detector from 40.0 to 90.0 mrad in place of 80"), "{note}");
}

/// Ours with a scan that starts at 0.31, 0.2 A, in abTEM's numerics.
fn moved_scan(folder: &Path) {
    let arguments = ["simulate", &reference("srtio3.xyz"), "-o", "moved.h5", "--quiet"];
    let scan = ["--scan-start", "0.31,0.2", "--scan-end", "4.215,4.105", "--scan-points", "8,8"];
    let numerics = ["--gpts", "200,200", "--slice-thickness", "1.9525"];
    let mut command = stemgen(folder);
    let run = command.args(arguments).args(scan).args(numerics).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
}

/// The note and the numbers of a comparison that fails.
fn report_of_a_failure(command: &mut Command) -> (String, Vec<(String, f64)>) {
    let run = command.arg("--json").output().unwrap();
    assert_eq!(run.status.code(), Some(3), "{}", stderr(&run));
    let report: serde_json::Value = serde_json::from_str(&stdout(&run)).unwrap();
    let case = &report["cases"][0];
    let checks = case["checks"].as_array().unwrap().iter();
    let numbers =
        checks.map(|c| (c["what"].as_str().unwrap().into(), c["value"].as_f64().unwrap()));
    (case["notes"][0].as_str().unwrap().into(), numbers.collect())
}

#[test]
fn a_scan_that_starts_elsewhere_and_a_factor_are_found_and_their_share_is_printed() {
    let folder = tempfile::tempdir().unwrap();
    moved_scan(folder.path());
    let image = stemgen::io::arrays::read(&folder.path().join("moved.h5"), None).unwrap().data;
    let (rows, columns) = (image.shape()[1], image.shape()[2]);
    let image: Array2<f64> = image.into_shape_with_order((rows, columns)).unwrap();
    array_npy(&folder.path().join("moved.npy"), &image);
    let ours = |file: &str, more: &[&str]| {
        let mut command = stemgen(folder.path());
        command.args(["validate", "--reference", file, "--structure", &reference("srtio3.xyz")]);
        command.args(["--gpts", "200,200", "--slice-thickness", "1.9525", "--overwrite"]);
        command.args(["--axes", "yx", "--tolerance", "0.1"]).args(more);
        command
    };
    let wrong = ["--scan-start", "0,0", "--scan-end", "3.905,3.905"];
    let (note, numbers) = report_of_a_failure(&mut ours("moved.npy", &wrong));
    assert!(note.contains("a scan that starts 0.3") && note.contains("explains"), "{note}");
    let (what, left) = numbers.iter().find(|(what, _)| what.contains("simulated")).unwrap();
    // 0.78 % where it was written; the grid moves against the atoms with the scan
    assert!(*left < 1.2, "{what}: {left} % of {note}");
    let rms = numbers.iter().find(|(what, _)| what.starts_with("rms difference, of")).unwrap().1;
    assert!(rms > 20.0 * left, "{rms} {left}");
    // the right start, with the pixels by their step
    let right = ["--scan-start", "0.31,0.2", "--scan-step", "0.488125"];
    assert!(largest(&mut ours("moved.npy", &right)) < 1e-3);
    array_npy(&folder.path().join("bright.npy"), &(image * 1.25));
    let right = ["--scan-start", "0.31,0.2", "--scan-end", "4.215,4.105"];
    let (note, _) = report_of_a_failure(&mut ours("bright.npy", &right));
    assert!(note.starts_with("the reference times 0.8000 explains"), "{note}");
}

#[test]
fn a_start_is_enough_where_the_file_tells_the_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let zarr = reference("haadf.zarr");
    let report =
        json(against(folder.path(), &zarr, &["--scan-start", "3.905,0"]).args(["-o", "one.html"]));
    // one period further on
    assert_eq!(report["verdict"], "pass");
    let settings = report["cases"][0]["settings"].as_array().unwrap();
    let value = |name: &str| {
        let row = settings.iter().find(|s| s["name"] == name).unwrap();
        row["value"].as_str().unwrap().to_owned()
    };
    assert!(value("probes").contains("from 3.905, 0.000 A"), "{settings:?}");
    assert_eq!(value("beam"), "200 keV, 21 mrad, defocus 0.97625 A");
    let summary = report["summary"].as_str().unwrap();
    assert!(summary.contains("agrees with haadf.zarr") && !summary.contains("cases"), "{summary}");
    let page = std::fs::read_to_string(folder.path().join("one.html")).unwrap();
    assert!(page.contains("<td>wave grid</td>") && !page.contains("energy_ev"), "no table");
    assert!(page.contains("the limit, 1.000 % of the maximum"), "no scale");
}

#[test]
fn nothing_is_guessed_and_bad_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    let mut nan = square();
    nan[[2, 3]] = f64::NAN;
    array_npy(&f.join("nan.npy"), &nan);
    let stack = Array3::<f64>::zeros((3, 4, 5));
    stack.write_npy(std::fs::File::create(f.join("stack.npy")).unwrap()).unwrap();
    std::fs::write(f.join("text.npy"), "1 2 3").unwrap();
    std::fs::write(f.join("text.h5"), "1 2 3").unwrap();
    std::fs::write(f.join("text.tif"), "1 2 3").unwrap();
    std::fs::create_dir(f.join("empty.zarr")).unwrap();
    let (square, zarr) = (reference("square.npy"), reference("haadf.zarr"));
    let xy = ["--axes", "xy"];
    let bad: &[(&str, &[&str], &str)] = &[
        (&square, &[], "--axes xy or --axes yx"),
        (
            &square,
            &["--axes", "xy", "--scan-points", "5,7"],
            "5 x 5 pixels (x, y), but the scan has 5 x 7",
        ),
        (&square, &xy, "give --scan-start X,Y and --scan-end X,Y"),
        (&square, &["--axes", "xy", "--scan-end", "1,1"], "give --scan-start X,Y, as in"),
        (&square, &["--axes", "xy", "--scan-start", "1,1"], "give --scan-end X,Y, or --scan-step"),
        (&zarr, &["--axes", "yx"], "names its axes x, y"),
        (&zarr, &["--energy", "300"], "200 keV"),
        (&zarr, &["--scan-end", "1,1"], "pixels of 0.6508 x 0.976"),
        (&zarr, &["--dataset", "image"], "array0"),
        (&zarr, &["--detector", "BF=0-20", "--detector", "ADF=30-60"], "2 detectors"),
        (&zarr, &["--tolerance", "0"], "--tolerance 0"),
        ("nan.npy", &xy, "NaN at index [2, 3]"),
        ("stack.npy", &xy, "its index has 1 number from 0, below 3"),
        ("stack.npy", &["--axes", "xy", "--index", "3"], "index 3 is too large"),
        ("text.npy", &xy, "no NumPy array"),
        ("text.h5", &[], "not HDF5"),
        ("text.tif", &[], "no readable TIFF"),
        ("empty.zarr", &[], "no zarr"),
        ("none.npy", &[], "none.npy: cannot read"),
        (&reference("srtio3.xyz"), &[], "expected .npy"),
    ];
    for (image, arguments, expected) in bad {
        let printed = fails(&mut against(f, image, arguments));
        assert!(printed.contains(expected), "{image} {arguments:?}: no `{expected}` in\n{printed}");
        let name = Path::new(image).file_name().unwrap().to_str().unwrap();
        let of_the_file = !["--tolerance 0", "2 detectors"].contains(expected);
        assert!(!of_the_file || printed.contains(name), "{name} is not named: {printed}");
        if expected.contains("index ") && !expected.contains("NaN") {
            assert!(printed.contains("hint: see --index"), "{printed}");
        }
    }
    assert!(!f.join("validation.html").exists());
}
