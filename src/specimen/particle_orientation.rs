//! Random orientations of particles.

use crate::models::particles::Morphology;
use crate::models::particles::rotation::Rotation;
use crate::rng::{Purpose, open_unit, words};

/// Number of the random draws for orientations.
const ORIENTATION: u32 = 1;

/// Draws any orientation.
pub fn any_orientation(seed: u64, index: u64) -> Rotation {
    let [a, b, c, _] = words(seed, Purpose::Particle, ORIENTATION, index).map(open_unit);
    Rotation::uniform([a, b, c])
}

/// Draws a zone axis within `max_tilt_deg` of the beam and any rotation about it; from 90 degrees on, any orientation.
pub fn near_zone_axis(
    morphology: Morphology,
    max_tilt_deg: f64,
    seed: u64,
    index: u64,
) -> Rotation {
    let [a, b, c, tilted] = words(seed, Purpose::Particle, ORIENTATION, index).map(open_unit);
    if max_tilt_deg >= 90.0 {
        return Rotation::uniform([a, b, c]);
    }
    let axis = morphology.zone_axes()[((3.0 * a) as usize).min(2)];
    let tilt = tilt([c, tilted], max_tilt_deg);
    tilt.after(Rotation::about([0.0, 0.0, 1.0], turn(b))).after(Rotation::to_z(axis))
}

/// Draws a tilt of the beam's direction by at most `max_tilt_deg`: directions are uniform on the cap of the sphere.
fn tilt([c, tilted]: [f64; 2], max_tilt_deg: f64) -> Rotation {
    let cosine = 1.0 - tilted * (1.0 - libm::cos(max_tilt_deg.to_radians()));
    let direction = [libm::cos(turn(c)), libm::sin(turn(c)), 0.0];
    Rotation::about(direction, libm::acos(cosine))
}

/// Draws the rotation of a particle whose upright rotation is known: any rotation about the beam if it is `turned`, and a tilt.
pub fn tilted(
    upright: Rotation,
    turned: bool,
    max_tilt_deg: f64,
    seed: u64,
    index: u64,
) -> Rotation {
    let [_, b, c, share] = words(seed, Purpose::Particle, ORIENTATION, index).map(open_unit);
    let about = if turned { Rotation::about([0.0, 0.0, 1.0], turn(b)) } else { Rotation::NONE };
    let tilt = if max_tilt_deg > 0.0 { tilt([c, share], max_tilt_deg) } else { Rotation::NONE };
    tilt.after(about).after(upright)
}

fn turn(v: f64) -> f64 {
    2.0 * std::f64::consts::PI * v
}
