//! The program as a user meets it.

mod acquire;
mod build;
mod cache;
mod card;
mod checks;
mod compare;
mod detectability;
#[path = "../common/dm_bytes.rs"]
mod dm_bytes;
mod docs;
mod errors;
mod every_specimen;
mod help;
mod import;
mod info;
#[path = "../common/python.rs"]
mod interpreter;
mod likely_mistakes;
mod live;
mod outputs;
mod patterns;
#[path = "../common/points.rs"]
mod points;
mod recipes;
mod released;
mod requests;
mod shards;
mod simulate;
#[path = "../common/skipped.rs"]
mod skipped;
mod specimen;
#[cfg(unix)]
mod strangers;
mod style;
mod tiles;
mod validate;
mod verify;
mod view;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

/// The program, run in `folder` as on a machine of two cores, with a library of the folder's own in place of the user's.
fn stemgen(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stemgen"));
    command.current_dir(folder).stdin(std::process::Stdio::null());
    command.env("STEMGEN_CACHE", cache(folder)).env("RAYON_NUM_THREADS", "2");
    command
}

/// Where the program keeps its library when it runs in `folder`, whose name is no other's: not in it, where tests count files. What
/// the last run left is removed.
fn cache(folder: &Path) -> PathBuf {
    static ALL: LazyLock<PathBuf> = LazyLock::new(|| {
        let all = Path::new(env!("CARGO_TARGET_TMPDIR")).join("libraries-of-cli");
        if all.exists() {
            std::fs::remove_dir_all(&all).unwrap();
        }
        all
    });
    let name = folder.to_str().unwrap().replace('/', "_");
    ALL.join(name)
}

/// A file of this repository.
fn file(name: &str) -> String {
    format!("{}/{name}", concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Runs a command that has to fail, with one error and at most one hint; returns what it says.
fn fails(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let printed = stderr(&output);
    let code = output.status.code();
    assert!(code == Some(1) || code == Some(2), "{command:?}: {code:?} {printed}");
    assert!(!printed.contains("panicked"), "{printed}");
    assert_eq!(printed.matches("error: ").count(), 1, "{printed}");
    if code == Some(1) {
        assert!(printed.lines().filter(|l| l.starts_with("hint: ")).count() <= 1, "{printed}");
    }
    printed
}

/// Runs the program and returns its standard output, which must be JSON.
fn json(command: &mut Command) -> serde_json::Value {
    let output = command.arg("--json").output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_str(&stdout(&output)).unwrap()
}

/// Runs a script of this folder with a Python that has h5py; returns what it prints.
fn python(script: &str, arguments: &[&Path]) -> String {
    let script = file(&format!("tests/cli/{script}"));
    let run = Command::new(interpreter::with_h5py()).arg(script).args(arguments).output().unwrap();
    assert!(run.status.success(), "{}{}", stdout(&run), stderr(&run));
    stdout(&run)
}
