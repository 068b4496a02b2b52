//! Carbon that grows under the beam during recordings.

use crate::acquisition::{Exposure, ScanPath, SourceImage};
use crate::error::{Error, Result};
use crate::imaging::{CarbonPatch, GrownCarbon, MOST_GROWN_ANGSTROM};
use crate::lengths;
use crate::recipe::Region;
use crate::setting::Setting;
use crate::specimen::DoseMap;

/// Thicknesses whose relative difference is below this value count as equal.
const ROUNDING: f64 = 1e-9;

/// The carbon on a specimen when a recording begins. The map holds thicknesses in Angstrom in place of doses.
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
    /// Describes the carbon on the area that an image shows; each electron adds `per_electron` cubic Angstrom.
    ///
    /// # Errors
    /// Errors of the settings.
    pub fn new(before: &CarbonBefore<'a>, image: &SourceImage, per_electron: f64) -> Result<Self> {
        let [x, y] = image.extent_nm();
        let mut patch = before.film.patch(&Region { x, y });
        let angstrom = before.angstrom.clone();
        patch.grow(&angstrom)?;
        Ok(GrowingCarbon { patch, angstrom, per_electron })
    }

    /// Returns the image of the specimen with the carbon added.
    pub fn over(&self, image: &SourceImage) -> SourceImage {
        image.plus(&self.patch.image())
    }

    /// Mean thickness in nm in a region (nm of the full field) without its outermost 0.05 nm, where cells of the map reach beyond it.
    pub fn mean_nm(&self, region: &Region) -> f64 {
        lengths::nm(self.angstrom.mean_within(region))
    }

    /// Adds the carbon that one frame deposits.
    ///
    /// # Errors
    /// Errors of the settings.
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

/// The carbon in Angstrom that a whole recording deposits on a clean specimen.
pub(crate) fn grown(path: &ScanPath, exposure: &Exposure, per_electron: f64) -> DoseMap {
    let mut angstrom = DoseMap::default();
    if per_electron > 0.0 {
        for frame in 0..path.frames() {
            expose_frame(&mut angstrom, path, per_electron * exposure.electrons_per_pixel, frame);
        }
    }
    angstrom
}

/// Checks that the carbon stays below its largest thickness.
///
/// # Errors
/// [`Error::Invalid`] if the carbon becomes too thick.
pub(crate) fn check_thickness(before: &DoseMap, more: &DoseMap, per_electron: f64) -> Result<()> {
    let greatest = before.greatest_with(more);
    if greatest <= MOST_GROWN_ANGSTROM * (1.0 + ROUNDING) {
        return Ok(());
    }
    let value = format!("contamination_angstrom3_per_electron = {per_electron}");
    let expected = format!(
        "the carbon would become {:.2} nm thick, and at most {} nm can be imaged: take a smaller dose or rate",
        lengths::nm(greatest),
        lengths::nm(MOST_GROWN_ANGSTROM)
    );
    Err(Error::invalid(Setting::Acquisition, value, expected))
}

/// Deposits the dose of every pixel of a frame, line by line; returns the area (nm of the full field) that the pixels lie in.
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
