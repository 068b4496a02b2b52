//! Where the like of a column is in the library of a mosaic.

use crate::specimen::column_index::ColumnIndex;

/// Units whose surroundings are alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct UnitFamily {
    /// Which lattice or boundary of the specimen.
    pub motif: usize,
    /// Step of a parameter that the lattice depends on (strain, order parameter).
    pub structure: usize,
    /// Bin of the rate of defects.
    pub bin: usize,
}

/// Where a unit's contents lie in the pool, and its image in the library.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PatternIndex {
    /// Bin of rates.
    pub bin: usize,
    /// Kind of unit.
    pub kind: usize,
    /// Lattice cell among those of all library cells of the bin.
    pub cell: usize,
}

/// Which unit (columns too close to be told apart) a column belongs to, and where its like is in the library.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnitTag {
    /// Unique in the specimen: the same for all columns of the unit.
    pub id: u64,
    /// Which column of the unit this is.
    pub member: usize,
    /// Centre (x, y) of the unit in nm.
    pub centre_nm: [f64; 2],
    /// Library cells that show units with such surroundings.
    pub family: UnitFamily,
    /// Its contents, and where they are in the library cells.
    pub entry: PatternIndex,
    /// Carries directions in the library cell over to the field: rows of an orthogonal matrix.
    pub frame: [[f64; 2]; 2],
}

/// A family whose library cells lie in the field in one way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TurnedFamily {
    /// The family.
    pub family: UnitFamily,
    /// [`UnitTag::frame`] in parts of 1e-7.
    frame: [[i64; 2]; 2],
}

/// Parts of a number that tells frames apart.
const FRAME_PARTS: f64 = 1e7;

impl TurnedFamily {
    /// That of a unit.
    pub fn of(tag: &UnitTag) -> Self {
        let parts = tag.frame.map(|row| row.map(|v| (v * FRAME_PARTS).round() as i64));
        TurnedFamily { family: tag.family, frame: parts }
    }

    /// The family as if its library cells were not turned.
    #[must_use]
    pub fn straight(self) -> Self {
        let one = FRAME_PARTS as i64;
        TurnedFamily { frame: [[one, 0], [0, one]], ..self }
    }

    /// Another family whose library cells lie in the field in the same way.
    #[must_use]
    pub fn with_family(self, family: UnitFamily) -> Self {
        TurnedFamily { family, ..self }
    }

    /// See [`UnitTag::frame`].
    pub fn frame(&self) -> [[f64; 2]; 2] {
        self.frame.map(|row| row.map(|v| v as f64 / FRAME_PARTS))
    }
}

impl UnitTag {
    /// For a unit of an unrotated lattice; `first` is its first column.
    pub fn unrotated(
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
