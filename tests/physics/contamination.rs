//! Carbon that grows under the beam.

use ndarray::{Array2, Axis, s};
use stemgen::acquisition::{Acquisition, Profile, SourceImage};
use stemgen::engine::Algorithm;
use stemgen::imaging::{
    Cache, DetectorChoice, DisplacedAtoms, GrownCarbon, ImageBlocks, ImagerFacts, ImagingCost,
    PixelRect, RasterDetail, RegionImager, SharedLibrary, Simulator, SurfaceImager, TurnedRaster,
};
use stemgen::live::{LiveOptions, LiveRequest, LiveSnapshot, LiveWorld};
use stemgen::progress::{Progress, Silent};
use stemgen::recipe::{CheckedRecipe, Override, Recipe, Region};
use stemgen::specimen::{DoseMap, specimen};
use stemgen::world::{
    BuildMethod, BuildOptions, Electrons, FieldRecording, ImagerSource, RecordedPart,
    RecordingOptions, record, refined, refinement,
};

/// The middle of the field of the recipe for tests, in nm from its first built pixel.
const CENTRE_NM: [f64; 2] = [4.0, 3.6];

fn recipe(changes: &[&str]) -> CheckedRecipe {
    let changes: Vec<Override> = changes.iter().map(|c| c.parse().expect("a change")).collect();
    Recipe::load("test", None).unwrap().with_overrides(&changes).unwrap().checked().unwrap()
}

/// A specimen that scatters nothing.
struct Vacuum;

impl RegionImager for Vacuum {
    fn facts(&self) -> ImagerFacts {
        ImagerFacts::new("vacuum", serde_json::json!({}))
    }

    fn library_mut(&mut self) -> Option<&mut dyn SharedLibrary> {
        None
    }

    fn blocks(&self) -> Option<&dyn ImageBlocks> {
        None
    }

    fn images_of(
        &self,
        pixels: &PixelRect,
        _: DetectorChoice,
        _: usize,
        _: &dyn Progress,
    ) -> stemgen::Result<Vec<Array2<f64>>> {
        Ok(vec![Array2::zeros(pixels.sampled_shape())])
    }

    fn images_at(
        &self,
        _: &TurnedRaster,
        _: RasterDetail,
        _: DetectorChoice,
        _: usize,
        _: &dyn Progress,
    ) -> stemgen::Result<Option<Vec<Array2<f64>>>> {
        Ok(None)
    }

    fn atoms(&self, _: &Region, _: usize) -> DisplacedAtoms {
        DisplacedAtoms::default()
    }

    fn cost(&self, _: [usize; 2], _: usize) -> stemgen::Result<ImagingCost> {
        unreachable!("no test asks for it")
    }
}

/// Edge of the recorded part in nm.
const SIZE_NM: f64 = 4.0;

/// Frames of carbon alone; `dose` is that of all frames.
fn recorded(
    recipe: &CheckedRecipe,
    acquisition: Acquisition,
    dose: f64,
) -> stemgen::Result<FieldRecording> {
    let pixel_nm = recipe.field.pixel_nm();
    let part = RecordedPart { centre_nm: CENTRE_NM, size_nm: [SIZE_NM; 2], pixel_nm };
    let electrons = Electrons::Dose(dose);
    let options =
        RecordingOptions { acquisition, electrons, seed: 3, keep_frames: true, keep_stages: true };
    let fine = refined(recipe, refinement(recipe)).unwrap();
    let source = ImagerSource { imager: &Vacuum, recipe: &fine };
    record(recipe, &*specimen(recipe).unwrap(), &source, &part, &options, &Silent)
}

fn growing(frames: usize, rate: f64) -> Acquisition {
    let ideal = Profile::Ideal.acquisition();
    Acquisition { frames, contamination_angstrom3_per_electron: rate, ..ideal }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (n, sum) = values.fold((0.0, 0.0), |(n, sum), v| (n + 1.0, sum + v));
    sum / n
}

/// Thickness = rate x dose of the frames before, and as bright as a layer of this thickness that was there from the beginning. Read
/// from the file.
#[test]
#[ignore = "long"]
fn a_file_shows_as_much_carbon_as_the_dose_has_made() {
    let recipe = recipe(&[]);
    // 1e8 e/A2 in 5 frames, 2e7 each: 1 nm of carbon from frame to frame
    let recording = recorded(&recipe, growing(5, 5e-7), 1e8).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("carbon.h5");
    recording.write(&path, false, &recipe, &*specimen(&recipe).unwrap(), "test").unwrap();
    let file = hdf5::File::open(&path).unwrap();
    let printed: Vec<f64> = file.dataset("carbon_nm").unwrap().read_raw().unwrap();
    let counts = file.dataset("recording").unwrap().read::<f32, ndarray::Ix3>().unwrap();
    let ideal = file.dataset("ideal").unwrap().read_2d::<f32>().unwrap();
    assert!(ideal.iter().all(|v| *v == 0.0), "there was nothing when it began");
    let frame = recording.exposure.electrons_per_pixel;
    for (number, printed) in printed.iter().enumerate() {
        assert!((printed - number as f64).abs() < 1e-6, "frame {number}: {printed} nm");
        // Further out, the tails of the probe leave the carbon.
        let counts = counts.index_axis(Axis(0), number);
        let edge = (0.5 / recipe.field.pixel_nm()) as usize;
        let inner = counts.slice(s![edge..counts.nrows() - edge, edge..counts.ncols() - edge]);
        let seen = mean(inner.iter().map(|v| f64::from(*v))) / frame;
        if number == 0 {
            assert_eq!(seen, 0.0);
            continue;
        }
        let known = layer_brightness(*printed, SIZE_NM - 1.0);
        println!("{printed:.3} nm of carbon: {seen:.6} of the beam, a layer of it {known:.6}");
        assert!((seen / known - 1.0).abs() < 0.05, "{printed} nm: {seen}, expected {known}");
    }
}

/// Mean brightness of a layer from the recipe, over about as large a region.
fn layer_brightness(thickness_nm: f64, size_nm: f64) -> f64 {
    let layer = recipe(&[&format!("surface.entrance_nm={thickness_nm}")]);
    let bare = recipe(&[]);
    let settings = Simulator::new(&bare, Algorithm::Window { width_angstrom: 7.8 });
    let specimen = specimen(&layer).unwrap();
    let imager =
        SurfaceImager::covering(Box::new(Vacuum), &layer, &*specimen, settings.settings()).unwrap();
    let pixels = (size_nm / layer.field.pixel_nm()).round() as usize;
    let image = imager.mean_of(&PixelRect::new([40; 2], [pixels; 2]), 1, &Silent).unwrap();
    mean(image.iter().copied())
}

/// Grown in many steps, unevenly, against all atoms at once.
#[test]
fn growth_step_by_step_is_that_of_all_atoms_at_once() {
    for changes in [&[][..], &["optics.source_fwhm_angstrom=0.8"]] {
        let recipe = recipe(changes);
        let carbon = GrownCarbon::on(&recipe, 0.8).unwrap();
        let area = Region { x: [2.0, 4.0], y: [2.0, 4.0] };
        let (mut steps, mut once) = (carbon.patch(&area), carbon.patch(&area));
        let mut thickness = DoseMap::default();
        for step in 0..8 {
            // 2 Angstrom each, within 1.2 nm that move along x
            let x = 1.9 + 0.1 * f64::from(step);
            thickness.add(&Region { x: [x, x + 1.2], y: [2.0, 3.5] }, 2.0 * 120.0 * 1.5);
            steps.grow(&thickness).unwrap();
        }
        once.grow(&thickness).unwrap();
        let (steps, once) = (values(&steps.image(), &area), values(&once.image(), &area));
        let top = once.iter().fold(0.0, |a: f64, b| a.max(*b));
        let worst = steps.iter().zip(&once).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("{changes:?}: worst {:.4} % of the maximum", 100.0 * worst / top);
        assert!(top > 0.0 && worst < 1e-3 * top, "{changes:?}: {worst} of {top}");
    }
}

fn values(image: &SourceImage, area: &Region) -> Vec<f64> {
    let at = |k: usize, range: [f64; 2]| range[0] + (range[1] - range[0]) * k as f64 / 40.0;
    let places = (0..=40).flat_map(|i| (0..=40).map(move |j| [j, i]));
    places.map(|[j, i]| image.at([at(j, area.x), at(i, area.y)])).collect()
}

#[test]
#[ignore = "long"]
fn threads_change_nothing() {
    let recipe = recipe(&[]);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let poor = Profile::Poor.acquisition();
        let settings =
            Acquisition { frames: 3, contamination_angstrom3_per_electron: 1e-4, ..poor };
        pool.install(|| recorded(&recipe, settings, 1e5).unwrap())
    };
    assert_eq!(with(1), with(3));
}

fn live(cache: &std::path::Path) -> LiveWorld {
    let recipe = recipe(&["field.thickness_nm=0.4", "boundaries.count=0"]);
    let imaging = BuildOptions {
        method: BuildMethod::Mosaic,
        cache: Cache::at(cache.to_owned()),
        ..BuildOptions::default()
    };
    LiveWorld::new(&recipe, 7, &LiveOptions { imaging, ..LiveOptions::default() }, &Silent).unwrap()
}

/// The rectangle that every microscopist knows: brighter where one has looked longest.
#[test]
#[ignore = "long"]
fn a_live_world_keeps_its_carbon() {
    let cache = tempfile::tempdir().unwrap();
    let mut world = live(cache.path());
    let pixel_nm = world.recipe().field.pixel_nm();
    let part = RecordedPart { centre_nm: CENTRE_NM, size_nm: [1.5; 2], pixel_nm };
    let acquisition = growing(1, 1e-4);
    let electrons = Electrons::Dose(1e5);
    let request = LiveRequest { part, electrons, acquisition, keep_frames: false };
    let everything = PixelRect::new([20, 20], [200, 240]);
    let before = world.look(&everything).unwrap().clean;
    world.acquire(&request, &Silent).unwrap();
    world.acquire(&request, &Silent).unwrap();
    let begun: Vec<f64> = world.history().iter().map(|one| one.carbon_nm).collect();
    assert!(begun[0] == 0.0 && (begun[1] - 1.0).abs() < 1e-3, "{begun:?}");
    let place = |half: f64| {
        let [x, y] = CENTRE_NM.map(|c| [c - half, c + half]);
        Region { x, y }
    };
    let nm = world.mean_carbon_nm(&place(0.6));
    assert!((nm - 2.0).abs() < 1e-3, "{nm}");
    let more = world.look(&everything).unwrap().clean - before;
    // full field: the first built pixel is at its origin
    let origin = world.recipe().field.origin_nm();
    let middle = [1, 0].map(|k| ((CENTRE_NM[k] + origin[k]) / pixel_nm).round() as usize - 20);
    let half = (0.4 / pixel_nm) as usize;
    let [rows, columns] = middle.map(|m| m - half..m + half);
    let inside = mean(more.slice(s![rows, columns]).iter().map(|v| f64::from(*v)));
    let known = layer_brightness(2.0, 2.6);
    println!("2 nm of carbon in a live world: {inside:.6}, a layer of it {known:.6}");
    // 0.8 nm hold few atoms, and the probe's tails leave them
    assert!((inside / known - 1.0).abs() < 0.2, "{inside}, expected {known}");
    assert!(f64::from(more[[2, 2]]).abs() < 0.1 * known, "{}", more[[2, 2]]);
    let text = serde_json::to_string(&world.snapshot()).unwrap();
    let stored: LiveSnapshot = serde_json::from_str(&text).unwrap();
    let next = world.acquire(&request, &Silent).unwrap();
    let mut again = live(cache.path());
    again.restore(&stored).unwrap();
    assert_eq!(again.acquire(&request, &Silent).unwrap(), next);
}

#[test]
fn what_cannot_be_is_refused_with_what_is_allowed() {
    let bare = recipe(&[]);
    let ranges = ["contamination_angstrom3_per_electron", "expected 0 to 10"];
    let thick = ["20.00 nm thick", "at most 6 nm", "smaller dose"];
    let printed = |recipe: &CheckedRecipe, rate: f64, dose: f64| {
        recorded(recipe, growing(1, rate), dose).unwrap_err().to_string()
    };
    for (message, parts) in [
        (printed(&bare, -1e-3, 1e4), &ranges[..]),
        (printed(&bare, 11.0, 1e4), &ranges),
        (printed(&bare, f64::NAN, 1e4), &ranges),
        (printed(&bare, 2e-2, 1e4), &thick),
    ] {
        for part in parts {
            assert!(message.contains(part), "no `{part}` in: {message}");
        }
    }
    let bright = recipe(&["detector.inner_mrad=10", "detector.outer_mrad=21"]);
    let message = printed(&bright, 1e-5, 1e4);
    assert!(message.contains("outside the direct beam"), "{message}");
    let whole = recipe(&["acquisition.contamination_angstrom3_per_electron=1e-3"]);
    let folder = tempfile::tempdir().unwrap();
    let options = BuildOptions { cache: Cache::none(), ..BuildOptions::default() };
    let path = folder.path().join("world.h5");
    let message = stemgen::world::build(&whole, &path, &options, &Silent).unwrap_err().to_string();
    assert!(message.contains("live worlds only"), "{message}");
}
