//! Units of chance variation between two worlds: waves over both fields, or parts of each.

use super::measure::Measured;
use super::variation::Variation;
use crate::validate::field_waves::FieldWaves;

/// The method by which two worlds are compared.
#[derive(Debug)]
pub enum Comparing {
    /// Both worlds have the same pixels: waves over their differences.
    Waves {
        /// Waves over the blocks.
        blocks: FieldWaves,
        /// Waves over the segments of spectra.
        segments: FieldWaves,
    },
    /// The worlds have different pixels: independent parts of each.
    Parts([FieldParts; 2]),
    /// No test: worlds of the recipe vary over this length in nm, which is larger than the fields.
    Nothing(f64),
}

/// Independent parts of a field, each of several rows of blocks in one column.
#[derive(Debug, Clone, Copy)]
pub struct FieldParts {
    rows: usize,
    columns: usize,
    /// Number of rows of a part.
    at_once: usize,
}

impl FieldParts {
    /// Returns the number of parts.
    pub fn count(&self) -> usize {
        (self.rows / self.at_once).max(1) * self.columns
    }

    /// Returns the part of a block. Remaining rows at the bottom belong to the last part.
    pub fn of(&self, block: usize) -> usize {
        let last = (self.rows / self.at_once).max(1) - 1;
        (block / self.columns / self.at_once).min(last) * self.columns + block % self.columns
    }

    /// Sums over the blocks of each part.
    pub fn sums(&self, blocks: &[(f64, f64)]) -> Vec<(f64, f64)> {
        let mut sums = vec![(0.0, 0.0); self.count()];
        for (block, (top, bottom)) in blocks.iter().enumerate() {
            let sum = &mut sums[self.of(block)];
            *sum = (sum.0 + top, sum.1 + bottom);
        }
        sums
    }

    /// Returns values with their parts in place of their blocks.
    pub fn values(&self, sample: &[(u32, f32)]) -> Vec<(u32, f32)> {
        sample.iter().map(|(block, v)| (self.of(*block as usize) as u32, *v)).collect()
    }
}

impl Comparing {
    /// Chooses the method; `same` is true if both worlds have the same pixels.
    pub fn new(a: &Measured, b: &Measured, same: bool) -> Self {
        let variation = a.variation.most(b.variation);
        let waves = variation.waves(a.extent_nm()[0]);
        let parts = [a, b].map(|m| {
            let [rows, columns] = m.grid;
            let at_once = variation.rows_of_part(rows, m.extent_nm()[0])?;
            Some(FieldParts { rows, columns, at_once })
        });
        match (variation, waves, parts) {
            (_, Some(waves), _) if same => Comparing::Waves {
                blocks: FieldWaves::new(a.grid, waves),
                segments: FieldWaves::new(a.spectrum.grid, waves),
            },
            (_, _, [Some(a), Some(b)]) if !same => Comparing::Parts([a, b]),
            (Variation::Beyond(nm), ..) => Comparing::Nothing(nm),
            _ => Comparing::Nothing(f64::INFINITY),
        }
    }

    /// Explains lines that have no test.
    pub fn why_not(&self) -> String {
        match self {
            Comparing::Nothing(nm) => format!(
                "phase boundaries of the recipe wander over {nm:.0} nm, more than the field: two seeds differ in this"
            ),
            _ => String::new(),
        }
    }
}
