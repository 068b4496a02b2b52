//! `stemgen patterns`, and `stemgen integrate`, which makes images of them.

use super::{fails, file, json, python, stderr, stemgen};
use std::path::Path;

/// A small scan of silicon, whose patterns take a second.
const SMALL: &[&str] = &[
    "--repeat",
    "4,4,2",
    "--scan-start",
    "8,8",
    "--scan-end",
    "10,9.5",
    "--scan-points",
    "4,3",
    "--pixels",
    "24",
    "--max-angle",
    "50",
];

fn silicon(folder: &Path) {
    std::fs::copy(file("structures/si.cif"), folder.join("si.cif")).unwrap();
}

fn done(folder: &Path, arguments: &[&str]) -> serde_json::Value {
    json(stemgen(folder).args(arguments))
}

#[test]
fn patterns_are_written_for_other_programs_and_make_images() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let made = done(here, &[&["patterns", "si.cif"], SMALL, &["--png", "--threads", "1"]].concat());
    assert_eq!(
        (made["files"][0]["rows"].as_u64(), made["files"][0]["pixels"].as_u64()),
        (Some(3), Some(24))
    );
    let share = made["files"][0]["mean_sum"].as_f64().unwrap();
    assert!(share > 0.9 && share < 1.0, "{share}");
    assert!(here.join("si_mean.png").exists());
    let held = python("check_patterns.py", &[&here.join("si.emd")]);
    assert!(held.starts_with("float32 3 4 24 24") && held.trim_end().ends_with("10.86"), "{held}");
    // The same numbers on other threads.
    done(here, &[&["patterns", "si.cif"], SMALL, &["-o", "two.emd", "--threads", "2"]].concat());
    let values = |name: &str| {
        let all = python("digest.py", &[&here.join(name)]);
        let line = all.lines().find(|line| line.contains("datacube/data")).map(str::to_owned);
        line.unwrap_or_else(|| panic!("{all}"))
    };
    assert_eq!(values("si.emd"), values("two.emd"));
    let images = done(
        here,
        &[
            "integrate",
            "si.emd",
            "--annulus",
            "ABF=10-21",
            "--sectors",
            "DPC=0-21:4@45",
            "--com",
            "--icom",
            "--png",
            "--tiff",
            "32",
        ],
    );
    let names: Vec<&str> =
        images["images"].as_array().unwrap().iter().filter_map(|i| i["name"].as_str()).collect();
    assert_eq!(names, ["ABF", "DPC_0", "DPC_1", "DPC_2", "DPC_3", "com_x", "com_y", "icom"]);
    for name in names {
        assert!(here.join(format!("si_images_{name}.png")).exists(), "{name}");
        assert!(here.join(format!("si_images_{name}.tif")).exists(), "{name}");
    }
    let all = python("digest.py", &[&here.join("si_images.h5")]);
    assert!(all.contains("images/icom (1, 3, 4)"), "{all}");
}

/// Parts of several processes: each row once, the same numbers for any division, damaged parts made again, other parts refused.
#[test]
fn patterns_are_simulated_in_parts() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let series = |more: &[&str]| {
        let common = ["--defocus", "0:20:20", "--phonons", "1", "--sigma", "0.08", "-o", "s.emd"];
        let mut command = stemgen(here);
        command.args(["patterns", "si.cif"]).args(SMALL).args(common).args(more);
        command
    };
    let names = ["s_defocus_0A.emd", "s_defocus_20A.emd"];
    let values = || {
        names.map(|name| {
            let all = python("digest.py", &[&here.join(name)]);
            all.lines().find(|line| line.contains("datacube/data")).map(str::to_owned).unwrap()
        })
    };
    let expected = {
        json(&mut series(&[]));
        values()
    };
    assert_ne!(expected[0], expected[1]);
    names.iter().for_each(|name| std::fs::remove_file(here.join(name)).unwrap());
    let mut rows = 0;
    for shard in ["1/2", "0/2", "4/5"] {
        let part = json(&mut series(&["--shard", shard]));
        rows += part["rows"].as_u64().unwrap() - part["rows_resumed"].as_u64().unwrap();
    }
    assert_eq!(rows, 6, "three rows at each of two foci");
    let again = json(&mut series(&["--shard", "1/2"]));
    assert_eq!(again["rows"], again["rows_resumed"]);
    assert!(!here.join(names[0]).exists());
    let parts = std::fs::read_dir(here.join("s.emd.work")).unwrap();
    let first = parts.map(|entry| entry.unwrap().path()).min().unwrap();
    std::fs::write(&first, b"STEMARR1 and no more").unwrap();
    let printed = fails(series(&["--seed", "5", "--shard", "0/2"]).arg("--quiet"));
    assert!(printed.contains("parts of other patterns"), "{printed}");
    let run = series(&[]).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    assert!(stderr(&run).contains("is cut off; simulated again"), "{}", stderr(&run));
    assert_eq!(values(), expected);
    assert!(!here.join("s.emd.work").exists());
}

/// The images of sectors that `simulate` makes are those that are made of patterns, whose pixels cut the edges otherwise.
#[test]
fn sectors_of_images_and_of_patterns_agree() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let scan = &SMALL[..8];
    let exact = ["--engine", "multislice"];
    let patterns = ["--pixels", "96", "--max-angle", "40", "-o", "p.emd"];
    done(here, &[&["patterns", "si.cif"], scan, &exact, &patterns].concat());
    done(here, &["integrate", "p.emd", "--sectors", "DPC=5-21:4@30", "-o", "a.h5"]);
    let detector = ["--detector", "DPC=5-21:4@30", "-o", "b.h5"];
    let made = done(here, &[&["simulate", "si.cif"], scan, &exact, &detector].concat());
    assert_eq!(made["images"].as_array().unwrap().len(), 4, "{made}");
    let images = |name: &str| {
        let file = hdf5::File::open(here.join(name)).unwrap();
        let one = |n: usize| {
            let image = file.dataset(&format!("images/DPC_{n}")).unwrap();
            let azimuths = image.attr("sector_degrees").unwrap().read_raw::<f64>().unwrap();
            assert_eq!(azimuths[0], 30.0 + 90.0 * n as f64);
            image.read_raw::<f32>().unwrap()
        };
        [0, 1, 2, 3].map(one)
    };
    let (of_patterns, direct) = (images("a.h5"), images("b.h5"));
    let share = |images: &[Vec<f32>; 4], n: usize, probe: usize| {
        images[n % 4][probe] / images.iter().map(|image| image[probe]).sum::<f32>()
    };
    // Patterns are cut around the probe, so that they lack what the cell repeats.
    let worst = |turn: usize| {
        let all = (0..4).flat_map(|n| (0..12).map(move |probe| (n, probe)));
        let off = all.map(|(n, probe)| {
            share(&of_patterns, n + turn, probe) / share(&direct, n, probe) - 1.0
        });
        off.map(f32::abs).fold(0.0, f32::max)
    };
    assert!(worst(0) < 0.06, "{}", worst(0));
    for turn in 1..4 {
        assert!(worst(turn) > 0.15, "{turn}: {}", worst(turn));
    }
}

/// The centre of mass that `simulate` makes is the one of patterns, whose square detector holds a little more. Both axes and the noise of a
/// dose are in the file.
#[test]
fn centres_of_mass_of_images_and_of_patterns_agree() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let scan = &SMALL[..8];
    let exact = ["--engine", "multislice"];
    let patterns = ["--pixels", "96", "--max-angle", "60", "-o", "p.emd"];
    done(here, &[&["patterns", "si.cif"], scan, &exact, &patterns].concat());
    done(here, &["integrate", "p.emd", "--com", "-o", "a.h5"]);
    let detector = ["--detector", "COM=0-60:com", "--detector", "BF=0-20", "--dose", "1e6"];
    let simulate = [&["simulate", "si.cif"], scan, &exact, &detector].concat();
    let made = done(here, &[&simulate[..], &["-o", "b.h5", "--png"]].concat());
    assert_eq!(made["images"].as_array().unwrap().len(), 3, "{made}");
    let read = |file: &str, name: &str| {
        let file = hdf5::File::open(here.join(file)).unwrap();
        let image = file.dataset(&format!("images/{name}")).unwrap();
        let units = image.attr("units").unwrap();
        let units = units.read_scalar::<hdf5::types::VarLenUnicode>().unwrap();
        assert!(name == "BF" || units.as_str() == "mrad", "{units}");
        image.read_raw::<f32>().unwrap()
    };
    let rms = |v: &[f32]| (v.iter().map(|v| v * v).sum::<f32>() / v.len() as f32).sqrt();
    let off = |a: &[f32], b: &[f32]| -> Vec<f32> { a.iter().zip(b).map(|(a, b)| a - b).collect() };
    for axis in ["x", "y"] {
        let of_patterns = read("a.h5", &format!("com_{axis}"));
        let direct = read("b.h5", &format!("COM_{axis}"));
        let error = rms(&off(&of_patterns, &direct)) / rms(&direct);
        println!("{axis}: {} mrad rms, off {error}", rms(&direct));
        assert!(error < 2e-3, "{axis}: {error}");
        // 1e6 electrons per square Angstrom, whose angles scatter by half of the semiangle and more.
        let noise = rms(&off(&read("b.h5", &format!("COM_{axis}_noisy")), &direct));
        assert!(noise > 0.005 && noise < 0.1, "{axis}: {noise}");
        assert!(here.join(format!("b_COM_{axis}.png")).exists());
    }
    let refused = fails(stemgen(here).args(["simulate", "si.cif", "--detector", "C=0-20:com:4"]));
    assert!(refused.contains("INNER-OUTER:com"), "{refused}");
    let twice = ["--detector", "C=0-20:com", "--detector", "C_x=0-9"];
    let twice = fails(stemgen(here).args([&["simulate", "si.cif"], &twice[..]].concat()));
    assert!(twice.contains("is used twice"), "{twice}");
}

#[test]
fn electrons_are_counted_at_every_thickness_and_defocus() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let more =
        ["--dose", "1e4", "--thicknesses", "5.4,10.8", "--defocus", "0:40:40", "-o", "s.emd"];
    let made = done(here, &[&["patterns", "si.cif"], SMALL, &more].concat());
    assert_eq!(made["files"].as_array().unwrap().len(), 4);
    let mut sums = Vec::new();
    for name in [
        "s_defocus_0A_5.4A.emd",
        "s_defocus_0A_10.9A.emd",
        "s_defocus_40A_5.4A.emd",
        "s_defocus_40A_10.9A.emd",
    ] {
        let held = python("check_patterns.py", &[&here.join(name)]);
        assert!(held.starts_with("uint32 3 4 24 24"), "{name}: {held}");
        // 0.25 A^2 for each probe.
        let mean: f64 = held.split_whitespace().nth(5).unwrap().parse().unwrap();
        assert!(mean > 2200.0 && mean < 2550.0, "{name}: {held}");
        sums.push(held);
    }
    sums.dedup();
    assert_eq!(sums.len(), 4, "each has draws of its own: {sums:?}");
    let images = done(here, &["integrate", "s_defocus_40A_5.4A.emd", "--annulus", "BF=0-21"]);
    assert_eq!(images["images"][0]["units"], "electrons");
}

/// A file of rings is small, and any annulus of whole rings is made of it: that of `simulate`, to the rounding of float32.
#[test]
fn rings_make_any_annulus() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let scan = &SMALL[..8];
    let full = ["--engine", "multislice", "--thicknesses", "5.4,10.8"];
    let made = done(
        here,
        &[&["patterns", "si.cif"], scan, &full, &["--radial", "1", "--max-angle", "200"]].concat(),
    );
    assert_eq!(made["files"][1]["rings"].as_u64(), Some(200));
    let held = python("check_rings.py", &[&here.join("si_10.9A.emd")]);
    assert!(held.starts_with("float32 3 4 200"), "{held}");
    assert!(made["files"][1]["file_bytes"].as_u64() < Some(200_000));
    done(
        here,
        &[
            "integrate",
            "si_10.9A.emd",
            "--annulus",
            "HAADF=68-200",
            "--annulus",
            "BF=0-21",
            "-o",
            "i.h5",
        ],
    );
    let detectors = ["--detector", "HAADF=68-200", "--detector", "BF=0-21", "-o", "s.h5"];
    let probes = ["--probe-step", "scan"];
    done(here, &[&["simulate", "si.cif"], scan, &full, &detectors, &probes].concat());
    let off = python("compare_images.py", &[&here.join("i.h5"), &here.join("s.h5")]);
    assert!(off.trim_end() == "HAADF BF", "{off}");
    // Electrons are counted on each ring.
    done(
        here,
        &[&["patterns", "si.cif"], scan, &["--radial", "2", "--dose", "1e4", "-o", "n.emd"]]
            .concat(),
    );
    assert!(python("check_rings.py", &[&here.join("n.emd")]).starts_with("uint32 3 4 50"));
    for html in [&[][..], &["--html"]] {
        let printed = fails(stemgen(here).args(["view", "n.emd"]).args(html));
        assert!(printed.contains("n.emd") && printed.contains("sums over rings"), "{printed}");
    }
    let printed = fails(stemgen(here).args(["view", "n.emd", "--index", "1"]));
    assert!(printed.contains("--index") && printed.contains("integrate"), "{printed}");
    let refused = |arguments: &[&str], words: &str| {
        let printed = fails(stemgen(here).args(arguments));
        assert!(printed.contains(words), "{arguments:?}: {printed}");
    };
    refused(&["integrate", "n.emd", "--annulus", "67-90"], "66-90 mrad consists of whole rings");
    refused(&["integrate", "n.emd", "--annulus", "68-200"], "reach to 100.0 mrad");
    refused(&["integrate", "n.emd", "--com"], "without --radial");
    refused(&["integrate", "n.emd", "--sectors", "0-20:4"], "need patterns of pixels");
    let rings = |more: &[&str], words: &str| {
        refused(&[&["patterns", "si.cif", "-o", "x.emd"], scan, more].concat(), words);
    };
    rings(&["--radial", "3"], "multiple is 99 mrad");
    rings(&["--radial", "1", "--pixels", "32"], "--pixels");
    rings(&["--radial", "1", "--mtf", "1"], "--mtf");
    rings(&["--radial", "1", "--png"], "have no picture");
    rings(&["--radial", "0.001"], "4096");
}

/// The same electrons in every kind of file.
#[test]
fn other_files_hold_the_same_electrons() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let scan = [&["patterns", "si.cif"], &SMALL[..8], &["--max-angle", "50"]].concat();
    let counted = [&scan[..], &["--pixels", "128", "--dose", "3e3"]].concat();
    for name in ["a.emd", "a.hspy", "a.toml", "a.raw"] {
        let made = done(here, &[&counted[..], &["-o", name]].concat());
        assert_eq!(made["files"][0]["output"], name);
    }
    let held = python("check_pattern_files.py", &[&here.join("a")]);
    assert!(held.starts_with("3 4 128 128"), "{held}");
    // Fractions of the beam for the EMPAD.
    done(here, &[&scan[..], &["--pixels", "128", "-o", "f.raw"]].concat());
    let bytes = std::fs::read(here.join("f.raw")).unwrap();
    assert_eq!(bytes.len(), 12 * 130 * 128 * 4);
    let mut files: Vec<_> = std::fs::read_dir(here)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    let expected = [
        "a.emd",
        "a.hspy",
        "a.json",
        "a.raw",
        "a.toml",
        "a.xml",
        "a_indices.dat",
        "a_indptr.dat",
        "a_values.dat",
        "f.json",
        "f.raw",
        "f.xml",
        "si.cif",
    ];
    assert_eq!(files, expected);
    let refused = |more: &[&str], words: &str| {
        let printed = fails(stemgen(here).args(&scan).args(more));
        assert!(printed.contains(words), "{more:?}: {printed}");
    };
    refused(&["-o", "b.toml"], "give a dose");
    refused(&["-o", "b.raw"], "128 x 128");
    refused(&["-o", "b.hspy", "--radial", "1"], "write rings as .emd");
    refused(&["-o", "b.zarr"], "did you mean b.emd?");
    refused(&["-o", "a.toml", "--dose", "10"], "--overwrite");
    std::fs::remove_file(here.join("a.raw")).unwrap();
    refused(&["-o", "a.raw", "--pixels", "128"], "a.json");
}

/// A source and a transfer function change the patterns, and go into the request.
#[test]
fn patterns_are_made_again_from_their_request() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    std::fs::write(here.join("mtf.csv"), "# cycles per pixel, transfer\n0,1\n0.25,0.8\n0.5,0.4\n")
        .unwrap();
    let more =
        ["--source-size", "0.8", "--mtf", "mtf.csv", "--dose", "1e5", "--defocus", "0:20:20"];
    let asked = [&["patterns", "si.cif"], SMALL, &more].concat();
    let plan = done(here, &[&asked[..], &["--dry-run"]].concat());
    assert_eq!(plan["scan"][1].as_u64(), Some(4), "{plan}");
    done(here, &[&asked[..], &["--write-request", "r.toml"]].concat());
    let text = std::fs::read_to_string(here.join("r.toml")).unwrap();
    assert!(text.contains("stemgen patterns r.toml") && text.contains("mtf = [["), "{text}");
    std::fs::remove_file(here.join("mtf.csv")).unwrap();
    done(here, &["patterns", "r.toml"]);
    let again = done(here, &["rerun", "r_defocus_20A.emd"]);
    assert_eq!(again["values"].as_u64(), Some(0), "{again}");
    assert!(here.join("r_defocus_20A_rerun_defocus_20A.emd").exists());
    done(here, &["patterns", "r.toml", "--mtf", "0", "-o", "sharp.emd"]);
    let values = |name: &str| {
        let all = python("digest.py", &[&here.join(name)]);
        all.lines().find(|line| line.contains("datacube/data")).map(str::to_owned)
    };
    assert_ne!(values("sharp_defocus_0A.emd"), values("r_defocus_0A.emd"));
    // A file whose numbers are others.
    python("change_pattern.py", &[&here.join("r_defocus_20A.emd")]);
    let printed =
        stemgen(here).args(["rerun", "r_defocus_20A.emd", "--overwrite"]).output().unwrap();
    assert_eq!(printed.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&printed.stdout).contains("1 values DIFFER"));
    let refused = |arguments: &[&str], words: &str| {
        let printed = fails(stemgen(here).args(arguments));
        assert!(printed.contains(words), "{arguments:?}: {printed}");
    };
    refused(&["patterns", "r.toml", "--write-request", "r.txt"], "did you mean r.toml?");
    refused(&["patterns", "r.toml", "--mtf", "none.csv"], "none.csv");
    refused(&["patterns", "r.toml", "--mtf", "-1"], "0 to 50 pixels");
    let lorentz = ["patterns", "r.toml", "--source-size", "0.8", "--source-lorentz", "0.3"];
    refused(&lorentz, "Gaussian");
    refused(&["rerun", "r_defocus_0A.emd", "-o", "x.h5"], "written as .emd");
    std::fs::remove_file(here.join("si.cif")).unwrap();
    refused(&["rerun", "r_defocus_0A.emd"], "--structure FILE");
}

#[test]
fn a_plan_says_what_patterns_take() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let wide = ["--repeat", "8,8,4", "--pixels", "128", "--dry-run"];
    let plan = done(here, &[&["patterns", "si.cif"], &wide[..]].concat());
    assert_eq!(plan["algorithm"]["name"], "window");
    let probes = plan["scan"][0].as_u64().unwrap() * plan["scan"][1].as_u64().unwrap();
    assert_eq!(plan["file_bytes"].as_u64(), Some(probes * 128 * 128 * 4));
    assert!(plan["memory_bytes"].as_u64() > Some(1 << 20));
    assert!(!here.join("si.emd").exists());
}

#[test]
fn mistakes_are_refused_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let refused = |arguments: &[&str], words: &str| {
        let printed = fails(stemgen(here).args(arguments));
        assert!(printed.contains(words), "{arguments:?}: {printed}");
    };
    let patterns = |more: &[&str], words: &str| {
        refused(&[&["patterns", "si.cif"], SMALL, more].concat(), words);
    };
    patterns(&["-o", "x.h5"], "did you mean x.emd?");
    patterns(&["--detector", "HAADF=68-200"], "stemgen integrate");
    patterns(&["--accuracy", "1"], "give the width of the window of patterns");
    patterns(&["--engine", "prism"], "PRISM");
    patterns(&["--sampling", "0.4"], "--sampling");
    refused(&["patterns", "si.cif", "--pixels", "1"], "2 to 4096");
    let large = ["--repeat", "4,4,1", "--pixels", "4096", "--scan-step", "0.01"];
    refused(&[&["patterns", "si.cif"], &large[..]].concat(), "free");
    assert!(std::fs::read_dir(here).unwrap().count() == 1, "nothing is left");
    done(here, &[&["patterns", "si.cif"], SMALL].concat());
    patterns(&[], "--overwrite");
    refused(&["integrate", "si.emd"], "--annulus");
    refused(&["integrate", "si.emd", "--annulus", "HAADF=68-200"], "reach to 50.0 mrad");
    refused(
        &["integrate", "si.emd", "--annulus", "A=0-10", "--annulus", "A=10-20"],
        "another name",
    );
    refused(&["integrate", "si.emd", "--sectors", "0-21"], "0-21:4@45");
    refused(&["integrate", "si.cif", "--com"], "si.cif");
    // A request for patterns is none for images.
    std::fs::write(here.join("r.toml"), "structure = \"si.cif\"\n[patterns]\npixels = 16\n")
        .unwrap();
    refused(&["simulate", "r.toml"], "stemgen patterns");
}
