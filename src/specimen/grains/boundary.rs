//! The core of a symmetric tilt boundary: which columns merge, and which atoms have no room.
//!
//! The right grain is the mirror image of the left one. A column closer to its image than the physical minimum becomes one column on the
//! mirror plane. Where other atoms then come too close, the atoms of lower priority are removed. All of this is decided once, for the whole
//! length of a boundary.

use std::collections::{BTreeMap, HashMap};

use crate::recipe::tables::DEFAULT_MIN_DISTANCE;
use crate::specimen::column_index::ColumnIndex;
use crate::specimen::grains::grain::Grain;
use crate::structure::columns::{Chain, ColumnCrystal};
use crate::structure::elements;

/// Positions closer than this to a mirror plane count as on it, in Angstrom.
pub(crate) const ON_PLANE: f64 = 1e-6;

/// Least distances between atoms, in Angstrom.
#[derive(Debug, Clone, Default)]
pub(crate) struct MinDistances(HashMap<(u8, u8), f64>);

impl MinDistances {
    /// Takes the distances of a recipe's table (`"Ti-O"`, checked before); other pairs get the default share of `shortest`, the shortest
    /// distances in the crystal.
    pub(crate) fn new(table: &BTreeMap<String, f64>, shortest: &BTreeMap<(u8, u8), f64>) -> Self {
        let number = |s: &str| elements::atomic_number(s).unwrap_or(0);
        let both = |a, b, d| [((a, b), d), ((b, a), d)];
        let default = shortest.iter().flat_map(|(&(a, b), d)| both(a, b, d * DEFAULT_MIN_DISTANCE));
        let given = table.iter().filter_map(|(pair, &d)| {
            let (a, b) = pair.split_once('-')?;
            Some(both(number(a), number(b), d))
        });
        MinDistances(default.chain(given.flatten()).collect())
    }
    /// Returns the least distance between two elements.
    pub(crate) fn get(&self, a: u8, b: u8) -> f64 {
        self.0.get(&(a, b)).copied().unwrap_or(0.0)
    }
    /// Returns the greatest of the distances.
    pub(crate) fn greatest(&self) -> f64 {
        self.0.values().copied().fold(0.0, f64::max)
    }
}

/// State of a column at a boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ColumnOutcome {
    /// New position (x in Angstrom), if the column moved.
    pub x: Option<f64>,
    /// Bit `n` is set if chain `n` is kept.
    pub kept: u64,
}

/// One chain of a column together with its mirror image.
struct MirrorPair {
    index: ColumnIndex,
    chain_number: usize,
    chain: Chain,
    merged: bool,
    depth: f64,
    y: f64,
}

impl MirrorPair {
    /// Returns the offsets of the atoms from the mirror plane.
    fn offsets(&self) -> &'static [f64] {
        if self.merged { &[0.0] } else { &[-1.0, 1.0] }
    }

    /// Returns the order of priority: the lightest element (the anions of an oxide) after all others, atoms at their lattice sites before
    /// moved ones, heavy before light, far from the plane before near; then along the boundary.
    fn rank(&self, lightest: Option<u8>) -> (bool, bool, u8, i64, i64) {
        let fixed = |v: f64| (v * 1e5).round() as i64;
        let moved = self.merged && self.depth > ON_PLANE;
        let light = u8::MAX - self.chain.number;
        (Some(self.chain.number) == lightest, moved, light, -fixed(self.depth), fixed(self.y))
    }

    fn too_close(&self, other: &MirrorPair, period: f64, limits: &MinDistances) -> bool {
        let limit = limits.get(self.chain.number, other.chain.number);
        let turns = (self.chain.z - other.chain.z).abs();
        let (dy, dz) = (self.y - other.y, turns.min(1.0 - turns) * period);
        self.offsets().iter().any(|s| {
            other.offsets().iter().any(|o| {
                let dx = s * self.depth - o * other.depth;
                dx * dx + dy * dy + dz * dz < limit * limit
            })
        })
    }
}

/// Decides the state of every column near the boundary at the right edge of `grains[left]`, for `y` within `span` (Angstrom). Columns that
/// are not in the map are unchanged.
pub(crate) fn resolve(
    crystal: &ColumnCrystal,
    grain: &Grain,
    left: usize,
    span: [f64; 2],
    limits: &MinDistances,
) -> HashMap<u64, ColumnOutcome> {
    let mut units = units(crystal, grain, left, span, limits);
    let lightest = crystal.lightest();
    units.sort_by_key(|u| u.rank(lightest));
    let mut fates: HashMap<u64, ColumnOutcome> = HashMap::new();
    for unit in &units {
        let mirror = mirror_image(unit.index).id();
        let moved = unit.merged.then_some(grain.x[1]);
        fates.entry(unit.index.id()).or_insert(ColumnOutcome { x: moved, kept: 0 });
        fates.entry(mirror).or_insert(ColumnOutcome { x: None, kept: 0 });
    }
    let reach = limits.greatest();
    let mut accepted: HashMap<i64, Vec<&MirrorPair>> = HashMap::new();
    for unit in &units {
        let bin = (unit.y / reach).floor() as i64;
        let mut near = (bin - 1..=bin + 1).filter_map(|b| accepted.get(&b)).flatten();
        if near.any(|other| unit.too_close(other, crystal.cell[2], limits)) {
            continue;
        }
        accepted.entry(bin).or_default().push(unit);
        let bit = 1u64 << unit.chain_number;
        let mut keep = |id: u64| {
            if let Some(fate) = fates.get_mut(&id) {
                fate.kept |= bit;
            }
        };
        keep(unit.index.id());
        if !unit.merged {
            keep(mirror_image(unit.index).id());
        }
    }
    fates
}

/// Returns the mirror image of a column in the next grain.
fn mirror_image(index: ColumnIndex) -> ColumnIndex {
    ColumnIndex { grain: index.grain + 1, ..index }
}

/// Returns the chains of the left grain within reach of the boundary.
fn units(
    crystal: &ColumnCrystal,
    grain: &Grain,
    left: usize,
    span: [f64; 2],
    limits: &MinDistances,
) -> Vec<MirrorPair> {
    let plane = grain.x[1];
    let mut units = Vec::new();
    let [is, js] = grain.cells(crystal.cell, [[plane - limits.greatest(), plane], span]);
    for i in is {
        for j in js.clone() {
            for (kind, column) in crystal.columns.iter().enumerate() {
                let (u, v) = (i as f64 + column.xy[0], j as f64 + column.xy[1]);
                let [x, y] = grain.position(crystal.cell, u, v);
                let depth = plane - x;
                if depth < -ON_PLANE
                    || depth > limits.greatest()
                    || !(span[0]..span[1]).contains(&y)
                {
                    continue;
                }
                let room = |c: &Chain| 2.0 * depth < limits.get(c.number, c.number);
                let merged = depth < ON_PLANE || column.chains.iter().any(room);
                let index = ColumnIndex { grain: left, kind, cell: [i, j] };
                for (chain_number, &chain) in column.chains.iter().enumerate() {
                    units.push(MirrorPair { index, chain_number, chain, merged, depth, y });
                }
            }
        }
    }
    units
}
