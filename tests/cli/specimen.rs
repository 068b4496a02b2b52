//! `stemgen specimen`.

use super::{fails, file, json, stderr, stemgen};
use std::path::Path;
use std::process::Command;
use stemgen::io::WorldFile;
use stemgen::structure::{self, Structure};

/// The tiny recipe, with many vacancies.
const VACANCIES: &str = "vacancies={element=\"O\", rate=0.2, cluster_fraction=0.0, \
                         cluster_sigma_nm=1.0, max_probability=0.5}";

fn tiny(folder: &Path, subcommand: &str) -> Command {
    let mut command = stemgen(folder);
    command.args([subcommand, "--recipe", &file("tests/cli/tiny.toml"), "--set", VACANCIES]);
    command
}

fn read(folder: &Path, name: &str) -> Structure {
    structure::read(&folder.join(name)).unwrap()
}

#[test]
fn atoms_are_read_again_from_both_formats() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let plan = json(tiny(here, "specimen").args(["-o", "a.extxyz", "--dry-run"]));
    assert_eq!(std::fs::read_dir(here).unwrap().count(), 0, "a dry run writes nothing");
    let summary = json(tiny(here, "specimen").args(["-o", "a.extxyz"]));
    assert_eq!(plan["estimated_sites"], summary["sites"]);
    let rows = summary["file_bytes"].as_u64().unwrap() - 2000;
    assert!(plan["estimated_file_bytes"].as_u64().unwrap() > rows, "{plan} {summary}");
    let vacant = summary["defects"]["vacancy_O"].as_u64().unwrap();
    let oxygen = summary["atoms"]["O"].as_u64().unwrap();
    assert!((vacant as f64 / (vacant + oxygen) as f64 - 0.2).abs() < 0.15, "{summary}");
    assert_eq!(summary["sites"].as_u64(), summary["rows"].as_u64().map(|n| n + vacant));
    let plain = read(here, "a.extxyz");
    assert_eq!(Some(plain.atoms.len() as u64), summary["rows"].as_u64());
    assert_eq!(plain.atoms.iter().filter(|a| a.number == 8).count() as u64, oxygen);
    let edges = plain.orthogonal_box().unwrap();
    let [height, _] = [0, 1].map(|k| summary["fov_nm"][k].as_f64().unwrap());
    assert!((edges[1] - 10.0 * height - 2.0).abs() < 1e-9, "{edges:?}");
    for name in ["v.xyz", "v.cif"] {
        let all = json(tiny(here, "specimen").args(["-o", name, "--vacancies"]));
        assert_eq!(all["rows"], all["sites"]);
        let again = read(here, name);
        assert_eq!(again.atoms.len(), plain.atoms.len(), "vacant sites are no atoms");
        for (a, b) in again.atoms.iter().zip(&plain.atoms) {
            assert_eq!(a.number, b.number);
            assert!((0..3).all(|k| (a.position[k] - b.position[k]).abs() < 2e-5), "{a:?} {b:?}");
        }
        let plan = json(stemgen(here).args(["simulate", name, "--dry-run"]));
        assert!(plan["probes"].as_u64().unwrap() > 0);
    }
    let text = std::fs::read_to_string(here.join("v.xyz")).unwrap();
    assert_eq!(text.lines().filter(|l| l.contains(" 0 1 vacancy_O ")).count() as u64, vacant);
    assert!(text.lines().nth(1).unwrap().contains("sigma=\"O=0.085,Sr=0.084,Ti=0.06\""));
}

#[test]
fn sites_stand_in_the_order_of_the_ground_truth() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let command = |name| {
        let mut command = tiny(here, name);
        command.args(["--seed", "5", "--quiet"]);
        command
    };
    assert!(command("build").args(["-o", "w.h5", "--no-png"]).status().unwrap().success());
    let run = command("specimen").args(["-o", "a.extxyz", "--vacancies"]).status().unwrap();
    assert!(run.success());
    let world = WorldFile::open(&here.join("w.h5")).unwrap();
    let truth = world.truth(0..world.site_count().unwrap()).unwrap();
    let text = std::fs::read_to_string(here.join("a.extxyz")).unwrap();
    let rows: Vec<Vec<&str>> =
        text.lines().skip(2).map(|l| l.split_whitespace().collect()).collect();
    assert_eq!(rows.len(), truth.types.len());
    let origin = 0.5 * world.metadata().pixel_size_nm + 0.1;
    for (i, row) in rows.iter().enumerate() {
        for k in 0..2 {
            let angstrom: f64 = row[1 + k].parse().unwrap();
            let nm = f64::from(truth.positions[i][k]) + origin;
            assert!((0.1 * angstrom - nm).abs() < 2e-6, "{row:?}");
        }
        assert_eq!(row[5], truth.types[i].to_string());
        assert_eq!(row[6], ["none", &truth.defect_names[i]][usize::from(truth.defects[i])]);
        assert_eq!(row[7], truth.columns[i].to_string());
    }
}

#[test]
fn threads_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |threads: &str| {
        let mut command = stemgen(folder.path());
        command.args(["specimen", "srtio3", "--difficulty", "easy", "--grid", "3x2", "--quiet"]);
        command.args(["-o", "a.extxyz", "--png", "--overwrite", "--threads", threads]);
        let run = command.output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        ["a.extxyz", "a.png"].map(|name| std::fs::read(folder.path().join(name)).unwrap())
    };
    assert!(bytes("1") == bytes("3"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing else is left");
}

#[test]
fn the_picture_shows_elements_and_defects() {
    let folder = tempfile::tempdir().unwrap();
    let run = tiny(folder.path(), "specimen").args(["-o", "a.extxyz", "--png"]).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let file = std::fs::File::open(folder.path().join("a.png")).unwrap();
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert!(info.height == 1600 && info.width > 1700, "the legend stands to the right: {info:?}");
    use stemgen::render::palette;
    let near = |p: &[u8], c: [u8; 3]| (0..3).all(|k| p[k].abs_diff(c[k]) < 40);
    for color in [palette::ELEMENTS[0], palette::ELEMENTS[1], palette::VACANCY] {
        let count = pixels.chunks_exact(3).filter(|p| near(p, color)).count();
        assert!(count > 300, "{color:?}: {count}");
    }
}

#[test]
fn bad_requests_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::write(here.join("there.cif"), "precious").unwrap();
    let cases: [(&[&str], &str); 5] = [
        (&["-o", "a.vasp"], ".extxyz"),
        (&["-o", "there.cif"], "--overwrite"),
        (&["-o", "there.cif/a.xyz"], "there.cif"),
        (&["-o", "a.xyz", "--vacuum", "-1"], "vacuum"),
        (&["-o", "a.xyz", "--grid", "3x3"], "2x2"),
    ];
    for (arguments, part) in cases {
        let printed = fails(tiny(here, "specimen").args(arguments));
        assert!(printed.contains(part), "{arguments:?}: no `{part}` in\n{printed}");
    }
    assert_eq!(std::fs::read(here.join("there.cif")).unwrap(), b"precious");
    assert_eq!(std::fs::read_dir(here).unwrap().count(), 1);
}

#[test]
fn layers_on_the_faces_follow_the_sites() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let without = json(tiny(here, "specimen").args(["-o", "a.extxyz"]));
    let mut command = tiny(here, "specimen");
    command.args(["--set", "surface.entrance_nm=1", "--set", "surface.exit_nm=0.6"]);
    let plan = json(command.args(["-o", "b.extxyz", "--dry-run"]));
    let mut command = tiny(here, "specimen");
    command.args(["--set", "surface.entrance_nm=1", "--set", "surface.exit_nm=0.6"]);
    let with = json(command.args(["-o", "b.extxyz"]));
    let number = |summary: &serde_json::Value, key: &str| summary[key].as_u64().unwrap();
    let carbon = number(&with, "layer_atoms");
    assert_eq!(number(&with, "rows"), number(&without, "rows") + carbon);
    assert_eq!(with["sites"], without["sites"]);
    assert_eq!(number(&without, "layer_atoms"), 0);
    let area: f64 = (0..2).map(|k| 10.0 * with["fov_nm"][k].as_f64().unwrap()).product();
    let expected = 0.1003 * area * 16.0;
    assert!((carbon as f64 / expected - 1.0).abs() < 0.1, "{carbon} of {expected}");
    let planned = number(&plan, "estimated_sites") as f64;
    assert!((planned / number(&with, "rows") as f64 - 1.0).abs() < 0.1, "{plan}");
    let [plain, layered] = ["a.extxyz", "b.extxyz"].map(|name| read(here, name).atoms);
    let (sites, layers) = layered.split_at(plain.len());
    // 10 A of carbon and 2 A to the specimen.
    for (a, b) in sites.iter().zip(&plain) {
        assert!(a.number == b.number && (a.position[2] - b.position[2] - 12.0).abs() < 2e-5);
    }
    let exit = 12.0 + 10.0 * with["thickness_nm"].as_f64().unwrap() + 2.0;
    let before = layers.iter().filter(|a| a.position[2] <= 10.0).count();
    assert!((before as f64 / carbon as f64 - 10.0 / 16.0).abs() < 0.05, "{before} of {carbon}");
    for atom in layers {
        let z = atom.position[2];
        assert!(
            atom.number == 6 && ((0.0..=10.0).contains(&z) || (exit..=exit + 6.0).contains(&z))
        );
    }
    let text = std::fs::read_to_string(here.join("b.extxyz")).unwrap();
    let comment = text.lines().nth(1).unwrap();
    assert!(comment.contains("specimen_face_angstrom=\"12\""), "{comment}");
    assert!(comment.contains("sigma=\"C=0.08,"), "{comment}");
    assert_eq!(text.lines().filter(|l| l.ends_with(" 0 none -1")).count() as u64, carbon);
    assert!(json(stemgen(here).args(["simulate", "b.extxyz", "--dry-run"]))["probes"].is_u64());
}
