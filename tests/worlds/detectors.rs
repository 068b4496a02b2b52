//! Worlds with several detectors: all from one simulation, each with images, scaling and noise of its own.

use std::path::Path;
use std::sync::Arc;

use ndarray::Array2;
use stemgen::engine::{Algorithm, Plan, Settings, simulate};
use stemgen::imaging::{
    AuditOptions, Cache, DirectImager, MethodChoice, MosaicImager, PixelBox, PixelRect,
    RegionImager, SharedLibrary, Simulator, audit, mean_atoms,
};
use stemgen::io::WorldFile;
use stemgen::progress::Silent;
use stemgen::recipe::{CheckedRecipe, Difficulty, Override, Recipe};
use stemgen::specimen::Specimen;
use stemgen::validate::worlds::{Sameness, compare};
use stemgen::world::{BuildMethod, BuildOptions, WorldBuild, build};

const ONE: &str = "detector={inner_mrad=50.0,outer_mrad=90.0}";
const THREE: &str = "detector=[{name=\"HAADF\",inner_mrad=50.0,outer_mrad=90.0},\
                     {name=\"ADF\",inner_mrad=45.0,outer_mrad=70.0},{name=\"ABF\",inner_mrad=10.0,outer_mrad=21.0}]";

/// Thin SrTiO3, 2 x 2 tiles of 16 pixels.
fn tiny(changes: &[&str]) -> CheckedRecipe {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/cli/tiny.toml"));
    let changes: Vec<Override> = changes.iter().map(|c| c.parse().unwrap()).collect();
    let recipe = Recipe::from_file(path, None).unwrap().with_overrides(&changes).unwrap();
    recipe.checked().unwrap()
}

fn options(method: BuildMethod) -> BuildOptions {
    BuildOptions {
        cache: Cache::none(),
        method,
        window_angstrom: matches!(method, BuildMethod::Window | BuildMethod::Mosaic).then_some(5.0),
        audit_regions: 0,
        keep_clean: true,
        ..BuildOptions::default()
    }
}

fn built(folder: &Path, name: &str, recipe: &CheckedRecipe, options: &BuildOptions) -> WorldFile {
    let path = folder.join(name);
    build(recipe, &path, options, &Silent).unwrap();
    WorldFile::open(&path).unwrap()
}

fn clean(world: &WorldFile) -> Array2<f32> {
    let [rows, columns] = world.shape();
    world.stitched_clean(0..rows, 0..columns).unwrap()
}

#[test]
fn windows_and_the_exact_engine_give_the_images_of_a_simulation_with_these_detectors() {
    let recipe = tiny(&[THREE, "phonons.configurations=2"]);
    let specimen: Arc<dyn Specimen> = stemgen::specimen::specimen(&recipe).unwrap();
    for algorithm in [Algorithm::Window { width_angstrom: 6.0 }, Algorithm::Multislice] {
        let simulator = Simulator::new(&recipe, algorithm);
        let imager = DirectImager::new(&recipe, &specimen, simulator.clone()).unwrap();
        let imager: &dyn RegionImager = &imager;
        let pixels = PixelRect::new([3, 5], [12, 9]);
        let ours = imager.means_of(&pixels, 2, &Silent).unwrap();
        let pixel_box = PixelBox::new(
            &pixels,
            recipe.field.pixel_nm(),
            simulator.margin_angstrom(),
            specimen.facts().thickness_nm,
        );
        let atoms = mean_atoms(&*specimen, &pixel_box.area, &recipe.phonons);
        let heights: Vec<f64> = atoms.iter().map(|a| a.position[2]).collect();
        let plan = Plan::new(simulator.settings(), pixel_box.size_angstrom, &heights).unwrap();
        let expected = simulate(&plan, &atoms, &pixel_box.scan, &Silent).unwrap();
        assert_eq!((ours.len(), imager.facts().detectors), (3, 3));
        for (n, image) in ours.iter().enumerate() {
            assert_eq!(image.mapv(|v| v as f32), expected.image(0, n), "{algorithm:?} {n}");
        }
        // Windows crop the beam; the bright field has the wave of the cropped part, the dark field is as without it.
        let without = Settings { direct_beam: false, ..simulator.settings().clone() };
        let plan = Plan::new(&without, pixel_box.size_angstrom, &heights).unwrap();
        let without = simulate(&plan, &atoms, &pixel_box.scan, &Silent).unwrap();
        let brighter = |n| expected.image(0, n).sum() / without.image(0, n).sum();
        match algorithm {
            Algorithm::Window { .. } => {
                assert!(brighter(2) > 1.02 && brighter(2) < 1.15, "{}", brighter(2));
                assert!((brighter(0) - 1.0).abs() < 3e-3, "{}", brighter(0));
            }
            _ => assert_eq!(expected, without),
        }
        // The whole of the annulus is brighter than its part, and the bright field than both.
        assert!(ours[1].sum() > 0.5 * ours[0].sum() && ours[2].sum() > 5.0 * ours[0].sum());
        assert_eq!(imager.mean_of(&pixels, 2, &Silent).unwrap(), ours[0]);
    }
}

#[test]
fn a_file_holds_each_detector_with_scaling_and_noise_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = tiny(&[THREE]);
    let world = built(folder.path(), "three.h5", &recipe, &options(BuildMethod::Window));
    assert_eq!(world.detectors(), recipe.detector.all());
    let alone = built(folder.path(), "one.h5", &tiny(&[ONE]), &options(BuildMethod::Window));
    assert!(alone.detectors().is_empty());
    let [rows, columns] = world.shape();
    let electrons = 1e5 * (10.0 * world.metadata().pixel_size_nm).powi(2);
    let mut noises = Vec::new();
    for detector in world.detectors() {
        let one = world.on_detector(&detector.name).unwrap();
        let [scale, offset] = one.metadata().scaling.unwrap();
        let stored = one.stitched(0..rows, 0..columns).unwrap();
        assert!(stored.iter().all(|v| (0.0..=1.0).contains(v)));
        let low = stored.iter().copied().fold(f32::INFINITY, f32::min);
        let high = stored.iter().copied().fold(0.0, f32::max);
        assert!(low == 0.0 && high == 1.0, "{}: {low} {high}", detector.name);
        let (noisy, clean) = (stored.mapv(|v| f64::from(v) * scale + offset), clean(&one));
        let noise = noisy - clean.mapv(f64::from);
        // Poisson: variance over mean is one electron.
        let ratio = (&noise * &noise).sum() * electrons / clean.mapv(f64::from).sum();
        assert!((ratio - 1.0).abs() < 0.25, "{}: {ratio}", detector.name);
        noises.push(noise / clean.mapv(|v| f64::from(v.sqrt())));
        assert_eq!(one.overview().unwrap().dim(), world.overview().unwrap().dim());
        assert_eq!(one.site_count().unwrap(), alone.site_count().unwrap());
    }
    for (a, b) in [(0, 1), (1, 2), (0, 2)] {
        let products = (&noises[a] * &noises[b]).sum();
        let [a, b] = [a, b].map(|n| noises[n].mapv(|v| v * v).sum().sqrt());
        let pixels = (rows * columns) as f64;
        assert!((products / (a * b)).abs() < 4.0 / pixels.sqrt(), "{}", products / (a * b));
    }
    // The main image lies where that of a single detector does.
    let main = world.on_detector("HAADF").unwrap();
    assert_eq!(main.tile(1, 0).unwrap(), world.tile(1, 0).unwrap());
    let message = world.on_detector("BF").err().unwrap().to_string();
    assert!(message.contains("no detector `BF`; it has HAADF, ADF, ABF"), "{message}");
    let message = alone.on_detector("BF").err().unwrap().to_string();
    assert!(message.contains("one detector without a name"), "{message}");
    // h5py's view of it: groups, links and attributes by these names.
    let file = hdf5::File::open(world.path()).unwrap();
    let group = file.group("detectors/ABF").unwrap();
    let angle = |name: &str| group.attr(name).unwrap().read_scalar::<f64>().unwrap();
    assert_eq!((angle("inner_mrad"), angle("outer_mrad")), (10.0, 21.0));
    assert!(file.dataset("detectors/HAADF/tiles/1_1").is_ok());
    assert!(file.dataset("detectors/ABF/overview").is_ok());
}

/// Sectors of a world: their sum is the image of the annulus, a mosaic makes them as windows do, and the file has their azimuths.
#[test]
#[ignore = "long"]
fn sectors_add_to_their_annulus_and_carry_their_azimuths() {
    let folder = tempfile::tempdir().unwrap();
    let sectors = THREE.replace(
        "outer_mrad=21.0}]",
        "outer_mrad=21.0},{name=\"DPC\",inner_mrad=10.0,outer_mrad=21.0,sectors=4,first_sector_deg=45.0}]",
    );
    let recipe = tiny(&[&sectors]);
    let direct = built(folder.path(), "w.h5", &recipe, &options(BuildMethod::Window));
    let mosaic = built(folder.path(), "m.h5", &recipe, &options(BuildMethod::Mosaic));
    let names: Vec<&str> = direct.detectors().iter().map(|d| d.name.as_str()).collect();
    assert_eq!(names, ["HAADF", "ADF", "ABF", "DPC_0", "DPC_1", "DPC_2", "DPC_3"]);
    let of = |world: &WorldFile, name: &str| clean(&world.on_detector(name).unwrap());
    for world in [&direct, &mosaic] {
        assert_eq!(world.detectors()[4].sector_degrees, Some([135.0, 225.0]));
        let whole = of(world, "ABF");
        let parts: Vec<Array2<f32>> = (0..4).map(|n| of(world, &format!("DPC_{n}"))).collect();
        let sum = &(&parts[0] + &parts[1]) + &(&parts[2] + &parts[3]);
        let worst = (&sum / &whole).iter().map(|v| (v - 1.0).abs()).fold(0.0, f32::max);
        assert!(worst < 2e-3, "{worst}");
        // The beam is deflected: opposite sectors differ, on average they do not.
        let difference = (&parts[0] - &parts[2]) / &whole;
        let rms = difference.mapv(|v| v * v).mean().unwrap().sqrt();
        assert!(rms > 0.01 && difference.mean().unwrap().abs() < 0.5 * rms, "{rms}");
    }
    for name in ["DPC_0", "DPC_3"] {
        let [a, b] = [&direct, &mosaic].map(|world| of(world, name));
        let off = (&a - &b).mapv(|v| v * v).mean().unwrap().sqrt() / a.mean().unwrap();
        assert!(off < 0.05, "{name}: {off}");
    }
    let file = hdf5::File::open(direct.path()).unwrap();
    let group = file.group("detectors/DPC_1").unwrap();
    let azimuths = group.attr("sector_degrees").unwrap().read_raw::<f64>().unwrap();
    assert_eq!(azimuths, [135.0, 225.0]);
}

/// The centre of mass of a world: signed images in mrad with the noise of their electrons.
#[test]
fn a_centre_of_mass_is_signed_and_has_the_noise_of_its_electrons() {
    let folder = tempfile::tempdir().unwrap();
    let both = "detector=[{name=\"HAADF\",inner_mrad=50.0,outer_mrad=90.0},\
                {name=\"COM\",inner_mrad=0.0,outer_mrad=25.0,centre_of_mass=true}]";
    let field = "field={fov_nm=[1.0,1.0],grid=[1,1],tile_px=12,overlap_px=0,thickness_nm=0.8}";
    let recipe = tiny(&[both, field]);
    let direct = built(folder.path(), "w.h5", &recipe, &options(BuildMethod::Window));
    let names: Vec<&str> = direct.detectors().iter().map(|d| d.name.as_str()).collect();
    assert_eq!(names, ["HAADF", "COM_x", "COM_y"]);
    assert_eq!(direct.detectors(), recipe.detector.all());
    let [rows, columns] = direct.shape();
    let electrons = 1e5 * (10.0 * direct.metadata().pixel_size_nm).powi(2);
    let file = hdf5::File::open(direct.path()).unwrap();
    for (name, axis) in [("COM_x", "x"), ("COM_y", "y")] {
        let one = direct.on_detector(name).unwrap();
        let a = clean(&one);
        let rms = a.mapv(|v| v * v).mean().unwrap().sqrt();
        println!("{name}: {rms:.3} mrad rms");
        assert!(rms > 0.2, "{name}: {rms}");
        assert!(a.iter().any(|v| *v < 0.0) && a.iter().any(|v| *v > 0.0));
        let [scale, offset] = one.metadata().scaling.unwrap();
        let stored = one.stitched(0..rows, 0..columns).unwrap();
        assert!(offset < 0.0 && stored.iter().all(|v| (0.0..=1.0).contains(v)));
        let noise = stored.mapv(|v| f64::from(v) * scale + offset) - a.mapv(f64::from);
        // One electron of an evenly lit disk has the variance of 21^2 / 4; 144 pixels measure it to 12 %.
        let variance = (&noise * &noise).mean().unwrap() * electrons / (21.0 * 21.0 / 4.0);
        println!("{name}: variance {variance:.3} of a lit disk");
        assert!((0.6..1.5).contains(&variance), "{name}: {variance}");
        let group = file.group(&format!("detectors/{name}")).unwrap();
        let text = |at: &hdf5::Group, name: &str| {
            let value = at.attr(name).unwrap().read_scalar::<hdf5::types::VarLenUnicode>().unwrap();
            value.to_string()
        };
        assert_eq!(text(&group, "centre_of_mass"), axis);
        let tiles = group.group("tiles").unwrap();
        assert_eq!(text(&tiles, "unit"), "mrad = value * scale + offset");
        assert_eq!(text(&group.group("clean").unwrap(), "unit"), "mrad");
    }
    let recorded = tiny(&[both, "acquisition.profile=\"ideal\""]);
    let message = WorldBuild::new(&recorded, &options(BuildMethod::Window)).err().unwrap();
    assert!(message.to_string().contains("a recording has one detector"), "{message}");
}

#[test]
#[ignore = "long"]
fn a_table_and_an_array_of_the_same_detector_give_the_same_tiles() {
    let folder = tempfile::tempdir().unwrap();
    let array = "detector=[{name=\"HAADF\",inner_mrad=50.0,outer_mrad=90.0}]";
    let [table, array] = [("t.h5", ONE), ("a.h5", array)].map(|(name, detector)| {
        built(folder.path(), name, &tiny(&[detector]), &options(BuildMethod::Mosaic))
    });
    for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        assert_eq!(table.tile(row, column).unwrap(), array.tile(row, column).unwrap());
    }
    assert_eq!(array.detectors().len(), 1);
}

#[test]
#[ignore = "long: two libraries with a bright field"]
fn bytes_of_several_detectors_do_not_depend_on_threads() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = tiny(&[THREE]);
    for method in [BuildMethod::Mosaic, BuildMethod::Window] {
        let with = |threads: usize| {
            let path = folder.path().join(format!("{method:?}{threads}.h5"));
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let build = || build(&recipe, &path, &options(method), &Silent).unwrap();
            pool.install(build);
            std::fs::read(&path).unwrap()
        };
        assert!(with(1) == with(3), "{method:?}");
    }
}

#[test]
#[ignore = "long"]
fn an_audit_tells_the_error_of_every_detector_of_a_mosaic() {
    let field = "field={fov_nm=[2.2,2.2],grid=[1,1],tile_px=110,overlap_px=0,thickness_nm=0.8}";
    let recipe = tiny(&[THREE, field]);
    let specimen: Arc<dyn Specimen> = stemgen::specimen::specimen(&recipe).unwrap();
    let simulator = Simulator::new(&recipe, Algorithm::Window { width_angstrom: 7.8 });
    let mut mosaic = MosaicImager::new(&recipe, &specimen, simulator, Cache::none()).unwrap();
    mosaic.prepare(&Silent).unwrap();
    let options = AuditOptions { regions: 1, size_nm: 0.8, ..AuditOptions::default() };
    let found = audit(&recipe, &*specimen, &mosaic, &options, &Silent).unwrap();
    let names: Vec<_> = found.all().map(|a| a.detector.clone().unwrap()).collect();
    assert_eq!(names, ["HAADF", "ADF", "ABF"]);
    for one in found.all().take(2) {
        println!("{:?} {} {}", one.detector, one.bright_rms_percent, one.all_rms_percent);
        assert!(one.bright_rms_percent < 1.5 && one.all_rms_percent < 1.5);
    }
    // Each is compared with its own exact image: their intensities differ.
    let means: Vec<f64> = found.all().map(|a| a.regions[0].exact.mean().unwrap()).collect();
    assert!(means[2] > 5.0 * means[0] && means[0] != means[1], "{means:?}");
}

#[test]
fn two_worlds_are_compared_on_every_detector() {
    let folder = tempfile::tempdir().unwrap();
    let a = built(folder.path(), "a.h5", &tiny(&[THREE]), &options(BuildMethod::Window));
    let seed = tiny(&[THREE, "seed=2"]);
    let b = built(folder.path(), "b.h5", &seed, &options(BuildMethod::Window));
    let c = built(folder.path(), "c.h5", &tiny(&[ONE]), &options(BuildMethod::Window));
    let same = compare(a.path(), b.path(), 0.001, &Silent).unwrap();
    assert!(same.lines.iter().any(|l| l.what == "ABF: mean of the image" && l.a.is_some()));
    assert!(same.lines.iter().any(|l| l.what == "detectors" && l.verdict == Sameness::Same));
    let other = compare(a.path(), c.path(), 0.001, &Silent).unwrap();
    let line = other.lines.iter().find(|l| l.what == "detectors").unwrap();
    assert_eq!(line.verdict, Sameness::Different);
    assert!(line.text.contains("ABF 10-21 mrad") && line.text.contains("one without a name"));
}

/// Bright fields make the windows of a mosaic wider, and that is said; detectors outside the beam do not.
#[test]
fn a_bright_field_takes_wider_windows() {
    let by = |method: BuildMethod, detectors: &str| {
        let recipe = Recipe::load("srtio3", Difficulty::Hard).unwrap();
        let recipe = recipe.with_overrides(&[detectors.parse().unwrap()]).unwrap();
        let options = BuildOptions { method, ..BuildOptions::default() };
        options.policy(&recipe.checked().unwrap()).unwrap()
    };
    let policy = |detectors: &str| by(BuildMethod::Auto, detectors);
    for method in [BuildMethod::Mosaic, BuildMethod::Window] {
        let asked = by(method, THREE);
        assert_eq!(asked.imaging.simulator.window_angstrom(), Some(15.6));
        assert!(asked.warnings[0].contains("ABF sees the direct beam"), "{:?}", asked.warnings);
    }
    let bright = policy(THREE);
    assert_eq!(bright.imaging.method, MethodChoice::Auto);
    assert_eq!(bright.imaging.simulator.window_angstrom(), Some(15.6));
    assert!(bright.warnings[0].contains("ABF sees the direct beam"), "{:?}", bright.warnings);
    let dark = policy(
        "detector=[{name=\"HAADF\",inner_mrad=68.0,outer_mrad=200.0},{name=\"ADF\",inner_mrad=50.0,outer_mrad=100.0}]",
    );
    assert_eq!(dark.imaging.method, MethodChoice::Auto);
    assert_eq!(dark.imaging.simulator.window_angstrom(), Some(7.8));
    // Between one and two semiangles neither does.
    let between = policy(
        "detector=[{name=\"HAADF\",inner_mrad=68.0,outer_mrad=200.0},{name=\"LAADF\",inner_mrad=25.0,outer_mrad=60.0}]",
    );
    assert_eq!(between.imaging.simulator.name(), "prism");
    assert!(between.warnings[0].contains("LAADF"), "{:?}", between.warnings);
}

#[test]
fn what_has_one_detector_refuses_more_before_any_work() {
    let recorded = tiny(&[THREE, "acquisition.profile=\"ideal\""]);
    let message = WorldBuild::new(&recorded, &options(BuildMethod::Window)).err().unwrap();
    let message = message.to_string();
    assert!(message.contains("a recording has one detector"), "{message}");
    // Beyond what the grid of the published settings carries, a detector is an error that names it.
    let beyond = "detector=[{name=\"HAADF\",inner_mrad=68.0,outer_mrad=200.0},\
                  {name=\"FAR\",inner_mrad=180.0,outer_mrad=220.0}]";
    let published = Simulator::published(&tiny(&[beyond]));
    let fault = published.plan([10.0, 10.0], 8.0, &[1.0]).err().unwrap().to_string();
    assert!(fault.contains("FAR"), "{fault}");
}
