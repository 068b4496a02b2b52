//! The cost of patterns in addition to the waves, estimated without making any.

use super::super::grid::Grid;
use super::super::plan::Plan;
use super::super::probe_patches::waves_of_patch;
use super::super::probe_scan::Scan;
use super::ring_sums::RingSums;
use super::run::{PROBES_TOGETHER, PatternReach, patches};
use super::{Band, HELD_BYTES, PatternSettings, bands, held};
use crate::detect::{PatternDetector, PixelatedDetector};
use num_complex::Complex32;

/// The cost of reading the patterns of a scan from its waves.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub(crate) struct PatternCost {
    /// Operations of all phonon configurations and thicknesses.
    pub flops: f64,
    /// Bytes of the patterns that are in memory at a time.
    held_bytes: u64,
    thread_bytes: u64,
}

impl PatternCost {
    /// The cost of all patterns of a scan.
    pub(crate) fn new(plan: &Plan, scan: &Scan, settings: &PatternSettings) -> Self {
        let Grid { points: [nx, ny], .. } = plan.wave_grid;
        let reach = PatternReach::new(plan, &settings.detector, nx);
        let patches = patches(plan, scan);
        let waves = patches.error.map_or(1, |_| waves_of_patch(plan));
        let own = reach.outer.as_ref().map_or(0, |_| nx * ny);
        let ([x, y], n) = (reach.padded.samples(), settings.detector.values());
        let reading = match &settings.detector {
            PatternDetector::Pixels(PixelatedDetector { pixels, .. }) => {
                2 * pixels * (x * y + pixels * y)
            }
            PatternDetector::Rings(bins) => {
                reach.ring_sums(plan, bins).iter().map(RingSums::flops).sum()
            }
        };
        let each = 8 * waves * (x * y + own) + reading;
        let records = plan.record_after.len();
        let runs = f64::from(plan.settings.configurations()) * (records * scan.len()) as f64;
        let values = (waves + PROBES_TOGETHER) * (x * y + own) + 8 * x * y;
        let bytes = |band: &Band| held(&band.rows, band.rows.end, scan.shape[1], records * n);
        let bands = bands(&patches.patches, scan, (records * n, HELD_BYTES));
        PatternCost {
            flops: runs * each as f64,
            // The patterns are stored once as sums, and once in the order of the scan.
            held_bytes: 2 * bands.iter().map(bytes).max().unwrap_or(0) as u64,
            thread_bytes: (values * size_of::<Complex32>()) as u64,
        }
    }

    /// Memory in bytes of the largest arrays on `threads` threads.
    pub(crate) fn memory_bytes(&self, threads: usize) -> u64 {
        self.held_bytes + self.thread_bytes * threads as u64
    }
}
