//! Diffraction patterns of every probe of a scan (4D-STEM), from the exit waves of multislice, on the full grid or in windows.
//!
//! Patterns are made for some rows of the scan at a time and passed on, so that memory does not grow with the scan. Windows are padded, and
//! the part of the probe that they cut off is added coherently (see `engine::coherent_tail`).

mod pattern_cost;
mod pixel_matrices;
mod ring_sums;
mod run;

use super::plan::Plan;
use super::probe_patches::Patch;
use super::probe_scan::Scan;
use super::settings::Algorithm;
use super::simulate::elements;
use super::stepper::TransmissionView;
use super::transmission::TransmissionBuilder;
use super::workspace_pool::WorkspacePool;
use crate::detect::PatternDetector;
use crate::error::{Error, Result};
use crate::files::Shard;
use crate::progress::Progress;
use crate::setting::Setting;
use crate::structure::Site;
use ndarray::{Array5, ArrayView5};
pub(crate) use pattern_cost::PatternCost;
use rayon::prelude::*;
use run::{GroupPath, PatternReader};
use std::ops::Range;

/// Approximate size in bytes of the patterns that are in memory at a time. One row of windows may need more.
const HELD_BYTES: usize = 256 << 20;

/// How patterns are read from exit waves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatternSettings {
    /// The detector.
    pub detector: PatternDetector,
    /// Adds the part of the probe that a window cuts off, propagated through the mean potential (windows only). Without it the bright field
    /// of windows of 11.7 A is 1 % too dark, and its pattern off by 2 % (SrTiO3, 39 A).
    pub coherent_tail: bool,
}

/// Patterns of neighbouring rows of a scan.
#[derive(Debug)]
pub struct PatternRows<'a> {
    /// The first row of the scan.
    pub first_row: usize,
    /// Fractions of the beam for each pixel: (thickness, row, column, ky, kx); for rings: (thickness, row, column, 1, ring).
    pub data: ArrayView5<'a, f32>,
}

/// Simulates the pattern of every probe of a scan, averaged over phonon configurations and frames, and passes them to `take` by rows, from
/// the first to the last. The bytes do not depend on the number of threads.
///
/// # Errors
/// Errors of [`simulate()`](super::simulate()); [`Error::Invalid`] for PRISM, and for a detector beyond the angles of the plan; errors of
/// `take`.
pub fn simulate_patterns(
    plan: &Plan,
    frames: &[&[Site]],
    scan: &Scan,
    settings: PatternSettings,
    take: &mut dyn FnMut(PatternRows<'_>) -> Result<()>,
    progress: &dyn Progress,
) -> Result<()> {
    let all = 0..scan.shape[0];
    simulate_pattern_rows(plan, frames, (scan, all), settings, take, progress)
}

/// The rows of a scan whose patterns one of several processes simulates: neighbouring rows, such that no patch of probes is divided. All
/// parts together are the scan; with many processes some are empty.
pub fn pattern_rows(plan: &Plan, scan: &Scan, shard: Shard) -> Range<usize> {
    let groups = run::patches(plan, scan).patches;
    let rows = scan.shape[0];
    let mut starts: Vec<usize> =
        bands(&groups, scan, (1, 0)).iter().map(|b| b.rows.start).collect();
    starts.push(rows);
    let bound = |k: usize| {
        let from = (k * rows).div_ceil(shard.count());
        starts.iter().copied().find(|start| *start >= from).unwrap_or(rows)
    };
    bound(shard.index())..bound(shard.index() + 1)
}

/// As [`simulate_patterns`], for some rows of the scan: the rows of one part ([`pattern_rows`]) or of several neighbouring parts. The values
/// do not depend on the division.
///
/// # Errors
/// As [`simulate_patterns`].
pub fn simulate_pattern_rows(
    plan: &Plan,
    frames: &[&[Site]],
    (scan, rows): (&Scan, Range<usize>),
    settings: PatternSettings,
    take: &mut dyn FnMut(PatternRows<'_>) -> Result<()>,
    progress: &dyn Progress,
) -> Result<()> {
    check(plan, &settings)?;
    let all: Vec<Site> = frames.iter().flat_map(|sites| sites.iter().copied()).collect();
    let builder = TransmissionBuilder::new(plan, &elements(&all))?;
    let mut reader = PatternReader::new(plan, settings);
    let (mut groups, shared) = reader.groups(scan);
    groups.retain(|group| rows.contains(&first_row(group, scan)));
    let each = plan.record_after.len() * settings.detector.values();
    let configurations = plan.settings.configurations();
    let runs = configurations as usize * frames.len();
    let probes: usize = groups.iter().map(|group| group.probes.len()).sum();
    progress.start("simulating", "patterns", (probes * runs) as u64);
    let workspaces = WorkspacePool::new();
    for band in bands(&groups, scan, (each, HELD_BYTES)) {
        let groups = &groups[band.groups.clone()];
        let mut sums: Vec<Vec<f32>> =
            groups.iter().map(|group| vec![0.0; group.probes.len() * each]).collect();
        for sites in frames {
            for configuration in 0..configurations {
                let transmission = builder.build(sites, configuration, progress)?;
                let (paths, path_of) = reader.paths(&transmission, groups);
                let reader = &reader;
                let run = |((group, path), sum): ((&Patch, usize), &mut Vec<f32>)| {
                    if progress.interrupted() {
                        return Err(Error::Interrupted);
                    }
                    let view =
                        TransmissionView { transmission: &transmission, origin: group.origin };
                    let at = GroupPath { path: &paths[path], view, group };
                    let add = |w: &mut _| reader.add(w, &at, shared.as_ref(), sum);
                    workspaces.with(|| reader.workspace(), add);
                    progress.advance(group.probes.len() as u64);
                    Ok(())
                };
                let each = groups.par_iter().zip(path_of).zip(sums.par_iter_mut());
                each.map(run).collect::<Result<Vec<()>>>()?;
                builder.reclaim(transmission);
            }
        }
        let data = in_order(&band, groups, &sums, (plan, scan, &settings), runs);
        take(PatternRows { first_row: band.rows.start, data: data.view() })?;
    }
    progress.finish();
    Ok(())
}

/// Refuses plans and detectors without patterns.
fn check(plan: &Plan, settings: &PatternSettings) -> Result<()> {
    if let Some(pixels) = settings.detector.pixels() {
        pixels.check()?;
    }
    if matches!(plan.settings.algorithm, Algorithm::Prism { .. }) {
        let expected = "PRISM cannot simulate patterns; use multislice or windows";
        return Err(Error::invalid(Setting::Algorithm, "prism", expected));
    }
    if plan.has_windows() && !plan.settings.large_probe_box() {
        let expected =
            "windows of patterns need the probe of a large box; use `large`, or multislice";
        return Err(Error::invalid(Setting::ProbeBox, "cell", expected));
    }
    let limit = plan.band_limit_mrad;
    let most = settings.detector.max_angle_mrad();
    if most > limit * (1.0 + 1e-9) {
        let expected = format!(
            "expected at most {limit:.1} mrad, the largest angle of the grid; a finer grid carries larger angles"
        );
        return Err(Error::invalid(Setting::MaxAngleMrad, most, expected));
    }
    Ok(())
}

/// Neighbouring rows of a scan, and the groups of their probes.
struct Band {
    rows: Range<usize>,
    groups: Range<usize>,
}

fn first_row(group: &Patch, scan: &Scan) -> usize {
    group.probes.first().map_or(0, |(i, _)| i / scan.shape[1])
}

/// Divides groups, which are sorted by row, into bands of whole rows whose patterns of `each` values need about `most` bytes.
fn bands(groups: &[Patch], scan: &Scan, (each, most): (usize, usize)) -> Vec<Band> {
    let columns = scan.shape[1];
    let row = |group: &Patch| first_row(group, scan);
    let mut bands: Vec<Band> = Vec::new();
    let mut last_row = usize::MAX;
    for (g, group) in groups.iter().enumerate() {
        let end = 1 + group.probes.iter().map(|(i, _)| i / columns).max().unwrap_or(0);
        let starts =
            row(group) != last_row && bands.last().is_none_or(|b| row(group) >= b.rows.end);
        last_row = row(group);
        match bands.last_mut() {
            Some(band) if !starts => {
                band.rows.end = band.rows.end.max(end);
                band.groups.end = g + 1;
            }
            Some(band) if held(&band.rows, end, columns, each) <= most => {
                band.rows.end = end;
                band.groups.end = g + 1;
            }
            _ => bands.push(Band { rows: row(group)..end, groups: g..g + 1 }),
        }
    }
    bands
}

/// Bytes of the patterns from the first of some rows to `end`.
fn held(rows: &Range<usize>, end: usize, columns: usize, each: usize) -> usize {
    (end - rows.start) * columns * each * size_of::<f32>()
}

/// The means of the patterns of a band, (thickness, row, column, ky, kx), from sums in the order of groups.
fn in_order(
    band: &Band,
    groups: &[Patch],
    sums: &[Vec<f32>],
    (plan, scan, settings): (&Plan, &Scan, &PatternSettings),
    runs: usize,
) -> Array5<f32> {
    let ([ny, nx], values) = (settings.detector.shape(), settings.detector.values());
    let (records, columns) = (plan.record_after.len(), scan.shape[1]);
    let mut data = Array5::zeros((records, band.rows.len(), columns, ny, nx));
    let scale = 1.0 / runs as f32;
    for (group, sums) in groups.iter().zip(sums) {
        for ((i, _), all) in group.probes.iter().zip(sums.chunks_exact(records * values)) {
            let (row, column) = (i / columns - band.rows.start, i % columns);
            for (r, pattern) in all.chunks_exact(values).enumerate() {
                let mut to = data.slice_mut(ndarray::s![r, row, column, .., ..]);
                // Interpolation can fall below 0 next to a sharp edge.
                to.iter_mut().zip(pattern).for_each(|(to, v)| *to = (v * scale).max(0.0));
            }
        }
    }
    data
}
