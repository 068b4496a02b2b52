//! How the lattice of a crystal fits another one across a plane interface.

use crate::structure::lattice::gcd;

/// Largest number of cells of either crystal in a coincidence.
pub const MOST_CELLS: usize = 60;
/// Largest number of cells of one crystal on one cell of the other in a coherent interface.
const MOST_COHERENT: usize = 4;

/// Numbers of cells of two crystals that lie on each other along one direction of the interface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CellMatch {
    /// Cells of the crystal that is fitted.
    pub own: usize,
    /// Cells of the crystal that it is fitted to.
    pub reference: usize,
    /// Strain of the fitted crystal: (length after) / (length before) - 1.
    pub strain: f64,
}

impl CellMatch {
    fn new([own, reference]: [usize; 2], [own_length, reference_length]: [f64; 2]) -> Self {
        let strain = reference as f64 * reference_length / (own as f64 * own_length) - 1.0;
        CellMatch { own, reference, strain }
    }
}

/// Returns the coherent match of cells of the lengths `own` and `reference` in Angstrom: n cells on one, or one on n, with the least strain.
pub fn coherent(own: f64, reference: f64) -> CellMatch {
    let pairs = (1..=MOST_COHERENT).flat_map(|n| [[1, n], [n, 1]]);
    least(pairs, [own, reference])
}

/// Returns the match of the fewest cells, at most [`MOST_CELLS`] of either crystal, whose strain is at most `most` in size.
pub fn coincident(own: f64, reference: f64, most: f64) -> Option<CellMatch> {
    let lengths = [own, reference];
    let mut pairs: Vec<[usize; 2]> = coprime_pairs().collect();
    pairs.sort_by_key(|[m, n]| (m + n, *m));
    let found = pairs.into_iter().map(|pair| CellMatch::new(pair, lengths));
    found.into_iter().find(|found| found.strain.abs() <= most)
}

/// Returns the match of at most [`MOST_CELLS`] cells of either crystal with the least strain.
pub fn closest(own: f64, reference: f64) -> CellMatch {
    least(coprime_pairs(), [own, reference])
}

fn coprime_pairs() -> impl Iterator<Item = [usize; 2]> {
    let all = (1..=MOST_CELLS).flat_map(|m| (1..=MOST_CELLS).map(move |n| [m, n]));
    all.filter(|[m, n]| gcd(*m, *n) == 1)
}

fn least(pairs: impl Iterator<Item = [usize; 2]>, lengths: [f64; 2]) -> CellMatch {
    let size = |found: &CellMatch| (found.strain.abs(), found.own + found.reference);
    let found = pairs.map(|pair| CellMatch::new(pair, lengths));
    let best =
        found.min_by(|a, b| size(a).partial_cmp(&size(b)).unwrap_or(std::cmp::Ordering::Equal));
    best.unwrap_or(CellMatch { own: 1, reference: 1, strain: lengths[1] / lengths[0] - 1.0 })
}

/// Returns the strain normal to an interface of a layer with the strains `in_plane` along two perpendicular directions of the interface,
/// and no stress normal to it: -nu / (1 - nu) (e1 + e2), isotropic elasticity with Poisson's ratio nu (J. W. Matthews and A. E. Blakeslee,
/// J. Cryst. Growth 27 (1974) 118). Free surfaces along the beam do not relax.
pub fn normal_strain(in_plane: [f64; 2], poisson_ratio: f64) -> f64 {
    -poisson_ratio / (1.0 - poisson_ratio) * (in_plane[0] + in_plane[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_matched_with_the_strain_that_they_need() {
        // LaAlO3 (pseudocubic, 3.790 A) on SrTiO3 (3.905 A).
        let one = coherent(3.790, 3.905);
        assert_eq!((one.own, one.reference), (1, 1));
        assert!((one.strain - 0.030_343).abs() < 1e-6);
        // Two cells of 2 A on one of 4.1 A.
        let two = coherent(2.0, 4.1);
        assert!((two.own, two.reference) == (2, 1) && (two.strain - 0.025).abs() < 1e-12);
        let few = coincident(3.790, 3.905, 0.005).unwrap();
        assert_eq!((few.own, few.reference), (30, 29));
        assert!(few.strain.abs() <= 0.005);
        assert!(coincident(3.790, 3.905, 1e-9).is_none());
        assert!(closest(3.790, 3.905).strain.abs() < few.strain.abs());
    }

    /// Silicon on germanium: a strained by 4.17 %, and the ratio 1/3 gives minus the in-plane strain along the normal.
    #[test]
    fn the_normal_strain_follows_poisson() {
        let e = 5.6578 / 5.431 - 1.0;
        assert!((normal_strain([e, e], 1.0 / 3.0) + e).abs() < 1e-12);
        assert_eq!(normal_strain([e, e], 0.0), 0.0);
    }
}
