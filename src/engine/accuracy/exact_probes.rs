//! What the exact engine makes of single probes of a scan: in the whole cell, or, where the cell is wide, in a piece cut out
//! around them.

use super::super::cost::Cost;
use super::super::elements;
use super::super::plan::Plan;
use super::super::probe_scan::Scan;
use super::super::probe_width::{geometric_radius, relative_size};
use super::super::settings::{Algorithm, ProbeStep, Settings};
use super::super::simulate::Simulation;
use super::probe_sample::DrawnCluster;
use crate::error::Result;
use crate::progress::Progress;
use crate::structure::Site;

/// Width of the piece in Angstrom for a thin specimen in focus, at 200 kV and 21 mrad. GaAs \[110\] of 104 A in a cell 28 A wide
/// differs by 0.04 % rms from one of 45 A.
const PIECE_ANGSTROM: f64 = 26.0;
/// It grows by this share of semiangle times thickness.
const SPREAD: f64 = 2.0;
/// A cell is cut if it is wider than the piece by this factor: cutting has a price.
const WORTH: f64 = 1.3;

/// The plan of the exact engine for the whole cell, and that for single probes.
pub struct ExactEngine {
    /// For the whole cell.
    pub plan: Plan,
    piece: Plan,
    cell_angstrom: [f64; 3],
}

impl ExactEngine {
    /// Multislice with these settings otherwise, for atoms at these heights.
    ///
    /// # Errors
    /// Those of [`Plan::new`].
    pub fn new(settings: &Settings, cell_angstrom: [f64; 3], heights: &[f64]) -> Result<Self> {
        let settings = Settings { algorithm: Algorithm::Multislice, ..settings.clone() };
        let plan = Plan::new(&settings, cell_angstrom, heights)?;
        let width = PIECE_ANGSTROM * relative_size(&settings).max(1.0)
            + 2.0 * geometric_radius(&settings)
            + SPREAD * 1e-3 * settings.optics.semiangle_mrad * cell_angstrom[2];
        let [x, y, z] = cell_angstrom;
        let cut = |l: f64| if l > WORTH * width { width } else { l };
        let each = Settings { probe_step: ProbeStep::Scan, ..settings };
        let piece = Plan::new(&each, [cut(x), cut(y), z], heights)?;
        Ok(ExactEngine { plan, piece, cell_angstrom })
    }

    /// Nominal operations of one probe of a sample in one phonon configuration.
    pub fn probe_flops(&self, scan: &Scan) -> f64 {
        let cost = Cost::new(&self.piece, scan);
        cost.nominal_flops() / (scan.len() as f64 * f64::from(self.piece.settings.configurations()))
    }

    /// Intensities of the probes of some clusters in one phonon configuration of some atoms: for each, (probe, thickness, detector).
    ///
    /// # Errors
    /// Those of the engine.
    pub fn intensities(
        &self,
        sites: &[Site],
        scan: &Scan,
        clusters: &[DrawnCluster],
        configuration: u32,
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<f64>>> {
        let mut simulation = Simulation::new(&self.piece, &elements(sites))?;
        if self.piece.transmission_grid == self.plan.transmission_grid {
            let indices: Vec<usize> = clusters.iter().flat_map(|c| c.indices.clone()).collect();
            let all = simulation.some_probes(sites, scan, &indices, configuration, progress)?;
            return Ok(by_cluster(&all, clusters));
        }
        let mut out = Vec::with_capacity(clusters.len());
        for cluster in clusters {
            let (sites, scan) = self.cut_out(sites, scan, cluster);
            out.push(simulation.some_probes(
                &sites,
                &scan,
                &cluster.indices,
                configuration,
                progress,
            )?);
        }
        Ok(out)
    }

    /// The atoms of the piece around a cluster, and the scan as it lies in the piece.
    fn cut_out(&self, sites: &[Site], scan: &Scan, cluster: &DrawnCluster) -> (Vec<Site>, Scan) {
        let piece = self.piece.transmission_grid.extent_angstrom;
        let n = cluster.indices.len() as f64;
        let middle =
            [0, 1].map(|k| cluster.indices.iter().map(|&i| scan.position(i)[k]).sum::<f64>() / n);
        let corner = [0, 1].map(|k| middle[k] - 0.5 * piece[k]);
        let inside = |site: &Site| {
            let mut site = *site;
            for k in 0..2 {
                site.position[k] = (site.position[k] - corner[k]).rem_euclid(self.cell_angstrom[k]);
                if site.position[k] >= piece[k] {
                    return None;
                }
            }
            Some(site)
        };
        let origin_angstrom = [0, 1].map(|k| scan.origin_angstrom[k] - corner[k]);
        (sites.iter().filter_map(inside).collect(), Scan { origin_angstrom, ..*scan })
    }
}

/// Values of the probes of all clusters, cluster by cluster.
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
