//! Atomic columns and their defects in a page.
//!
//! Columns are sorted by cells of [`CELL`] units, row by row, and by x within a cell. What columns have in
//! common (sites, vacancies, substitutions, composition) is listed once as a kind.

use std::collections::HashMap;

use serde::Serialize;

use super::blobs::Blobs;
use crate::error::Result;
use crate::io::schema::CompositionText;
use crate::io::{WorldColumn, WorldFile, atom_type};
use crate::plane;

/// Edge of a cell in nm.
const CELL: f64 = 4.0;
/// Positions and depths are whole multiples of this, in nm.
const STEP: f64 = 0.001;

/// The columns in the header. Lists of 16 bits stand as all low, then all high bytes.
#[derive(Debug, Serialize)]
pub(super) struct PageColumns {
    pub count: usize,
    pub cell: f64,
    pub step: f64,
    /// Left upper corner of the first cell.
    pub corner: [f64; 2],
    /// Columns and rows of cells.
    pub cells: [usize; 2],
    /// Blob of the number of columns in each cell, 16 bits.
    pub counts: usize,
    /// Blob of x from the column before (from the cell's edge for its first), in steps, 16 bits.
    pub x: usize,
    /// Blob of y from the cell's edge, in steps, 16 bits.
    pub y: usize,
    /// Blob of the index of the kind: all lowest, middle and highest bytes of 24 bits.
    pub kind: usize,
    /// Sites, vacancies, substitutions, composition.
    pub kinds: Vec<(i32, i32, i32, String)>,
    pub defects: Option<PageDefects>,
}

/// Vacant and substituted sites, column by column, by depth.
#[derive(Debug, Serialize)]
pub(super) struct PageDefects {
    pub names: Vec<String>,
    /// Blob of the index of the name, 8 bits.
    pub name: usize,
    /// Blob of the depth in steps, 16 bits.
    pub depth: usize,
}

/// Lists the columns of a world; `None` if it has none.
pub(super) fn columns(world: &WorldFile, blobs: &mut Blobs) -> Result<Option<PageColumns>> {
    let all = world.columns()?;
    if all.is_empty() {
        return Ok(None);
    }
    let cells = Cells::around(&all);
    let mut order: Vec<usize> = (0..all.len()).collect();
    let place = |i: usize| cells.place(all[i].position_nm);
    order.sort_by_key(|&i| {
        let (cell, [x, y]) = place(i);
        (cell, x, y, i)
    });
    let mut counts = vec![0u16; cells.number[0] * cells.number[1]];
    let (mut xs, mut ys) = (Vec::new(), Vec::new());
    let (mut last, mut before) = (usize::MAX, 0);
    for &i in &order {
        let (cell, [x, y]) = place(i);
        before = if cell == last { before } else { 0 };
        counts[cell] = counts[cell].saturating_add(1);
        xs.push(x - before);
        ys.push(y);
        (last, before) = (cell, x);
    }
    let mut known: HashMap<(i32, i32, i32, CompositionText), u32> = HashMap::new();
    let mut kinds = Vec::new();
    let mut indices = Vec::new();
    for &i in &order {
        let c = &all[i];
        let next = known.len() as u32;
        let key = (c.sites, c.vacancies, c.substitutions, c.composition);
        indices.push(*known.entry(key).or_insert_with(|| {
            let text = c.composition.as_str().to_owned();
            kinds.push((c.sites, c.vacancies, c.substitutions, text));
            next
        }));
    }
    let kind: Vec<u8> = [0, 8, 16]
        .iter()
        .flat_map(|shift| indices.iter().map(move |k| (k >> shift) as u8))
        .collect();
    Ok(Some(PageColumns {
        count: all.len(),
        cell: CELL,
        step: STEP,
        corner: cells.corner,
        cells: cells.number,
        counts: blobs.add(&planes(&counts)),
        x: blobs.add(&planes(&xs)),
        y: blobs.add(&planes(&ys)),
        kind: blobs.add(&kind),
        kinds,
        defects: defects(world, &all, &order, blobs)?,
    }))
}

/// The defects in the order of the columns; `None` where the file does not say in which they are.
fn defects(
    world: &WorldFile,
    columns: &[WorldColumn],
    order: &[usize],
    blobs: &mut Blobs,
) -> Result<Option<PageDefects>> {
    let mut found: Vec<(u32, u16, u8)> = Vec::new();
    let mut names: Vec<String> = Vec::new();
    let mut usable = true;
    let mut rank = vec![0u32; columns.len()];
    order.iter().enumerate().for_each(|(k, &i)| rank[i] = k as u32);
    world.for_each_chunk_of_sites(|_, truth| {
        for (i, kind) in truth.types.iter().enumerate() {
            if *kind == atom_type::PRISTINE {
                continue;
            }
            let column = truth.columns.get(i).and_then(|c| rank.get(usize::try_from(*c).ok()?));
            let (Some(column), Some(z), Some(name)) =
                (column, truth.z.get(i), truth.defect_names.get(i))
            else {
                usable = false;
                return;
            };
            let index = names.iter().position(|n| n == name).unwrap_or_else(|| {
                names.push(name.clone());
                names.len() - 1
            });
            let depth = (f64::from(*z) / STEP).round().clamp(0.0, 65535.0) as u16;
            found.push((*column, depth, index.min(255) as u8));
        }
    })?;
    let expected: usize =
        columns.iter().map(|c| (c.vacancies + c.substitutions).max(0) as usize).sum();
    if !usable || names.len() > 255 || found.len() != expected {
        return Ok(None);
    }
    found.sort_unstable();
    let name: Vec<u8> = found.iter().map(|d| d.2).collect();
    let depths: Vec<u16> = found.iter().map(|d| d.1).collect();
    Ok(Some(PageDefects { names, name: blobs.add(&name), depth: blobs.add(&planes(&depths)) }))
}

/// All low, then all high bytes.
fn planes(values: &[u16]) -> Vec<u8> {
    let low = values.iter().map(|v| *v as u8);
    low.chain(values.iter().map(|v| (v >> 8) as u8)).collect()
}

/// A grid of cells that holds all columns.
struct Cells {
    corner: [f64; 2],
    number: [usize; 2],
}

impl Cells {
    fn around(columns: &[WorldColumn]) -> Self {
        let finite = |v: &f64| v.is_finite();
        let along =
            |k: usize| columns.iter().map(move |c| f64::from(c.position_nm[k])).filter(finite);
        let corner = [0, 1].map(|k| along(k).fold(f64::INFINITY, f64::min).min(1e6).floor());
        let end = [0, 1].map(|k| along(k).fold(f64::NEG_INFINITY, f64::max));
        // A file whose positions are far off is still shown, if not right.
        let number = plane::sub(end, corner).map(|l| (l / CELL).clamp(0.0, 4095.0) as usize + 1);
        Cells { corner, number }
    }

    /// The cell of a position, and the steps from its corner.
    fn place(&self, position: [f32; 2]) -> (usize, [u16; 2]) {
        let most = (CELL / STEP) as i64 - 1;
        let along = |k: usize| {
            let steps = ((f64::from(position[k]) - self.corner[k]) / STEP).round() as i64;
            let cell = (steps / (most + 1)).clamp(0, self.number[k] as i64 - 1);
            (cell as usize, (steps - cell * (most + 1)).clamp(0, most) as u16)
        };
        let ((i, x), (j, y)) = (along(0), along(1));
        (j * self.number[0] + i, [x, y])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_come_back_to_half_a_picometre() {
        let column = |x: f32, y: f32| WorldColumn {
            position_nm: [x, y],
            sites: 1,
            vacancies: 0,
            substitutions: 0,
            composition: CompositionText::default(),
        };
        let all = [column(-0.01, 3.9999), column(99.98765, 47.0), column(12.0, 8.00049)];
        let cells = Cells::around(&all);
        assert_eq!(cells.number, [26, 12]);
        for c in &all {
            let (cell, steps) = cells.place(c.position_nm);
            let corner = [cell % cells.number[0], cell / cells.number[0]];
            for k in 0..2 {
                let back = cells.corner[k] + corner[k] as f64 * CELL + f64::from(steps[k]) * STEP;
                assert!((back - f64::from(c.position_nm[k])).abs() < 0.00051, "{c:?} {back}");
            }
        }
        assert_eq!(planes(&[0x0102, 0x0304]), [2, 4, 1, 3]);
    }
}
