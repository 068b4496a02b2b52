//! One unrotated crystal lattice through the whole field, stretched along x.
//!
//! A column has a place in the undeformed reference lattice and a position in the field. Both differ
//! in x only: along y and the beam the whole specimen keeps the period of the reference crystal, so
//! that neighbouring parts of other lattice parameters stay coherent.

use std::ops::Range;

use rayon::prelude::*;

use crate::lengths;
use crate::plane;
use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::region::Region;
use crate::recipe::tables::Field;
use crate::specimen::column_index::ColumnIndex;
use crate::specimen::units::unit_kinds::UnitMember;
use crate::structure::columns::{Chain, ColumnCrystal};

/// The spacing of planes, as a map from the field to the reference lattice that rises with x. All lengths are in nm.
pub trait Stretch {
    /// The values that all points of one y share.
    type Row: Send + Sync;
    /// Returns the values that all points of one y share.
    fn row(&self, y: f64) -> Self::Row;
    /// Maps the point x of a row of the field to x in the reference lattice.
    fn to_reference(&self, x: f64, row: &Self::Row) -> f64;
    /// Maps x in the reference lattice to the x of a row of the field: the inverse of [`Stretch::to_reference`].
    fn to_field(&self, reference: f64, row: &Self::Row) -> f64;
    /// Largest difference of [`Stretch::to_reference`] between two values of y, and largest distance of columns from their undeformed
    /// position in the cell.
    fn spread(&self) -> f64;
}

/// The index of cells across x, and for each kind of column the cell's row in the stretch.
type RowOfCells<R> = (i64, Vec<(usize, R)>);

/// One crystal lattice through the whole field, stretched along x.
pub struct Coherent<S> {
    pub crystal: ColumnCrystal,
    pub cells_along_beam: usize,
    pub field: Region,
    pub stretch: S,
    extent: Region,
    /// A lattice point of the reference lattice in nm.
    origin: [f64; 2],
}

impl<S: Stretch> Coherent<S> {
    pub fn new(crystal: ColumnCrystal, field: &Field, stretch: S) -> Self {
        let cells_along_beam = crystal.cells_along_beam(field.thickness_nm);
        let field = field.full_region();
        let origin = [field.x[0], 0.5 * (field.y[0] + field.y[1])];
        let extent = field.grown(BEYOND_FIELD_NM);
        Coherent { crystal, cells_along_beam, field, stretch, extent, origin }
    }

    pub fn thickness_nm(&self) -> f64 {
        lengths::nm(self.cells_along_beam as f64 * self.crystal.cell[2])
    }

    /// Returns the centre in nm of a unit whose first member lies in the cell of `first`; `place` gives the position of a column.
    pub fn centre(
        &self,
        members: &[UnitMember],
        first: ColumnIndex,
        mut place: impl FnMut(ColumnIndex) -> [f64; 2],
    ) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for member in members {
            let cell = plane::add(first.cell, member.cell);
            let at = place(ColumnIndex { kind: member.kind, cell, ..first });
            sum = plane::add(sum, at.map(|v| v / members.len() as f64));
        }
        sum
    }

    /// Height in nm of the atom of `chain` in cell `cell` along the beam.
    pub fn height(&self, cell: usize, chain: &Chain) -> f64 {
        lengths::nm((cell as f64 + chain.z) * self.crystal.cell[2])
    }

    /// Calls `f(column, position, more, row)` for the columns of the specimen whose position lies in `region`; `place` computes the
    /// position and `more` from the position in the reference lattice and its row.
    pub fn for_each_column<T>(
        &self,
        region: &Region,
        place: impl Fn(ColumnIndex, [f64; 2], &S::Row) -> ([f64; 2], T),
        mut f: impl FnMut(ColumnIndex, [f64; 2], T, &S::Row),
    ) {
        let region = region.intersection(&self.extent);
        let rows = self.rows(&region);
        for i in self.cells(&region, 0) {
            self.for_each_at(i, &rows, &region, &place, &mut f);
        }
    }

    /// Counts over the columns of a region, of the kinds that `kinds` selects, on all threads: `add` counts one column, `merge` joins two
    /// counts, in any order.
    pub fn tally<T, A: Default + Send>(
        &self,
        region: &Region,
        kinds: impl Fn(usize) -> bool + Sync,
        place: impl Fn(ColumnIndex, [f64; 2], &S::Row) -> ([f64; 2], T) + Sync,
        add: impl Fn(&mut A, ColumnIndex, T, &S::Row) + Sync,
        merge: impl Fn(A, A) -> A + Sync,
    ) -> A
    where
        S: Sync,
    {
        let region = region.intersection(&self.extent);
        let mut rows = self.rows(&region);
        rows.iter_mut().for_each(|(_, of_row)| of_row.retain(|(kind, _)| kinds(*kind)));
        let counted = |mut counts: A, i: i64| {
            let mut add = |index: ColumnIndex, _: [f64; 2], more: T, row: &S::Row| {
                add(&mut counts, index, more, row);
            };
            self.for_each_at(i, &rows, &region, &place, &mut add);
            counts
        };
        let cells = self.cells(&region, 0).into_par_iter();
        cells.fold(A::default, counted).reduce(A::default, &merge)
    }

    /// Returns the cells of the reference lattice along an axis whose columns may lie in a part of the specimen.
    pub fn cells(&self, region: &Region, axis: usize) -> Range<i64> {
        if region.x[0] >= region.x[1] || region.y[0] >= region.y[1] {
            return 0..0;
        }
        let spread = self.stretch.spread();
        let y = [region.y[0] - spread, region.y[1] + spread];
        let ends = match axis {
            0 => {
                let row = self.stretch.row(y[0]);
                [
                    self.stretch.to_reference(region.x[0], &row) - spread,
                    self.stretch.to_reference(region.x[1], &row) + spread,
                ]
            }
            _ => y,
        };
        let cell = |v: f64| {
            ((v - self.origin[axis]) / lengths::nm(self.crystal.cell[axis])).floor() as i64
        };
        cell(ends[0]) - 1..cell(ends[1]) + 1
    }

    /// Returns the rows of cells across x that may lie in a part of the specimen, with the rows of the stretch for each kind of column.
    fn rows(&self, region: &Region) -> Vec<RowOfCells<S::Row>> {
        let of_kind = |kind: usize, j: i64| {
            let index = ColumnIndex { grain: 0, kind, cell: [0, j] };
            (kind, self.stretch.row(self.reference(index)[1]))
        };
        let kinds = 0..self.crystal.columns.len();
        let row = |j: i64| (j, kinds.clone().map(|kind| of_kind(kind, j)).collect());
        self.cells(region, 1).map(row).collect()
    }

    /// Calls `f` for the columns with this index along x.
    fn for_each_at<T>(
        &self,
        i: i64,
        rows: &[RowOfCells<S::Row>],
        region: &Region,
        place: &impl Fn(ColumnIndex, [f64; 2], &S::Row) -> ([f64; 2], T),
        f: &mut impl FnMut(ColumnIndex, [f64; 2], T, &S::Row),
    ) {
        for (j, kinds) in rows {
            for (kind, row) in kinds {
                let index = ColumnIndex { grain: 0, kind: *kind, cell: [i, *j] };
                let (position, more) = place(index, self.reference(index), row);
                if region.contains(position) {
                    f(index, position, more, row);
                }
            }
        }
    }

    /// Returns the place of a column in the reference lattice, in nm.
    pub fn reference(&self, index: ColumnIndex) -> [f64; 2] {
        let xy = self.crystal.columns[index.kind].xy;
        [0, 1].map(|k| {
            self.origin[k] + lengths::nm((index.cell[k] as f64 + xy[k]) * self.crystal.cell[k])
        })
    }
}
