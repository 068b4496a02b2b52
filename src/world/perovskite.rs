//! A perovskite seen along \[001\], in grains that are rotated alternately about the beam.

use std::collections::HashMap;

use super::boundary::{self, Fate, MinDistances, ON_PLANE};
use super::coincidence::{self, HalfAngle};
use super::crystal::{ColumnCrystal, ColumnIndex, Grain};
use super::recipe::Recipe;
use super::relax;
use super::specimen::{
    AtomColumn, BEYOND_FIELD_NM, GrainBoundary, Region, SiteKind, Sites, Specimen, SpecimenSite,
};
use super::vacancies::{DistanceHistogram, VacancyProfile};
use crate::error::{Error, Result};
use crate::rng::{self, Purpose};
use crate::structure::elements;

const NM: f64 = 0.1;

/// See the module.
pub struct PerovskiteGrains {
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
    misorientation_deg: f64,
    sigma: Option<u32>,
    vacancies: Option<(u8, VacancyProfile)>,
    relaxation: f64,
    seed: u64,
}

/// A column that is there.
struct Present {
    id: u64,
    kind: usize,
    /// Angstrom.
    position: [f64; 2],
    kept: u8,
}

impl PerovskiteGrains {
    /// Lays out grains and boundaries and fits the vacancies of the full field.
    ///
    /// # Errors
    /// [`Error::Invalid`] for another zone axis, missing tables, or a vacancy rate without room.
    pub fn new(recipe: &Recipe) -> Result<Self> {
        if recipe.zone_axis != "[001]" {
            let expected = "perovskite-grains are seen along \"[001]\"";
            return Err(Error::invalid("zone_axis", &recipe.zone_axis, expected));
        }
        let l = &recipe.lattice;
        let [na, nb, nx] = [&l.a_site, &l.b_site, &l.x_site].map(|s| elements::atomic_number(s));
        let numbers = [na?, nb?, nx?];
        let shape = recipe.field.pixels(recipe.field.grid);
        let field = Region::of_pixels([0, 0], shape, recipe.field.pixel_nm());
        let mut specimen = PerovskiteGrains {
            crystal: ColumnCrystal::perovskite(l.a_angstrom, numbers),
            cells_along_beam: cells(recipe.field.thickness_nm * 10.0 / l.a_angstrom),
            grains: Vec::new(),
            planes: Vec::new(),
            fates: HashMap::new(),
            reach: 0.0,
            extent: field.grown(BEYOND_FIELD_NM),
            field,
            misorientation_deg: 0.0,
            sigma: None,
            vacancies: None,
            relaxation: recipe.vacancies.as_ref().map_or(0.0, |v| v.relaxation_angstrom),
            seed: recipe.seed,
        };
        specimen.lay_out(recipe, numbers[2])?;
        specimen.fit_vacancies(recipe)?;
        Ok(specimen)
    }

    fn lay_out(&mut self, recipe: &Recipe, anion: u8) -> Result<()> {
        let centre_y = 0.5 * (self.field.y[0] + self.field.y[1]) / NM;
        let left_edge = self.field.x[0] / NM;
        let width = (self.field.x[1] - self.field.x[0]) / NM;
        let boundaries = recipe.boundaries.as_ref().filter(|b| b.count > 0);
        let Some(boundaries) = boundaries else {
            let (origin, x) =
                ([left_edge + 0.5 * width, centre_y], [f64::NEG_INFINITY, f64::INFINITY]);
            self.grains = vec![Grain { origin, rotation: [1.0, 0.0], x }];
            return Ok(());
        };
        let coincidence = match boundaries.sigma {
            Some(sigma) => Some(
                coincidence::half_angle(sigma, boundaries.misorientation_deg)
                    .map_err(|e| Error::invalid("boundaries.sigma", sigma, e))?,
            ),
            None => None,
        };
        let half = coincidence
            .map_or(0.5 * boundaries.misorientation_deg.to_radians(), HalfAngle::radians);
        (self.misorientation_deg, self.sigma) = (2.0 * half.to_degrees(), boundaries.sigma);
        let target = |k: usize| left_edge + width * k as f64 / (boundaries.count + 1) as f64;
        let mut grain = Grain {
            origin: [target(1), centre_y],
            rotation: [libm::cos(half), libm::sin(half)],
            x: [f64::NEG_INFINITY, f64::INFINITY],
        };
        for k in 1..=boundaries.count {
            let plane = snap(&grain, self.crystal.a, target(k), coincidence);
            grain.x[1] = plane;
            self.grains.push(grain);
            self.planes.push(plane);
            grain = grain.mirrored(plane);
        }
        self.grains.push(grain);
        let limits = MinDistances::new(&boundaries.min_distance_angstrom);
        self.reach = limits.greatest();
        let span = self.extent.y.map(|y| y / NM);
        for (left, grain) in self.grains[..boundaries.count].iter().enumerate() {
            self.fates.extend(boundary::resolve(&self.crystal, grain, left, span, anion, &limits));
        }
        Ok(())
    }

    fn fit_vacancies(&mut self, recipe: &Recipe) -> Result<()> {
        let Some(vacancies) = &recipe.vacancies else { return Ok(()) };
        let element = elements::atomic_number(&vacancies.element)?;
        let mut histogram = DistanceHistogram::default();
        self.for_each_column(&self.field, |column| {
            let chains = self.chains(&column).filter(|(_, c)| c.number == element).count();
            histogram.add(self.distance_nm(column.position[0]), chains as u64);
        });
        self.vacancies = Some((element, VacancyProfile::fit(vacancies, &histogram)?));
        Ok(())
    }

    /// Distance from the nearest boundary in nm; `x` in Angstrom.
    fn distance_nm(&self, x: f64) -> f64 {
        self.planes.iter().map(|p| (x - p).abs() * NM).fold(f64::INFINITY, f64::min)
    }

    fn chains(
        &self,
        column: &Present,
    ) -> impl Iterator<Item = (usize, &super::crystal::Chain)> + use<'_> {
        let kept = column.kept;
        let chains = &self.crystal.columns[column.kind].chains;
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
            let [is, js] = grain.cells(self.crystal.a, [x, y]);
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
        let mut position = grain.position(self.crystal.a, u, v);
        let x = position[0];
        if x <= grain.x[0] + ON_PLANE || x > grain.x[1] + ON_PLANE {
            return None;
        }
        let id = index.id();
        let near = x < grain.x[0] + self.reach + ON_PLANE || x > grain.x[1] - self.reach - ON_PLANE;
        let mut kept = u8::MAX;
        if let Some(fate) = near.then(|| self.fates.get(&id)).flatten() {
            position[0] = fate.x.unwrap_or(x);
            kept = fate.kept;
        }
        (kept != 0).then_some(Present { id, kind: index.kind, position, kept })
    }

    fn unrelaxed(&self, region: &Region) -> Sites {
        let mut out = Sites::default();
        self.for_each_column(region, |column| {
            let first = out.sites.len();
            let [x, y] = column.position.map(|v| v * NM);
            let probability = self.vacancies.map(|(element, profile)| {
                (element, profile.probability(self.distance_nm(column.position[0])))
            });
            for cell in 0..self.cells_along_beam {
                for (chain_number, chain) in self.chains(&column) {
                    let key = column.id << 16 | (cell as u64) << 4 | chain_number as u64;
                    let drawn = || rng::uniform(self.seed, Purpose::Defect, 0, key);
                    let vacant = probability.is_some_and(|(e, p)| e == chain.number && drawn() < p);
                    let kind = if vacant { SiteKind::Vacancy } else { SiteKind::Pristine };
                    let z = (cell as f64 + chain.z) * self.crystal.a * NM;
                    let number = chain.number;
                    out.sites.push(SpecimenSite { key, position_nm: [x, y, z], number, kind });
                }
            }
            let sites = first..out.sites.len();
            out.columns.push(AtomColumn { id: column.id, position_nm: [x, y], sites });
        });
        out
    }
}

impl Specimen for PerovskiteGrains {
    fn query(&self, region: &Region) -> Sites {
        let mut sites = self.unrelaxed(region);
        if let (true, Some((element, _))) = (self.relaxation > 0.0, self.vacancies) {
            let reach_nm = relax::REACH * self.crystal.a * NM;
            let around = self.unrelaxed(&region.grown(reach_nm));
            let vacant: Vec<_> =
                around.sites.into_iter().filter(|s| s.kind == SiteKind::Vacancy).collect();
            relax::outward(&mut sites.sites, &vacant, element, self.relaxation * NM, reach_nm);
        }
        sites
    }

    fn thickness_nm(&self) -> f64 {
        self.cells_along_beam as f64 * self.crystal.a * NM
    }

    fn boundaries(&self) -> Vec<GrainBoundary> {
        let line = |&plane: &f64| self.field.y.map(|y| [plane * NM, y]).to_vec();
        let boundary = |plane| GrainBoundary {
            line_nm: line(plane),
            misorientation_deg: self.misorientation_deg,
            sigma: self.sigma,
        };
        self.planes.iter().map(boundary).collect()
    }
}

/// Nearest whole number of cells, at least one.
fn cells(thickness: f64) -> usize {
    (thickness.round() as usize).max(1)
}

/// The mirror plane nearest to `target` (all in Angstrom): a lattice line of the coincidence
/// boundary, or the line through a lattice point within 5 nm of the middle of the field.
fn snap(grain: &Grain, a: f64, target: f64, coincidence: Option<HalfAngle>) -> f64 {
    if let Some(half) = coincidence {
        let spacing = half.line_spacing() * a;
        return grain.origin[0] + ((target - grain.origin[0]) / spacing).round() * spacing;
    }
    let y = [grain.origin[1] - 50.0, grain.origin[1] + 50.0];
    let [is, js] = grain.cells(a, [[target - a, target + a], y]);
    let points = is.flat_map(|i| js.clone().map(move |j| (i, j)));
    let candidates = points.map(|(i, j)| grain.position(a, i as f64, j as f64));
    candidates
        .filter(|p| (y[0]..=y[1]).contains(&p[1]))
        .map(|p| p[0])
        .min_by(|p, q| (p - target).abs().total_cmp(&(q - target).abs()))
        .unwrap_or(target)
}
