//! The places of layers along their normal: interfaces lie between atomic planes.

use super::atomic_planes::AtomicPlane;

/// Spacing of "planes" in amorphous matter, in Angstrom, which decides the gap between it and a crystal.
const AMORPHOUS_SPACING_ANGSTROM: f64 = 2.0;

/// What a layer is made of, seen along the normal.
#[derive(Debug, Clone, PartialEq)]
pub enum LayerMatter {
    /// A crystal.
    Crystal {
        /// Length of the cell along the normal in Angstrom.
        length: f64,
        /// Its atomic planes, by their positions.
        planes: Vec<AtomicPlane>,
        /// Index of the plane that begins the layer, if it is given.
        first: Option<usize>,
        /// Index of the plane that ends the layer, if it is given.
        last: Option<usize>,
    },
    /// An amorphous layer.
    Amorphous,
}

/// The place of a layer along the normal, in Angstrom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LayerPlace {
    /// Height of the interface at which the layer begins; of the first layer, where the stack begins.
    pub begin: f64,
    /// Height of the origin of a cell of its crystal.
    pub origin: f64,
}

/// Stacks layers from the height `start` on. `nominal` are the heights of the interfaces that the recipe gives, one fewer than the layers.
///
/// The layer below an interface ends with the atomic plane that puts the interface nearest to its nominal height, among the planes that
/// `last` allows. The layer above begins with its plane `first`, or else with the plane whose place in the cell is nearest to the place of
/// the plane that would have followed below, so that crystals of one structure continue. The distance of the two planes is the mean of the
/// spacings that they have in their own crystals, and the interface lies in the middle between them.
///
/// # Errors
/// The index of a layer that has no room for its planes.
pub fn layer_places(
    layers: &[LayerMatter],
    start: f64,
    nominal: &[f64],
) -> Result<Vec<LayerPlace>, usize> {
    let mut places: Vec<LayerPlace> = Vec::with_capacity(layers.len());
    for (n, layer) in layers.iter().enumerate() {
        let place = match places.last() {
            None => LayerPlace { begin: start, origin: first_origin(layer, start) },
            Some(below) => {
                let place = next(&layers[n - 1], below, layer, nominal[n - 1]);
                if place.begin <= below.begin {
                    return Err(n - 1);
                }
                place
            }
        };
        places.push(place);
    }
    Ok(places)
}

/// Returns the origin of the first layer: the lowest atom of its first plane lies at the start.
fn first_origin(layer: &LayerMatter, start: f64) -> f64 {
    match layer {
        LayerMatter::Crystal { length, planes, first, .. } => {
            let plane = &planes[first.unwrap_or(0)];
            start - plane.fraction * length - plane.spread_angstrom[0]
        }
        LayerMatter::Amorphous => start,
    }
}

fn next(below: &LayerMatter, place: &LayerPlace, above: &LayerMatter, nominal: f64) -> LayerPlace {
    let (end, after, follows) = match below {
        LayerMatter::Crystal { length, planes, last, .. } => {
            let half = |k: usize| 0.5 * spacing_after(planes, *length, k);
            let allowed = (0..planes.len()).filter(|k| last.is_none_or(|last| last == *k));
            // For each plane the cell in which it lies nearest to the interface.
            let nearest = allowed.map(|k| {
                let at = place.origin + planes[k].fraction * length;
                let cells = ((nominal - half(k) - at) / length).round();
                (at + cells * length, k)
            });
            let off = |(at, k): &(f64, usize)| (at + half(*k) - nominal).abs();
            let best = nearest.min_by(|a, b| off(a).total_cmp(&off(b)));
            let (at, k) = best.unwrap_or((nominal, 0));
            let following = planes[(k + 1) % planes.len()].fraction;
            (at, 2.0 * half(k), Some(following))
        }
        LayerMatter::Amorphous => {
            let half = 0.5 * AMORPHOUS_SPACING_ANGSTROM;
            (nominal - half, AMORPHOUS_SPACING_ANGSTROM, None)
        }
    };
    let LayerMatter::Crystal { length, planes, first, .. } = above else {
        let gap = 0.5 * (after + AMORPHOUS_SPACING_ANGSTROM);
        return LayerPlace { begin: end + 0.5 * gap, origin: end + gap };
    };
    let k = first.or_else(|| follows.map(|at| nearest_plane(planes, at))).unwrap_or(0);
    let before = spacing_after(planes, *length, (k + planes.len() - 1) % planes.len());
    let gap = 0.5 * (after + before);
    LayerPlace { begin: end + 0.5 * gap, origin: end + gap - planes[k].fraction * length }
}

/// Returns the plane whose place in the cell is nearest.
fn nearest_plane(planes: &[AtomicPlane], fraction: f64) -> usize {
    let off = |k: &usize| {
        let d = (planes[*k].fraction - fraction).rem_euclid(1.0);
        d.min(1.0 - d)
    };
    (0..planes.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
}

/// Returns the distance from a plane to the next in Angstrom.
fn spacing_after(planes: &[AtomicPlane], length: f64, k: usize) -> f64 {
    let here = planes[k].fraction;
    match planes.get(k + 1) {
        Some(next) => (next.fraction - here) * length,
        None => (1.0 + planes[0].fraction - here) * length,
    }
}

#[cfg(test)]
mod tests {
    use super::super::atomic_planes::{atomic_planes, parse_formula};
    use super::*;
    use crate::structure::crystals;

    fn matter(last: Option<usize>, first: Option<usize>) -> LayerMatter {
        let crystal = crystals::crystal("srtio3").unwrap();
        LayerMatter::Crystal { length: 3.905, planes: atomic_planes(&crystal, 0), first, last }
    }

    #[test]
    fn the_same_crystal_continues_without_a_step() {
        let layers = [matter(None, None), matter(None, None)];
        for nominal in [10.0, 11.1, 12.9] {
            let places = layer_places(&layers, 0.0, &[nominal]).unwrap();
            let cells = (places[1].origin - places[0].origin) / 3.905;
            assert!((cells - cells.round()).abs() < 1e-9, "{places:?}");
            assert!((places[1].begin - nominal).abs() <= 0.25 * 3.905 + 1e-9);
        }
    }

    #[test]
    fn the_planes_asked_for_meet() {
        let planes = atomic_planes(&crystals::crystal("srtio3").unwrap(), 0);
        let titanium = planes.iter().position(|p| p.formula == parse_formula("TiO2").unwrap());
        // TiO2 on TiO2: the planes are half a cell apart, as planes are in the crystal.
        let layers = [matter(titanium, None), matter(None, titanium)];
        let places = layer_places(&layers, 0.0, &[20.0]).unwrap();
        let offset = ((places[1].origin - places[0].origin) / 3.905).rem_euclid(1.0);
        assert!((offset - 0.5).abs() < 1e-9, "{offset}");
        let below = places[1].begin - 0.25 * 3.905;
        assert!(((below / 3.905 - 0.5).round() - (below / 3.905 - 0.5)).abs() < 1e-9, "{below}");
    }

    #[test]
    fn a_layer_without_room_is_named() {
        let layers = [matter(None, None), LayerMatter::Amorphous, matter(None, None)];
        assert_eq!(layer_places(&layers, 0.0, &[20.0, 20.0]), Err(1));
        let places = layer_places(&layers, 0.0, &[20.0, 40.0]).unwrap();
        assert!((places[2].begin - 40.0).abs() < 0.6 && places[1].begin > 19.0);
    }
}
