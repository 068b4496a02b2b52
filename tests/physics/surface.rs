//! Layers of carbon on the faces of a specimen.

use std::sync::Arc;

use ndarray::Array2;
use stemgen::engine::{Algorithm, Phonons, Plan};
use stemgen::imaging::{
    DetectorChoice, DirectImager, DisplacedAtoms, ImageBlocks, ImagerFacts, ImagingCost, PixelBox,
    PixelRect, RasterDetail, RegionImager, SharedLibrary, Simulator, SurfaceImager, TurnedRaster,
    turned_image,
};
use stemgen::progress::{Progress, Silent};
use stemgen::recipe::{CheckedRecipe, Override, Recipe, Region};
use stemgen::specimen::{Specimen, SurfaceLayers, specimen};
use stemgen::structure::Site;

const WINDOW: Algorithm = Algorithm::Window { width_angstrom: 7.8 };

fn recipe(changes: &[&str]) -> CheckedRecipe {
    let fixed = ["phonons.configurations=1", "field.thickness_nm=2"];
    let parsed: Vec<Override> =
        fixed.iter().chain(changes).map(|c| c.parse().expect("a change")).collect();
    let recipe = Recipe::load("test", None).unwrap().with_overrides(&parsed).unwrap();
    recipe.with_grid(1, 1).unwrap().checked().unwrap()
}

/// The layers of a recipe about what another imager makes.
fn covered(
    recipe: &CheckedRecipe,
    specimen: &Arc<dyn Specimen>,
    inner: Box<dyn RegionImager>,
) -> Box<dyn RegionImager> {
    let simulator = Simulator::new(recipe, WINDOW);
    SurfaceImager::covering(inner, recipe, &**specimen, simulator.settings()).unwrap()
}

/// A specimen that scatters nothing.
struct Empty;

impl RegionImager for Empty {
    fn facts(&self) -> ImagerFacts {
        ImagerFacts::new("empty", serde_json::json!({}))
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
        raster: &TurnedRaster,
        _: RasterDetail,
        _: DetectorChoice,
        _: usize,
        _: &dyn Progress,
    ) -> stemgen::Result<Option<Vec<Array2<f64>>>> {
        Ok(Some(vec![Array2::zeros(raster.shape)]))
    }

    fn atoms(&self, _: &Region, _: usize) -> DisplacedAtoms {
        DisplacedAtoms::default()
    }

    fn cost(&self, _: [usize; 2], _: usize) -> stemgen::Result<ImagingCost> {
        unreachable!("no test asks for it")
    }
}

fn exact_imager(recipe: &CheckedRecipe, specimen: &Arc<dyn Specimen>) -> DirectImager {
    DirectImager::new(recipe, specimen, Simulator::new(recipe, Algorithm::Multislice)).unwrap()
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (n, sum) = values.fold((0.0, 0.0), |(n, sum), v| (n + 1.0, sum + v * v));
    f64::sqrt(sum / n)
}

fn mean(image: &Array2<f64>) -> f64 {
    image.sum() / image.len() as f64
}

/// Rms difference of two images at pixels as bright as `share` of the brightest, as a share of what they have there.
fn error_at_bright(image: &Array2<f64>, exact: &Array2<f64>, share: f64) -> f64 {
    let top = exact.iter().fold(0.0, |a: f64, b| a.max(*b));
    let bright = image.iter().zip(exact).filter(|(_, e)| **e > share * top);
    rms(bright.map(|(i, e)| i / e - 1.0))
}

fn place() -> PixelRect {
    PixelRect::new([20, 24], [40, 40]).every(3)
}

/// With the very same atoms: carbon before the specimen adds its image, to within what it does to the probe; behind it, to
/// within half a per cent.
#[test]
#[ignore = "long"]
fn layers_add_what_the_exact_engine_shows() {
    let bare = recipe(&[]);
    for (layer, bright, off) in [("exit_nm=1.5", 0.03, 0.15), ("entrance_nm=1", 0.06, 0.2)] {
        let recipe = recipe(&[&format!("surface.{layer}")]);
        let specimen = specimen(&recipe).unwrap();
        let crystal = exact_imager(&bare, &specimen);
        let imager = covered(&recipe, &specimen, Box::new(crystal.clone()));
        let layers = SurfaceLayers::of(&recipe, specimen.facts().thickness_nm).unwrap();
        let simulator = Simulator::new(&recipe, Algorithm::Multislice).with_large_probe_box();
        let exact = |imager: &dyn RegionImager, focus: f64, thickness: f64| {
            let simulator = simulator.with_focus_deeper(focus);
            let (pixel, margin) = (recipe.field.pixel_nm(), simulator.margin_angstrom());
            let pixels = PixelBox::new(&place(), pixel, margin, 0.1 * thickness);
            let atoms = |configuration| imager.atoms(&pixels.area, configuration);
            simulator.means(&pixels, 1, atoms, &Silent).unwrap().remove(0)
        };
        let with = exact(&*imager, layers.before_angstrom(), layers.thickness_angstrom());
        let without = exact(&crystal, 0.0, 10.0 * specimen.facts().thickness_nm);
        let ours = imager.mean_of(&place(), 1, &Silent).unwrap();
        let error = error_at_bright(&ours, &with, 0.5);
        let added = mean(&ours) - mean(&without);
        let truly = mean(&with) - mean(&without);
        eprintln!("{layer}: {error:.4} at bright pixels; adds {added:.6}, exact {truly:.6}");
        assert!(error < bright, "{layer}: {error}");
        assert!((added / truly - 1.0).abs() < off, "{layer}: {added} {truly}");
        // Without the layer the image would be off.
        assert!(truly > 0.01 * mean(&with), "{truly} of {}", mean(&with));
    }
}

/// The box, its slices and the focus: those of a simulation put together by hand.
#[test]
fn direct_simulation_has_the_layers_where_they_belong() {
    let recipe = recipe(&["surface.entrance_nm=0.6", "surface.exit_nm=0.4"]);
    let specimen = specimen(&recipe).unwrap();
    let imager = exact_imager(&recipe, &specimen);
    let rectangle = PixelRect::new([30, 30], [12, 12]).every(3);
    let ours = (&imager as &dyn RegionImager).mean_of(&rectangle, 1, &Silent).unwrap();
    let mut settings = Simulator::new(&recipe, Algorithm::Multislice).settings().clone();
    // 6 A of carbon and the distance of 2 A to the specimen
    settings.optics.aberrations.add_defocus(8.0);
    let by_hand = Simulator::of(settings.clone());
    let thickness_nm = 0.8 + specimen.facts().thickness_nm + 0.6;
    let pixel = recipe.field.pixel_nm();
    let pixels = PixelBox::new(&rectangle, pixel, by_hand.margin_angstrom(), thickness_nm);
    let corner = [pixels.area.x[0], pixels.area.y[0]];
    let sites = specimen.sites(&pixels.area.grown(0.1));
    let inside = |s: &&stemgen::specimen::SpecimenSite| {
        pixels.area.contains([s.position_nm[0], s.position_nm[1]])
    };
    let mut atoms: Vec<Site> =
        sites.iter().filter(inside).filter_map(|s| s.atom(corner, &recipe.phonons)).collect();
    let mut heights: Vec<f64> = atoms.iter().map(|s| s.position[2]).collect();
    let layers = SurfaceLayers::of(&recipe, specimen.facts().thickness_nm).unwrap();
    for layer in layers.layers() {
        let carbon = layer.atoms(&pixels.area);
        heights.extend(carbon.iter().map(|s| layer.slice_height_angstrom(s.position[2])));
        atoms.extend(carbon);
    }
    atoms.iter_mut().for_each(|s| s.position[2] += 8.0);
    heights.iter_mut().for_each(|z| *z += 8.0);
    let inside = |s: &Site| (0.0..=10.0 * thickness_nm).contains(&s.position[2]);
    assert!(atoms.iter().all(inside));
    settings.phonons = Some(Phonons { configurations: 1, seed: recipe.seed });
    let plan = Plan::new(&settings, pixels.size_angstrom, &heights).unwrap();
    let image = stemgen::engine::simulate(&plan, &atoms, &pixels.scan, &Silent).unwrap();
    assert!(atoms.iter().any(|s| s.number == 6));
    let top = ours.iter().fold(0.0, |a: f64, b| a.max(*b));
    let image = image.image(0, 0);
    let worst = image.iter().zip(&ours).map(|(a, b)| (f64::from(*a) - b).abs());
    let worst = worst.fold(0.0, f64::max);
    eprintln!("worst {:.5} of the maximum", worst / top);
    assert!(worst < 3e-4 * top, "{worst} of {top}");
}

/// A layer too thin for any atom moves the specimen down and the focus with it.
#[test]
fn the_focus_stays_on_the_specimen() {
    let rectangle = PixelRect::new([30, 30], [12, 12]).every(3);
    let image = |changes: &[&str]| {
        let recipe = recipe(changes);
        let specimen = specimen(&recipe).unwrap();
        let imager: &dyn RegionImager = &exact_imager(&recipe, &specimen);
        imager.mean_of(&rectangle, 1, &Silent).unwrap()
    };
    let (bare, moved) = (image(&[]), image(&["surface.entrance_nm=0.001"]));
    let top = bare.iter().fold(0.0, |a: f64, b| a.max(*b));
    let worst = bare.iter().zip(&moved).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst < 0.002 * top, "{worst} of {top}");
    assert!(worst > 0.0, "nothing moved");
}

#[test]
fn rectangles_and_turned_rasters_share_one_image() {
    let recipe = recipe(&["surface.entrance_nm=0.5", "surface.exit_nm=2"]);
    let specimen = specimen(&recipe).unwrap();
    let imager = covered(&recipe, &specimen, Box::new(Empty));
    let whole = imager.mean_of(&PixelRect::new([10, 12], [40, 40]), 1, &Silent).unwrap();
    let part = imager.mean_of(&PixelRect::new([20, 22], [9, 11]), 1, &Silent).unwrap();
    for ((i, j), v) in part.indexed_iter() {
        assert!(
            (v - whole[[10 + i, 10 + j]]).abs() < 1e-9,
            "{i} {j}: {v} {}",
            whole[[10 + i, 10 + j]]
        );
    }
    let pixel = recipe.field.pixel_nm();
    let raster = TurnedRaster {
        centre_nm: [(12.0 + 19.5) * pixel, (10.0 + 19.5) * pixel],
        pixel_nm: pixel,
        angle_rad: 0.0,
        shape: [40, 40],
    };
    let turned = turned_image(&recipe, &*imager, &raster, &Silent).unwrap();
    let worst = turned.iter().zip(&whole).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-6 * whole.iter().fold(0.0, |a: f64, b| a.max(*b)), "{worst}");
}

/// Atoms that scatter each by itself make no bright field, and no library holds the layers for several detectors.
#[test]
fn detectors_in_the_beam_are_simulated_with_the_layers() {
    let layer = "surface.entrance_nm=1";
    assert!(SurfaceImager::can_cover(&recipe(&[layer])));
    assert!(SurfaceImager::can_cover(&recipe(&[
        "detector.inner_mrad=10",
        "detector.outer_mrad=21"
    ])));
    let bright = ["detector.inner_mrad=10", "detector.outer_mrad=21", layer];
    assert!(!SurfaceImager::can_cover(&recipe(&bright)));
}

#[test]
fn what_no_layer_has_is_refused() {
    for (change, part) in [
        ("surface.entrance_nm=-1", "expected 0 to 6"),
        ("surface.exit_nm=60", "expected 0 to 6"),
        ("surface.sigma_angstrom=3", "expected 0 to 0.5"),
        ("surface.thickness_nm=3", "thickness_nm"),
    ] {
        let change: Override = change.parse().unwrap();
        let read =
            Recipe::load("test", None).unwrap().with_overrides(std::slice::from_ref(&change));
        let printed = read.and_then(Recipe::checked).err().map(|e| e.to_string());
        assert!(printed.as_ref().is_some_and(|t| t.contains(part)), "{change:?}: {printed:?}");
    }
}
