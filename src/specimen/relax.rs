//! Outward relaxation of the atoms beside a vacancy.

use std::collections::{BTreeMap, HashMap};

use crate::error::Result;
use crate::lengths;
use crate::recipe::CheckedRecipe;
use crate::recipe::region::Region;
use crate::specimen::atom_columns::{AtomColumn, Sites};
use crate::specimen::sites::{DISPLACED_NM, SiteKind, SpecimenSite};
use crate::specimen::specimen_trait::{Specimen, SpecimenLayout};
use crate::specimen::units::unit_tag::UnitFamily;
use crate::structure::{PAIR_CUTOFF_ANGSTROM, elements, shortest_distances};

/// Neighbours up to this multiple of the shortest distance of their pair of elements move: the factor includes the nearest shell and
/// excludes the next.
const SHELL: f64 = 1.15;

/// A specimen whose atoms move away from the vacancies beside them.
pub(crate) struct Relaxed {
    inner: Box<dyn Specimen>,
    distance_nm: f64,
    reach: Reach,
}

impl Relaxed {
    /// Relaxes `inner` by `vacancies.relaxation_angstrom` of the recipe; returns `inner` unchanged if that is 0.
    ///
    /// # Errors
    /// As [`CheckedRecipe::structure`].
    pub(crate) fn of(
        inner: Box<dyn Specimen>,
        recipe: &CheckedRecipe,
    ) -> Result<Box<dyn Specimen>> {
        let vacancies = recipe.vacancies.as_ref().filter(|v| v.relaxation_angstrom > 0.0);
        let Some(vacancies) = vacancies else { return Ok(inner) };
        let element = elements::atomic_number(&vacancies.element)?;
        let shortest = shortest_distances(recipe.structure()?, PAIR_CUTOFF_ANGSTROM);
        Ok(Box::new(Relaxed {
            inner,
            distance_nm: lengths::nm(vacancies.relaxation_angstrom),
            reach: Reach::new(element, &shortest),
        }))
    }
}

impl Specimen for Relaxed {
    fn query(&self, region: &Region) -> Sites {
        let mut sites = self.inner.query(region);
        // Columns whose vacancies reach into the region, including columns with sites outside it.
        let around = self.inner.sites(&region.grown(self.reach.greatest_nm() + DISPLACED_NM));
        let vacant: Vec<_> = around.into_iter().filter(|s| s.kind == SiteKind::Vacancy).collect();
        outward(&mut sites.sites, &vacant, self.distance_nm, &self.reach);
        sites
    }
    fn layout(&self) -> &dyn SpecimenLayout {
        self.inner.layout()
    }
    fn columns(&self, region: &Region) -> Vec<AtomColumn> {
        self.inner.columns(region)
    }
    fn particles_on_a_plane(&self, region: &Region) -> Sites {
        self.inner.particles_on_a_plane(region)
    }
    fn reached_families(&self, family: UnitFamily) -> Vec<UnitFamily> {
        self.inner.reached_families(family)
    }
}

/// The reach of a vacancy of one element: the distance up to which atoms of each other element move.
#[derive(Debug, Clone, Default)]
pub(crate) struct Reach(BTreeMap<u8, f64>);

impl Reach {
    /// Computes the reach for vacancies of `element`; `shortest` are the shortest distances in the crystal in Angstrom.
    pub(crate) fn new(element: u8, shortest: &BTreeMap<(u8, u8), f64>) -> Self {
        let of = |(&(a, b), d): (&(u8, u8), &f64)| {
            let other = if a == element { b } else { a };
            ((a == element || b == element) && other != element).then_some((other, 0.1 * SHELL * d))
        };
        Reach(shortest.iter().filter_map(of).collect())
    }
    /// Returns the reach for atoms of `number`, in nm.
    fn of(&self, number: u8) -> f64 {
        self.0.get(&number).copied().unwrap_or(0.0)
    }
    /// Returns the greatest reach, in nm.
    pub(crate) fn greatest_nm(&self) -> f64 {
        self.0.values().copied().fold(0.0, f64::max)
    }
}

/// Moves every site within `reach` of a vacancy by `distance_nm` away from it. The result does not depend on the order of `vacant`.
pub(crate) fn outward(
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
    use crate::specimen::units::library_cell::LibraryCell;
    use crate::specimen::{Boundary, ParticleTruth, SpecimenFacts};

    /// A specimen of one site, with a layout that has its own values.
    struct OneSite(SpecimenFacts);

    impl SpecimenLayout for OneSite {
        fn facts(&self) -> &SpecimenFacts {
            &self.0
        }
        fn boundaries(&self) -> Vec<Boundary> {
            Vec::new()
        }
        fn phase_at(&self, _: [f64; 2]) -> usize {
            1
        }
        fn library_cell(&self, _: UnitFamily) -> Option<LibraryCell> {
            None
        }
        fn particles_reaching(&self, _: &Region) -> Vec<ParticleTruth> {
            Vec::new()
        }
    }

    impl Specimen for OneSite {
        fn layout(&self) -> &dyn SpecimenLayout {
            self
        }
        fn query(&self, _: &Region) -> Sites {
            let position_nm = [0.0; 3];
            let site = SpecimenSite { key: 1, position_nm, number: 8, kind: SiteKind::Pristine };
            let mut sites = Sites::default();
            sites.push_column(1, [0.0; 2], None, std::iter::once(site));
            sites
        }
        fn columns(&self, _: &Region) -> Vec<AtomColumn> {
            Vec::new()
        }
        fn particles_on_a_plane(&self, region: &Region) -> Sites {
            self.query(region)
        }
        fn reached_families(&self, family: UnitFamily) -> Vec<UnitFamily> {
            vec![family, UnitFamily { bin: family.bin + 1, ..family }]
        }
    }

    /// All facts except the atoms come from the layout, which is the layout of the rigid specimen itself and no copy. The trait has no
    /// defaults, so a fact that is added to [`SpecimenFacts`] or [`SpecimenLayout`] is passed on, too.
    #[test]
    fn a_relaxed_specimen_loses_no_fact() {
        let facts = SpecimenFacts { thickness_nm: 3.0, ..SpecimenFacts::default() };
        let inner: Box<dyn Specimen> = Box::new(OneSite(facts));
        let layout: *const () = std::ptr::from_ref(inner.layout()).cast();
        let relaxed = Relaxed { inner, distance_nm: 0.01, reach: Reach::default() };
        let relaxed: &dyn Specimen = &relaxed;
        assert!(std::ptr::addr_eq(relaxed.layout(), layout));
        assert_eq!((relaxed.facts().thickness_nm, relaxed.phase_at([0.0; 2])), (3.0, 1));
        let region = Region { x: [0.0, 1.0], y: [0.0, 1.0] };
        assert_eq!(relaxed.sites(&region).len(), 1);
        assert!(relaxed.columns(&region).is_empty());
        assert_eq!(relaxed.particles_on_a_plane(&region).sites.len(), 1);
        let family = UnitFamily { motif: 0, structure: 0, bin: 5 };
        assert_eq!(relaxed.reached_families(family).len(), 2);
    }
}
