//! Rows and pairs of vacancies in the undisturbed layers of a stack.

use std::collections::BTreeSet;

use super::filling::MadeSite;
use crate::error::{Error, Result};
use crate::lengths;
use crate::models::stack::least_distances::AtomBoxes;
use crate::recipe::stacked_crystals::{CheckedLines, StackedCrystals};
use crate::recipe::vacancy_groups_table::{DoubleVacancies, MissingAtoms, VacancyPair};
use crate::recipe::{CheckedRecipe, StackTable};
use crate::rng::{Purpose, uniform};
use crate::setting::Setting;
use crate::specimen::sites::SiteKind;
use crate::structure::elements;
use crate::structure::lattice::{Vec3, norm, subtract};

/// Sites whose (x, y) differ by less belong to one column, in Angstrom.
const COLUMN_ANGSTROM: f64 = 0.3;
/// Largest distance in Angstrom of a column of a row from the place that the recipe names.
const NEAREST_ANGSTROM: f64 = 10.0;
/// Largest distance in Angstrom of the two atoms of a double vacancy.
const PAIR_ANGSTROM: f64 = 6.0;
/// Pairs at up to this many times the shortest distance are neighbours.
const AS_NEAR: f64 = 1.1;
/// Number of places that are tried for one row.
const TRIES: u64 = 1000;
/// Streams of random numbers: rows use the first ones, double vacancies the others.
const OF_PAIRS: u32 = 1024;

/// Pristine sites of one element in one layer.
struct LayerSites {
    /// Their numbers among all sites.
    numbers: Vec<usize>,
    places: Vec<Vec3>,
    boxes: AtomBoxes,
}

impl LayerSites {
    fn of(sites: &[MadeSite], layer: usize, element: u8, edge: f64) -> Self {
        let wanted = |site: &MadeSite| {
            usize::from(site.layer) == layer
                && site.number == element
                && site.kind == SiteKind::Pristine
        };
        let numbers: Vec<usize> = (0..sites.len()).filter(|n| wanted(&sites[*n])).collect();
        let places: Vec<Vec3> = numbers.iter().map(|n| sites[*n].position).collect();
        let boxes = AtomBoxes::new(places.iter().copied(), edge);
        LayerSites { numbers, places, boxes }
    }
}

/// The columns of one element in one layer.
struct LayerColumns {
    sites: LayerSites,
    /// Members of each column by their height.
    members: Vec<Vec<usize>>,
    boxes: AtomBoxes,
}

impl LayerColumns {
    fn of(sites: &[MadeSite], layer: usize, element: u8) -> Self {
        let sites = LayerSites::of(sites, layer, element, NEAREST_ANGSTROM);
        let mut order: Vec<usize> = (0..sites.places.len()).collect();
        order.sort_by(|a, b| sites.places[*a][2].total_cmp(&sites.places[*b][2]).then(a.cmp(b)));
        let flat = |at: Vec3| [at[0], at[1], 0.0];
        let boxes = AtomBoxes::new(sites.places.iter().map(|at| flat(*at)), COLUMN_ANGSTROM);
        let mut column = vec![usize::MAX; sites.places.len()];
        let mut members: Vec<Vec<usize>> = Vec::new();
        for n in order {
            let at = flat(sites.places[n]);
            let near = |m: &usize| {
                column[*m] != usize::MAX
                    && norm(subtract(at, flat(sites.places[*m]))) < COLUMN_ANGSTROM
            };
            let known = boxes.near(at).map(|m| m as usize).find(near).map(|m| column[m]);
            column[n] = known.unwrap_or_else(|| {
                members.push(Vec::new());
                members.len() - 1
            });
            members[column[n]].push(n);
        }
        let first = members.iter().map(|of| flat(sites.places[of[0]]));
        let boxes = AtomBoxes::new(first, NEAREST_ANGSTROM);
        LayerColumns { sites, members, boxes }
    }

    fn place(&self, column: usize) -> [f64; 2] {
        let [x, y, _] = self.sites.places[self.members[column][0]];
        [x, y]
    }

    /// Returns the column nearest to a place, at most `reach` away.
    fn nearest(&self, at: [f64; 2], reach: f64) -> Option<usize> {
        let away = |column: usize| {
            let [x, y] = self.place(column);
            (x - at[0]).hypot(y - at[1])
        };
        let near = self.boxes.near([at[0], at[1], 0.0]).map(|m| m as usize);
        let near = near.map(|m| (m, away(m))).filter(|(_, d)| *d <= reach);
        near.min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0))).map(|(m, _)| m)
    }

    /// Returns the columns of a row about its middle, without those beyond the ends of the lattice.
    fn row(&self, line: &CheckedLines, middle: [f64; 2]) -> Vec<usize> {
        let Some(centre) = self.nearest(middle, NEAREST_ANGSTROM) else { return Vec::new() };
        let from = self.place(centre);
        let before = (line.columns - 1) / 2;
        let at = |k: usize| {
            let steps = k as f64 - before as f64;
            let place = [0, 1].map(|i| from[i] + steps * line.step[i]);
            self.nearest(place, COLUMN_ANGSTROM)
        };
        // From the middle to both sides, each as far as the lattice goes.
        let mut found: Vec<usize> = (0..before).rev().map_while(at).collect();
        found.reverse();
        found.extend((before..line.columns).map_while(at));
        found
    }
}

/// Makes the sites of rows of vacancies vacant. Returns the first and the last column of each row in Angstrom.
///
/// # Errors
/// [`Error::Invalid`] for rows that find no place.
pub fn mark_lines(
    recipe: &CheckedRecipe,
    table: &StackTable,
    crystals: &StackedCrystals,
    sites: &mut [MadeSite],
) -> Result<Vec<[[f64; 2]; 2]>> {
    let mut ends = Vec::new();
    for (n, (line, given)) in crystals.lines.iter().zip(&table.vacancy_lines).enumerate() {
        let columns = LayerColumns::of(sites, line.layer, line.element);
        let mut taken = BTreeSet::new();
        for row in 0..line.count {
            let given_place = given.positions_nm.get(row);
            let found = match given_place {
                Some(at) => Some(columns.row(line, lengths::angstrom_by_division(*at))),
                None => random_row(recipe, &columns, line, (n, row), &taken),
            };
            let found = found.filter(|found| found.len() > 1);
            let Some(found) = found else { return Err(no_place(n, row, line, given_place)) };
            ends.push([found[0], found[found.len() - 1]].map(|column| columns.place(column)));
            for column in &found {
                let members = &columns.members[*column];
                let missing = match given.missing {
                    MissingAtoms::Entrance => &members[..1],
                    MissingAtoms::Exit => &members[members.len() - 1..],
                    MissingAtoms::All => &members[..],
                };
                for member in missing {
                    sites[columns.sites.numbers[*member]].kind = SiteKind::Vacancy;
                }
            }
            taken.extend(found);
        }
    }
    Ok(ends)
}

/// Draws places in the field until one has room for a whole row.
fn random_row(
    recipe: &CheckedRecipe,
    columns: &LayerColumns,
    line: &CheckedLines,
    (n, row): (usize, usize),
    taken: &BTreeSet<usize>,
) -> Option<Vec<usize>> {
    let field = recipe.field.full_region();
    (0..TRIES).find_map(|attempt| {
        let share = |axis: u32| {
            let stream = 2 * n as u32 + axis;
            uniform(recipe.seed, Purpose::VacancyGroup, stream, row as u64 * TRIES + attempt)
        };
        let place = |[low, high]: [f64; 2], share: f64| {
            lengths::angstrom_by_division(low + (high - low) * share)
        };
        let found = columns.row(line, [place(field.x, share(0)), place(field.y, share(1))]);
        let whole = found.len() == line.columns && found.iter().all(|c| !taken.contains(c));
        whole.then_some(found)
    })
}

fn no_place(n: usize, row: usize, line: &CheckedLines, given: Option<&[f64; 2]>) -> Error {
    let symbol = elements::symbol(line.element);
    let expected = match given {
        Some([x, y]) => format!(
            "no row of {symbol} lies within {:.0} nm of ({x}, {y}) nm; expected a place in the layer",
            lengths::nm(NEAREST_ANGSTROM)
        ),
        None => format!(
            "line {} finds no place for {} columns of {symbol} that lack no atoms yet; lower per_um2 or length_nm",
            row + 1,
            line.columns
        ),
    };
    let key = if given.is_some() { "positions_nm" } else { "per_um2" };
    Error::invalid(Setting::Recipe, format!("stack.vacancy_lines[{}].{key}", n + 1), expected)
}

/// Makes the sites of double vacancies vacant: pairs in a random order, until their share of the sites is the rate.
///
/// # Errors
/// [`Error::Invalid`] for layers without such pairs, and for rates beyond the pairs that do not share an atom.
pub fn mark_double_vacancies(
    recipe: &CheckedRecipe,
    table: &StackTable,
    sites: &mut [MadeSite],
) -> Result<()> {
    for (n, given) in table.double_vacancies.iter().enumerate() {
        let element = elements::atomic_number(&given.element)?;
        let layer = given.layer - 1;
        let all = sites
            .iter()
            .filter(|site| usize::from(site.layer) == layer && site.number == element)
            .count();
        let own = LayerSites::of(sites, layer, element, PAIR_ANGSTROM);
        let mut pairs = pairs(&own, given.pair);
        let stream = OF_PAIRS + n as u32;
        let drawn = |[a, b]: [usize; 2]| {
            uniform(recipe.seed, Purpose::VacancyGroup, stream, (a as u64) << 32 | b as u64)
        };
        // Numbers between 0 and 1 are in the order of their bits.
        pairs.sort_by_cached_key(|pair| (drawn(*pair).to_bits(), *pair));
        let wanted = (0.5 * given.rate * all as f64).round() as usize;
        let mut made = 0;
        for pair in pairs {
            let numbers = pair.map(|m| own.numbers[m]);
            if made == wanted {
                break;
            }
            if numbers.iter().all(|m| sites[*m].kind == SiteKind::Pristine) {
                numbers.iter().for_each(|m| sites[*m].kind = SiteKind::Vacancy);
                made += 1;
            }
        }
        if made < wanted {
            return Err(no_pairs(n, given, made, all));
        }
    }
    Ok(())
}

/// Lists the nearest pairs of sites that are behind or beside each other.
fn pairs(own: &LayerSites, kind: VacancyPair) -> Vec<[usize; 2]> {
    let mut found: Vec<([usize; 2], f64)> = Vec::new();
    for (a, at) in own.places.iter().enumerate() {
        for b in own.boxes.near(*at).map(|b| b as usize).filter(|b| *b > a) {
            let by = subtract(own.places[b], *at);
            let (across, distance) = (by[0].hypot(by[1]), norm(by));
            let behind = across < COLUMN_ANGSTROM;
            if behind == (kind == VacancyPair::Column) && distance < PAIR_ANGSTROM {
                found.push(([a, b], distance));
            }
        }
    }
    let shortest = found.iter().map(|(_, d)| *d).fold(f64::INFINITY, f64::min);
    let near = found.into_iter().filter(|(_, d)| *d <= AS_NEAR * shortest);
    near.map(|(pair, _)| pair).collect()
}

fn no_pairs(n: usize, given: &DoubleVacancies, made: usize, all: usize) -> Error {
    let element = &given.element;
    let (key, expected) = match (made, given.pair) {
        (0, VacancyPair::Column) => (
            "pair",
            format!(
                "no two atoms of {element} lie behind each other within 0.6 nm; expected pair = \"neighbours\""
            ),
        ),
        (0, VacancyPair::Neighbours) => (
            "pair",
            format!(
                "no two atoms of {element} lie beside each other within 0.6 nm; expected pair = \"column\""
            ),
        ),
        _ => (
            "rate",
            format!(
                "at most {:.4} of the sites of {element} are in pairs that share no atom; lower the rate",
                2.0 * made as f64 / all as f64
            ),
        ),
    };
    let value = format!("stack.double_vacancies[{}].{key} = {}", n + 1, given.pair.name());
    Error::invalid(Setting::Recipe, value, expected)
}
