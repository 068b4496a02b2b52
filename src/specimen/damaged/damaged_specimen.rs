//! A specimen that loses atoms under the beam.
//!
//! Every atom has a random number u, and is lost once the dose D at its column satisfies `1 - exp(-cross-section D) > u`. Which atoms are
//! left depends on the seed and on the total dose alone, not on the steps of the dose.
//!
//! A unit with a place in the library of a mosaic keeps a place, as far as the library can show its losses: among the patterns with the
//! right number of vacancies it takes the one that has most of them on the right sites. Numbers of vacancies are therefore exact; the
//! vacant sites of a column are not always (atoms also move along a column under the beam, which is not modelled here). All other columns
//! hold exactly the atoms that are left, and are simulated at their own place.

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

/// First draw of [`Purpose::Damage`] for the atoms of a unit, by their place in the unit; draw 0 is for atoms of other columns.
const FIRST_SITE_DRAW: u32 = 16;
/// Draw that chooses among equally good patterns.
const PATTERN_DRAW: u32 = 1;

/// A specimen whose atoms are lost with the dose at their column.
pub struct DamagedSpecimen {
    inner: Arc<dyn Specimen>,
    seed: u64,
    /// Cross-sections in square Angstrom for the loss of an atom, by atomic number; 0 for elements that stay.
    losses: Vec<f64>,
    /// Greatest dose that the library of a mosaic is made for.
    most_dose: f64,
    dose: RwLock<DoseMap>,
    families: RwLock<HashMap<UnitFamily, Arc<UnitPatterns>>>,
}

/// State of a unit after a dose.
enum UnitOutcome {
    /// It has lost nothing.
    Whole,
    /// It looks like this unit of the library, which has the right number of vacancies.
    Pattern(UnitTag),
    /// It has lost these sites, one member after the other, and the library does not show it.
    Lost(Vec<bool>),
}

impl DamagedSpecimen {
    /// Prepares the specimen of a recipe for damage, with no atom lost yet; the table `[damage]` gives the cross-sections. `most_dose`
    /// (electrons per square Angstrom) decides how many vacancies the library of a mosaic shows.
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

    /// Whether no dose changes the specimen.
    pub fn is_lasting(&self) -> bool {
        self.losses.iter().all(|loss| *loss == 0.0)
    }

    /// Returns the map of doses.
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

    /// Returns the state of a unit after a dose.
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

    /// Finds the unit of the library with these vacancies; `share` is the share of atoms of the kind that is lost.
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

    /// Returns the bins that units of a family can reach, up to the greatest dose.
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

    /// Removes the atoms of a column, and of its sites, that are lost after a dose.
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

    /// Removes the lost atoms from columns and sites.
    fn with_losses(&self, mut found: Sites) -> Sites {
        let doses = self.dose();
        // All columns of a unit take the dose of its centre.
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

/// Adds the lost sites to the vacancies that a unit had before (ascending); `None` if a lost atom is vacant in no pattern of its kind.
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
