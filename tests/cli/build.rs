//! `stemgen build`.

use super::points::{Point, can_trace, meets};
use super::{fails, file, json, python, stderr, stdout, stemgen};
use std::path::Path;
use std::process::Command;

fn tiny(folder: &Path) -> Command {
    let mut command = stemgen(folder);
    command.args(["build", "--recipe", &file("tests/cli/tiny.toml")]);
    command
}

/// Small sub-tiles, so that there are many.
const SUBTILES: [&str; 4] = ["--subtile", "0.6", "--subtile-overlap", "0.1"];

#[test]
fn a_world_is_built_with_its_picture() {
    let folder = tempfile::tempdir().unwrap();
    let printed = fails(tiny(folder.path()).args(["--seed", "9223372036854775808"]));
    assert!(printed.contains("at most 9223372036854775807"), "{printed}");
    let run = tiny(folder.path()).args(["--seed", "7", "--keep-clean"]).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let printed = stdout(&run);
    let names = ["worlds/tiny_seed7.h5", "worlds/tiny_seed7.png"];
    for part in names.into_iter().chain(["2 x 2: 28 x 28 pixels", "window, 1 sub-tile"]) {
        assert!(printed.contains(part), "{part}: {printed}");
    }
    let digest = python("digest.py", &[&folder.path().join("worlds/tiny_seed7.h5")]);
    for part in ["clean/1_1 (16, 16) float32", "ground_truth/atom_positions", "overview"] {
        assert!(digest.contains(part), "{digest}");
    }
    let again = tiny(folder.path()).args(["--seed", "7"]).output().unwrap();
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr(&again).contains("--overwrite"), "{}", stderr(&again));
    let summary = json(tiny(folder.path()).args(["--overwrite", "--no-noise", "--quiet"]));
    assert_eq!(summary["dose_electrons_per_angstrom2"], serde_json::Value::Null);
}

/// The world's image as HyperSpy reads it: as in the world file, in fractions of the beam.
#[test]
fn a_world_is_written_for_hyperspy_too() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = tiny(folder.path());
    command.args(["--keep-clean", "--hspy", "--no-png", "-o", "w.h5"]);
    let printed = stdout(&command.output().unwrap());
    assert!(printed.contains("w.hspy"), "{printed}");
    let printed = python("check_world_hspy.py", &[&folder.path().join("w.h5")]);
    assert_eq!(printed, "HAADF, HAADF_clean\n");
    // what is there is kept
    let mut again = tiny(folder.path());
    let message = fails(again.args(["--hspy", "--no-png", "-o", "w.h5", "--seed", "9"]));
    assert!(message.contains("--overwrite"), "{message}");
}

#[test]
fn the_library_builds_the_same_file() {
    use stemgen::imaging::Cache;
    use stemgen::recipe::CheckedRecipe;
    use stemgen::world::{BuildMethod, BuildOptions, build};
    let folder = tempfile::tempdir().unwrap();
    let recipe = CheckedRecipe::from_file(Path::new(&file("tests/cli/tiny.toml")), None).unwrap();
    let cases = [
        ("plain", &[][..], BuildMethod::Auto),
        ("mosaic", &["--engine", "mosaic"], BuildMethod::Mosaic),
        ("prism", &["--engine", "prism"], BuildMethod::Prism),
    ];
    for (name, arguments, method) in cases {
        let cache = folder.path().join("cache");
        let mut command = tiny(folder.path());
        command.args(["--no-png", "-o", "cli.h5", "--overwrite"]).args(arguments);
        let run = command.env("STEMGEN_CACHE", &cache).output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        let path = folder.path().join("library.h5");
        let cache = Cache::at(cache);
        let options = BuildOptions { method, cache, overwrite: true, ..BuildOptions::default() };
        build(&recipe, &path, &options, &stemgen::progress::Silent).unwrap();
        let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
        assert!(read("cli.h5") == read("library.h5"), "{name}: the files differ");
    }
}

#[test]
fn a_largest_error_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let limited = |limit: &str, name: &str| {
        let mut command = tiny(here);
        command.env("STEMGEN_CACHE", here.join("cache"));
        command.args(["--max-error", limit, "--no-png", "-o", name]);
        command
    };
    let run = limited("20%", "good.h5").output().unwrap();
    let printed = stdout(&run);
    assert!(run.status.success(), "{}", stderr(&run));
    assert!(
        printed.contains("rms at bright columns") && printed.contains("multislice"),
        "{printed}"
    );
    // Windows are held to it as well, and to an error of the mean image.
    let windows = json(limited("20%", "windows.h5").args(["--quiet", "--engine", "window"]));
    let regions = windows["audit"]["regions"].as_array().unwrap().len();
    assert!(windows["engine"] == "window" && regions >= 4, "{windows}");
    for error in ["bright_rms_percent", "all_rms_percent"] {
        assert!((0.0..20.0).contains(&windows["audit"][error].as_f64().unwrap()), "{windows}");
    }
    let mut command = tiny(here);
    command.args(["--accuracy", "5", "--engine", "window", "--no-png", "-o", "mean.h5", "--quiet"]);
    let found = json(&mut command)["audit"]["mean_rms_percent"].as_f64().unwrap();
    assert!((0.0..=5.0).contains(&found), "{found}");
    // Where no window is so right, the exact engine, said beforehand with its time.
    let mut exact = limited("0.001%", "exact.h5");
    let run = exact.arg("--json").output().unwrap();
    let printed = stderr(&run);
    for part in [
        "at most 0.001 % was asked for",
        "the exact engine simulates the whole field, which needs about",
    ] {
        assert!(printed.contains(part), "no `{part}` in\n{printed}");
    }
    assert!(
        stdout(&run).contains("\"engine\":\"multislice\"")
            || stdout(&run).contains("\"engine\": \"multislice\"")
    );
    let printed = fails(limited("20%", "impossible.h5").args(["--audit", "0"]));
    for part in ["largest error (%) = 20: needs an audit of at least one region", "--audit"] {
        assert!(printed.contains(part), "no `{part}` in\n{printed}");
    }
    let mut written = std::fs::read_dir(here).unwrap().map(|e| e.unwrap().file_name());
    assert!(written.all(|n| !n.to_string_lossy().starts_with("impossible")));
}

/// The example of worlds/README.md reads what the formulas there say.
#[test]
fn the_example_of_the_readme_reads_a_world() {
    let folder = tempfile::tempdir().unwrap();
    let built = json(tiny(folder.path()).args(["--no-png", "-o", "w.h5"]));
    let printed = python("../../worlds/example.py", &[&folder.path().join("w.h5")]);
    let lines: Vec<&str> = printed.lines().collect();
    assert!(lines[0].starts_with("28 x 28 pixels, "), "{printed}");
    let columns = format!("{} columns, {} vacant sites", built["columns"], built["vacancies"]);
    assert_eq!(lines[1], columns);
    let electrons: u64 =
        lines[0].trim_end_matches(" electrons").rsplit(' ').next().unwrap().parse().unwrap();
    let world = stemgen::io::WorldFile::open(&folder.path().join("w.h5")).unwrap();
    // 1e5 electrons fall on a square Angstrom, 25 000 on a pixel
    let mean = world.stitched(0..28, 0..28).unwrap().mapv(f64::from).sum();
    let file = hdf5::File::open(folder.path().join("w.h5")).unwrap();
    let scale = |name: &str| -> f64 {
        file.group("tiles").unwrap().attr(name).unwrap().read_scalar().unwrap()
    };
    let expected = (mean * scale("scale") + 784.0 * scale("offset")) * 25_000.0;
    assert!((electrons as f64 - expected).abs() < 400.0, "{electrons} {expected}");
}

#[test]
fn threads_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    for (name, threads) in [("one.h5", "1"), ("two.h5", "2")] {
        let mut command = tiny(folder.path());
        let run = command.args(SUBTILES).args(["-o", name, "--threads", threads]).output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
    }
    let digest = |name: &str| python("digest.py", &[&folder.path().join(name)]);
    assert_eq!(digest("one.h5"), digest("two.h5"));
}

#[test]
fn an_audit_takes_the_settings_of_the_world() {
    let folder = tempfile::tempdir().unwrap();
    let run = tiny(folder.path()).args(["--window", "5.9"]).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let audit = |arguments: &[&str]| {
        let mut command = stemgen(folder.path());
        command.args(["audit", "worlds/tiny.h5", "--size", "0.6"]).args(arguments);
        command
    };
    let found = json(&mut audit(&["--regions", "1"]));
    assert_eq!(
        (&found["engine"], &found["window_angstrom"]),
        (&"window".into(), &5.9.into()),
        "{found}"
    );
    let error = found["all_rms_percent"].as_f64().unwrap();
    assert!(error > 0.0 && error < 3.0, "{found}");
    let refused = fails(&mut audit(&["--seed", "3"]));
    assert!(refused.contains("a world has its recipe"), "{refused}");
    // An error above what is allowed is said, also if nothing else is, and has an exit code of its own.
    for (limit, code) in [("99", 0), ("0.0001", 3)] {
        let mut command = audit(&["--regions", "1", "--quiet", "--max-error", limit]);
        let run = command.output().unwrap();
        let printed = stderr(&run);
        assert_eq!(
            (run.status.code(), stdout(&run).as_str()),
            (Some(code), ""),
            "{limit}: {printed}"
        );
        assert_eq!(
            printed.contains("warning: the audit: far off"),
            code == 3,
            "{limit}: {printed}"
        );
        assert!(code == 0 || printed.contains("at most 0.0001 % are allowed"), "{printed}");
    }
}

#[test]
fn a_dry_run_prints_the_plan() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stemgen(folder.path());
    command.args(["build", "srtio3", "--difficulty", "easy", "--grid", "2x2", "--dry-run"]);
    let plan = json(&mut command);
    assert_eq!((&plan["tiles"], &plan["subtiles"]), (&serde_json::json!([2, 2]), &1.into()));
    assert_eq!((&plan["slices"]["count"], &plan["configurations"]), (&52.into(), &4.into()));
    assert!(plan["memory_bytes"].as_f64().unwrap() < 2e9 * plan["threads"].as_f64().unwrap());
    assert_eq!(plan["output"], "worlds/srtio3_easy_2x2.h5");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn the_plan_of_a_mosaic_lists_what_is_new_and_what_the_audit_takes() {
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("cache");
    let mosaic = |arguments: &[&str]| {
        let mut command = tiny(folder.path());
        command.env("STEMGEN_CACHE", &cache).args(["--engine", "mosaic"]).args(arguments);
        command
    };
    let plan = json(mosaic(&["--dry-run"]).arg("--quiet"));
    let why = plan["mosaic"]["new"][0]["why"].as_str().unwrap();
    assert_eq!(why, "no image of this material is kept");
    assert_eq!(plan["mosaic"]["new"][0]["images"], plan["mosaic"]["images"]);
    assert!(plan["audit_range_s"][1].as_f64().unwrap() > 0.0, "{plan}");
    assert!(mosaic(&["--no-png", "--audit", "0"]).status().unwrap().success());
    // The same library cells, each in one configuration more: half of what is needed is there.
    let more = ["--dry-run", "--set", "phonons.configurations=2", "--audit", "0"];
    let plan = json(mosaic(&more).arg("--quiet"));
    assert_eq!((&plan["configurations"], &plan["audit_range_s"][1]), (&2.into(), &0.0.into()));
    let [images, missing] = ["images", "missing"].map(|k| plan["mosaic"][k].as_u64().unwrap());
    assert!(missing > 0 && missing <= images.div_ceil(2), "{plan}");
    let text = stdout(&mosaic(&more).output().unwrap());
    assert!(text.contains("more contents or phonon configurations"), "{text}");
    assert!(text.contains("nm thick") && !text.contains("recorded at"), "{text}");
}

#[test]
fn a_world_of_windows_is_audited_if_asked() {
    let folder = tempfile::tempdir().unwrap();
    let built = json(tiny(folder.path()).args(["--audit", "1", "--no-png"]));
    assert_eq!((&built["engine"], &built["audit"]["engine"]), (&"window".into(), &"window".into()));
    let world = stemgen::io::WorldFile::open(&folder.path().join("worlds/tiny.h5"));
    assert!(world.is_ok());
}

#[test]
fn every_method_has_fitting_defaults() {
    let folder = tempfile::tempdir().unwrap();
    let methods: [&[&str]; 7] = [
        &["--engine", "prism"],
        &["--engine", "multislice"],
        &["--engine", "window", "--window", "9"],
        &["--interpolation", "2,3"],
        &["--subtile", "2"],
        &["--profile", "default"],
        &["--profile", "published"],
    ];
    for method in methods {
        let mut command = stemgen(folder.path());
        command.args(["build", "srtio3", "--difficulty", "hard", "--dry-run"]).args(method);
        let plan = json(&mut command);
        assert!(plan["estimated_time_s"].as_f64().unwrap() > 0.0, "{method:?}");
    }
}

#[cfg(unix)]
#[test]
fn an_interrupted_build_leaves_no_file_and_goes_on() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let recipe = file("tests/cli/tiny.toml");
    let arguments = [&["build", "--recipe", &recipe, "-o", "w.h5"][..], &SUBTILES].concat();
    let first = folder.path().join("w.h5.work/subtile_000000.bin");
    let point = Point::on("a sub-tile is written", "renameat", "w.h5.work/subtile_000000.bin");
    let stopped = meets(stemgen(folder.path()).args(&arguments), point, "signal=SIGTERM");
    let printed = stderr(&stopped);
    assert_eq!(stopped.status.code(), Some(143), "{printed}");
    assert!(
        printed.contains("error: interrupted")
            && printed.contains("repeat the command to continue"),
        "{printed}"
    );
    assert!(!folder.path().join("w.h5").exists() && first.exists());
    let other = fails(stemgen(folder.path()).args(&arguments).args(["--seed", "6"]));
    assert!(other.contains("now seed = 6") && first.exists(), "{other}");
    let summary = json(stemgen(folder.path()).args(&arguments));
    assert!(summary["subtiles_resumed"].as_u64().unwrap() >= 1, "{summary}");
    assert!(folder.path().join("w.h5").exists() && !folder.path().join("w.h5.work").exists());
}
