//! Recorded images of other programs lie as those programs mean them, with the pixels that their files tell.
//!
//! `tests/recorded/make_recorded.py` makes the files: 5 x 3 pixels (x, y) of 0.02 nm, with the value 10 y + x.

use std::path::PathBuf;

use ndarray::Array2;
use stemgen::io::arrays;
use stemgen::io::recorded::{ImageChoice, RecordedImage, read};
use stemgen::validate::user::reference;

fn file(name: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/recorded")).join(name)
}

fn named(name: &str) -> ImageChoice {
    ImageChoice { dataset: Some(name.to_owned()), index: None }
}

/// The only image of a file.
fn only(name: &str) -> RecordedImage {
    read(&file(name), &ImageChoice::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn expected() -> Array2<f64> {
    Array2::from_shape_fn((3, 5), |(y, x)| (10 * y + x) as f64)
}

#[track_caller]
fn is_right(image: &RecordedImage) {
    assert_eq!(image.pixels, expected(), "{}", image.path.display());
    let nm = image.pixel_nm.clone().unwrap();
    assert!((nm / 0.02 - 1.0).abs() < 1e-6, "{}: {nm} nm", image.path.display());
}

/// Files whose first axis is called x, and who made them or says how.
const XY: [&str; 7] = [
    "berkeley_xy.emd",
    "hyperspy_xy.hspy",
    "labels_xy.h5",
    "nexus_old_xy.nxs",
    "nexus_xy.nxs",
    "prismatic_xy.h5",
    "scales_xy.h5",
];

#[test]
fn named_axes_decide_how_an_image_lies_and_how_large_its_pixels_are() {
    for name in XY {
        let image = only(name);
        is_right(&image);
        assert!(image.notes.iter().any(|note| note.contains("transposed")), "{name}");
    }
}

#[test]
fn a_reference_lies_as_its_axes_are_named() {
    for name in XY.into_iter().filter(|name| !name.ends_with(".hspy")) {
        let array = arrays::read(&file(name), None).unwrap_or_else(|e| panic!("{e}"));
        let found = reference(&array, None, &[], None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(found.data, expected(), "{name}");
        let step = found.step_angstrom.unwrap();
        assert!(step.iter().all(|s| (s / 0.2 - 1.0).abs() < 1e-6), "{name}: {step:?}");
        assert_eq!(found.origin_angstrom, Some([0.0; 2]), "{name}");
    }
}

/// Images of abTEM: 6 x 4 pixels (x, y), which are not square.
#[test]
fn images_of_abtem_are_turned_upright() {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/references"));
    let values = |name: &str| {
        let array = arrays::read(&folder.join(name), None).unwrap();
        reference(&array, None, &[], None).unwrap().data
    };
    for (name, shape) in [("haadf.zarr", (4, 6)), ("haadf.tif", (4, 6))] {
        let image = read(&folder.join(name), &ImageChoice::default()).unwrap();
        assert_eq!((image.pixels.dim(), &image.pixels), (shape, &values(name)), "{name}");
        let why = image.pixel_nm.unwrap_err();
        assert!(why.contains("not square") && why.contains("0.65"), "{name}: {why}");
    }
}

#[test]
fn the_pixels_of_a_tiff_are_those_of_imagej_of_ome_or_of_its_resolution() {
    for name in ["imagej.tif", "imagej_um.tif", "ome.ome.tif", "resolution.tif"] {
        let image = only(name);
        is_right(&image);
        assert!(image.notes.is_empty(), "{name}: {:?}", image.notes);
        // Its axes have no names, and its first pixel no place: neither is guessed.
        let array = arrays::read(&file(name), None).unwrap();
        let printed = reference(&array, None, &[], None).unwrap_err().to_string();
        assert!(printed.contains("xy or yx"), "{printed}");
        let order = Some(stemgen::validate::user::Order::Yx);
        let found = reference(&array, order, &[], None).unwrap();
        assert!(found.step_angstrom.is_some() && found.origin_angstrom.is_none(), "{name}");
    }
    let why = only("printer.tif").pixel_nm.unwrap_err();
    assert!(why.contains("one for a printer"), "{why}");
}

#[test]
fn a_tiff_whose_zero_is_white_is_bright_where_its_picture_is() {
    let image = only("white_is_zero.tif");
    assert_eq!(image.pixels, expected());
    assert!(image.notes[0].contains("its zero is white"), "{:?}", image.notes);
    let printed = read(&file("white_is_zero_float.tif"), &ImageChoice::default()).unwrap_err();
    assert!(printed.to_string().contains("minisblack"), "{printed}");
}

#[test]
fn images_of_a_segmented_detector_have_the_titles_that_their_user_saw() {
    let path = file("velox_segments.emd");
    let printed = read(&path, &ImageChoice::default()).unwrap_err().to_string();
    // The Fourier transform is complex, and not offered.
    assert!(
        printed.contains("choose one of: DF4-A, DF4-B, iDPC") && !printed.contains("FFT"),
        "{printed}"
    );
    for (k, name) in ["DF4-A", "DF4-B", "iDPC"].into_iter().enumerate() {
        let image = read(&path, &named(name)).unwrap();
        assert_eq!(image.pixels, expected() + 100.0 * k as f64, "{name}");
        assert_eq!((image.name.as_str(), image.detector.as_deref()), (name, Some("DF4")));
    }
    let transform = "30123456789abcdef0123456789abcde";
    let printed = read(&path, &named(transform)).unwrap_err().to_string();
    assert!(printed.contains("complex numbers"), "{printed}");
}
