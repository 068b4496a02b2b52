//! `stemgen view`.

use super::{fails, file, stderr, stdout, stemgen};
use std::path::Path;
use stemgen::io::WorldFile;
use stemgen::render::palette;

const VACANCIES: &str = "vacancies={element=\"O\", rate=0.4, cluster_fraction=0.0, \
                         cluster_sigma_nm=1.0, max_probability=0.5}";

/// A tiny world with vacancies, `w.h5`.
fn build(folder: &Path) -> WorldFile {
    let mut command = stemgen(folder);
    command.args(["build", "--recipe", &file("tests/cli/tiny.toml"), "--set", VACANCIES]);
    let run = command.args(["-o", "w.h5", "--no-png", "--quiet"]).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    WorldFile::open(&folder.join("w.h5")).unwrap()
}

struct Decoded {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Decoded {
    fn at(&self, [x, y]: [f64; 2]) -> [u8; 3] {
        let start = 3 * (y.round() as usize * self.width + x.round() as usize);
        [self.pixels[start], self.pixels[start + 1], self.pixels[start + 2]]
    }
}

fn view(folder: &Path, arguments: &[&str]) -> Decoded {
    let mut command = stemgen(folder);
    command.args(["view", "w.h5", "-o", "v.png", "--overwrite", "--quiet"]);
    let run = command.args(arguments).output().unwrap();
    assert!(run.status.success() && run.stdout.is_empty(), "{}", stderr(&run));
    let file = std::fs::File::open(folder.join("v.png")).unwrap();
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    Decoded { width: info.width as usize, height: info.height as usize, pixels }
}

#[test]
fn atoms_and_rings_stand_where_the_truth_says() {
    let folder = tempfile::tempdir().unwrap();
    let world = build(folder.path());
    let pixel = world.metadata().pixel_size_nm;
    let side = pixel * world.shape()[0] as f64;
    let picture = view(folder.path(), &["--size", "1400"]);
    assert_eq!((picture.width, picture.height), (1400, 1400), "no legend without overlays");
    let place = |[x, y]: [f32; 2], corner: f64, scale: f64| {
        [x, y].map(|v| (f64::from(v) + 0.5 * pixel - corner) * scale - 0.5)
    };
    // Strontium scatters most.
    let columns = world.columns().unwrap();
    let inside = |at: [f64; 2], size: f64| at.iter().all(|v| (30.0..size - 30.0).contains(v));
    let light = |p: [u8; 3]| u32::from(p[0]);
    let truth = world.truth(0..world.site_count().unwrap()).unwrap();
    let mut bright = Vec::new();
    for (i, _) in truth.numbers.iter().enumerate().filter(|(_, n)| **n == 38) {
        let at = place(truth.positions[i], 0.0, 1400.0 / side);
        if inside(at, 1400.0) && at[1] < 1000.0 {
            bright.push(light(picture.at(at)));
        }
    }
    let mean = f64::from(bright.iter().sum::<u32>()) / bright.len() as f64;
    let all: f64 = picture.pixels.iter().map(|p| f64::from(*p)).sum();
    let dark = all / picture.pixels.len() as f64;
    assert!(bright.len() > 4 && mean > 2.5 * dark, "{mean} at strontium, {dark} on average");
    // Rings of a part: from pixel 3 to pixel 25 of 28.
    let (from, to) = (2.6 * pixel, 24.4 * pixel);
    let part = format!("{from},{from},{to},{to}");
    let picture =
        view(folder.path(), &["--region", &part, "--overlay", "defects", "--size", "700"]);
    assert!(picture.height == 700 && picture.width > 720, "a legend beside it");
    let mut found = 0;
    for column in columns.iter().filter(|c| c.vacancies > 0) {
        let scale = 700.0 / (22.0 * pixel);
        let [x, y] = place(column.position_nm, 3.0 * pixel, scale);
        let right = [x + 0.085 * scale, y];
        if inside(right, 700.0) && inside([x, y], 700.0) && y < 550.0 {
            let color = picture.at(right);
            let share = f64::from(column.vacancies) / f64::from(column.sites);
            let least = if share > 0.4 { 60 } else { 110 };
            let far = (0..3).map(|k| color[k].abs_diff(palette::VACANCY[k])).max().unwrap();
            assert!(far < least, "{color:?} beside {column:?}");
            found += 1;
        }
    }
    assert!(found > 2, "{found} rings");
}

#[test]
fn bad_requests_are_explained() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    build(here);
    std::fs::write(here.join("text.h5"), "no world").unwrap();
    let bytes = std::fs::read(here.join("w.h5")).unwrap();
    std::fs::write(here.join("cut.h5"), &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(here.join("there.png"), "precious").unwrap();
    let images = stemgen_file(here, "images.h5");
    images.new_attr::<hdf5::types::VarLenUnicode>().create("format").unwrap();
    let format: hdf5::types::VarLenUnicode = "stemgen images".parse().unwrap();
    images.attr("format").unwrap().write_scalar(&format).unwrap();
    let other = stemgen_file(here, "other.h5");
    other.create_group("entry").unwrap();
    drop((images, other));
    std::fs::copy(here.join("w.h5"), here.join("nan.h5")).unwrap();
    let world = hdf5::File::open_rw(here.join("nan.h5")).unwrap();
    let tile = world.dataset("tiles/1_0").unwrap();
    tile.write_slice(&ndarray::arr2(&[[f32::NAN]]), (5..6, 7..8)).unwrap();
    drop((tile, world));
    damage(here, "w.h5", "damaged.h5");
    let cases: [(&[&str], &str); 20] = [
        (&["w.h5", "--overlay", "boundaries"], "no boundaries"),
        (&["w.h5", "--grid", "1x1"], "leave out --difficulty and --grid"),
        (&["none.h5"], "none.h5"),
        (&["text.h5"], "is not HDF5"),
        (&["cut.h5"], "truncated"),
        (&["w.h5", "--clean"], "--keep-clean"),
        (&["w.h5", "--overlay", "particles"], "no particles"),
        (&["w.h5", "--overlay", "phases"], "no phases"),
        (&["w.h5", "--overlay", "columns", "--region", "9,9,10,10"], "0,0 to 1.40,1.40"),
        (&["w.h5", "--region", "1,1,0,0"], "right of and below"),
        (&["w.h5", "-o", "there.png"], "--overwrite"),
        (&["images.h5"], "holds no images"),
        (&["other.h5"], "no group /metadata, but entry"),
        (&["nan.h5"], "nan.h5: holds NaN at row 17, column 7 of the image (/tiles/1_0)"),
        (&["nan.h5", "--html"], "holds NaN at row 17, column 7"),
        (&["damaged.h5"], "/tiles/0_1 has a chunk at [0, 0] that does not unpack"),
        (&["w.h5", "--html", "--clean"], "--keep-clean"),
        (&["w.h5", "--html", "--overlay", "particles"], "no particles"),
        (&["w.h5", "--html", "--size", "900"], "cannot be used with"),
        (&["w.h5", "--html", "-o", "there.png"], "--overwrite"),
    ];
    for (arguments, part) in cases {
        let printed = fails(stemgen(here).arg("view").args(arguments));
        assert!(printed.contains(part), "{arguments:?}: no `{part}` in\n{printed}");
    }
    assert_eq!(std::fs::read_dir(here).unwrap().count(), 8, "nothing was written");
}

fn stemgen_file(folder: &Path, name: &str) -> hdf5::File {
    hdf5::File::create(folder.join(name)).unwrap()
}

/// Copies a world, and spoils the compressed pixels of tile (0, 1).
fn damage(folder: &Path, from: &str, to: &str) {
    let at = {
        let world = hdf5::File::open(folder.join(from)).unwrap();
        let chunk = world.dataset("tiles/0_1").unwrap().chunk_info(0).unwrap();
        (chunk.addr..chunk.addr + chunk.size).map(|b| b as usize)
    };
    let mut bytes = std::fs::read(folder.join(from)).unwrap();
    at.for_each(|b| bytes[b] ^= 0x5a);
    std::fs::write(folder.join(to), bytes).unwrap();
}

#[test]
fn columns_of_a_file_that_lists_none_are_sites_above_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let world = build(here);
    let mut expected = world.columns().unwrap();
    drop(world);
    let file = hdf5::File::open_rw(here.join("w.h5")).unwrap();
    file.unlink("ground_truth/columns").unwrap();
    drop(file);
    let mut found = WorldFile::open(&here.join("w.h5")).unwrap().columns().unwrap();
    for list in [&mut expected, &mut found] {
        list.sort_by_key(|c| c.position_nm.map(|v| (1000.0 * v).round() as i64));
    }
    assert_eq!(found, expected);
    let picture = view(here, &["--overlay", "defects,columns", "--size", "700"]);
    assert!(picture.width > 720, "a legend beside it");
    assert!(stemgen(here).args(["view", "w.h5", "--html", "-q"]).status().unwrap().success());
    let page = std::fs::read_to_string(here.join("w.html")).unwrap();
    assert!(page.contains(&format!("\"count\":{}", expected.len())), "the page has its columns");
}

#[test]
fn the_specimen_of_a_recipe_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let view = |arguments: &[&str]| {
        let mut command = stemgen(folder.path());
        command.arg("view").args(arguments);
        command
    };
    let run = view(&["srtio3", "--difficulty", "easy", "--grid", "1x1"]).output().unwrap();
    assert!(run.status.success(), "{}", super::stderr(&run));
    assert!(folder.path().join("srtio3.view.png").exists());
    let run = view(&[&super::file("tests/cli/tiny.toml"), "-o", "t.png"]).status().unwrap();
    assert!(run.success() && folder.path().join("t.png").exists());
    let printed = super::fails(&mut view(&["srtio3", "--difficulty", "easy", "--html"]));
    assert!(printed.contains("build the world for --html"), "{printed}");
}

/// What `simulate` and `acquire` write can be looked at, and tells the command that made it.
#[test]
fn images_and_recordings_are_drawn_and_described() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    build(here);
    let run = |arguments: &[&str]| {
        let done = stemgen(here).args(arguments).output().unwrap();
        assert!(done.status.success(), "{arguments:?}: {}", stderr(&done));
        stdout(&done)
    };
    let si = file("structures/si.cif");
    let simulate = ["simulate", &si, "--sampling", "0.1", "--scan-points", "6,4", "--quiet"];
    let detectors = ["--detector", "ADF=40-80", "--detector", "BF=0-10"];
    let thick = ["--thicknesses", "2.7,5.431", "-o", "i.h5"];
    run(&[&simulate[..], &detectors, &thick].concat());
    run(&[
        "acquire",
        "w.h5",
        "--dose",
        "1e4",
        "--frames",
        "2",
        "--keep-frames",
        "-o",
        "r.h5",
        "--quiet",
    ]);

    let printed = run(&["view", "i.h5", "--detector", "BF", "--index", "0", "--size", "128"]);
    assert!(printed.contains("BF, number 0 of 0 to 1, 0.54 x 0.54 nm"), "{printed}");
    let printed = run(&["view", "r.h5", "-o", "r.png"]);
    assert!(printed.contains("recording, number 1 of 0 to 1"), "{printed}");
    run(&["view", "r.h5", "--clean", "-o", "c.png"]);
    let bytes = |name: &str| std::fs::read(here.join(name)).unwrap();
    assert!(bytes("i.view.png").starts_with(b"\x89PNG") && bytes("r.png") != bytes("c.png"));

    let printed = run(&["info", "i.h5", "r.h5"]);
    assert!(printed.contains("ADF, BF") && printed.contains("stemgen acquire w.h5"), "{printed}");
    let printed: serde_json::Value =
        serde_json::from_str(&run(&["info", "r.h5", "--json"])).unwrap();
    assert_eq!(printed["images"][0]["kind"], "recording");

    for (arguments, fault) in [
        (&["view", "i.h5", "--detector", "HAADF", "-o", "f.png"][..], "contains ADF, BF"),
        (
            &["view", "i.h5", "--index", "2", "-o", "f.png"],
            "has 2 images; expected an index from 0 to 1",
        ),
        (&["view", "i.h5", "--clean", "-o", "f.png"], "--clean"),
        (&["view", "r.h5", "--overlay", "defects", "-o", "f.png"], "is no world"),
        (&["view", "w.h5", "--index", "0", "-o", "f.png"], "a world is one image"),
        (&["view", "i.h5", "-o", "i.h5", "--overwrite"], "i.h5"),
    ] {
        let printed = fails(stemgen(here).args(arguments));
        assert!(printed.contains(fault), "{arguments:?}: {printed}");
        assert!(!here.join("f.png").exists());
    }
}
