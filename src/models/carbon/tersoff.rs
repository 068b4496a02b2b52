//! Tersoff's potential for carbon, with forces.
//!
//! J. Tersoff, Phys. Rev. B 39, 5566 (1989), parameters of its table I (B as in the erratum, Phys.
//! Rev. B 41, 3248). The energy is the sum over bonds of `fc(r) [A exp(-lambda r) - b B exp(-mu r)]`, where
//! the bond order b falls with the number of competing neighbours and their angles.

use super::Vec3;
use super::network::{Neighbours, Network};
use crate::structure::lattice::dot;

/// Factor of all lengths of the potential, so that the bonds of graphite have 1.42 A and not 1.46; the energies do not change.
pub const LENGTH_SCALE: f64 = 1.42 / 1.46;

const A_EV: f64 = 1393.6;
const B_EV: f64 = 346.74;
const LAMBDA: f64 = 3.4879 / LENGTH_SCALE;
const MU: f64 = 2.2119 / LENGTH_SCALE;
const BETA: f64 = 1.5724e-7;
const N: f64 = 0.72751;
const C2: f64 = 38049.0 * 38049.0;
const D2: f64 = 4.3484 * 4.3484;
const H: f64 = -0.57058;
/// Start of the cutoff, in Angstrom.
const R: f64 = 1.8 * LENGTH_SCALE;
/// Atoms farther apart than this do not interact, in Angstrom.
pub const CUTOFF: f64 = 2.1 * LENGTH_SCALE;

/// Largest number of neighbours of one atom; at 2.1 A there is no room for so many.
const MOST: usize = 24;

/// A neighbour within the cutoff.
#[derive(Clone, Copy, Default)]
struct Bond {
    to: usize,
    /// Unit vector towards the neighbour.
    u: Vec3,
    r: f64,
    inverse: f64,
    cut: f64,
    cut_slope: f64,
}

/// Returns the cutoff function and its derivative.
fn cutoff(r: f64) -> [f64; 2] {
    if r < R {
        return [1.0, 0.0];
    }
    let scale = std::f64::consts::PI / (CUTOFF - R);
    let phase = scale * (r - R);
    [0.5 + 0.5 * libm::cos(phase), -0.5 * scale * libm::sin(phase)]
}

/// Returns the angular function g and its derivative.
fn angular(cosine: f64) -> [f64; 2] {
    let h = H - cosine;
    let denominator = 1.0 / (D2 + h * h);
    [1.0 + C2 / D2 - C2 * denominator, -2.0 * C2 * h * denominator * denominator]
}

/// Returns the bond order and its derivative by zeta.
fn order(zeta: f64) -> [f64; 2] {
    if zeta < 1e-12 {
        return [1.0, 0.0];
    }
    let t = libm::exp(N * libm::log(BETA * zeta));
    let b = libm::exp(-0.5 / N * libm::log(1.0 + t));
    [b, -0.5 * b * t / (zeta * (1.0 + t))]
}

/// Adds the forces of the half bonds that start at atom `i` to `forces`, in eV/A, and returns their energy in eV. The energy of a network
/// is the sum over all atoms.
pub fn half_bonds(network: &Network, near: &Neighbours, i: usize, forces: &mut [Vec3]) -> f64 {
    let mut bonds = [Bond::default(); MOST];
    let mut count = 0;
    for &to in near.of(i) {
        let to = to as usize;
        let d = network.vector(i, to);
        let square = dot(d, d);
        if square < CUTOFF * CUTOFF && count < MOST {
            let r = square.sqrt().max(1e-3);
            let [cut, cut_slope] = cutoff(r);
            let inverse = 1.0 / r;
            bonds[count] = Bond { to, u: d.map(|v| v * inverse), r, inverse, cut, cut_slope };
            count += 1;
        }
    }
    let bonds = &bonds[..count];
    let mut own = [0.0; 3];
    let mut energy = 0.0;
    for (n, bond) in bonds.iter().enumerate() {
        let mut zeta = 0.0;
        let mut angles = [[0.0; 3]; MOST];
        for (m, other) in bonds.iter().enumerate() {
            if m != n {
                let cosine = dot(bond.u, other.u);
                let [g, slope] = angular(cosine);
                zeta += other.cut * g;
                angles[m] = [cosine, g, slope];
            }
        }
        let [b, b_slope] = order(zeta);
        let repulsion = A_EV * libm::exp(-LAMBDA * bond.r);
        let attraction = -B_EV * libm::exp(-MU * bond.r);
        let pair = repulsion + b * attraction;
        energy += 0.5 * bond.cut * pair;
        let radial =
            0.5 * (bond.cut_slope * pair + bond.cut * (-LAMBDA * repulsion - MU * b * attraction));
        let mut gradient = bond.u.map(|u| radial * u);
        let weight = 0.5 * bond.cut * attraction * b_slope;
        for (m, other) in bonds.iter().enumerate() {
            if m == n {
                continue;
            }
            let [cosine, g, slope] = angles[m];
            let turn = weight * other.cut * slope;
            let stretch = weight * other.cut_slope * g;
            for k in 0..3 {
                gradient[k] += turn * (other.u[k] - cosine * bond.u[k]) * bond.inverse;
                let on_other =
                    turn * (bond.u[k] - cosine * other.u[k]) * other.inverse + stretch * other.u[k];
                forces[other.to][k] -= on_other;
                own[k] += on_other;
            }
        }
        for k in 0..3 {
            forces[bond.to][k] -= gradient[k];
            own[k] += gradient[k];
        }
    }
    for k in 0..3 {
        forces[i][k] += own[k];
    }
    energy
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, normal3};
    use crate::structure::lattice::norm;

    fn energy(network: &Network) -> (f64, Vec<Vec3>) {
        let near = Neighbours::new(network, CUTOFF + 0.1);
        let mut forces = vec![[0.0; 3]; network.positions.len()];
        let energy =
            (0..network.positions.len()).map(|i| half_bonds(network, &near, i, &mut forces)).sum();
        (energy, forces)
    }

    fn diamond(a: f64) -> Network {
        let mut positions = Vec::new();
        for n in 0..27 {
            let corner = [n % 3, n / 3 % 3, n / 9].map(f64::from);
            for f in [[0.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 0.5, 0.0]] {
                for s in [0.0, 0.25] {
                    positions.push([0, 1, 2].map(|k| (corner[k] + f[k] + s) * a));
                }
            }
        }
        Network { positions, period: [3.0 * a; 3] }
    }

    /// Tersoff, Phys. Rev. Lett. 61, 2879 (1988): diamond -7.37 eV per atom at 3.566 A.
    #[test]
    fn diamond_has_its_energy_and_lattice_parameter() {
        let per_atom = |a: f64| energy(&diamond(a * LENGTH_SCALE)).0 / 216.0;
        assert!((per_atom(3.566) + 7.37).abs() < 0.005, "{}", per_atom(3.566));
        assert!(per_atom(3.566) < per_atom(3.55) && per_atom(3.566) < per_atom(3.58));
    }

    #[test]
    fn forces_are_the_slopes_of_the_energy() {
        let mut network = diamond(3.4);
        for (i, p) in network.positions.iter_mut().enumerate() {
            let n = normal3(3, Purpose::Carbon, 0, i as u64);
            (0..3).for_each(|k| p[k] += 0.15 * n[k]);
        }
        let (_, forces) = energy(&network);
        for i in [0, 17, 100] {
            for k in 0..3 {
                let mut at = |step: f64| {
                    network.positions[i][k] += step;
                    let e = energy(&network).0;
                    network.positions[i][k] -= step;
                    e
                };
                let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
                assert!((slope + forces[i][k]).abs() < 1e-4 * (1.0 + norm(forces[i])));
            }
        }
    }
}
