//! Any file that is given to a reader is accepted or refused in a time that grows with its size, and within 1 GB.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use sha2::{Digest, Sha256};
use stemgen::imaging::Cache;
use stemgen::imaging::library_archive::import;
use stemgen::io::arrays;
use stemgen::io::recorded::{self, ImageChoice};
use stemgen::numerics::NUMERICS_VERSION;
use stemgen::progress::Silent;
use stemgen::replay::{ReplayOptions, ReplayWorld};
use stemgen::structure::{Format, parse};

use super::allocation::watch;
use super::fuzz::processor_seconds;

/// What a reader says of a structure: its number of atoms, or its error.
fn printed(format: Format, text: &str) -> String {
    within(|| match parse(format, text.as_bytes(), Path::new("f")) {
        Ok(structure) => match structure.resolve_occupancy(1) {
            Ok(_) => format!("{} atoms", structure.atoms.len()),
            Err(e) => e.to_string(),
        },
        Err(e) => e.to_string(),
    })
}

#[track_caller]
fn within<T>(run: impl FnOnce() -> T) -> T {
    let before = processor_seconds();
    let (result, bytes) = watch(run);
    let seconds = processor_seconds() - before;
    assert!(bytes <= 1 << 30, "{bytes} bytes");
    // Seconds are usual. What grows with the square of a million would take hours on any machine.
    assert!(seconds < 300.0, "{seconds} s");
    result
}

/// Libraries of simulations that claim gigabytes: images are unpacked one after the other, and a larger one not at all.
#[test]
fn libraries_that_claim_much_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (file, cache) = (folder.path().join("a.stemlib"), folder.path().join("cache"));
    let printed = |claimed: u64, packed: &[u8]| {
        let mut bytes = b"STEMLIB1".to_vec();
        bytes.extend(NUMERICS_VERSION.to_le_bytes());
        bytes.extend(8_u32.to_le_bytes());
        for number in 0..8 {
            bytes.extend([1_u16, 64].map(u16::to_le_bytes).as_flattened());
            bytes.extend([claimed, packed.len() as u64].map(u64::to_le_bytes).as_flattened());
            bytes.extend(format!("a{number:064x}").bytes());
            bytes.extend(packed);
        }
        let digest = Sha256::digest(&bytes);
        bytes.extend(digest);
        std::fs::write(&file, &bytes).unwrap();
        assert!(bytes.len() < 3 << 20, "{} bytes", bytes.len());
        let cache = Cache::at(cache.clone());
        within(|| import(&cache, &file, &Silent).unwrap_err().to_string())
    };
    let zeros = 255 << 20;
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::best());
    packed.write_all(&vec![0; zeros]).unwrap();
    let packed = packed.finish().unwrap();
    assert!(printed(zeros as u64, &packed).contains("is no array of this program"));
    assert!(printed(1000, &packed).contains("another size"));
    assert!(printed(1 << 40, &packed).contains("an invalid name or size"));
    assert!(!cache.exists());
}

fn xyz(cell: f64, extra: &str, atoms: impl Iterator<Item = String>) -> String {
    let lines: Vec<String> = atoms.collect();
    let lattice = format!("{cell} 0 0 0 {cell} 0 0 0 {cell}");
    format!("{}\nLattice=\"{lattice}\" {extra}\n{}\n", lines.len(), lines.join("\n"))
}

const PARTIAL: &str = "Properties=species:S:1:pos:R:3:occupancy:R:1";

#[test]
fn atoms_in_one_place() {
    let full = xyz(4.0, "", (0..1_000_000).map(|_| "Si 1 1 1".to_owned()));
    assert!(printed(Format::ExtXyz, &full).contains("together occupy more than one site"));
    let partial = xyz(4.0, PARTIAL, (0..1_000_000).map(|_| "Si 1 1 1 1e-7".to_owned()));
    assert!(printed(Format::ExtXyz, &partial).contains("more than 200 atoms"));
    let partial = xyz(4.0, PARTIAL, (0..30_000).map(|_| "Si 1 1 1 1e-5".to_owned()));
    assert!(printed(Format::ExtXyz, &partial).contains("more than 200 atoms"));
    let pile = xyz(4.0, PARTIAL, (0..150).map(|_| "Si 1 1 1 0.005".to_owned()));
    assert_eq!(printed(Format::ExtXyz, &pile), "150 atoms");
}

#[test]
#[ignore = "long"]
fn a_million_atoms_are_read_wherever_they_are() {
    let place = |i: usize, scale: f64| {
        let [x, y, z] = [i % 100, i / 100 % 100, i / 10_000].map(|n| n as f64 * scale);
        format!("Si {x} {y} {z}")
    };
    // A crystal, and a cluster in a vacuum so wide that the usual search would find all of it in one box.
    for (cell, scale) in [(200.0, 2.0), (900_000.0, 0.5)] {
        let text = xyz(cell, "", (0..1_000_000).map(|i| place(i, scale)));
        assert_eq!(printed(Format::ExtXyz, &text), "1000000 atoms");
    }
    // Piles of sites that are just not too many.
    let piles = xyz(900.0, PARTIAL, (0..400_000).map(|i| place(i / 150, 2.0) + " 0.001"));
    assert_eq!(printed(Format::ExtXyz, &piles), "400000 atoms");
}

#[test]
fn flat_cells_and_absurd_counts() {
    let flat = "1\nLattice=\"1 0 0 -0.5 0.866 0 0.5 0.288 0.001\" Properties=species:S:1:pos:R:3\nSi 0 0 0\n";
    assert!(printed(Format::ExtXyz, flat).contains("apart, expected at least 0.3 A"));
    assert!(
        printed(Format::ExtXyz, "99999999999\nLattice=\"4 0 0 0 4 0 0 0 4\"\n")
            .contains("at most 10000000")
    );
    let line = format!("1\nLattice=\"4 0 0 0 4 0 0 0 4\" {}\nSi 0 0 0\n", "a ".repeat(1 << 20));
    assert!(printed(Format::ExtXyz, &line).contains("at most 65536 are read"));
    let lines = "\n".repeat(100_000_000);
    let poscar = format!("c\n1\n4 0 0\n0 4 0\n0 0 4\nSi\n50000000\nDirect\n{lines}");
    assert!(printed(Format::Poscar, &poscar).contains("at most 10000000"));
}

#[test]
#[ignore = "long"]
fn cif_of_many_words() {
    let cell = "data_x\n_cell_length_a 9\n_cell_length_b 9\n_cell_length_c 9\n_cell_angle_alpha 90\n\
                _cell_angle_beta 90\n_cell_angle_gamma 90\n";
    let values = format!("{}\n", "1 ".repeat(32_000)).repeat(500);
    let text = format!("{cell}loop_\n_a\n{values}");
    assert!(text.len() > 30 << 20);
    assert!(printed(Format::Cif, &text).contains("no data block"));
    let tags: String = (0..2_000_000).fold(String::new(), |mut s, i| {
        let _ = writeln!(s, "_{i:x} 1");
        s
    });
    assert!(printed(Format::Cif, &format!("{cell}{tags}")).contains("no data block"));
    // A group of translations, as many as are read, and sites for each.
    let operations: String = (0..100).fold(String::new(), |mut s, i| {
        let _ = writeln!(s, "x,y,z+{i}/100");
        s
    });
    let sites = |n: usize| -> String {
        (0..n).fold(String::new(), |mut s, i| {
            let _ = writeln!(s, "Si {} {} 0", (i % 100) as f64 / 100.0, (i / 100) as f64 / 100.0);
            s
        })
    };
    let with = |n: usize| {
        format!(
            "{cell}loop_\n_symmetry_equiv_pos_as_xyz\n{operations}loop_\n_atom_site_type_symbol\n\
             _atom_site_fract_x\n_atom_site_fract_y\n_atom_site_fract_z\n{}",
            sites(n)
        )
    };
    let found = printed(Format::Cif, &with(30_000));
    assert!(found.contains("more than one site"), "{found}");
    assert!(printed(Format::Cif, &with(50_000)).contains("at most 4000000"));
}

#[test]
fn arrays_at_the_limit() {
    let folder = tempfile::tempdir().unwrap();
    let header = |shape: &str, kind: &str| {
        let text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
        [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes()].concat()
    };
    let path = folder.path().join("a.npy");
    // 64 million bytes become 512 MiB of numbers, and no more than that.
    let mut bytes = header("(8192, 8192)", "|u1");
    bytes.resize(bytes.len() + (1 << 26), 1);
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(within(|| arrays::read(&path, None)).unwrap().data.len(), 1 << 26);
    std::fs::write(&path, header("(8193, 8192)", "|u1")).unwrap();
    assert!(within(|| arrays::read(&path, None)).unwrap_err().to_string().contains("at most"));
}

/// A file of a head and so many bytes of which the last rows are not zero; the rest takes no room on the disk.
fn sparse(path: &Path, head: &[u8], row: &[u8], rows: u64) {
    use std::io::{Seek, SeekFrom};
    const FILLED: u64 = 200;
    let mut file = std::fs::File::create(path).unwrap();
    file.write_all(head).unwrap();
    file.seek(SeekFrom::Start(head.len() as u64 + (rows - FILLED) * row.len() as u64)).unwrap();
    (0..FILLED).for_each(|_| file.write_all(row).unwrap());
}

/// The largest image that is read becomes a world below 1 GB, whatever its numbers are.
#[test]
#[ignore = "long"]
fn the_import_of_the_largest_image_stays_below_one_gigabyte() {
    const EDGE: u64 = 8192;
    let folder = tempfile::tempdir().unwrap();
    let npy = |kind: &str| {
        let text =
            format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({EDGE}, {EDGE}), }}\n");
        [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes()].concat()
    };
    // One strip of single precision, as tifffile writes it.
    let tiff = |kind: u32, bits: u32| {
        let mut head = b"II*\0\x08\0\0\0\x09\0".to_vec();
        let size = EDGE as u32;
        let at = 8 + 2 + 9 * 12 + 4;
        for (tag, value) in [
            (256_u16, size),
            (257, size),
            (258, bits),
            (259, 1),
            (262, 1),
            (273, at),
            (278, size),
            (279, size * size * bits / 8),
            (339, kind),
        ] {
            head.extend([tag, 4].map(u16::to_le_bytes).as_flattened());
            head.extend([1, value].map(u32::to_le_bytes).as_flattened());
        }
        head.extend([0; 4]);
        head
    };
    let ramp =
        |bytes: fn(u64) -> Vec<u8>| (0..EDGE).flat_map(|k| bytes(k + 1)).collect::<Vec<u8>>();
    let double = ramp(|k| (k as f64).to_le_bytes().into());
    let single = ramp(|k| (k as f32).to_le_bytes().into());
    let short = ramp(|k| (k as u16).to_le_bytes().into());
    let options = ReplayOptions { pixel_nm: Some(0.02), ..ReplayOptions::default() };
    for (name, head, row) in [
        ("double.npy", npy("<f8"), &double),
        ("single.tif", tiff(3, 32), &single),
        ("short.tif", tiff(1, 16), &short),
    ] {
        let path = folder.path().join(name);
        sparse(&path, &head, row, EDGE);
        let (world, bytes) = watch(|| {
            let image = recorded::read(&path, &ImageChoice::default()).unwrap();
            ReplayWorld::new(image, &options).unwrap()
        });
        assert!(bytes < 1_000_000_000, "{name}: {bytes} bytes");
        assert_eq!((world.facts().recorded_px, world.facts().range[0]), ([8192; 2], 0.0), "{name}");
        assert!(world.facts().range[1] > 7000.0, "{name}: {:?}", world.facts().range);
        std::fs::remove_file(&path).unwrap();
    }
}

/// What comes to more than a file of its size may is refused for that reason, with the way out.
#[test]
fn an_image_that_is_packed_too_much_is_refused_for_that_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("packed.h5");
    let file = hdf5::File::create(&path).unwrap();
    let builder = file.new_dataset::<u16>().shape((8192, 8192)).chunk((512, 8192)).deflate(9);
    let dataset = builder.create("image").unwrap();
    let band = ndarray::Array2::<u16>::from_shape_fn((512, 8192), |(i, _)| i as u16);
    for first in (0..8192).step_by(512) {
        dataset.write_slice(&band, ndarray::s![first..first + 512, ..]).unwrap();
    }
    file.close().unwrap();
    let bytes = std::fs::metadata(&path).unwrap().len();
    assert!(bytes < (8192 * 8192 * 2) / 400, "{bytes} bytes: packed too little for this test");
    let printed = recorded::read(&path, &ImageChoice::default()).unwrap_err().to_string();
    for part in ["packed", ": 1; at most", "save it without compression (h5repack -f NONE)"] {
        assert!(printed.contains(part), "no `{part}` in {printed}");
    }
}
