//! The exact engine for an infinite specimen: multislice over the whole cell, with the probe of a large box. In a wide cell it uses windows
//! wide enough to give equal images. In a narrow cell, which would crop too much off a probe, the probe is made in the cell, as in periodic
//! codes. Where atoms form no planes, slices of the whole cell are thin.

use super::super::cost::Cost;
use super::super::elements;
use super::super::plan::Plan;
use super::super::probe_scan::Scan;
use super::super::probe_width::{geometric_radius, relative_size};
use super::super::settings::{Algorithm, Expansion, ProbeBox, ProbeStep, Settings};
use super::super::simulate::Simulation;
use super::probe_sample::DrawnCluster;
use crate::error::Result;
use crate::potential::slices::Slicing;
use crate::progress::Progress;
use crate::resample::image_band_limit;
use crate::structure::Site;

/// Width of the windows in Angstrom for a thin specimen in focus, at 200 kV and 21 mrad. GaAs \[110\] of 104 A in a cell 28 A wide
/// differs by 0.04 % rms from one of 45 A.
const WIDE_ANGSTROM: f64 = 26.0;
/// The width grows by this share of semiangle times thickness.
const SPREAD: f64 = 2.0;
/// Windows are used in a cell that is wider than the windows by this factor, since they cost extra work.
const WORTH: f64 = 1.3;
/// A cell narrower than this, at 200 kV and 21 mrad, is narrow: more than 2.6 % of a probe lie outside, and the correction for the outside
/// works for large angles only.
const NARROW_ANGSTROM: f64 = 15.0;
/// Step times band limit of the probes from which a scan is interpolated. The interpolation's error is then 0.01 % of the image's contrast,
/// and 0.03 % at its edges ([`crate::resample::Kernel`]).
const PROBE_STEP: f64 = 0.42;

/// The plans of the exact engine for a scan and for single probes.
pub(crate) struct ExactEngine {
    /// Plan for a scan. The scan is interpolated where this needs fewer probes, unless the settings give the probes' distance.
    pub plan: Plan,
    /// Plan that propagates every probe.
    pub each: Plan,
}

impl ExactEngine {
    /// Plans the exact engine with otherwise equal settings, for atoms at these heights.
    ///
    /// # Errors
    /// Errors of [`Plan::new`].
    pub(crate) fn new(
        settings: &Settings,
        cell_angstrom: [f64; 3],
        heights: &[f64],
    ) -> Result<Self> {
        let [x, y, thickness] = cell_angstrom;
        let width = WIDE_ANGSTROM * relative_size(settings).max(1.0)
            + 2.0 * geometric_radius(settings)
            + SPREAD * 1e-3 * settings.optics.semiangle_mrad * thickness;
        let narrow = x.min(y) < NARROW_ANGSTROM * relative_size(settings).max(1.0);
        let natural = if narrow { ProbeBox::Cell } else { ProbeBox::Large };
        let probe_box = settings.probe_box.unwrap_or(natural);
        let wide = x.min(y) > WORTH * width && probe_box == ProbeBox::Large;
        let algorithm = match wide {
            true => Algorithm::Window { width_angstrom: width },
            false => Algorithm::Multislice,
        };
        let whole = Settings {
            algorithm,
            slicing: match wide {
                true => settings.slicing,
                false => settings.slicing.exact(thickness, heights),
            },
            probe_box: Some(probe_box),
            probe_step: match settings.probe_step {
                ProbeStep::Auto => interpolated_step(settings),
                given => given,
            },
            ..settings.clone()
        };
        let each =
            Settings { probe_step: ProbeStep::Scan, expansion: Expansion::Off, ..whole.clone() };
        let plan = |settings| Plan::new(settings, cell_angstrom, heights);
        Ok(ExactEngine { plan: plan(&whole)?, each: plan(&each)? })
    }

    /// Name of the engine for messages.
    pub(crate) fn name(&self) -> String {
        let settings = &self.plan.settings;
        let name = match (settings.algorithm, settings.probe_box) {
            (Algorithm::Window { width_angstrom }, _) => {
                format!("multislice in {width_angstrom:.0} A about each probe")
            }
            (_, Some(ProbeBox::Large)) => "multislice with the probe of a large box".to_owned(),
            _ => "multislice".to_owned(),
        };
        match settings.slicing {
            Slicing::Grouped(span) => format!("{name}, in slices of {span} A"),
            _ => name,
        }
    }

    /// Nominal operations of this number of probes in one phonon configuration, including the potentials.
    pub(crate) fn flops(&self, scan: &Scan, probes: usize) -> f64 {
        let cost = Cost::new(&self.each, scan).for_probes(probes);
        cost.nominal_flops() / f64::from(self.each.settings.configurations())
    }

    /// Intensities of some probes of a scan in each of some phonon configurations: (configuration, cluster, probe, thickness, detector).
    ///
    /// # Errors
    /// Errors of [`simulate()`](super::super::simulate()).
    pub(crate) fn intensities(
        &self,
        sites: &[Site],
        scan: &Scan,
        clusters: &[DrawnCluster],
        configurations: &[u32],
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<Vec<f64>>>> {
        let mut simulation = Simulation::new(&self.each, &elements(sites))?;
        let indices: Vec<usize> = clusters.iter().flat_map(|c| c.indices.clone()).collect();
        let in_one = |configuration: &u32| {
            let all = simulation.some_probes(sites, scan, &indices, *configuration, progress)?;
            Ok(by_cluster(&all, clusters))
        };
        configurations.iter().map(in_one).collect()
    }
}

/// Distance of the probes from which a scan is interpolated.
pub fn interpolated_step(settings: &Settings) -> ProbeStep {
    ProbeStep::Angstrom(PROBE_STEP / image_band_limit(&settings.optics))
}

/// Splits the probes' values by cluster.
pub fn by_cluster(values: &[f64], clusters: &[DrawnCluster]) -> Vec<Vec<f64>> {
    let probes: usize = clusters.iter().map(|c| c.indices.len()).sum();
    let each = values.len() / probes.max(1);
    let mut rest = values;
    let part = |c: &DrawnCluster| {
        let (part, others) = rest.split_at(each * c.indices.len());
        rest = others;
        part.to_vec()
    };
    clusters.iter().map(part).collect()
}
