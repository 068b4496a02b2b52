//! Finds sites that exclude each other: shared sites, the alternatives of a place, and sites closer than any bond.

use std::collections::{BTreeMap, HashMap};
use std::ops::ControlFlow;

use super::neighbors::try_each_pair;
use super::overlap::FULLEST_SITE;
use super::{Alternative, Structure, elements, for_each_pair};

/// Atoms nearer than this, in Angstrom, share one site.
const SAME_SITE: f64 = 0.01;
/// Partly occupied sites nearer than this, in Angstrom, are never filled together ...
const SHORTEST_BOND: f64 = 1.2;
/// ... except C, N and O, whose shortest bonds are 1.10 A (nitrogen; 1.21 A between two O), ...
const SHORTEST_BOND_CNO: f64 = 1.0;
/// ... and hydrogen (0.74 A in H2).
const SHORTEST_BOND_H: f64 = 0.7;
/// Largest number of pairs that exclude each other, per atom, for which sites are still analysed ...
const MOST_PAIRS_EACH: usize = 16;
/// ... and in total.
const MOST_PAIRS: usize = 20_000_000;
/// Distances that differ by less than this in Angstrom are handled in the order of the atoms.
const SAME_DISTANCE: f32 = 1e-3;

/// Two partly occupied sites that are too close to be filled together, and too full to exclude each other.
#[derive(Debug, Clone, Copy)]
pub(super) struct CrowdedPair {
    pub atoms: [u32; 2],
    pub distance: f32,
}

/// The atoms of a structure in groups. At most one unit of each group is present: an atom, or the atoms of one [`Alternative`].
pub(super) struct ExclusiveSites {
    /// For each atom the smallest index in its group.
    group: Vec<usize>,
    /// For each atom the smallest index on its site.
    pub site: Vec<usize>,
    /// Close pairs that are in no group.
    pub crowded: Vec<CrowdedPair>,
}

/// Groups as a forest, whose roots are the smallest indices.
struct Forest(Vec<usize>);

impl Forest {
    fn root(&mut self, mut i: usize) -> usize {
        while self.0[i] != i {
            self.0[i] = self.0[self.0[i]];
            i = self.0[i];
        }
        i
    }

    fn join(&mut self, i: usize, j: usize) -> usize {
        let (a, b) = (self.root(i), self.root(j));
        let (low, high) = (a.min(b), a.max(b));
        self.0[high] = low;
        low
    }
}

impl ExclusiveSites {
    /// Groups the atoms. Nearer sites are joined before farther ones, as long as the occupancies of a group add to at most 1.
    pub fn of(structure: &Structure) -> Self {
        let count = structure.atoms.len();
        let mut site: Vec<usize> = (0..count).collect();
        if structure.atoms.iter().all(|a| a.occupancy == 1.0 && a.alternative.is_none()) {
            return ExclusiveSites { group: site.clone(), site, crowded: Vec::new() };
        }
        // `i` never decreases, so that `site[i]` is final when it is copied to j.
        for_each_pair(structure, SAME_SITE, |i, j, _| site[j] = site[j].min(site[i]));
        let mut close = close_pairs(structure);
        let mut forest = Forest((0..count).collect());
        let mut places: HashMap<u32, usize> = HashMap::new();
        for (i, atom) in structure.atoms.iter().enumerate() {
            forest.join(i, site[i]);
            if let Some(alternative) = atom.alternative {
                let first = *places.entry(alternative.place).or_insert(i);
                forest.join(i, first);
            }
        }
        let mut loads = vec![0.0; count];
        for unit in units(structure, &site, &(0..count).collect::<Vec<_>>()) {
            loads[forest.root(unit.atoms[0])] += unit.occupancy;
        }
        close.sort_by_key(|pair| ((pair.distance / SAME_DISTANCE) as u32, pair.atoms));
        close.retain(|pair| {
            let [i, j] = pair.atoms.map(|atom| forest.root(atom as usize));
            if i != j && loads[i] + loads[j] > FULLEST_SITE {
                return true;
            }
            if i != j {
                loads[forest.join(i, j)] = loads[i] + loads[j];
            }
            false
        });
        let group = (0..count).map(|i| forest.root(i)).collect();
        ExclusiveSites { group, site, crowded: close }
    }

    /// Returns the atoms of each group, at the index of its first atom; other entries are empty.
    pub fn members(&self) -> Vec<Vec<usize>> {
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); self.group.len()];
        for (index, &group) in self.group.iter().enumerate() {
            members[group].push(index);
        }
        members
    }
}

/// Atoms that are present together, and their occupancy.
pub(super) struct SiteUnit {
    /// The atoms; at least one.
    pub atoms: Vec<usize>,
    /// Sum of the occupancies on the unit's fullest site.
    pub occupancy: f64,
}

/// Returns the units among some atoms, in the order of their first atoms; `site` holds the smallest index on each atom's site.
pub(super) fn units(structure: &Structure, site: &[usize], members: &[usize]) -> Vec<SiteUnit> {
    let mut units: Vec<SiteUnit> = Vec::new();
    let mut known: HashMap<Alternative, usize> = HashMap::new();
    for &atom in members {
        let alternative = structure.atoms[atom].alternative;
        let at = match alternative {
            Some(alternative) => *known.entry(alternative).or_insert(units.len()),
            None => units.len(),
        };
        if at == units.len() {
            units.push(SiteUnit { atoms: Vec::new(), occupancy: 0.0 });
        }
        units[at].atoms.push(atom);
    }
    for unit in &mut units {
        let mut sums: BTreeMap<usize, f64> = BTreeMap::new();
        for &atom in &unit.atoms {
            *sums.entry(site[atom]).or_default() += structure.atoms[atom].occupancy;
        }
        unit.occupancy = sums.into_values().fold(0.0, f64::max);
    }
    units
}

/// Returns the pairs of sites that cannot be filled together. If there are too many pairs, only the first ones are returned.
fn close_pairs(structure: &Structure) -> Vec<CrowdedPair> {
    let most = MOST_PAIRS.min(structure.atoms.len().saturating_mul(MOST_PAIRS_EACH));
    let (mut close, mut seen) = (Vec::new(), 0);
    // The search may end anywhere in a crowd of atoms.
    let _ = try_each_pair(structure, SHORTEST_BOND, |i, j, distance| {
        seen += 1;
        if distance > SAME_SITE && i != j && excludes(structure, i, j, distance) {
            close.push(CrowdedPair { atoms: [i as u32, j as u32], distance: distance as f32 });
        }
        match close.len() > most || seen > 8 * most {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    });
    close
}

/// Whether two atoms at a distance in Angstrom cannot be present together.
fn excludes(structure: &Structure, i: usize, j: usize, distance: f64) -> bool {
    let (a, b) = (&structure.atoms[i], &structure.atoms[j]);
    let partly = a.occupancy < 1.0 || b.occupancy < 1.0;
    let together = a.alternative.is_some() && a.alternative == b.alternative;
    let organic = |number: u8| (6..=8).contains(&number);
    let shortest = match (a.number, b.number) {
        (1, _) | (_, 1) => SHORTEST_BOND_H,
        (8, 8) => SHORTEST_BOND,
        (a, b) if organic(a) && organic(b) => SHORTEST_BOND_CNO,
        _ => SHORTEST_BOND,
    };
    partly && !together && distance < shortest
}

impl Structure {
    /// Reports partly occupied sites that are closer than any bond, and too full to exclude each other.
    pub(crate) fn crowded_sites(&self) -> Option<String> {
        let crowded = ExclusiveSites::of(self).crowded;
        let CrowdedPair { atoms: [i, j], distance } = *crowded.first()?;
        let name = |atom: u32| {
            let atom = &self.atoms[atom as usize];
            format!("{} (occupancy {})", elements::symbol(atom.number), atom.occupancy)
        };
        Some(format!(
            "{} pairs of sites are closer than any bond, such as {} and {}, {distance:.2} A apart, and their occupancies \
             add to more than 1: some places will hold two atoms at once. Check the occupancies; in a CIF, \
             _atom_site_disorder_assembly and _atom_site_disorder_group say which sites exclude each other",
            crowded.len(),
            name(i),
            name(j)
        ))
    }
}
