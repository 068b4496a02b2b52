//! One unrotated crystal lattice through the whole field, stretched along x.
//!
//! A column has a place in the undeformed reference lattice and a position in the field. Both differ
//! in x only: along y and the beam the whole specimen keeps the period of the reference crystal, so
//! that neighbouring parts of other lattice parameters stay coherent.

use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::region::Region;
use crate::recipe::tables::Field;
use crate::specimen::column_index::ColumnIndex;
use crate::specimen::units::unit_kinds::UnitMember;
use crate::structure::columns::{Chain, ColumnCrystal};

pub(super) const NM: f64 = 0.1;

/// How far apart neighbouring planes are, as a map from the field to the reference lattice that rises
/// with x. All in nm.
pub trait Stretch {
    /// x of the reference lattice at the point (x, y) of the field.
    fn to_reference(&self, position: [f64; 2]) -> f64;
    /// The x in the field at which [`Stretch::to_reference`] is `position[0]`.
    fn to_field(&self, position: [f64; 2]) -> f64;
    /// How much [`Stretch::to_reference`] may differ between two values of y, and columns from their
    /// undeformed position in the cell.
    fn spread(&self) -> f64;
}

/// See the module.
pub struct Coherent<S> {
    pub crystal: ColumnCrystal,
    pub cells_along_beam: usize,
    pub field: Region,
    pub stretch: S,
    extent: Region,
    /// A lattice point of the reference in nm.
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
        self.cells_along_beam as f64 * self.crystal.cell[2] * NM
    }

    /// Centre in nm of a unit whose first member lies in the cell of `first`; `place` gives the position of a column.
    pub fn centre(
        &self,
        members: &[UnitMember],
        first: ColumnIndex,
        place: impl Fn(ColumnIndex) -> [f64; 2],
    ) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for member in members {
            let cell = [0, 1].map(|k| first.cell[k] + member.cell[k]);
            let at = place(ColumnIndex { kind: member.kind, cell, ..first });
            sum = [0, 1].map(|k| sum[k] + at[k] / members.len() as f64);
        }
        sum
    }

    /// Height in nm of the atom of `chain` in cell `cell` along the beam.
    pub fn height(&self, cell: usize, chain: &Chain) -> f64 {
        (cell as f64 + chain.z) * self.crystal.cell[2] * NM
    }

    /// Calls `f(column, position, more)` for the columns of the specimen whose position lies in `region`;
    /// `place` tells it, and more, from the position in the reference lattice.
    pub fn for_each_column<T>(
        &self,
        region: &Region,
        place: impl Fn(ColumnIndex, [f64; 2]) -> ([f64; 2], T),
        mut f: impl FnMut(ColumnIndex, [f64; 2], T),
    ) {
        let region = region.intersection(&self.extent);
        if region.x[0] >= region.x[1] || region.y[0] >= region.y[1] {
            return;
        }
        let spread = self.stretch.spread();
        let y = [region.y[0] - spread, region.y[1] + spread];
        let low = self.stretch.to_reference([region.x[0], y[0]]) - spread;
        let high = self.stretch.to_reference([region.x[1], y[0]]) + spread;
        let cell = |v: f64, k: usize| ((v - self.origin[k]) / (self.crystal.cell[k] * NM)).floor();
        for i in cell(low, 0) as i64 - 1..=cell(high, 0) as i64 {
            for j in cell(y[0], 1) as i64 - 1..=cell(y[1], 1) as i64 {
                for kind in 0..self.crystal.columns.len() {
                    let index = ColumnIndex { grain: 0, kind, cell: [i, j] };
                    let (position, more) = place(index, self.reference(index));
                    if region.contains(position) {
                        f(index, position, more);
                    }
                }
            }
        }
    }

    /// Place of a column in the reference lattice, in nm.
    pub fn reference(&self, index: ColumnIndex) -> [f64; 2] {
        let xy = self.crystal.columns[index.kind].xy;
        [0, 1].map(|k| self.origin[k] + (index.cell[k] as f64 + xy[k]) * self.crystal.cell[k] * NM)
    }
}
