//! Converts a recorded image to a world file.

use std::path::Path;

use ndarray::{Array2, ArrayView2, s};
use rayon::prelude::*;
use serde::Serialize;

use super::calibration::{Calibration, calibrate};
use super::nearest_cells::NearestCells;
use super::robust_range::percentiles;
use crate::error::{Error, Result};
use crate::files::atomic_write;
use crate::files::file_digest::sha256_of_file;
use crate::io::recorded::{RecordedCells, RecordedImage};
use crate::io::{Header, WorldFile, WorldWriter};
use crate::progress::Progress;
use crate::setting::Setting;
use crate::world::blended_image::Overview;

/// Edge of a tile, and overlap of neighbours, in pixels.
const TILE_PX: usize = 128;
const OVERLAP_PX: usize = 4;
const STRIDE_PX: usize = TILE_PX - OVERLAP_PX;
/// Allowed edges of a pixel in nm: a hundredth of a pm to 10 um.
const PIXELS_NM: std::ops::RangeInclusive<f64> = 1e-5..=1e4;
/// Names of the four phases by the signs of the polarisation along x and y.
const QUADRANTS: [&str; 4] = ["Px+ Py+", "Px- Py+", "Px- Py-", "Px+ Py-"];
/// If a smaller share of the cells lies in the image, the cells belong to another image.
const LEAST_INSIDE: f64 = 0.5;

/// Options for converting a recorded image to a world.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayOptions {
    /// Edge of a pixel in nm, in place of the file's.
    pub pixel_nm: Option<f64>,
    /// A spacing of the crystal in nm that is measured in the image; the search begins at the given size of a pixel.
    pub spacing_nm: Option<f64>,
    /// Percentiles of the image that become 0 and 1.
    pub percentiles: [f64; 2],
}

impl Default for ReplayOptions {
    fn default() -> Self {
        ReplayOptions { pixel_nm: None, spacing_nm: None, percentiles: [0.1, 99.9] }
    }
}

/// Origin of the size of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelOrigin {
    /// Taken from the file.
    File,
    /// Given by the user.
    Given,
    /// Measured by a known spacing.
    Calibrated,
}

/// Contents of a world of a recorded image.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ReplayFacts {
    /// Kind of the recorded file.
    pub format: &'static str,
    /// Name of the image in its file.
    pub image: String,
    /// Rows and columns of the recorded image.
    pub recorded_px: [usize; 2],
    /// Rows and columns of tiles.
    pub tiles: [usize; 2],
    /// Rows and columns of pixels of the world; the rest of the image, below and to the right, is left out.
    pub pixels: [usize; 2],
    /// Edge of a pixel in nm.
    pub pixel_size_nm: f64,
    /// Origin of the size of a pixel.
    pub pixel_size_from: PixelOrigin,
    /// Size of a pixel in the file.
    pub pixel_size_in_file_nm: Option<f64>,
    /// The calibration, if one was made.
    pub calibration: Option<Calibration>,
    /// Recorded values that become 0 and 1.
    pub range: [f64; 2],
    /// Shares of the pixels below and above that range, which are clipped.
    pub cut_off: [f64; 2],
    /// Number of pixels of the whole image without a finite value, which are replaced by its median.
    pub invalid_pixels: usize,
    /// Number of places in the world that the file lists.
    pub sites: usize,
    /// Number of listed places elsewhere, or without finite numbers.
    pub sites_left_out: usize,
    /// Names of the phases by their codes; empty for a single phase.
    pub phases: Vec<String>,
    /// Energy of the electrons, if the file gives it.
    pub energy_kev: Option<f64>,
    /// Name of the detector, if the file gives it.
    pub detector: Option<String>,
    /// Changes of the image's orientation after reading, in words.
    pub notes: Vec<String>,
}

/// A world of a recorded image, before it is written.
#[derive(Debug)]
pub struct ReplayWorld {
    facts: ReplayFacts,
    file_name: String,
    sha256: Option<String>,
    percentiles: [f64; 2],
    /// The recorded image, without gaps; the world holds its first rows and columns.
    image: Array2<f64>,
    valid: Array2<bool>,
    cells: RecordedCells,
    /// Places in pixels, and quadrants of the polarisation, of all cells that have both, in the tiles or beside them.
    quadrants: Vec<([f64; 2], i32)>,
}

impl ReplayWorld {
    /// Calibrates and scales a recorded image.
    ///
    /// # Errors
    /// [`Error::Choice`] if the file does not give the size of a pixel, for an image smaller than a tile, and for an image of a single
    /// value; [`Error::Invalid`] for options out of limits, and a spacing that the image does not show; [`Error::Io`].
    pub fn new(mut recorded: RecordedImage, options: &ReplayOptions) -> Result<Self> {
        let path = recorded.path.clone();
        let (rows, columns) = recorded.pixels.dim();
        let tiles = grid([rows, columns], &path)?;
        let first_guess = first_guess(&recorded, options)?;
        let FilledImage { image, valid, range } = FilledImage::of(&mut recorded, options)?;
        let calibration = options
            .spacing_nm
            .map(|spacing| calibrate(&image, spacing, first_guess))
            .transpose()?;
        let pixels = tiles.map(|n| n * STRIDE_PX + OVERLAP_PX);
        let invalid_pixels = valid.iter().filter(|v| !**v).count();
        let part = image.slice(s![..pixels[0], ..pixels[1]]);
        let share = |beyond: &dyn Fn(f64) -> bool| {
            part.iter().filter(|v| beyond(**v)).count() as f64 / part.len() as f64
        };
        let listed = recorded.cells.as_ref().map_or(0, |cells| cells.positions_px.len());
        let quadrants = recorded.cells.as_ref().map(quadrants).unwrap_or_default();
        let cells = match recorded.cells {
            Some(cells) => inside(cells, pixels, &path)?,
            None => RecordedCells::default(),
        };
        let sites = cells.positions_px.len();
        let facts = ReplayFacts {
            format: recorded.format.name(),
            image: recorded.name,
            recorded_px: [rows, columns],
            tiles,
            pixels,
            pixel_size_nm: calibration.as_ref().map_or(first_guess, |c| c.pixel_nm),
            pixel_size_from: match (options.spacing_nm, options.pixel_nm) {
                (Some(_), _) => PixelOrigin::Calibrated,
                (None, Some(_)) => PixelOrigin::Given,
                (None, None) => PixelOrigin::File,
            },
            pixel_size_in_file_nm: recorded.pixel_nm.ok(),
            calibration,
            range,
            cut_off: [share(&|v| v < range[0]), share(&|v| v > range[1])],
            invalid_pixels,
            sites,
            sites_left_out: listed - sites,
            phases: phases(&quadrants),
            energy_kev: recorded.energy_kev,
            detector: recorded.detector,
            notes: recorded.notes,
        };
        // A zarr array is a folder and has no digest.
        let sha256 = path.is_file().then(|| sha256_of_file(&path)).transpose()?;
        let sha256 = sha256.map(|(digest, _)| digest);
        let file_name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let percentiles = options.percentiles;
        Ok(ReplayWorld { facts, file_name, sha256, percentiles, image, valid, cells, quadrants })
    }

    /// Returns the contents of the world.
    pub fn facts(&self) -> &ReplayFacts {
        &self.facts
    }

    /// Writes the world. The file appears complete or not at all.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Hdf5`], [`Error::Interrupted`].
    pub fn write(&self, path: &Path, overwrite: bool, progress: &dyn Progress) -> Result<()> {
        atomic_write::write_with(path, overwrite, |temporary| {
            let writer = WorldWriter::create(temporary, &self.header(), false)?;
            self.write_images(&writer, progress)?;
            self.write_truth(&writer, progress)?;
            writer.finish()?;
            // A file that cannot be read back is not put in place.
            WorldFile::open(temporary)?.overview().map(drop)
        })
    }

    fn header(&self) -> Header {
        let f = &self.facts;
        let [rows, columns] = f.recorded_px;
        let [low, high] = self.percentiles;
        let mut texts = vec![
            ("source", "replay".to_owned()),
            ("source_file", self.file_name.clone()),
            ("source_format", f.format.to_owned()),
            ("source_image", f.image.clone()),
            (
                "source_pixels",
                format!("{rows} rows x {columns} columns, of which the first are taken"),
            ),
            ("pixel_size_from", self.pixel_size_from()),
            (
                "normalisation",
                format!(
                    "percentiles {low} and {high} of the recorded values become 0 and 1; values beyond are cut off"
                ),
            ),
            ("stemgen_version", env!("CARGO_PKG_VERSION").to_owned()),
        ];
        if f.invalid_pixels > 0 {
            let gaps = "have the median of the image, and are false in valid_region";
            texts.push((
                "gaps",
                format!("{} pixels without a finite value {gaps}", f.invalid_pixels),
            ));
        }
        if !f.notes.is_empty() {
            texts.push(("source_notes", f.notes.join("; ")));
        }
        texts.extend(self.sha256.clone().map(|digest| ("source_sha256", digest)));
        texts.extend(f.detector.clone().map(|name| ("recorded_detector", name)));
        let calibration = f.calibration.as_ref().and_then(|c| serde_json::to_string(c).ok());
        texts.extend(calibration.map(|json| ("calibration", json)));
        for (_, value) in &mut texts {
            // HDF5 ends texts at this character.
            value.retain(|c| c != '\0');
        }
        let stated = [
            ("recorded_black", Some(f.range[0])),
            ("recorded_white", Some(f.range[1])),
            ("share_below_black", Some(f.cut_off[0])),
            ("share_above_white", Some(f.cut_off[1])),
            ("pixel_size_in_file_nm", f.pixel_size_in_file_nm),
            ("recorded_energy_kev", f.energy_kev),
        ];
        Header {
            pixel_size_nm: f.pixel_size_nm,
            tile_size_px: TILE_PX,
            overlap_px: OVERLAP_PX,
            grid_shape: f.tiles,
            fov_nm: f.pixels.map(|n| n as f64 * f.pixel_size_nm),
            texts,
            numbers: stated.into_iter().filter_map(|(name, v)| Some((name, v?))).collect(),
            ..Header::default()
        }
    }

    fn pixel_size_from(&self) -> String {
        match (&self.facts.calibration, self.facts.pixel_size_from) {
            (Some(c), _) => format!(
                "a spacing of {} nm, found at {:.3} pixels in the Fourier transform",
                c.spacing_nm,
                c.spacing_nm / c.pixel_nm
            ),
            (None, PixelOrigin::File) => "the file".into(),
            (None, _) => "the user".into(),
        }
    }

    fn write_images(&self, writer: &WorldWriter, progress: &dyn Progress) -> Result<()> {
        let [low, high] = self.facts.range;
        writer.scaling_of_recorded(high - low, low)?;
        let ([rows, columns], [_, width]) = (self.facts.tiles, self.facts.pixels);
        let mut overview = Overview::new(self.facts.pixels);
        progress.start("writing tiles", "tile", (rows * columns) as u64);
        for row in 0..rows {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let first = row * STRIDE_PX;
            let band = self.image.slice(s![first..first + TILE_PX, ..width]);
            let band = band.mapv(|v| ((v - low) / (high - low)).clamp(0.0, 1.0) as f32);
            let lefts = (0..columns).map(|column| column * STRIDE_PX);
            let tiles: Vec<_> =
                lefts.map(|left| band.slice(s![.., left..left + TILE_PX])).collect();
            writer.tiles(row, &tiles)?;
            progress.advance(columns as u64);
            let own = if row + 1 == rows { TILE_PX } else { STRIDE_PX };
            overview.add(first, band.slice(s![..own, ..]));
            writer.valid_rows(first, self.valid.slice(s![first..first + own, ..width]))?;
        }
        progress.finish();
        writer.overview(overview.mean().view())
    }

    fn write_truth(&self, writer: &WorldWriter, progress: &dyn Progress) -> Result<()> {
        let pixel = self.facts.pixel_size_nm;
        let place = |p: &[f64; 2]| p.map(|v| (v * pixel) as f32);
        let places: Vec<[f32; 2]> = self.cells.positions_px.iter().map(place).collect();
        writer.truth().places_alone(&places)?;
        let cells = &self.cells;
        if !cells.polarisations.is_empty() || !cells.intensities.is_empty() {
            let vectors: Vec<[f32; 2]> =
                cells.polarisations.iter().map(|p| p.map(|v| v as f32)).collect();
            let list = |(name, values): &(String, Vec<f64>)| {
                (name.clone(), values.iter().map(|v| *v as f32).collect())
            };
            let lists: Vec<(String, Vec<f32>)> = cells.intensities.iter().map(list).collect();
            writer.truth().unit_cells(&vectors, &lists)?;
        }
        if self.facts.phases.is_empty() {
            return Ok(());
        }
        writer.truth().create_phase_map(&self.facts.phases)?;
        self.write_phases(writer, progress)
    }

    /// Writes the phase map: each pixel has the quadrant of the nearest cell.
    fn write_phases(&self, writer: &WorldWriter, progress: &dyn Progress) -> Result<()> {
        let known = &self.quadrants;
        let [rows, columns] = self.facts.pixels;
        let places = known.iter().map(|(at, _)| *at).collect();
        let nearest = NearestCells::new(places, self.facts.pixels);
        for first in (0..rows).step_by(STRIDE_PX) {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let count = STRIDE_PX.min(rows - first);
            let code = |at: usize| {
                let (row, column) = (first + at / columns, at % columns);
                let cell = nearest.nearest([column as f64, row as f64]);
                cell.map_or(0, |cell| known[cell].1)
            };
            let codes: Vec<i32> = (0..count * columns).into_par_iter().map(code).collect();
            let band = ArrayView2::from_shape((count, columns), &codes);
            let band = band.expect("as many codes as pixels");
            writer.truth().phase_rows(first, band)?;
        }
        Ok(())
    }
}

/// Returns the rows and columns of whole tiles in an image.
fn grid(shape: [usize; 2], path: &Path) -> Result<[usize; 2]> {
    let tiles = shape.map(|n| n.saturating_sub(OVERLAP_PX) / STRIDE_PX);
    if tiles.contains(&0) {
        let [rows, columns] = shape;
        let message = format!(
            "its image has {rows} x {columns} pixels, and a tile of a world has {TILE_PX} x {TILE_PX}: use a larger part of the recording, \
             or resample it to finer pixels first (this changes the pixel size)"
        );
        return Err(Error::choice(path, Setting::ReplayImage, message));
    }
    Ok(tiles)
}

/// Returns the size of a pixel as given by the user or the file.
fn first_guess(recorded: &RecordedImage, options: &ReplayOptions) -> Result<f64> {
    let nm = match (options.pixel_nm, &recorded.pixel_nm) {
        (Some(nm), _) => nm,
        (None, Ok(nm)) => *nm,
        (None, Err(why)) => {
            let message = format!(
                "does not contain a usable pixel size ({why}); give the edge of a pixel in nm"
            );
            return Err(Error::choice(&recorded.path, Setting::ReplayPixelNm, message));
        }
    };
    match PIXELS_NM.contains(&nm) {
        true => Ok(nm),
        false => {
            let expected =
                format!("expected {} to {} nm along its edge", PIXELS_NM.start(), PIXELS_NM.end());
            Err(Error::invalid(Setting::ReplayPixelNm, nm, expected))
        }
    }
}

/// An image without gaps.
struct FilledImage {
    /// The image, with its median in place of values that are not finite.
    image: Array2<f64>,
    /// True for pixels with a finite value.
    valid: Array2<bool>,
    /// The image's values at the percentiles.
    range: [f64; 2],
}

impl FilledImage {
    /// Fills the gaps in the pixels of a recorded image.
    fn of(recorded: &mut RecordedImage, options: &ReplayOptions) -> Result<Self> {
        let [low, high] = options.percentiles;
        if !(0.0 <= low && low < high && high <= 100.0) {
            let expected = "expected two percentiles from 0 to 100, the lower first";
            let value = format!("{low},{high}");
            return Err(Error::invalid(Setting::ContrastPercentiles, value, expected));
        }
        let mut image = std::mem::take(&mut recorded.pixels);
        let refuse =
            |message: &str| Err(Error::choice(&recorded.path, Setting::ReplayImage, message));
        let valid = image.mapv(f64::is_finite);
        let values = image.as_slice_memory_order().unwrap_or_default();
        let Some([low, median, high]) = percentiles(values, [low, 50.0, high]) else {
            return refuse("its image has no pixel with a finite value");
        };
        if !(low < high && (high - low).is_finite()) {
            return refuse(
                "its image has one value at both percentiles: it is empty, or nearly so; percentiles further apart may help",
            );
        }
        image.mapv_inplace(|v| if v.is_finite() { v } else { median });
        Ok(FilledImage { image, valid, range: [low, high] })
    }
}

/// Returns the cells whose place is known and lies in an image of this shape.
fn inside(cells: RecordedCells, [rows, columns]: [usize; 2], path: &Path) -> Result<RecordedCells> {
    let within = |v: f64, n: usize| (-0.5..n as f64 - 0.5).contains(&v);
    let listed = cells.positions_px.len();
    let kept: Vec<usize> = (0..listed)
        .filter(|k| {
            let [x, y] = cells.positions_px[*k];
            within(x, columns) && within(y, rows)
        })
        .collect();
    if (kept.len() as f64) < LEAST_INSIDE * listed as f64 {
        let message = format!(
            "lists {listed} places, of which {} lie in its image of {rows} x {columns} pixels: they belong to another image, or their unit \
             is not the pixel",
            kept.len()
        );
        return Err(Error::choice(path, Setting::ReplayImage, message));
    }
    let list = |(name, values): &(String, Vec<f64>)| {
        (name.clone(), kept.iter().filter_map(|k| values.get(*k).copied()).collect())
    };
    Ok(RecordedCells {
        positions_px: kept.iter().map(|k| cells.positions_px[*k]).collect(),
        polarisations: kept.iter().filter_map(|k| cells.polarisations.get(*k).copied()).collect(),
        intensities: cells.intensities.iter().map(list).collect(),
    })
}

/// Returns the code of the quadrant of a polarisation; zeros count as positive. `None` if it is not known.
fn quadrant([x, y]: [f64; 2]) -> Option<i32> {
    if !(x.is_finite() && y.is_finite()) {
        return None;
    }
    Some(match (x < 0.0, y < 0.0) {
        (false, false) => 0,
        (true, false) => 1,
        (true, true) => 2,
        (false, true) => 3,
    })
}

/// Returns places and quadrants of the cells that have both.
fn quadrants(cells: &RecordedCells) -> Vec<([f64; 2], i32)> {
    let all = cells.positions_px.iter().zip(&cells.polarisations);
    let known = all.filter(|(at, _)| at.iter().all(|v| v.is_finite()));
    known.filter_map(|(at, p)| Some((*at, quadrant(*p)?))).collect()
}

/// Returns the names of the phases, if the cells have more than one.
fn phases(quadrants: &[([f64; 2], i32)]) -> Vec<String> {
    let several = quadrants.windows(2).any(|pair| pair[0].1 != pair[1].1);
    if several { QUADRANTS.map(str::to_owned).to_vec() } else { Vec::new() }
}
