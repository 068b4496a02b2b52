//! Any output path is refused or written, and nothing else is touched.

use super::cases::cases;
use super::stemgen;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};

/// Everything below a folder: contents of files, targets of links.
fn snapshot(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let kind = fs::symlink_metadata(&path).unwrap();
        if kind.is_symlink() {
            let target = fs::read_link(&path).unwrap();
            found.insert(path, target.into_os_string().into_vec());
        } else if kind.is_dir() {
            found.insert(path.clone(), b"folder".to_vec());
            found.extend(snapshot(&path));
        } else {
            let bytes = fs::read(&path).unwrap();
            found.insert(path, bytes);
        }
    }
    found
}

/// A folder with things to run into.
fn place() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let here = &inner(&folder);
    fs::create_dir_all(here.join("folder")).unwrap();
    for name in ["file", "there.xyz", "folder/there.xyz", "there.png"] {
        fs::write(here.join(name), format!("precious {name}")).unwrap();
    }
    let link = |to: &str, name: &str| std::os::unix::fs::symlink(to, here.join(name)).unwrap();
    link("there.xyz", "link.xyz");
    link("nowhere.xyz", "dangling.xyz");
    link("folder", "way");
    link("round", "round");
    fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/cli/tiny.toml"), here.join("in.toml"))
        .unwrap();
    folder
}

fn inner(folder: &tempfile::TempDir) -> PathBuf {
    folder.path().join("a/b/c")
}

/// Parts of paths: usual, odd, long, not UTF-8, and what is there.
fn part() -> impl Strategy<Value = Vec<u8>> {
    let there = [
        "folder",
        "file",
        "there.xyz",
        "link.xyz",
        "dangling.xyz",
        "way",
        "round",
        "in.toml",
        ".",
        "..",
        "",
        "new",
        "a b.xyz",
        "-x.xyz",
        "x.cif",
        "x",
        "'q'.xyz",
        "\u{3b1}.xyz",
        "x.xyz.lock",
        "x.xyz.partial",
    ];
    let there: Vec<Vec<u8>> = there.iter().map(|t| t.as_bytes().to_vec()).collect();
    prop_oneof![
        8 => proptest::sample::select(there),
        1 => (1usize..300).prop_map(|n| [vec![b'l'; n], b".xyz".to_vec()].concat()),
        1 => proptest::collection::vec(1u8..=255, 1..6).prop_map(|v| {
            v.into_iter().filter(|b| *b != b'/').chain(*b".xyz").collect()
        }),
    ]
}

#[test]
fn any_output_is_refused_or_written_and_nothing_else_is_touched() {
    let parts = proptest::collection::vec(part(), 1..4);
    let mut runner = TestRunner::new(cases(150));
    let mut written = 0;
    let count = std::cell::Cell::new(0);
    runner
        .run(&(parts, any::<bool>()), |(parts, overwrite)| {
            let folder = place();
            let here = &inner(&folder);
            let before = snapshot(folder.path());
            let output = OsString::from_vec([b"./".to_vec(), parts.join(&b'/')].concat());
            // Two folders up at most, which is within the folder of the test.
            let mut command = stemgen(here);
            command.args(["specimen", "--recipe", "in.toml"]).arg(joined("--output=", &output));
            if overwrite {
                command.arg("--overwrite");
            }
            let ended = command.output().unwrap();
            let printed = super::stderr(&ended);
            let code = ended.status.code();
            prop_assert!(
                matches!(code, Some(0..=2)) && !printed.contains("panicked"),
                "{output:?}: {printed}"
            );
            let after = snapshot(folder.path());
            let target = here.join(&output);
            let changed: Vec<&PathBuf> = before
                .keys()
                .chain(after.keys())
                .filter(|p| {
                    before.get(*p) != after.get(*p) && after.get(*p).is_none_or(|v| v != b"folder")
                })
                .collect();
            if code == Some(0) {
                count.set(count.get() + 1);
                prop_assert!(target.is_file(), "{output:?}");
                let real = target.canonicalize().unwrap();
                let other = changed.iter().find(|p| p.canonicalize().ok() != Some(real.clone()));
                prop_assert!(other.is_none(), "{output:?}: {other:?}");
            } else {
                prop_assert!(changed.is_empty(), "{output:?}: {changed:?} {printed}");
            }
            Ok(())
        })
        .unwrap();
    written += count.get();
    assert!(written >= 10, "{written} of 150 outputs were written");
}

fn joined(option: &str, value: &OsString) -> OsString {
    let mut all = OsString::from(option);
    all.push(value);
    all
}
