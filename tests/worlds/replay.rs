//! Worlds of recorded images: what files say is read as they say it, and the world holds nothing else.

use std::path::{Path, PathBuf};

use crate::common::{Spots, build};
use crate::dm_bytes::{DM3, DM3_BIG, DM4, Dm, DmStyle, document, floats, image};
use ndarray::{Array2, Array3, arr2, s};
use stemgen::io::recorded::{ImageChoice, RecordedFormat, RecordedImage, read};
use stemgen::io::{HspyFacts, ImageStack, WorldFile, atom_type, schema, write_hspy};
use stemgen::progress::Silent;
use stemgen::recipe::Recipe;
use stemgen::replay::{PixelOrigin, ReplayOptions, ReplayWorld, calibrate};
use stemgen::validate::{CheckOutcome, check_world};
use stemgen::world::BuildOptions;

fn named(name: &str) -> ImageChoice {
    ImageChoice { dataset: Some(name.to_owned()), index: None }
}

fn frame(index: usize) -> ImageChoice {
    ImageChoice { dataset: None, index: Some(index) }
}

fn only(path: &Path) -> RecordedImage {
    read(path, &ImageChoice::default()).unwrap()
}

/// Why a file is refused.
fn refused(path: &Path, choice: &ImageChoice) -> String {
    read(path, choice).unwrap_err().to_string()
}

fn stored(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Values of a small image, with both signs where they may be.
fn value(k: usize, signed: bool) -> f64 {
    if signed { k as f64 - 3.0 } else { 2.0 * k as f64 }
}

/// Kind of the image, code of its numbers, whether they have a sign, and a number's bytes.
type DmNumber = (u32, u64, bool, fn(f64) -> Vec<u8>);

const DM_NUMBERS: [DmNumber; 11] = [
    (1, 2, true, |v| (v as i16).to_le_bytes().to_vec()),
    (2, 6, true, |v| (v as f32).to_le_bytes().to_vec()),
    (6, 10, false, |v| vec![v as u8]),
    (7, 3, true, |v| (v as i32).to_le_bytes().to_vec()),
    (9, 9, true, |v| vec![v as i8 as u8]),
    (10, 4, false, |v| (v as u16).to_le_bytes().to_vec()),
    (11, 5, false, |v| (v as u32).to_le_bytes().to_vec()),
    (12, 7, true, |v| v.to_le_bytes().to_vec()),
    (14, 8, false, |v| vec![v as u8]),
    (39, 11, true, |v| (v as i64).to_le_bytes().to_vec()),
    (40, 12, false, |v| (v as u64).to_le_bytes().to_vec()),
];

#[test]
fn all_numbers_of_dm_files_are_read_in_all_orders() {
    let folder = tempfile::tempdir().unwrap();
    for style in [DM3, DM3_BIG, DM4] {
        for (kind, code, signed, bytes) in DM_NUMBERS {
            let data = (0..12).flat_map(|k| style.value(bytes(value(k, signed)))).collect();
            let tags = document(vec![image("HAADF", &[4, 3], kind, code, data, (0.02, "nm"))]);
            let path = stored(folder.path(), "a.dm", &style.file(tags));
            let found = only(&path);
            let expected = Array2::from_shape_fn((3, 4), |(i, j)| value(4 * i + j, signed));
            assert_eq!(found.pixels, expected, "{style:?}, kind {kind}");
            assert!((found.pixel_nm.clone().unwrap() - 0.02).abs() < 1e-8, "{:?}", found.pixel_nm);
            let format = if style.version == 3 { RecordedFormat::Dm3 } else { RecordedFormat::Dm4 };
            assert_eq!((found.format, found.name.as_str()), (format, "HAADF"));
            assert_eq!(found.energy_kev, Some(200.0));
        }
    }
}

/// Images of two by three pixels.
fn two_images(style: DmStyle) -> Vec<u8> {
    let stack = (0..12).map(|k| k as f32);
    style.file(document(vec![
        image("HAADF", &[3, 2], 2, 6, floats(style, (0..6).map(|k| k as f32)), (0.2, "\u{c5}")),
        image("frames", &[3, 2, 2], 2, 6, floats(style, stack), (0.03, "1/nm")),
    ]))
}

#[test]
fn an_image_or_a_frame_is_chosen_and_a_thumbnail_never() {
    let folder = tempfile::tempdir().unwrap();
    for style in [DM3, DM4] {
        let path = stored(folder.path(), "two.dm3", &two_images(style));
        let printed = refused(&path, &ImageChoice::default());
        assert!(printed.contains("choose one of: HAADF, frames"), "{printed}");
        let printed = refused(&path, &named("ADF"));
        assert!(
            printed.contains("no image `ADF`") && printed.contains("HAADF, frames"),
            "{printed}"
        );
        let first = read(&path, &named("HAADF")).unwrap();
        assert_eq!(first.pixels, arr2(&[[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]));
        assert!((first.pixel_nm.unwrap() - 0.02).abs() < 1e-8);
        let printed = refused(&path, &named("frames"));
        assert!(printed.contains("holds 2 frames; choose one, from 0 to 1"), "{printed}");
        let at = |index| ImageChoice { index: Some(index), ..named("frames") };
        assert!(refused(&path, &at(2)).contains("no frame 2"));
        let second = read(&path, &at(1)).unwrap();
        assert_eq!(second.pixels, arr2(&[[6.0, 7.0, 8.0], [9.0, 10.0, 11.0]]));
        let why = second.pixel_nm.unwrap_err();
        assert!(why.contains("1/nm") && why.contains("no length"), "{why}");
    }
}

#[test]
fn transforms_and_coloured_pictures_are_not_offered() {
    let folder = tempfile::tempdir().unwrap();
    for style in [DM3, DM3_BIG, DM4] {
        let six = || floats(style, (0..6).map(|k| k as f32));
        // As wide as complex numbers are.
        let transform = image("FFT of HAADF", &[3, 2], 3, 7, vec![0; 48], (0.2, "1/nm"));
        let grey = image("HAADF", &[3, 2], 2, 6, six(), (0.2, "nm"));
        let coloured = image("overlay", &[3, 2], 23, 5, vec![0; 24], (0.2, "nm"));
        let all = document(vec![transform.clone(), grey, coloured]);
        let path = stored(folder.path(), "a.dm", &style.file(all));
        assert_eq!(only(&path).name, "HAADF");
        assert!(refused(&path, &named("FFT of HAADF")).contains("complex numbers"));
        assert!(refused(&path, &named("overlay")).contains("colours"));
        let alone = stored(folder.path(), "b.dm", &style.file(document(vec![transform])));
        assert!(refused(&alone, &ImageChoice::default()).contains("complex numbers"));
    }
}

#[test]
fn damaged_dm_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for style in [DM3, DM3_BIG, DM4] {
        let whole = style.file(document(vec![image(
            "a",
            &[3, 2],
            2,
            6,
            floats(style, [0.5; 6]),
            (0.2, "nm"),
        )]));
        // Eight zeros end it.
        for length in 0..whole.len() - 8 {
            let path = stored(folder.path(), "cut.dm3", &whole[..length]);
            let printed = refused(&path, &ImageChoice::default());
            assert!(
                printed.contains("readable") || printed.contains("the file is complete"),
                "{length}: {printed}"
            );
        }
        // Lengths of tags, of names and of arrays that ask for gigabytes.
        for at in 0..whole.len() - 8 {
            let mut bytes = whole.clone();
            bytes[at..at + 8].fill(0x7f);
            let path = stored(folder.path(), "wild.dm3", &bytes);
            let _ = read(&path, &ImageChoice::default());
        }
    }
    let odd = |kind, code, lengths: &[u32], data: Vec<u8>| {
        let file = DM3.file(document(vec![image("a", lengths, kind, code, data, (1.0, "nm"))]));
        refused(&stored(folder.path(), "odd.dm3", &file), &ImageChoice::default())
    };
    assert!(odd(3, 6, &[2, 2], vec![0; 16]).contains("complex numbers"));
    assert!(odd(23, 5, &[2, 2], vec![0; 16]).contains("colours"));
    assert!(odd(77, 5, &[2, 2], vec![0; 16]).contains("kind 77"));
    assert!(odd(12, 6, &[2, 2], vec![0; 16]).contains("4 values of 4 bytes"));
    assert!(odd(2, 6, &[4], vec![0; 16]).contains("two axes"));
    assert!(odd(2, 6, &[0, 4], vec![]).contains("no pixels"));
    let none = stored(folder.path(), "none.dm3", &DM3.file(document(Vec::new())));
    assert!(refused(&none, &ImageChoice::default()).contains("holds no"));
    let large =
        DM4.file(document(vec![image("a", &[1 << 20, 1 << 20], 6, 10, vec![], (1.0, "nm"))]));
    let printed = refused(&stored(folder.path(), "l.dm4", &large), &ImageChoice::default());
    assert!(printed.contains("announces 1099511627776 bytes"), "{printed}");
}

/// Makes an HDF5 file.
fn hdf5_file(path: &Path, fill: impl FnOnce(&hdf5::File)) {
    let file = hdf5::File::create(path).unwrap();
    fill(&file);
    file.close().unwrap();
}

fn text(at: &hdf5::Location, name: &str, value: &str) {
    let value: hdf5::types::VarLenUnicode = value.parse().unwrap();
    at.new_attr::<hdf5::types::VarLenUnicode>().create(name).unwrap().write_scalar(&value).unwrap();
}

#[test]
fn signals_of_hyperspy_are_read_with_their_axes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.hspy");
    let data = Array3::from_shape_fn((2, 3, 4), |(t, i, j)| (12 * t + 4 * i + j) as f32);
    let stack = |name, data, thicknesses_angstrom| ImageStack {
        name,
        data,
        units: "",
        step_angstrom: [0.2, 0.2],
        origin_angstrom: [0.0; 2],
        thicknesses_angstrom,
        defocus_angstrom: None,
        annulus_mrad: None,
        sector_degrees: None,
        electrons_per_pixel: None,
    };
    let one = data.slice(s![..1, .., ..]);
    let both = [stack("HAADF", one, &[10.0]), stack("BF", data.view(), &[10.0, 20.0])];
    write_hspy(&path, true, &both, &HspyFacts::default()).unwrap();
    let printed = refused(&path, &ImageChoice::default());
    assert!(printed.contains("choose one of:") && printed.contains("HAADF"), "{printed}");
    let found = read(&path, &named("HAADF")).unwrap();
    assert_eq!(found.pixels, data.slice(s![0, .., ..]).mapv(f64::from));
    assert!((found.pixel_nm.unwrap() - 0.02).abs() < 1e-12);
    let second = read(&path, &ImageChoice { index: Some(1), ..named("BF") }).unwrap();
    assert_eq!(second.pixels, data.slice(s![1, .., ..]).mapv(f64::from));
    write_hspy(&path, true, &both[..1], &HspyFacts::default()).unwrap();
    assert_eq!(only(&path).format, RecordedFormat::HyperSpy);
}

/// An image of Velox with two frames.
fn velox_image(file: &hdf5::File, id: &str, detector: &str, first: u16) {
    let group = file.create_group(&format!("Data/Image/{id}")).unwrap();
    let data = Array3::from_shape_fn((3, 4, 2), |(i, j, t)| first + (12 * t + 4 * i + j) as u16);
    group.new_dataset_builder().with_data(&data).create("Data").unwrap();
    let json = format!(
        r#"{{"BinaryResult": {{"Detector": "{detector}", "PixelUnitX": "m", "PixelUnitY": "m",
        "PixelSize": {{"width": "1.25e-011", "height": "1.25e-011"}}}}, "Optics": {{"AccelerationVoltage": "300000"}}}}"#
    );
    let mut letters = Array2::<u8>::zeros((600, 2));
    for (k, byte) in json.bytes().enumerate() {
        letters.row_mut(k).fill(byte);
    }
    group.new_dataset_builder().with_data(&letters).create("Metadata").unwrap();
}

#[test]
fn images_of_velox_are_read_with_their_detectors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("v.emd");
    hdf5_file(&path, |file| {
        velox_image(file, "a0123456789", "HAADF", 0);
        velox_image(file, "b0123456789", "BF", 100);
        velox_image(file, "c0123456789", "BF", 200);
    });
    let printed = refused(&path, &ImageChoice::default());
    assert!(printed.contains("HAADF, BF:b0123456, BF:c0123456"), "{printed}");
    let printed = refused(&path, &named("HAADF"));
    assert!(printed.contains("holds 2 frames"), "{printed}");
    for (name, first) in
        [("HAADF", 0.0), ("BF:c0123456", 200.0), ("/Data/Image/b0123456789/Data", 100.0)]
    {
        let found = read(&path, &ImageChoice { index: Some(1), ..named(name) }).unwrap();
        let expected = Array2::from_shape_fn((3, 4), |(i, j)| first + (12 + 4 * i + j) as f64);
        assert_eq!(found.pixels, expected, "{name}");
        assert!((found.pixel_nm.unwrap() - 0.0125).abs() < 1e-9);
        assert_eq!(found.energy_kev, Some(300.0));
    }
}

#[derive(hdf5::H5Type, Clone, Copy)]
#[repr(C)]
struct Colour {
    r: u8,
    g: u8,
    b: u8,
}

#[test]
fn other_hdf5_files_are_read_by_the_paths_of_their_images() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("o.h5");
    let data = Array2::from_shape_fn((3, 4), |(i, j)| (4 * i + j) as f64);
    hdf5_file(&path, |file| {
        let group = file.create_group("root/annular").unwrap();
        group.new_dataset_builder().with_data(&data).create("data").unwrap();
        for (name, places) in [("dim0", vec![1.0, 1.5, 2.0]), ("dim1", vec![0.0, 0.5, 1.0, 1.5])] {
            let axis = group.new_dataset_builder().with_data(&places).create(name).unwrap();
            text(&axis, "units", "A");
        }
        let cube = ndarray::Array4::<f32>::zeros((2, 2, 3, 3));
        file.new_dataset_builder().with_data(&cube).create("cube").unwrap();
        let colours = Array2::from_elem((2, 2), Colour { r: 1, g: 2, b: 3 });
        file.new_dataset_builder().with_data(&colours).create("coloured").unwrap();
        let waves = Array2::from_elem((2, 2), num_complex::Complex64::new(1.0, 2.0));
        file.new_dataset_builder().with_data(&waves).create("wave").unwrap();
        let plain = Array2::<i16>::ones((2, 2));
        file.new_dataset_builder().with_data(&plain).create("plain").unwrap();
    });
    let found = read(&path, &named("root/annular/data")).unwrap();
    assert_eq!(found.pixels, data);
    assert!((found.pixel_nm.unwrap() - 0.05).abs() < 1e-12);
    assert!(read(&path, &named("/plain")).unwrap().pixel_nm.unwrap_err().contains("no pixel size"));
    let printed = refused(&path, &ImageChoice::default());
    assert!(printed.contains("several") && printed.contains("/root/annular/data"), "{printed}");
    assert!(refused(&path, &named("/nothing")).contains("no image `/nothing`"));
    assert!(refused(&path, &named("cube")).contains("has 4 axes"));
    assert!(refused(&path, &named("coloured")).contains("r and g and b"));
    assert!(refused(&path, &named("wave")).contains("complex numbers"));
    let bytes = std::fs::read(&path).unwrap();
    let cut = stored(folder.path(), "cut.h5", &bytes[..bytes.len() / 2]);
    assert!(refused(&cut, &ImageChoice::default()).contains("damaged or truncated"));
}

#[test]
fn what_cannot_be_a_world_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let recorded = |rows: u32, columns: u32, unit: &'static str, value: fn(usize) -> f32| {
        let values = (0..(rows * columns) as usize).map(value);
        let image = image("a", &[columns, rows], 2, 6, floats(DM3, values), (0.02, unit));
        only(&stored(folder.path(), "a.dm3", &DM3.file(document(vec![image]))))
    };
    let usual = ReplayOptions::default();
    let printed = |image: RecordedImage, options: &ReplayOptions| {
        ReplayWorld::new(image, options).unwrap_err().to_string()
    };
    let ramp = |k: usize| k as f32;
    let small = printed(recorded(127, 400, "nm", ramp), &usual);
    assert!(small.contains("127 x 400 pixels") && small.contains("larger part"), "{small}");
    let unsaid = printed(recorded(128, 128, "", ramp), &usual);
    assert!(unsaid.contains("does not contain a usable pixel size"), "{unsaid}");
    for nm in [-0.02, 0.0, f64::NAN, 1e9] {
        let options = ReplayOptions { pixel_nm: Some(nm), ..usual.clone() };
        let printed = printed(recorded(128, 128, "nm", ramp), &options);
        assert!(printed.contains("pixel of the recorded image"), "{printed}");
    }
    assert!(printed(recorded(128, 128, "nm", |_| 4.0), &usual).contains("one value"));
    assert!(printed(recorded(128, 128, "nm", |_| f32::NAN), &usual).contains("finite value"));
    let back = ReplayOptions { percentiles: [90.0, 10.0], ..usual.clone() };
    assert!(printed(recorded(128, 128, "nm", ramp), &back).contains("the lower first"));
    let spacing = ReplayOptions { spacing_nm: Some(-1.0), ..usual.clone() };
    assert!(printed(recorded(128, 128, "nm", ramp), &spacing).contains("positive length"));
    assert!(ReplayWorld::new(recorded(128, 128, "nm", ramp), &usual).is_ok());
    let options = ReplayOptions { pixel_nm: Some(0.5), ..usual };
    let given = ReplayWorld::new(recorded(128, 128, "", ramp), &options).unwrap();
    assert_eq!(given.facts().pixel_size_from, PixelOrigin::Given);
}

/// A small world of SrTiO3, with its image.
fn simulated(folder: &Path) -> (WorldFile, Array2<f64>) {
    let path = folder.join("simulated.h5");
    let recipe = Recipe::load("test", None).unwrap();
    build(&recipe, &Spots::new(), &path, &BuildOptions::default(), &Silent).unwrap();
    let world = WorldFile::open(&path).unwrap();
    let [rows, columns] = world.shape();
    let image = world.stitched(0..rows, 0..columns).unwrap().mapv(f64::from);
    (world, image)
}

#[test]
fn a_known_spacing_calibrates_the_image_of_a_world() {
    let folder = tempfile::tempdir().unwrap();
    let (world, image) = simulated(folder.path());
    let pixel = world.metadata().pixel_size_nm;
    for wrong in [0.9, 1.0, 1.07] {
        let found = calibrate(&image, 0.3905, wrong * pixel).unwrap();
        assert!((found.pixel_nm / pixel - 1.0).abs() < 0.01, "{wrong}: {found:?}, {pixel}");
        assert!(!found.peaks.is_empty());
    }
}

/// A place beside the image.
const OUTSIDE: [f64; 2] = [-3.0, 10.0];

/// What a file of the BiFeO3 layout holds.
struct CellFile {
    image: Array2<f64>,
    places: Vec<[f64; 2]>,
    polarisations: Vec<[f64; 2]>,
    scale: f64,
}

/// A file in the layout of the BiFeO3 images of the paper, made from a world: places are its columns in pixels. A block of pixels is
/// missing, and one polarisation.
fn cell_file(folder: &Path, path: &Path, transposed: bool) -> CellFile {
    let (world, mut image) = simulated(folder);
    image.mapv_inplace(|v| 500.0 + 3000.0 * v);
    image.slice_mut(s![40..60, 100..130]).fill(f64::NAN);
    let pixel = world.metadata().pixel_size_nm;
    let [rows, columns] = world.shape();
    let inside = |p: &[f64; 2]| {
        (-0.5..columns as f64 - 0.5).contains(&p[0]) && (-0.5..rows as f64 - 0.5).contains(&p[1])
    };
    let all = world.columns().unwrap();
    let places = all.iter().map(|c| c.position_nm.map(|v| f64::from(v) / pixel));
    let places: Vec<[f64; 2]> = places.filter(inside).step_by(7).collect();
    assert!(places.len() > 40, "{}", places.len());
    let mut polarisations: Vec<[f64; 2]> =
        places.iter().map(|[x, y]| [(x * 0.02).sin(), (y * 0.03).cos()]).collect();
    polarisations[3] = [f64::NAN, 1.0];
    let table = |list: &[[f64; 2]]| {
        let table = arr2(list);
        if transposed { table.reversed_axes().as_standard_layout().into_owned() } else { table }
    };
    hdf5_file(path, |file| {
        let add = |name: &str, table: &Array2<f64>| {
            file.new_dataset_builder().with_data(table).create(name).unwrap();
        };
        add("main image", &image);
        // One place too many lies outside.
        let mut listed = places.clone();
        listed.push(OUTSIDE);
        let mut vectors = polarisations.clone();
        vectors.push([1.0, 1.0]);
        add("xy_COM", &table(&listed));
        add("Pxy", &table(&vectors));
        for k in 1..=5 {
            let values: Vec<f64> = (0..listed.len()).map(|n| (10 * n + k) as f64).collect();
            file.new_dataset_builder().with_data(&values).create(&*format!("I{k}")).unwrap();
        }
        file.new_dataset_builder().with_data(&[0.0156]).create("Scale").unwrap();
    });
    CellFile { image, places, polarisations, scale: 0.0156 }
}

fn quadrant([x, y]: [f64; 2]) -> i32 {
    match (x >= 0.0, y >= 0.0) {
        (true, true) => 0,
        (false, true) => 1,
        (false, false) => 2,
        (true, false) => 3,
    }
}

/// `numpy.percentile` of the finite values.
fn percentile(image: &Array2<f64>, percent: f64) -> f64 {
    let mut values: Vec<f64> = image.iter().copied().filter(|v| v.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let place = 0.01 * percent * (values.len() - 1) as f64;
    let (low, high) = (values[place.floor() as usize], values[place.ceil() as usize]);
    low + (place - place.floor()) * (high - low)
}

#[test]
fn the_layout_of_the_paper_becomes_a_world_with_cells_phases_and_gaps() {
    for transposed in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("Sm_0_1.h5");
        let made = cell_file(folder.path(), &path, transposed);
        let recorded = read(&path, &named("/main image")).unwrap();
        let places = |image: &RecordedImage| image.cells.as_ref().unwrap().positions_px.clone();
        assert!(places(&recorded) == places(&only(&path)));
        assert_eq!(recorded.format, RecordedFormat::UnitCells);
        let replay = ReplayWorld::new(recorded, &ReplayOptions::default()).unwrap();
        let output = folder.path().join("replay.h5");
        replay.write(&output, false, &Silent).unwrap();
        assert!(replay.write(&output, false, &Silent).is_err(), "nothing is replaced unasked");
        let facts = replay.facts();
        assert_eq!((facts.sites_left_out, facts.invalid_pixels), (1, 20 * 30));
        let world = WorldFile::open(&output).unwrap();
        check_images(&world, &made);
        check_truth(&world, &made);
        for check in check_world(&output, &Silent).unwrap() {
            assert_ne!(check.outcome, CheckOutcome::Fault, "{check:?}");
        }
    }
}

fn check_images(world: &WorldFile, made: &CellFile) {
    let m = world.metadata();
    assert_eq!((m.tile_size_px, m.overlap_px, m.pixel_size_nm), (128, 4, made.scale));
    assert_eq!(m.source.as_deref(), Some("replay"));
    assert_eq!((&m.recipe, &m.noise, &m.seed, &m.scaling), (&None, &None, &None, &None));
    assert_eq!((m.dose_electrons_per_angstrom2, m.thickness_nm), (None, None));
    let [rows, columns] = world.shape();
    let found = world.stitched(0..rows, 0..columns).unwrap();
    let [low, median, high] = [0.1, 50.0, 99.9].map(|p| percentile(&made.image, p));
    for ((i, j), value) in found.indexed_iter() {
        let recorded = made.image[(i, j)];
        let recorded = if recorded.is_finite() { recorded } else { median };
        let expected = ((recorded - low) / (high - low)).clamp(0.0, 1.0);
        assert!((expected - f64::from(*value)).abs() < 1e-6, "{i}, {j}: {value}, {expected}");
    }
    let file = hdf5::File::open(world.path()).unwrap();
    let valid: Array2<bool> = file.dataset(schema::VALID_REGION).unwrap().read().unwrap();
    assert!(valid.indexed_iter().all(|(at, v)| *v == made.image[at].is_finite()));
    let tiles = file.group(schema::TILES).unwrap();
    let number = |name: &str| tiles.attr(name).unwrap().read_scalar::<f64>().unwrap();
    assert!((number("recorded_scale") - (high - low)).abs() < 1e-9);
    assert!((number("recorded_offset") - low).abs() < 1e-9);
}

fn check_truth(world: &WorldFile, made: &CellFile) {
    let count = world.site_count().unwrap();
    assert_eq!(count, made.places.len());
    let truth = world.truth(0..count).unwrap();
    for (found, expected) in truth.positions.iter().zip(&made.places) {
        let near = |k: usize| (f64::from(found[k]) - made.scale * expected[k]).abs() < 1e-5;
        assert!(near(0) && near(1), "{found:?} {expected:?}");
    }
    assert!(truth.types.iter().all(|t| *t == atom_type::PRISTINE));
    assert!(truth.defects.iter().all(|d| !d) && truth.defect_names.iter().all(String::is_empty));
    assert!(truth.z.is_empty() && truth.numbers.is_empty() && truth.columns.is_empty());
    let [rows, columns] = world.shape();
    let map = world.phase_map(0..rows, 0..columns).unwrap().unwrap();
    assert_eq!(world.phase_names().unwrap(), ["Px+ Py+", "Px- Py+", "Px- Py-", "Px+ Py-"]);
    for ((i, j), code) in map.indexed_iter().filter(|((i, j), _)| i % 7 == 0 && j % 5 == 0) {
        let cells = made.places.iter().zip(&made.polarisations);
        let far = |p: &[f64; 2]| (p[0] - j as f64).hypot(p[1] - i as f64);
        let known = cells.filter(|(_, p)| p[0].is_finite());
        let mut near: Vec<(f64, i32)> = known.map(|(at, p)| (far(at), quadrant(*p))).collect();
        // The one that lies outside counts for the pixels that are nearest to it.
        near.push((far(&OUTSIDE), 0));
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Where two are equally near, either will do.
        let least = near[0].0 + 1e-9;
        assert!(near.iter().any(|(far, q)| *far <= least && q == code), "{i}, {j}");
    }
    let file = hdf5::File::open(world.path()).unwrap();
    let cells = file.group("ground_truth/unit_cells").unwrap();
    let last: Vec<f32> = cells.dataset("I5").unwrap().read_raw().unwrap();
    assert_eq!((last.len(), last[2]), (count, 25.0));
    assert_eq!(cells.dataset("polarisation").unwrap().shape(), [count, 2]);
}

#[test]
fn lists_of_cells_that_do_not_fit_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.h5");
    let make = |cells: &Array2<f64>, others: usize| {
        hdf5_file(&path, |file| {
            let image = Array2::from_shape_fn((130, 130), |(i, j)| (i * j) as f64);
            file.new_dataset_builder().with_data(&image).create("main image").unwrap();
            file.new_dataset_builder().with_data(cells).create("xy_COM").unwrap();
            let vectors = Array2::<f64>::ones((others, 2));
            file.new_dataset_builder().with_data(&vectors).create("Pxy").unwrap();
        });
    };
    make(&Array2::from_elem((4, 2), 9.0), 5);
    assert!(refused(&path, &ImageChoice::default()).contains("4 unit cells, and Pxy 5"));
    make(&Array2::from_elem((4, 3), 9.0), 4);
    assert!(refused(&path, &ImageChoice::default()).contains("expected (N, 2)"));
    make(&Array2::from_elem((4, 2), 900.0), 4);
    let found = only(&path);
    assert!(found.pixel_nm.clone().unwrap_err().contains("no `Scale`"));
    let options = ReplayOptions { pixel_nm: Some(0.02), ..ReplayOptions::default() };
    let printed = ReplayWorld::new(found, &options).unwrap_err().to_string();
    assert!(printed.contains("4 places, of which 0 lie"), "{printed}");
}

#[test]
fn a_frame_of_a_file_with_one_is_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let values = floats(DM4, (0..6).map(|k| k as f32));
    let tags = document(vec![image("a", &[3, 2], 2, 6, values, (1.0, "nm"))]);
    let path = stored(folder.path(), "a.dm4", &DM4.file(tags));
    assert!(read(&path, &frame(0)).is_ok());
    assert!(refused(&path, &frame(1)).contains("no frame 1"));
    // A file without a list of thumbnails, and an image with an axis of length 1 too many.
    let values = floats(DM4, (0..6).map(|k| k as f32));
    let mut tags = document(vec![image("a", &[3, 2, 1, 1], 2, 6, values, (1.0, "nm"))]);
    tags.retain(|(name, _)| *name != "Thumbnails");
    let found = only(&stored(folder.path(), "c.dm4", &DM4.file(tags)));
    assert_eq!((found.name.as_str(), found.pixels.dim()), ("a", (2, 3)));
    let wild = Dm::Group(vec![("ImageData", Dm::Group(vec![("Data", Dm::Text("none"))]))]);
    let path = stored(folder.path(), "b.dm4", &DM4.file(document(vec![wild])));
    assert!(refused(&path, &ImageChoice::default()).contains("two axes"));
}
