//! Relaxes atoms to the nearest minimum of energy (FIRE), and moves them by molecular dynamics at a temperature.

use rayon::prelude::*;

use super::Vec3;
use super::network::{Neighbours, Network};
use super::tersoff::{CUTOFF, half_bonds};
use crate::rng::{Purpose, normal3};
use crate::structure::lattice::{dot, norm, subtract};

/// Reach of the neighbour lists beyond the cutoff, in Angstrom.
const SKIN: f64 = 0.8;
/// 1 eV/(A u) in A/fs^2.
const ACCELERATION: f64 = 9.648_533e-3;
/// Mass of carbon in u.
const MASS_U: f64 = 12.011;
/// Boltzmann's constant in eV/K.
const BOLTZMANN: f64 = 8.617_333e-5;
/// Number of parts whose forces are summed separately; it is fixed, so that the sum does not depend on the threads.
const PARTS: usize = 4;

/// Roles of the atoms of a network: the first `mobile` ones move, and the half bonds of the first `active` ones count; the other atoms only
/// affect the bond orders of these.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Roles {
    /// Number of atoms that move.
    pub mobile: usize,
    /// Number of atoms, the mobile ones included, whose bonds depend on the positions of the mobile ones.
    pub active: usize,
}

/// A network during relaxation or dynamics.
struct Mover<'a> {
    network: &'a mut Network,
    roles: Roles,
    near: Neighbours,
    /// Positions for which the lists in `near` were made.
    listed: Vec<Vec3>,
    forces: Vec<Vec3>,
    buffers: Vec<Vec<Vec3>>,
}

impl<'a> Mover<'a> {
    fn new(network: &'a mut Network, roles: Roles) -> Self {
        network.wrap();
        let near = Neighbours::new(network, CUTOFF + SKIN);
        let listed = network.positions.clone();
        let forces = vec![[0.0; 3]; listed.len()];
        let parts = if roles.active > 10_000 { PARTS } else { 1 };
        Mover { network, roles, near, buffers: vec![forces.clone(); parts], listed, forces }
    }

    fn update(&mut self) {
        let limit = 0.25 * SKIN * SKIN;
        let far = |(p, q): (&Vec3, &Vec3)| {
            let d = subtract(*p, *q);
            dot(d, d) > limit
        };
        let mobile = self.roles.mobile;
        if self.network.positions[..mobile].iter().zip(&self.listed).any(far) {
            self.network.wrap();
            self.near = Neighbours::new(self.network, CUTOFF + SKIN);
            self.listed.clone_from(&self.network.positions);
        }
        let share = self.roles.active.div_ceil(self.buffers.len());
        let (network, near, active) = (&*self.network, &self.near, self.roles.active);
        let part = |(n, forces): (usize, &mut Vec<Vec3>)| {
            forces.fill([0.0; 3]);
            for i in n * share..((n + 1) * share).min(active) {
                half_bonds(network, near, i, forces);
            }
        };
        match self.buffers.len() {
            1 => self.buffers.iter_mut().enumerate().for_each(part),
            _ => self.buffers.par_iter_mut().enumerate().for_each(part),
        }
        for (i, force) in self.forces[..mobile].iter_mut().enumerate() {
            *force = [0.0; 3];
            for buffer in &self.buffers {
                (0..3).for_each(|k| force[k] += buffer[i][k]);
            }
        }
    }
}

/// Moves atoms downhill by at most `steps` steps, until no force exceeds `tolerance` eV/A. Returns the greatest remaining force.
///
/// FIRE: E. Bitzek et al., Phys. Rev. Lett. 97, 170201 (2006).
pub(crate) fn relax(network: &mut Network, roles: Roles, steps: usize, tolerance: f64) -> f64 {
    const LONGEST_STEP: f64 = 0.15;
    let mut mover = Mover::new(network, roles);
    let mut velocities = vec![[0.0; 3]; roles.mobile];
    let (mut step, mut mixing, mut downhill) = (0.1, 0.1, 0);
    let mut greatest = f64::INFINITY;
    for _ in 0..steps {
        mover.update();
        let forces = &mover.forces[..roles.mobile];
        greatest = forces.iter().map(|f| norm(*f)).fold(0.0, f64::max);
        if greatest < tolerance {
            break;
        }
        let sum = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| dot(*a, *b)).sum::<f64>();
        if sum(forces, &velocities) > 0.0 {
            downhill += 1;
            let ratio = (sum(&velocities, &velocities) / sum(forces, forces)).sqrt();
            for (v, f) in velocities.iter_mut().zip(forces) {
                (0..3).for_each(|k| v[k] += mixing * (ratio * f[k] - v[k]));
            }
            if downhill > 5 {
                step = f64::min(step * 1.1, 0.4);
                mixing *= 0.99;
            }
        } else {
            velocities.fill([0.0; 3]);
            (step, mixing, downhill) = (0.5 * step, 0.1, 0);
        }
        for i in 0..roles.mobile {
            (0..3).for_each(|k| velocities[i][k] += step * forces[i][k]);
            let length = step * norm(velocities[i]);
            let scale = step * (LONGEST_STEP / length.max(LONGEST_STEP));
            (0..3).for_each(|k| mover.network.positions[i][k] += scale * velocities[i][k]);
        }
    }
    greatest
}

/// Runs molecular dynamics under a thermostat that follows `temperature(step)` in K, with the time step `femtoseconds`. Velocities start
/// from random numbers of `seed`; `velocities` passes them to the next call.
pub(crate) fn heat(
    network: &mut Network,
    roles: Roles,
    velocities: &mut Vec<Vec3>,
    seed: u64,
    femtoseconds: f64,
    steps: std::ops::Range<usize>,
    temperature: impl Fn(usize) -> f64,
) {
    /// Time constant of the thermostat in steps.
    const THERMOSTAT: f64 = 40.0;
    /// Largest distance that an atom moves in one step, in Angstrom.
    const LONGEST_STEP: f64 = 0.1;
    let count = roles.mobile;
    if velocities.is_empty() {
        let speed = (BOLTZMANN * temperature(steps.start) / MASS_U * ACCELERATION).sqrt();
        let velocity = |i| normal3(seed, Purpose::Carbon, 1, i as u64).map(|n| n * speed);
        *velocities = (0..count).map(velocity).collect();
    }
    let mut mover = Mover::new(network, roles);
    mover.update();
    let kick = 0.5 * femtoseconds * ACCELERATION / MASS_U;
    for n in steps {
        for i in 0..count {
            (0..3).for_each(|k| velocities[i][k] += kick * mover.forces[i][k]);
            let length = femtoseconds * norm(velocities[i]);
            let scale = (LONGEST_STEP / length).min(1.0);
            for k in 0..3 {
                velocities[i][k] *= scale;
                mover.network.positions[i][k] += femtoseconds * velocities[i][k];
            }
        }
        mover.update();
        for i in 0..count {
            (0..3).for_each(|k| velocities[i][k] += kick * mover.forces[i][k]);
        }
        let square = velocities.iter().map(|v| dot(*v, *v)).sum::<f64>();
        let now = square * MASS_U / ACCELERATION / (3.0 * count as f64 * BOLTZMANN);
        let scale = (1.0 + (temperature(n) / now - 1.0) / THERMOSTAT).max(0.25).sqrt();
        velocities.iter_mut().for_each(|v| (0..3).for_each(|k| v[k] *= scale));
    }
}
