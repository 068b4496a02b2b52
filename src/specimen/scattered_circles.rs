//! Random places of circles in the field.

use crate::lengths;
use crate::plane;
use crate::recipe::region::Region;
use crate::rng::{Purpose, open_unit, words};

/// Number of places tried for a circle.
const TRIES: u64 = 100_000;
/// Number of the random draws for places.
const PLACE: u32 = 2;

/// A circle in Angstrom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    /// Centre (x, y).
    pub centre: [f64; 2],
    /// Radius.
    pub radius: f64,
}

impl Circle {
    /// Whether two circles are at least `gap` Angstrom apart.
    pub fn is_clear_of(&self, other: &Circle, gap: f64) -> bool {
        let room = self.radius + other.radius + gap;
        let d = plane::sub(self.centre, other.centre);
        d[0] * d[0] + d[1] * d[1] > room * room
    }
}

/// A circle that found no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoPlace {
    /// Index of the circle.
    pub index: usize,
    /// Number of circles that were placed before.
    pub placed: usize,
}

/// Places circles of given radii at random in a field, the largest first, at least `gap` Angstrom from each other and from the circles
/// that are there. `stream` numbers the first circle among all circles of a seed.
///
/// # Errors
/// The first circle for which no place is found.
pub fn scattered(
    radii: &[f64],
    there: &[Circle],
    field: &Region,
    gap: f64,
    (seed, stream): (u64, u64),
) -> Result<Vec<[f64; 2]>, NoPlace> {
    let mut order: Vec<usize> = (0..radii.len()).collect();
    order.sort_by(|&i, &j| radii[j].total_cmp(&radii[i]).then(i.cmp(&j)));
    let mut taken = there.to_vec();
    let mut centres = vec![[0.0; 2]; radii.len()];
    for (placed, &index) in order.iter().enumerate() {
        let radius = radii[index];
        let tried = |attempt: u64| {
            let w = words(seed, Purpose::Particle, PLACE, (stream + index as u64) << 32 | attempt);
            let within = |range: [f64; 2], w: u32| {
                let [low, high] = lengths::angstrom_by_division(range);
                low + radius + (high - low - 2.0 * radius) * open_unit(w)
            };
            Circle { centre: [within(field.x, w[0]), within(field.y, w[1])], radius }
        };
        let inside = [field.x, field.y]
            .iter()
            .all(|r| lengths::angstrom_by_division(r[1] - r[0]) > 2.0 * radius);
        let tries = if inside { 0..TRIES } else { 0..0 };
        let clear = |circle: &Circle| taken.iter().all(|other| circle.is_clear_of(other, gap));
        let Some(found) = tries.map(tried).find(clear) else {
            return Err(NoPlace { index, placed });
        };
        centres[index] = found.centre;
        taken.push(found);
    }
    Ok(centres)
}
