//! Units: groups of atomic columns that lie so close together that their images overlap.
//!
//! The contents of a unit are drawn as a whole (`super::occupation`), and its patch of the image is simulated as a whole
//! ([`crate::imaging::mosaic`]).

use crate::plane;
use crate::structure::columns::ColumnCrystal;

/// Columns nearer than this in projection belong to one unit, in Angstrom.
pub(crate) const SAME_UNIT_ANGSTROM: f64 = 1.5;

/// A column of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct UnitMember {
    /// Index into [`ColumnCrystal::columns`].
    pub kind: usize,
    /// Cell of the column relative to the cell of the first member.
    pub cell: [i64; 2],
}

/// The units of a crystal's cell.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct UnitKinds {
    /// Members of each kind of unit; the first has the lowest kind of column.
    pub kinds: Vec<Vec<UnitMember>>,
    /// For each kind of column: its kind of unit, and its number among the members.
    pub of_column: Vec<(usize, usize)>,
}

impl UnitKinds {
    /// Groups the columns of a crystal. Where close columns form endless chains, each column is a separate unit.
    pub(crate) fn new(crystal: &ColumnCrystal) -> Self {
        let count = crystal.columns.len();
        let mut taken = vec![false; count];
        let mut kinds = Vec::new();
        for first in 0..count {
            if taken[first] {
                continue;
            }
            let Some(members) = cluster(crystal, first) else { return UnitKinds::single(count) };
            members.iter().for_each(|m| taken[m.kind] = true);
            kinds.push(members);
        }
        let mut of_column = vec![(0, 0); count];
        for (unit, members) in kinds.iter().enumerate() {
            for (n, member) in members.iter().enumerate() {
                of_column[member.kind] = (unit, n);
            }
        }
        UnitKinds { kinds, of_column }
    }

    fn single(count: usize) -> Self {
        UnitKinds {
            kinds: (0..count).map(|kind| vec![UnitMember { kind, cell: [0, 0] }]).collect(),
            of_column: (0..count).map(|kind| (kind, 0)).collect(),
        }
    }
}

/// Returns the columns that are connected with column `first` by short distances; `None` when they never end.
fn cluster(crystal: &ColumnCrystal, first: usize) -> Option<Vec<UnitMember>> {
    let mut members = vec![UnitMember { kind: first, cell: [0, 0] }];
    let mut next = 0;
    while next < members.len() {
        let from = members[next];
        next += 1;
        for (kind, column) in crystal.columns.iter().enumerate() {
            for shift in (0..9).map(|n| [n % 3 - 1, n / 3 - 1]) {
                let d = [0, 1].map(|k| {
                    let away = column.xy[k] - crystal.columns[from.kind].xy[k] + shift[k] as f64;
                    away * crystal.cell[k]
                });
                let member = UnitMember { kind, cell: plane::add(from.cell, shift) };
                if d[0].hypot(d[1]) > SAME_UNIT_ANGSTROM || members.contains(&member) {
                    continue;
                }
                if members.iter().any(|m| m.kind == kind) {
                    return None;
                }
                members.push(member);
            }
        }
    }
    Some(members)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::crystals;

    fn units(name: &str, zone: [i32; 3], up: [i32; 3]) -> (ColumnCrystal, UnitKinds) {
        let structure = crystals::crystal(name).unwrap().oriented(zone, Some(up)).unwrap();
        let crystal = ColumnCrystal::new(&structure).unwrap();
        let units = UnitKinds::new(&crystal);
        (crystal, units)
    }

    #[test]
    fn dumbbells_are_units_and_perovskite_columns_are_not() {
        let (_, perovskite) = units("srtio3", [0, 0, 1], [0, 1, 0]);
        assert!(perovskite.kinds.len() == 4 && perovskite.kinds.iter().all(|m| m.len() == 1));
        for (name, zone, up) in [("si", [1, 1, 0], [1, -1, 0]), ("gan", [1, 1, 0], [1, -1, 0])] {
            let (crystal, units) = units(name, zone, up);
            assert_eq!(2 * units.kinds.len(), crystal.columns.len(), "{name}");
            for members in &units.kinds {
                assert_eq!(members.len(), 2);
                let at = |m: &UnitMember, k: usize| {
                    (crystal.columns[m.kind].xy[k] + m.cell[k] as f64) * crystal.cell[k]
                };
                let d = [0, 1].map(|k| at(&members[1], k) - at(&members[0], k));
                // Distances are 1.358 A in silicon and 1.13 A in gallium nitride.
                assert!((1.0..1.4).contains(&d[0].hypot(d[1])), "{name} {d:?}");
            }
        }
    }
}
