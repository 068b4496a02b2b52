//! A crystal in grains that are rotated alternately about the beam, with straight symmetric tilt
//! boundaries.

use std::collections::{BTreeMap, HashMap};

use super::boundary::{self, Fate, MinDistances, ON_PLANE};
use super::coherent::NM;
use super::coincidence::{self, HalfAngle};
use super::crystal::{Chain, ColumnCrystal, ColumnIndex, Grain};
use super::defects::Defects;
use super::recipe::{Boundaries, Recipe};
use super::specimen::{
    BEYOND_FIELD_NM, Boundary, BoundaryKind, Region, Sites, Specimen, SpecimenSite,
};
use crate::error::{Error, Result};
use crate::structure::shortest_distances;

/// Pairs of neighbours are nearer than this in every crystal, in Angstrom.
pub(super) const PAIR_CUTOFF_ANGSTROM: f64 = 6.0;

/// See the module.
pub struct Grains {
    crystal: ColumnCrystal,
    cells_along_beam: usize,
    grains: Vec<Grain>,
    /// Positions of the boundaries in Angstrom.
    planes: Vec<f64>,
    fates: HashMap<u64, Fate>,
    /// How far from a boundary columns may have changed, in Angstrom.
    reach: f64,
    extent: Region,
    field: Region,
    kind: BoundaryKind,
    defects: Defects,
}

/// A column that is there.
struct Present {
    index: ColumnIndex,
    /// Angstrom.
    position: [f64; 2],
    kept: u64,
}

impl Grains {
    /// Lays out grains and boundaries and fits the defects of the full field.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a crystal that has no mirror plane where boundaries need one, or a
    /// vacancy rate without room.
    pub fn new(recipe: &Recipe) -> Result<Self> {
        let structure = recipe.oriented_crystal()?;
        let shortest = shortest_distances(&structure, PAIR_CUTOFF_ANGSTROM);
        let crystal = ColumnCrystal::new(&structure)?;
        let field = recipe.field.full_region();
        let mut specimen = Grains {
            cells_along_beam: crystal.cells_along_beam(recipe.field.thickness_nm),
            crystal,
            grains: Vec::new(),
            planes: Vec::new(),
            fates: HashMap::new(),
            reach: 0.0,
            extent: field.grown(BEYOND_FIELD_NM),
            field,
            kind: BoundaryKind::Grain { misorientation_deg: 0.0, sigma: None },
            defects: Defects::default(),
        };
        specimen.lay_out(recipe.boundaries.as_ref(), &shortest)?;
        specimen.defects = Defects::fit(recipe, |element, histogram| {
            specimen.for_each_column(&specimen.field, |column| {
                let chains = specimen.chains(&column).filter(|(_, c)| c.number == element).count();
                histogram.add(specimen.distance_nm(column.position[0]), chains as u64);
            });
        })?;
        Ok(specimen)
    }

    fn lay_out(
        &mut self,
        boundaries: Option<&Boundaries>,
        shortest: &BTreeMap<(u8, u8), f64>,
    ) -> Result<()> {
        let centre_y = 0.5 * (self.field.y[0] + self.field.y[1]) / NM;
        let left_edge = self.field.x[0] / NM;
        let width = (self.field.x[1] - self.field.x[0]) / NM;
        let everywhere = [f64::NEG_INFINITY, f64::INFINITY];
        let Some(boundaries) = boundaries.filter(|b| b.count > 0) else {
            let origin = [left_edge + 0.5 * width, centre_y];
            self.grains =
                vec![Grain { origin, rotation: [1.0, 0.0], mirrored: false, x: everywhere }];
            return Ok(());
        };
        if !self.crystal.has_mirror_x() {
            let expected = "symmetric tilt boundaries need a crystal with a mirror plane \
                            perpendicular to x; choose another y_axis, or count = 0";
            return Err(Error::invalid("boundaries.count", boundaries.count, expected));
        }
        let coincidence = match boundaries.sigma {
            Some(sigma) => Some(
                coincidence::half_angle(sigma, boundaries.misorientation_deg)
                    .map_err(|e| Error::invalid("boundaries.sigma", sigma, e))?,
            ),
            None => None,
        };
        let half = coincidence
            .map_or(0.5 * boundaries.misorientation_deg.to_radians(), HalfAngle::radians);
        self.kind = BoundaryKind::Grain {
            misorientation_deg: 2.0 * half.to_degrees(),
            sigma: boundaries.sigma,
        };
        let target = |k: usize| left_edge + width * k as f64 / (boundaries.count + 1) as f64;
        let mut grain = Grain {
            origin: [target(1), centre_y],
            rotation: [libm::cos(half), libm::sin(half)],
            mirrored: false,
            x: everywhere,
        };
        for k in 1..=boundaries.count {
            let plane = snap(&grain, self.crystal.cell, target(k), coincidence);
            grain.x[1] = plane;
            self.grains.push(grain);
            self.planes.push(plane);
            grain = grain.mirror_image(plane);
        }
        self.grains.push(grain);
        let limits = MinDistances::new(&boundaries.min_distance_angstrom, shortest);
        self.reach = limits.greatest();
        let span = self.extent.y.map(|y| y / NM);
        for (left, grain) in self.grains[..boundaries.count].iter().enumerate() {
            self.fates.extend(boundary::resolve(&self.crystal, grain, left, span, &limits));
        }
        Ok(())
    }

    /// Distance from the nearest boundary in nm; `x` in Angstrom.
    fn distance_nm(&self, x: f64) -> f64 {
        self.planes.iter().map(|p| (x - p).abs() * NM).fold(f64::INFINITY, f64::min)
    }

    fn chains(&self, column: &Present) -> impl Iterator<Item = (usize, &Chain)> + use<'_> {
        let kept = column.kept;
        let chains = &self.crystal.columns[column.index.kind].chains;
        chains.iter().enumerate().filter(move |(n, _)| kept >> n & 1 == 1)
    }

    /// Calls `f` for the columns that lie in `region`, in the order of grains and cells.
    fn for_each_column(&self, region: &Region, mut f: impl FnMut(Present)) {
        let region = region.intersection(&self.extent);
        if region.x[0] >= region.x[1] || region.y[0] >= region.y[1] {
            return;
        }
        let wide = region.grown(self.reach * NM);
        for (number, grain) in self.grains.iter().enumerate() {
            let (x, y) = (wide.x.map(|v| v / NM), wide.y.map(|v| v / NM));
            let x = [x[0].max(grain.x[0]), x[1].min(grain.x[1])];
            if x[0] > x[1] {
                continue;
            }
            let [is, js] = grain.cells(self.crystal.cell, [x, y]);
            for i in is {
                for j in js.clone() {
                    for kind in 0..self.crystal.columns.len() {
                        let index = ColumnIndex { grain: number, kind, cell: [i, j] };
                        let column = self.column(grain, index);
                        column
                            .filter(|c| region.contains(c.position.map(|v| v * NM)))
                            .into_iter()
                            .for_each(&mut f);
                    }
                }
            }
        }
    }

    /// The column, if its grain reaches there and it is not empty.
    fn column(&self, grain: &Grain, index: ColumnIndex) -> Option<Present> {
        let xy = self.crystal.columns[index.kind].xy;
        let (u, v) = (index.cell[0] as f64 + xy[0], index.cell[1] as f64 + xy[1]);
        let mut position = grain.position(self.crystal.cell, u, v);
        let x = position[0];
        if x <= grain.x[0] + ON_PLANE || x > grain.x[1] + ON_PLANE {
            return None;
        }
        let near = x < grain.x[0] + self.reach + ON_PLANE || x > grain.x[1] - self.reach - ON_PLANE;
        let mut kept = u64::MAX;
        if let Some(fate) = near.then(|| self.fates.get(&index.id())).flatten() {
            position[0] = fate.x.unwrap_or(x);
            kept = fate.kept;
        }
        (kept != 0).then_some(Present { index, position, kept })
    }
}

impl Specimen for Grains {
    fn query(&self, region: &Region) -> Sites {
        let mut out = Sites::default();
        self.for_each_column(region, |column| {
            let [x, y] = column.position.map(|v| v * NM);
            let defects = self.defects.at(self.distance_nm(column.position[0]));
            let cells = 0..self.cells_along_beam;
            let sites = cells.flat_map(|cell| self.chains(&column).map(move |(_, c)| (cell, c)));
            let sites = sites.map(|(cell, chain)| {
                let key = column.index.key(chain, cell);
                let (kind, number) = defects.of(key, chain.number);
                let z = (cell as f64 + chain.z) * self.crystal.cell[2] * NM;
                SpecimenSite { key, position_nm: [x, y, z], number, kind }
            });
            out.push_column(column.index.id(), [x, y], sites);
        });
        out
    }

    fn thickness_nm(&self) -> f64 {
        self.cells_along_beam as f64 * self.crystal.cell[2] * NM
    }

    fn boundaries(&self) -> Vec<Boundary> {
        let line = |&plane: &f64| self.field.y.map(|y| [plane * NM, y]).to_vec();
        let boundary = |plane| Boundary { line_nm: line(plane), kind: self.kind.clone() };
        self.planes.iter().map(boundary).collect()
    }
}

/// The mirror plane nearest to `target` (all in Angstrom): a lattice line of the coincidence
/// boundary, or the line through a lattice point within 5 nm of the middle of the field.
fn snap(grain: &Grain, cell: [f64; 3], target: f64, coincidence: Option<HalfAngle>) -> f64 {
    if let Some(half) = coincidence {
        let spacing = half.line_spacing() * cell[0];
        return grain.origin[0] + ((target - grain.origin[0]) / spacing).round() * spacing;
    }
    let y = [grain.origin[1] - 50.0, grain.origin[1] + 50.0];
    let [is, js] = grain.cells(cell, [[target - cell[0], target + cell[0]], y]);
    let points = is.flat_map(|i| js.clone().map(move |j| (i, j)));
    let candidates = points.map(|(i, j)| grain.position(cell, i as f64, j as f64));
    candidates
        .filter(|p| (y[0]..=y[1]).contains(&p[1]))
        .map(|p| p[0])
        .min_by(|p, q| (p - target).abs().total_cmp(&(q - target).abs()))
        .unwrap_or(target)
}
