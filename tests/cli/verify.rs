//! `stemgen verify`.

use super::{file, stderr, stdout, stemgen};
use std::path::Path;

/// A world of 2 x 2 tiles with its noise-free image.
fn built(folder: &Path) {
    let mut command = stemgen(folder);
    command.args(["build", "--recipe", &file("tests/cli/tiny.toml"), "--keep-clean"]);
    command.args(["--set", "field.thickness_nm=0.4", "--audit", "0", "--no-png", "--quiet"]);
    let output = command.args(["-o", "w.h5"]).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}

/// Changes a copy of the world.
fn damaged(folder: &Path, change: impl FnOnce(&hdf5::File)) {
    std::fs::copy(folder.join("w.h5"), folder.join("bad.h5")).unwrap();
    let file = hdf5::File::open_rw(folder.join("bad.h5")).unwrap();
    change(&file);
    file.close().unwrap();
}

/// The faults of the changed copy, which ends with 3, a line for each.
fn faults(folder: &Path) -> Vec<String> {
    let output = stemgen(folder).args(["verify", "bad.h5", "--json"]).output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let report: serde_json::Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert_eq!(report["sound"], false);
    let checks = report["checks"].as_array().unwrap();
    let faults = checks.iter().filter(|c| c["outcome"] == "fault");
    let text = |c: &serde_json::Value, key: &str| c[key].as_str().unwrap().to_owned();
    faults.map(|c| format!("{}: {}", text(c, "what"), text(c, "found"))).collect()
}

/// The only fault.
fn fault(folder: &Path) -> String {
    let mut faults = faults(folder);
    assert_eq!(faults.len(), 1, "{faults:?}");
    faults.remove(0)
}

fn tile(file: &hdf5::File, name: &str, change: impl FnOnce(&mut ndarray::Array2<f32>)) {
    let dataset = file.dataset(name).unwrap();
    let mut values = dataset.read_2d::<f32>().unwrap();
    change(&mut values);
    dataset.write(&values).unwrap();
}

#[test]
fn a_sound_world_and_each_fault_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    built(here);
    let output = stemgen(here).args(["verify", "w.h5"]).output().unwrap();
    assert!(output.status.success(), "{}{}", stdout(&output), stderr(&output));
    let told = stdout(&output);
    assert!(told.contains("w.h5 is sound") && told.contains("standard errors"), "{told}");
    assert!(!told.contains("FAULT") && !told.contains("skipped"), "{told}");

    // Pixel (0, 13) is shared with the tile to the right.
    damaged(here, |f| tile(f, "tiles/0_1", |t| t[[0, 1]] = 1.0 - t[[0, 1]]));
    let told = faults(here);
    assert!(told[0].starts_with("tiles: /tiles/0_1 differs from a neighbour"), "{told:?}");
    damaged(here, |f| tile(f, "tiles/1_1", |t| t[[9, 9]] = -0.5));
    assert!(faults(here)[0].starts_with("tiles: /tiles/1_1 has values from -0.5"));
    damaged(here, |f| tile(f, "tiles/1_1", |t| t[[9, 9]] *= 0.97));
    assert!(faults(here).iter().any(|f| f.starts_with("counts: /tiles/1_1 holds")));
    // Electrons at twice the dose, which the file says otherwise.
    damaged(here, |f| {
        let attribute = f.group("metadata").unwrap().attr("dose_electrons_per_angstrom2").unwrap();
        let dose = attribute.read_scalar::<f64>().unwrap();
        attribute.write_scalar(&(2.0 * dose)).unwrap();
    });
    assert!(fault(here).starts_with("counts: mean and scatter"), "{}", fault(here));
    damaged(here, |f| {
        let types = f.dataset("ground_truth/atom_types").unwrap();
        let mut values = types.read_1d::<i32>().unwrap();
        let pristine = values.iter().position(|t| *t == 0).unwrap();
        values[pristine] = 1;
        types.write(&values).unwrap();
        let mask = f.dataset("ground_truth/defect_mask").unwrap();
        let mut values = mask.read_1d::<bool>().unwrap();
        values[pristine] = true;
        mask.write(&values).unwrap();
    });
    assert!(fault(here).starts_with("columns: column"), "{}", fault(here));
    damaged(here, |f| tile(f, "overview", |o| o[[1, 1]] += 0.01));
    assert!(fault(here).starts_with("overview: differs"), "{}", fault(here));
    damaged(here, |f| {
        let positions = f.dataset("ground_truth/atom_positions").unwrap();
        let mut values = positions.read_2d::<f32>().unwrap();
        values[[5, 0]] = 90.0;
        positions.write(&values).unwrap();
    });
    assert!(fault(here).contains("site 5 lies at x 90"), "{}", fault(here));
}

#[test]
fn what_is_no_world_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::write(here.join("no.h5"), b"text").unwrap();
    let output = stemgen(here).args(["verify", "no.h5"]).output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(stdout(&output).contains("FAULT"), "{}", stdout(&output));
    let output = stemgen(here).args(["verify", "nothing.h5"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stdout(&output));
    assert!(stderr(&output).contains("nothing.h5"), "{}", stderr(&output));
}
