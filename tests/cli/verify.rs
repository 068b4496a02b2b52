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
fn a_sound_world_and_each_fault_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    built(here);
    let output = stemgen(here).args(["verify", "w.h5"]).output().unwrap();
    assert!(output.status.success(), "{}{}", stdout(&output), stderr(&output));
    let printed = stdout(&output);
    assert!(printed.contains("w.h5 is sound") && printed.contains("standard errors"), "{printed}");
    assert!(!printed.contains("FAULT") && !printed.contains("skipped"), "{printed}");

    // Pixel (0, 13) is shared with the tile to the right.
    damaged(here, |f| tile(f, "tiles/0_1", |t| t[[0, 1]] = 1.0 - t[[0, 1]]));
    let printed = faults(here);
    assert!(printed[0].starts_with("tiles: /tiles/0_1 differs from a neighbour"), "{printed:?}");
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
    let printed = faults(here);
    assert!(printed[0].starts_with("attributes: `dose_electrons_per_angstrom2`"), "{printed:?}");
    assert!(
        printed[1].starts_with("counts: mean and scatter") && printed.len() == 2,
        "{printed:?}"
    );
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
    let printed = faults(here);
    assert!(printed[0].contains("has type 1 and the defect type ``"), "{printed:?}");
    assert!(printed[1].starts_with("columns: column 0 lists"), "{printed:?}");
    damaged(here, |f| tile(f, "overview", |o| o[[1, 1]] += 0.01));
    assert!(fault(here).starts_with("overview: differs"), "{}", fault(here));
    damaged(here, |f| {
        let positions = f.dataset("ground_truth/atom_positions").unwrap();
        let mut values = positions.read_2d::<f32>().unwrap();
        values[[5, 0]] = 90.0;
        positions.write(&values).unwrap();
    });
    let printed = faults(here);
    assert!(printed[0].contains("site 5 lies at x 90"), "{printed:?}");
    assert!(printed[1].contains("site 5 lies beside its column"), "{printed:?}");
    damaged(here, |f| tile(f, "overview", |o| o[[1, 1]] = f32::NAN));
    assert!(fault(here).starts_with("overview: differs"), "{}", fault(here));
    damaged(here, |f| {
        let lines = f.group("ground_truth/grain_boundaries").unwrap();
        let points = ndarray::arr2(&[[0.1_f32, 0.1], [f32::NAN, 0.2]]);
        lines.new_dataset_builder().with_data(&points).create("0").unwrap();
    });
    assert!(fault(here).contains("boundaries at NaN nm"), "{}", fault(here));
    let attribute = |f: &hdf5::File, group: &str, name: &str, value: f64| {
        f.group(group).unwrap().attr(name).unwrap().write_scalar(&value).unwrap();
    };
    for (group, name, value) in [
        ("metadata", "dose_electrons_per_angstrom2", -1e5),
        ("metadata", "dose_electrons_per_angstrom2", f64::NAN),
        ("tiles", "scale", 0.0),
    ] {
        damaged(here, |f| attribute(f, group, name, value));
        let printed = fault(here);
        assert!(
            printed.starts_with("schema:") && printed.contains(name.split('_').next().unwrap()),
            "{printed}"
        );
    }
}

#[test]
fn what_is_no_world_is_reported() {
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

/// Changes one value of a list of the truth.
fn changed<T: hdf5::H5Type>(file: &hdf5::File, list: &str, at: usize, value: T) {
    let dataset = file.dataset(&format!("ground_truth/{list}")).unwrap();
    let mut values = dataset.read_raw::<T>().unwrap();
    values[at] = value;
    dataset.write_raw(&values).unwrap();
}

/// Puts another dataset in the place of one.
fn replaced<T: hdf5::H5Type, D: ndarray::Dimension>(
    file: &hdf5::File,
    name: &str,
    values: &ndarray::Array<T, D>,
) {
    file.unlink(name).unwrap();
    file.new_dataset_builder().with_data(values).create(name).unwrap();
}

#[test]
fn lists_that_contradict_each_other_are_reported() {
    use hdf5::types::{FixedAscii, VarLenUnicode};
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    built(here);
    let printed = |change: &dyn Fn(&hdf5::File)| {
        damaged(here, change);
        fault(here)
    };
    for depth in [f32::NAN, 7.0] {
        let fault = printed(&|f| changed(f, "atom_z", 3, depth));
        assert!(fault.starts_with("sites: site 3 lies at a depth of"), "{fault}");
    }
    let name = FixedAscii::<16>::from_ascii("vacancy_O").unwrap();
    let pristine = |f: &hdf5::File| {
        let types = f.dataset("ground_truth/atom_types").unwrap().read_1d::<i32>().unwrap();
        types.iter().position(|t| *t == 0).unwrap()
    };
    let fault = printed(&|f| changed(f, "defect_types", pristine(f), name));
    assert!(fault.contains("has type 0 and the defect type `vacancy_O`"), "{fault}");
    let fault = printed(&|f| changed(f, "atomic_numbers", pristine(f), 74));
    assert!(fault.starts_with("columns: column") && fault.contains("its sites hold other atoms"));
    let fault = printed(&|f| {
        let place = f.dataset("ground_truth/columns/position").unwrap();
        let x = place.read_raw::<f32>().unwrap()[4];
        changed(f, "columns/position", 4, x + 0.02);
    });
    assert!(fault.starts_with("columns: column 2 is listed at x"), "{fault}");
    let text = FixedAscii::<32>::from_ascii("W3").unwrap();
    let fault = printed(&|f| changed(f, "columns/composition", 1, text));
    assert!(fault.starts_with("columns: column 1 is listed as `W3`"), "{fault}");

    let fault = printed(&|f| {
        let wide = f.dataset("tiles/1_0").unwrap().read_2d::<f32>().unwrap().mapv(f64::from);
        replaced(f, "tiles/1_0", &wide);
    });
    assert!(fault.contains("/tiles/1_0 holds float64, expected float32"), "{fault}");
    let fault = printed(&|f| {
        let mask = f.dataset("ground_truth/defect_mask").unwrap().read_1d::<bool>().unwrap();
        replaced(f, "ground_truth/defect_mask", &mask.mapv(u8::from));
    });
    assert!(fault.contains("defect_mask holds uint8, expected bool"), "{fault}");
    let fault = printed(&|f| replaced(f, "valid_region", &ndarray::arr2(&[[true, false]])));
    assert!(fault.contains("/valid_region has the shape [1, 2]"), "{fault}");
    let fault = printed(&|f| f.unlink("valid_region").unwrap());
    assert!(fault.contains("has no dataset /valid_region"), "{fault}");

    let fault = printed(&|f| f.group("metadata").unwrap().delete_attr("seed").unwrap());
    assert!(fault.starts_with("attributes: `seed` is missing"), "{fault}");
    let fault = printed(&|f| {
        let other: VarLenUnicode = "batio3".parse().unwrap();
        let metadata = f.group("metadata").unwrap();
        metadata.delete_attr("material").unwrap();
        metadata.new_attr_builder().with_data(&[other]).create("material").unwrap();
    });
    assert!(fault.starts_with("attributes: `material`"), "{fault}");
    let fault = printed(&|f| {
        let attribute = f.group("metadata").unwrap().attr("origin_px_in_full_field").unwrap();
        attribute.write_raw(&[3i64, 4]).unwrap();
    });
    assert!(fault.starts_with("attributes: `origin_px_in_full_field`"), "{fault}");
    let fault = printed(&|f| {
        f.dataset("overview").unwrap().attr("factor").unwrap().write_scalar(&5u64).unwrap();
    });
    assert!(fault.starts_with("attributes: `factor of /overview`"), "{fault}");
}
