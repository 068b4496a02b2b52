//! The box of atoms, the column of the defect in it, and the atoms that the defect changes.

use std::collections::BTreeMap;

use super::asked_defect::{AskedDefect, DefectDepth, DefectForm};
use super::detectability_request::{DetectabilityRequest, column_elements};
use crate::engine::Site;
use crate::error::{Error, Result};
use crate::lengths;
use crate::setting::Setting;
use crate::simulation::{PreparedSpecimen, SigmaChoice};
use crate::structure::{ROOM_TEMPERATURE_K, elements, tabulated_sigma_angstrom};

/// Atoms of one column lie within this distance of the chosen atom, in projection, in Angstrom.
const SAME_COLUMN_ANGSTROM: f64 = 0.4;
/// Farthest column from a place that is asked for, in Angstrom.
const FARTHEST_ANGSTROM: f64 = 1.5;
/// Lengths in Angstrom are compared in these steps, so that rounding decides nothing.
const STEP_ANGSTROM: f64 = 1e-3;
/// Columns near the centre among which one is chosen.
const MOST_COLUMNS: usize = 64;
/// Most depths that stand for all depths of a column.
const MOST_DEPTHS: usize = 8;

/// The column that holds a defect.
#[derive(Debug, Clone, PartialEq)]
pub struct DefectSite {
    /// Place (x, y) of the column in Angstrom.
    pub centre: [f64; 2],
    /// Indices of the atoms of the column, by rising height.
    pub column: Vec<usize>,
    /// Indices of the changed atoms, for each form that the defect can have: one, or one for each depth.
    pub variants: Vec<Vec<usize>>,
    /// Elements of the column with their numbers of atoms: `Ti26 O26`.
    pub composition: String,
}

/// Prepares atoms without defects: in a box that is at least `width` wide (Angstrom), and as thick as asked.
pub fn pristine(
    request: &DetectabilityRequest,
    thickness_nm: Option<f64>,
    width: f64,
) -> Result<PreparedSpecimen> {
    let mut specimen = request.specimen.clone();
    specimen.phonons = Some(request.configurations);
    if specimen.repeat.is_none() {
        let cell = specimen.prepare(&request.structure)?.size_angstrom;
        let across = |k: usize| ((width / cell[k]).ceil() as usize).max(1);
        let along =
            thickness_nm.map_or(1.0, |nm| (lengths::angstrom(nm) / cell[2]).round().max(1.0));
        specimen.repeat = Some([across(0), across(1), along as usize]);
    }
    specimen.prepare(&request.structure)
}

impl DefectSite {
    /// Finds the column of a defect.
    ///
    /// # Errors
    /// [`Error::Invalid`] if no column of the atoms holds the element, or none is where it is asked for.
    pub fn find(
        request: &DetectabilityRequest,
        defect: &AskedDefect,
        atoms: &PreparedSpecimen,
    ) -> Result<Self> {
        let places = places(&atoms.sites, defect.element());
        if places.is_empty() {
            let held: Vec<&str> = atoms.composition().into_keys().collect();
            let expected = format!("the atoms have none of this element, only {}", held.join(", "));
            return Err(Error::invalid(Setting::Defect, defect, expected));
        }
        let [x, y, thickness] = atoms.size_angstrom;
        let from = request.site_angstrom.unwrap_or([0.5 * x, 0.5 * y]);
        let steps = |index: usize| {
            let [a, b, _] = atoms.sites[index].position;
            ((a - from[0]).hypot(b - from[1]) / STEP_ANGSTROM).round() as u64
        };
        let mut near: Vec<usize> = places;
        near.sort_by_key(|index| (steps(*index), *index));
        near.truncate(MOST_COLUMNS);
        let columns: Vec<Vec<usize>> = near.iter().map(|i| column(&atoms.sites, *i)).collect();
        let chosen = match (&request.column, request.site_angstrom) {
            (Some(text), _) => {
                let wanted = column_elements(text)?;
                let fits = |c: &&Vec<usize>| held(&atoms.sites, c) == wanted;
                let found = columns.iter().find(fits);
                found.ok_or_else(|| no_column(text, defect, &atoms.sites, &columns))?
            }
            (None, Some(_)) => &columns[0],
            // The first of the columns with the fewest elements is the nearest to the centre.
            (None, None) => {
                let fewest = columns.iter().min_by_key(|c| held(&atoms.sites, c).len());
                fewest.unwrap_or(&columns[0])
            }
        };
        let own = |index: &&usize| atoms.sites[**index].number == defect.element();
        let hosts: Vec<usize> = chosen.iter().filter(own).copied().collect();
        let centre = mean_place(&atoms.sites, &hosts);
        if let Some(asked) = request.site_angstrom {
            let distance = (centre[0] - asked[0]).hypot(centre[1] - asked[1]);
            if distance.is_nan() || distance > FARTHEST_ANGSTROM {
                let value = format!("({}, {}) A", asked[0], asked[1]);
                let expected = format!(
                    "the nearest column with this element is at ({:.2}, {:.2}) A, {distance:.1} A away; give its place",
                    centre[0], centre[1]
                );
                return Err(Error::invalid(Setting::DefectSite, value, expected));
            }
        }
        Ok(DefectSite {
            centre,
            variants: variants(defect, &atoms.sites, &hosts, chosen, thickness),
            composition: composition(&atoms.sites, chosen),
            column: chosen.clone(),
        })
    }

    /// The atoms with a form of the defect. Atoms that stay keep their keys, and with them their displacements.
    pub fn with_defect(
        &self,
        request: &DetectabilityRequest,
        defect: &AskedDefect,
        sites: &[Site],
        variant: usize,
    ) -> Result<Vec<Site>> {
        let changed = &self.variants[variant];
        let others = sites.iter().enumerate().filter(|(index, _)| !changed.contains(index));
        let mut all: Vec<Site> = others.map(|(_, site)| *site).collect();
        if let DefectForm::Substitution(_, by) = defect.form {
            for index in changed {
                let site = sites[*index];
                let sigma_angstrom = sigma_of(request, by)?.unwrap_or(site.sigma_angstrom);
                all.push(Site { number: by, sigma_angstrom, ..site });
            }
        }
        Ok(all)
    }

    /// The atoms with the column moved by (x, y) in Angstrom.
    pub fn with_column_moved(&self, sites: &[Site], by: [f64; 2]) -> Vec<Site> {
        let mut all = sites.to_vec();
        for index in &self.column {
            (0..2).for_each(|k| all[*index].position[k] += by[k]);
        }
        all
    }
}

/// The vibration of an element by the request, in Angstrom; `None` if the request has none, as for a dopant that a recipe leaves out.
fn sigma_of(request: &DetectabilityRequest, number: u8) -> Result<Option<f64>> {
    Ok(match &request.specimen.sigma_angstrom {
        Some(SigmaChoice::All(sigma)) => Some(*sigma),
        Some(SigmaChoice::ByElement(by_symbol)) => {
            let own = |symbol: &&String| elements::atomic_number(symbol).is_ok_and(|n| n == number);
            by_symbol.keys().find(own).and_then(|symbol| by_symbol.get(symbol)).copied()
        }
        Some(SigmaChoice::FromTable(_)) => {
            let kelvin = request.specimen.temperature_k.unwrap_or(ROOM_TEMPERATURE_K);
            Some(tabulated_sigma_angstrom(number, kelvin)?)
        }
        Some(SigmaChoice::FromFile(_)) | None => None,
    })
}

/// One atom of each column that holds an element.
fn places(sites: &[Site], number: u8) -> Vec<usize> {
    let mut first = BTreeMap::new();
    for (index, site) in sites.iter().enumerate().filter(|(_, site)| site.number == number) {
        let step = |k: usize| (site.position[k] / STEP_ANGSTROM / 10.0).round() as i64;
        first.entry((step(0), step(1))).or_insert(index);
    }
    first.into_values().collect()
}

/// The atoms of the column of an atom, by rising height.
fn column(sites: &[Site], index: usize) -> Vec<usize> {
    let [x, y, _] = sites[index].position;
    let near =
        |site: &Site| (site.position[0] - x).hypot(site.position[1] - y) <= SAME_COLUMN_ANGSTROM;
    let mut all: Vec<usize> = (0..sites.len()).filter(|i| near(&sites[*i])).collect();
    all.sort_by(|a, b| sites[*a].position[2].total_cmp(&sites[*b].position[2]));
    all
}

/// The elements (atomic numbers) of a column, in rising order.
fn held(sites: &[Site], column: &[usize]) -> Vec<u8> {
    let mut numbers: Vec<u8> = column.iter().map(|index| sites[*index].number).collect();
    numbers.sort_unstable();
    numbers.dedup();
    numbers
}

fn mean_place(sites: &[Site], atoms: &[usize]) -> [f64; 2] {
    [0, 1].map(|k| {
        let sum: f64 = atoms.iter().map(|index| sites[*index].position[k]).sum();
        sum / atoms.len() as f64
    })
}

/// Elements with their numbers of atoms, the heaviest first.
fn composition(sites: &[Site], column: &[usize]) -> String {
    let count = |number: u8| column.iter().filter(|index| sites[**index].number == number).count();
    let mut numbers = held(sites, column);
    numbers.reverse();
    let one = |number: &u8| format!("{}{}", elements::symbol(*number), count(*number));
    numbers.iter().map(one).collect::<Vec<_>>().join(" ")
}

fn no_column(text: &str, defect: &AskedDefect, sites: &[Site], columns: &[Vec<usize>]) -> Error {
    let name = |column: &Vec<usize>| {
        let symbols = held(sites, column).into_iter().rev().map(elements::symbol);
        symbols.collect::<Vec<_>>().join("-")
    };
    let mut known: Vec<String> = columns.iter().map(name).collect();
    known.sort();
    known.dedup();
    let symbol = elements::symbol(defect.element());
    let expected = format!("columns that hold {symbol} are {}", known.join(", "));
    Error::invalid(Setting::DefectSite, text, expected)
}

/// The changed atoms for each form of a defect.
fn variants(
    defect: &AskedDefect,
    sites: &[Site],
    hosts: &[usize],
    column: &[usize],
    thickness: f64,
) -> Vec<Vec<usize>> {
    if let DefectForm::Column(_) = defect.form {
        return vec![column.to_vec()];
    }
    match defect.depth {
        DefectDepth::Any => {
            let count = hosts.len().min(MOST_DEPTHS);
            let each = |k: usize| hosts[(2 * k + 1) * hosts.len() / (2 * count)];
            (0..count).map(|k| vec![each(k)]).collect()
        }
        DefectDepth::Fraction(part) => {
            let off = |index: &usize| {
                ((sites[*index].position[2] - part * thickness).abs() / STEP_ANGSTROM).round()
                    as u64
            };
            let nearest = hosts.iter().copied().min_by_key(|index| (off(index), *index));
            vec![nearest.into_iter().collect()]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recipe::{Difficulty, Recipe};

    fn request(defect: &str) -> DetectabilityRequest {
        let recipe = Recipe::load("srtio3", Difficulty::Easy).unwrap().checked().unwrap();
        let mut request = DetectabilityRequest::of_recipe(&recipe).unwrap();
        request.defects = vec![defect.parse().unwrap()];
        request
    }

    fn found(request: &DetectabilityRequest) -> (PreparedSpecimen, Result<DefectSite>) {
        let atoms = pristine(request, Some(4.0), 11.0).unwrap();
        let site = DefectSite::find(request, &request.defects[0], &atoms);
        (atoms, site)
    }

    #[test]
    fn the_purest_column_nearest_to_the_centre_is_chosen() {
        let (atoms, site) = found(&request("vacancy:O"));
        let site = site.unwrap();
        assert_eq!(site.composition, "O10");
        assert!(atoms.size_angstrom[0] >= 11.0 && (atoms.size_angstrom[2] - 39.05).abs() < 1e-9);
        let height = atoms.sites[site.variants[0][0]].position[2];
        assert!((height - 0.5 * 39.05).abs() < 2.0, "{height}");
        let middle = 0.5 * atoms.size_angstrom[0];
        assert!((site.centre[0] - middle).hypot(site.centre[1] - middle) < 3.0);
    }

    #[test]
    fn columns_can_be_named() {
        let mut request = request("vacancy:O@top");
        request.column = Some("Ti-O".to_owned());
        let (atoms, site) = found(&request);
        let site = site.unwrap();
        assert_eq!(site.composition, "Ti10 O10");
        assert!(atoms.sites[site.variants[0][0]].position[2] < 3.0);
        request.column = Some("Sr-O".to_owned());
        let said = found(&request).1.unwrap_err().to_string();
        assert!(said.contains("O, Ti-O"), "{said}");
        request.column = None;
        request.site_angstrom = Some([0.0, 0.0]);
        let said = found(&request).1.unwrap_err().to_string();
        assert!(said.contains("the nearest column with this element"), "{said}");
        request.defects = vec!["vacancy:Nb".parse().unwrap()];
        assert!(found(&request).1.unwrap_err().to_string().contains("only O, Sr, Ti"));
    }

    #[test]
    fn a_defect_keeps_the_keys_of_all_other_atoms() {
        let request = request("substitution:Ti:Nb");
        let (atoms, site) = found(&request);
        let site = site.unwrap();
        let with = site.with_defect(&request, &request.defects[0], &atoms.sites, 0).unwrap();
        assert_eq!(with.len(), atoms.sites.len());
        let host = &atoms.sites[site.variants[0][0]];
        let guest = with.iter().find(|s| s.number == 41).unwrap();
        assert_eq!((guest.key, guest.position), (host.key, host.position));
        // The recipe has no displacement for niobium, which takes the displacement of titanium.
        assert_eq!(guest.sigma_angstrom, 0.060);
        let same = |s: &&Site| s.number != 41 && atoms.sites.contains(s);
        assert_eq!(with.iter().filter(same).count(), atoms.sites.len() - 1);
    }

    #[test]
    fn depths_and_columns_have_their_atoms() {
        let request = request("vacancy:O@any");
        let site = found(&request).1.unwrap();
        assert_eq!(site.variants.len(), 8);
        let column = self::request("column:Ti");
        let (atoms, site) = found(&column);
        let site = site.unwrap();
        let left = site.with_defect(&column, &column.defects[0], &atoms.sites, 0).unwrap();
        assert_eq!(left.len(), atoms.sites.len() - 20);
    }
}
