//! Checks whether the lists of a world's ground truth agree with each other and with the field.

use std::hash::{DefaultHasher, Hash, Hasher};

use super::soundness::{FoundOrFault, SKIPPED};
use crate::error::Result;
use crate::io::{GroundTruth, WorldColumn, WorldFile, atom_type};
use crate::structure::elements;

/// Largest distance of a site outside the field, in nm: columns at its edge have displaced sites.
const OUTSIDE_NM: f64 = 0.1;
/// Largest distance of a site from the middle of its column, in nm: in displaced and in tilted columns it reaches 0.09.
const BESIDE_NM: f64 = 0.15;
/// Largest distance of a column from the mean of its sites, in nm: single precision in a field of 1 um.
const MEAN_ERROR_NM: f64 = 1e-3;

/// Checks that sites lie in the specimen, that types are known, that masks and names agree with the types, and that atomic numbers exist.
pub fn check_sites(world: &WorldFile) -> Result<FoundOrFault> {
    let m = world.metadata();
    let [height, width] = m.fov_nm;
    let thickness = m.thickness_nm.unwrap_or(f64::MAX);
    let within = |v: f32, size: f64| (-OUTSIDE_NM..=size + OUTSIDE_NM).contains(&f64::from(v));
    let (mut fault, mut count, mut defects) = (None, 0, 0);
    let of_site = |truth: &GroundTruth, i: usize| -> Option<String> {
        let (kind, [x, y]) = (truth.types[i], truth.positions[i]);
        let known = [atom_type::PRISTINE, atom_type::VACANCY, atom_type::SUBSTITUTION];
        if !(within(x, width) && within(y, height)) {
            return Some(format!("lies at x {x}, y {y} nm, outside the field"));
        }
        if let Some(z) = truth.z.get(i).filter(|z| !within(**z, thickness)) {
            return Some(format!("lies at a depth of {z} nm, outside the specimen"));
        }
        if !known.contains(&kind) {
            return Some(format!("has type {kind}, expected 0, 1 or 2"));
        }
        if truth.defects[i] != (kind != atom_type::PRISTINE) {
            return Some(format!("has type {kind} and defect_mask {}", truth.defects[i]));
        }
        if let Some(name) = truth.defect_names.get(i).filter(|name| !fits(name, kind)) {
            return Some(format!("has type {kind} and the defect type `{name}`"));
        }
        let number = truth.numbers.get(i);
        number.filter(|z| !(1..=118).contains(*z)).map(|z| format!("has atomic number {z}"))
    };
    world.for_each_chunk_of_sites(|first, truth| {
        count += truth.types.len();
        defects += truth.defects.iter().filter(|d| **d).count();
        if fault.is_none() {
            fault = (0..truth.types.len()).find_map(|i| Some((first + i, of_site(truth, i)?)));
        }
    })?;
    Ok(match fault {
        Some((site, what)) => Err(format!("site {site} {what}")),
        None => Ok(format!(
            "{count} in the field, {defects} of them defects, in agreement with their types"
        )),
    })
}

/// Whether a name of `defect_types` fits a site of this type.
fn fits(name: &str, kind: i32) -> bool {
    match kind {
        atom_type::VACANCY => name.starts_with("vacancy"),
        atom_type::SUBSTITUTION => name.starts_with("substitution"),
        _ => name.is_empty(),
    }
}

/// Sums over the sites of a column.
#[derive(Clone, Default)]
struct SitesOfColumn {
    /// Number of sites, vacancies and substitutions.
    counts: [i32; 3],
    /// Sums of (x, y) in nm.
    place: [f64; 2],
    /// Sum of the keys of its atoms' elements.
    atoms: u64,
}

/// Returns a number for an element; sums of such numbers differ between compositions.
fn key(atomic_number: i32) -> u64 {
    let mut hash = DefaultHasher::new();
    atomic_number.hash(&mut hash);
    hash.finish()
}

/// Returns the sum of the keys of a composition as text, `O25 Ti26`; `None` for a text that is no composition.
fn atoms(composition: &str) -> Option<u64> {
    composition.split_whitespace().try_fold(0_u64, |sum, part| {
        let digits = part.find(|c: char| c.is_ascii_digit())?;
        let number = elements::atomic_number(&part[..digits]).ok()?;
        let count: u64 = part[digits..].parse().ok()?;
        Some(sum.wrapping_add(count.wrapping_mul(key(i32::from(number)))))
    })
}

impl SitesOfColumn {
    fn add(&mut self, truth: &GroundTruth, i: usize) {
        let kind = truth.types[i];
        self.counts[0] += 1;
        self.counts[1] += i32::from(kind == atom_type::VACANCY);
        self.counts[2] += i32::from(kind == atom_type::SUBSTITUTION);
        for (sum, v) in self.place.iter_mut().zip(truth.positions[i]) {
            *sum += f64::from(v);
        }
        if let (Some(number), true) = (truth.numbers.get(i), kind != atom_type::VACANCY) {
            self.atoms = self.atoms.wrapping_add(key(*number));
        }
    }

    /// Describes how the list entry of a column differs from its sites.
    fn fault(&self, column: &WorldColumn, numbered: bool) -> Option<String> {
        let listed = [column.sites, column.vacancies, column.substitutions];
        if listed != self.counts {
            let counted = self.counts;
            return Some(format!(
                "lists {listed:?} sites, vacancies and substitutions, and has {counted:?}"
            ));
        }
        let n = f64::from(self.counts[0]).max(1.0);
        let off = |k: usize| (f64::from(column.position_nm[k]) - self.place[k] / n).abs();
        if self.counts[0] > 0 && off(0).max(off(1)) > MEAN_ERROR_NM {
            let ([x, y], [mx, my]) = (column.position_nm, self.place.map(|sum| sum / n));
            return Some(format!("is listed at x {x}, y {y} nm, its sites at {mx:.4}, {my:.4} nm"));
        }
        let text = column.composition.as_str();
        // The file holds an empty text where the composition was too long.
        (numbered && !text.is_empty() && atoms(text) != Some(self.atoms))
            .then(|| format!("is listed as `{text}`, but its sites hold other atoms"))
    }
}

/// Checks that the list entry of each column agrees with its sites.
pub fn check_columns(world: &WorldFile) -> Result<FoundOrFault> {
    let columns = world.columns()?;
    let mut found = vec![SitesOfColumn::default(); columns.len()];
    let (mut fault, mut listed, mut numbered) = (None, false, false);
    world.for_each_chunk_of_sites(|first, truth| {
        numbered |= !truth.numbers.is_empty();
        for (i, number) in truth.columns.iter().enumerate() {
            listed = true;
            let (site, n) = (first + i, usize::try_from(*number).unwrap_or(usize::MAX));
            let Some((own, column)) = found.get_mut(n).zip(columns.get(n)) else {
                fault.get_or_insert(format!(
                    "site {site} is of column {number}, which is not listed"
                ));
                continue;
            };
            own.add(truth, i);
            let beside = |k: usize| f64::from(truth.positions[i][k] - column.position_nm[k]);
            if beside(0).hypot(beside(1)) > BESIDE_NM {
                fault.get_or_insert(format!("site {site} lies beside its column, {number}"));
            }
        }
    })?;
    if !listed {
        return Ok(Ok(format!("{SKIPPED}the file does not list the columns of its sites")));
    }
    let wrong = columns.iter().zip(&found).enumerate();
    let wrong = wrong.map(|(n, (column, own))| Some((n, own.fault(column, numbered)?)));
    Ok(match (fault, wrong.flatten().next()) {
        (Some(fault), _) => Err(fault),
        (None, Some((n, what))) => Err(format!("column {n} {what}")),
        (None, None) => Ok(format!("{}, in agreement with their sites", columns.len())),
    })
}

/// Checks that lines between grains and phases, and of planar faults, have places, in the field or not far from it.
pub fn check_boundaries(world: &WorldFile) -> Result<FoundOrFault> {
    let [height, width] = world.metadata().fov_nm;
    let near = |v: f32, size: f64| (-size..=2.0 * size).contains(&f64::from(v));
    let grains = world.boundaries()?;
    let phases = world.phase_boundaries()?;
    let faults = world.fault_lines()?;
    let all = [("grain boundary", &grains), ("phase boundary", &phases), ("fault line", &faults)];
    for (kind, lines) in all {
        for (number, line) in lines.iter().enumerate() {
            let far = line.iter().find(|[x, y]| !(near(*x, width) && near(*y, height)));
            if let Some([x, y]) = far {
                return Ok(Err(format!(
                    "{kind} {number} has a point at x {x}, y {y} nm, far from the field"
                )));
            }
        }
    }
    Ok(Ok(match grains.len() + phases.len() + faults.len() {
        0 => "none".to_owned(),
        n => format!("{n} lines in and near the field"),
    }))
}
