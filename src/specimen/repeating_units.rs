//! Units that repeat, found among any columns.
//!
//! Columns nearer to each other than 1.5 A are one unit. Units with equal contents and like neighbours ([`UnitLikeness`]) are a *group*,
//! which shares a library cell of the mosaic: the surroundings of the first unit of the group, its *model*, as they are in the specimen.
//! Units without a group, and groups of few units, are simulated at their place in the field.

use std::collections::HashMap;

use rayon::prelude::*;

use super::held_columns::HeldColumns;
use super::sites::SpecimenSite;
use super::unit_likeness::{COMPARED_ANGSTROM, UnitLikeness, held_number, strengths};
use super::units::library_cell::{LibraryCell, LibrarySite, LibraryUnit};
use super::units::unit_kinds::SAME_UNIT_ANGSTROM;
use super::units::unit_tag::{PatternIndex, UnitFamily, UnitTag};
use crate::lengths;
use crate::plane;
use crate::recipe::region::Region;

/// Largest number of columns of a unit. Where more columns are linked by short distances, each is a unit of its own.
const MOST_MEMBERS: usize = 4;
/// Least number of units of a group. The images of a library cell take the time of one or two units.
const LEAST_UNITS: usize = 4;
/// Number of units of a group for each of its library cells.
const UNITS_PER_CELL: usize = 32;
/// Largest number of library cells of a group. They differ in the thermal displacements of their atoms.
const MOST_CELLS: usize = 8;
/// Largest number of models with equal contents. Further units without a model are simulated at their place.
const MOST_MODELS: usize = 200;
/// Units that are compared with the models side by side.
const CHUNK: usize = 8192;
/// A unit is scanned where no other column is nearer by more than this, in square Angstrom. Elsewhere the weight of its image is below
/// 0.2 % (`imaging::mosaic::assembly::RAMPS`).
pub(crate) const SHARED_ANGSTROM2: f64 = 2.0;
/// Largest distance in Angstrom of a place from a column that it shows.
pub(crate) const MOST_SHOWN_ANGSTROM: f64 = 0.5 * COMPARED_ANGSTROM;
/// Width in Angstrom of the specimen beyond the scan: half a window of 15.6 A, and the reach of potentials.
const SPECIMEN_BEYOND_ANGSTROM: f64 = 10.5;
/// Stands for no unit, or no group.
const NONE: u32 = u32::MAX;

/// The units of a specimen that repeat.
#[derive(Default)]
pub(super) struct RepeatingUnits {
    /// The unit of each column, and the number of the column among its members.
    place: Vec<(u32, u8)>,
    units: Vec<FoundUnit>,
    groups: Vec<UnitGroup>,
}

/// A unit of columns.
struct FoundUnit {
    /// Columns, in an order that equal units share.
    members: Vec<u32>,
    centre_nm: [f64; 2],
    group: u32,
}

/// Units that share library cells.
struct UnitGroup {
    /// Index of the model.
    model: u32,
    /// The ranges (x, y) in Angstrom of the scan about the centre of a unit.
    scan: [[f64; 2]; 2],
    /// Number of library cells.
    cells: usize,
}

impl RepeatingUnits {
    /// Finds the units of columns in a region that repeat.
    pub(super) fn find(columns: &HeldColumns, region: &Region) -> Self {
        let mut found = Self::units(columns, region);
        let groups = found.grouped(columns);
        let mut count = vec![0usize; groups.len()];
        for unit in found.units.iter().filter(|unit| unit.group != NONE) {
            count[unit.group as usize] += 1;
        }
        let mut new = vec![NONE; groups.len()];
        for (group, (model, likeness)) in groups.iter().enumerate() {
            if count[group] < LEAST_UNITS {
                continue;
            }
            let scan = likeness.shown(SHARED_ANGSTROM2, MOST_SHOWN_ANGSTROM);
            let cells = (count[group] / UNITS_PER_CELL).clamp(1, MOST_CELLS);
            new[group] = found.groups.len() as u32;
            found.groups.push(UnitGroup { model: *model, scan, cells });
        }
        for unit in found.units.iter_mut().filter(|unit| unit.group != NONE) {
            unit.group = new[unit.group as usize];
        }
        found
    }

    /// Joins close columns to units, still without groups.
    fn units(columns: &HeldColumns, region: &Region) -> Self {
        let mut found =
            RepeatingUnits { place: vec![(NONE, 0); columns.len()], ..RepeatingUnits::default() };
        let mut taken = vec![false; columns.len()];
        for first in columns.inside(region) {
            if taken[first] {
                continue;
            }
            let linked = linked(columns, first, &mut taken);
            let each = if linked.len() > MOST_MEMBERS { 1 } else { linked.len() };
            linked.chunks(each).for_each(|members| found.push(columns, members));
        }
        found
    }

    fn push(&mut self, columns: &HeldColumns, members: &[u32]) {
        let at = |m: &u32| columns.position_nm(*m as usize);
        let sum = members.iter().fold([0.0; 2], |sum, m| plane::add(sum, at(m)));
        let centre_nm = sum.map(|s| s / members.len() as f64);
        // In no order of x or y, by which two members of a unit may be equal but for rounding.
        let order = |m: &u32| at(m)[0] + std::f64::consts::FRAC_1_SQRT_2 * at(m)[1];
        let mut members = members.to_vec();
        members.sort_by(|a, b| order(a).total_cmp(&order(b)));
        for (n, member) in members.iter().enumerate() {
            self.place[*member as usize] = (self.units.len() as u32, n as u8);
        }
        self.units.push(FoundUnit { members, centre_nm, group: NONE });
    }

    /// Puts each unit into the group of the first model that it is like, or makes it a model. Returns the models.
    fn grouped(&mut self, columns: &HeldColumns) -> Vec<(u32, UnitLikeness)> {
        let strengths = strengths(columns);
        let mut models: Vec<(u32, UnitLikeness)> = Vec::new();
        let mut by_contents: HashMap<Vec<u8>, Vec<u32>> = HashMap::new();
        for start in (0..self.units.len()).step_by(CHUNK) {
            let end = (start + CHUNK).min(self.units.len());
            let like = |likeness: &UnitLikeness, candidates: &[u32]| {
                candidates.iter().copied().find(|m| models[*m as usize].1.is_like(likeness))
            };
            let compared = |unit: &FoundUnit| {
                let all = (columns, &strengths[..]);
                let likeness = UnitLikeness::of(all, &unit.members, unit.centre_nm);
                let contents = likeness.contents();
                let known = by_contents.get(&contents).map_or(&[][..], Vec::as_slice);
                (like(&likeness, known), known.len(), contents, likeness)
            };
            let compared: Vec<_> = self.units[start..end].par_iter().map(compared).collect();
            for (n, (found, compared_with, contents, likeness)) in compared.into_iter().enumerate()
            {
                let known = by_contents.entry(contents).or_default();
                let mut newer = known[compared_with..].iter().copied();
                let found = found
                    .or_else(|| newer.find(|m| models[*m as usize].1.is_like(&likeness)))
                    .or_else(|| {
                        let room = known.len() < MOST_MODELS;
                        room.then(|| {
                            models.push(((start + n) as u32, likeness));
                            known.push(models.len() as u32 - 1);
                            models.len() as u32 - 1
                        })
                    });
                self.units[start + n].group = found.unwrap_or(NONE);
            }
        }
        models
    }

    /// The place in the library of a column's unit, if it repeats.
    pub(super) fn tag(&self, columns: &HeldColumns, column: usize) -> Option<UnitTag> {
        let (unit, member) = self.place[column];
        let unit = self.units.get(unit as usize)?;
        let group = self.groups.get(unit.group as usize)?;
        let id = columns.id(unit.members[0] as usize);
        let cell = (id % group.cells as u64) as usize;
        Some(UnitTag {
            id,
            member: usize::from(member),
            centre_nm: unit.centre_nm,
            family: UnitFamily { motif: unit.group as usize, structure: 0, bin: 0 },
            entry: PatternIndex { bin: 0, kind: 0, cell },
            frame: [[1.0, 0.0], [0.0, 1.0]],
        })
    }

    /// The library cell of a group: its model, and the columns around it. A tilted beam is displaced by `way` (Angstrom) at half thickness,
    /// and the scan lies there. `library_seed` is the recipe's.
    pub(super) fn library_cell(
        &self,
        columns: &HeldColumns,
        family: UnitFamily,
        (thickness_angstrom, way): (f64, [f64; 2]),
        library_seed: u64,
    ) -> Option<LibraryCell> {
        let group = self.groups.get(family.motif)?;
        let scan = plane::per_axis(group.scan, way, |ends, way| ends.map(|end| end - way));
        let model = &self.units[group.model as usize];
        let centre = lengths::angstrom(model.centre_nm);
        let scanned = scan.map(|[low, high]| high - low);
        // The place of the unit's centre in the library cell.
        let at = scan.map(|[low, _]| SPECIMEN_BEYOND_ANGSTROM - low);
        let size = scanned.map(|width| width + 2.0 * SPECIMEN_BEYOND_ANGSTROM);
        let corner = lengths::nm(plane::sub(centre, at));
        let end = plane::add(corner, lengths::nm(size));
        let around = Region { x: [corner[0], end[0]], y: [corner[1], end[1]] };
        let site = |s: &SpecimenSite| {
            let [x, y, z] = lengths::angstrom(s.position_nm);
            let [x, y] = plane::add(plane::sub([x, y], centre), at);
            LibrarySite { position: [x, y, z], number: held_number(s), defect: None }
        };
        let sites = |n: usize| columns.sites(n).iter().map(site).collect::<Vec<_>>();
        let is_member = |n: &usize| model.members.contains(&(*n as u32));
        let unit = LibraryUnit {
            kind: 0,
            cell: 0,
            centre: at,
            members: model.members.iter().map(|m| sites(*m as usize)).collect(),
            patterns: vec![Vec::new(); group.cells],
        };
        Some(LibraryCell {
            box_angstrom: [size[0], size[1], thickness_angstrom],
            scanned,
            scan_origin: [SPECIMEN_BEYOND_ANGSTROM; 2],
            cell: scanned,
            periodic: [false; 2],
            cells: 1,
            count: group.cells,
            process: None,
            rate: 0.0,
            seed: library_seed,
            units: vec![unit],
            surroundings: columns.inside(&around).filter(|n| !is_member(n)).map(sites).collect(),
        })
    }
}

/// The columns that are linked with a column by short distances.
fn linked(columns: &HeldColumns, first: usize, taken: &mut [bool]) -> Vec<u32> {
    let reach_nm = lengths::nm(SAME_UNIT_ANGSTROM);
    let mut linked = vec![first as u32];
    taken[first] = true;
    let mut next = 0;
    while next < linked.len() {
        let from = columns.position_nm(linked[next] as usize);
        next += 1;
        for other in columns.inside(&Region::centred(from, [2.0 * reach_nm; 2])) {
            let [x, y] = plane::sub(columns.position_nm(other), from);
            if !taken[other] && x * x + y * y <= reach_nm * reach_nm {
                taken[other] = true;
                linked.push(other as u32);
            }
        }
    }
    linked
}
