//! Finds the sites of a CIF that exclude each other: by `_atom_site_disorder_assembly` and `_atom_site_disorder_group`, or by the
//! alternative locations of mmCIF, `_atom_site.label_alt_id`, which are counted within each residue.

use std::collections::BTreeMap;

use super::atom_tables::CifSite;
use crate::structure::Alternative;
use crate::structure::overlap::FULLEST_SITE;

const GROUP: [&str; 1] = ["_atom_site_disorder_group"];
const ASSEMBLY: [&str; 1] = ["_atom_site_disorder_assembly"];
/// The alternative locations of mmCIF, used if no group is given.
const ALTERNATIVE: [&str; 1] = ["_atom_site_label_alt_id"];
/// Columns that name a residue of mmCIF: the chain, the number, and the code of inserted residues.
const RESIDUE: [&[&str]; 3] = [
    &["_atom_site_auth_asym_id", "_atom_site_label_asym_id"],
    &["_atom_site_auth_seq_id", "_atom_site_label_seq_id"],
    &["_atom_site_pdbx_pdb_ins_code"],
];
/// Occupancies that differ by less than this count as equal.
const SAME_OCCUPANCY: f64 = 0.01;

/// The groups of the sites: for each site the number of its assembly and of the group within it.
pub struct DisorderGroups {
    of_site: Vec<Option<[u32; 2]>>,
    /// Number of the place, by assembly and symmetry operation.
    places: BTreeMap<[u32; 2], u32>,
}

impl DisorderGroups {
    /// Reads the groups of a file. Where the file names no assemblies, groups of one number may belong to several; the assemblies are then
    /// distinguished by the occupancies. Assemblies whose groups add to more than 1 are left out, which is reported in `notes`.
    pub fn of(sites: &[CifSite], notes: &mut Vec<String>) -> Self {
        let mut named: BTreeMap<String, BTreeMap<&str, Vec<usize>>> = BTreeMap::new();
        for (index, site) in sites.iter().enumerate() {
            let Some((assembly, group)) = group(site).filter(|_| site.atom.occupancy < 1.0) else {
                continue;
            };
            named.entry(assembly).or_default().entry(group).or_default().push(index);
        }
        if let Some(unnamed) = named.remove("") {
            named.extend(by_occupancy(sites, unnamed));
        }
        let mut of_site = vec![None; sites.len()];
        for (number, (assembly, groups)) in named.iter().enumerate() {
            let fullest = |members: &Vec<usize>| {
                members.iter().map(|&m| sites[m].atom.occupancy).fold(0.0, f64::max)
            };
            let total: f64 = groups.values().map(fullest).sum();
            if total > FULLEST_SITE {
                let name = assembly.trim_start_matches('.');
                notes.push(format!(
                    "disorder assembly `{name}`: the occupancies of its groups add to {total:.3}, more than 1; the groups \
                     were left out, and only sites closer than any bond exclude each other"
                ));
                continue;
            }
            for (group, members) in groups.values().enumerate() {
                members.iter().for_each(|&m| of_site[m] = Some([number as u32, group as u32]));
            }
        }
        DisorderGroups { of_site, places: BTreeMap::new() }
    }

    /// Returns the alternative of a site's image by a symmetry operation.
    pub fn alternative(&mut self, site: usize, operation: usize) -> Option<Alternative> {
        let [assembly, choice] = self.of_site[site]?;
        let next = self.places.len() as u32;
        let place = *self.places.entry([assembly, operation as u32]).or_insert(next);
        Some(Alternative { place, choice })
    }
}

/// Returns the assembly of a site, empty if it is not named, and the group in it.
fn group<'a>(site: &CifSite<'_, 'a>) -> Option<(String, &'a str)> {
    if let Some(group) = site.value(&GROUP) {
        return Some((site.value(&ASSEMBLY).unwrap_or("").to_owned(), group));
    }
    let alternative = site.value(&ALTERNATIVE)?;
    let residue: Vec<&str> = RESIDUE.iter().filter_map(|tags| site.value(tags)).collect();
    Some((residue.join(" "), alternative))
}

/// Forms assemblies that are not named: one if the occupancies allow it, or else one for each pair of occupancies that add to 1.
fn by_occupancy<'a>(
    sites: &[CifSite],
    groups: BTreeMap<&'a str, Vec<usize>>,
) -> BTreeMap<String, BTreeMap<&'a str, Vec<usize>>> {
    let first: Vec<f64> = groups
        .values()
        .next()
        .map(|members| members.iter().map(|&m| sites[m].atom.occupancy).collect())
        .unwrap_or_default();
    let even = first.iter().all(|o| (o - first[0]).abs() < SAME_OCCUPANCY);
    let mut assemblies: BTreeMap<String, BTreeMap<&str, Vec<usize>>> = BTreeMap::new();
    for (position, (group, members)) in groups.into_iter().enumerate() {
        for member in members {
            let occupancy = sites[member].atom.occupancy;
            let share = if position == 0 { occupancy } else { 1.0 - occupancy };
            let name = match even {
                true => ".".to_owned(),
                false => format!(".{}", (share / SAME_OCCUPANCY).round()),
            };
            assemblies.entry(name).or_default().entry(group).or_default().push(member);
        }
    }
    assemblies
}
