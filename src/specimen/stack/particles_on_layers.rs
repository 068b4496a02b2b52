//! Particles on the layers of a stack: how large each is, how it is turned, and where it lies.

use rayon::prelude::*;

use super::filling::{MadeSite, NO_LAYER};
use crate::error::{Error, Result};
use crate::lengths;
use crate::models::particles::crystal_particle::{ParticleBody, crystal_particle, volume_per_atom};
use crate::models::particles::rotation::Rotation;
use crate::models::particles::{Cluster, build};
use crate::models::stack::least_distances::{LEAST_SHARE, LeastDistances};
use crate::plane;
use crate::recipe::stack_table::{ParticleSide, StackParticles};
use crate::recipe::stacked_crystals::{
    CheckedParticles, ParticleForm, ParticleOrientation, StackedCrystals,
};
use crate::recipe::{CheckedRecipe, StackTable};
use crate::rng::{Purpose, uniform};
use crate::setting::Setting;
use crate::specimen::own_atoms::HeldParticle;
use crate::specimen::particle_orientation::{any_orientation, near_zone_axis, tilted};
use crate::specimen::scattered_circles::{Circle, NoPlace, scattered};
use crate::specimen::sites::SiteKind;
use crate::specimen::specimen_trait::ParticleTruth;
use crate::structure::lattice::Vec3;
use crate::structure::min_pair_distance;

/// Number of the random draw for diameters.
const DIAMETER: u32 = 0;
/// Bits of the number of a particle within its table.
const TABLE_BITS: u32 = 14;
/// The atoms of the layers to this depth in Angstrom below their face decide where a particle comes to rest.
const FACE_DEPTH: f64 = 12.0;
/// The projection of a particle reaches this far beyond the places of its atoms, in units of the shortest distance of two atoms.
const SHADOW_EDGE: f64 = 0.5;

/// A particle in its place; lengths in Angstrom.
pub struct LaidParticle {
    atoms: Vec<(Vec3, u8)>,
    phase: usize,
    centre: Vec3,
    diameter_nm: f64,
    shape: &'static str,
    rotation: Rotation,
    edge: f64,
}

/// A particle before it has a place: atoms about their centre.
struct MadeParticle {
    atoms: Vec<(Vec3, u8)>,
    rotation: Rotation,
    diameter_nm: f64,
    radius: f64,
}

/// Makes the particles of all tables and lays them on the sites of the layers.
///
/// # Errors
/// [`Error::Invalid`] for particles that find no place, or whose height is more than the vacuum on their side.
pub fn laid_particles(
    recipe: &CheckedRecipe,
    table: &StackTable,
    crystals: &StackedCrystals,
    layers: &[MadeSite],
) -> Result<Vec<LaidParticle>> {
    let mut laid: Vec<LaidParticle> = Vec::new();
    let mut taken: [Vec<Circle>; 2] = [Vec::new(), Vec::new()];
    for (n, (given, checked)) in table.particles.iter().zip(&crystals.particles).enumerate() {
        let made: Vec<MadeParticle> = (0..given.number())
            .into_par_iter()
            .map(|k| made_particle(recipe.seed, n, k, given, checked))
            .collect::<Result<_>>()?;
        let circles = &mut taken[given.side as usize];
        let centres = places(recipe, n, given, &made, circles)?;
        let face = face_atoms(layers, given.side);
        let rest = |(made, centre): (&MadeParticle, [f64; 2])| {
            let height = resting_height(made, centre, &face, given, &crystals.least);
            laid_at(made, [centre[0], centre[1], height], given, checked)
        };
        let found: Vec<LaidParticle> = made.par_iter().zip(centres.clone()).map(rest).collect();
        check_height(n, given, &found, recipe.field.thickness_nm)?;
        circles.extend(
            centres.iter().zip(&made).map(|(c, m)| Circle { centre: *c, radius: m.radius }),
        );
        laid.extend(found);
    }
    Ok(laid)
}

/// Returns the number of a particle among all particles of the recipe.
fn stream(table: usize, particle: usize) -> u64 {
    (table as u64) << TABLE_BITS | particle as u64
}

fn made_particle(
    seed: u64,
    n: usize,
    k: usize,
    given: &StackParticles,
    checked: &CheckedParticles,
) -> Result<MadeParticle> {
    let index = stream(n, k);
    let [low, high] = given.diameter_nm;
    let wanted_nm = low + (high - low) * uniform(seed, Purpose::Particle, DIAMETER, index);
    let rotation = match checked.orientation {
        ParticleOrientation::Any => any_orientation(seed, index),
        ParticleOrientation::ZoneAxes(most) => match checked.form {
            ParticleForm::Cluster(morphology, _) => near_zone_axis(morphology, most, seed, index),
            _ => any_orientation(seed, index),
        },
        ParticleOrientation::Axis { rotation, turned, max_tilt_deg } => {
            tilted(rotation, turned, max_tilt_deg, seed, index)
        }
    };
    let radius = lengths::angstrom_by_division(0.5 * wanted_nm);
    let volume = 4.0 / 3.0 * std::f64::consts::PI * radius * radius * radius;
    let own = match &checked.form {
        ParticleForm::Wulff(unit) => {
            let body = ParticleBody::Polyhedron(unit.scaled(libm::cbrt(volume)));
            crystal_particle(&checked.structure, &body, volume)
        }
        ParticleForm::Sphere => {
            crystal_particle(&checked.structure, &ParticleBody::Sphere(radius), volume)
        }
        ParticleForm::Cluster(morphology, metal) => {
            let cluster: Cluster = build(*morphology, metal, wanted_nm, given.diameter_nm)?;
            let number = checked.structure.atoms.first().map_or(0, |atom| atom.number);
            cluster.positions.into_iter().map(|p| (p, number)).collect()
        }
    };
    if own.is_empty() {
        let expected = "no atoms are left of a particle of this size; raise the diameter";
        return Err(Error::invalid(
            Setting::ParticleDiameterNm,
            format!("{wanted_nm:.3}"),
            expected,
        ));
    }
    let atoms: Vec<(Vec3, u8)> = own.iter().map(|(p, z)| (rotation.apply(*p), *z)).collect();
    let volume = own.len() as f64 * volume_per_atom(&checked.structure);
    let across = atoms.iter().map(|(p, _)| p[0].hypot(p[1])).fold(0.0, f64::max);
    Ok(MadeParticle {
        atoms,
        rotation,
        diameter_nm: lengths::nm(libm::cbrt(6.0 * volume / std::f64::consts::PI)),
        radius: across + 1e-3,
    })
}

/// Returns the places (x, y) of the particles of a table.
fn places(
    recipe: &CheckedRecipe,
    n: usize,
    given: &StackParticles,
    made: &[MadeParticle],
    taken: &[Circle],
) -> Result<Vec<[f64; 2]>> {
    let gap = lengths::angstrom_by_division(given.gap_nm);
    let field = recipe.field.full_region();
    let radii: Vec<f64> = made.iter().map(|m| m.radius).collect();
    let named = |k: usize| format!("stack.particles[{}], particle {}", n + 1, k + 1);
    if given.positions_nm.is_empty() {
        return scattered(&radii, taken, &field, gap, (recipe.seed, stream(n, 0))).map_err(
            |NoPlace { index, placed }| {
                let expected = format!(
                    "after {placed} particles no place was found for another with a diameter of {:.2} nm, {} nm from the others; lower the number, \
                     the diameters or gap_nm, or raise field.fov_nm",
                    made[index].diameter_nm, given.gap_nm
                );
                Error::invalid(Setting::Recipe, named(index), expected)
            },
        );
    }
    let centres: Vec<[f64; 2]> =
        given.positions_nm.iter().copied().map(lengths::angstrom_by_division).collect();
    let mut there = taken.to_vec();
    for (k, (centre, radius)) in centres.iter().zip(radii).enumerate() {
        let circle = Circle { centre: *centre, radius };
        if !there.iter().all(|other| circle.is_clear_of(other, gap)) {
            let expected = format!(
                "the circle of {:.2} nm about it is nearer than {} nm to the circle about another particle; expected more distance, or a smaller gap_nm",
                lengths::nm(2.0 * radius),
                given.gap_nm
            );
            return Err(Error::invalid(Setting::Recipe, named(k), expected));
        }
        there.push(circle);
    }
    Ok(centres)
}

/// Returns the atoms near a face of the layers, with the distance into the layers in place of the height.
fn face_atoms(layers: &[MadeSite], side: ParticleSide) -> Vec<(Vec3, u8)> {
    let sign = side.inward();
    let depth = |site: &MadeSite| sign * site.position[2];
    let face = layers.iter().map(depth).fold(f64::INFINITY, f64::min);
    let near = layers.iter().filter(|site| depth(site) < face + FACE_DEPTH);
    near.map(|site| ([site.position[0], site.position[1], depth(site)], site.number)).collect()
}

/// Returns the height of the centre of a particle where it comes to rest: no atom is nearer to an atom of the layers than the contact.
fn resting_height(
    made: &MadeParticle,
    centre: [f64; 2],
    face: &[(Vec3, u8)],
    given: &StackParticles,
    least: &LeastDistances,
) -> f64 {
    let sign = given.side.inward();
    let contact = |a: u8, b: u8| given.contact_angstrom.unwrap_or(least.of(a, b) / LEAST_SHARE);
    let most = given.contact_angstrom.unwrap_or(least.greatest() / LEAST_SHARE);
    let within = |at: &Vec3| (0..2).all(|k| (at[k] - centre[k]).abs() <= made.radius + most);
    let below: Vec<&(Vec3, u8)> = face.iter().filter(|(at, _)| within(at)).collect();
    let lowest = made.atoms.iter().map(|(p, _)| sign * p[2]).fold(f64::NEG_INFINITY, f64::max);
    let deepest = below.iter().map(|(at, _)| at[2]).fold(f64::NEG_INFINITY, f64::max);
    let mut depth = if deepest.is_finite() { deepest - lowest } else { 0.0 };
    for (p, number) in &made.atoms {
        if sign * p[2] < lowest - FACE_DEPTH {
            continue;
        }
        let [x, y] = [0, 1].map(|k| centre[k] + p[k]);
        for (at, other) in &below {
            let reach = contact(*number, *other);
            let square = reach * reach - (at[0] - x).powi(2) - (at[1] - y).powi(2);
            if square > 0.0 {
                depth = depth.min(at[2] - square.sqrt() - sign * p[2]);
            }
        }
    }
    sign * depth
}

fn laid_at(
    made: &MadeParticle,
    centre: Vec3,
    given: &StackParticles,
    checked: &CheckedParticles,
) -> LaidParticle {
    let moved = |(p, z): &(Vec3, u8)| (std::array::from_fn(|k| p[k] + centre[k]), *z);
    let shortest = min_pair_distance(&checked.structure).unwrap_or(0.0);
    LaidParticle {
        atoms: made.atoms.iter().map(moved).collect(),
        phase: checked.phase,
        centre,
        diameter_nm: made.diameter_nm,
        shape: given.shape.name(),
        rotation: made.rotation,
        edge: SHADOW_EDGE * shortest,
    }
}

/// Refuses particles that reach out of the specimen.
fn check_height(
    n: usize,
    given: &StackParticles,
    laid: &[LaidParticle],
    thickness_nm: f64,
) -> Result<()> {
    for (k, particle) in laid.iter().enumerate() {
        let heights = || particle.atoms.iter().map(|(p, _)| lengths::nm(p[2]));
        let low = heights().fold(f64::INFINITY, f64::min);
        let high = heights().fold(f64::NEG_INFINITY, f64::max);
        let (out, remedy) = match given.side {
            ParticleSide::Entrance => (-low, "raise stack.begin_nm and field.thickness_nm"),
            ParticleSide::Exit => (high - thickness_nm, "raise field.thickness_nm"),
        };
        if out > 0.0 {
            let value = format!("stack.particles[{}], particle {}", n + 1, k + 1);
            let expected = format!(
                "it is {:.2} nm tall and reaches {out:.2} nm out of the specimen; {remedy} by at least {:.1} nm",
                high - low,
                (10.0 * out).ceil() / 10.0
            );
            return Err(Error::invalid(Setting::Recipe, value, expected));
        }
    }
    Ok(())
}

impl LaidParticle {
    /// Returns the sites of the particle.
    pub fn sites(&self) -> impl Iterator<Item = MadeSite> + '_ {
        self.atoms.iter().map(|(position, number)| MadeSite {
            position: *position,
            number: *number,
            kind: SiteKind::Pristine,
            phase: self.phase as u16,
            layer: NO_LAYER,
        })
    }

    /// Returns the particle with its projection along the beam.
    pub fn held(&self) -> HeldParticle {
        let truth = ParticleTruth {
            centre_nm: lengths::nm(self.centre),
            diameter_nm: self.diameter_nm,
            morphology: self.shape.to_owned(),
            orientation: self.rotation.0,
        };
        let places = self.atoms.iter().map(|(p, _)| [p[0], p[1]]).collect();
        let corners = grown(&convex_hull(places), [self.centre[0], self.centre[1]], self.edge);
        let shadow_nm = corners.into_iter().map(lengths::nm).collect();
        HeldParticle { truth, phase: self.phase, shadow_nm }
    }
}

/// Returns the corners of the convex hull of points, from +x to +y about it (A. M. Andrew, Inf. Process. Lett. 9, 216 (1979)).
fn convex_hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let left = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 1e-9
    };
    let half = |points: &mut dyn Iterator<Item = &[f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for &p in points {
            while chain.len() > 1 && !left(chain[chain.len() - 2], chain[chain.len() - 1], p) {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut points.iter());
    hull.extend(half(&mut points.iter().rev()));
    hull
}

/// Moves the corners of a polygon away from its centre.
fn grown(corners: &[[f64; 2]], centre: [f64; 2], by: f64) -> Vec<[f64; 2]> {
    let moved = |c: &[f64; 2]| {
        let d = plane::sub(*c, centre);
        let length = d[0].hypot(d[1]).max(1e-9);
        plane::add(*c, d.map(|d| by * d / length))
    };
    corners.iter().map(moved).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hull_of_a_square_with_points_inside_is_the_square() {
        let inside = (0..50).map(|n| [0.02 * f64::from(n), 0.5]);
        let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let hull = convex_hull(square.into_iter().chain(inside).chain([[0.5, 0.0]]).collect());
        assert_eq!(hull, square);
        let large = grown(&hull, [0.5, 0.5], 0.5f64.sqrt());
        let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-9;
        assert!(near(large[0], [-0.5, -0.5]) && near(large[2], [1.5, 1.5]), "{large:?}");
    }
}
