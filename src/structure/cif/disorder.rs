//! Which sites of a CIF exclude each other: `_atom_site_disorder_assembly` and `_atom_site_disorder_group`, or the alternative locations of
//! mmCIF, `_atom_site.label_alt_id`, of which each residue has its own.

use std::collections::BTreeMap;

use super::atom_tables::CifSite;
use crate::structure::Alternative;
use crate::structure::overlap::FULLEST_SITE;

const GROUP: [&str; 1] = ["_atom_site_disorder_group"];
const ASSEMBLY: [&str; 1] = ["_atom_site_disorder_assembly"];
/// The alternative locations of mmCIF, used where the group is not given.
const ALTERNATIVE: [&str; 1] = ["_atom_site_label_alt_id"];
/// What names a residue of mmCIF: the chain, the number, and the code of inserted residues.
const RESIDUE: [&[&str]; 3] = [
    &["_atom_site_auth_asym_id", "_atom_site_label_asym_id"],
    &["_atom_site_auth_seq_id", "_atom_site_label_seq_id"],
    &["_atom_site_pdbx_pdb_ins_code"],
];
/// Occupancies that differ by less than this are one.
const SAME_OCCUPANCY: f64 = 0.01;

/// The groups of the sites: of each the assembly and the group within it, by number.
pub struct DisorderGroups {
    of_site: Vec<Option<[u32; 2]>>,
    /// Number of the place by assembly and symmetry operation.
    places: BTreeMap<[u32; 2], u32>,
}

impl DisorderGroups {
    /// The groups that a file gives. Where it names no assemblies, groups of one number may belong to several: sites are told apart
    /// by their occupancies then. Assemblies whose groups add to more than 1 are left out, and `notes` says so.
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

    /// The alternative that the image of a site by a symmetry operation is.
    pub fn alternative(&mut self, site: usize, operation: usize) -> Option<Alternative> {
        let [assembly, choice] = self.of_site[site]?;
        let next = self.places.len() as u32;
        let place = *self.places.entry([assembly, operation as u32]).or_insert(next);
        Some(Alternative { place, choice })
    }
}

/// The assembly of a site, empty where it is not named, and the group in it.
fn group<'a>(site: &CifSite<'_, 'a>) -> Option<(String, &'a str)> {
    if let Some(group) = site.value(&GROUP) {
        return Some((site.value(&ASSEMBLY).unwrap_or("").to_owned(), group));
    }
    let alternative = site.value(&ALTERNATIVE)?;
    let residue: Vec<&str> = RESIDUE.iter().filter_map(|tags| site.value(tags)).collect();
    Some((residue.join(" "), alternative))
}

/// Assemblies that are not named: one if the occupancies allow it, or else one for each pair of occupancies that add to 1.
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
