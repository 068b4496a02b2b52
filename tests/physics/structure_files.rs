//! Every file in `tests/structures/good` is read, every one in `bad` fails with its expected
//! message, and no mutation of a good file panics.

use super::cases::cases;
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use stemgen::structure::{Format, Structure, elements, min_pair_distance, parse, read};

fn files(kind: &str) -> Vec<PathBuf> {
    let folder =
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join("tests/structures").join(kind);
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_none_or(|e| e != "expected"))
        .collect();
    files.sort();
    assert!(!files.is_empty());
    files
}

fn good(name: &str) -> Structure {
    let folder =
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join("tests/structures/good");
    read(&folder.join(name)).unwrap_or_else(|e| panic!("{e}"))
}

fn count(structure: &Structure, symbol: &str) -> usize {
    structure.atoms.iter().filter(|a| elements::symbol(a.number) == symbol).count()
}

#[track_caller]
fn assert_near(got: f64, expected: f64) {
    assert!((got - expected).abs() < 1e-6 * expected.abs().max(1.0), "{got}, expected {expected}");
}

#[test]
fn good_files_are_read() {
    for path in files("good") {
        let structure = read(&path).unwrap_or_else(|e| panic!("{e}"));
        assert!(!structure.atoms.is_empty());
        assert!(min_pair_distance(&structure).is_some());
    }
}

/// The expected part of the message stands in a sidecar `NAME.expected`, or in the first line
/// after `expected: `.
#[test]
fn bad_files_say_what_is_wrong_and_where() {
    for path in files("bad") {
        let mut sidecar = path.clone().into_os_string();
        sidecar.push(".expected");
        let expected = std::fs::read_to_string(&sidecar).unwrap_or_else(|_| {
            let text = std::fs::read_to_string(&path).unwrap();
            let first = text.lines().next().unwrap_or("");
            first.split_once("expected: ").map(|(_, e)| e.to_owned()).unwrap_or_else(|| {
                panic!("{}: no expected message", path.display());
            })
        });
        let error = match read(&path) {
            Ok(_) => panic!("{}: was read, expected `{}`", path.display(), expected.trim()),
            Err(error) => error.to_string(),
        };
        assert!(error.contains(expected.trim()), "got `{error}`, expected `{}`", expected.trim());
    }
}

#[test]
fn all_operations_of_diamond_give_eight_atoms() {
    let si = good("si_fd3m_origin1.cif");
    assert_eq!(count(&si, "Si"), 8);
    assert_near(min_pair_distance(&si).unwrap(), 5.431 * 3f64.sqrt() / 4.0);
}

#[test]
fn rutile_has_its_published_bonds() {
    let rutile = good("rutile_label_only.cif");
    assert_eq!((count(&rutile, "Ti"), count(&rutile, "O")), (2, 4));
    assert!((min_pair_distance(&rutile).unwrap() - 1.949).abs() < 5e-3);
}

#[test]
fn occupancies_are_kept_per_site() {
    let bst = good("mixed_occupancy.cif");
    assert_eq!(bst.atoms.len(), 6);
    let oxygen: f64 = bst.atoms.iter().filter(|a| a.number == 8).map(|a| a.occupancy).sum();
    assert_near(oxygen, 2.95);
    let resolved = bst.repeat([4, 4, 4]).unwrap().resolve_occupancy(1).unwrap();
    assert_eq!(count(&resolved, "Ba") + count(&resolved, "Sr"), 64);
    assert_eq!(count(&resolved, "Ti"), 64);
    assert!(min_pair_distance(&resolved).unwrap() > 1.9);
}

#[test]
fn one_crystal_in_three_formats() {
    let (xyz, poscar) = (good("srtio3.xyz"), good("POSCAR_srtio3"));
    let cif =
        read(&Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join("structures/srtio3.cif"))
            .unwrap();
    assert_eq!(xyz, poscar);
    assert_eq!(xyz, cif);
}

#[test]
fn left_handed_cells_are_kept() {
    let s = good("left_handed.extxyz");
    assert_eq!(s.cell[0], [0.0, 4.0, 0.0]);
    assert_eq!(s.atoms[1].position, [2.0; 3]);
    assert_eq!(s.oriented([0, 0, 1], None).unwrap().atoms.len(), 2);
}

#[test]
fn poscar_scales() {
    let cu = good("cartesian.vasp");
    assert_near(min_pair_distance(&cu).unwrap(), (4.0 * 11.81f64).cbrt() / 2f64.sqrt());
    let c = good("CONTCAR");
    assert_eq!(c.cell, [[2.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 4.0]]);
    assert_eq!(c.atoms[1].position, [1.0, 1.5, 2.0]);
}

/// One change of a file's bytes.
#[derive(Debug, Clone)]
enum Mutation {
    Replace(usize, u8),
    Insert(usize, u8),
    Remove(usize, usize),
    RepeatLine(usize),
    DropLine(usize),
    SwapWords(usize),
    Truncate(usize),
}

fn mutation() -> impl Strategy<Value = Mutation> {
    let byte = prop_oneof![
        any::<u8>(),
        proptest::sample::select(b"0123456789.-+eE()'\"; \n\r\t#_,xyz/NnIi?{}=:".to_vec())
    ];
    prop_oneof![
        (any::<usize>(), byte.clone()).prop_map(|(i, b)| Mutation::Replace(i, b)),
        (any::<usize>(), byte).prop_map(|(i, b)| Mutation::Insert(i, b)),
        (any::<usize>(), 1usize..20).prop_map(|(i, n)| Mutation::Remove(i, n)),
        any::<usize>().prop_map(Mutation::RepeatLine),
        any::<usize>().prop_map(Mutation::DropLine),
        any::<usize>().prop_map(Mutation::SwapWords),
        any::<usize>().prop_map(Mutation::Truncate),
    ]
}

fn mutate(bytes: &mut Vec<u8>, mutation: &Mutation) {
    let size = bytes.len().max(1);
    let mut lines: Vec<Vec<u8>> = bytes.split(|&b| b == b'\n').map(<[u8]>::to_vec).collect();
    match *mutation {
        Mutation::Replace(i, b) => {
            if let Some(target) = bytes.get_mut(i % size) {
                *target = b;
            }
        }
        Mutation::Insert(i, b) => bytes.insert(i % (bytes.len() + 1), b),
        Mutation::Remove(i, n) => {
            let start = (i % size).min(bytes.len());
            bytes.drain(start..(start + n).min(bytes.len()));
        }
        Mutation::RepeatLine(i) => {
            let i = i % lines.len();
            lines.insert(i, lines[i].clone());
            *bytes = lines.join(&b'\n');
        }
        Mutation::DropLine(i) => {
            lines.remove(i % lines.len());
            *bytes = lines.join(&b'\n');
        }
        Mutation::SwapWords(i) => {
            let i = i % lines.len();
            let mut words: Vec<&[u8]> = lines[i].split(|&b| b == b' ').collect();
            words.reverse();
            lines[i] = words.join(&b' ');
            *bytes = lines.join(&b'\n');
        }
        Mutation::Truncate(i) => bytes.truncate(i % size),
    }
}

proptest! {
    #![proptest_config(cases(3000))]

    #[test]
    fn mutated_files_never_panic(
        file in any::<usize>(),
        mutations in proptest::collection::vec(mutation(), 1..6),
    ) {
        let files = files("good");
        let path = &files[file % files.len()];
        let mut bytes = std::fs::read(path).unwrap();
        for m in &mutations {
            mutate(&mut bytes, m);
        }
        if let Ok(structure) = parse(Format::from_path(path).unwrap(), &bytes, path) {
            prop_assert!(structure.atoms.iter().all(|a| a.position.iter().all(|x| x.is_finite())));
            prop_assert!(structure.atoms.iter().all(|a| a.occupancy > 0.0 && a.occupancy <= 1.0));
        }
    }

    #[test]
    fn random_text_never_panics(text in "\\PC{0,200}", kind in 0usize..3) {
        let format = [Format::ExtXyz, Format::Cif, Format::Poscar][kind];
        let _ = parse(format, text.as_bytes(), Path::new("random"));
    }
}
