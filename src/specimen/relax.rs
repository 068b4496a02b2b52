//! Outward relaxation of the atoms beside a vacancy.

use std::collections::{BTreeMap, HashMap};

use crate::error::Result;
use crate::recipe::CheckedRecipe;
use crate::recipe::region::Region;
use crate::specimen::atom_columns::{AtomColumn, Sites};
use crate::specimen::sites::{DISPLACED_NM, SiteKind, SpecimenSite};
use crate::specimen::specimen_trait::ThinFilm;
use crate::specimen::specimen_trait::{Boundary, ParticleOutline, ParticleTruth, Specimen};
use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::unit_tag::UnitFamily;
use crate::structure::{PAIR_CUTOFF_ANGSTROM, elements, shortest_distances};

/// Neighbours up to this many times the shortest distance of their pair of elements move: more than
/// the nearest shell, less than the next.
const SHELL: f64 = 1.15;

/// A specimen whose atoms move away from the vacancies beside them.
pub struct Relaxed {
    inner: Box<dyn Specimen>,
    distance_nm: f64,
    reach: Reach,
}

impl Relaxed {
    /// Relaxes `inner` by `vacancies.relaxation_angstrom` of the recipe; returns it as it is if that is 0.
    ///
    /// # Errors
    /// As [`CheckedRecipe::structure`].
    pub fn of(inner: Box<dyn Specimen>, recipe: &CheckedRecipe) -> Result<Box<dyn Specimen>> {
        let vacancies = recipe.vacancies.as_ref().filter(|v| v.relaxation_angstrom > 0.0);
        let Some(vacancies) = vacancies else { return Ok(inner) };
        let element = elements::atomic_number(&vacancies.element)?;
        let shortest = shortest_distances(recipe.structure()?, PAIR_CUTOFF_ANGSTROM);
        Ok(Box::new(Relaxed {
            inner,
            distance_nm: 0.1 * vacancies.relaxation_angstrom,
            reach: Reach::new(element, &shortest),
        }))
    }
}

impl Specimen for Relaxed {
    fn query(&self, region: &Region) -> Sites {
        let mut sites = self.inner.query(region);
        // The columns whose vacancies reach into the region, wherever their sites lie.
        let around = self.inner.sites(&region.grown(self.reach.greatest_nm() + DISPLACED_NM));
        let vacant: Vec<_> = around.into_iter().filter(|s| s.kind == SiteKind::Vacancy).collect();
        outward(&mut sites.sites, &vacant, self.distance_nm, &self.reach);
        sites
    }
    fn columns(&self, region: &Region) -> Vec<AtomColumn> {
        self.inner.columns(region)
    }
    fn expected_sites(&self, region: &Region) -> Option<u64> {
        self.inner.expected_sites(region)
    }
    fn library_cell(&self, family: UnitFamily) -> Option<LibraryCell> {
        self.inner.library_cell(family)
    }
    fn thickness_nm(&self) -> f64 {
        self.inner.thickness_nm()
    }
    fn boundaries(&self) -> Vec<Boundary> {
        self.inner.boundaries()
    }
    fn phases(&self) -> Vec<String> {
        self.inner.phases()
    }
    fn phase_at(&self, position_nm: [f64; 2]) -> usize {
        self.inner.phase_at(position_nm)
    }
    fn film(&self) -> Option<ThinFilm> {
        self.inner.film()
    }
    fn particles(&self) -> Vec<ParticleTruth> {
        self.inner.particles()
    }
    fn particles_reaching(&self, region: &Region) -> Vec<ParticleTruth> {
        self.inner.particles_reaching(region)
    }
    fn particle_outlines(&self) -> Vec<ParticleOutline> {
        self.inner.particle_outlines()
    }
    fn particles_on_a_plane(&self, region: &Region) -> Sites {
        self.inner.particles_on_a_plane(region)
    }
}

/// How far from a vacancy of one element atoms of the others move.
#[derive(Debug, Clone, Default)]
pub struct Reach(BTreeMap<u8, f64>);

impl Reach {
    /// For vacancies of `element`; `shortest` are the shortest distances in the crystal in Angstrom.
    pub fn new(element: u8, shortest: &BTreeMap<(u8, u8), f64>) -> Self {
        let of = |(&(a, b), d): (&(u8, u8), &f64)| {
            let other = if a == element { b } else { a };
            ((a == element || b == element) && other != element).then_some((other, 0.1 * SHELL * d))
        };
        Reach(shortest.iter().filter_map(of).collect())
    }
    /// For atoms of `number`, in nm.
    fn of(&self, number: u8) -> f64 {
        self.0.get(&number).copied().unwrap_or(0.0)
    }
    /// The greatest, in nm.
    pub fn greatest_nm(&self) -> f64 {
        self.0.values().copied().fold(0.0, f64::max)
    }
}

/// Moves every site within `reach` of a vacancy by `distance_nm` away from it. The result does not depend on the order of `vacant`.
pub fn outward(
    sites: &mut [SpecimenSite],
    vacant: &[SpecimenSite],
    distance_nm: f64,
    reach: &Reach,
) {
    let edge = reach.greatest_nm();
    if edge <= 0.0 {
        return;
    }
    let cell = |p: [f64; 3]| p.map(|v| (v / edge).floor() as i64);
    let mut cells: HashMap<[i64; 3], Vec<&SpecimenSite>> = HashMap::new();
    for vacancy in vacant {
        cells.entry(cell(vacancy.position_nm)).or_default().push(vacancy);
    }
    let around = |[i, j, k]: [i64; 3]| {
        (0..27).map(move |n| [i + n % 3 - 1, j + n / 3 % 3 - 1, k + n / 9 - 1])
    };
    for site in sites.iter_mut().filter(|s| s.kind != SiteKind::Vacancy) {
        let (from, reach_nm) = (site.position_nm, reach.of(site.number));
        let near = around(cell(from)).filter_map(|c| cells.get(&c)).flatten();
        let away = |v: &&SpecimenSite| {
            let d = [0, 1, 2].map(|k| from[k] - v.position_nm[k]);
            let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            (length < reach_nm && length > 1e-9).then(|| (v.key, d.map(|c| c / length)))
        };
        let mut pushes: Vec<(u64, [f64; 3])> = near.filter_map(away).collect();
        pushes.sort_by_key(|(key, _)| *key);
        for (_, direction) in pushes {
            for k in 0..3 {
                site.position_nm[k] += distance_nm * direction[k];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::specimen::{BoundaryKind, SpecimenSite};

    /// Knows something of everything that a specimen can be asked for.
    struct KnowsAll;

    impl Specimen for KnowsAll {
        fn query(&self, _: &Region) -> Sites {
            let position_nm = [0.0; 3];
            let site = SpecimenSite { key: 1, position_nm, number: 8, kind: SiteKind::Pristine };
            let mut sites = Sites::default();
            sites.push_column(1, [0.0; 2], None, std::iter::once(site));
            sites
        }
        fn expected_sites(&self, _: &Region) -> Option<u64> {
            Some(7)
        }
        fn thickness_nm(&self) -> f64 {
            3.0
        }
        fn boundaries(&self) -> Vec<Boundary> {
            let kind = BoundaryKind::Grain { misorientation_deg: 1.0, sigma: None };
            vec![Boundary { line_nm: vec![[0.0; 2]; 2], kind }]
        }
        fn phases(&self) -> Vec<String> {
            vec!["a".into(), "b".into()]
        }
        fn phase_at(&self, _: [f64; 2]) -> usize {
            1
        }
        fn library_cell(&self, family: UnitFamily) -> Option<LibraryCell> {
            Some(LibraryCell {
                box_angstrom: [1.0; 3],
                scanned: [1.0; 2],
                scan_origin: [0.0; 2],
                cell: [1.0; 2],
                periodic: [true; 2],
                cells: 1,
                count: family.bin,
                process: None,
                rate: 0.0,
                units: Vec::new(),
                surroundings: Vec::new(),
            })
        }
        fn film(&self) -> Option<ThinFilm> {
            Some(ThinFilm { number: 6, depth_nm: [0.0, 1.0], atoms_per_nm2: 1.0, other_keys: 1 })
        }
        fn particles(&self) -> Vec<ParticleTruth> {
            let morphology = "wulff".into();
            let (centre_nm, orientation) = ([0.0; 3], [1.0, 0.0, 0.0, 0.0]);
            vec![ParticleTruth { centre_nm, diameter_nm: 1.0, morphology, orientation }]
        }
        fn particles_reaching(&self, _: &Region) -> Vec<ParticleTruth> {
            [self.particles(), self.particles()].concat()
        }
        fn particle_outlines(&self) -> Vec<ParticleOutline> {
            vec![self.particles()[0].outline(); 3]
        }
        fn particles_on_a_plane(&self, region: &Region) -> Sites {
            self.query(region)
        }
    }

    /// A default of the trait in place of what the rigid specimen knows would be a silent fault.
    #[test]
    fn everything_that_the_rigid_specimen_knows_is_passed_on() {
        let relaxed =
            Relaxed { inner: Box::new(KnowsAll), distance_nm: 0.01, reach: Reach::default() };
        let region = Region { x: [0.0, 1.0], y: [0.0, 1.0] };
        assert_eq!(relaxed.sites(&region).len(), 1);
        assert_eq!(relaxed.expected_sites(&region), Some(7));
        assert_eq!(relaxed.thickness_nm(), 3.0);
        assert_eq!(relaxed.boundaries().len(), 1);
        assert_eq!((relaxed.phases().len(), relaxed.phase_at([0.0; 2])), (2, 1));
        let family = UnitFamily { motif: 0, structure: 0, bin: 5 };
        assert_eq!(relaxed.library_cell(family).map(|cell| cell.count), Some(5));
        assert_eq!(relaxed.film().map(|film| film.number), Some(6));
        assert_eq!((relaxed.particles().len(), relaxed.particles_reaching(&region).len()), (1, 2));
        assert_eq!(relaxed.particle_outlines().len(), 3);
        assert_eq!(relaxed.particles_on_a_plane(&region).sites.len(), 1);
    }
}
