//! A crystal in grains that are rotated alternately about the beam, with straight symmetric tilt
//! boundaries.

use std::collections::{BTreeMap, HashMap};

use crate::error::{Error, Result};
use crate::lengths;
use crate::plane;
use crate::recipe::CheckedRecipe;
use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::region::Region;
use crate::recipe::tables::Boundaries;
use crate::specimen::atom_columns::{AtomColumn, Sites};
use crate::specimen::column_index::ColumnIndex;
use crate::specimen::defects::clusters::Clusters;
use crate::specimen::defects::rules::Defects;
use crate::specimen::grains::boundary;
use crate::specimen::grains::boundary::{ColumnOutcome, MinDistances, ON_PLANE};
use crate::specimen::grains::boundary_motif::{
    BoundaryColumn, BoundaryMotif, SLOT_REACH_ANGSTROM, reach_angstrom,
};
use crate::specimen::grains::grain::Grain;
use crate::specimen::sites::{SiteKind, SpecimenSite};
use crate::specimen::specimen_trait::{
    Boundary, BoundaryKind, ParticleTruth, Specimen, SpecimenFacts, SpecimenLayout,
};
use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::occupation::UnitOccupation;
use crate::specimen::units::unit_tag::UnitFamily;
use crate::specimen::units::unit_tag::UnitTag;
use crate::structure::coincidence;
use crate::structure::coincidence::HalfAngle;
use crate::structure::columns::{Chain, ColumnCrystal};
use crate::structure::{PAIR_CUTOFF_ANGSTROM, shortest_distances};

/// A crystal in grains with symmetric tilt boundaries.
pub(crate) struct Grains {
    crystal: ColumnCrystal,
    cells_along_beam: usize,
    grains: Vec<Grain>,
    /// Positions of the boundaries in Angstrom.
    planes: Vec<f64>,
    fates: HashMap<u64, ColumnOutcome>,
    /// Largest distance in Angstrom from a boundary at which columns may have changed.
    reach: f64,
    extent: Region,
    field: Region,
    kind: BoundaryKind,
    clusters: Clusters,
    defects: Defects,
    /// The contents of units for each kind of defect; if empty, each site is drawn separately.
    contents: Vec<UnitOccupation>,
    /// Each pattern of boundaries, once for each kind of defect.
    motifs: Vec<BoundaryMotif>,
    /// For each boundary that repeats: its motif, the directions of the motif's axes, and a lattice point on
    /// the plane.
    repeating: Vec<Option<Repeat>>,
    facts: SpecimenFacts,
}

/// How a boundary repeats a motif.
#[derive(Debug, Clone, Copy)]
struct Repeat {
    /// Index of the motif for the first kind of defect.
    motif: usize,
    flip: [f64; 2],
    /// y in Angstrom of a lattice point on the plane.
    origin: f64,
}

/// A column that is kept.
struct Present {
    index: ColumnIndex,
    /// Position (x, y) in Angstrom.
    position: [f64; 2],
    kept: u64,
}

impl Present {
    /// Position (x, y) in nm.
    fn position_nm(&self) -> [f64; 2] {
        lengths::nm(self.position)
    }
}

/// The contents of a column for each kind of defect.
struct Held {
    /// The column's place in the library, which shows columns of one kind of defect only.
    tag: Option<UnitTag>,
    /// The column's patterns, one for each kind of defect that it holds; where several name a site, the first counts.
    defective: Vec<UnitTag>,
}

impl Grains {
    /// Lays out grains and boundaries and fits the defects of the full field.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a crystal that has no mirror plane where boundaries need one, or a
    /// vacancy rate without room.
    pub(crate) fn new(recipe: &CheckedRecipe) -> Result<Self> {
        let shortest = shortest_distances(recipe.structure()?, PAIR_CUTOFF_ANGSTROM);
        let crystal = recipe.columns()?.clone();
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
            clusters: Clusters::draw(recipe),
            defects: Defects::default(),
            contents: Vec::new(),
            motifs: Vec::new(),
            repeating: Vec::new(),
            facts: SpecimenFacts::default(),
        };
        specimen.facts.thickness_nm =
            lengths::nm(specimen.cells_along_beam as f64 * specimen.crystal.cell[2]);
        specimen.facts.clusters_nm = specimen.clusters.centres_nm().to_vec();
        specimen.lay_out(recipe.boundaries.as_ref(), &shortest)?;
        specimen.defects = Defects::fit(recipe, |element, histogram| {
            specimen.for_each_column(&specimen.field, |column| {
                let chains = specimen.chains(&column).filter(|(_, c)| c.number == element).count();
                histogram.add(specimen.distance_nm(column.position), chains as u64);
            });
        })?;
        specimen.contents = UnitOccupation::each(recipe, &specimen.crystal)?;
        specimen.find_motifs(recipe);
        Ok(specimen)
    }

    fn lay_out(
        &mut self,
        boundaries: Option<&Boundaries>,
        shortest: &BTreeMap<(u8, u8), f64>,
    ) -> Result<()> {
        let centre_y = self.middle_angstrom();
        let left_edge = lengths::angstrom_by_division(self.field.x[0]);
        let width = lengths::angstrom_by_division(self.field.x[1] - self.field.x[0]);
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
            return Err(Error::invalid(crate::Setting::BoundaryCount, boundaries.count, expected));
        }
        let coincidence = coincidence_of(boundaries, self.crystal.cell)?;
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
        let span = lengths::angstrom_by_division(self.extent.y);
        for (left, grain) in self.grains[..boundaries.count].iter().enumerate() {
            self.fates.extend(boundary::resolve(&self.crystal, grain, left, span, &limits));
        }
        Ok(())
    }

    /// Returns the middle of the field along y in Angstrom.
    fn middle_angstrom(&self) -> f64 {
        lengths::angstrom_by_division(0.5 * (self.field.y[0] + self.field.y[1]))
    }

    /// Returns the distance of a position (x, y) in Angstrom from the nearest place about which vacancies gather, in nm.
    fn distance_nm(&self, position: [f64; 2]) -> f64 {
        let across = |plane: &f64| lengths::nm((position[0] - plane).abs());
        let boundary = || self.planes.iter().map(across).fold(f64::INFINITY, f64::min);
        self.clusters.distance_nm(lengths::nm(position)).unwrap_or_else(boundary)
    }

    fn chains(&self, column: &Present) -> impl Iterator<Item = (usize, &Chain)> + use<'_> {
        let kept = column.kept;
        let chains = &self.crystal.columns[column.index.kind].chains;
        chains.iter().enumerate().filter(move |(n, _)| kept >> n & 1 == 1)
    }

    /// Draws the contents of a column; `None` where each site is drawn separately. The library has no columns with several kinds of
    /// defects: such columns are simulated separately.
    fn held(&self, column: &Present) -> Option<Held> {
        let (mut defective, mut pristine) = (Vec::new(), None);
        for kind in 0..self.contents.len() {
            let tag = self.tag(column, kind)?;
            if self.pattern(&tag).is_empty() {
                pristine = pristine.or(Some(tag));
            } else if !defective.iter().any(|first| self.covers(first, &tag)) {
                defective.push(tag);
            }
        }
        let tag = match defective[..] {
            [] => Some(pristine?),
            [only] => Some(only),
            _ => None,
        };
        Some(Held { tag, defective })
    }

    /// Whether the pattern of one kind of defect covers all sites of a later pattern of the same element.
    fn covers(&self, first: &UnitTag, later: &UnitTag) -> bool {
        let element =
            |tag: &UnitTag| self.contents[self.kind_of(tag.family)].process.map(|p| p.element);
        let taken = self.pattern(first);
        element(first) == element(later) && self.pattern(later).iter().all(|s| taken.contains(s))
    }

    /// Returns the contents of a site: the atom of a chain in cell `depth` along the beam. `chains` are the number of the chain in the kind
    /// of column, and its number among the chains that are kept.
    fn site_of(
        &self,
        defective: &[UnitTag],
        column: ColumnIndex,
        chains: [usize; 2],
        (depth, number): (usize, u8),
    ) -> (SiteKind, u8) {
        let drawn = defective.iter().find_map(|tag| {
            let contents = &self.contents[self.kind_of(tag.family)];
            let site = self.site(contents, tag, column.kind, chains, depth);
            let held = contents.held(self.pattern(tag), site, number);
            (held.0 != SiteKind::Pristine).then_some(held)
        });
        drawn.unwrap_or((SiteKind::Pristine, number))
    }

    /// Returns the number of the kind of defect that a family shows.
    fn kind_of(&self, family: UnitFamily) -> usize {
        match family.motif {
            0 => family.structure,
            motif => (motif - 1) % self.contents.len(),
        }
    }

    /// Returns the place of a column in the part of the library for one kind of defect.
    fn tag(&self, column: &Present, process: usize) -> Option<UnitTag> {
        let contents = self.contents.get(process)?;
        let (kind, member, first) = contents.unit_of(column.index);
        let members = &contents.units.kinds[kind];
        let grain = &self.grains[column.index.grain];
        let centre = centre(members.iter().map(|m| {
            let xy = self.crystal.columns[m.kind].xy;
            let at = |k: usize| (first.cell[k] + m.cell[k]) as f64 + xy[k];
            grain.position(self.crystal.cell, at(0), at(1))
        }));
        let rate_at = |position: [f64; 2]| {
            let local = || self.defects.at(self.distance_nm(position));
            contents.process.map_or(0.0, |kind| local().rate_of(kind))
        };
        let nearest = self.nearest_plane(centre[0]);
        if let Some(plane) =
            nearest.filter(|n| (centre[0] - self.planes[*n]).abs() <= SLOT_REACH_ANGSTROM)
        {
            let repeat = self.repeating.get(plane).copied().flatten()?;
            let motif = &self.motifs[repeat.motif + process];
            let [x, y] = column.position;
            let seen =
                [repeat.flip[0] * (x - self.planes[plane]), repeat.flip[1] * (y - repeat.origin)];
            let slot = motif.slot(seen, self.chains(column).map(|(n, _)| n))?;
            let (rate, around) = (rate_at([x, y]), rate_at([self.planes[plane], y]));
            let entry = motif.draw(slot, column.index.id(), rate, around)?;
            return Some(UnitTag {
                id: column.index.id(),
                member: 0,
                centre_nm: column.position_nm(),
                family: UnitFamily {
                    motif: 1 + repeat.motif + process,
                    structure: 0,
                    bin: entry.bin,
                },
                entry,
                frame: [[repeat.flip[0], 0.0], [0.0, repeat.flip[1]]],
            });
        }
        let entry = contents.draw(kind, first, rate_at(centre))?;
        let ([c, s], x) = (grain.rotation, if grain.mirrored { -1.0 } else { 1.0 });
        Some(UnitTag {
            id: first.id(),
            member,
            centre_nm: lengths::nm(centre),
            family: UnitFamily { motif: 0, structure: process, bin: entry.bin },
            entry,
            frame: [[x * c, -x * s], [s, c]],
        })
    }

    fn nearest_plane(&self, x: f64) -> Option<usize> {
        let distance = |n: &usize| (x - self.planes[*n]).abs();
        (0..self.planes.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    fn pattern(&self, tag: &UnitTag) -> &[u16] {
        match tag.family.motif {
            0 => self.contents[tag.family.structure].pattern(tag.entry),
            motif => {
                let patterns = self.motifs[motif - 1].pool.patterns(tag.entry.kind, tag.entry.bin);
                &patterns.cells[tag.entry.cell]
            }
        }
    }

    /// Returns the number of an atom among the unit's sites. The chain is given by its number in the kind of column and its number among
    /// the chains that are kept.
    fn site(
        &self,
        contents: &UnitOccupation,
        tag: &UnitTag,
        kind: usize,
        [chain, there]: [usize; 2],
        depth: usize,
    ) -> Option<usize> {
        match tag.family.motif {
            0 => contents.site(kind, chain, depth),
            motif => self.motifs[motif - 1].site(tag.entry.kind, there, depth),
        }
    }

    /// Finds the repeating patterns of the boundaries.
    fn find_motifs(&mut self, recipe: &CheckedRecipe) {
        let Some(contents) = self.contents.first() else { return };
        let coincidence =
            recipe.boundaries.as_ref().and_then(|b| coincidence_of(b, self.crystal.cell).ok()?);
        let single = contents.units.kinds.iter().all(|m| m.len() == 1);
        let Some(half) = coincidence.filter(|_| single && self.reach < SLOT_REACH_ANGSTROM) else {
            return;
        };
        let period = half.period() * self.crystal.cell[0];
        let mut motifs: Vec<BoundaryMotif> = Vec::new();
        for plane in 0..self.planes.len() {
            let found = self.origin_on(plane, period).map(|origin| {
                let columns = self.period_of(plane, origin, period);
                let flips = [[1.0, 1.0], [-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0]];
                let kinds = self.contents.len();
                let known = motifs.iter().enumerate().step_by(kinds).find_map(|(motif, m)| {
                    let flip = flips.into_iter().find(|flip| shows(m, &columns, *flip))?;
                    Some(Repeat { motif, flip, origin })
                });
                known.unwrap_or_else(|| {
                    let motif = motifs.len();
                    for contents in &self.contents {
                        let (depth, process) = (self.cells_along_beam, contents.process);
                        let library_seed = recipe.phonons.library_seed;
                        let seeds = (contents.seed(), library_seed, (motif / kinds) as u64);
                        let size = [contents.patches, recipe.phonons.configurations];
                        let columns = columns.clone();
                        motifs
                            .push(BoundaryMotif::new(columns, period, depth, process, size, seeds));
                    }
                    Repeat { motif, flip: [1.0; 2], origin }
                })
            });
            self.repeating.push(found);
        }
        self.motifs = motifs;
    }

    /// Returns y of the lattice point on a boundary's plane that is nearest above the middle of the field.
    fn origin_on(&self, plane: usize, period: f64) -> Option<f64> {
        let (grain, x) = (&self.grains[plane], self.planes[plane]);
        let middle = self.middle_angstrom();
        let cell = self.crystal.cell;
        // In a centred lattice every other point on the plane may be the corner of a cell.
        let [is, js] = grain.cells(cell, [[x, x], [middle, middle + 2.0 * period]]);
        let points = is.flat_map(|i| js.clone().map(move |j| (i, j)));
        let points = points.map(|(i, j)| grain.position(cell, i as f64, j as f64));
        let on = points.filter(|p| (p[0] - x).abs() < ON_PLANE && p[1] >= middle - ON_PLANE);
        on.map(|p| p[1]).min_by(f64::total_cmp)
    }

    /// Returns the columns around a boundary over one period from `origin`.
    fn period_of(&self, plane: usize, origin: f64, period: f64) -> Vec<BoundaryColumn> {
        let (x, reach) = (self.planes[plane], reach_angstrom());
        // The range begins a little lower, so that rounding neither counts a column twice nor skips it.
        let low = origin - 1e-3;
        let rect = [[x - reach, x + reach], [low, low + period]];
        let [across, along] = lengths::nm(rect);
        let region = Region { x: across, y: along };
        let mut columns = Vec::new();
        self.for_each_column(&region, |column| {
            let position = [column.position[0] - x, column.position[1] - origin];
            // Positions are rounded, so that worlds of other seeds and fields have the same library cells.
            let position = position.map(|v| (v * 1e6).round() * 1e-6);
            let chains = self.chains(&column).map(|(n, c)| (n, *c)).collect();
            columns.push(BoundaryColumn { position, chains });
        });
        columns.sort_by(|a, b| {
            a.position[1].total_cmp(&b.position[1]).then(a.position[0].total_cmp(&b.position[0]))
        });
        columns
    }

    /// Calls `f` for the columns that lie in `region`, in the order of grains and cells.
    fn for_each_column(&self, region: &Region, mut f: impl FnMut(Present)) {
        let region = region.intersection(&self.extent);
        if region.x[0] >= region.x[1] || region.y[0] >= region.y[1] {
            return;
        }
        let wide = region.grown(lengths::nm(self.reach));
        for (number, grain) in self.grains.iter().enumerate() {
            let [x, y] = lengths::angstrom_by_division([wide.x, wide.y]);
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
                            .filter(|c| region.contains(c.position_nm()))
                            .into_iter()
                            .for_each(&mut f);
                    }
                }
            }
        }
    }

    /// Returns the column, if its grain reaches there and it is not empty.
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

    /// Lists the columns of a region; without sites if `with_sites` is false.
    fn listed(&self, region: &Region, with_sites: bool) -> Sites {
        let mut out = Sites::default();
        self.for_each_column(region, |column| {
            let [x, y] = column.position_nm();
            let held = self.held(&column);
            let defects = self.defects.at(self.distance_nm(column.position));
            let cells = 0..if with_sites { self.cells_along_beam } else { 0 };
            let sites = cells.flat_map(|cell| {
                self.chains(&column).enumerate().map(move |(there, (n, c))| (cell, there, n, c))
            });
            let sites = sites.map(|(cell, there, number, chain)| {
                let z = lengths::nm((cell as f64 + chain.z) * self.crystal.cell[2]);
                let key = column.index.key(chain, cell);
                let (kind, number) = match &held {
                    Some(Held { defective, .. }) => {
                        let (chains, atom) = ([number, there], (cell, chain.number));
                        self.site_of(defective, column.index, chains, atom)
                    }
                    None => defects.of(key, chain.number),
                };
                SpecimenSite { key, position_nm: [x, y, z], number, kind }
            });
            let tag = held.as_ref().and_then(|held| held.tag);
            out.push_column(column.index.id(), [x, y], tag, sites);
        });
        out
    }
}

impl SpecimenLayout for Grains {
    fn facts(&self) -> &SpecimenFacts {
        &self.facts
    }

    fn boundaries(&self) -> Vec<Boundary> {
        let line = |&plane: &f64| self.field.y.map(|y| [lengths::nm(plane), y]).to_vec();
        let boundary = |plane| Boundary { line_nm: line(plane), kind: self.kind.clone() };
        self.planes.iter().map(boundary).collect()
    }

    fn phase_at(&self, _: [f64; 2]) -> usize {
        0
    }

    fn library_cell(&self, family: UnitFamily) -> Option<LibraryCell> {
        let contents = self.contents.get(self.kind_of(family))?;
        if family.motif > 0 {
            let motif = self.motifs.get(family.motif - 1)?;
            return Some(motif.library_cell(&self.crystal, self.cells_along_beam, family.bin));
        }
        let [a, b, c] = self.crystal.cell;
        let place = |depth: usize, kind: usize, chain: usize| {
            let column = &self.crystal.columns[kind];
            let z = (depth as f64 + column.chains[chain].z) * c;
            [column.xy[0] * a, column.xy[1] * b, z]
        };
        let cell = ([a, b], family.bin);
        Some(LibraryCell::lattice(contents, &self.crystal, cell, self.cells_along_beam, place))
    }

    fn particles_reaching(&self, _: &Region) -> Vec<ParticleTruth> {
        Vec::new()
    }
}

impl Specimen for Grains {
    fn layout(&self) -> &dyn SpecimenLayout {
        self
    }

    fn query(&self, region: &Region) -> Sites {
        self.listed(region, true)
    }

    fn columns(&self, region: &Region) -> Vec<AtomColumn> {
        self.listed(region, false).columns
    }

    fn particles_on_a_plane(&self, _: &Region) -> Sites {
        Sites::default()
    }

    fn reached_families(&self, family: UnitFamily) -> Vec<UnitFamily> {
        vec![family]
    }
}

/// Whether the columns near a boundary, in the motif's axes, are exactly the slots of the motif.
fn shows(motif: &BoundaryMotif, columns: &[BoundaryColumn], flip: [f64; 2]) -> bool {
    let near = columns.iter().filter(|c| c.position[0].abs() <= SLOT_REACH_ANGSTROM);
    let mut count = 0;
    let all = near.into_iter().all(|c| {
        count += 1;
        let seen = plane::mul(flip, c.position);
        motif.slot(seen, c.chains.iter().map(|(n, _)| *n)).is_some()
    });
    all && count == motif.slot_count()
}

/// Returns the coincidence that the boundaries of a recipe are based on.
fn coincidence_of(boundaries: &Boundaries, cell: [f64; 3]) -> Result<Option<HalfAngle>> {
    let Some(sigma) = boundaries.sigma else { return Ok(None) };
    let found = coincidence::half_angle_in(cell, sigma, boundaries.misorientation_deg);
    found.map(Some).map_err(|e| Error::invalid(crate::Setting::BoundarySigma, sigma, e))
}

fn centre(positions: impl ExactSizeIterator<Item = [f64; 2]>) -> [f64; 2] {
    let count = positions.len() as f64;
    positions.fold([0.0; 2], |sum, p| plane::add(sum, p.map(|v| v / count)))
}

/// Returns the mirror plane nearest to `target` (all in Angstrom): a lattice line of the coincidence boundary, or the line through a
/// lattice point within 5 nm of the middle of the field.
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
