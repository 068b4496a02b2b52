//! Audits: regions of a world are simulated again, exactly, with the same atoms.

use std::collections::BTreeMap;

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::column_statistics::{ColumnPoint, KindAudit, column_points, kind_audit};
pub use super::options::AuditOptions;
use super::places::{AuditPlace, places};
use super::power_spectrum::{PowerBand, power};
use crate::detect::{ShownImage, shown_images};
use crate::engine::{Algorithm, ProbeStep};
use crate::error::Result;
use crate::imaging::direct::rectangle_plan;
use crate::imaging::imaging_cost::SimulationRuns;
use crate::imaging::pixels::{PixelBox, PixelRect};
use crate::imaging::region_imager::RegionImager;
use crate::imaging::simulator::Simulator;
use crate::imaging::source_imager::{blurred, margin_px};
use crate::potential::slices::Slicing;
use crate::progress::{InterruptOnly, Progress};
use crate::recipe::{CheckedRecipe, Recipe};
use crate::resample::image_band_limit;
use crate::specimen::{Specimen, SurfaceLayers};

/// A column is bright if it has more than this share of the intensity of the brightest one.
const BRIGHT: f64 = 0.4;
/// Approximate distance in Angstrom of the compared pixels.
const POINT_ANGSTROM: f64 = 0.5;
/// Distance of the reference's probes in Nyquist distances of the image, where the source blurs the image.
const NYQUIST_SHARE: f64 = 0.9;
/// Thickness in Angstrom of the reference's slices where there are particles. They are thinner than the world's slices, so that an audit
/// shows the error of slicing.
const PARTICLE_SPAN_ANGSTROM: f64 = 0.1;

/// The two images of a region, and the differences between them.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[non_exhaustive]
pub struct RegionAudit {
    /// Centre (x, y) in nm of the built field.
    pub centre_nm: [f64; 2],
    /// Bright columns compared.
    pub bright_columns: usize,
    /// Rms error at bright columns in per cent of their intensity. A column is bright if it has more than 40 % of the intensity of the
    /// brightest column of all regions.
    pub bright_rms_percent: f64,
    /// Mean error at bright columns in per cent.
    pub bright_mean_percent: f64,
    /// Error of the mean over the region in per cent of the exact mean.
    pub mean_percent: f64,
    /// Rms error off bright columns (more than 1 Angstrom from any), in per cent of the brightest column.
    pub off_columns_rms_percent: f64,
    /// Rms error of all pixels in per cent of the brightest column.
    pub all_rms_percent: f64,
    /// Greatest error of any pixel in per cent of the brightest column.
    pub worst_percent: f64,
    /// The audited image at the compared pixels, [row, column], fractions of the beam.
    #[serde(skip)]
    pub ours: Array2<f64>,
    /// The exact image at the compared pixels, [row, column], fractions of the beam.
    #[serde(skip)]
    pub exact: Array2<f64>,
}

/// The result of an audit.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Audit {
    /// Name of the detector, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detector: Option<String>,
    /// Engine that made the world.
    pub engine: String,
    /// Width in Angstrom of this engine's windows.
    pub window_angstrom: Option<f64>,
    /// Engine of the exact images.
    pub reference: String,
    /// Number of averaged configurations, and number of all.
    pub configurations: [usize; 2],
    /// Rms error over all bright columns, per cent of their intensity.
    pub bright_rms_percent: f64,
    /// Rms error over all pixels, per cent of the brightest column; of a centre of mass, per cent of its rms.
    pub all_rms_percent: f64,
    /// Rms error over all pixels, per cent of the mean image; of a centre of mass, per cent of its rms.
    pub mean_rms_percent: f64,
    /// Greatest error, per cent of the brightest column.
    pub worst_percent: f64,
    /// Statistics by kind of column.
    pub kinds: Vec<KindAudit>,
    /// Power of the audited images over the power of the exact ones, in bands of spatial frequency (1/Angstrom).
    pub power: Vec<PowerBand>,
    /// The result for each region.
    pub regions: Vec<RegionAudit>,
    /// The audits of the other detectors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub others: Vec<Audit>,
}

impl Audit {
    /// The audits of all detectors, the main one first.
    pub fn all(&self) -> impl Iterator<Item = &Audit> {
        std::iter::once(self).chain(&self.others)
    }

    /// The error that `--max-error` limits, in per cent: the larger of the rms errors at bright columns and over all pixels.
    #[must_use]
    pub fn error_percent(&self) -> f64 {
        self.bright_rms_percent.max(self.all_rms_percent)
    }
}

/// Audits a prepared imager: compares its images of some regions with multislice on the full grid, on the atoms of these images.
///
/// # Errors
/// [`crate::Error::Invalid`] for regions outside the field, errors of the engine, [`crate::Error::Interrupted`].
pub fn audit(
    recipe: &Recipe,
    specimen: &dyn Specimen,
    imager: &dyn RegionImager,
    options: &AuditOptions,
    progress: &dyn Progress,
) -> Result<Audit> {
    let all = recipe.phonons.configurations.max(1);
    let configurations = options.configurations.unwrap_or(all).clamp(1, all);
    let reference = reference(recipe, specimen);
    let pixel = recipe.field.pixel_angstrom();
    let stride = stride(options, pixel);
    let step_angstrom = pixel * stride as f64;
    let places = places(recipe, specimen, options, stride)?;
    let layers = SurfaceLayers::of(recipe, specimen.facts().thickness_nm);
    let thickness = layers.map_or(specimen.facts().thickness_nm, |layers| layers.thickness_nm());
    let points =
        |p: &AuditPlace| p.pixels.sampled_shape().iter().product::<usize>() * configurations;
    progress.start("auditing", "probe", places.iter().map(points).sum::<usize>() as u64);
    let mut pairs = Vec::new();
    for AuditPlace { pixels, .. } in &places {
        let ours = imager.means_of(pixels, configurations, &InterruptOnly(progress))?;
        let point = |pixels: &PixelRect| {
            let margin = reference.margin_angstrom();
            let pixel_box = PixelBox::new(pixels, recipe.field.pixel_nm(), margin, thickness);
            let atoms = |configuration| imager.atoms(&pixel_box.area, configuration);
            reference.means(&pixel_box, configurations, atoms, progress)
        };
        let exact = match recipe.optics.source() {
            Some(source) => blurred((source, pixel), pixels, point)?,
            None => point(pixels)?,
        };
        pairs.push(ours.into_iter().zip(exact).collect::<Vec<AuditImages>>());
    }
    progress.finish();
    let shown = shown_images(&recipe.detector.measured());
    let of_detector = |shown: &ShownImage, name: Option<String>| {
        let pairs: Vec<AuditImages> = pairs.iter().map(|pairs| shown_pair(shown, pairs)).collect();
        let found = match shown.axis {
            None => compared(recipe, specimen, (&places, &pairs), step_angstrom),
            Some(_) => compared_deflections((&places, &pairs), step_angstrom),
        };
        let found = summary(imager, [configurations, all], found, step_angstrom);
        let mean_rms_percent =
            if shown.axis.is_some() { found.all_rms_percent } else { found.mean_rms_percent };
        Audit { detector: name, mean_rms_percent, ..found }
    };
    let name = |s: &ShownImage| Some(s.detector.name.clone()).filter(|_| shown.len() > 1);
    let made = shown.iter().filter(|s| s.number < imager.facts().detectors);
    let others = made.skip(1).map(|s| of_detector(s, name(s))).collect();
    Ok(Audit { others, ..of_detector(&shown[0], name(&shown[0])) })
}

/// The images that users see, from the measured ones.
fn shown_pair(shown: &ShownImage, pairs: &[AuditImages]) -> AuditImages {
    let Some(parts) = shown.parts() else { return pairs[shown.number].clone() };
    let mean = |of: fn(&AuditImages) -> &Array2<f64>| {
        let [mean, _] = shown.angles(parts.map(|number| of(&pairs[number]).view()));
        mean.mapv(f64::from)
    };
    (mean(|pair| &pair.0), mean(|pair| &pair.1))
}

/// The audited image of a region, and the exact one.
type AuditImages = (Array2<f64>, Array2<f64>);

/// The differences in each region, and its columns.
type ComparedRegions = (Vec<RegionAudit>, Vec<Vec<ColumnPoint>>);

/// Compares the images of all regions on one detector.
fn compared(
    recipe: &Recipe,
    specimen: &dyn Specimen,
    (places, pairs): (&[AuditPlace], &[AuditImages]),
    step_angstrom: f64,
) -> ComparedRegions {
    let points = |(place, (ours, exact)): (&AuditPlace, &AuditImages)| {
        column_points(recipe, specimen, &place.pixels, [ours, exact])
    };
    let columns: Vec<Vec<ColumnPoint>> = places.iter().zip(pairs).map(points).collect();
    let top = columns.iter().flatten().map(|c: &ColumnPoint| c.exact).fold(1e-12, f64::max);
    let region = |((place, pair), columns): ((&AuditPlace, &AuditImages), &Vec<ColumnPoint>)| {
        compare(place.centre_nm, pair.clone(), columns, step_angstrom, top)
    };
    let regions = places.iter().zip(pairs).zip(&columns).map(region).collect();
    (regions, columns)
}

/// Compares the images of a centre of mass: errors are in per cent of its rms over all regions.
fn compared_deflections(
    (places, pairs): (&[AuditPlace], &[AuditImages]),
    step_angstrom: f64,
) -> ComparedRegions {
    let exact = pairs.iter().flat_map(|(_, exact)| exact.iter().copied());
    let top = rms(exact).max(1e-12);
    let region = |(place, pair): (&AuditPlace, &AuditImages)| {
        let found = compare(place.centre_nm, pair.clone(), &[], step_angstrom, top);
        let mean = (&pair.0 - &pair.1).mean().unwrap_or(0.0);
        RegionAudit { mean_percent: 100.0 * mean / top, ..found }
    };
    (places.iter().zip(pairs).map(region).collect(), Vec::new())
}

/// The exact engine: multislice on the full grid.
fn reference(recipe: &Recipe, specimen: &dyn Specimen) -> Simulator {
    let layers = SurfaceLayers::of(recipe, specimen.facts().thickness_nm);
    let before = layers.map_or(0.0, |layers| layers.before_angstrom());
    let mut reference = Simulator::new(recipe, Algorithm::Multislice)
        .with_large_probe_box()
        .with_focus_deeper(before);
    if recipe.optics.source().is_some() {
        // With a source, all pixels are needed, not every `stride`-th one. Probes at the Nyquist distance are enough for them.
        reference = reference.with_probe_step(ProbeStep::Angstrom(NYQUIST_SHARE * nyquist(recipe)));
    }
    match specimen.facts().film {
        Some(_) => reference.with_slices(Slicing::Grouped(PARTICLE_SPAN_ANGSTROM)),
        None => reference,
    }
}

/// The Nyquist distance of the image in Angstrom.
fn nyquist(recipe: &Recipe) -> f64 {
    0.5 / image_band_limit(&recipe.optics.optics())
}

fn stride(options: &AuditOptions, pixel_angstrom: f64) -> usize {
    options.stride.unwrap_or((POINT_ANGSTROM / pixel_angstrom).round().max(1.0) as usize)
}

/// Advice for an audit that needs too much memory.
pub(crate) const AUDIT_REMEDY: &str = "the exact simulation that the audit compares with needs most of the memory; use fewer threads, smaller \
    regions, or no audit";

/// The cost of the exact simulations of an audit.
///
/// # Errors
/// Errors of [`crate::engine::Plan::new`].
pub(crate) fn audit_cost(
    recipe: &CheckedRecipe,
    specimen: &dyn Specimen,
    options: &AuditOptions,
) -> Result<SimulationRuns> {
    let all = recipe.phonons.configurations.max(1);
    let configurations = options.configurations.unwrap_or(all).clamp(1, all);
    let reference = reference(recipe, specimen).with_configurations(configurations);
    let edge = (options.size_nm / recipe.field.pixel_nm()).round().max(1.0) as usize;
    let pixel = recipe.field.pixel_angstrom();
    let probes = match recipe.optics.source() {
        None => edge.div_ceil(stride(options, pixel)).pow(2),
        Some(source) => {
            let margin = margin_px(source, pixel)?;
            let width = pixel * (edge + 2 * margin) as f64;
            (width / (NYQUIST_SHARE * nyquist(recipe))).ceil().powi(2) as usize
        }
    };
    let regions = if options.at_nm.is_empty() { options.regions } else { options.at_nm.len() };
    Ok(rectangle_plan(recipe, specimen, &reference, [edge; 2], regions)?.0.for_probes(probes))
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (n, sum) = values.fold((0.0, 0.0), |(n, sum), v| (n + 1.0, sum + v * v));
    if n > 0.0 { f64::sqrt(sum / n) } else { 0.0 }
}

fn compare(
    centre_nm: [f64; 2],
    (ours, exact): (Array2<f64>, Array2<f64>),
    columns: &[ColumnPoint],
    pixel: f64,
    top: f64,
) -> RegionAudit {
    let bright: Vec<&ColumnPoint> = columns.iter().filter(|c| c.exact > BRIGHT * top).collect();
    let relative = |c: &&ColumnPoint| c.ours / c.exact - 1.0;
    let difference = &ours - &exact;
    let off = difference.indexed_iter().filter(|((i, j), _)| {
        let far = |c: &&ColumnPoint| {
            (c.at[0] - *j as f64 * pixel).hypot(c.at[1] - *i as f64 * pixel) > 1.0
        };
        bright.iter().all(far)
    });
    RegionAudit {
        centre_nm,
        bright_columns: bright.len(),
        bright_rms_percent: 100.0 * rms(bright.iter().map(relative)),
        bright_mean_percent: 100.0 * bright.iter().map(relative).sum::<f64>()
            / bright.len().max(1) as f64,
        mean_percent: 100.0 * (ours.sum() / exact.sum() - 1.0),
        off_columns_rms_percent: 100.0 * rms(off.map(|(_, d)| d / top)),
        all_rms_percent: 100.0 * rms(difference.iter().map(|d| d / top)),
        worst_percent: 100.0 * difference.iter().fold(0.0, |w: f64, d| w.max(d.abs())) / top,
        ours,
        exact,
    }
}

fn mean_rms_percent(images: &[[&Array2<f64>; 2]]) -> f64 {
    let pixels = || images.iter().flat_map(|[ours, exact]| ours.iter().zip(*exact));
    let mean = pixels().map(|(_, e)| e).sum::<f64>() / pixels().count().max(1) as f64;
    if mean > 0.0 { 100.0 * rms(pixels().map(|(o, e)| o - e)) / mean } else { 0.0 }
}

fn summary(
    imager: &dyn RegionImager,
    configurations: [usize; 2],
    (regions, columns): ComparedRegions,
    step_angstrom: f64,
) -> Audit {
    let weighted = |of: &dyn Fn(&RegionAudit) -> (f64, f64)| {
        let (sum, n) = regions.iter().map(of).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        if n > 0.0 { (sum / n).sqrt() } else { 0.0 }
    };
    let mut kinds: BTreeMap<&str, Vec<(usize, &ColumnPoint)>> = BTreeMap::new();
    for (region, points) in columns.iter().enumerate() {
        for point in points {
            kinds.entry(&point.kind).or_default().push((region, point));
        }
    }
    let images: Vec<[&Array2<f64>; 2]> = regions.iter().map(|r| [&r.ours, &r.exact]).collect();
    Audit {
        detector: None,
        engine: imager.facts().name.into(),
        window_angstrom: imager.facts().window_angstrom,
        reference: "multislice".into(),
        configurations,
        bright_rms_percent: weighted(&|r| {
            let n = r.bright_columns as f64;
            (n * r.bright_rms_percent.powi(2), n)
        }),
        all_rms_percent: weighted(&|r| {
            let n = r.ours.len() as f64;
            (n * r.all_rms_percent.powi(2), n)
        }),
        mean_rms_percent: mean_rms_percent(&images),
        worst_percent: regions.iter().map(|r| r.worst_percent).fold(0.0, f64::max),
        kinds: kinds.iter().map(|(kind, points)| kind_audit(kind, points)).collect(),
        power: power(&images, step_angstrom),
        regions,
        others: Vec::new(),
    }
}
