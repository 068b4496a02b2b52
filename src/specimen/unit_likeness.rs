//! What decides whether two units of columns that were found among any atoms may share an image.

use super::held_columns::HeldColumns;
use super::sites::{SiteKind, SpecimenSite};
use crate::lengths;
use crate::plane;
use crate::recipe::region::Region;

/// Columns up to this distance from the centre of a unit are compared, in Angstrom. A column farther away changes the image of a thin
/// crystal by little.
pub(super) const COMPARED_ANGSTROM: f64 = 6.0;
/// Width in Angstrom about that distance in which a column may have its counterpart.
const EDGE_ANGSTROM: f64 = 0.3;
/// Largest difference of the sites of a unit across the beam, in Angstrom.
const ACROSS_ANGSTROM: f64 = 0.05;
/// Largest difference of the sites of a unit along the beam, in Angstrom.
const ALONG_ANGSTROM: f64 = 0.15;
/// Largest sum of the differences in strength of the sites, as a share of the strongest column among unit and neighbours. So light atoms of
/// a thick column may be missing at other depths.
const EXCHANGED: f64 = 0.02;
/// Largest difference in the place of a neighbour: a length in Angstrom, and a share of its distance.
const NEIGHBOUR: [f64; 2] = [0.03, 0.02];
/// Largest difference in the strength of a neighbour, as a share of the stronger one, and as a share of the strongest column: the larger one
/// counts.
const STRENGTH: [f64; 2] = [0.2, 0.05];
/// Power of the atomic number that an atom scatters with at high angles.
const SCATTERING_POWER: f64 = 1.7;
/// Direction (x, y) along which neighbours are sorted. In crystals, few rows of columns are perpendicular to it.
const SORTED_ALONG: [f64; 2] = [0.848, 0.530];

/// A site of a unit: its place in Angstrom from the centre of the unit and from the entrance surface, and its atom, 0 for none.
struct ComparedSite {
    position: [f64; 3],
    number: u8,
}

/// A neighbour of a unit.
struct Neighbour {
    /// Place along [`SORTED_ALONG`].
    order: f64,
    /// Place (x, y) in Angstrom from the centre of the unit.
    at: [f64; 2],
    strength: f64,
}

/// The contents and the neighbours of a unit.
pub(super) struct UnitLikeness {
    sites: Vec<ComparedSite>,
    neighbours: Vec<Neighbour>,
    /// Places (x, y) of the members in Angstrom from the centre.
    members: Vec<[f64; 2]>,
    /// Strength of the strongest column among members and neighbours.
    strongest: f64,
}

/// The atomic number of the atom on a site; 0 for a vacancy.
pub(super) fn held_number(site: &SpecimenSite) -> u8 {
    if site.kind == SiteKind::Vacancy { 0 } else { site.number }
}

impl UnitLikeness {
    /// The contents and neighbours of the unit with these members and this centre (x, y) in nm; `strengths` are of all columns.
    pub(super) fn of(
        (columns, strengths): (&HeldColumns, &[f64]),
        members: &[u32],
        centre_nm: [f64; 2],
    ) -> Self {
        let from = |nm: [f64; 2]| lengths::angstrom(plane::sub(nm, centre_nm));
        let all = members.iter().flat_map(|m| columns.sites(*m as usize));
        let site = |s: &SpecimenSite| {
            let [x, y, z] = s.position_nm;
            let [x, y] = from([x, y]);
            ComparedSite { position: [x, y, lengths::angstrom(z)], number: held_number(s) }
        };
        let reach = COMPARED_ANGSTROM + EDGE_ANGSTROM;
        let around = Region::centred(centre_nm, [lengths::nm(2.0 * reach); 2]);
        let others = columns.inside(&around).filter(|n| !members.contains(&(*n as u32)));
        let neighbour = |n: usize| {
            let at = from(columns.position_nm(n));
            let strength = strengths[n];
            let order = at[0] * SORTED_ALONG[0] + at[1] * SORTED_ALONG[1];
            Neighbour { order, at, strength }
        };
        let mut neighbours: Vec<Neighbour> = others.map(neighbour).collect();
        neighbours.retain(|n| length(n.at) < reach);
        neighbours.sort_by(|a, b| a.order.total_cmp(&b.order));
        let own = members.iter().map(|m| strengths[*m as usize]);
        let strengths = neighbours.iter().map(|n| n.strength).chain(own);
        UnitLikeness {
            strongest: strengths.fold(0.0, f64::max),
            sites: all.map(site).collect(),
            neighbours,
            members: members.iter().map(|m| from(columns.position_nm(*m as usize))).collect(),
        }
    }

    /// The atoms of the unit in a form that equal units share: all atomic numbers, and the depth of the first site.
    pub(super) fn contents(&self) -> Vec<u8> {
        let first = self.sites.first().map_or(0.0, |site| site.position[2]);
        let depth = (first / (2.0 * ALONG_ANGSTROM)).round() as i32;
        let mut numbers: Vec<u8> = self.sites.iter().map(|site| site.number).collect();
        numbers.sort_unstable();
        numbers.extend(depth.to_le_bytes());
        numbers
    }

    /// Whether the units may share an image.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        let same = |(a, b): (&ComparedSite, &ComparedSite)| {
            let d = [0, 1, 2].map(|k| a.position[k] - b.position[k]);
            d[2].abs() < ALONG_ANGSTROM && length([d[0], d[1]]) < ACROSS_ANGSTROM
        };
        let exchanged = |(a, b): (&ComparedSite, &ComparedSite)| match a.number == b.number {
            true => 0.0,
            false => (strength(a.number) - strength(b.number)).abs(),
        };
        let pairs = || self.sites.iter().zip(&other.sites);
        self.sites.len() == other.sites.len()
            && self.members.len() == other.members.len()
            && pairs().all(same)
            && pairs().map(exchanged).sum::<f64>() <= EXCHANGED * self.strongest
            && self.has_neighbours_of(other)
            && other.has_neighbours_of(self)
    }

    /// Whether each of the other unit's neighbours has a counterpart here.
    fn has_neighbours_of(&self, other: &Self) -> bool {
        let near = other.neighbours.iter().filter(|n| length(n.at) < COMPARED_ANGSTROM);
        near.into_iter().all(|n| {
            let within = NEIGHBOUR[0] + NEIGHBOUR[1] * length(n.at);
            let first = self.neighbours.partition_point(|own| own.order < n.order - within);
            let candidates = self.neighbours[first..].iter();
            let mut candidates = candidates.take_while(|own| own.order <= n.order + within);
            candidates.any(|own| {
                let unlike = (own.strength - n.strength).abs();
                let most = STRENGTH[0] * own.strength.max(n.strength);
                length(plane::sub(own.at, n.at)) < within
                    && unlike <= most.max(STRENGTH[1] * self.strongest)
            })
        })
    }

    /// The ranges (x, y) in Angstrom about the centre of the places that show this unit: no other column is nearer by more than `shared`
    /// square Angstrom, and the unit lies within `most` Angstrom.
    pub(super) fn shown(&self, shared: f64, most: f64) -> [[f64; 2]; 2] {
        const STEP: f64 = 0.1;
        let reach = self.members.iter().map(|m| length(*m)).fold(0.0, f64::max) + most;
        let steps = (reach / STEP).ceil() as i32;
        let square = |at: [f64; 2], p: &[f64; 2]| {
            let d = plane::sub(at, *p);
            d[0] * d[0] + d[1] * d[1]
        };
        let mut ranges = [[0.0f64; 2]; 2];
        for (i, j) in (-steps..=steps).flat_map(|j| (-steps..=steps).map(move |i| (i, j))) {
            let at = [i, j].map(|n| f64::from(n) * STEP);
            let own = self.members.iter().map(|m| square(at, m)).fold(f64::INFINITY, f64::min);
            let others = self.neighbours.iter().map(|n| square(at, &n.at));
            if own <= most * most && own - others.fold(own, f64::min) <= shared {
                ranges = plane::per_axis(ranges, at, |[low, high], v| [low.min(v), high.max(v)]);
            }
        }
        ranges
    }
}

fn length([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

/// The strength of each column: how much its atoms scatter at high angles.
pub(super) fn strengths(columns: &HeldColumns) -> Vec<f64> {
    let of_number: Vec<f64> = (0..=u8::MAX).map(strength).collect();
    let of_site = |site: &SpecimenSite| of_number[usize::from(held_number(site))];
    (0..columns.len()).map(|n| columns.sites(n).iter().map(of_site).sum()).collect()
}

fn strength(number: u8) -> f64 {
    libm::pow(f64::from(number), SCATTERING_POWER)
}
