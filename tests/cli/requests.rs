//! Requests: what decides an image, in a file, and images made again from what they hold.

use super::{fails, file, json, python, stderr, stdout, stemgen};
use std::path::Path;

/// Two small images of silicon with phonons, counted electrons and a finite source.
const ASKED: &[&str] = &[
    "--repeat",
    "2,2,1",
    "--scan-end",
    "2.7155,2.7155",
    "--scan-points",
    "6,5",
    "--sampling",
    "0.2",
    "--phonons",
    "2",
    "--sigma",
    "Si=0.08",
    "--detector",
    "ADF=30-45",
    "--detector",
    "BF=0-10",
    "--dose",
    "1e5",
    "--source-size",
    "0.7",
    "--defocus",
    "0:20:20",
    "--aberration",
    "C12=15@0.3",
];

fn digest(path: &Path) -> String {
    python("digest.py", &[path])
}

#[test]
fn a_request_in_a_file_makes_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::copy(file("structures/si.cif"), here.join("si.cif")).unwrap();
    let run = |arguments: &[&str]| {
        let run = stemgen(here).arg("simulate").args(arguments).output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        stdout(&run)
    };
    run(&[&["si.cif"], ASKED, &["-o", "asked.h5"]].concat());
    run(&[&["si.cif"], ASKED, &["--write-request", "r.toml"]].concat());
    assert!(
        !here.join("si.h5").exists() && !here.join("r.h5").exists(),
        "--write-request simulates nothing"
    );
    let text = std::fs::read_to_string(here.join("r.toml")).unwrap();
    assert!(
        text.contains("structure = \"si.cif\"") && text.contains("defocus_angstrom = [0.0, 20.0]"),
        "{text}"
    );
    // The folder moves with its structure, and the request still finds it.
    run(&["r.toml"]);
    assert_eq!(images(&here.join("asked.h5")), images(&here.join("r.h5")));
    // Options change what the request asks for.
    run(&["r.toml", "--defocus", "20", "-o", "one.h5"]);
    assert!(digest(&here.join("one.h5")).contains("images/ADF (1, 5, 6)"));
    let plan = json(stemgen(here).args(["simulate", "r.toml", "--window", "9", "--dry-run"]));
    assert_eq!(
        (plan["algorithm"]["name"].as_str(), plan["defocus_angstrom"][1].as_f64()),
        (Some("window"), Some(20.0))
    );
}

/// Digests of the images and counts alone: the command that made a file is another.
fn images(path: &Path) -> Vec<String> {
    let all = digest(path);
    let kept = all.lines().filter(|line| line.contains("images/") || line.contains("counts/"));
    let kept: Vec<String> = kept.map(str::to_owned).collect();
    assert!(kept.len() >= 8, "{all}");
    kept
}

#[test]
fn bad_requests_are_refused_with_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::copy(file("structures/si.cif"), here.join("si.cif")).unwrap();
    let with = |text: &str| {
        std::fs::write(here.join("r.toml"), text).unwrap();
        fails(stemgen(here).args(["simulate", "r.toml"]))
    };
    for (text, words) in [
        ("structure = \"none.cif\"\n", "none.cif: cannot read"),
        (
            "structure = \"si.cif\"\nthicknes_angstrom = [2]\n",
            "r.toml:2: unknown field `thicknes_angstrom`",
        ),
        ("structure = \"si.cif\"\n[numerics]\nengine = \"mosaic\"\n", "unknown variant `mosaic`"),
        (
            "structure = \"si.cif\"\n[numerics]\nsampling_angstrom = 0.1\ngpts = [64, 64]\n",
            "both set the grid",
        ),
        ("structure = \"si.cif\"\n[specimen]\nphonons = 3\n", "--sigma"),
        ("structure = \"si.cif\"\n[microscope]\nenergy_kev = 200000\n", "did you mean 200?"),
        ("structure = \"si.cif\"\nelectrons_per_angstrom2 = 1e15\n", "more than can be counted"),
        ("material = \"srtio3\"\n", "unknown field `material`"),
    ] {
        let printed = with(text);
        assert!(printed.contains(words), "{text}: {printed}");
    }
    let printed = fails(stemgen(here).args(["simulate", "si.cif", "--write-request", "r.h5"]));
    assert!(printed.contains("did you mean r.toml?"), "{printed}");
    let printed = fails(stemgen(here).args(["simulate", "si.cif", "--write-request", "r.toml"]));
    assert!(printed.contains("r.toml") && printed.contains("--overwrite"), "{printed}");
}

#[test]
fn images_are_made_again_from_what_they_hold() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::copy(file("structures/si.cif"), here.join("si.cif")).unwrap();
    let small = [
        "--scan-end",
        "2.7155,2.7155",
        "--scan-points",
        "4,4",
        "--sampling",
        "0.1",
        "--detector",
        "ADF=40-80",
    ];
    let run = stemgen(here)
        .args(["simulate", "si.cif", "--thicknesses", "2.7,5.431"])
        .args(small)
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let info = stemgen(here).args(["info", "si.h5"]).output().unwrap();
    assert!(stdout(&info).contains("stemgen rerun si.h5"), "{}", stdout(&info));
    let printed = json(stemgen(here).args(["info", "si.h5"]));
    assert_eq!(printed["images"][0]["request"]["structure"], "si.cif");
    let again = stemgen(here).args(["rerun", "si.h5"]).output().unwrap();
    assert!(
        again.status.success() && stdout(&again).contains("ADF: the same bits"),
        "{}",
        stderr(&again)
    );
    assert!(here.join("si_rerun.h5").exists());
    // A file whose pixels were touched since is found out, by a code of its own.
    python("touch_image.py", &[&here.join("si.h5")]);
    let again = stemgen(here).args(["rerun", "si.h5", "--overwrite"]).output().unwrap();
    assert_eq!(again.status.code(), Some(3), "{}", stdout(&again));
    assert!(stdout(&again).contains("ADF: DIFFERS in 1 pixels"), "{}", stdout(&again));
    // The structure file is another, or gone.
    let mut text = std::fs::read_to_string(here.join("si.cif")).unwrap();
    std::fs::rename(here.join("si.cif"), here.join("moved.cif")).unwrap();
    let gone = fails(stemgen(here).args(["rerun", "si.h5", "--overwrite"]));
    assert!(gone.contains("si.cif: is not there; give --structure FILE"), "{gone}");
    let moved =
        stemgen(here).args(["rerun", "si_rerun.h5", "--structure", "moved.cif"]).output().unwrap();
    assert!(moved.status.success(), "{}", stderr(&moved));
    text += "# changed\n";
    std::fs::write(here.join("si.cif"), text).unwrap();
    let other = fails(stemgen(here).args(["rerun", "si.h5", "--overwrite"]));
    assert!(other.contains("is not the file that si.h5 was made from"), "{other}");
    let foreign = fails(stemgen(here).args(["rerun", "moved.cif"]));
    assert!(foreign.contains("moved.cif"), "{foreign}");
}

/// What command line and Python said differently before there was one request. The library and Python have tests of the same.
#[test]
fn the_command_line_refuses_and_warns_as_the_library_does() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let si = file("structures/si.cif");
    let simulate = |more: &[&str]| fails(stemgen(here).args(["simulate", &si]).args(more));
    for dose in ["1e12", "1e15"] {
        assert!(simulate(&["--dose", dose]).contains("more than can be counted"));
    }
    let plan = json(stemgen(here).args(["simulate", &si, "--dry-run"]));
    let warnings = plan["warnings"].as_array().unwrap();
    let narrow =
        warnings.iter().filter_map(|w| w.as_str()).find(|w| w.contains("is narrow")).unwrap();
    assert!(narrow.contains("repeat it 3,3,1 times") && narrow.contains("--repeat"), "{narrow}");
    assert!(simulate(&["-o", "x.tif"]).contains("did you mean x.h5?"));
    let printed = simulate(&["--plane-wave", "--thicknesses", "2,4"]);
    assert!(printed.contains("a plane wave is known at the exit surface only"), "{printed}");
    let printed = simulate(&["--plane-wave", "--interpolation", "2"]);
    assert!(
        printed.contains("a plane wave is propagated by multislice")
            && printed.contains("--engine"),
        "{printed}"
    );
}

/// The help says defaults in words; the library has them. Both agree.
#[test]
fn defaults_in_the_help_are_those_of_the_request() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let si = file("structures/si.cif");
    let run = stemgen(here).args(["simulate", &si, "--write-request", "r.toml"]).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let request: toml::Table =
        std::fs::read_to_string(here.join("r.toml")).unwrap().parse().unwrap();
    let help = stdout(&stemgen(here).args(["simulate", "--help"]).output().unwrap());
    let printed = |option: &str| {
        let from = help
            .find(&format!("--{option} <"))
            .unwrap_or_else(|| panic!("--{option} is not in the help"));
        let text = help[from..].split_whitespace().collect::<Vec<_>>().join(" ");
        let (_, value) = text.split_once("[default: ").unwrap();
        value.split_once(']').unwrap().0.to_owned()
    };
    for (option, table, key) in [
        ("energy", "microscope", "energy_kev"),
        ("semiangle", "microscope", "semiangle_mrad"),
        ("seed", "specimen", "seed"),
        ("projection", "numerics", "projection"),
        ("parametrization", "numerics", "parametrization"),
        ("band-taper", "numerics", "band_taper"),
        ("angle-margin", "numerics", "angle_margin"),
        ("probe-step", "numerics", "probe_step"),
        ("expansion", "numerics", "expansion_percent"),
    ] {
        let known = match &request[table][key] {
            toml::Value::String(word) => word.clone(),
            toml::Value::Float(number) => number.to_string(),
            other => other.to_string(),
        };
        assert_eq!(printed(option), known, "--{option}");
    }
    let defocus = request["microscope"]["defocus_angstrom"].as_array().unwrap();
    assert_eq!(
        (printed("defocus"), defocus.len(), defocus[0].as_float()),
        ("0".into(), 1, Some(0.0))
    );
    let [detector] = &request["microscope"]["detectors"].as_array().unwrap()[..] else {
        panic!("{request:?}")
    };
    let annulus = ["inner_mrad", "outer_mrad"].map(|key| detector[key].as_float().unwrap());
    assert_eq!(
        printed("detector"),
        format!("{}={}-{}", detector["name"].as_str().unwrap(), annulus[0], annulus[1])
    );
}
