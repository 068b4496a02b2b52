//! No result replaces what a command reads, another result, or anything that is no file; and what cannot be written at the end is
//! found before any work.

use super::{fails, file, stderr, stemgen};
use std::path::Path;
use std::process::Command;

fn built(folder: &Path) {
    let mut command = stemgen(folder);
    command.args(["build", "--recipe", &file("tests/cli/tiny.toml"), "--no-png", "-o", "w.h5"]);
    let run = command.output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
}

#[test]
fn inputs_are_not_replaced_even_when_overwriting() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    built(here);
    for (from, to) in [("structures/si.cif", "si.cif"), ("tests/cli/tiny.toml", "r.toml")] {
        std::fs::copy(file(from), here.join(to)).unwrap();
    }
    std::fs::copy(here.join("w.h5"), here.join("v.h5")).unwrap();
    let before: Vec<Vec<u8>> =
        ["w.h5", "v.h5", "si.cif", "r.toml"].map(|n| std::fs::read(here.join(n)).unwrap()).into();
    let cases: [&[&str]; 8] = [
        &["view", "w.h5", "-o", "w.h5"],
        &["view", "w.h5", "-o", "./w.h5", "--html"],
        &["compare", "w.h5", "v.h5", "-o", "w.h5"],
        &["compare", "w.h5", "v.h5", "-o", "v.h5"],
        &["simulate", "si.cif", "-o", "si.cif"],
        &["build", "--recipe", "r.toml", "-o", "r.toml"],
        &["specimen", "--recipe", "r.toml", "-o", "./r.toml"],
        &["validate", "--reference", "w.h5", "--structure", "si.cif", "-o", "w.h5"],
    ];
    for arguments in cases {
        let printed = fails(stemgen(here).args(arguments).arg("--overwrite"));
        // `specimen` and `validate` may find another fault first
        let early = ["specimen", "validate"].contains(&arguments[0]);
        assert!(early || printed.contains("is read by this command"), "{arguments:?}: {printed}");
    }
    let after = ["w.h5", "v.h5", "si.cif", "r.toml"].map(|n| std::fs::read(here.join(n)).unwrap());
    assert!(before == after, "an input was changed");
}

#[test]
fn a_picture_never_replaces_its_world() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = file("tests/cli/tiny.toml");
    let build = |arguments: &[&str]| {
        let mut command = stemgen(folder.path());
        command.args(["build", "--recipe", &recipe, "--overwrite"]).args(arguments);
        command
    };
    let printed = fails(&mut build(&["-o", "x.png"]));
    assert!(printed.contains("x.png") && printed.contains("written twice"), "{printed}");
    let printed = fails(&mut build(&["-o", "/dev/null"]));
    assert!(printed.contains("no regular file"), "{printed}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let printed = fails(&mut build(&["-o", "x.png", "--no-png"]));
    assert!(printed.contains("did you mean x.h5?"), "{printed}");
    std::fs::write(folder.path().join("file"), "").unwrap();
    let printed = fails(&mut build(&["-o", "file/x.h5"]));
    assert!(printed.contains("would lie in file, which is a file"), "{printed}");
}

/// Names that the file system takes, but not with an ending more, or not HDF5.
#[cfg(unix)]
#[test]
fn names_that_fail_at_the_end_fail_at_the_beginning() {
    use std::ffi::OsString;
    use std::os::unix::ffi::OsStringExt;
    let folder = tempfile::tempdir().unwrap();
    let long = OsString::from("a".repeat(247) + ".h5");
    let odd = OsString::from_vec(b"w\xff.h5".to_vec());
    for name in [long, odd] {
        let mut command: Command = stemgen(folder.path());
        command.args(["build", "srtio3", "--difficulty", "hard", "--no-png", "-o"]).arg(&name);
        let printed = fails(&mut command);
        // Nothing was simulated: that would have been told, stage by stage.
        assert!(
            !printed.contains("simulating") && printed.lines().count() <= 2,
            "{name:?}: {printed}"
        );
        let why = if name.to_str().is_some() { "too long" } else { "no text in UTF-8" };
        assert!(printed.contains(why), "{name:?}: {printed}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{name:?}: {printed}");
    }
}

#[test]
fn optics_that_no_probe_has_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let si = file("structures/si.cif");
    for arguments in [
        ["--aberration", "C12=1@1e308"],
        ["--defocus", "1e308"],
        ["--energy", "1"],
        ["--semiangle", "5e-324"],
    ] {
        let printed = fails(stemgen(folder.path()).arg("simulate").arg(&si).args(arguments));
        assert!(
            printed.contains("must be between") || printed.contains("must be below"),
            "{printed}"
        );
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
