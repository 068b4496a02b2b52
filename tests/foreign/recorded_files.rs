//! Recorded images: files of DigitalMicrograph, Velox and HyperSpy, and lists of unit cells.

use std::path::Path;

use hdf5::File;
use hdf5::types::VarLenUnicode;
use ndarray::{Array2, Array3};

use super::dm_bytes::{DmStyle, document, floats, image};

/// Files of DigitalMicrograph: a small image, a stack, and one as large as a tile.
pub fn dm_files(style: DmStyle) -> Vec<Vec<u8>> {
    let values = |n: u32| floats(style, (0..n).map(|k| k as f32));
    let small = image("HAADF", &[3, 2], 2, 6, values(6), (0.2, "nm"));
    let stack = image("stack", &[3, 2, 2], 2, 6, values(12), (0.2, "nm"));
    let bytes: Vec<u8> = (0..130 * 129_u32).map(|k| (k % 251) as u8).collect();
    let tile = image("tile", &[130, 129], 6, 10, bytes, (0.02, "nm"));
    [vec![small.clone()], vec![small, stack], vec![tile]]
        .map(|images| style.file(document(images)))
        .into()
}

/// Two frames of one detector, as Velox keeps them.
pub fn velox(path: &Path) -> File {
    let file = File::create(path).unwrap();
    let group = file.create_group("Data/Image/a1").unwrap();
    let frames = Array3::<u16>::from_shape_fn((6, 5, 2), |(i, j, t)| (10 * i + j + t) as u16);
    group.new_dataset_builder().chunk((3, 5, 1)).with_data(&frames).create("Data").unwrap();
    let json = br#"{"BinaryResult": {"Detector": "HAADF", "PixelUnitX": "m", "PixelUnitY": "m", "PixelSize": {"width": "1e-11", "height": "1e-11"}}}"#;
    let mut letters = Array2::<u8>::zeros((200, 2));
    for (k, letter) in json.iter().enumerate() {
        letters.row_mut(k).fill(*letter);
    }
    group.new_dataset_builder().with_data(&letters).create("Metadata").unwrap();
    file
}

/// One signal of HyperSpy.
pub fn signal(path: &Path) -> File {
    let file = File::create(path).unwrap();
    let group = file.create_group("Experiments/HAADF").unwrap();
    let values = Array2::<f32>::from_shape_fn((6, 5), |(i, j)| (5 * i + j) as f32);
    group.new_dataset_builder().deflate(1).with_data(&values).create("data").unwrap();
    for axis in 0..2 {
        let axis = group.create_group(&format!("axis-{axis}")).unwrap();
        axis.new_attr::<f64>().create("scale").unwrap().write_scalar(&0.02).unwrap();
        let unit: VarLenUnicode = "nm".parse().unwrap();
        axis.new_attr::<VarLenUnicode>().create("units").unwrap().write_scalar(&unit).unwrap();
    }
    file
}

/// An image as large as a tile, with three unit cells.
pub fn unit_cells(path: &Path) -> File {
    let file = File::create(path).unwrap();
    let image = Array2::<u8>::from_shape_fn((128, 129), |(i, j)| (i ^ j) as u8);
    let builder = file.new_dataset_builder().deflate(6).chunk((64, 129));
    builder.with_data(&image).create("main image").unwrap();
    let places = ndarray::arr2(&[[5.0, 6.0], [70.0, 20.0], [100.0, 120.0]]);
    let vectors = ndarray::arr2(&[[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0]]);
    for (name, table) in [("xy_COM", places), ("Pxy", vectors)] {
        file.new_dataset_builder().with_data(&table).create(name).unwrap();
    }
    file.new_dataset_builder().with_data(&[1.0, 2.0, 3.0]).create("I1").unwrap();
    file.new_dataset_builder().with_data(&[0.0156]).create("Scale").unwrap();
    file
}
