//! Worlds and references in HDF5.

use std::path::Path;

use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, File, Group};
use ndarray::Array2;
use stemgen::io::{WorldFile, arrays};

use super::mutation::Dice;

/// Edge of a tile of [`world`] in pixels; there are 1 x 2 of them.
const TILE: usize = 16;

/// The smallest world with a bit of everything.
pub fn world(path: &Path) -> File {
    let file = File::create(path).unwrap();
    let metadata = file.create_group("metadata").unwrap();
    for (name, value) in
        [("pixel_size_nm", 0.05), ("tile_size_px", TILE as f64), ("overlap_px", 0.0)]
    {
        set(&metadata, name, value);
    }
    metadata.new_attr_builder().with_data(&[1_i64, 2]).create("grid_shape").unwrap();
    let fov = [1, 2].map(|tiles| (tiles * TILE) as f64 * 0.05);
    metadata.new_attr_builder().with_data(&fov).create("fov_nm").unwrap();
    text(&metadata, "recipe", "id = \"x\"");
    let tiles = file.create_group("tiles").unwrap();
    for name in ["0_0", "0_1"] {
        let pixels = Array2::from_shape_fn((TILE, TILE), |(y, x)| (y * TILE + x) as f32 / 256.0);
        tiles.new_dataset_builder().deflate(1).with_data(&pixels).create(name).unwrap();
    }
    let overview = Array2::<f32>::zeros((TILE / 8, 2 * TILE / 8));
    file.new_dataset_builder().with_data(&overview).create("overview").unwrap();
    let truth = file.create_group("ground_truth").unwrap();
    let positions = [[0.1_f32, 0.1], [0.5, 0.1], [1.1, 0.3]];
    list(&truth, "atom_positions", &ndarray::arr2(&positions));
    list(&truth, "atom_types", &ndarray::arr1(&[0, 1, 2]));
    list(&truth, "defect_mask", &ndarray::arr1(&[false, true, true]));
    list(&truth, "atomic_numbers", &ndarray::arr1(&[38, 8, 22]));
    let columns = truth.create_group("columns").unwrap();
    list(&columns, "position", &ndarray::arr2(&positions));
    for name in ["number_of_sites", "vacancies", "substitutions"] {
        list(&columns, name, &ndarray::arr1(&[1, 0, 1]));
    }
    let lines = truth.create_group("grain_boundaries").unwrap();
    list(&lines, "0", &ndarray::arr2(&[[0.0_f32, 0.0], [1.0, 0.5]]));
    let map = list(&truth, "phase_map", &Array2::<i32>::ones((TILE, 2 * TILE)));
    text(&map, "codes", "0 matrix, 1 well");
    let particles = truth.create_group("particles").unwrap();
    list(&particles, "centre", &ndarray::arr2(&[[0.5_f32, 0.5, 0.1]]));
    list(&particles, "orientation", &ndarray::arr2(&[[1.0_f32, 0.0, 0.0, 0.0]]));
    list(&particles, "diameter", &ndarray::arr1(&[0.3_f32]));
    let shape = hdf5::types::FixedAscii::<16>::from_ascii("wulff").unwrap();
    list(&particles, "morphology", &ndarray::arr1(&[shape]));
    file
}

fn list<T: hdf5::H5Type, D: ndarray::Dimension>(
    group: &Group,
    name: &str,
    values: &ndarray::Array<T, D>,
) -> Dataset {
    group.new_dataset_builder().with_data(values).create(name).unwrap()
}

fn set(at: &hdf5::Location, name: &str, value: f64) {
    let _ = at.delete_attr(name);
    at.new_attr::<f64>().create(name).unwrap().write_scalar(&value).unwrap();
}

fn text(at: &hdf5::Location, name: &str, value: &str) {
    let value: VarLenUnicode = value.parse().unwrap();
    at.new_attr::<VarLenUnicode>().create(name).unwrap().write_scalar(&value).unwrap();
}

/// A file of one image, as `stemgen simulate` writes it.
pub fn reference(path: &Path) -> File {
    let file = File::create(path).unwrap();
    let images = file.create_group("images").unwrap();
    let image = list(&images, "HAADF", &ndarray::Array3::<f32>::zeros((1, 6, 5)));
    for name in ["sampling_angstrom", "origin_angstrom"] {
        image.new_attr_builder().with_data(&[0.2, 0.1]).create(name).unwrap();
    }
    let axes = ["thickness", "y", "x"].map(|name| name.parse::<VarLenUnicode>().unwrap());
    image.new_attr_builder().with_data(&axes).create("axes").unwrap();
    file
}

/// The small world with some of its parts made anew: other shapes, other types, other values.
pub fn odd_world(path: &Path, dice: &mut Dice) -> File {
    const LISTS: [&str; 18] = [
        "tiles/0_0",
        "tiles/0_1",
        "overview",
        "ground_truth/atom_positions",
        "ground_truth/atom_types",
        "ground_truth/defect_mask",
        "ground_truth/atomic_numbers",
        "ground_truth/columns/position",
        "ground_truth/columns/vacancies",
        "ground_truth/columns/number_of_sites",
        "ground_truth/grain_boundaries/0",
        "ground_truth/phase_map",
        "ground_truth/particles/centre",
        "ground_truth/particles/diameter",
        "ground_truth/particles/morphology",
        "ground_truth/columns/composition",
        "ground_truth/defect_types",
        "ground_truth/atom_z",
    ];
    let file = world(path);
    for _ in 0..=dice.below(3) {
        let list: &str = LISTS[dice.below(LISTS.len())];
        match dice.below(4) {
            0 => odd_attribute(&file, dice),
            1 => drop(file.unlink(list)),
            2 => drop(file.link_hard(list, &format!("tiles/0_{}", dice.below(4)))),
            _ => odd_list(&file, list, dice),
        }
    }
    file
}

fn odd_attribute(file: &File, dice: &mut Dice) {
    const NAMES: [&str; 9] = [
        "pixel_size_nm",
        "tile_size_px",
        "overlap_px",
        "grid_shape",
        "fov_nm",
        "recipe",
        "seed",
        "noise",
        "thickness_nm",
    ];
    const VALUES: [f64; 12] =
        [0.0, -1.0, 0.5, 1.0, 2.0, 16.0, 1e5, 1e9, 1e300, f64::NAN, f64::INFINITY, 5e-324];
    let metadata = file.group("metadata").unwrap();
    let name = *dice.pick(&NAMES);
    let _ = metadata.delete_attr(name);
    match dice.below(5) {
        0 => {}
        1 => text(&metadata, name, "1.5"),
        2 => {
            let values = vec![*dice.pick(&VALUES); dice.below(5)];
            metadata.new_attr_builder().with_data(&values).create(name).unwrap();
        }
        3 => {
            let pair = [*dice.pick(&VALUES), *dice.pick(&VALUES)];
            metadata.new_attr_builder().with_data(&pair).create(name).unwrap();
        }
        _ => set(&metadata, name, *dice.pick(&VALUES)),
    }
}

fn odd_list(file: &File, name: &str, dice: &mut Dice) {
    let _ = file.unlink(name);
    const LENGTHS: [usize; 11] = [0, 1, 2, 3, 4, 16, 32, 1000, 1 << 20, 1 << 40, 1 << 62];
    let shape: Vec<usize> = (0..dice.below(4)).map(|_| *dice.pick(&LENGTHS)).collect();
    // The builder multiplies them.
    if shape.iter().try_fold(1_usize, |n, length| n.checked_mul(*length)).is_none() {
        return;
    }
    let chunk: Vec<usize> = shape.iter().map(|n| (*n).clamp(1, 64)).collect();
    macro_rules! make {
        ($kind:ty) => {
            match shape.is_empty() {
                true => file.new_dataset::<$kind>().create(name),
                false => {
                    file.new_dataset::<$kind>().chunk(chunk).deflate(1).shape(shape).create(name)
                }
            }
        };
    }
    // A shape that the library refuses is one that is not there.
    let _ = match dice.below(6) {
        0 => make!(f32),
        1 => make!(f64),
        2 => make!(i32),
        3 => make!(u8),
        4 => make!(VarLenUnicode),
        _ => make!(hdf5::types::FixedAscii<16>),
    };
}

/// Reads everything that a world holds.
pub fn read_world(path: &Path) -> stemgen::Result<()> {
    let world = WorldFile::open(path)?;
    let [height, width] = world.shape();
    world.overview()?;
    world.stitched(0..height.min(512), 0..width)?;
    world.truth(0..world.site_count()?.min(1 << 20))?;
    world.columns()?;
    world.boundary_lines()?;
    world.phase_map(0..height.min(512), 0..width)?;
    world.phase_names()?;
    world.particles().map(drop)
}

/// The error of a world after `change`.
fn refused(change: impl FnOnce(&File)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.h5");
    let file = world(&path);
    change(&file);
    file.close().unwrap();
    let printed = read_world(&path).unwrap_err().to_string();
    assert!(printed.contains("w.h5"), "no file in: {printed}");
    printed
}

/// Puts an empty dataset of this shape in the place of another. Its chunks were never written.
fn announce(file: &File, name: &str, shape: [usize; 2]) {
    file.unlink(name).unwrap();
    let chunk = shape.map(|n| n.min(64));
    file.new_dataset::<f32>().chunk(chunk).shape(shape).create(name).unwrap();
}

#[test]
fn the_small_world_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.h5");
    world(&path).close().unwrap();
    read_world(&path).unwrap();
    let read = WorldFile::open(&path).unwrap();
    assert_eq!(read.truth(0..3).unwrap().defects, [false, true, true]);
    assert_eq!(read.phase_names().unwrap(), ["matrix", "well"]);
    assert_eq!(read.metadata().noise, None);
}

#[test]
fn lists_of_odd_shapes_are_refused() {
    let printed = refused(|f| announce(f, "ground_truth/grain_boundaries/0", [5, 1]));
    assert!(printed.contains("shape [5, 1]"), "{printed}");
    let printed = refused(|f| announce(f, "ground_truth/particles/centre", [1, 2]));
    assert!(printed.contains("lists of particles"), "{printed}");
    let printed = refused(|f| announce(f, "ground_truth/columns/position", [4, 2]));
    assert!(printed.contains("lists of columns"), "{printed}");
    let printed = refused(|f| announce(f, "ground_truth/atomic_numbers", [3, 1]));
    assert!(printed.contains("atomic_numbers"), "{printed}");
    let printed = refused(|f| announce(f, "overview", [3, 3]));
    assert!(printed.contains("overview"), "{printed}");
}

#[test]
fn what_is_announced_is_held_against_the_size_of_the_file() {
    for name in ["ground_truth/columns/position", "ground_truth/atom_positions"] {
        // 2^62 columns, and 75 kB that ask for 9.6 GB
        for rows in [1 << 61, 1_200_000_000] {
            let printed = refused(|f| announce(f, name, [rows, 2]));
            assert!(
                printed.contains("announces") && printed.contains("at most 268435456"),
                "{printed}"
            );
        }
    }
    let huge = |f: &File| set(&f.group("metadata").unwrap(), "tile_size_px", 999_999_999.0);
    assert!(refused(huge).contains("tile_size_px = 999999999"));
    let printed = refused(|f| {
        huge(f);
        announce(f, "tiles/0_0", [999_999_999; 2]);
    });
    assert!(printed.contains("at most 268435456"), "{printed}");
    // One tile under many names is still a large image.
    let printed = refused(|f| {
        set(&f.group("metadata").unwrap(), "tile_size_px", 2048.0);
        let grid = f.group("metadata").unwrap();
        grid.delete_attr("grid_shape").unwrap();
        grid.new_attr_builder().with_data(&[10_i64, 10]).create("grid_shape").unwrap();
        f.unlink("tiles").unwrap();
        f.create_group("tiles").unwrap();
        let tile = f.new_dataset::<f32>().chunk((64, 64)).shape((2048, 2048));
        tile.create("tiles/0_0").unwrap();
        for i in 1..100 {
            f.link_hard("tiles/0_0", &format!("tiles/{}_{}", i / 10, i % 10)).unwrap();
        }
    });
    assert!(printed.contains("[20480, 20480]"), "{printed}");
}

#[test]
fn places_must_be_finite_and_near() {
    for far in [f32::INFINITY, f32::NAN, 1e30] {
        for name in ["columns/position", "atom_positions", "grain_boundaries/0", "particles/centre"]
        {
            let printed = refused(|f| {
                let places = f.dataset(&format!("ground_truth/{name}")).unwrap();
                let mut values: Array2<f32> = places.read_2d().unwrap();
                values[(0, 1)] = far;
                places.write(&values).unwrap();
            });
            assert!(printed.contains("expected up to 10000000 nm"), "{name}: {printed}");
        }
    }
}

#[test]
fn attributes_of_a_world_are_held_against_each_other() {
    let with = |name: &'static str, value: f64| {
        refused(move |f| set(&f.group("metadata").unwrap(), name, value))
    };
    for (name, value, part) in [
        ("tile_size_px", 15.0, "tile_size_px = 15"),
        ("tile_size_px", 15.5, "tile_size_px"),
        ("overlap_px", 16.0, "overlap_px"),
        ("overlap_px", 2.0, "fov_nm"),
        ("pixel_size_nm", 0.06, "fov_nm"),
        ("pixel_size_nm", 1e-300, "pixel_size_nm"),
        ("pixel_size_nm", f64::NAN, "pixel_size_nm"),
        ("thickness_nm", -1.0, "thickness_nm"),
        ("grid_shape", 2.0, "grid_shape"),
        ("fov_nm", 2.0, "fov_nm"),
    ] {
        let printed = with(name, value);
        assert!(printed.contains(part), "{name} = {value}: {printed}");
    }
    let printed = refused(|f| {
        let tiles = f.group("tiles").unwrap();
        set(&tiles, "scale", f64::INFINITY);
        set(&tiles, "offset", 0.0);
    });
    assert!(printed.contains("scale or offset"), "{printed}");
}

#[test]
fn a_world_takes_nothing_from_other_files() {
    let folder = tempfile::tempdir().unwrap();
    let secret = folder.path().join("secret.h5");
    world(&secret).close().unwrap();
    let secret = secret.to_str().unwrap();
    let inside = |name: &'static str| {
        refused(move |f| {
            f.unlink(name).unwrap();
            f.link_external(secret, name, name).unwrap();
        })
    };
    for name in ["tiles", "tiles/0_1", "overview", "ground_truth", "metadata"] {
        let printed = inside(name);
        assert!(printed.contains("link to another file") && printed.contains(name), "{printed}");
    }
    // a soft link that leaves through an external one
    let printed = refused(|f| {
        f.unlink("tiles").unwrap();
        f.link_external(secret, "/", "other").unwrap();
        f.link_soft("/other/tiles", "tiles").unwrap();
    });
    assert!(printed.contains("link to another file, /other"), "{printed}");
    let printed = refused(|f| {
        f.unlink("tiles/0_0").unwrap();
        let tile = f.new_dataset::<f32>().shape((TILE, TILE));
        tile.external("/etc/passwd", 0, 4 * TILE * TILE).create("tiles/0_0").unwrap();
    });
    assert!(printed.contains("/tiles/0_0 refers to values in another file"), "{printed}");
    let printed = refused(|f| {
        f.unlink("tiles/0_0").unwrap();
        let tile = f.new_dataset::<f32>().shape((TILE, TILE));
        let all = || (0..TILE, 0..TILE);
        let shape = (TILE, TILE);
        tile.virtual_map(secret, "tiles/0_0", shape, all(), shape, all())
            .create("tiles/0_0")
            .unwrap();
    });
    assert!(printed.contains("/tiles/0_0 refers to values in another file"), "{printed}");
}

/// The error of a reference that `make` makes.
fn refused_reference(make: impl FnOnce(&File)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.h5");
    let file = File::create(&path).unwrap();
    let image = Array2::<f32>::zeros((4, 4));
    file.new_dataset_builder().with_data(&image).create("image").unwrap();
    make(&file);
    file.close().unwrap();
    arrays::read(&path, Some("image")).unwrap_err().to_string()
}

#[test]
fn groups_of_a_reference_may_form_circles_but_no_abyss() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.h5");
    let file = File::create(&path).unwrap();
    let inner = file.create_group("a/b/c").unwrap();
    inner.link_hard("/a", "back").unwrap();
    file.link_hard("/", "a/root").unwrap();
    let image = Array2::<f32>::ones((4, 4));
    inner.new_dataset_builder().with_data(&image).create("image").unwrap();
    file.close().unwrap();
    let array = arrays::read(&path, None).unwrap();
    assert_eq!((array.name.as_str(), array.data.shape()), ("/a/b/c/image", &[4, 4][..]));

    let printed = refused_reference(|f| {
        let mut group = f.create_group("g").unwrap();
        for _ in 0..20_000 {
            group = group.create_group("g").unwrap();
        }
    });
    assert!(printed.contains("more than 64 deep"), "{printed}");
}

#[test]
fn a_reference_takes_nothing_from_other_files() {
    let printed = refused_reference(|f| f.link_external("/etc/passwd", "/", "other").unwrap());
    assert!(printed.contains("link to another file, /other"), "{printed}");
    let printed = refused_reference(|f| {
        f.unlink("image").unwrap();
        let image = f.new_dataset::<u8>().shape((16, 16));
        image.external("/etc/passwd", 0, 256).create("image").unwrap();
    });
    assert!(printed.contains("another file"), "{printed}");
    let printed = refused_reference(|f| announce(f, "image", [1 << 30, 1 << 30]));
    assert!(printed.contains("at most 268435456"), "{printed}");
}

#[cfg(unix)]
#[test]
fn pipes_are_not_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["w.h5", "r.npy"] {
        let path = folder.path().join(name);
        let made = std::process::Command::new("mkfifo").arg(&path).status().unwrap();
        assert!(made.success());
        let printed = match name {
            "w.h5" => read_world(&path).unwrap_err().to_string(),
            _ => arrays::read(&path, None).unwrap_err().to_string(),
        };
        assert!(printed.contains("no regular file"), "{printed}");
    }
}

/// Writes the packed bytes of the only chunk of a dataset of two axes.
fn pack(dataset: &Dataset, packed: &[u8], skipped: u32) {
    // SAFETY: an offset for each of the two axes, and as many bytes as are announced.
    let written = hdf5::sync::sync(|| unsafe {
        hdf5_sys::h5d::H5Dwrite_chunk(
            dataset.id(),
            hdf5_sys::h5p::H5P_DEFAULT,
            skipped,
            [0, 0].as_ptr(),
            packed.len(),
            packed.as_ptr().cast(),
        )
    });
    assert!(written >= 0);
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// The error of a world whose first tile is this chunk, and the most memory that reading it took.
fn refused_tile(packed: &[u8], skipped: u32) -> (String, usize) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.h5");
    let file = world(&path);
    file.unlink("tiles/0_0").unwrap();
    let tile = file.new_dataset::<f32>().chunk((TILE, TILE)).deflate(1).shape((TILE, TILE));
    pack(&tile.create("tiles/0_0").unwrap(), packed, skipped);
    file.close().unwrap();
    let (read, bytes) = super::allocation::watch(|| read_world(&path));
    (read.unwrap_err().to_string(), bytes)
}

#[test]
fn chunks_unpack_to_their_size_or_not_at_all() {
    let whole = 4 * TILE * TILE;
    // libhdf5 1.10.8 shows what lies in memory behind a chunk that is too short, or dies
    for (packed, skipped) in [(deflated(&[0; 16]), 0), (vec![0; 16], 1)] {
        let (printed, _) = refused_tile(&packed, skipped);
        assert!(
            printed.contains("/tiles/0_0") && printed.contains("16 bytes in place of 1024"),
            "{printed}"
        );
    }
    // ... and takes the 512 MiB that this one becomes
    let bomb = deflated(&vec![0; 512 << 20]);
    let (printed, bytes) = refused_tile(&bomb, 0);
    assert!(printed.contains("unpacks to more than"), "{printed}");
    assert!(bytes < (8 << 20) + bomb.len(), "{bytes} bytes");
    let (printed, _) = refused_tile(&deflated(&vec![0; whole])[..9], 0);
    assert!(printed.contains("does not unpack"), "{printed}");
}

#[test]
fn packings_that_are_not_bounded_are_refused() {
    let printed = refused_reference(|f| {
        f.unlink("image").unwrap();
        let image = f.new_dataset::<i32>().chunk((4, 4)).nbit().shape((4, 4));
        image.create("image").unwrap();
    });
    assert!(printed.contains("NBit") && printed.contains("gzip"), "{printed}");
    let printed = refused_reference(|f| {
        f.unlink("image").unwrap();
        f.new_dataset::<f32>().chunk((1, 1)).shape((2000, 2000)).create("image").unwrap();
    });
    assert!(printed.contains("4000000 chunks"), "{printed}");
}

#[test]
fn values_are_those_that_the_library_reads() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.h5");
    let file = File::create(&path).unwrap();
    let floats = ndarray::Array3::from_shape_fn((5, 17, 23), |(i, j, k)| {
        (i * 1000 + j * 37 + k) as f64 * 0.25 - 300.0
    });
    let whole = floats.mapv(|v| v as i16);
    let bytes = floats.mapv(|v| v as u8);
    let builder = || file.new_dataset_builder().chunk((2, 5, 7));
    builder().shuffle().deflate(6).fletcher32().with_data(&floats).create("a").unwrap();
    builder().fletcher32().deflate(1).with_data(&whole).create("b").unwrap();
    builder().with_data(&bytes).create("c").unwrap();
    file.new_dataset_builder().with_data(&whole).create("d").unwrap();
    file.new_dataset_builder()
        .layout(hdf5::plist::dataset_create::Layout::Compact)
        .with_data(&bytes)
        .create("e")
        .unwrap();
    // of three rows only the first was written
    let partly = file.new_dataset::<f32>().chunk((1, 4)).shuffle().deflate(1).fill_value(2.5_f32);
    let partly = partly.shape((3, 6)).create("f").unwrap();
    partly.write_slice(&ndarray::arr2(&[[1_f32; 6]]), ndarray::s![0..1, ..]).unwrap();
    drop(partly);
    file.close().unwrap();
    let file = File::open(&path).unwrap();
    for name in ["a", "b", "c", "d", "e", "f"] {
        let expected = file.dataset(name).unwrap().read_dyn::<f64>().unwrap();
        assert_eq!(arrays::read(&path, Some(name)).unwrap().data, expected, "{name}");
    }
}

#[test]
fn blocks_before_a_file_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.h5");
    let file = hdf5::FileBuilder::new().with_fcpl(|p| p.userblock(512)).create(&path).unwrap();
    list(&file, "image", &Array2::<f32>::zeros((4, 4)));
    file.close().unwrap();
    let printed = arrays::read(&path, None).unwrap_err().to_string();
    assert!(printed.contains("block of other data"), "{printed}");
}
