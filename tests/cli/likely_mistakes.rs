//! Input that is possible, but hardly meant: it is read right, refused, or said.

use super::{fails, file, json, stemgen};
use std::path::Path;

/// The warnings of a dry run of `simulate`.
fn warnings(folder: &Path, arguments: &[&str]) -> Vec<String> {
    let mut command = stemgen(folder);
    let plan = json(command.arg("simulate").args(arguments).arg("--dry-run"));
    plan["warnings"].as_array().unwrap().iter().map(|w| w.as_str().unwrap().to_owned()).collect()
}

/// The one that holds a text.
#[track_caller]
fn printed(folder: &Path, arguments: &[&str], part: &str) -> String {
    let all = warnings(folder, arguments);
    let found = all.iter().find(|w| w.contains(part));
    found.unwrap_or_else(|| panic!("{arguments:?}: no `{part}` in {all:?}")).clone()
}

#[test]
fn crops_narrower_than_the_probe_give_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let run = |more: &[&'static str]| {
        let srtio3 = file("structures/srtio3.cif");
        let wide = ["--repeat", "10,10,4", "--scan-end", "3.905,3.905", "--scan-points", "4,4"];
        let all: Vec<String> = std::iter::once(srtio3)
            .chain(wide.iter().chain(more).map(|s| (*s).to_owned()))
            .collect();
        let words: Vec<&str> = all.iter().map(String::as_str).collect();
        warnings(here, &words)
    };
    let prism = run(&["--defocus", "300", "--engine", "prism", "--interpolation", "4"]);
    assert!(
        prism[0].contains("9.8 A wide, but inside the specimen the probe is 14.1 A"),
        "{prism:?}"
    );
    assert!(prism[0].contains("use a crop of 20.4 A"), "{prism:?}");
    assert!(run(&["--defocus", "300"]).is_empty());
    assert!(run(&["--engine", "prism", "--interpolation", "4"]).is_empty());
    let window = run(&["--aberration", "C30=1.2e7", "--engine", "window"]);
    assert!(window[0].contains("use a cell of"), "{window:?}");
    let cell = run(&["--aberration", "C30=1.2e7"]);
    assert!(cell[0].contains("meets its own periodic images"), "{cell:?}");
    let window = run(&["--aberration", "C30=1e6", "--engine", "window"]);
    assert!(window[0].contains("a window of 26."), "{window:?}");
    let tem = run(&["--aberration", "C30=1e6", "--defocus", "500"]);
    assert!(tem.is_empty(), "{tem:?}");
}

#[test]
fn options_of_other_programs_get_the_name_that_they_have_here() {
    let folder = tempfile::tempdir().unwrap();
    for (words, part) in [
        (&["--convergence", "25"][..], "--semiangle MRAD"),
        (&["--voltage", "80"], "--energy KV"),
        (&["--energy-kv", "80"], "--energy KV"),
        (&["--mistilt", "1,2"], "--tilt X,Y"),
        (&["--gpu"], "does not use GPUs"),
    ] {
        let said = fails(stemgen(folder.path()).args(["simulate", "si.cif"]).args(words));
        assert!(said.contains(part) && said.contains(words[0]), "{words:?}: {said}");
    }
}

#[test]
fn a_cell_is_strained_within_the_limit_and_the_file_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let relaxed = file("tests/structures/good/nearly_orthogonal.vasp");
    let refused = fails(stemgen(here).args(["simulate", &relaxed]));
    assert!(refused.contains("--max-strain PERCENT"), "{refused}");
    let refused = fails(stemgen(here).args(["simulate", &relaxed, "--max-strain", "0.01"]));
    assert!(refused.contains("allow more strain") && refused.contains("--max-strain"), "{refused}");
    let arguments = [&relaxed, "--max-strain", "0.1%"];
    let warning = printed(here, &arguments, "the cell was strained by 0.0");
    assert!(warning.contains("to make its angles 90 degrees"), "{warning}");
    let mut command = stemgen(here);
    command.arg("simulate").args(arguments).args(["--scan-points", "2,2", "--quiet", "-o", "s.h5"]);
    assert!(command.output().unwrap().status.success());
    let specimen = hdf5::File::open(here.join("s.h5")).unwrap().group("specimen").unwrap();
    let strain: f64 = specimen.attr("strain_percent").unwrap().read_scalar().unwrap();
    assert!((0.035..0.045).contains(&strain), "{strain}");
}

#[test]
fn four_indices_are_those_of_a_hexagonal_lattice() {
    let folder = tempfile::tempdir().unwrap();
    let gan = &file("structures/gan.cif");
    let size = |zone: &str| {
        let mut command = stemgen(folder.path());
        json(command.args(["simulate", gan, "--dry-run", "--zone", zone]))["box_angstrom"].clone()
    };
    assert_eq!(size("2,-1,-1,0"), size("1,0,0"));
    let refused = fails(stemgen(folder.path()).args(["simulate", gan, "--zone", "1,1,1,0"]));
    assert!(refused.contains("must add to 0"), "{refused}");
}

#[test]
fn azimuths_in_degrees_and_thicknesses_of_one_slice_give_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let si = &file("structures/si.cif");
    printed(here, &[si, "--aberration", "C12=30@45"], "45 degrees are 0.7854 rad");
    printed(here, &[si, "--thicknesses", "2.6,2.8"], "images are recorded at 2.7");
}

#[test]
fn files_of_other_programs_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for (name, part) in [
        ("x.pdb", "a PDB file, which is not read; convert it with ASE"),
        ("x.mrc", "an MRC file"),
        ("x.lammpstrj", "a dump file of LAMMPS"),
    ] {
        let refused = fails(stemgen(here).args(["simulate", name]));
        assert!(refused.contains(part), "{refused}");
    }
}

/// Whether by its name or by what it holds: a file of LAMMPS or a PDB file is named, with the line of Python that converts it.
#[test]
fn files_of_lammps_and_of_proteins_are_named_with_the_way_to_convert_them() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let bad = |name: &str| std::fs::read(file(&format!("tests/structures/bad/{name}"))).unwrap();
    let data =
        ["a data file of LAMMPS", "read(\"FILE.data\", format=\"lammps-data\"", "Z_of_type="];
    let dump =
        ["a dump file of LAMMPS", "read(\"FILE.dump\", format=\"lammps-dump-text\"", "specorder="];
    let pdb = ["a PDB file", "read(\"FILE.pdb\")", "write(\"atoms.xyz\""];
    for (names, content, parts) in [
        (["a.lmp", "a.data", "a.xyz"], bad("lammps_data.xyz"), data),
        (["b.dump", "b.lammpstrj", "b.xyz"], bad("dump.xyz"), dump),
        (["c.pdb", "c.ent", "c.xyz"], bad("protein.xyz"), pdb),
    ] {
        for name in names {
            std::fs::write(here.join(name), &content).unwrap();
            let refused = fails(stemgen(here).args(["simulate", name]));
            for part in parts.iter().chain(&[name, "from ase.io import read, write"]) {
                assert!(refused.contains(part), "{name}: no `{part}` in {refused}");
            }
        }
    }
}

#[test]
fn frames_of_an_xdatcar_are_simulated() {
    let folder = tempfile::tempdir().unwrap();
    let trajectory = &file("tests/structures/bad/XDATCAR_two_frames");
    let refused = fails(stemgen(folder.path()).args(["simulate", trajectory]));
    assert!(refused.contains("--frames"), "{refused}");
    let mut command = stemgen(folder.path());
    let plan = json(command.args(["simulate", trajectory, "--frames", "all", "--dry-run"]));
    assert_eq!(plan["atoms"], 2);
}
