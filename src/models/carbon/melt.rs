//! Makes a network from the melt: random atoms, heated, quenched and relaxed.
//!
//! Quenching liquid carbon at fixed density is the usual way to a model of amorphous carbon: G. Galli et al., Phys.
//! Rev. Lett. 62, 555 (1989); with Tersoff's potential J. Tersoff, Phys. Rev. Lett. 61, 2879 (1988).

use super::Vec3;
use super::dynamics::{Roles, heat, relax};
use super::network::Network;
use crate::rng::{Purpose, words};

/// Atoms per A^3 of carbon at 1 g/cm3.
pub(crate) const ATOMS_PER_CUBIC_ANGSTROM: f64 = 0.602_214_076 / 12.011;

/// Temperatures in K of the melt and of the annealed solid, and the time step in fs.
const MELT_K: f64 = 6000.0;
const SOLID_K: f64 = 2500.0;
const STEP_FS: f64 = 0.7;

/// A network that is being made.
#[derive(Debug, Clone)]
pub struct Melt {
    /// Present positions of the atoms.
    pub network: Network,
    velocities: Vec<Vec3>,
    seed: u64,
    done: usize,
}

impl Melt {
    /// Places random atoms at a density in g/cm3 in a periodic cube of `edge` Angstrom, and pushes them apart.
    pub fn new(seed: u64, edge: f64, density: f64) -> Self {
        let count = (density * ATOMS_PER_CUBIC_ANGSTROM * edge.powi(3)).round() as u64;
        let position = |i| {
            let w = words(seed, Purpose::Carbon, 2, i);
            [0, 1, 2].map(|k| edge * (f64::from(w[k]) + 0.5) / 4_294_967_296.0)
        };
        let positions: Vec<Vec3> = (0..count).map(position).collect();
        let all = Roles { mobile: positions.len(), active: positions.len() };
        let mut network = Network { positions, period: [edge; 3] };
        relax(&mut network, all, 60, 1.0);
        Melt { network, velocities: Vec::new(), seed, done: 0 }
    }

    /// Continues to step `until` of `steps`: a quarter of the steps melts, half cools exponentially, a quarter anneals.
    pub fn run(&mut self, until: usize, steps: usize) {
        let temperature = |n: usize| {
            let cooled = ((4 * n) as f64 / steps as f64 - 1.0).clamp(0.0, 2.0) / 2.0;
            MELT_K * libm::exp(cooled * libm::log(SOLID_K / MELT_K))
        };
        let range = self.done..until.min(steps);
        let all =
            Roles { mobile: self.network.positions.len(), active: self.network.positions.len() };
        heat(&mut self.network, all, &mut self.velocities, self.seed, STEP_FS, range, temperature);
        self.done = until;
    }

    /// Returns the relaxed network.
    pub fn finish(mut self) -> Network {
        let count = self.network.positions.len();
        relax(&mut self.network, Roles { mobile: count, active: count }, 1000, 0.01);
        self.network.wrap();
        self.network
    }
}
