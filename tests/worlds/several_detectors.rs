//! Recordings and live worlds of several detectors: one path and one dose for all, noise and chain of their own.

use std::path::Path;
use std::sync::Arc;

use ndarray::Array2;
use stemgen::acquisition::{Acquisition, Profile};
use stemgen::detect::shown_images;
use stemgen::engine::Algorithm;
use stemgen::imaging::{Cache, DirectImager, PixelRect, RegionImager, Simulator};
use stemgen::io::StoredImages;
use stemgen::live::{LiveOptions, LiveRequest, LiveWorld};
use stemgen::progress::Silent;
use stemgen::recipe::{CheckedRecipe, Override, Recipe, Region};
use stemgen::specimen::{Specimen, specimen};
use stemgen::world::{
    BuildMethod, BuildOptions, DetectorRecording, Electrons, FieldRecording, ImagerSource,
    RecordedPart, RecordingOptions, record, refined, refinement,
};

const ONE: &str = "detector={inner_mrad=50.0,outer_mrad=90.0}";
const DARK: &str = "detector=[{name=\"HAADF\",inner_mrad=50.0,outer_mrad=90.0},\
                    {name=\"ADF\",inner_mrad=45.0,outer_mrad=70.0,acquisition={gain_counts=2.0,bits=32}},\
                    {name=\"SEG\",inner_mrad=45.0,outer_mrad=70.0,sectors=4}]";
const COM: &str = "detector=[{name=\"HAADF\",inner_mrad=50.0,outer_mrad=90.0},\
                   {name=\"COM\",inner_mrad=0.0,outer_mrad=25.0,centre_of_mass=true}]";

/// Thin SrTiO3 of 1.4 nm.
fn tiny(changes: &[&str]) -> CheckedRecipe {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/cli/tiny.toml"));
    let changes: Vec<Override> = changes.iter().map(|c| c.parse().unwrap()).collect();
    let recipe = Recipe::from_file(path, None).unwrap().with_overrides(&changes).unwrap();
    recipe.checked().unwrap()
}

/// The recipe with the pixels of its noise-free image, and the imager of that image.
fn imager(recipe: &CheckedRecipe) -> (CheckedRecipe, DirectImager) {
    let fine = refined(recipe, refinement(recipe)).unwrap();
    let specimen: Arc<dyn Specimen> = specimen(recipe).unwrap();
    let simulator = Simulator::new(&fine, Algorithm::Window { width_angstrom: 5.0 });
    let imager = DirectImager::new(&fine, &specimen, simulator).unwrap();
    (fine, imager)
}

fn recorded(
    recipe: &CheckedRecipe,
    part: &RecordedPart,
    (acquisition, dose): (Acquisition, f64),
) -> FieldRecording {
    let (fine, imager) = imager(recipe);
    let electrons = Electrons::Dose(dose);
    let options =
        RecordingOptions { acquisition, electrons, seed: 3, keep_frames: false, keep_stages: true };
    let source = ImagerSource { imager: &imager, recipe: &fine };
    record(recipe, &*specimen(recipe).unwrap(), &source, part, &options, &Silent).unwrap()
}

fn middle(size_nm: f64) -> RecordedPart {
    RecordedPart { centre_nm: [0.7125; 2], size_nm: [size_nm; 2], pixel_nm: 0.025 }
}

fn on<'a>(recording: &'a FieldRecording, name: &str) -> &'a DetectorRecording {
    recording.others.iter().find(|one| one.detector.name == name).unwrap()
}

/// The main detector records as it does alone; sectors see the electrons of their annulus on the same path; the file names them all.
#[test]
fn detectors_share_the_path_and_each_has_its_own_noise() {
    let acquisition = Acquisition { frames: 2, ..Profile::Poor.acquisition() };
    let several = tiny(&[DARK]);
    let all = recorded(&several, &middle(0.5), (acquisition, 1e6));
    let alone = recorded(&tiny(&[ONE]), &middle(0.5), (acquisition, 1e6));
    assert_eq!((&all.data, &all.stages, &all.ideal), (&alone.data, &alone.stages, &alone.ideal));
    assert!(alone.others.is_empty() && all.position_in_image == alone.position_in_image);
    let names: Vec<&str> = all.images().map(|(detector, _)| &detector.name[..]).collect();
    assert_eq!(names, ["HAADF", "ADF", "SEG_0", "SEG_1", "SEG_2", "SEG_3"]);

    let stages = |name: &str| on(&all, name).stages.as_ref().unwrap();
    let sum = |of: fn(&stemgen::world::RecordingStages) -> &ndarray::Array3<f32>| {
        (1..4).fold(of(stages("SEG_0")).clone(), |sum, n| sum + of(stages(&format!("SEG_{n}"))))
    };
    let (moved, whole) = (sum(|s| &s.moved), &stages("ADF").moved);
    let worst = (&moved / whole).iter().map(|v| (v - 1.0).abs()).fold(0.0, f32::max);
    assert!(worst < 1e-3, "{worst}");
    // Both count the same mean, each with electrons of its own.
    let (parts, whole) = (sum(|s| &s.electrons), &stages("ADF").electrons);
    let difference = (&parts - whole).mapv(f64::from);
    let total = f64::from(parts.sum() + whole.sum());
    let (mean, scatter) =
        (difference.sum() / total.sqrt(), difference.mapv(|v| v * v).sum() / total);
    println!("sectors: mean off by {mean:.2} standard errors, scatter {scatter:.3}");
    assert!(mean.abs() < 4.0 && (scatter - 1.0).abs() < 0.2, "{mean} {scatter}");
    // The chain of one detector differs: 2 counts an electron and 10 dark counts, in numbers that are not rounded.
    let adf = on(&all, "ADF");
    assert_eq!(
        (adf.acquisition.gain_counts, adf.acquisition.bits, adf.acquisition.dark_counts),
        (2.0, 32, 10.0)
    );
    assert!(adf.data.iter().any(|v| v.fract() != 0.0) && all.data.iter().all(|v| v.fract() == 0.0));

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("all.h5");
    all.write(&path, false, &several, &*specimen(&several).unwrap(), "test").unwrap();
    let images = StoredImages::open(&path).unwrap().unwrap();
    assert_eq!(images.names[..2], ["recording", "ideal"]);
    assert_eq!(images.names[2..], names[..]);
    let read = images.image("ADF", None).unwrap().values;
    assert_eq!(read, adf.data.index_axis(ndarray::Axis(0), 0).mapv(|v| v as f32));
    assert_eq!(
        images.image("HAADF", None).unwrap().values,
        images.image("recording", None).unwrap().values
    );
    assert_eq!(images.ideal("SEG_2").unwrap().values, on(&all, "SEG_2").ideal);
}

/// A recorded centre of mass is the mean angle of the measured images, with the scatter of the electrons of all frames.
#[test]
fn a_recorded_centre_of_mass_is_that_of_the_image() {
    let recipe = tiny(&[COM]);
    let acquisition = Acquisition { frames: 2, ..Profile::Ideal.acquisition() };
    let part = middle(0.4);
    let all = recorded(&recipe, &part, (acquisition, 1e6));
    let (fine, imager) = imager(&recipe);
    let first = [1, 0].map(|k| (all.frame.origin_nm[k] / fine.field.pixel_nm()).round() as usize);
    let [x, y] = all.frame.origin_nm;
    let pixels = PixelRect::new(first, all.frame.shape);
    let imager: &dyn RegionImager = &imager;
    let measured = imager.means_of(&pixels, 1, &Silent).unwrap();
    for shown in &shown_images(&recipe.detector.measured())[1..] {
        let one = on(&all, &shown.detector.name);
        let parts = shown.parts().unwrap().map(|n| measured[n].view());
        let [mean, _] = shown.angles(parts);
        let rms = |image: Array2<f32>| image.mapv(|v| v * v).mean().unwrap().sqrt();
        let (signal, off) = (rms(mean.clone()), rms(&one.ideal - &mean));
        println!(
            "{}: {signal:.3} mrad rms, off by {off:.5}; first pixel at {x} {y}",
            one.detector.name
        );
        // The recorded image is interpolated from the probes of a larger rectangle.
        assert!(signal > 0.2 && off < 0.02 * signal, "{signal} {off}");
        let noise = &one.data.index_axis(ndarray::Axis(0), 0) - &one.ideal.mapv(f64::from);
        // One electron of an evenly lit disk has the variance of 21^2 / 4; 256 pixels measure it to 9 %.
        let electrons = 2.0 * all.exposure.electrons_per_pixel;
        let variance = (&noise * &noise).mean().unwrap() * electrons / (21.0 * 21.0 / 4.0);
        println!("{}: variance {variance:.3} of a lit disk", one.detector.name);
        assert!((0.6..1.5).contains(&variance), "{variance}");
        assert!(one.data.iter().any(|v| *v < 0.0) && one.clipped == 0);
    }
}

/// A live world sees all detectors; its electrons fall once, as for one detector.
#[test]
fn a_live_world_counts_its_dose_once() {
    let options = |names: Option<&[&str]>| LiveOptions {
        imaging: BuildOptions {
            cache: Cache::none(),
            method: BuildMethod::Window,
            window_angstrom: Some(5.0),
            ..BuildOptions::default()
        },
        detectors: names.map(|names| names.iter().map(|n| (*n).to_owned()).collect()),
        ..LiveOptions::default()
    };
    let recipe = tiny(&[DARK, "damage={radiolysis_barn={O=20.0}}"]);
    let [mut two, mut one] = [&["HAADF", "ADF"][..], &["HAADF"]]
        .map(|names| LiveWorld::new(&recipe, 7, &options(Some(names)), &Silent).unwrap());
    let request = LiveRequest {
        part: middle(0.5),
        electrons: Electrons::Dose(8e5),
        acquisition: Profile::Ideal.acquisition(),
        keep_frames: false,
    };
    let begun = one.snapshot();
    let (both, alone) =
        (two.acquire(&request, &Silent).unwrap(), one.acquire(&request, &Silent).unwrap());
    assert_eq!((&both.data, both.others.len()), (&alone.data, 1));
    assert!(on(&both, "ADF").data.sum() > 0.0);
    assert_eq!(two.history(), one.history());
    assert!(two.history()[0].lost["O"] > 0);
    let place = Region { x: [0.5, 0.9], y: [0.5, 0.9] };
    assert_eq!(two.mean_dose(&place), one.mean_dose(&place));
    // The images of both detectors show the loss; a snapshot of a world of other detectors goes back to before it.
    let pixels = PixelRect::new([12, 12], [4, 4]);
    let after = two.look(&pixels).unwrap();
    assert_eq!(after.clean, one.look(&pixels).unwrap().clean);
    two.restore(&begun).unwrap();
    let before = two.look(&pixels).unwrap();
    assert_eq!(before.others[0].0.name, "ADF");
    assert!(before.clean.sum() > after.clean.sum());
    assert!(before.others[0].1.sum() > after.others[0].1.sum());
    let mut grows = request;
    grows.acquisition.contamination_angstrom3_per_electron = 1e-5;
    let refused = two.acquire(&grows, &Silent).unwrap_err().to_string();
    assert!(refused.contains("record HAADF alone"), "{refused}");
    let unknown = LiveWorld::new(&recipe, 7, &options(Some(&["BF"])), &Silent).err().unwrap();
    assert!(unknown.to_string().contains("the recipe has HAADF, ADF, SEG, SEG_0"), "{unknown}");
}
