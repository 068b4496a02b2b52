//! Mosaics: worlds put together from a library of exactly simulated units.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock};

use crate::common::specimen;
use ndarray::Array2;
use stemgen::engine::Algorithm;
use stemgen::imaging::{
    AuditOptions, Cache, DetectorChoice, DisplacedAtoms, ImageBlocks, ImagerFacts, ImagingCost,
    MosaicImager, PixelRect, RasterDetail, RegionImager, SharedLibrary, Simulator, TurnedRaster,
    audit,
};
use stemgen::io::{GroundTruth, WorldFile};
use stemgen::progress::{Progress, Silent};
use stemgen::recipe::{Difficulty, Recipe, Region};
use stemgen::specimen::{SiteKind, Specimen};
use stemgen::world::{BuildMethod, BuildOptions, WorldBuild, build};

/// SrTiO3 as thin and with a detector as narrow as to take seconds; a boundary where `count` is 1.
fn recipe(count: usize, rate: f64) -> Recipe {
    let text = format!(
        r#"
        version = 1
        id = "thin"
        structure = "grains"
        zone_axis = "[001]"
        y_axis = "[010]"
        crystal = "srtio3"
        seed = 3
        field = {{ fov_nm = [6.2, 6.2], grid = [3, 3], tile_px = 106, overlap_px = 4, thickness_nm = 0.8 }}
        boundaries = {{ count = {count}, misorientation_deg = 36.87, sigma = 5, min_distance_angstrom = {{ Sr-Sr = 2.2 }} }}
        vacancies = {{ element = "O", rate = {rate}, cluster_fraction = 0.0, cluster_sigma_nm = 1.0, max_probability = 0.3 }}
        phonons = {{ configurations = 6, sigma_angstrom = {{ Sr = 0.084, Ti = 0.060, O = 0.085 }} }}
        optics = {{ energy_kv = 200.0, convergence_mrad = 21.0 }}
        detector = {{ inner_mrad = 50.0, outer_mrad = 90.0 }}
        dose = {{ electrons_per_angstrom2 = 1e5 }}
        "#
    );
    Recipe::from_toml_str("thin.toml", &text, None).unwrap()
}

fn mosaic(recipe: &Recipe, specimen: &Arc<dyn Specimen>) -> MosaicImager {
    mosaic_from(recipe, specimen, Cache::none())
}

fn mosaic_from(recipe: &Recipe, specimen: &Arc<dyn Specimen>, cache: Cache) -> MosaicImager {
    let simulator = Simulator::new(recipe, Algorithm::Window { width_angstrom: 7.8 });
    let recipe = recipe.clone().checked().unwrap();
    let mut mosaic = MosaicImager::new(&recipe, specimen, simulator, cache).unwrap();
    mosaic.prepare(&Silent).unwrap();
    mosaic
}

/// An imager whose atoms are not those of its images.
struct OtherAtoms<'a> {
    images: &'a MosaicImager,
    atoms: &'a MosaicImager,
}

impl RegionImager for OtherAtoms<'_> {
    fn facts(&self) -> ImagerFacts {
        ImagerFacts { name: "other atoms", ..self.images.facts() }
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
        detectors: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> stemgen::Result<Vec<Array2<f64>>> {
        self.images.images_of(pixels, detectors, configurations, progress)
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
    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms {
        self.atoms.atoms(area, configuration)
    }
    fn cost(&self, subtile: [usize; 2], subtiles: usize) -> stemgen::Result<ImagingCost> {
        self.images.cost(subtile, subtiles)
    }
}

#[test]
fn a_mosaic_is_the_exact_image_of_its_atoms() {
    let recipe = recipe(1, 0.04);
    let specimen = specimen(&recipe).unwrap();
    // Other seeds have the same library.
    let folder = tempfile::tempdir().unwrap();
    let cache = Cache::at(folder.path().to_owned());
    let mosaic = mosaic_from(&recipe, &specimen, cache.clone());
    let survey = mosaic.survey();
    assert!(survey.families.len() >= 2, "crystal and boundary: {survey:?}");
    assert!(survey.untagged * 100 < survey.tagged, "{survey:?}");
    // One region on the boundary, one beside it.
    let options = AuditOptions {
        at_nm: vec![[3.1, 3.1], [1.2, 4.0]],
        configurations: Some(1),
        ..AuditOptions::default()
    };
    let found = audit(&recipe, &*specimen, &mosaic, &options, &Silent).unwrap();
    println!("{found:?}");
    assert!(found.bright_rms_percent < 1.0, "{}", found.bright_rms_percent);
    assert!(found.all_rms_percent < 0.8, "{}", found.all_rms_percent);
    for kind in found.kinds.iter().filter(|k| k.kind != "O") {
        // Column by column the phonons and vacancies are those of the exact image.
        assert!(kind.columns > 5 && kind.correlation > 0.98, "{kind:?}");
        assert!((kind.variance_ratio - 1.0).abs() < 0.15, "{kind:?}");
    }
    // The check can fail: the vacancies and displacements of another seed are other atoms.
    let other = Recipe { seed: 4, ..recipe.clone() };
    let other_specimen = crate::common::specimen(&other).unwrap();
    let others = mosaic_from(&other, &other_specimen, cache);
    let mixed = OtherAtoms { images: &mosaic, atoms: &others };
    let wrong = audit(&recipe, &*specimen, &mixed, &options, &Silent).unwrap();
    println!("{wrong:?}");
    assert!(wrong.bright_rms_percent > 4.0, "{}", wrong.bright_rms_percent);
    assert!(wrong.bright_rms_percent > 6.0 * found.bright_rms_percent);
    for kind in wrong.kinds.iter().filter(|k| k.kind != "O") {
        assert!(kind.correlation < 0.7, "{kind:?}");
    }
}

/// As thick as worlds are, with their detector. Takes a few minutes, so on demand:
/// `cargo test --release --test worlds mosaic:: -- --ignored --nocapture`
#[test]
#[ignore = "takes minutes"]
fn a_mosaic_of_10_nm_is_the_exact_image_of_its_atoms() {
    let mut recipe = recipe(0, 0.0);
    recipe.field.thickness_nm = 10.0;
    recipe.phonons.configurations = 2;
    recipe.detector = stemgen::recipe::DetectorTables::one(68.0, 200.0);
    let specimen = specimen(&recipe).unwrap();
    let mosaic = mosaic(&recipe, &specimen);
    let options = AuditOptions { at_nm: vec![[3.1, 3.1], [1.2, 4.0]], ..AuditOptions::default() };
    let found = audit(&recipe, &*specimen, &mosaic, &options, &Silent).unwrap();
    println!("{found:?}");
    assert!(found.bright_rms_percent < 0.5, "{}", found.bright_rms_percent);
    assert!(found.all_rms_percent < 0.5, "{}", found.all_rms_percent);
}

/// A field with two boundaries, and its first tile, which has none.
static WHOLE_AND_PART: LazyLock<[MosaicImager; 2]> = LazyLock::new(|| {
    let changes = ["field.fov_nm=[2.12, 14.36]", "field.grid=[1, 7]", "phonons.configurations=1"];
    let changes: Vec<_> = changes.iter().map(|c| c.parse().unwrap()).collect();
    let whole = recipe(2, 0.0).with_overrides(&changes).unwrap();
    let part = whole.clone().with_grid(1, 1).unwrap();
    [&whole, &part].map(|r| mosaic(r, &specimen(r).unwrap()))
});

/// The library of a part of a field has no boundary; places at one are simulated as they are, not left black.
#[test]
#[ignore = "long"]
fn places_that_the_library_does_not_know_are_simulated() {
    let [all, some] = &*WHOLE_AND_PART;
    assert!(some.survey().families.len() < all.survey().families.len());
    let pixels = PixelRect::new([30, 225], [40, 30]);
    let [known, unknown] =
        [all, some].map(|m| (m as &dyn RegionImager).mean_of(&pixels, 1, &Silent).unwrap());
    let ratio = unknown.mean().unwrap() / known.mean().unwrap();
    assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
}

/// Overviews show what the library lacks as other columns nearby, and the rest as it is.
#[test]
#[ignore = "long"]
fn overviews_simulate_no_column_of_their_own() {
    let [all, some] = &*WHOLE_AND_PART;
    let raster =
        TurnedRaster { centre_nm: [4.8, 1.0], pixel_nm: 0.04, angle_rad: 0.0, shape: [32, 40] };
    let images = |mosaic: &MosaicImager| {
        let main = DetectorChoice::Main;
        let made = |detail| {
            mosaic.images_at(&raster, detail, main, 1, &Silent).unwrap().unwrap().remove(0)
        };
        (made(RasterDetail::Full), made(RasterDetail::Overview))
    };
    let brightest = |image: &Array2<f64>| image.iter().fold(0.0f64, |m, v| m.max(*v));
    let overviews = [all, some].map(|mosaic| {
        let (exact, overview) = images(mosaic);
        let ratio = overview.mean().unwrap() / exact.mean().unwrap();
        assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
        let ratio = brightest(&overview) / brightest(&exact);
        assert!((ratio - 1.0).abs() < 0.2, "{ratio}");
        overview
    });
    let [all, some] = &overviews;
    let same = all.iter().zip(some).filter(|(a, b)| a == b).count();
    assert!(same > 50 && all.len() - same > 50, "{same} of {}", all.len());
    let ratio = some.mean().unwrap() / all.mean().unwrap();
    assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
    let ratio = brightest(some) / brightest(all);
    assert!((ratio - 1.0).abs() < 0.2, "{ratio}");
}

/// Options for a mosaic that is built in several sub-tiles, with its noise-free image.
fn in_small_parts(cache: Cache) -> BuildOptions {
    BuildOptions {
        keep_clean: true,
        subtile_nm: Some(3.0),
        subtile_overlap_nm: Some(0.4),
        audit_regions: 0,
        method: BuildMethod::Mosaic,
        window_angstrom: Some(7.8),
        cache,
        ..BuildOptions::default()
    }
}

#[test]
fn bytes_depend_neither_on_threads_nor_on_the_cache() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe(0, 0.0).checked().unwrap();
    let cache = Cache::at(folder.path().join("cache"));
    let cases = [("cold", 1, cache.clone()), ("warm", 3, cache), ("none", 2, Cache::none())];
    let mut images = HashMap::new();
    for (name, threads, cache) in cases {
        let path = folder.path().join(format!("{name}.h5"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = in_small_parts(cache);
        let done = pool.install(|| build(&recipe, &path, &options, &Silent)).unwrap();
        let [all, simulated] = done.library.unwrap();
        assert_eq!(simulated, if name == "warm" { 0 } else { all }, "{name}");
        assert_eq!(done.engine, "mosaic");
        let world = WorldFile::open(&path).unwrap();
        let tiles: Vec<_> = (0..9)
            .map(|n| (world.tile(n / 3, n % 3).unwrap(), world.clean_tile(n / 3, n % 3).unwrap()))
            .collect();
        images.insert(name, tiles);
    }
    assert_eq!(images["cold"], images["warm"]);
    assert_eq!(images["cold"], images["none"]);
}

#[test]
fn another_library_seed_shares_no_image_with_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let with = |name: &str, library_seed: u64, seed: u64| {
        let mut recipe = recipe(0, 0.1);
        (recipe.phonons.library_seed, recipe.seed) = (library_seed, seed);
        let options = in_small_parts(Cache::at(folder.path().join("cache")));
        let path = folder.path().join(name);
        let done = build(&recipe.checked().unwrap(), &path, &options, &Silent).unwrap();
        (done.library.unwrap(), WorldFile::open(&path).unwrap())
    };
    let ([images, _], first) = with("first.h5", 0, 3);
    let (second_library, second) = with("second.h5", 1, 3);
    assert_eq!(second_library, [images; 2], "all images are simulated anew");
    assert_eq!(with("third.h5", 1, 4).0[1], 0, "worlds with one library seed share their images");
    let [one, two] = [&first, &second].map(|world| world.clean_tile(1, 1).unwrap());
    let mean = |tile: &Array2<f32>| f64::from(tile.sum()) / tile.len() as f64;
    let rms = (&one - &two).mapv(|d| f64::from(d).powi(2)).mean().unwrap().sqrt();
    assert!((mean(&one) / mean(&two) - 1.0).abs() < 0.02, "{} {}", mean(&one), mean(&two));
    assert!(rms > 0.01 * mean(&one), "{rms}");
    // Each column keeps its number of vacancies; they lie at other depths.
    let [truth, other] =
        [&first, &second].map(|world| world.truth(0..world.site_count().unwrap()).unwrap());
    let vacancies = |truth: &GroundTruth| truth.defects.iter().filter(|d| **d).count();
    assert!(vacancies(&truth) > 50);
    assert_eq!(vacancies(&truth), vacancies(&other));
    assert_ne!(truth.defects, other.defects);
}

#[test]
fn what_a_column_holds_is_what_its_library_cell_shows() {
    for (material, difficulty) in [
        ("srtio3", Difficulty::Easy),
        ("batio3", Difficulty::Hard),
        ("sige", Difficulty::Easy),
        ("gan", Difficulty::Medium),
    ] {
        let recipe = Recipe::load(material, difficulty).unwrap();
        let specimen = specimen(&recipe).unwrap();
        let field = recipe.field.full_region();
        // across a boundary, or a well
        let aside = if material == "gan" { (field.x[1] - field.x[0]) / 12.0 } else { 0.0 };
        let centre = [0.5 * (field.x[0] + field.x[1]) + aside, 0.5 * (field.y[0] + field.y[1])];
        let region =
            Region { x: [centre[0] - 4.0, centre[0] + 4.0], y: [centre[1] - 1.0, centre[1] + 1.0] };
        let sites = specimen.query(&region);
        let mut library_cells = HashMap::new();
        let (mut compared, mut defects) = (0, 0);
        for column in &sites.columns {
            let Some(tag) = column.unit else { continue };
            let library_cell = library_cells
                .entry(tag.family)
                .or_insert_with(|| specimen.library_cell(tag.family).unwrap().rounded());
            let (number, cell) =
                (tag.entry.cell / library_cell.cells, tag.entry.cell % library_cell.cells);
            let unit =
                library_cell.units.iter().find(|u| u.kind == tag.entry.kind && u.cell == cell);
            let unit = unit.unwrap();
            let shown = &unit.members[tag.member];
            let held = &sites.sites[column.sites.clone()];
            assert_eq!(shown.len(), held.len(), "{material}");
            for (a, b) in shown.iter().zip(held) {
                let defect = a.defect.is_some_and(|d| unit.patterns[number].contains(&(d as u16)));
                assert_eq!(defect, b.kind != SiteKind::Pristine, "{material}");
                let d = [0, 1].map(|k| {
                    let from_centre = a.position[k] - unit.centre[k];
                    let field = 10.0 * (b.position_nm[k] - tag.centre_nm[k]);
                    (from_centre, field)
                });
                let frame = tag.frame;
                for k in 0..2 {
                    let turned = frame[k][0] * d[0].0 + frame[k][1] * d[1].0;
                    // Strain and order parameter come in steps.
                    assert!((turned - d[k].1).abs() < 0.04, "{material}: {turned} {}", d[k].1);
                }
                assert!((a.position[2] - 10.0 * b.position_nm[2]).abs() < 0.06, "{material}");
                defects += usize::from(defect);
            }
            compared += 1;
        }
        assert!(
            compared > 100 && compared * 100 > sites.columns.len() * 95,
            "{material} {compared}"
        );
        assert!(defects > 0, "{material}");
    }
}

#[test]
fn small_fields_are_simulated_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe(0, 0.0).with_grid(1, 1).unwrap().checked().unwrap();
    let options = BuildOptions { cache: Cache::none(), ..BuildOptions::default() };
    let laid_out = WorldBuild::new(&recipe, &options).unwrap();
    let mosaic = laid_out.cost().unwrap().mosaic.unwrap();
    assert!(!mosaic.pays && mosaic.missing == mosaic.images, "{mosaic:?}");
    let path = folder.path().join("w.h5");
    let done = laid_out.run(&path, &Silent).unwrap();
    assert_eq!((done.engine.as_str(), done.library), ("window", None));
    assert_eq!(WorldFile::open(&path).unwrap().metadata().engine.as_deref(), Some("window"));
}
