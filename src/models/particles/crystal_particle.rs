//! Particles of any crystal: the atoms within a polyhedron or a sphere.

use std::collections::HashSet;

use rayon::prelude::*;

use super::facets::Polyhedron;
use crate::structure::Structure;
use crate::structure::lattice::{
    Vec3, determinant, face_distances, inverse, norm, row_times, subtract,
};

/// The centre is tried at this many places along each vector of the cell; at half as many, and at a few atoms, for particles of many atoms.
const CENTRES: usize = 4;
const MANY_ATOMS: f64 = 8000.0;
const FEW: usize = 8;
/// Share by which the number of atoms may differ from the wanted one.
const NEAR_ENOUGH: f64 = 0.02;
/// Atoms nearer than this are bonded, in units of the shortest distance of the atom in the crystal; O and O of fluorite are at 1.155.
const BOND: f64 = 1.15;
/// An atom that keeps less than this share of its bonds is left out.
const LEAST_BONDS: f64 = 1.0 / 3.0;
/// Atoms within this distance outside a facet belong to the particle, in Angstrom.
const ROUNDING: f64 = 1e-6;
/// Corners of a body move out by less than this with its facets by [`ROUNDING`], in Angstrom.
const MARGIN: f64 = 1e-3;

/// The outside of a particle, about its centre; lengths in Angstrom.
#[derive(Debug, Clone, PartialEq)]
pub enum ParticleBody {
    /// Bounded by facets.
    Polyhedron(Polyhedron),
    /// A sphere of a radius.
    Sphere(f64),
}

impl ParticleBody {
    fn depth(&self, at: Vec3) -> f64 {
        match self {
            ParticleBody::Polyhedron(polyhedron) => polyhedron.depth(at),
            ParticleBody::Sphere(radius) => radius - norm(at),
        }
    }

    /// Returns the body multiplied by a length.
    fn scaled(&self, by: f64) -> Self {
        match self {
            ParticleBody::Polyhedron(polyhedron) => ParticleBody::Polyhedron(polyhedron.scaled(by)),
            ParticleBody::Sphere(radius) => ParticleBody::Sphere(by * radius),
        }
    }

    /// Returns the greatest distance of a point of the particle from its centre.
    fn reach(&self) -> f64 {
        match self {
            ParticleBody::Polyhedron(polyhedron) => {
                let polygons = polyhedron.polygons().unwrap_or_default();
                polygons.iter().flatten().map(|corner| norm(*corner)).fold(0.0, f64::max)
            }
            ParticleBody::Sphere(radius) => *radius,
        }
    }

    /// Returns the radius of the sphere about the centre that touches the nearest facet; 0 if the centre is outside.
    fn clear(&self) -> f64 {
        self.depth([0.0; 3]).max(0.0)
    }
}

/// A body of one size.
struct SizedBody {
    body: ParticleBody,
    /// The greatest distance of its points from the centre.
    reach: f64,
    /// All points nearer to the centre belong to it.
    clear: f64,
}

impl SizedBody {
    /// Most points are decided by their distance from the centre alone.
    fn holds(&self, at: Vec3) -> bool {
        let r = norm(at);
        r < self.clear || (r < self.reach + MARGIN && self.body.depth(at) >= -ROUNDING)
    }
}

/// An atom of a crystal: its cell and its number in the cell.
type Label = ([i32; 3], usize);

/// The bonds of each atom of a cell, as labels relative to it.
struct Bonds {
    of_atom: Vec<Vec<Label>>,
    longest: f64,
}

impl Bonds {
    fn new(crystal: &Structure) -> Self {
        let mut of_atom = Vec::new();
        let mut longest: f64 = 0.0;
        let around = |a: usize, reach: f64| {
            let cells = face_distances(&crystal.cell).map(|d| (reach / d).ceil() as i32 + 1);
            let mut found: Vec<(f64, Label)> = Vec::new();
            for i in -cells[0]..=cells[0] {
                for j in -cells[1]..=cells[1] {
                    for k in -cells[2]..=cells[2] {
                        for b in 0..crystal.atoms.len() {
                            let to = place(crystal, ([i, j, k], b));
                            let from = crystal.atoms[a].position;
                            let apart = norm(subtract(to, from));
                            if apart > 1e-3 && apart <= reach {
                                found.push((apart, ([i, j, k], b)));
                            }
                        }
                    }
                }
            }
            found
        };
        let shortest = |a: usize| {
            let mut reach = 3.0;
            loop {
                let nearest =
                    around(a, reach).into_iter().map(|(d, _)| d).fold(f64::INFINITY, f64::min);
                if nearest.is_finite() || reach > 50.0 {
                    return nearest.min(reach);
                }
                reach *= 1.5;
            }
        };
        for a in 0..crystal.atoms.len() {
            let reach = BOND * shortest(a);
            longest = longest.max(reach);
            of_atom.push(around(a, reach).into_iter().map(|(_, label)| label).collect());
        }
        Bonds { of_atom, longest }
    }
}

fn place(crystal: &Structure, (cell, atom): Label) -> Vec3 {
    let corner = row_times(cell.map(f64::from), &crystal.cell);
    let [x, y, z] = crystal.atoms[atom].position;
    [corner[0] + x, corner[1] + y, corner[2] + z]
}

fn sum(cell: [i32; 3], by: [i32; 3]) -> [i32; 3] {
    std::array::from_fn(|k| cell[k] + by[k])
}

/// Returns the volume of a crystal for each atom, in cubic Angstrom.
pub fn volume_per_atom(crystal: &Structure) -> f64 {
    determinant(&crystal.cell).abs() / crystal.atoms.len().max(1) as f64
}

/// Returns the atoms (place in Angstrom in the axes of the crystal, relative to their mean; atomic number) of a particle of the shape of
/// `body`, which has a volume in cubic Angstrom.
///
/// Sizes about this volume are tried, and centres of the body: places on a grid in the cell, and the places of the atoms. Among the particles
/// whose number of atoms differs by at most 2 % from what fills the volume, the one with the least energy of broken bonds for its size is
/// taken: the sum of `1 - sqrt(z / Z)` over its atoms, which keep z of their Z bonds, divided by the number of atoms to the power 2/3 (the
/// second-moment approximation of tight binding, F. Ducastelle, J. Phys. (Paris) 31, 1055 (1970)). Without any such particle, the number of
/// atoms decides. Then atoms that keep less than a third of their bonds are left out, as often as there are any.
pub fn crystal_particle(crystal: &Structure, body: &ParticleBody, volume: f64) -> Vec<(Vec3, u8)> {
    let bonds = Bonds::new(crystal);
    let wanted = volume / volume_per_atom(crystal);
    let reach = body.reach();
    let bodies: Vec<SizedBody> = sizes(wanted, volume, &bonds)
        .into_iter()
        .map(|size| SizedBody {
            body: body.scaled(size),
            reach: size * reach,
            clear: size * body.clear(),
        })
        .collect();
    let centres = centres(crystal, wanted);
    let tries: Vec<(usize, usize)> =
        (0..bodies.len()).flat_map(|b| (0..centres.len()).map(move |c| (b, c))).collect();
    let found: Vec<(f64, f64)> = tries
        .par_iter()
        .map(|&(b, c)| {
            let (count, energy) = count_and_energy(crystal, &bodies[b], &bonds, centres[c]);
            ((count as f64 / wanted - 1.0).abs(), energy)
        })
        .collect();
    // Places that symmetry relates differ by rounding; the first one is taken.
    let rank = |n: &usize| {
        let (off, energy) = found[*n];
        let near = off <= NEAR_ENOUGH;
        (!near, (1e9 * if near { energy } else { off }).round() as u64)
    };
    let Some(best) = (0..tries.len()).min_by_key(rank) else { return Vec::new() };
    let (b, c) = tries[best];
    let kept = trimmed(inside(crystal, &bodies[b], centres[c]), &bonds);
    let atoms: Vec<(Vec3, u8)> =
        kept.iter().map(|label| (place(crystal, *label), crystal.atoms[label.1].number)).collect();
    let count = atoms.len().max(1) as f64;
    let mean: Vec3 = std::array::from_fn(|k| atoms.iter().map(|(p, _)| p[k]).sum::<f64>() / count);
    atoms.iter().map(|(p, z)| (subtract(*p, mean), *z)).collect()
}

/// Returns the sizes that are tried, relative to the volume. Atoms lie on the facets, so that a particle fills more than its polyhedron: by
/// up to half a bond on each side.
fn sizes(wanted: f64, volume: f64, bonds: &Bonds) -> Vec<f64> {
    let radius = libm::cbrt(0.75 * volume / std::f64::consts::PI);
    let spread = (0.8 * bonds.longest / radius).min(0.4);
    let count = (60_000.0 / wanted).clamp(9.0, 31.0) as usize;
    let step = 1.3 * spread / (count - 1) as f64;
    (0..count).map(|n| 1.0 - spread + step * n as f64).collect()
}

/// Returns the centres that are tried; fewer for particles of many atoms, of which each has many facets to choose from.
fn centres(crystal: &Structure, wanted: f64) -> Vec<Vec3> {
    let edge = if wanted < MANY_ATOMS { CENTRES } else { CENTRES / 2 };
    let step = 1.0 / edge as f64;
    let grid = (0..edge.pow(3)).map(|n| {
        let index = [n / edge / edge, n / edge % edge, n % edge];
        row_times(index.map(|i| step * i as f64), &crystal.cell)
    });
    let of_atoms = crystal.atoms.iter().map(|atom| atom.position);
    grid.chain(of_atoms.take(if wanted < MANY_ATOMS { usize::MAX } else { FEW })).collect()
}

/// Returns the atoms within a body about a centre, cell by cell.
fn inside(crystal: &Structure, sized: &SizedBody, centre: Vec3) -> Vec<Label> {
    let reach = sized.reach;
    let to_fraction = inverse(&crystal.cell).unwrap_or([[0.0; 3]; 3]);
    let middle = row_times(centre, &to_fraction);
    let thick = face_distances(&crystal.cell);
    // Atoms may lie outside their cell.
    let range = |k: usize| {
        let cells = reach / thick[k] + 2.0;
        (middle[k] - cells).floor() as i32..=(middle[k] + cells).ceil() as i32
    };
    let of_cell = crystal.atoms.iter().map(|atom| norm(atom.position)).fold(0.0, f64::max);
    let mut found = Vec::new();
    for i in range(0) {
        for (j, k) in range(1).flat_map(|j| range(2).map(move |k| (j, k))) {
            let corner = row_times([i, j, k].map(f64::from), &crystal.cell);
            if norm(subtract(corner, centre)) > reach + of_cell + MARGIN {
                continue;
            }
            for atom in 0..crystal.atoms.len() {
                let at = place(crystal, ([i, j, k], atom));
                if sized.holds(subtract(at, centre)) {
                    found.push(([i, j, k], atom));
                }
            }
        }
    }
    found
}

/// Returns the number of atoms of a particle, and the energy of its broken bonds for its size.
fn count_and_energy(
    crystal: &Structure,
    sized: &SizedBody,
    bonds: &Bonds,
    centre: Vec3,
) -> (usize, f64) {
    let atoms = inside(crystal, sized, centre);
    if atoms.is_empty() {
        return (0, f64::INFINITY);
    }
    let from_centre = |label: Label| {
        let at = place(crystal, label);
        subtract(at, centre)
    };
    let mut missing = 0.0;
    for &(cell, atom) in &atoms {
        let own = &bonds.of_atom[atom];
        let at = from_centre((cell, atom));
        let deep =
            || norm(at) + bonds.longest < sized.clear || sized.body.depth(at) > bonds.longest;
        if own.is_empty() || deep() {
            continue;
        }
        let held = |&&(by, other): &&Label| sized.holds(from_centre((sum(cell, by), other)));
        let kept = own.iter().filter(held).count();
        missing += 1.0 - (kept as f64 / own.len() as f64).sqrt();
    }
    let edge = libm::cbrt(atoms.len() as f64);
    (atoms.len(), missing / (edge * edge))
}

/// Leaves out atoms that keep too few bonds.
fn trimmed(mut atoms: Vec<Label>, bonds: &Bonds) -> Vec<Label> {
    loop {
        let there: HashSet<Label> = atoms.iter().copied().collect();
        let before = atoms.len();
        atoms.retain(|(cell, atom)| {
            let own = &bonds.of_atom[*atom];
            let kept = own.iter().filter(|(by, b)| there.contains(&(sum(*cell, *by), *b))).count();
            kept as f64 >= LEAST_BONDS * own.len() as f64
        });
        if atoms.len() == before {
            return atoms;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::facets::Facet;
    use super::super::{Metal, Morphology, build};
    use super::*;
    use crate::structure::crystals::crystal;

    fn wulff(name: &str, families: &[([i32; 3], f64)], volume: f64) -> Vec<(Vec3, u8)> {
        let crystal = crystal(name).unwrap();
        let unit = Polyhedron::of_families(&crystal, families).unwrap();
        let scale = libm::cbrt(volume / unit.volume().unwrap());
        crystal_particle(&crystal, &ParticleBody::Polyhedron(unit.scaled(scale)), volume)
    }

    #[test]
    fn a_particle_has_the_volume_that_was_asked_for_to_within_its_surface() {
        for (name, families) in [
            ("pt", vec![([1, 1, 1], 1.0), ([1, 0, 0], 1.19)]),
            ("srtio3", vec![([1, 0, 0], 1.0), ([1, 1, 0], 1.1)]),
            ("gan", vec![([1, 0, 0], 1.0), ([0, 0, 1], 1.2)]),
        ] {
            let volume = 4.0 / 3.0 * std::f64::consts::PI * 25f64.powi(3);
            let atoms = wulff(name, &families, volume);
            let per_atom = volume_per_atom(&crystal(name).unwrap());
            let share = atoms.len() as f64 * per_atom / volume;
            assert!((share - 1.0).abs() < 0.03, "{name}: {share}");
        }
    }

    #[test]
    fn a_metal_has_no_more_broken_bonds_than_the_search_over_truncated_octahedra() {
        let metal = Metal { a: 3.9242, surface_energy_ratio: 1.19 };
        let own = build(Morphology::Wulff, &metal, 3.0, [2.9, 3.1]).unwrap();
        let volume = std::f64::consts::PI / 6.0 * 30f64.powi(3);
        let atoms = wulff("pt", &[([1, 1, 1], 1.0), ([1, 0, 0], 1.19)], volume);
        let ratio = atoms.len() as f64 / own.positions.len() as f64;
        assert!((0.93..1.07).contains(&ratio), "{ratio}");
        let least = |positions: Vec<Vec3>| {
            let cluster = super::super::Cluster { positions };
            let counts = cluster.coordination(&metal);
            let missing: f64 = counts.iter().map(|&c| 1.0 - (c as f64 / 12.0).sqrt()).sum();
            missing / libm::cbrt(counts.len() as f64).powi(2)
        };
        let [general, searched] = [atoms.iter().map(|a| a.0).collect(), own.positions].map(least);
        assert!(general < 1.06 * searched, "{general} {searched}");
    }

    #[test]
    fn no_atom_hangs_on_few_bonds() {
        let atoms = wulff("si", &[([1, 1, 1], 1.0), ([1, 0, 0], 1.1)], 20_000.0);
        let bond = 5.431 * 3f64.sqrt() / 4.0;
        for (at, _) in &atoms {
            let apart = |b: &Vec3| norm(subtract(*at, *b));
            let bonds = atoms.iter().filter(|(b, _)| (0.1..1.1 * bond).contains(&apart(b))).count();
            assert!((2..=4).contains(&bonds), "{bonds}");
        }
        // A sphere through whose surface single atoms stick out.
        let strontium_titanate = crystal("srtio3").unwrap();
        let volume = 4.0 / 3.0 * std::f64::consts::PI * 12f64.powi(3);
        let sphere = crystal_particle(&strontium_titanate, &ParticleBody::Sphere(12.0), volume);
        let wanted = volume / 3.905f64.powi(3) * 5.0;
        assert!((sphere.len() as f64 / wanted - 1.0).abs() < 0.05, "{}", sphere.len());
        let mean: Vec3 = std::array::from_fn(|k| sphere.iter().map(|a| a.0[k]).sum());
        assert!(norm(mean) < 1e-6);
    }

    #[test]
    fn a_cut_particle_has_a_flat_face() {
        let platinum = crystal("pt").unwrap();
        let unit = Polyhedron::of_families(&platinum, &[([1, 1, 1], 1.0), ([1, 0, 0], 1.19)]);
        let cut = unit.unwrap().cut(Facet { normal: [0.0, 0.0, 1.0], distance: 0.2 }).scaled(20.0);
        let volume = cut.volume().unwrap();
        let atoms = crystal_particle(&platinum, &ParticleBody::Polyhedron(cut), volume);
        let top = atoms.iter().map(|(p, _)| p[2]).fold(f64::NEG_INFINITY, f64::max);
        let on_top = atoms.iter().filter(|(p, _)| (p[2] - top).abs() < 1e-6).count();
        let bottom = atoms.iter().map(|(p, _)| p[2]).fold(f64::INFINITY, f64::min);
        let below = atoms.iter().filter(|(p, _)| (p[2] - bottom).abs() < 1e-6).count();
        assert!(on_top > 4 * below, "{on_top} {below}");
    }
}
