//! Mackay's icosahedra, with closed shells or with a part of the next shell.

use std::collections::BTreeSet;
use std::sync::LazyLock;

use super::{Candidate, Cluster, Metal, Morphology, Vec3};
use crate::structure::lattice::{dot, norm, subtract};

/// Closed shells about an atom, and facets of the next shell.
///
/// A. L. Mackay, Acta Cryst. 15, 916 (1962). Shells grow facet by facet, as the mass spectra of clusters show: T. P. Martin,
/// Phys. Rep. 273, 199 (1996).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Icosahedron {
    /// Number of closed shells about the central atom.
    pub shells: usize,
    /// Number of facets of the next shell, 0 to 19, beginning around one vertex.
    pub facets: usize,
}

/// Radial divided by tangential distance of neighbours: circumscribed radius divided by edge of an icosahedron, sin 72 degrees.
const RATIO: f64 = 0.951_056_516_295_153_6;
/// Tangential distance in units of the bulk bond, at the least energy of springs between neighbours, half of which are radial.
const TANGENTIAL: f64 = (1.0 + RATIO) / (1.0 + RATIO * RATIO);

/// Returns the vertices, at distance 1.
fn vertices() -> [Vec3; 12] {
    let (height, width) = (1.0 / 5f64.sqrt(), 2.0 / 5f64.sqrt());
    std::array::from_fn(|n| match n {
        0 => [0.0, 0.0, 1.0],
        11 => [0.0, 0.0, -1.0],
        _ => {
            let upper = n <= 5;
            let turn = (n - 1) % 5;
            let angle = std::f64::consts::PI / 5.0 * (2 * turn + usize::from(!upper)) as f64;
            let z = if upper { height } else { -height };
            [width * libm::cos(angle), width * libm::sin(angle), z]
        }
    })
}

/// Returns triples of neighbouring vertices, from the top down.
fn faces(v: &[Vec3; 12]) -> Vec<[usize; 3]> {
    let near = |a: usize, b: usize| norm(subtract(v[a], v[b])) < 1.1;
    let mut faces = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(a, c) {
                    faces.push([a, b, c]);
                }
            }
        }
    }
    let height = |f: &[usize; 3]| f.iter().map(|&n| v[n][2]).sum::<f64>();
    // The sort is stable: facets of one ring keep their order.
    faces.sort_by(|a, b| ((height(b) * 1e6).round()).total_cmp(&(height(a) * 1e6).round()));
    faces
}

/// For each number of facets: the number of their edges, and of vertices that belong to at least three of them.
static BORDERS: LazyLock<[[usize; 2]; 21]> = LazyLock::new(|| {
    let faces = faces(&vertices());
    std::array::from_fn(|facets| {
        let edge = |[a, b, c]: [usize; 3]| [[a, b], [b, c], [a, c]];
        let edges: BTreeSet<_> = faces[..facets].iter().copied().flat_map(edge).collect();
        let of_vertex = |v: usize| faces[..facets].iter().filter(|f| f.contains(&v)).count();
        [edges.len(), (0..12).filter(|v| of_vertex(*v) >= 3).count()]
    })
});

/// Returns a five-fold, a three-fold and a two-fold axis.
pub(super) fn axes() -> [Vec3; 3] {
    let v = vertices();
    let sum = |of: &[usize]| [0, 1, 2].map(|k| of.iter().map(|&n| v[n][k]).sum::<f64>());
    [v[0], sum(&[0, 1, 2]), sum(&[0, 1])]
}

/// A lattice point of a shell: vertices, and the number of steps towards each; the numbers add to the number of the shell.
type ShellPlace = [(usize, usize); 3];

/// Returns the atoms of `shell` that belong to `facets` (by rank). A vertex is only included if three of its facets are, since it would
/// otherwise have fewer than five neighbours.
fn places(shell: usize, faces: &[[usize; 3]], facets: usize) -> Vec<ShellPlace> {
    let mut out: Vec<ShellPlace> = Vec::new();
    for face in &faces[..facets] {
        for i in 0..=shell {
            for j in 0..=shell - i {
                let steps = [i, j, shell - i - j];
                let mut place = [0, 1, 2].map(|k| (face[k], steps[k]));
                // An atom must have one name in all its facets.
                place.iter_mut().filter(|(_, n)| *n == 0).for_each(|p| p.0 = usize::MAX);
                place.sort_unstable();
                out.push(place);
            }
        }
    }
    out.sort_unstable();
    let mut kept: Vec<ShellPlace> = Vec::new();
    for group in out.chunk_by(|a, b| a == b) {
        let vertex = group[0].iter().any(|(_, n)| *n == shell);
        if !vertex || group.len() >= 3 {
            kept.push(group[0]);
        }
    }
    kept
}

impl Candidate for Icosahedron {
    const MORPHOLOGY: Morphology = Morphology::Icosahedral;

    fn count(&self) -> usize {
        let n = self.shells;
        let closed = (10 * n * n * n + 15 * n * n + 11 * n) / 3 + 1;
        // Atoms of the next shell: inside facets, on edges between vertices, and on vertices.
        let [edges, vertices] = BORDERS[self.facets];
        closed + self.facets * (n * n.saturating_sub(1) / 2) + edges * n + vertices
    }

    fn cluster(&self, metal: &Metal) -> Cluster {
        let v = vertices();
        let faces = faces(&v);
        let radial = TANGENTIAL * RATIO * metal.bond();
        let mut positions = vec![[0.0; 3]];
        for shell in 1..=self.shells + 1 {
            let facets = if shell > self.shells { self.facets } else { 20 };
            for place in places(shell, &faces, facets) {
                let steps = place.iter().filter(|(_, n)| *n > 0);
                let mut at = [0.0; 3];
                for &(vertex, n) in steps {
                    (0..3).for_each(|k| at[k] += radial * n as f64 * v[vertex][k]);
                }
                positions.push(at);
            }
        }
        debug_assert!(positions.iter().all(|p| dot(*p, *p).is_finite()));
        Cluster::centred(positions)
    }

    fn key(&self) -> [u64; 4] {
        [self.shells, self.facets, 0, 0].map(|n| n as u64)
    }
}

/// Returns icosahedra of about this diameter.
pub(super) fn candidates(metal: &Metal, diameter_nm: f64) -> Vec<Icosahedron> {
    let wanted = metal.count(diameter_nm);
    let mut out = Vec::new();
    for shells in 1.. {
        let closed = Icosahedron { shells, facets: 0 }.count() as f64;
        if closed > 2.0 * wanted {
            break;
        }
        let next = Icosahedron { shells: shells + 1, facets: 0 }.count() as f64;
        if next < 0.5 * wanted {
            continue;
        }
        out.extend((0..20).map(|facets| Icosahedron { shells, facets }));
    }
    out
}
