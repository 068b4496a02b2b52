//! `stemgen simulate`.

use super::{fails, file, json, python, stderr, stdout, stemgen};
use std::path::Path;
use std::process::Command;

/// A small, quick simulation of silicon.
fn silicon(folder: &Path) -> Command {
    let mut command = stemgen(folder);
    command.arg("simulate").arg(file("structures/si.cif"));
    command.args(["--scan-end", "2.7155,2.7155", "--sampling", "0.1", "--quiet"]);
    command.args(["--detector", "ADF=40-80", "--detector", "BF=0-10"]);
    command
}

#[test]
fn files_are_read_by_h5py() {
    let folder = tempfile::tempdir().unwrap();
    let run =
        silicon(folder.path()).args(["--png", "--thicknesses", "2.7,5.431"]).output().unwrap();
    assert!(run.status.success() && stdout(&run).is_empty(), "{}", stderr(&run));
    let printed = python("check_images.py", &[&folder.path().join("si.h5")]);
    assert_eq!(printed, "ADF 2 10 10\nBF 2 10 10\n");
    let mut names: Vec<String> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let pictures = ["si_ADF_2.7A.png", "si_ADF_5.4A.png", "si_BF_2.7A.png", "si_BF_5.4A.png"];
    assert_eq!(names, [&["si.h5"], &pictures[..]].concat());
}

#[test]
fn every_algorithm_runs_and_threads_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let phonons = ["--phonons", "2", "--sigma", "Si=0.08", "--repeat", "2,2,1"];
    for algorithm in ["multislice", "prism", "window"] {
        let mut digests = Vec::new();
        for threads in ["1", "2"] {
            let name = format!("{algorithm}{threads}.h5");
            let mut command = silicon(folder.path());
            command.args(["--algorithm", algorithm, "--threads", threads, "-o", &name]);
            let run = command.args(phonons).output().unwrap();
            assert!(run.status.success(), "{}", stderr(&run));
            digests.push(python("digest.py", &[&path(&name)]));
        }
        assert_eq!(digests[0], digests[1], "{algorithm}");
        assert!(digests[0].contains("images/ADF (1, 10, 10) float32"), "{}", digests[0]);
    }
}

#[test]
fn exit_waves_of_probes_are_a_numpy_array() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = silicon(folder.path());
    command.args([
        "--scan-points",
        "3,2",
        "--defocus",
        "0:50:50",
        "--phonons",
        "2",
        "--sigma",
        "0.08",
    ]);
    let summary = json(command.args(["--exit-waves"]));
    assert!(summary["exit_waves"].as_str().unwrap().ends_with("si_exit_waves.npy"), "{summary}");
    let printed = python("check_waves.py", &[&folder.path().join("si_exit_waves.npy")]);
    assert_eq!(printed, "complex64 (2, 2, 2, 3, 1, 60, 60)\n");
    let wrong =
        silicon(folder.path()).args(["--exit-waves", "--engine", "window"]).output().unwrap();
    assert!(!wrong.status.success() && stderr(&wrong).contains("full grid"), "{}", stderr(&wrong));
}

#[test]
fn plane_waves_give_exit_wave_and_image() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stemgen(folder.path());
    command.arg("simulate").arg(file("structures/si.cif"));
    command.args(["--plane-wave", "--defocus", "-60.5", "--sampling", "0.1", "--png"]);
    let summary = json(command.args(["--phonons", "2", "--sigma", "0.08"]));
    assert_eq!(summary["images"][0]["name"], "lens");
    let printed = python("check_images.py", &[&folder.path().join("si.h5")]);
    assert!(printed.starts_with("lens 1 "), "{printed}");
    assert!(folder.path().join("si_lens.png").exists());
}

#[test]
fn a_dry_run_prints_the_numbers_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stemgen(folder.path());
    command.arg("simulate").arg(file("structures/srtio3.cif"));
    let plan = json(command.args(["--repeat", "5,5,10", "--dry-run"]));
    assert_eq!(plan["wave_grid"]["points"], serde_json::json!([480, 480]));
    assert_eq!(plan["potential_grid"]["points"], serde_json::json!([480, 480]));
    let number = |key: &str| plan[key].as_f64().unwrap();
    assert!((number("wavelength_angstrom") - 0.025079).abs() < 1e-6);
    // 0.8 wavelength / (2 pixel), with pixels of 19.525 A / 480
    assert!((number("band_limit_mrad") - 246.6).abs() < 0.1, "{}", plan["band_limit_mrad"]);
    assert_eq!(plan["slices"]["count"], 20);
    let thickest = plan["slices"]["thickest_angstrom"].as_f64().unwrap();
    assert!((thickest - 1.9525).abs() < 1e-9, "{thickest}");
    assert_eq!((&plan["atoms"], &plan["composition"]["O"]), (&1250.into(), &750.into()));
    // a step of at most 0.2986 A in 19.525 A
    assert_eq!((&plan["scan"]["rows"], &plan["probes"]), (&66.into(), &(66 * 66).into()));
    assert_eq!((&plan["beams"], &plan["configurations"]), (&0.into(), &1.into()));
    assert!(number("memory_bytes") > 50e6 && number("memory_bytes") < 500e6);
    let [least, most] = [0, 1].map(|k| plan["estimated_range_s"][k].as_f64().unwrap());
    let middle = number("estimated_time_s");
    assert!(0.0 < least && least < middle && middle < most, "{least} {middle} {most}");
    assert_eq!(plan["warnings"], serde_json::json!([]));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn crystals_are_turned_and_repeated() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stemgen(folder.path());
    command.arg("simulate").arg(file("structures/si.cif"));
    command.args(["--zone", "-1,1,0", "--repeat", "1,1,3", "--dry-run", "--algorithm", "prism"]);
    let plan = json(&mut command);
    let size: Vec<f64> =
        plan["box_angstrom"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert!((size[2] - 3.0 * 5.431 * 2.0_f64.sqrt()).abs() < 1e-3, "{size:?}");
    assert!(plan["beams"].as_u64().unwrap() > 10);
    assert!(plan["warnings"][0].as_str().unwrap().contains("--repeat"), "{}", plan["warnings"]);
}

#[test]
fn series_source_dose_and_formats() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stemgen(folder.path());
    command.arg("simulate").arg(file("structures/si.cif"));
    command.args(["--repeat", "2,2,1", "--scan-end", "5.431,5.431", "--sampling", "0.1"]);
    command.args(["--detector", "ADF=40-80", "--defocus", "0:50:50", "--source-size", "0.8"]);
    command.args(["--dose", "1e6", "--seed", "7", "--tiff", "16", "--hspy", "--png"]);
    let summary = json(command.args(["--no-scale-bar", "--quiet"]));
    assert!(summary["images"][0]["electrons"].as_u64().unwrap() > 1000, "{summary}");
    let printed = python("check_results.py", &[&folder.path().join("si.h5")]);
    assert_eq!(printed, "4 images\n");
    for name in ["ADF.tif", "ADF_noisy.tif", "ADF_defocus_0A.png", "ADF_defocus_50A_noisy.png"] {
        assert!(folder.path().join(format!("si_{name}")).exists(), "{name}");
    }
    // The images of the series have one grey scale, those with noise another.
    let scales = summary["grey_scales"].as_array().unwrap();
    let of = |n: usize| &scales[n]["grey_from_to"];
    assert_eq!(scales.len(), 4, "{summary}");
    assert_eq!((of(0), of(2)), (of(1), of(3)), "{summary}");
    assert!(scales.iter().any(|s| s["clipped_percent"].as_f64().unwrap() > 0.0), "{summary}");
    let stack = tiff_description(&folder.path().join("si_ADF.tif"));
    for part in ["images=2\nslices=2\nspacing=50\n", "axes=defocus,y,x\ndefocus_angstrom=0,50\n"] {
        assert!(stack.contains(part), "no `{part}` in {stack}");
    }
}

/// The first text that begins as those that ImageJ reads.
fn tiff_description(path: &Path) -> String {
    let bytes = std::fs::read(path).unwrap();
    let start = bytes.windows(7).position(|w| w == b"ImageJ=").unwrap();
    let text = bytes[start..].split(|b| *b == 0).next().unwrap();
    String::from_utf8(text.to_vec()).unwrap()
}

/// NeXus readers get an image as an image: no axis has one value.
#[test]
fn one_image_has_two_axes_for_readers_of_nexus() {
    let folder = tempfile::tempdir().unwrap();
    let run = silicon(folder.path()).args(["--png", "--grey-bar"]).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let file = hdf5::File::open(folder.path().join("si.h5")).unwrap();
    let (stored, shown) = (file.dataset("images/ADF"), file.dataset("entry/ADF/data"));
    let (stored, shown) = (stored.unwrap(), shown.unwrap());
    assert_eq!((stored.shape(), shown.shape()), (vec![1, 10, 10], vec![10, 10]));
    assert_eq!(stored.read_raw::<f32>().unwrap(), shown.read_raw::<f32>().unwrap());
    let bars = std::fs::read(folder.path().join("si_ADF.png")).unwrap();
    let plain = silicon(folder.path()).args(["--png", "--overwrite"]).output().unwrap();
    assert!(plain.status.success());
    assert!(bars != std::fs::read(folder.path().join("si_ADF.png")).unwrap());
}

#[test]
fn frames_and_displacements_come_from_files() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let head = "Lattice=\"8 0 0 0 8 0 0 0 4\" Properties=species:S:1:pos:R:3";
    let frame = |x: f64| format!("2\n{head}\nSi {x} 2 1\nSi 4 4 3\n");
    let frames = [2.0, 2.2, 2.4, 2.6].map(frame);
    std::fs::write(here.join("md.xyz"), frames.concat()).unwrap();
    frames.iter().enumerate().for_each(|(n, f)| {
        std::fs::write(here.join(format!("f{n}.xyz")), f).unwrap();
    });
    let image = |arguments: &[&str]| -> Vec<f32> {
        let mut command = stemgen(here);
        command.arg("simulate").args(arguments).args(["--sampling", "0.1", "--scan-step", "0.5"]);
        command.args(["--detector", "ADF=40-80", "--overwrite", "-o", "o.h5", "--quiet"]);
        let run = command.output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        let file = hdf5::File::open(here.join("o.h5")).unwrap();
        file.dataset("images/ADF").unwrap().read_raw().unwrap()
    };
    let mean = image(&["md.xyz", "--frames", "1:3:2"]);
    let (one, three) = (image(&["f1.xyz"]), image(&["f3.xyz"]));
    assert!(one != three);
    for ((m, a), b) in mean.iter().zip(&one).zip(&three) {
        assert!((m - 0.5 * (a + b)).abs() < 1e-6, "{m} {a} {b}");
    }
    // U = 0.0064 is a sigma of 0.08
    let cif = std::fs::read_to_string(file("structures/si.cif")).unwrap();
    let cell = cif.lines().filter(|l| l.starts_with("_cell") || l.starts_with("data"));
    let atoms = [
        "loop_",
        "_atom_site_type_symbol",
        "_atom_site_fract_x",
        "_atom_site_fract_y",
        "_atom_site_fract_z",
        "_atom_site_U_iso_or_equiv",
        "Si 0 0 0 0.0064(2)",
        "Si 0.5 0.5 0.25 0.0064",
        "",
    ];
    let text = cell.chain(atoms).collect::<Vec<_>>().join("\n");
    std::fs::write(here.join("u.cif"), text).unwrap();
    let sigma = |sigma| image(&["u.cif", "--phonons", "2", "--sigma", sigma]);
    assert_eq!(sigma("from-file"), sigma("0.08"));
    let mut none = stemgen(here);
    let si = file("structures/si.cif");
    let printed =
        super::fails(none.args(["simulate", &si, "--phonons", "2", "--sigma", "from-file"]));
    assert!(printed.contains("_atom_site_u_iso_or_equiv"), "{printed}");
    // B is 0.4630 at 280 K in the table.
    let expected = (0.4630 / (8.0 * std::f64::consts::PI.powi(2))).sqrt().to_string();
    let table = ["u.cif", "--phonons", "2", "--sigma", "table", "--temperature", "280"];
    assert_eq!(image(&table), sigma(&expected));
    let mut lacks = stemgen(here);
    let oxide = file("structures/srtio3.cif");
    let printed =
        super::fails(lacks.args(["simulate", &oxide, "--phonons", "2", "--sigma", "table"]));
    assert!(printed.contains("O is not among them"), "{printed}");
    let mut cold = stemgen(here);
    let table = ["--phonons", "2", "--sigma", "table", "--temperature", "77"];
    let printed = super::fails(cold.args(["simulate", &si]).args(table));
    assert!(printed.contains("200 to 400 K") && printed.contains("--temperature"), "{printed}");
}

/// Anisotropic displacements of a CIF: the plan prints them, and a site without a vibration is named.
#[test]
fn anisotropic_displacements_are_printed() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(file("tests/structures/good/trigonal_u.cif")).unwrap();
    let bad = text.replace("0.0080 0.0062 0.0095", "0.0080 0.0062 -0.0095");
    assert_ne!(bad, text);
    for (text, expected) in [
        (text, ["anisotropic displacements", "all 36 atoms"]),
        (bad, ["Si1 (-0.0095)", "for 24 of 36 atoms"]),
    ] {
        std::fs::write(folder.path().join("u.cif"), text).unwrap();
        let mut command = stemgen(folder.path());
        command.args(["simulate", "u.cif", "--zone", "0,0,1", "--repeat", "1,1,2", "--dry-run"]);
        command.args(["--phonons", "2", "--sigma", "from-file", "--engine", "multislice"]);
        let run = command.output().unwrap();
        let printed = String::from_utf8_lossy(&run.stderr) + String::from_utf8_lossy(&run.stdout);
        assert!(run.status.success(), "{printed}");
        assert!(expected.iter().all(|part| printed.contains(part)), "{printed}");
    }
}

/// The same command gives the same bytes, at any time.
#[test]
fn the_same_command_writes_the_same_file() {
    let folder = tempfile::tempdir().unwrap();
    let once = || {
        let mut command = stemgen(folder.path());
        command.arg("simulate").arg(file("structures/si.cif"));
        command.args(["--sampling", "0.1", "--detector", "ADF=40-80", "--scan-points", "4,4"]);
        command.args(["--phonons", "2", "--sigma", "0.08", "--dose", "1e4", "--hspy"]);
        let run = command.args(["--overwrite", "--quiet", "-o", "a.h5"]).output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        ["a.h5", "a.hspy"].map(|name| std::fs::read(folder.path().join(name)).unwrap())
    };
    let first = once();
    // Another second of the clock.
    std::thread::sleep(std::time::Duration::from_millis(1100));
    assert!(first == once());
}

/// A part of the cell with a source is that part of the whole with the same source.
#[test]
fn a_source_blurs_parts_as_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, scan: [&str; 4], source: &[&str]| -> Vec<f32> {
        let mut command = stemgen(folder.path());
        command.arg("simulate").arg(file("structures/si.cif"));
        command.args(["--sampling", "0.1", "--detector", "ADF=40-80", "--quiet", "-o", name]);
        let run = command.args(scan).args(source).output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        let file = hdf5::File::open(folder.path().join(name)).unwrap();
        file.dataset("images/ADF").unwrap().read_raw().unwrap()
    };
    // 20 pixels of the cell, and 10 in its corner
    let whole = ["--scan-points", "20,20", "--scan-start", "0,0"];
    let corner = ["--scan-points", "10,10", "--scan-end", "2.7155,2.7155"];
    let source = ["--source-size", "0.9"];
    let (sharp, whole) = (run("a.h5", whole, &[]), run("b.h5", whole, &source));
    let corner = run("c.h5", corner, &source);
    let spread = |v: &[f32]| {
        v.iter().fold(0.0, |m: f32, a| m.max(*a)) - v.iter().fold(1.0, |m: f32, a| m.min(*a))
    };
    assert!(spread(&whole) < 0.8 * spread(&sharp), "{} {}", spread(&whole), spread(&sharp));
    let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
    assert!((mean(&whole) / mean(&sharp) - 1.0).abs() < 1e-5);
    for (i, value) in corner.iter().enumerate() {
        let same = whole[i / 10 * 20 + i % 10];
        assert!((value - same).abs() < 2e-3 * spread(&whole), "{i}: {value} {same}");
    }
}

#[test]
fn a_warning_is_a_sentence_without_gaps() {
    let folder = tempfile::tempdir().unwrap();
    let mut simulate = stemgen(folder.path());
    let plan = json(simulate.args(["simulate", &file("structures/si.cif"), "--dry-run"]));
    let warnings: Vec<&str> =
        plan["warnings"].as_array().unwrap().iter().map(|w| w.as_str().unwrap()).collect();
    assert!(!warnings.is_empty() && warnings.iter().all(|w| !w.contains("  ")), "{warnings:?}");
    let mut build = stemgen(folder.path());
    build.args(["build", "--recipe", &file("tests/cli/tiny.toml"), "--accuracy", "1", "--dry-run"]);
    let printed = stderr(&build.output().unwrap());
    let warning = printed.lines().find(|l| l.contains("was not measured for")).expect(&printed);
    assert!(!warning.contains("  "), "{warning}");
}

/// What was asked and found is in the summary, in the plan, and in the file.
#[test]
fn an_accuracy_is_measured_and_printed() {
    let folder = tempfile::tempdir().unwrap();
    let run = |more: &[&str]| {
        let mut command = stemgen(folder.path());
        command.args(["simulate", &file("structures/si.cif"), "--repeat", "4,4,1"]);
        command.args(["--scan-start", "5,5", "--scan-end", "11.4,11.4", "--scan-step", "0.4"]);
        command.args(["--accuracy", "2%", "--quiet"]).args(more);
        json(&mut command)["accuracy"].clone()
    };
    let (planned, found) = (run(&["--dry-run"]), run(&["-o", "si.h5"]));
    for report in [&planned, &found] {
        assert_eq!(report["asked_percent"], 2.0);
        assert_eq!(report["algorithm"]["name"], "window");
        let tried = report["tried"].as_array().unwrap().last().unwrap();
        assert!(tried["found_percent"].as_f64().unwrap() < 2.0, "{report}");
        assert!(report["reference"].as_str().unwrap().contains("multislice"), "{report}");
    }
    assert_eq!(planned["tried"], found["tried"]);
    let file = hdf5::File::open(folder.path().join("si.h5")).unwrap();
    let printed: hdf5::types::VarLenUnicode = file.attr("accuracy").unwrap().read_scalar().unwrap();
    let printed: serde_json::Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(
        (&printed["tried"], &printed["asked_percent"]),
        (&found["tried"], &found["asked_percent"])
    );
    assert!(printed.get("measured_in_s").is_none(), "{printed}");
}

/// Out of focus the probe is wide, and so is the window that it takes.
#[test]
fn an_accuracy_is_measured_for_each_defocus() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stemgen(folder.path());
    command.args(["simulate", &file("structures/si.cif"), "--repeat", "6,6,1", "--quiet"]);
    command.args(["--scan-start", "8,8", "--scan-end", "14.4,14.4", "--scan-step", "0.4"]);
    command.args(["--accuracy", "3%", "--defocus", "0:100:100", "-o", "si.h5"]);
    let found = json(&mut command)["accuracy"].clone();
    let printed: hdf5::types::VarLenUnicode = hdf5::File::open(folder.path().join("si.h5"))
        .and_then(|f| f.attr("accuracy")?.read_scalar())
        .unwrap();
    let printed: serde_json::Value = serde_json::from_str(&printed).unwrap();
    for reports in [&found, &printed] {
        let of = |n: usize| reports[n]["tried"].as_array().unwrap().last().unwrap().clone();
        let (sharp, wide) = (of(0), of(1));
        assert_eq!(reports.as_array().unwrap().len(), 2, "{reports}");
        for tried in [&sharp, &wide] {
            assert!(tried["found_percent"].as_f64().unwrap() < 3.0, "{reports}");
        }
        let width = |tried: &serde_json::Value| tried["width_angstrom"].as_f64().unwrap();
        assert!(width(&wide) > width(&sharp) + 1.0, "{reports}");
    }
}

#[test]
fn what_lies_outside_the_cell_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let atoms =
        "2\nLattice=\"12 0 0 0 12 0 0 0 4\" Properties=species:S:1:pos:R:3\nSi 6 6 1\nSi -3 6 1\n";
    std::fs::write(folder.path().join("turned.xyz"), atoms).unwrap();
    let mut command = stemgen(folder.path());
    let plan = json(command.args(["simulate", "turned.xyz", "--dry-run", "--scan-end", "15,12"]));
    let warnings = plan["warnings"].to_string();
    for part in ["1 of 2 atoms lie outside the cell, up to 3.0 A", "from 0.000 to 15.000 A along x"]
    {
        assert!(warnings.contains(part), "no `{part}` in {warnings}");
    }
}

#[cfg(unix)]
#[test]
fn a_closed_pipe_is_no_fault() {
    let folder = tempfile::tempdir().unwrap();
    let command = format!(
        "'{}' simulate '{}' --dry-run --json | true; exit ${{PIPESTATUS[0]}}",
        env!("CARGO_BIN_EXE_stemgen"),
        file("structures/si.cif")
    );
    let mut bash = Command::new("bash");
    let run = bash.args(["-c", &command]).current_dir(folder.path()).output().unwrap();
    assert!(run.status.success() && stderr(&run).is_empty(), "{}", stderr(&run));
}

#[test]
fn electrons_beyond_counting_and_names_used_twice_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run = |more: &[&str]| {
        let mut command = stemgen(folder.path());
        command.arg("simulate").arg(file("structures/si.cif"));
        command.args(["--scan-end", "1,1", "-o", "x.h5"]).args(more);
        fails(&mut command)
    };
    for dose in ["1e20", "1e308"] {
        let printed = run(&["--dose", dose]);
        assert!(printed.contains("more than can be counted; expected at most"), "{printed}");
    }
    let printed = run(&["--dose", "100", "--detector", "A=68-200", "--detector", "A_noisy=90-200"]);
    assert!(
        printed.contains("A_noisy: is also the name of the noisy image of another detector"),
        "{printed}"
    );
    let printed = run(&["--focal-spread", "1e308"]);
    assert!(printed.contains("1e308: must be from 0 to") && printed.len() < 400, "{printed}");
    assert!(!folder.path().join("x.h5").exists());
}
