//! Crystals seen along a symmetry axis: a square lattice of columns, periodic along the beam.

/// A row of equal atoms along the beam, one per unit cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chain {
    /// Height in the unit cell, as a fraction of it.
    pub z: f64,
    /// Atomic number.
    pub number: u8,
}

/// A column of the unit cell: the chains that share a projected position.
#[derive(Debug, Clone, PartialEq)]
pub struct ColumnKind {
    /// Position in the cell, as fractions; each is 0 or 1/2.
    pub xy: [f64; 2],
    /// The chains, by ascending height.
    pub chains: Vec<Chain>,
}

/// A crystal as columns.
#[derive(Debug, Clone, PartialEq)]
pub struct ColumnCrystal {
    /// Edge of the cubic cell in Angstrom.
    pub a: f64,
    /// Columns of one cell.
    pub columns: Vec<ColumnKind>,
}

impl ColumnCrystal {
    /// The cubic perovskite ABX3 along \[001\]. Planes lie at a/4 (AX) and 3a/4 (BX2), so that
    /// slices of a/2 from the entrance surface have them in their middle.
    pub fn perovskite(a: f64, [na, nb, nx]: [u8; 3]) -> Self {
        let chain = |z, number| Chain { z, number };
        let columns = vec![
            ColumnKind { xy: [0.0, 0.0], chains: vec![chain(0.25, na)] },
            ColumnKind { xy: [0.5, 0.5], chains: vec![chain(0.25, nx), chain(0.75, nb)] },
            ColumnKind { xy: [0.5, 0.0], chains: vec![chain(0.75, nx)] },
            ColumnKind { xy: [0.0, 0.5], chains: vec![chain(0.75, nx)] },
        ];
        ColumnCrystal { a, columns }
    }
}

/// Which column of a specimen: grain, kind of column, and unit cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColumnIndex {
    /// Grain, from the left.
    pub grain: usize,
    /// Index into [`ColumnCrystal::columns`].
    pub kind: usize,
    /// Cell (i, j) of the grain's lattice.
    pub cell: [i64; 2],
}

/// Cells are counted from -2^17 to 2^17.
const CELL_BITS: u32 = 18;

impl ColumnIndex {
    /// A number below 2^48 that is unique in the specimen.
    pub fn id(self) -> u64 {
        let cell = |n: i64| (n + (1 << (CELL_BITS - 1))) as u64 & ((1 << CELL_BITS) - 1);
        let [i, j] = self.cell;
        ((self.grain as u64) << 40 | (self.kind as u64) << 36) | cell(i) << CELL_BITS | cell(j)
    }

    /// The column at the mirror image of this one, in the next grain (see [`Grain::mirrored`]).
    pub fn mirrored(self, crystal: &ColumnCrystal) -> Self {
        let half = crystal.columns[self.kind].xy[0] > 0.25;
        let [i, j] = self.cell;
        ColumnIndex { grain: self.grain + 1, kind: self.kind, cell: [-i - i64::from(half), j] }
    }
}

/// The lattice of one grain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grain {
    /// A lattice point in Angstrom.
    pub origin: [f64; 2],
    /// Cosine and sine of the rotation.
    pub rotation: [f64; 2],
    /// The grain spans `x[0] < x <= x[1]`, in Angstrom.
    pub x: [f64; 2],
}

impl Grain {
    /// Position of the point (u, v) in Angstrom; u and v in units of the cell edge `a`.
    pub fn position(&self, a: f64, u: f64, v: f64) -> [f64; 2] {
        let [c, s] = self.rotation;
        [self.origin[0] + a * (c * u - s * v), self.origin[1] + a * (s * u + c * v)]
    }

    /// The mirror image about the line `x = plane`.
    pub fn mirrored(&self, plane: f64) -> Grain {
        let [c, s] = self.rotation;
        Grain {
            origin: [2.0 * plane - self.origin[0], self.origin[1]],
            rotation: [c, -s],
            x: [plane, f64::INFINITY],
        }
    }

    /// Ranges of cells (i, j) that cover a rectangle `[[x0, x1], [y0, y1]]` in Angstrom.
    pub fn cells(&self, a: f64, rect: [[f64; 2]; 2]) -> [std::ops::RangeInclusive<i64>; 2] {
        let [c, s] = self.rotation;
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for x in rect[0] {
            for y in rect[1] {
                let (dx, dy) = (x - self.origin[0], y - self.origin[1]);
                let uv = [(c * dx + s * dy) / a, (c * dy - s * dx) / a];
                for k in 0..2 {
                    low[k] = f64::min(low[k], uv[k]);
                    high[k] = f64::max(high[k], uv[k]);
                }
            }
        }
        [0, 1].map(|k| low[k].floor() as i64 - 1..=high[k].ceil() as i64)
    }
}
