//! Carbon atoms in a periodic box, and their neighbours.

use super::Vec3;
use crate::structure::for_each_pair;
use crate::structure::lattice::subtract;
use crate::structure::{Atom, Structure};

/// Atomic number of carbon.
pub(crate) const CARBON: u8 = 6;

/// Atoms in Angstrom, in a box that may be periodic.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    /// Positions in Angstrom.
    pub positions: Vec<Vec3>,
    /// Period along each axis in Angstrom; infinite along an axis without a period.
    pub period: Vec3,
}

impl Network {
    /// Returns the vector from atom `i` to the nearest image of `j`. Neither may be farther than a period outside the box.
    #[inline]
    pub fn vector(&self, i: usize, j: usize) -> Vec3 {
        let [dx, dy, dz] = subtract(self.positions[j], self.positions[i]);
        let nearest = |d: f64, period: f64| match d {
            _ if d > 0.5 * period => d - period,
            _ if d < -0.5 * period => d + period,
            _ => d,
        };
        let [px, py, pz] = self.period;
        [nearest(dx, px), nearest(dy, py), nearest(dz, pz)]
    }

    /// Moves every atom into the box.
    pub(crate) fn wrap(&mut self) {
        for p in &mut self.positions {
            for k in 0..3 {
                if self.period[k].is_finite() {
                    p[k] -= self.period[k] * (p[k] / self.period[k]).floor();
                }
            }
        }
    }

    /// Returns the atoms as a structure; without periods, in a cell with vacuum of `margin` Angstrom.
    fn structure(&self, margin: f64) -> Structure {
        let mut cell = [[0.0; 3]; 3];
        for k in 0..3 {
            let ends = self
                .positions
                .iter()
                .fold([f64::INFINITY, f64::NEG_INFINITY], |e, p| [e[0].min(p[k]), e[1].max(p[k])]);
            let free = ends[1] - ends[0] + margin;
            cell[k][k] = if self.period[k].is_finite() { self.period[k] } else { free };
        }
        let atom = |&position: &Vec3| Atom::new(CARBON, position);
        Structure { cell, atoms: self.positions.iter().map(atom).collect() }
    }
}

/// Lists of neighbours; each pair is in both lists.
#[derive(Debug, Clone)]
pub struct Neighbours {
    starts: Vec<u32>,
    list: Vec<u32>,
}

impl Neighbours {
    /// Finds the pairs up to `reach` Angstrom apart.
    pub fn new(network: &Network, reach: f64) -> Self {
        let count = network.positions.len();
        let mut pairs: Vec<[u32; 2]> = Vec::with_capacity(4 * count);
        for_each_pair(&network.structure(2.0 * reach), reach, |i, j, _| {
            if i != j {
                pairs.push([i as u32, j as u32]);
            }
        });
        let mut starts = vec![0u32; count + 1];
        for &[i, j] in &pairs {
            starts[i as usize + 1] += 1;
            starts[j as usize + 1] += 1;
        }
        for i in 0..count {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut list = vec![0; 2 * pairs.len()];
        for [i, j] in pairs {
            for (from, to) in [(i, j), (j, i)] {
                list[next[from as usize] as usize] = to;
                next[from as usize] += 1;
            }
        }
        Neighbours { starts, list }
    }

    /// Returns the neighbours of atom `i`.
    pub fn of(&self, i: usize) -> &[u32] {
        &self.list[self.starts[i] as usize..self.starts[i + 1] as usize]
    }
}
