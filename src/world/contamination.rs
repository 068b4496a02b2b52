//! Carbon that grows under the beam, as recordings see it.

use crate::acquisition::{Exposure, ScanPath, SourceImage};
use crate::error::{Error, Result};
use crate::imaging::{CarbonPatch, GrownCarbon, MOST_GROWN_ANGSTROM};
use crate::recipe::Region;
use crate::setting::Setting;
use crate::specimen::DoseMap;

/// Thicknesses that differ by less than this share are the same.
const ROUNDING: f64 = 1e-9;

/// The carbon on a specimen when a recording begins; thicknesses in Angstrom take the place of doses.
#[derive(Clone, Copy)]
pub(crate) struct CarbonBefore<'a> {
    pub film: &'a GrownCarbon,
    pub angstrom: &'a DoseMap,
}

/// The carbon on a specimen during a recording.
pub(crate) struct GrowingCarbon<'a> {
    patch: CarbonPatch<'a>,
    angstrom: DoseMap,
    per_electron: f64,
}

impl<'a> GrowingCarbon<'a> {
    /// The carbon on what an image shows; each electron adds `per_electron` cubic Angstrom.
    ///
    /// # Errors
    /// Those of the settings.
    pub fn new(before: &CarbonBefore<'a>, image: &SourceImage, per_electron: f64) -> Result<Self> {
        let [x, y] = image.extent_nm();
        let mut patch = before.film.patch(&Region { x, y });
        let angstrom = before.angstrom.clone();
        patch.grow(&angstrom)?;
        Ok(GrowingCarbon { patch, angstrom, per_electron })
    }

    /// An image of the specimen with the carbon added.
    pub fn over(&self, image: &SourceImage) -> SourceImage {
        image.plus(&self.patch.image())
    }

    /// Mean thickness in nm in a region (nm of the full field), but for its outermost 0.05 nm, where cells reach beyond it.
    pub fn mean_nm(&self, region: &Region) -> f64 {
        0.1 * self.angstrom.mean_within(region)
    }

    /// Adds what a frame leaves.
    ///
    /// # Errors
    /// Those of the settings.
    pub fn after_frame(
        &mut self,
        path: &ScanPath,
        exposure: &Exposure,
        frame: usize,
    ) -> Result<()> {
        let volume = self.per_electron * exposure.electrons_per_pixel;
        expose_frame(&mut self.angstrom, path, volume, frame);
        self.patch.grow(&self.angstrom)
    }
}

/// The carbon of a whole recording, in Angstrom, with none before.
pub(crate) fn grown(path: &ScanPath, exposure: &Exposure, per_electron: f64) -> DoseMap {
    let mut angstrom = DoseMap::default();
    if per_electron > 0.0 {
        for frame in 0..path.frames() {
            expose_frame(&mut angstrom, path, per_electron * exposure.electrons_per_pixel, frame);
        }
    }
    angstrom
}

/// Whether carbon stays as thin as it may be.
///
/// # Errors
/// [`Error::Invalid`] if it does not.
pub(crate) fn check_thickness(before: &DoseMap, more: &DoseMap, per_electron: f64) -> Result<()> {
    let greatest = before.greatest_with(more);
    if greatest <= MOST_GROWN_ANGSTROM * (1.0 + ROUNDING) {
        return Ok(());
    }
    let value = format!("contamination_angstrom3_per_electron = {per_electron}");
    let expected = format!(
        "the carbon would become {:.2} nm thick, and at most {} nm can be imaged: take a smaller dose or rate",
        0.1 * greatest,
        0.1 * MOST_GROWN_ANGSTROM
    );
    Err(Error::invalid(Setting::Acquisition, value, expected))
}

/// Spreads what every pixel of a frame leaves, line by line; returns the area (nm of the full field) that they lie in.
pub(crate) fn expose_frame(
    map: &mut DoseMap,
    path: &ScanPath,
    per_pixel: f64,
    frame: usize,
) -> Region {
    let [rows, columns] = path.frame().shape;
    let (half, amount) = (0.5 * path.frame().pixel_nm, per_pixel * columns as f64);
    let mut area = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for row in 0..rows {
        let ends = [0, columns - 1].map(|column| path.place_nm(frame, row, column));
        let y = 0.5 * (ends[0][1] + ends[1][1]);
        let x = [ends[0][0].min(ends[1][0]) - half, ends[0][0].max(ends[1][0]) + half];
        let line = Region { x, y: [y - half, y + half] };
        map.add(&line, amount);
        for (all, own) in area.iter_mut().zip([line.x, line.y]) {
            *all = [all[0].min(own[0]), all[1].max(own[1])];
        }
    }
    Region { x: area[0], y: area[1] }
}
