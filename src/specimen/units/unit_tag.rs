//! Tags that point from a column to its place in the library of a mosaic.

use crate::specimen::column_index::ColumnIndex;

/// Units with equal surroundings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct UnitFamily {
    /// Number of the lattice or boundary in the specimen.
    pub motif: usize,
    /// Step of a parameter that the lattice depends on (strain, order parameter).
    pub structure: usize,
    /// Bin of the rate of defects.
    pub bin: usize,
}

/// Place of a unit's contents in the pool, and of its image in the library.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PatternIndex {
    /// Bin of rates.
    pub bin: usize,
    /// Kind of unit.
    pub kind: usize,
    /// Number of the lattice cell among the cells of all library cells of the bin.
    pub cell: usize,
}

/// The unit (columns too close to be resolved) that a column belongs to, and its place in the library.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnitTag {
    /// Number of the unit, unique in the specimen; all columns of the unit have it.
    pub id: u64,
    /// Number of the column among the members of the unit.
    pub member: usize,
    /// Centre (x, y) of the unit in nm.
    pub centre_nm: [f64; 2],
    /// The library cells that show units with equal surroundings.
    pub family: UnitFamily,
    /// Contents of the unit, and their place in the library cells.
    pub entry: PatternIndex,
    /// Rotates directions in the library cell into the field: rows of an orthogonal matrix.
    pub frame: [[f64; 2]; 2],
}

/// A family, and one orientation of its library cells in the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TurnedFamily {
    /// The family.
    pub family: UnitFamily,
    /// [`UnitTag::frame`] in parts of 1e-7.
    frame: [[i64; 2]; 2],
}

/// Resolution of frames that are compared: elements in parts of 1e-7.
const FRAME_PARTS: f64 = 1e7;

impl TurnedFamily {
    /// Returns the family and orientation of a unit.
    pub(crate) fn of(tag: &UnitTag) -> Self {
        let parts = tag.frame.map(|row| row.map(|v| (v * FRAME_PARTS).round() as i64));
        TurnedFamily { family: tag.family, frame: parts }
    }

    /// Returns the family with unrotated library cells.
    #[must_use]
    pub(crate) fn straight(self) -> Self {
        let one = FRAME_PARTS as i64;
        TurnedFamily { frame: [[one, 0], [0, one]], ..self }
    }

    /// Returns another family in the same orientation.
    #[must_use]
    pub(crate) fn with_family(self, family: UnitFamily) -> Self {
        TurnedFamily { family, ..self }
    }

    /// Returns the frame (see [`UnitTag::frame`]).
    pub(crate) fn frame(&self) -> [[f64; 2]; 2] {
        self.frame.map(|row| row.map(|v| v as f64 / FRAME_PARTS))
    }
}

impl UnitTag {
    /// Makes the tag of a unit of an unrotated lattice; `first` is its first column.
    pub(crate) fn unrotated(
        (first, member): (ColumnIndex, usize),
        centre_nm: [f64; 2],
        structure: usize,
        entry: PatternIndex,
    ) -> Self {
        UnitTag {
            id: first.id(),
            member,
            centre_nm,
            family: UnitFamily { motif: 0, structure, bin: entry.bin },
            entry,
            frame: [[1.0, 0.0], [0.0, 1.0]],
        }
    }
}
