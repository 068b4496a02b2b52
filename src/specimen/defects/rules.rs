//! Rules for the defects of a lattice site: vacancies and random substitutions.

use crate::error::Result;
use crate::recipe::resolved_recipe::Recipe;
use crate::recipe::tables::MOST_POINT_DEFECTS;
use crate::rng::{self, Purpose};
use crate::specimen::defects::vacancies::{DistanceHistogram, VacancyProfile};
use crate::specimen::sites::SiteKind;
use crate::specimen::units::occupation::DefectKind;
use crate::structure::elements;

/// Numbers of the independent draws for one site.
mod draw {
    pub const VACANCY: u32 = 0;
    pub const SUBSTITUTION: u32 = 1;
    pub const FURTHER: u32 = 2;
}

/// Rules by which sites become defects. The result for a site depends on the seed and on its key only.
#[derive(Debug, Clone, Default)]
pub struct Defects {
    seed: u64,
    vacancies: Option<(u8, VacancyProfile)>,
    /// Atomic numbers of the replaced element and of its substitute, and the rate.
    substitutions: Option<(u8, u8, f64)>,
    further: FurtherDefects,
}

/// Further kinds of defects, and the rate of each.
type FurtherDefects = [Option<(DefectKind, f64)>; MOST_POINT_DEFECTS];

impl Defects {
    /// Fits the rules to the sites of the full field; `count` adds the sites of the given element to a histogram of their distance from the
    /// boundaries.
    ///
    /// # Errors
    /// [`crate::Error::UnknownElement`], and errors of [`VacancyProfile::fit`].
    pub fn fit(recipe: &Recipe, count: impl FnOnce(u8, &mut DistanceHistogram)) -> Result<Self> {
        let vacancies = match &recipe.vacancies {
            Some(v) => {
                let element = elements::atomic_number(&v.element)?;
                let mut histogram = DistanceHistogram::default();
                count(element, &mut histogram);
                Some((element, VacancyProfile::fit(v, &histogram)?))
            }
            None => None,
        };
        let substitutions = match &recipe.substitutions {
            Some(s) => {
                let number = elements::atomic_number;
                Some((number(&s.element)?, number(&s.by)?, s.rate))
            }
            None => None,
        };
        let mut further = FurtherDefects::default();
        for (place, defect) in further.iter_mut().zip(&recipe.defects) {
            *place = Some((DefectKind::of(defect)?, defect.rate));
        }
        Ok(Defects { seed: recipe.seed, vacancies, substitutions, further })
    }

    /// Returns the rules for sites at `distance_nm` from the nearest boundary.
    pub fn at(&self, distance_nm: f64) -> LocalDefects {
        let vacancies = self.vacancies.map(|(e, profile)| (e, profile.probability(distance_nm)));
        let Defects { seed, substitutions, further, .. } = *self;
        LocalDefects { seed, vacancies, substitutions, further }
    }
}

/// The rules at one place.
#[derive(Debug, Clone, Copy)]
pub struct LocalDefects {
    seed: u64,
    vacancies: Option<(u8, f64)>,
    substitutions: Option<(u8, u8, f64)>,
    further: FurtherDefects,
}

impl LocalDefects {
    /// Returns the probability that a site of `element` is a defect.
    pub fn rate(&self, element: u8) -> f64 {
        let vacant = self.vacancies.filter(|(e, _)| *e == element).map_or(0.0, |(_, p)| p);
        let replaced = self.substitutions.filter(|(e, _, _)| *e == element);
        let first = vacant + (1.0 - vacant) * replaced.map_or(0.0, |(_, _, rate)| rate);
        let further = self.further.iter().flatten().filter(|(kind, _)| kind.element == element);
        further.fold(first, |rate, (_, more)| rate + (1.0 - rate) * more)
    }

    /// Returns the probability that a site of the element of `kind` is drawn to be that defect, without regard to the other kinds.
    pub fn rate_of(&self, kind: DefectKind) -> f64 {
        let vacant = self.vacancies.filter(|(e, _)| kind == DefectKind { element: *e, by: None });
        let replaced = self
            .substitutions
            .filter(|(element, by, _)| kind == DefectKind { element: *element, by: Some(*by) });
        let further = self.further.iter().flatten().filter(|(k, _)| *k == kind);
        let first = vacant.map(|(_, rate)| rate).or(replaced.map(|(_, _, rate)| rate));
        further.fold(first.unwrap_or(0.0), |rate, (_, more)| rate + (1.0 - rate) * more)
    }

    /// Returns the kind of the site `key` where element `number` belongs, and the element that it holds (of a vacancy, the missing
    /// element).
    pub fn of(&self, key: u64, number: u8) -> (SiteKind, u8) {
        let drawn = |substream| rng::uniform(self.seed, Purpose::Defect, substream, key);
        if self.vacancies.is_some_and(|(e, p)| e == number && drawn(draw::VACANCY) < p) {
            return (SiteKind::Vacancy, number);
        }
        match self.substitutions {
            Some((element, by, rate)) if element == number && drawn(draw::SUBSTITUTION) < rate => {
                return (SiteKind::Substitution, by);
            }
            _ => {}
        }
        for (substream, (kind, rate)) in (draw::FURTHER..).zip(self.further.iter().flatten()) {
            if kind.element == number && drawn(substream) < *rate {
                return kind.defect();
            }
        }
        (SiteKind::Pristine, number)
    }
}
