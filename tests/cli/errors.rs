//! Whatever is wrong: one error, at most one hint, a code that is not 0, and no panic.

use super::skipped::skipped;
use super::{fails, file, stemgen};

#[test]
fn bad_input_is_explained() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::write(here.join("there.h5"), "precious").unwrap();
    let odd = "1\nLattice=\"4 0 0 0 4 0 0 0 4\" Properties=species:S:1:pos:R:3\nXx 0 0 0\n";
    std::fs::write(here.join("odd.xyz"), odd).unwrap();
    let cif = std::fs::read_to_string(file("structures/si.cif")).unwrap();
    std::fs::write(here.join("cut.cif"), &cif[..cif.len() - 10]).unwrap();
    let tilted = "1\nLattice=\"4 1 0 0 4 0 0 0 4\" Properties=species:S:1:pos:R:3\nSi 0 0 0\n";
    std::fs::write(here.join("tilted.xyz"), tilted).unwrap();
    let si = &file("structures/si.cif");
    let srtio3 = &file("structures/srtio3.cif");
    let cases: [(&[&str], &[&str]); 27] = [
        (&[si, "--detector", "HAADF=0.068-0.2"], &["did you mean HAADF=68-200?"]),
        (&[si, "--semiangle", "0.03"], &["did you mean 30?"]),
        (&[si, "--energy", "200000"], &["did you mean 200?"]),
        (&[si, "--scan-end", "5,500"], &["500.0 A along y", "--scan-end"]),
        (&[si, "-o", "x.tif"], &["HDF5", "did you mean x.h5?"]),
        (&[si, "-o", "x.tif", "--dry-run"], &["did you mean x.h5?"]),
        (
            &[si, "--defocus", "30", "--aberration", "C10=5"],
            &["C10 is minus the defocus", "give one of them"],
        ),
        (&[si, "--aberration", "C12=30", "--aberration", "C12=3@1"], &["C12=3: is given twice"]),
        (&["none.cif"], &["none.cif", "check the name"]),
        (&["there.h5"], &["there.h5", ".cif"]),
        (&["odd.xyz"], &["odd.xyz:3", "Xx"]),
        (&["cut.cif"], &["cut.cif:"]),
        (&["tilted.xyz"], &["--zone"]),
        (&[si, "--sampling", "0.06"], &["`HAADF` reaches 200.0 mrad", "--sampling 0.0"]),
        (&[si, "--sampling", "-0.05"], &["-0.05", "--sampling"]),
        (&[si, "--sampling", "1e-9"], &["--sampling"]),
        (&[si, "--energy", "0"], &["energy", "--energy"]),
        (&[si, "--output", "there.h5"], &["exists", "--overwrite"]),
        (&[si, "--output", "there.h5/x.h5"], &["there.h5"]),
        (&[si, "--detector", "HAADF=200-68"], &["HAADF=200-68"]),
        (&[si, "--scan-step", "-1"], &["--scan-step"]),
        (&[si, "--repeat", "0,1,1"], &["--repeat"]),
        (&[si, "--repeat", "99999,99999,99999"], &["--repeat"]),
        (&[si, "--thicknesses", "80"], &["5.431", "--repeat"]),
        (&[si, "--zone", "0,0,0"], &["zone"]),
        (&[si, "--algorithm", "multislice", "--window", "9"], &["--window"]),
        (&[srtio3, "--phonons", "2", "--sigma", "Sr=0.1,Ti=0.1"], &["for O"]),
    ];
    for (arguments, parts) in cases {
        let printed = fails(stemgen(here).arg("simulate").args(arguments));
        for part in parts {
            assert!(printed.contains(part), "{arguments:?}: no `{part}` in\n{printed}");
        }
        assert!(printed.matches("(os error").count() < 2, "said twice: {printed}");
    }
    let printed = fails(stemgen(here).args(["simulate", "none.cif"]));
    assert_eq!(printed.matches("No such file").count(), 1, "the reason is told once: {printed}");
    let printed = fails(stemgen(here).args(["simulate", si, "--slice-thickness", "1e-308"]));
    assert!(
        printed.contains("from 0.01 to 1000 A") && printed.contains("--slice-thickness"),
        "{printed}"
    );
    let printed = fails(stemgen(here).args(["simulate", si, "--accuracy", "50%%"]));
    assert!(printed.contains("write per cent"), "{printed}");
    assert_eq!(std::fs::read(here.join("there.h5")).unwrap(), b"precious");
    assert_eq!(std::fs::read_dir(here).unwrap().count(), 4, "nothing was written");
}

#[test]
fn hints_stand_only_where_they_help() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::write(here.join("bad.cif"), "data_x\n_cell_length_a 5\n").unwrap();
    let printed = fails(stemgen(here).args(["simulate", "bad.cif"]));
    assert!(printed.starts_with("error: bad.cif") && !printed.contains("hint"), "{printed}");
    let si = &file("structures/si.cif");
    let printed = fails(stemgen(here).args(["simulate", si, "--dosis", "100"]));
    assert!(printed.contains("--dosis") && !printed.contains("as a value"), "{printed}");
    for (arguments, part) in [
        (["--pixelated", "1"], "`stemgen patterns` simulates diffraction patterns"),
        (["--detector", "DPC=0-20"], "--detector DPC=0-21:4@45 of `stemgen simulate`"),
        (["--beam-tilt", "3"], "take another --zone"),
    ] {
        let printed = fails(stemgen(here).args(["simulate", si]).args(arguments));
        assert!(printed.contains(part) && !printed.contains("as a value"), "{printed}");
    }
    let recipe = std::fs::read_to_string(file("generate/srtio3.toml")).unwrap();
    let two = recipe.split("[difficulty.hard]").next().unwrap();
    std::fs::write(here.join("two.toml"), two).unwrap();
    for tier in [&["--difficulty", "hard"][..], &[]] {
        let printed = fails(stemgen(here).args(["show-recipe", "two.toml"]).args(tier));
        assert!(printed.contains("the recipe has easy, medium"), "{printed}");
    }
}

#[test]
fn bad_builds_are_explained() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bad.toml"), "version = 1\nsede = 3\n").unwrap();
    let easy = ["--difficulty", "easy"];
    let cases: [(&[&str], &str); 7] = [
        (&["srtio4"], "srtio3"),
        (&["srtio3", "--grid", "99x1"], "40x40"),
        (&["srtio3", "--grid", "2"], "rows x columns"),
        (&["srtio3", "--subtile", "-1"], "--subtile"),
        (&["srtio3", "--window", "1"], "--window"),
        (&["--recipe", "none.toml"], "none.toml"),
        (&["--recipe", "bad.toml"], "bad.toml"),
    ];
    for (arguments, part) in cases {
        let printed = fails(stemgen(folder.path()).arg("build").args(arguments).args(easy));
        assert!(printed.contains(part), "{arguments:?}: no `{part}` in\n{printed}");
    }
}

#[cfg(unix)]
#[test]
fn a_folder_that_is_read_only_is_found_before_simulating() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o555)).unwrap();
    let probe = std::fs::write(folder.path().join("probe"), "");
    if probe.is_ok() {
        return skipped("root may write into a folder that is read-only");
    }
    let printed = fails(stemgen(folder.path()).args(["simulate", &file("structures/si.cif")]));
    assert!(printed.contains("--output"), "{printed}");
}
