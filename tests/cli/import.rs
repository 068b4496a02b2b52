//! `stemgen import`: worlds of recorded images.

use super::dm_bytes::{DM4, document, floats, image};
use super::{fails, json, stderr, stdout, stemgen};
use std::path::Path;

/// Rows and columns of the image, which is a lattice of 16 pixels.
const SHAPE: [usize; 2] = [260, 390];

fn brightness(row: usize, column: usize) -> f32 {
    let wave = |k: usize| (2.0 * std::f32::consts::PI * k as f32 / 16.0).cos();
    // A number without a period (S. Vigna's splitmix64).
    let mixed = (row * SHAPE[1] + column) as u64;
    let mixed = mixed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let noise = ((mixed ^ (mixed >> 27)) >> 40) as f32 / (1 << 24) as f32;
    1000.0 + 100.0 * (wave(row) + wave(column)) + 20.0 * noise
}

fn values(shape: [usize; 2]) -> Vec<f32> {
    (0..shape[0] * shape[1]).map(|k| brightness(k / shape[1], k % shape[1])).collect()
}

/// Writes `NAME.npy`, single precision.
fn npy(folder: &Path, name: &str, shape: [usize; 2]) {
    let [rows, columns] = shape;
    let header =
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {columns}), }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(values(shape).iter().flat_map(|v| v.to_le_bytes()));
    std::fs::write(folder.join(name), bytes).unwrap();
}

fn dm4(folder: &Path, name: &str, unit: &'static str) -> Vec<u8> {
    let [rows, columns] = SHAPE.map(|n| n as u32);
    let data = floats(DM4, values(SHAPE));
    let one = image("HAADF", &[columns, rows], 2, 6, data, (0.025, unit));
    let bytes = DM4.file(document(vec![one]));
    std::fs::write(folder.join(name), &bytes).unwrap();
    bytes
}

fn runs(folder: &Path, arguments: &[&str]) -> String {
    let output = stemgen(folder).args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    stdout(&output)
}

/// Names of the files of a folder.
fn files(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn an_image_becomes_a_world_that_all_commands_read() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    dm4(here, "a.dm4", "nm");
    let printed = runs(here, &["import", "a.dm4", "-o", "w.h5"]);
    for part in ["DM4, HAADF, 200 keV, 260 x 390 pixels", "2 x 3, of its first 252 x 376", "0.025"]
    {
        assert!(printed.contains(part), "no `{part}` in\n{printed}");
    }
    let printed = runs(here, &["verify", "w.h5"]);
    assert!(printed.contains("is sound") && !printed.contains("FAULT"), "{printed}");
    let printed = runs(here, &["info", "w.h5"]);
    for part in [
        "replay",
        "a.dm4 (DM4, HAADF, 200 keV)",
        "percentiles 0.1 and 99.9",
        "the file",
        "`stemgen import`",
    ] {
        assert!(printed.contains(part), "no `{part}` in\n{printed}");
    }
    runs(here, &["view", "w.h5", "-o", "w.png", "--quiet"]);
    runs(here, &["view", "w.h5", "--html", "-o", "w.html", "--quiet"]);
    let printed = runs(here, &["tiles", "w.h5", "-n", "3", "--size", "64", "-o", "t.npz"]);
    assert!(printed.contains("that of the stored image"), "{printed}");
    let dose = ["tiles", "w.h5", "-o", "u.npz", "--random-dose", "1e3,1e4"];
    assert!(fails(stemgen(here).args(dose)).contains("leave out --random-dose"));
    let seed = ["tiles", "w.h5", "-o", "u.npz", "--seed", "4"];
    assert!(fails(stemgen(here).args(seed)).contains("world without a recipe"));
    // What simulates has nothing to begin with, and says so.
    for arguments in [&["audit", "w.h5"][..], &["acquire", "w.h5", "-o", "r.h5"]] {
        let printed = fails(stemgen(here).args(arguments));
        assert!(printed.contains("holds no recipe") && printed.contains("recorded"), "{printed}");
    }
    let printed = fails(stemgen(here).args(["view", "w.h5", "--clean", "-o", "c.png"]));
    assert!(printed.contains("noiseless image"), "{printed}");
    assert_eq!(files(here), ["a.dm4", "t.npz", "w.h5", "w.html", "w.png"]);
}

#[test]
fn the_same_image_is_the_same_world_for_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    dm4(here, "a.dm4", "nm");
    for threads in ["1", "2"] {
        let output = format!("{threads}.h5");
        runs(here, &["import", "a.dm4", "-o", &output, "--threads", threads, "--calibrate", "0.4"]);
    }
    let read = |name: &str| std::fs::read(here.join(name)).unwrap();
    assert!(read("1.h5") == read("2.h5"));
}

#[test]
fn the_pixel_is_that_of_the_file_of_the_user_or_of_a_spacing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    npy(here, "a.npy", SHAPE);
    let printed = fails(stemgen(here).args(["import", "a.npy", "-o", "w.h5"]));
    assert!(printed.contains("does not contain a usable pixel size"), "{printed}");
    assert!(printed.contains("--pixel-size") && printed.contains("--calibrate"), "{printed}");
    let given =
        json(stemgen(here).args(["import", "a.npy", "-o", "w.h5", "--pixel-size", "0.025"]));
    assert_eq!(given["pixel_size_nm"], 0.025);
    assert_eq!(given["pixel_size_from"], "given");
    // 16 pixels are 0.4 nm; the first guess is 6 % off.
    let more = ["--pixel-size", "0.0265", "--calibrate", "0.4", "--overwrite"];
    let found = json(stemgen(here).args(["import", "a.npy", "-o", "w.h5"]).args(more));
    let pixel = found["pixel_size_nm"].as_f64().unwrap();
    assert!((pixel / 0.025 - 1.0).abs() < 2e-3, "{found}");
    assert_eq!(found["calibration"]["peaks"].as_array().unwrap().len(), 2, "{found}");
    let printed = runs(here, &["info", "w.h5"]);
    assert!(printed.contains("a spacing of 0.4 nm, found at 16.0"), "{printed}");
    let far = ["--pixel-size", "0.035", "--calibrate", "0.4", "--overwrite"];
    let printed = fails(stemgen(here).args(["import", "a.npy", "-o", "w.h5"]).args(far));
    assert!(printed.contains("no peak of the Fourier transform"), "{printed}");
    dm4(here, "a.dm4", "nm");
    let run = stemgen(here)
        .args(["import", "a.dm4", "-o", "far.h5", "--calibrate", "0.45"])
        .output()
        .unwrap();
    assert!(stderr(&run).contains("more than is usual"), "{}", stderr(&run));
}

#[test]
fn a_dry_run_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    npy(folder.path(), "a.npy", SHAPE);
    let arguments = ["import", "a.npy", "-o", "w.h5", "--pixel-size", "0.02", "--dry-run"];
    assert!(runs(folder.path(), &arguments).contains("w.h5 would be written"));
    assert_eq!(files(folder.path()), ["a.npy"]);
}

#[test]
fn what_cannot_be_imported_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let whole = dm4(here, "a.dm4", "nm");
    npy(here, "small.npy", [100, 300]);
    std::fs::write(here.join("cut.dm4"), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(here.join("text.txt"), "no image").unwrap();
    let file = hdf5::File::create(here.join("o.h5")).unwrap();
    for name in ["one", "two"] {
        let image = ndarray::Array2::<f32>::ones((128, 128));
        file.new_dataset_builder().with_data(&image).create(name).unwrap();
    }
    file.close().unwrap();
    std::fs::write(here.join("cut.h5"), &std::fs::read(here.join("o.h5")).unwrap()[..900]).unwrap();
    let before = files(here);
    for (arguments, parts) in [
        (&["cut.dm4"][..], &["cut.dm4: is no readable DM4 file", "truncated"][..]),
        (&["text.txt"], &["no recorded image of a known format"]),
        (&["nothing.dm3"], &["nothing.dm3: cannot read"]),
        (&["small.npy", "--pixel-size", "0.02"], &["100 x 300 pixels", "128 x 128"]),
        (&["a.dm4", "--pixel-size", "-0.02"], &["--pixel-size", "above 0"]),
        (&["a.dm4", "--pixel-size", "1e9"], &["along its edge", "--pixel-size NM"]),
        (&["a.dm4", "--dataset", "BF"], &["no image `BF`; there are: HAADF"]),
        (&["a.dm4", "--index", "2"], &["no frame 2", "--index"]),
        (&["a.dm4", "--contrast", "99,1"], &["must rise"]),
        (&["o.h5"], &["choose one of: /one, /two", "--dataset NAME"]),
        (&["o.h5", "--dataset", "three"], &["no image `three`; there are: /one, /two"]),
        (&["o.h5", "--dataset", "one", "--pixel-size", "0.1"], &["one value"]),
        (&["cut.h5"], &["damaged"]),
    ] {
        let printed = fails(stemgen(here).arg("import").args(arguments).args(["-o", "w.h5"]));
        for part in parts {
            assert!(printed.contains(part), "{arguments:?}: no `{part}` in\n{printed}");
        }
    }
    for output in ["a.dm4", "o.h5"] {
        let printed = fails(stemgen(here).args(["import", "a.dm4", "-o", output]));
        assert!(printed.contains(output), "{printed}");
    }
    assert_eq!(files(here), before);
}
