//! Tiles with their truth on the fly: the same numbers as in a world file.

use std::sync::{Arc, Mutex};

use ndarray::Array2;
use stemgen::imaging::{
    Cache, DetectorChoice, DisplacedAtoms, ImageBlocks, ImagerFacts, ImagingChoice, ImagingCost,
    PixelRect, RasterDetail, RegionImager, SharedLibrary, TurnedRaster,
};
use stemgen::io::WorldFile;
use stemgen::progress::{Progress, Silent};
use stemgen::recipe::{CheckedRecipe, Difficulty, Recipe, Region};
use stemgen::specimen::{SiteKind, Specimen, specimen};
use stemgen::world::{
    BuildMethod, BuildOptions, FieldTile, TrainingOptions, WorldBuild, field_tile, training_set,
};

/// A thin specimen whose images take seconds.
fn recipe(material: &str, grid: [usize; 2]) -> CheckedRecipe {
    let recipe = Recipe::load(material, Difficulty::Easy).unwrap();
    let changes =
        ["field.thickness_nm=1.0", "phonons.configurations=2", "detector.outer_mrad=90.0"];
    let changes: Vec<_> = changes.iter().map(|c| c.parse().unwrap()).collect();
    let recipe = recipe.with_overrides(&changes).unwrap();
    recipe.with_grid(grid[0], grid[1]).unwrap().checked().unwrap()
}

struct Case {
    _folder: tempfile::TempDir,
    recipe: CheckedRecipe,
    specimen: Arc<dyn Specimen>,
    imager: Box<dyn RegionImager>,
    world: WorldFile,
}

/// A world, and what makes tiles of it.
fn case(recipe: CheckedRecipe, options: BuildOptions) -> Case {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.h5");
    let options = BuildOptions { keep_clean: true, audit_regions: 0, ..options };
    WorldBuild::new(&recipe, &options).unwrap().run(&path, &Silent).unwrap();
    let specimen = specimen(&recipe).unwrap();
    let imaging: ImagingChoice = options.policy(&recipe).unwrap().imaging;
    let mut imager = imaging.imager(&recipe, &specimen).unwrap();
    imager.prepare(&Silent).unwrap();
    let world = WorldFile::open(&path).unwrap();
    Case { _folder: folder, recipe, specimen, imager, world }
}

impl Case {
    /// The tile of the world's file, on the fly.
    fn tile(&self, row: usize, column: usize) -> FieldTile {
        let field = &self.recipe.field;
        let first = field.crop_origin_px();
        let corner = [first[0] + row * field.stride_px(), first[1] + column * field.stride_px()];
        let pixels = PixelRect::new(corner, [field.tile_px; 2]);
        let dose = field_dose(&self.recipe);
        let (specimen, imager) = (&*self.specimen, &*self.imager);
        field_tile(&self.recipe, specimen, imager, &pixels, Some(dose), &Silent).unwrap()
    }

    /// Compares the image of a tile, and the counts where pixels agree to the last bit.
    fn assert_image(&self, row: usize, column: usize, most: f32) {
        let tile = self.tile(row, column);
        let clean = self.world.clean_tile(row, column).unwrap();
        let top = clean.iter().copied().fold(0.0, f32::max);
        let off = (&tile.clean - &clean).iter().fold(0.0, |m: f32, d| m.max(d.abs())) / top;
        println!("tile {row}, {column}: off by {off:.1e}");
        assert!(off <= most, "{off}");
        let scaling = self.world.metadata().scaling.unwrap();
        let pixel = 10.0 * tile.pixel_nm;
        let electrons = field_dose(&self.recipe) * pixel * pixel;
        let stored = self.world.tile(row, column).unwrap();
        let counts = tile.counts.as_ref().unwrap();
        let mut compared = 0;
        for ((at, stored), count) in stored.indexed_iter().zip(counts) {
            if tile.clean[at] == clean[at] {
                let counted = (f64::from(*stored) * scaling[0] + scaling[1]) * electrons;
                assert!((counted - f64::from(*count)).abs() < 0.02, "{counted} {count}");
                compared += 1;
            }
        }
        assert!(compared * 2 > stored.len(), "{compared}");
    }

    /// Compares all that is known of a tile with the lists of the file.
    fn assert_truth(&self, row: usize, column: usize) {
        let tile = self.tile(row, column);
        let n = self.world.site_count().unwrap();
        let truth = self.world.truth(0..n).unwrap();
        let half = 0.5 * tile.pixel_nm as f32;
        let extent = tile.pixels.shape.map(|n| (n as f64 * tile.pixel_nm) as f32 - half);
        let [x0, y0] = tile.origin_nm.map(|v| v as f32);
        let inside = |[x, y]: [f32; 2]| {
            (-half..extent[1]).contains(&(x - x0)) && (-half..extent[0]).contains(&(y - y0))
        };
        let columns = self.world.columns().unwrap();
        let mut found: Vec<([f32; 2], String, u32)> = columns
            .iter()
            .filter(|c| inside(c.position_nm))
            .map(|c| (c.position_nm, c.composition.to_string(), c.sites as u32))
            .collect();
        let mut ours: Vec<_> =
            tile.columns.iter().map(|c| (c.position_nm, c.composition(), c.sites)).collect();
        let order = |a: &([f32; 2], String, u32), b: &([f32; 2], String, u32)| {
            a.0[0].total_cmp(&b.0[0]).then(a.0[1].total_cmp(&b.0[1]))
        };
        found.sort_by(order);
        ours.sort_by(order);
        assert!(ours.len() > 20);
        assert_eq!(ours, found);
        // every site is listed in the file, with its defect
        let key = |x: f32, y: f32, z: f32| [x, y, z].map(f32::to_bits);
        let listed: std::collections::HashMap<_, _> = (0..truth.numbers.len())
            .map(|i| {
                let [x, y] = truth.positions[i];
                (key(x, y, truth.z[i]), (truth.numbers[i], truth.defect_names[i].to_string()))
            })
            .collect();
        for site in &tile.sites {
            let [x, y, z] = site.position_nm;
            let (number, defect) = &listed[&key(x, y, z)];
            assert_eq!(
                (*number as u8, defect.as_str()),
                (site.number, site.defect_name().as_str())
            );
        }
        let sites: u32 = tile.columns.iter().map(|c| c.sites).sum();
        assert_eq!(tile.sites.len(), sites as usize);
        if let Some(map) = &tile.phase_map {
            let stride = self.recipe.field.stride_px();
            let range = |n: usize| n * stride..n * stride + self.recipe.field.tile_px;
            let stored = self.world.phase_map(range(row), range(column)).unwrap().unwrap();
            assert_eq!(&stored, map);
            assert!(map.iter().any(|v| *v != map[[0, 0]]), "a boundary crosses the tile");
        }
    }
}

fn field_dose(recipe: &Recipe) -> f64 {
    recipe.dose.electrons_per_angstrom2
}

#[test]
#[ignore = "long"]
fn a_tile_of_a_mosaic_is_that_of_its_world() {
    let method = BuildMethod::Mosaic;
    let options = BuildOptions {
        method,
        subtile_nm: Some(3.0),
        subtile_overlap_nm: Some(0.4),
        cache: Cache::none(),
        window_angstrom: Some(5.9),
        ..BuildOptions::default()
    };
    let cache = tempfile::tempdir().unwrap();
    let options = BuildOptions { cache: Cache::at(cache.path().to_owned()), ..options };
    let case = case(recipe("srtio3", [2, 2]), options);
    for (row, column) in [(0, 0), (1, 1)] {
        // sub-tiles of a mosaic agree where they overlap
        case.assert_image(row, column, 1e-5);
        case.assert_truth(row, column);
    }
    let tile = case.tile(0, 1);
    assert!(tile.sites.iter().any(|s| s.kind == SiteKind::Vacancy));
    assert_eq!(tile.boundaries.len(), 1);
}

#[test]
fn a_direct_tile_is_the_world_of_one_tile() {
    let method = BuildMethod::Window;
    let window_angstrom = Some(5.9);
    let options = BuildOptions { method, window_angstrom, ..BuildOptions::default() };
    let case = case(recipe("batio3", [1, 1]), options);
    case.assert_image(0, 0, 0.0);
    case.assert_truth(0, 0);
}

#[test]
fn rectangles_outside_the_field_are_refused() {
    let recipe = recipe("srtio3", [1, 1]);
    let specimen = specimen(&recipe).unwrap();
    let imaging = BuildOptions::default().policy(&recipe).unwrap().imaging;
    let imager = imaging.imager(&recipe, &specimen).unwrap();
    let full = recipe.field.pixels(recipe.field.grid);
    let tile = |pixels: PixelRect, dose| {
        field_tile(&recipe, &*specimen, &*imager, &pixels, dose, &Silent).unwrap_err().to_string()
    };
    for pixels in [
        PixelRect::new([0, 0], [0, 4]),
        PixelRect::new([full[0] - 3, 0], [4, 4]),
        PixelRect::new([0, usize::MAX], [4, 4]),
        PixelRect::new([0, 0], [8, 8]).every(2),
    ] {
        let message = tile(pixels, None);
        assert!(message.contains("rectangle in the full field"), "{message}");
    }
    for dose in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let message = tile(PixelRect::new([0, 0], [8, 8]), Some(dose));
        assert!(message.contains("electrons per square Angstrom"), "{message}");
    }
}

/// An imager that notes what it is asked for.
#[derive(Default)]
struct Noting(Mutex<Vec<PixelRect>>);

impl RegionImager for Noting {
    fn facts(&self) -> ImagerFacts {
        ImagerFacts::new("noting", serde_json::Value::Null)
    }
    fn library_mut(&mut self) -> Option<&mut dyn SharedLibrary> {
        None
    }
    fn blocks(&self) -> Option<&dyn ImageBlocks> {
        None
    }
    fn images_of(
        &self,
        p: &PixelRect,
        _: DetectorChoice,
        _: usize,
        _: &dyn Progress,
    ) -> stemgen::Result<Vec<Array2<f64>>> {
        self.0.lock().unwrap().push(*p);
        Ok(vec![Array2::from_elem(p.shape, 0.1)])
    }
    fn images_at(
        &self,
        _: &TurnedRaster,
        _: RasterDetail,
        _: DetectorChoice,
        _: usize,
        _: &dyn Progress,
    ) -> stemgen::Result<Option<Vec<Array2<f64>>>> {
        unreachable!("tiles ask for no raster")
    }
    fn atoms(&self, _: &Region, _: usize) -> DisplacedAtoms {
        unreachable!("tiles ask for no displaced atoms")
    }
    fn cost(&self, _: [usize; 2], _: usize) -> stemgen::Result<ImagingCost> {
        unreachable!("tiles ask for no cost")
    }
}

#[test]
fn tiles_for_training_make_the_field_once_and_no_more() {
    for (grid, pixels) in [([1, 1], 128 * 128), ([1, 2], 128 * 252)] {
        let recipe = recipe("srtio3", grid);
        let imager = Noting::default();
        let options =
            TrainingOptions { tiles: 40, size_px: 100, dose: [1e4; 2], sigma_px: 2.0, seed: 5 };
        let specimen = specimen(&recipe).unwrap();
        let set = training_set(&recipe, &*specimen, &imager, &options, &Silent).unwrap();
        assert_eq!(set.images.shape(), [40, 100, 100]);
        let asked = imager.0.into_inner().unwrap();
        assert_eq!(asked.len(), grid[0] * grid[1], "{asked:?}");
        assert_eq!(asked.iter().map(|p| p.shape[0] * p.shape[1]).sum::<usize>(), pixels);
    }
}
