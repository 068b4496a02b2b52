//! One process's part of a simulated scan, for several processes that share the scan.
//!
//! The plan, the scan and the number of a process decide which probes it simulates. A probe has the same value in every part as in the
//! whole, so the bytes of the image do not depend on the division.

use ndarray::{Array2, Array4};

use super::detector_images::Images;
use super::plan::Plan;
use super::probe_patches::ProbePatches;
use super::probe_scan::{ProbePlaces, Scan};
use crate::error::{Error, Result};
use crate::files::Shard;
use crate::numerics::NUMERICS_VERSION;
use crate::setting::Setting;
use crate::structure::Site;
use sha2::{Digest, Sha256};

/// The values that one of several processes simulated of a series of images.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanPart {
    shard: Shard,
    /// For each plan and frame, (probe of the part, detector of each thickness).
    values: Vec<Array2<f32>>,
}

impl ScanPart {
    /// The part of a process, still without values.
    pub(super) fn new(shard: Shard) -> Self {
        ScanPart { shard, values: Vec::new() }
    }

    pub(super) fn push(&mut self, values: Array2<f32>) {
        self.values.push(values);
    }

    /// All values in one array: the rows of each plan and frame, one below the other.
    pub fn to_array(&self) -> Array2<f32> {
        let columns = self.values.first().map_or(0, Array2::ncols);
        let rows = self.values.iter().map(Array2::nrows).sum();
        let values = self.values.iter().flat_map(|v| v.iter().copied()).collect();
        Array2::from_shape_vec([rows, columns], values).unwrap_or_default()
    }

    /// Restores the part of a process from the array of [`ScanPart::to_array`], for these plans, this number of frames, and this scan.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an array of another shape.
    pub fn from_array(
        array: &Array2<f32>,
        shard: Shard,
        (plans, frames, scan): (&[Plan], usize, &Scan),
    ) -> Result<Self> {
        let mut part = ScanPart::new(shard);
        let mut first = 0;
        for plan in plans {
            let raster = super::ProbeRaster::new(plan, scan)?;
            let rows = probes_of(plan, raster.scan(), shard).iter().filter(|w| **w).count();
            for _ in 0..frames {
                let end = first + rows;
                if end > array.nrows() || array.ncols() != per_probe(plan) {
                    return Err(other_series(shard));
                }
                part.push(array.slice(ndarray::s![first..end, ..]).to_owned());
                first = end;
            }
        }
        if first == array.nrows() { Ok(part) } else { Err(other_series(shard)) }
    }

    /// Rows and columns of the part's array, for these plans, this number of frames, and this scan.
    ///
    /// # Errors
    /// Errors of [`super::ProbeRaster::new`].
    pub fn shape(shard: Shard, plans: &[Plan], frames: usize, scan: &Scan) -> Result<[usize; 2]> {
        let mut rows = 0;
        for plan in plans {
            let raster = super::ProbeRaster::new(plan, scan)?;
            rows += frames * probes_of(plan, raster.scan(), shard).iter().filter(|w| **w).count();
        }
        Ok([rows, plans.first().map_or(0, per_probe)])
    }
}

/// A digest of the settings, slices, places and atoms that decide the values of a series of images or patterns of a scan.
pub fn series_digest(plans: &[Plan], frames: &[&[Site]], scan: &Scan) -> String {
    let settings: Vec<_> = plans.iter().map(|plan| &plan.settings).collect();
    let grids: Vec<_> = plans.iter().map(|plan| format!("{:?}", plan.slices)).collect();
    let text = serde_json::json!([NUMERICS_VERSION, settings, grids, format!("{scan:?}")]);
    let mut digest = Sha256::new_with_prefix(text.to_string());
    for sites in frames {
        digest.update(sites.len().to_le_bytes());
        for site in *sites {
            site.position.iter().for_each(|x| digest.update(x.to_le_bytes()));
            digest.update([site.number]);
            digest.update(site.sigma_angstrom.to_le_bytes());
            digest.update(site.key.to_le_bytes());
            if let Some(anisotropy) = site.anisotropy {
                anisotropy.components().iter().for_each(|x| digest.update(x.to_le_bytes()));
            }
        }
    }
    digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

fn other_series(shard: Shard) -> Error {
    Error::invalid(Setting::Shard, shard, "is a part of other images; remove it, and make it again")
}

fn per_probe(plan: &Plan) -> usize {
    plan.record_after.len() * plan.settings.detectors.len()
}

/// The probes of a raster that a process simulates: whole patches where the probes of a patch are expanded in common waves, else rows.
pub(super) fn probes_of(plan: &Plan, raster: &Scan, shard: Shard) -> Vec<bool> {
    let patches = ProbePatches::new(plan, raster);
    let mut wanted = vec![false; raster.len()];
    match patches.error {
        Some(_) => {
            let own = patches.patches.iter().enumerate().filter(|(n, _)| shard.does(*n));
            own.flat_map(|(_, patch)| &patch.probes).for_each(|(i, _)| wanted[*i] = true);
        }
        None => {
            let columns = raster.shape[1];
            wanted.iter_mut().enumerate().for_each(|(i, w)| *w = shard.does(i / columns));
        }
    }
    wanted
}

/// Images for probes at these places, filled with zeros.
pub(super) fn blank(plan: &Plan, places: ProbePlaces<'_>) -> Images {
    let [rows, columns] = places.shape();
    let shape = (plan.record_after.len(), plan.settings.detectors.len(), rows, columns);
    Images {
        data: Array4::zeros(shape),
        detectors: plan.settings.detectors.iter().map(|d| d.name.clone()).collect(),
        thicknesses_angstrom: plan.thicknesses_angstrom(),
    }
}

/// The values of the probes of a part: (probe, detector of each thickness).
pub(super) fn values_of(images: &Images, wanted: &[bool]) -> Array2<f32> {
    let (thicknesses, detectors, _, columns) = images.data.dim();
    let own: Vec<usize> = (0..wanted.len()).filter(|i| wanted[*i]).collect();
    Array2::from_shape_fn((own.len(), thicknesses * detectors), |(n, k)| {
        images.data[[k / detectors, k % detectors, own[n] / columns, own[n] % columns]]
    })
}

/// The parts of a series that processes have made.
pub(super) struct Known<'a> {
    pub parts: &'a [ScanPart],
    /// Index, among the arrays of a part, of the first array of the current plans.
    pub first: usize,
    /// Number of arrays of each plan.
    pub frames: usize,
}

impl Known<'_> {
    /// The probes that no part has; `None` where there are no parts.
    pub fn missing(&self, plan: &Plan, raster: Option<&Scan>) -> Option<Vec<bool>> {
        let raster = raster.filter(|_| !self.parts.is_empty())?;
        let mut missing = vec![true; raster.len()];
        for part in self.parts {
            let own = probes_of(plan, raster, part.shard);
            missing.iter_mut().zip(own).for_each(|(m, own)| *m &= !own);
        }
        Some(missing)
    }

    /// Copies the values of all parts into the images of one plan and frame.
    pub fn put(
        &self,
        images: &mut Images,
        (plan, raster): (&Plan, Option<&Scan>),
        [lens, frame]: [usize; 2],
    ) -> Result<()> {
        let Some(raster) = raster else { return Ok(()) };
        let (thicknesses, detectors, _, columns) = images.data.dim();
        for part in self.parts {
            let own = probes_of(plan, raster, part.shard);
            let own: Vec<usize> = (0..own.len()).filter(|i| own[*i]).collect();
            let values = part.values.get(self.first + lens * self.frames + frame);
            let shape = [own.len(), thicknesses * detectors];
            let values = values.filter(|v| v.shape() == shape);
            let values = values.ok_or_else(|| other_series(part.shard))?;
            for ((n, k), value) in values.indexed_iter() {
                let (y, x) = (own[n] / columns, own[n] % columns);
                images.data[[k / detectors, k % detectors, y, x]] = *value;
            }
        }
        Ok(())
    }
}
