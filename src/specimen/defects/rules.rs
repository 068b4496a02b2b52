//! What a lattice site holds: vacancies and random substitutions.

use crate::error::Result;
use crate::recipe::resolved_recipe::Recipe;
use crate::rng::{self, Purpose};
use crate::specimen::defects::vacancies::{DistanceHistogram, VacancyProfile};
use crate::specimen::sites::SiteKind;
use crate::structure::elements;

/// Independent draws for one site.
mod draw {
    pub const VACANCY: u32 = 0;
    pub const SUBSTITUTION: u32 = 1;
}

/// Rules by which sites become defects. What a site holds depends on the seed and its key only.
#[derive(Debug, Clone, Default)]
pub struct Defects {
    seed: u64,
    vacancies: Option<(u8, VacancyProfile)>,
    /// Element, what replaces it, and how often.
    substitutions: Option<(u8, u8, f64)>,
}

impl Defects {
    /// Fits the rules to the sites of the full field; `count` adds the sites of the element that it
    /// is given to a histogram of their distance from the boundaries.
    ///
    /// # Errors
    /// [`crate::Error::UnknownElement`], and those of [`VacancyProfile::fit`].
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
        Ok(Defects { seed: recipe.seed, vacancies, substitutions })
    }

    /// The rule for sites at `distance_nm` from the nearest boundary.
    pub fn at(&self, distance_nm: f64) -> LocalDefects {
        let vacancies = self.vacancies.map(|(e, profile)| (e, profile.probability(distance_nm)));
        LocalDefects { seed: self.seed, vacancies, substitutions: self.substitutions }
    }
}

/// The rule at one place.
#[derive(Debug, Clone, Copy)]
pub struct LocalDefects {
    seed: u64,
    vacancies: Option<(u8, f64)>,
    substitutions: Option<(u8, u8, f64)>,
}

impl LocalDefects {
    /// How often a site where `element` belongs is a defect.
    pub fn rate(&self, element: u8) -> f64 {
        let vacant = self.vacancies.filter(|(e, _)| *e == element).map_or(0.0, |(_, p)| p);
        let replaced = self.substitutions.filter(|(e, _, _)| *e == element);
        vacant + (1.0 - vacant) * replaced.map_or(0.0, |(_, _, rate)| rate)
    }

    /// Kind of the site `key` where element `number` belongs, and the element that it holds (of a
    /// vacancy, the one that is missing).
    pub fn of(&self, key: u64, number: u8) -> (SiteKind, u8) {
        let drawn = |substream| rng::uniform(self.seed, Purpose::Defect, substream, key);
        if self.vacancies.is_some_and(|(e, p)| e == number && drawn(draw::VACANCY) < p) {
            return (SiteKind::Vacancy, number);
        }
        match self.substitutions {
            Some((element, by, rate)) if element == number && drawn(draw::SUBSTITUTION) < rate => {
                (SiteKind::Substitution, by)
            }
            _ => (SiteKind::Pristine, number),
        }
    }
}
