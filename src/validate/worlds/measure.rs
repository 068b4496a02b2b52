//! Measures one world.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use ndarray::{Array2, s};
use serde::Serialize;

use super::column_squares::ColumnSquares;
use super::spectrum::{Bands, Collector, Spectrum};
use super::variation::Variation;
use crate::constants::wavelength_angstrom;
use crate::error::{Error, Result};
use crate::io::{WorldColumn, WorldFile, atom_type};
use crate::progress::Progress;
use crate::rng::philox4x32_10;
use crate::setting::Setting;

/// Number of blocks along an axis, and the smallest edge of a block in pixels.
const BLOCKS: usize = 16;
const SMALLEST_BLOCK_PX: usize = 8;
/// Number of sites read at a time.
const SITES_AT_ONCE: usize = 1 << 20;
/// Number of rows of the image read at a time; a strip holds whole segments.
const STRIP: usize = 128;
/// The intensity of a column is the mean of the pixels around it with Gaussian weights of this standard deviation, out to [`SIGMAS`] of
/// them. The weights have no detail of the size of a pixel, so the place of a column between pixels does not matter.
const COLUMN_SIGMA_NM: f64 = 0.025;
const SIGMAS: f64 = 5.0;
/// If the weights add to less than this, pixels are coarse and the nearest pixel is taken.
const LEAST_WEIGHT: f64 = 0.2;
/// Distances are spread by this much, because the distances of a perfect lattice differ by rounding only and would look different.
const DISTANCE_RESOLUTION_NM: f32 = 1e-3;
/// Intensities are spread by this share of their mean: where few electrons are counted, many columns have equal intensities, which differ
/// between two worlds by rounding.
const INTENSITY_RESOLUTION: f32 = 1e-3;

/// Measurements of a world. Pairs (numerator, denominator) are per block.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct Measured {
    /// The file.
    pub path: String,
    /// Metadata of the file: material, seed, dose ...
    pub notes: BTreeMap<String, String>,
    /// Height and width in pixels.
    pub shape: [usize; 2],
    /// Edge of a pixel in nm.
    pub pixel_nm: f64,
    /// Number of blocks.
    pub blocks: usize,
    /// Rows and columns of blocks.
    pub grid: [usize; 2],
    /// Length over which worlds of the recipe vary.
    pub variation: Variation,
    /// Atomic numbers of all sites; empty where the file has none.
    pub elements: BTreeSet<u8>,
    /// Defects and sites, by name of the defect.
    #[serde(skip)]
    pub defects: BTreeMap<String, Vec<(f64, f64)>>,
    /// Sites and area in nm2.
    #[serde(skip)]
    pub sites: Vec<(f64, f64)>,
    /// Columns and area in nm2.
    #[serde(skip)]
    pub columns: Vec<(f64, f64)>,
    /// Intensity and pixels.
    #[serde(skip)]
    pub intensity: Vec<(f64, f64)>,
    /// Distance of each column to its nearest neighbour.
    #[serde(skip)]
    pub neighbours_nm: Vec<(u32, f32)>,
    /// Mean intensity about each column, in fractions of the beam.
    #[serde(skip)]
    pub intensities: Vec<(u32, f32)>,
    /// Power spectrum of the image.
    #[serde(skip)]
    pub spectrum: Spectrum,
    /// Sites in each block.
    #[serde(skip)]
    site_counts: Vec<f64>,
}

impl Measured {
    /// Height and width in nm.
    pub(crate) fn extent_nm(&self) -> [f64; 2] {
        self.shape.map(|n| n as f64 * self.pixel_nm)
    }

    /// Returns the rates of a defect that this world does not have.
    pub(crate) fn no_defects(&self) -> Vec<(f64, f64)> {
        self.site_counts.iter().map(|n| (0.0, *n)).collect()
    }
}

/// The division of a field into blocks.
#[derive(Clone, Copy)]
struct Blocks {
    count: [usize; 2],
    shape: [usize; 2],
    pixel_nm: f64,
}

impl Blocks {
    fn new(shape: [usize; 2], pixel_nm: f64) -> Self {
        let count = shape.map(|n| (n / SMALLEST_BLOCK_PX).clamp(1, BLOCKS));
        Blocks { count, shape, pixel_nm }
    }

    fn extent_nm(&self) -> [f64; 2] {
        self.shape.map(|n| n as f64 * self.pixel_nm)
    }

    fn len(&self) -> usize {
        self.count[0] * self.count[1]
    }

    /// Returns the block of a pixel; positions beyond the edge belong to the block at the edge.
    fn of_pixel(&self, row: f64, column: f64) -> usize {
        let index = |at: f64, axis: usize| {
            let i = at * self.count[axis] as f64 / self.shape[axis] as f64;
            (i.max(0.0) as usize).min(self.count[axis] - 1)
        };
        index(row, 0) * self.count[1] + index(column, 1)
    }

    fn of(&self, [x, y]: [f32; 2]) -> usize {
        self.of_pixel(f64::from(y) / self.pixel_nm + 0.5, f64::from(x) / self.pixel_nm + 0.5)
    }

    fn area_nm2(&self) -> f64 {
        let pixels = (self.shape[0] * self.shape[1]) as f64;
        pixels * self.pixel_nm * self.pixel_nm / self.len() as f64
    }
}

/// Reads and measures a world.
///
/// # Errors
/// Errors of reading; [`Error::Invalid`] for an image with values that are not finite.
pub(crate) fn measure(
    world: &WorldFile,
    path: &Path,
    bands: &Bands,
    progress: &dyn Progress,
) -> Result<Measured> {
    let metadata = world.metadata();
    let blocks = Blocks::new(world.shape(), metadata.pixel_size_nm);
    let sites = SiteCounts::read(world, blocks)?;
    let columns = columns(world, &sites)?;
    let cells = ColumnSquares::new(&columns, path)?;
    let places: Vec<u32> = columns.iter().map(|at| blocks.of(*at) as u32).collect();
    let mut column_counts = vec![0.0; blocks.len()];
    places.iter().for_each(|b| column_counts[*b as usize] += 1.0);
    let image = ImageMeasures::read(world, path, blocks, bands, &columns, progress)?;
    let mean = image.columns.iter().sum::<f32>() / image.columns.len().max(1) as f32;
    let resolution = INTENSITY_RESOLUTION * mean.abs();
    let area = blocks.area_nm2();
    let per_area = |counts: &[f64]| counts.iter().map(|n| (*n, area)).collect();
    let with_blocks = |values: Vec<f32>| places.iter().copied().zip(values).collect::<Vec<_>>();
    let rates =
        |counts: &Vec<f64>| counts.iter().copied().zip(sites.counts.iter().copied()).collect();
    Ok(Measured {
        path: path.display().to_string(),
        notes: notes(world),
        shape: world.shape(),
        pixel_nm: metadata.pixel_size_nm,
        blocks: blocks.len(),
        grid: blocks.count,
        variation: Variation::of_recipe(recipe(world).as_ref(), blocks.extent_nm()),
        elements: sites.elements,
        defects: sites.defects.iter().map(|(name, counts)| (name.clone(), rates(counts))).collect(),
        sites: per_area(&sites.counts),
        columns: per_area(&column_counts),
        intensity: image.blocks,
        neighbours_nm: with_blocks(spread(cells.nearest(), DISTANCE_RESOLUTION_NM)),
        intensities: with_blocks(spread(image.columns, resolution)),
        spectrum: image.spectrum,
        site_counts: sites.counts,
    })
}

fn notes(world: &WorldFile) -> BTreeMap<String, String> {
    let m = world.metadata();
    let recipe = recipe(world);
    let mut notes = BTreeMap::new();
    let mut add = |name: &str, value: Option<String>| {
        value.map(|v| notes.insert(name.to_owned(), v));
    };
    add("recipe", recipe.as_ref().and_then(|r| Some(r.get("id")?.as_str()?.to_owned())));
    add("engine", m.engine.clone());
    add("stemgen", m.version.clone());
    add("seed", m.seed.map(|s| s.to_string()));
    add("dose", m.dose_electrons_per_angstrom2.map(|d| format!("{d} electrons per A2")));
    add("source", m.source.clone());
    notes
}

fn recipe(world: &WorldFile) -> Option<toml::Table> {
    world.metadata().recipe.as_ref()?.parse().ok()
}

/// Returns the spatial frequency (1/nm) above which an incoherent image holds noise only: twice the semiangle divided by the wavelength.
/// Infinite if the file does not give them.
fn optical_limit(world: &WorldFile) -> f64 {
    let measured = || {
        let recipe = recipe(world)?;
        let optics = recipe.get("optics")?;
        let number = |key: &str| {
            let v = optics.get(key)?;
            v.as_float().or_else(|| v.as_integer().map(|i| i as f64))
        };
        let wavelength_nm = wavelength_angstrom(number("energy_kv")? * 1e3) / 10.0;
        Some(2e-3 * number("convergence_mrad")? / wavelength_nm)
    };
    measured().unwrap_or(f64::INFINITY)
}

#[derive(Default)]
struct SiteCounts {
    counts: Vec<f64>,
    elements: BTreeSet<u8>,
    defects: BTreeMap<String, Vec<f64>>,
    /// Positions of sites, kept only if the file lists no columns.
    positions: Vec<[f32; 2]>,
}

impl SiteCounts {
    fn read(world: &WorldFile, blocks: Blocks) -> Result<Self> {
        let keep = world.columns()?.is_empty();
        let mut sites = SiteCounts { counts: vec![0.0; blocks.len()], ..SiteCounts::default() };
        let count = world.site_count()?;
        for start in (0..count).step_by(SITES_AT_ONCE) {
            let part = world.truth(start..(start + SITES_AT_ONCE).min(count))?;
            sites.elements.extend(part.numbers.iter().filter_map(|z| u8::try_from(*z).ok()));
            for (i, at) in part.positions.iter().enumerate() {
                let block = blocks.of(*at);
                sites.counts[block] += 1.0;
                let kind = match part.types.get(i).copied().unwrap_or_default() {
                    atom_type::PRISTINE => continue,
                    atom_type::VACANCY => "vacancy",
                    _ => "substitution",
                };
                let name = part.defect_names.get(i).filter(|n| !n.is_empty());
                let name = name.map_or(kind, String::as_str);
                if !sites.defects.contains_key(name) {
                    sites.defects.insert(name.to_owned(), vec![0.0; blocks.len()]);
                }
                if let Some(counts) = sites.defects.get_mut(name) {
                    counts[block] += 1.0;
                }
            }
            if keep {
                sites.positions.extend(part.positions);
            }
        }
        Ok(sites)
    }
}

/// Returns the positions of the atomic columns; if the file lists none, the positions of the sites.
fn columns(world: &WorldFile, sites: &SiteCounts) -> Result<Vec<[f32; 2]>> {
    let columns: Vec<WorldColumn> = world.columns()?;
    Ok(match columns.is_empty() {
        true => sites.positions.clone(),
        false => columns.iter().map(|c| c.position_nm).collect(),
    })
}

struct ImageMeasures {
    /// Intensity and pixels of each block.
    blocks: Vec<(f64, f64)>,
    /// Mean intensity about each column.
    columns: Vec<f32>,
    spectrum: Spectrum,
}

impl ImageMeasures {
    /// Reads strips of rows, each with the margin that columns at its edges need.
    fn read(
        world: &WorldFile,
        path: &Path,
        blocks: Blocks,
        bands: &Bands,
        columns: &[[f32; 2]],
        progress: &dyn Progress,
    ) -> Result<Self> {
        let [height, width] = world.shape();
        let pixel_nm = blocks.pixel_nm;
        let [scale, offset] = world.metadata().scaling.unwrap_or([1.0, 0.0]);
        let margin = (SIGMAS * COLUMN_SIGMA_NM / pixel_nm).ceil() as usize + 1;
        let mut image = ImageMeasures {
            blocks: vec![(0.0, 0.0); blocks.len()],
            columns: vec![0.0; columns.len()],
            spectrum: Collector::new(*bands, pixel_nm, 0.0).finish(),
        };
        let mut collector = Collector::new(*bands, pixel_nm, optical_limit(world));
        let mut by_strip: HashMap<usize, Vec<usize>> = HashMap::new();
        for (i, [_, y]) in columns.iter().enumerate() {
            let row = (f64::from(*y) / pixel_nm).round().clamp(0.0, (height - 1) as f64) as usize;
            by_strip.entry(row / STRIP).or_default().push(i);
        }
        for start in (0..height).step_by(STRIP) {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let end = (start + STRIP).min(height);
            let (first, last) = (start.saturating_sub(margin), (end + margin).min(height));
            let strip = world.stitched(first..last, 0..width)?;
            if let Some(((y, x), v)) = strip.indexed_iter().find(|(_, v)| !v.is_finite()) {
                let place = format!("{v} at row {}, column {x}", first + y);
                let expected = format!("expected finite values in {}", path.display());
                return Err(Error::invalid(Setting::ImageValue, place, expected));
            }
            let strip = strip.mapv(|v| f64::from(v) * scale + offset);
            let own = strip.slice(s![start - first..end - first, ..]);
            for ((y, x), v) in own.indexed_iter() {
                let block = &mut image.blocks[blocks.of_pixel((start + y) as f64, x as f64)];
                *block = (block.0 + v, block.1 + 1.0);
            }
            collector.add(own);
            for i in by_strip.remove(&(start / STRIP)).unwrap_or_default() {
                image.columns[i] = around(&strip, first, columns[i], pixel_nm);
            }
            progress.advance((end - start) as u64);
        }
        image.spectrum = collector.finish();
        Ok(image)
    }
}

/// Returns the weighted mean of the pixels around a column (see [`COLUMN_SIGMA_NM`]), or else the value of the nearest pixel.
fn around(strip: &Array2<f64>, first: usize, [x, y]: [f32; 2], pixel_nm: f64) -> f32 {
    let (rows, columns) = strip.dim();
    let (cx, cy) = (f64::from(x) / pixel_nm, f64::from(y) / pixel_nm - first as f64);
    let (sigma, reach) = (COLUMN_SIGMA_NM / pixel_nm, SIGMAS * COLUMN_SIGMA_NM / pixel_nm);
    let range = |centre: f64, n: usize| {
        let clamp = |v: f64| v.clamp(0.0, (n - 1) as f64) as usize;
        clamp((centre - reach).round())..=clamp((centre + reach).round())
    };
    let (mut sum, mut count) = (0.0, 0.0);
    let (mut nearest, mut value) = (f64::INFINITY, 0.0);
    for row in range(cy, rows) {
        for column in range(cx, columns) {
            let distance = (row as f64 - cy).hypot(column as f64 - cx);
            if distance <= reach {
                let weight = (-0.5 * (distance / sigma).powi(2)).exp();
                sum += weight * strip[[row, column]];
                count += weight;
            }
            if distance < nearest {
                (nearest, value) = (distance, strip[[row, column]]);
            }
        }
    }
    (if count > LEAST_WEIGHT { sum / count } else { value }) as f32
}

/// Adds a random number between -1/2 and 1/2 of `resolution` to each value.
fn spread(mut values: Vec<f32>, resolution: f32) -> Vec<f32> {
    for (i, d) in values.iter_mut().enumerate() {
        let word = philox4x32_10([i as u32, (i >> 32) as u32, 0, 0], [0x6e6e, 0])[0];
        *d += resolution * (word as f32 / u32::MAX as f32 - 0.5);
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::validate::field_waves::FieldWaves;
    use crate::validate::statistics::{Places, kolmogorov_smirnov};

    #[test]
    fn columns_average_their_pixels() {
        let strip = Array2::from_shape_fn((20, 20), |(y, x)| (100 * y + x) as f64);
        // The mean of a slope is the value at the column, at any place between pixels.
        assert!((around(&strip, 0, [0.2, 0.2], 0.02) - 1010.0).abs() < 1e-3);
        assert!((around(&strip, 5, [0.2, 0.31], 0.02) - 1060.0).abs() < 1e-2);
        assert!((around(&strip, 0, [0.2072, 0.2044], 0.02) - 1032.36).abs() < 1e-2);
        // With coarse pixels the nearest pixel is taken.
        assert_eq!(around(&strip, 0, [0.9, 0.4], 0.2), 204.0);
    }

    /// With few electrons most columns have one of a few intensities, which two files hold with different rounding.
    #[test]
    fn equal_counts_of_electrons_are_equal_whatever_the_rounding() {
        let counts = |seed: u32| -> Vec<f32> {
            let electrons = |i: u32| (philox4x32_10([i, 0, 0, 0], [seed, 9])[0] % 7) as f32;
            (0..6400).map(|i| 1.3e-3 * electrons(i)).collect()
        };
        let scaled: Vec<f32> = counts(2).iter().map(|v| v * (1.0 + 3e-7)).collect();
        let compare = |a: Vec<f32>, b: Vec<f32>| {
            let blocks = |v: Vec<f32>| -> Vec<(u32, f32)> {
                v.into_iter().enumerate().map(|(i, v)| (i as u32 / 100, v)).collect()
            };
            let waves = FieldWaves::new([8, 8], [5, 5]);
            kolmogorov_smirnov(&blocks(a), &blocks(b), Places::Same(&waves))
        };
        let raw = compare(counts(1), scaled.clone());
        assert!(raw.p < 1e-3 && raw.distance > 0.1, "rounding alone: {raw:?}");
        let resolution = INTENSITY_RESOLUTION * 3.9e-3;
        let same = compare(spread(counts(1), resolution), spread(scaled, resolution));
        assert!(same.p > 0.01 && same.distance < 0.03, "{same:?}");
    }

    #[test]
    fn blocks_cover_the_field() {
        let blocks = Blocks::new([128, 376], 0.02);
        assert_eq!(blocks.count, [16, 16]);
        assert_eq!(blocks.of([-0.02, 0.0]), 0);
        assert_eq!(blocks.of([100.0, 100.0]), 255);
        assert!((blocks.area_nm2() * 256.0 - 128.0 * 376.0 * 4e-4).abs() < 1e-9);
        assert_eq!(Blocks::new([28, 28], 0.02).count, [3, 3]);
    }
}
