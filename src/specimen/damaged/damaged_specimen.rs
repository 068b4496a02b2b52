//! A specimen that the beam takes atoms from.
//!
//! Every atom has a random number of its own, u, and is lost when the dose D at its column has come to
//! `1 - exp(-cross-section D) > u`: what is left depends on the seed and on the dose alone, not on the steps in which it came.
//!
//! A unit with a place in the library of a mosaic keeps one, as far as the library can show what it has lost: it takes the
//! pattern with as many vacancies that has most of them where they are. Numbers of vacancies are exact, then; which of a column's sites
//! are vacant is not always (atoms move along a column under the beam too, and are not followed here). All other columns hold just the atoms
//! that are left, and are simulated where they lie.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, RwLock, RwLockReadGuard};

use super::dose_map::DoseMap;
use super::unit_patterns::{KindPatterns, UnitPatterns};
use crate::recipe::region::Region;
use crate::recipe::resolved_recipe::Recipe;
use crate::rng::{Purpose, uniform};
use crate::specimen::atom_columns::{AtomColumn, Sites};
use crate::specimen::sites::{SiteKind, SpecimenSite};
use crate::specimen::specimen_trait::{Specimen, SpecimenLayout};
use crate::specimen::units::patterns::{bin_of, nearest_bins, rate_of};
use crate::specimen::units::unit_tag::{PatternIndex, UnitFamily, UnitTag};
use crate::structure::elements;

/// Draws of [`Purpose::Damage`] for an atom of a unit, by its place in the unit, begin here; 0 is for those of other columns.
const FIRST_SITE_DRAW: u32 = 16;
/// Draw that chooses among equal patterns.
const PATTERN_DRAW: u32 = 1;

/// See the module.
pub struct DamagedSpecimen {
    inner: Arc<dyn Specimen>,
    seed: u64,
    /// Cross-sections in square Angstrom for the loss of an atom, by atomic number; 0 for those that stay.
    losses: Vec<f64>,
    /// The greatest dose that the library of a mosaic is made for.
    most_dose: f64,
    dose: RwLock<DoseMap>,
    families: RwLock<HashMap<UnitFamily, Arc<UnitPatterns>>>,
}

/// What became of a unit.
enum UnitOutcome {
    /// It has lost nothing.
    Whole,
    /// The library shows a unit with so many vacancies.
    Pattern(UnitTag),
    /// It has lost these of its sites, one member after the other.
    Lost(Vec<bool>),
}

impl DamagedSpecimen {
    /// A specimen of a recipe, still whole, whose atoms the beam displaces as its table `[damage]` says. `most_dose` (electrons per
    /// square Angstrom) decides how many vacancies the library of a mosaic shows.
    pub fn new(inner: Arc<dyn Specimen>, recipe: &Recipe, most_dose: f64) -> Self {
        let cross_section = |number: u8| {
            let symbol = elements::symbol(number);
            let of = |table: &crate::damage::DamageTable| {
                table.cross_section_angstrom2(symbol, number, recipe.optics.energy_kv)
            };
            recipe.damage.as_ref().map_or(0.0, of)
        };
        DamagedSpecimen {
            inner,
            seed: recipe.seed,
            losses: (0..=elements::MAX_ATOMIC_NUMBER).map(cross_section).collect(),
            most_dose,
            dose: RwLock::default(),
            families: RwLock::default(),
        }
    }

    /// Whether any dose changes it.
    pub fn is_lasting(&self) -> bool {
        self.losses.iter().all(|loss| *loss == 0.0)
    }

    /// The doses of all places.
    pub fn dose(&self) -> RwLockReadGuard<'_, DoseMap> {
        self.dose.read().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Changes the doses.
    pub fn expose(&self, change: impl FnOnce(&mut DoseMap)) {
        change(&mut self.dose.write().unwrap_or_else(std::sync::PoisonError::into_inner));
    }

    /// Probability that an atom is lost after a dose.
    fn lost_share(&self, number: u8, dose: f64) -> f64 {
        let loss = self.losses.get(usize::from(number)).copied().unwrap_or_default();
        1.0 - libm::exp(-loss * dose)
    }

    /// The patterns of a family.
    fn patterns(&self, family: UnitFamily) -> Option<Arc<UnitPatterns>> {
        let known = self.families.read().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(found) = known.get(&family) {
            return Some(Arc::clone(found));
        }
        drop(known);
        let made = Arc::new(UnitPatterns::of(&self.inner.library_cell(family)?));
        let mut known = self.families.write().unwrap_or_else(std::sync::PoisonError::into_inner);
        Some(Arc::clone(known.entry(family).or_insert(made)))
    }

    /// What a dose has made of a unit.
    fn outcome(&self, tag: &UnitTag, dose: f64) -> UnitOutcome {
        let Some(family) = self.patterns(tag.family) else { return UnitOutcome::Whole };
        let Some(kind) = family.kind(tag.entry.kind) else { return UnitOutcome::Whole };
        let (Some(before), process) = (kind.cells.get(&tag.entry.cell), family.process) else {
            return UnitOutcome::Whole;
        };
        let lost = |(n, site): (usize, &super::unit_patterns::UnitSite)| {
            let defect = site.defect.is_some_and(|d| before.binary_search(&d).is_ok());
            let held = process
                .filter(|_| defect)
                .map_or((SiteKind::Pristine, site.number), |p| p.defect());
            let u = || uniform(self.seed, Purpose::Damage, FIRST_SITE_DRAW + n as u32, tag.id);
            let share = self.lost_share(held.1, dose);
            held.0 != SiteKind::Vacancy && share > 0.0 && u() < share
        };
        let lost: Vec<bool> = kind.sites.iter().enumerate().map(lost).collect();
        if !lost.contains(&true) {
            return UnitOutcome::Whole;
        }
        let shown = process.filter(|p| p.by.is_none()).and_then(|process| {
            let vacant = vacancies(kind, before, &lost)?;
            self.shown(tag, &vacant, self.lost_share(process.element, dose))
        });
        shown.map_or(UnitOutcome::Lost(lost), UnitOutcome::Pattern)
    }

    /// The unit of the library that has such vacancies, where a share of all atoms of the kind has been lost.
    fn shown(&self, tag: &UnitTag, vacant: &[u16], share: f64) -> Option<UnitTag> {
        let first = rate_of(tag.family.bin);
        let rate = first + (1.0 - first) * share;
        let reached = self.bins(tag.family);
        let bins = nearest_bins(rate).into_iter().filter(|bin| reached.contains(bin));
        let pick = uniform(self.seed, Purpose::Damage, PATTERN_DRAW, tag.id);
        bins.into_iter().find_map(|bin| {
            let family = UnitFamily { bin, ..tag.family };
            let cell = self.patterns(family)?.kind(tag.entry.kind)?.nearest(vacant, pick)?;
            let entry = PatternIndex { bin, cell, ..tag.entry };
            Some(UnitTag { family, entry, ..*tag })
        })
    }

    /// The bins that units of a family may come to, up to the greatest dose.
    fn bins(&self, family: UnitFamily) -> std::ops::RangeInclusive<usize> {
        let process = self.patterns(family).and_then(|patterns| patterns.process);
        let Some(process) = process.filter(|p| p.by.is_none()) else {
            return family.bin..=family.bin;
        };
        let first = rate_of(family.bin);
        let rate = first + (1.0 - first) * self.lost_share(process.element, self.most_dose);
        let last = if rate > first { bin_of(rate).max(1) } else { family.bin };
        family.bin..=last.max(family.bin)
    }

    /// A column, and its sites, after what it has been through.
    fn aged(&self, column: &mut AtomColumn, sites: &mut [SpecimenSite], dose: f64) {
        let Some(tag) = column.unit else {
            for site in sites.iter_mut().filter(|s| s.kind != SiteKind::Vacancy) {
                let share = self.lost_share(site.number, dose);
                if share > 0.0 && uniform(self.seed, Purpose::Damage, 0, site.key) < share {
                    site.kind = SiteKind::Vacancy;
                }
            }
            return;
        };
        let members = |family: UnitFamily| {
            let patterns = self.patterns(family)?;
            let kind = patterns.kind(tag.entry.kind)?;
            Some((*kind.members.get(tag.member)?, patterns))
        };
        match self.outcome(&tag, dose) {
            UnitOutcome::Whole => {}
            UnitOutcome::Lost(lost) => {
                let Some((first, _)) = members(tag.family) else { return };
                for (site, lost) in sites.iter_mut().zip(&lost[first..]).filter(|(_, lost)| **lost)
                {
                    debug_assert!(*lost && site.kind != SiteKind::Vacancy);
                    site.kind = SiteKind::Vacancy;
                }
                column.unit = None;
            }
            UnitOutcome::Pattern(new) => {
                let Some((first, patterns)) = members(new.family) else { return };
                let Some(kind) = patterns.kind(new.entry.kind) else { return };
                let pattern = &kind.cells[&new.entry.cell];
                for (site, place) in sites.iter_mut().zip(&kind.sites[first..]) {
                    let vacant = place.defect.is_some_and(|d| pattern.binary_search(&d).is_ok());
                    site.kind = if vacant { SiteKind::Vacancy } else { SiteKind::Pristine };
                    site.number = place.number;
                }
                column.unit = Some(new);
            }
        }
    }

    /// Columns, and their sites, after what they have been through.
    fn with_losses(&self, mut found: Sites) -> Sites {
        let doses = self.dose();
        // All columns of a unit have the dose of its centre.
        let mut dose_of = BTreeMap::new();
        for column in &mut found.columns {
            let dose = match &column.unit {
                Some(tag) => *dose_of.entry(tag.id).or_insert_with(|| doses.at(tag.centre_nm)),
                None => doses.at(column.position_nm),
            };
            if dose > 0.0 {
                let sites = column.sites.clone();
                self.aged(column, &mut found.sites[sites], dose);
            }
        }
        found
    }
}

/// The vacancies of a unit (ascending) that had some before; `None` if atoms are lost that no pattern of its kind lacks.
fn vacancies(kind: &KindPatterns, before: &[u16], lost: &[bool]) -> Option<Vec<u16>> {
    let mut vacant = before.to_vec();
    for (site, _) in kind.sites.iter().zip(lost).filter(|(_, lost)| **lost) {
        vacant.push(site.defect?);
    }
    vacant.sort_unstable();
    Some(vacant)
}

impl Specimen for DamagedSpecimen {
    fn layout(&self) -> &dyn SpecimenLayout {
        self.inner.layout()
    }
    fn query(&self, region: &Region) -> Sites {
        self.with_losses(self.inner.query(region))
    }
    fn columns(&self, region: &Region) -> Vec<AtomColumn> {
        self.query(region).into_columns()
    }
    fn particles_on_a_plane(&self, region: &Region) -> Sites {
        self.with_losses(self.inner.particles_on_a_plane(region))
    }
    fn reached_families(&self, family: UnitFamily) -> Vec<UnitFamily> {
        self.bins(family).map(|bin| UnitFamily { bin, ..family }).collect()
    }
}
