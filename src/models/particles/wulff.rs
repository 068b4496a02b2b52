//! Truncated octahedra by Wulff's construction.

use std::sync::{Arc, Mutex, PoisonError};

use super::{Candidate, Cluster, Metal, Morphology, Vec3};

/// The lattice points of a face-centred cubic crystal within planes about a centre: {111} at one distance, {100}
/// at another (G. Wulff, Z. Kristallogr. 34, 449 (1901)).
#[derive(Debug, Clone, PartialEq)]
pub struct Wulff {
    /// The centre in units of the cell edge, from a lattice point.
    pub centre: Vec3,
    /// Distance of the {111} planes from the centre in Angstrom.
    pub distance: f64,
    count: usize,
}

/// Diameter in nm up to which points are kept for the particles of a recipe: 27 MB.
const LARGEST_NM: f64 = 10.0;

/// Finest division of the cell edge for centres.
const DIVISIONS: i32 = 8;

/// Returns the distance of the planes, in Angstrom, at which the point is just inside.
fn depth(metal: &Metal, p: Vec3) -> f64 {
    let [x, y, z] = p.map(f64::abs);
    let octahedral = (x + y + z) / 3f64.sqrt();
    octahedral.max(x.max(y).max(z) / metal.surface_energy_ratio)
}

/// Returns lattice points up to `reach` Angstrom from the centre along each axis, relative to the centre.
fn points(metal: &Metal, centre: Vec3, reach: f64) -> Vec<Vec3> {
    let half = 0.5 * metal.a;
    let most = (reach / half).ceil() as i32 + 2;
    let mut out = Vec::new();
    for i in -most..=most {
        for j in -most..=most {
            for k in (-most..=most).filter(|k| (i + j + k) % 2 == 0) {
                let lattice = [i, j, k].map(|n| f64::from(n) * half);
                out.push([0, 1, 2].map(|n| lattice[n] - metal.a * centre[n]));
            }
        }
    }
    out
}

impl Wulff {
    /// Makes the cluster within planes {111} at `distance` Angstrom from `centre` (in units of the cell edge) and {100} at
    /// `surface_energy_ratio` times that distance.
    pub fn new(metal: &Metal, centre: Vec3, distance: f64) -> Self {
        let mut wulff = Wulff { centre, distance, count: 0 };
        wulff.count = wulff.cluster(metal).positions.len();
        wulff
    }
}

impl Candidate for Wulff {
    const MORPHOLOGY: Morphology = Morphology::Wulff;

    fn count(&self) -> usize {
        self.count
    }
    fn cluster(&self, metal: &Metal) -> Cluster {
        let reach = self.distance * metal.surface_energy_ratio.max(1.0);
        let inside = |p: &Vec3| depth(metal, *p) < self.distance + 1e-6;
        let all = points(metal, self.centre, reach);
        Cluster::centred(all.into_iter().filter(inside).collect())
    }

    fn key(&self) -> [u64; 4] {
        let [x, y, z] = self.centre;
        [x, y, z, self.distance].map(f64::to_bits)
    }
}

/// Depths of lattice points about centres throughout the cell.
struct Depths {
    metal: Metal,
    /// Only depths below this many Angstrom are listed.
    reach: f64,
    /// For each centre the depths in Angstrom, ascending.
    about: Vec<(Vec3, Vec<f64>)>,
}

/// The depths that were requested last: all particles of one recipe use them.
static DEPTHS: Mutex<Option<Arc<Depths>>> = Mutex::new(None);

impl Depths {
    fn new(metal: &Metal, reach: f64) -> Self {
        let about = |centre: Vec3| {
            let mut depths: Vec<f64> =
                points(metal, centre, reach).into_iter().map(|p| depth(metal, p)).collect();
            depths.retain(|&d| d < reach);
            depths.sort_unstable_by(f64::total_cmp);
            (centre, depths)
        };
        Depths { metal: *metal, reach, about: centres().into_iter().map(about).collect() }
    }

    /// Returns the depths up to `reach` Angstrom, and possibly more.
    fn kept(metal: &Metal, reach: f64) -> Arc<Self> {
        let mut kept = DEPTHS.lock().unwrap_or_else(PoisonError::into_inner);
        match &*kept {
            Some(depths) if depths.metal == *metal && depths.reach >= reach => Arc::clone(depths),
            _ => Arc::clone(kept.insert(Arc::new(Depths::new(metal, reach)))),
        }
    }
}

/// Returns clusters of about this diameter, of at most `most_nm`, about centres throughout the cell.
pub(super) fn candidates(metal: &Metal, diameter_nm: f64, most_nm: f64) -> Vec<Wulff> {
    // In a cluster of a fourth more atoms the planes are 5.1 Angstrom from its centre for each nm of diameter.
    const REACH: f64 = 7.0;
    let wanted = metal.count(diameter_nm);
    let kept = Depths::kept(metal, REACH * diameter_nm.max(most_nm.min(LARGEST_NM)));
    let mut out = Vec::new();
    for (centre, depths) in &kept.about {
        let depths = &depths[..depths.partition_point(|d| *d < REACH * diameter_nm)];
        // A shell is complete where the next point lies deeper.
        let near = (1..depths.len().min((1.25 * wanted).ceil() as usize))
            .filter(|&n| (0.8..1.25).contains(&(n as f64 / wanted)));
        let ends = near.filter(|&n| depths[n] > depths[n - 1] + 1e-6);
        out.extend(ends.map(|n| Wulff { centre: *centre, distance: depths[n - 1], count: n }));
    }
    out
}

/// Returns centres that are not related by a symmetry of the crystal.
fn centres() -> Vec<Vec3> {
    let mut out = Vec::new();
    for i in 0..=DIVISIONS / 2 {
        for j in 0..=i {
            for k in 0..=j {
                out.push([i, j, k].map(|n| f64::from(n) / f64::from(DIVISIONS)));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points that were kept for larger clusters also serve smaller ones.
    #[test]
    fn candidates_do_not_depend_on_how_far_points_are_known() {
        let metal = Metal { a: 3.7, surface_energy_ratio: 1.1 };
        let known = |most_nm: f64| candidates(&metal, 1.5, most_nm);
        let few = known(1.5);
        assert!(few.len() > 100 && few == known(4.0) && few == known(1.5), "{}", few.len());
        assert!(few == known(f64::INFINITY));
    }
}
