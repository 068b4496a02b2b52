//! A world file as a world of the benchmark.

use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use ndarray::{Array2, s};

use super::benchmark_world::{BenchmarkWorld, PhaseSamples, RegionTruth, TrueColumn, window};
use super::by_place::ByPlace;
use super::findings::{FoundParticle, PlacedDefect, type_name};
use super::recipe_world::{RecipeSource, RecipeWorld};
use super::view::{FieldFacts, TileView};
use crate::error::{Error, Result};
use crate::imaging::TurnedRaster;
use crate::io::{WorldFile, atom_type};
use crate::lengths;
use crate::made_once::MadeOnce;
use crate::progress::Progress;
use crate::recipe::{CheckedRecipe, Recipe, Region};
use crate::resample::{HALF_WIDTH, Kernel};
use crate::setting::Setting;
use crate::specimen::SiteKind;
use crate::world::BuildOptions;

/// Word in the `source` of files of recorded data.
const REPLAY: &str = "replay";
/// Number of rows of the phase map that are read at a time.
const PHASE_ROWS: usize = 256;

/// Tiles read so far, by \[row, column\].
type ReadTiles = MadeOnce<[usize; 2], Array2<f32>>;

/// A world file. Everything that was read is kept.
///
/// Images between pixels, and images of files without a noise-free image, are simulated from the recipe in the file.
pub struct FileWorld {
    file: Mutex<WorldFile>,
    facts: FieldFacts,
    has_clean: bool,
    options: BuildOptions,
    tiles: ReadTiles,
    clean: ReadTiles,
    overview: Array2<f32>,
    defects: ByPlace<SiteKind>,
    columns: OnceLock<ByPlace<bool>>,
    particles: Vec<FoundParticle>,
    /// Phases, by the distance of the samples in pixels.
    phases: MadeOnce<usize, PhaseSamples>,
    /// The specimen, made again from the recipe.
    again: MadeOnce<(), RecipeWorld>,
}

impl FileWorld {
    /// Reads the overview and the defects of a file. `options` describe how images that the file does not hold are simulated.
    ///
    /// # Errors
    /// Errors of the file.
    pub fn open(path: &Path, options: &BuildOptions) -> Result<Self> {
        let file = WorldFile::open(path)?;
        let mut sites: Vec<([f64; 2], SiteKind)> = Vec::new();
        file.for_each_chunk_of_sites(|_, truth| {
            for (place, code) in truth.positions.iter().zip(&truth.types) {
                let kind = match *code {
                    atom_type::VACANCY => SiteKind::Vacancy,
                    atom_type::SUBSTITUTION => SiteKind::Substitution,
                    _ => continue,
                };
                sites.push((place.map(f64::from), kind));
            }
        })?;
        let batch = file.particles()?;
        let particle = |n: usize| FoundParticle {
            position_nm: [batch.centres[n][0], batch.centres[n][1]].map(f64::from),
            diameter_nm: f64::from(batch.diameters[n]),
            morphology: batch.morphologies[n].as_str().to_owned(),
        };
        let overview = file.overview()?;
        Ok(FileWorld {
            facts: facts(path, &file, &sites)?,
            has_clean: file.has_clean(),
            options: options.clone(),
            tiles: ReadTiles::default(),
            clean: ReadTiles::default(),
            overview,
            defects: ByPlace::new(sites.into_iter()),
            columns: OnceLock::new(),
            particles: (0..batch.diameters.len()).map(particle).collect(),
            phases: MadeOnce::default(),
            again: MadeOnce::default(),
            file: Mutex::new(file),
        })
    }

    fn with_file<T>(&self, read: impl FnOnce(&WorldFile) -> Result<T>) -> Result<T> {
        read(&self.file.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Returns pixels of the stored tiles, or of the noise-free ones.
    fn stitched(
        &self,
        clean: bool,
        rows: Range<usize>,
        columns: Range<usize>,
    ) -> Result<Array2<f32>> {
        let stride = self.facts.stride_px();
        let tiles = |range: &Range<usize>, n: usize| {
            (range.start / stride).min(n - 1)..range.end.div_ceil(stride).min(n)
        };
        let mut out = Array2::zeros((rows.len(), columns.len()));
        let grid = self.facts.grid;
        for row in tiles(&rows, grid[0]) {
            for column in tiles(&columns, grid[1]) {
                let tile = self.tile(clean, [row, column])?;
                let common = |range: &Range<usize>, at: usize| {
                    let start = at * stride;
                    range.start.max(start)..range.end.min(start + self.facts.tile_px)
                };
                let (ys, xs) = (common(&rows, row), common(&columns, column));
                if ys.is_empty() || xs.is_empty() {
                    continue;
                }
                let part = |from: [usize; 2]| {
                    s![ys.start - from[0]..ys.end - from[0], xs.start - from[1]..xs.end - from[1]]
                };
                let of_tile = tile.slice(part([row * stride, column * stride]));
                out.slice_mut(part([rows.start, columns.start])).assign(&of_tile);
            }
        }
        Ok(out)
    }

    fn tile(&self, clean: bool, at: [usize; 2]) -> Result<Arc<Array2<f32>>> {
        let kept = if clean { &self.clean } else { &self.tiles };
        kept.get(at, || {
            let [row, column] = at;
            let tile = self.with_file(|file| match clean {
                true => file.clean_tile(row, column),
                false => file.tile(row, column),
            })?;
            if let Some(odd) = tile.iter().find(|v| !v.is_finite()) {
                let expected = format!(
                    "tile {row}, {column} holds {odd}: the file is damaged; copy or build it again"
                );
                return Err(Error::invalid(Setting::CleanImage, "an image", expected));
            }
            Ok(tile)
        })
    }

    /// Reads the phases of every `stride_px`-th pixel.
    fn read_phases(&self, stride_px: usize) -> Result<PhaseSamples> {
        let [height, width] = self.facts.shape_px();
        let shape = PhaseSamples::shape([height, width], stride_px);
        let mut phases = Array2::zeros(shape);
        for first in (0..height).step_by(PHASE_ROWS) {
            let rows = first..height.min(first + PHASE_ROWS);
            let Some(band) = self.with_file(|f| f.phase_map(rows.clone(), 0..width))? else {
                break;
            };
            for (row, mut line) in phases.outer_iter_mut().enumerate() {
                let at = row * stride_px + stride_px / 2;
                if rows.contains(&at) {
                    for (column, phase) in line.iter_mut().enumerate() {
                        *phase = band[[at - first, column * stride_px + stride_px / 2]];
                    }
                }
            }
        }
        Ok(PhaseSamples { phases, stride_px })
    }

    /// Returns the specimen, made again from the recipe.
    fn again(&self, progress: &dyn Progress) -> Result<Arc<RecipeWorld>> {
        self.again.get((), || {
            let text = self.with_file(|file| {
                file.metadata().recipe.clone().ok_or_else(|| {
                    let message =
                        "holds neither a noise-free image nor a recipe; use the stored tiles";
                    Error::choice(file.path(), Setting::CleanImage, message)
                })
            })?;
            let recipe = recipe(&text)?;
            let source = RecipeSource::new(&recipe, &self.options, progress)?;
            source.world(recipe.seed)
        })
    }

    /// Interpolates a view between the pixels of an image.
    fn between(
        &self,
        view: &TileView,
        kernel: &Kernel,
        pixels: impl Fn(Range<usize>, Range<usize>) -> Result<Array2<f32>>,
    ) -> Result<Array2<f32>> {
        let shape = self.facts.shape_px();
        let width = (view.tile_px as f64 / view.zoom).ceil() as usize + 2 * HALF_WIDTH + 2;
        let range = |k: usize| {
            let centre = view.first_px[k] + view.tile_px / 2;
            let width = width.min(shape[k]);
            let first = centre.saturating_sub(width / 2).min(shape[k] - width);
            first..first + width
        };
        let (rows, columns) = (range(0), range(1));
        let values = pixels(rows.clone(), columns.clone())?;
        let raster = view.raster(1.0, [-(columns.start as f64), -(rows.start as f64)]);
        Ok(interpolated(&values, &raster, kernel))
    }
}

/// Interpolates values between pixels; the raster counts in pixels.
fn interpolated(values: &Array2<f32>, raster: &TurnedRaster, kernel: &Kernel) -> Array2<f32> {
    let (height, width) = values.dim();
    let weights = |n: usize, axis: usize, of: usize| {
        let mut at = [0.0; 2];
        at[axis] = n as f64;
        let [x, y] = raster.place_nm(at[0], at[1]);
        kernel.weights_within(if axis == 1 { x } else { y }, of)
    };
    let along_x: Vec<_> = (0..raster.shape[1]).map(|n| weights(n, 1, width)).collect();
    let along_y: Vec<_> = (0..raster.shape[0]).map(|n| weights(n, 0, height)).collect();
    // Rows are interpolated first, then columns.
    let lines = Array2::from_shape_fn((height, raster.shape[1]), |(i, j)| {
        let w = &along_x[j];
        let first = w.first as usize;
        let taps = w.values.iter().enumerate();
        taps.map(|(k, weight)| f64::from(values[[i, first + k]]) * weight).sum::<f64>()
    });
    Array2::from_shape_fn((raster.shape[0], raster.shape[1]), |(i, j)| {
        let w = &along_y[i];
        let first = w.first as usize;
        let taps = w.values.iter().enumerate();
        taps.map(|(k, weight)| lines[[first + k, j]] * weight).sum::<f64>() as f32
    })
}

fn recipe(text: &str) -> Result<CheckedRecipe> {
    Recipe::from_toml_str("the recipe of the world", text, None)?.checked()
}

/// Collects the facts of the field from the file.
fn facts(path: &Path, file: &WorldFile, sites: &[([f64; 2], SiteKind)]) -> Result<FieldFacts> {
    let m = file.metadata();
    let kinds = [SiteKind::Vacancy, SiteKind::Substitution];
    let many = |kind: SiteKind| sites.iter().filter(|(_, k)| *k == kind).count();
    let commonest = kinds
        .into_iter()
        .filter(|k| many(*k) > 0)
        .max_by_key(|k| (many(*k), *k == SiteKind::Vacancy));
    let name = path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let phases = file.phase_names()?;
    Ok(FieldFacts {
        name,
        material: m.material.clone().unwrap_or_default(),
        grid: m.grid_shape,
        tile_px: m.tile_size_px,
        overlap_px: m.overlap_px,
        pixel_nm: m.pixel_size_nm,
        dose: m.dose_electrons_per_angstrom2.unwrap_or_default(),
        scaling: m.scaling.unwrap_or([1.0, 0.0]),
        phases,
        target: commonest.and_then(type_name).map(str::to_owned),
        recorded: m.source.as_deref() == Some(REPLAY),
        margin_px: 0,
    })
}

impl BenchmarkWorld for FileWorld {
    fn facts(&self) -> &FieldFacts {
        &self.facts
    }

    fn clean(&self, view: &TileView, progress: &dyn Progress) -> Result<Arc<Array2<f32>>> {
        let pixel_angstrom = lengths::angstrom(self.facts.pixel_nm);
        if self.has_clean && view.zoom == 1.0 {
            let stride = self.facts.stride_px();
            let [row, column] = view.first_px;
            if row % stride == 0 && column % stride == 0 {
                return self.tile(true, [row / stride, column / stride]);
            }
            let size = view.tile_px;
            return Ok(Arc::new(self.stitched(true, row..row + size, column..column + size)?));
        }
        if self.has_clean {
            let text = self.with_file(|file| Ok(file.metadata().recipe.clone()))?;
            let limit =
                text.map(|text| recipe(&text)).transpose()?.map(|r| r.optics.image_band_limit());
            let kernel = limit.and_then(|limit| Kernel::new(pixel_angstrom, limit).ok());
            if let Some(kernel) = kernel {
                let clean = |rows, columns| self.stitched(true, rows, columns);
                return Ok(Arc::new(self.between(view, &kernel, clean)?));
            }
        }
        self.again(progress)?.clean(view, progress)
    }

    fn stored(&self, view: &TileView) -> Result<Array2<f32>> {
        let size = view.tile_px;
        let [row, column] = view.first_px;
        if view.zoom == 1.0 {
            return self.stitched(false, row..row + size, column..column + size);
        }
        // Noise has all frequencies, so the kernel passes everything up to the Nyquist frequency of the pixels.
        let kernel = Kernel::new(1.0, 0.5)?;
        let image = self.between(view, &kernel, |r, c| self.stitched(false, r, c))?;
        Ok(image.mapv(|v| v.clamp(0.0, 1.0)))
    }

    fn overview(
        &self,
        position: [f64; 2],
        size: usize,
        _progress: &dyn Progress,
    ) -> Result<Array2<f32>> {
        let (height, width) = self.overview.dim();
        let [row, column] = window(position, [height, width], size);
        let (rows, columns) = (row..height.min(row + size), column..width.min(column + size));
        let mut out = Array2::zeros([size; 2]);
        let part = self.overview.slice(s![rows.clone(), columns.clone()]);
        out.slice_mut(s![..rows.len(), ..columns.len()]).assign(&part);
        Ok(out)
    }

    fn truth(&self, region: &Region, columns: bool) -> Result<RegionTruth> {
        let placed = |(position_nm, kind): ([f64; 2], SiteKind)| {
            let kind = type_name(kind)?.to_owned();
            Some(PlacedDefect { kind, position_nm })
        };
        let mut found = Vec::new();
        if columns {
            if self.columns.get().is_none() {
                let list = self.with_file(WorldFile::columns)?;
                let defective = |c: &crate::io::WorldColumn| c.vacancies + c.substitutions > 0;
                let all = list.iter().map(|c| (c.position_nm.map(f64::from), defective(c)));
                let _ = self.columns.set(ByPlace::new(all));
            }
            let list = self.columns.get().map(|all| all.within(region)).unwrap_or_default();
            let column = |(position_nm, defective)| TrueColumn { position_nm, defective };
            found = list.into_iter().map(column).collect();
        }
        let reaches =
            |p: &&FoundParticle| region.grown(0.5 * p.diameter_nm).contains(p.position_nm);
        Ok(RegionTruth {
            defects: self.defects.within(region).into_iter().filter_map(placed).collect(),
            columns: found,
            particles: self.particles.iter().filter(reaches).cloned().collect(),
        })
    }

    fn phases(&self, stride_px: usize) -> Result<Arc<PhaseSamples>> {
        self.phases.get(stride_px, || self.read_phases(stride_px))
    }
}
