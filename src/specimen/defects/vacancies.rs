//! The probability of vacancies: a uniform part, and a part gathered about the boundaries.

use crate::error::{Error, Result};
use crate::recipe::tables::Vacancies;

/// Width of the bins of distance in which sites are counted, in nm.
const BIN_NM: f64 = 0.01;

/// Counts sites by their distance from the nearest boundary.
#[derive(Debug, Clone, Default)]
pub struct DistanceHistogram {
    counts: Vec<u64>,
    beyond: u64,
}

impl DistanceHistogram {
    /// Adds `n` sites at `distance_nm`; infinite where there is no boundary.
    pub fn add(&mut self, distance_nm: f64, n: u64) {
        if !distance_nm.is_finite() {
            self.beyond += n;
            return;
        }
        let bin = (distance_nm / BIN_NM) as usize;
        if bin >= self.counts.len() {
            self.counts.resize(bin + 1, 0);
        }
        self.counts[bin] += n;
    }

    /// Adds the sites of another histogram.
    pub fn merged(mut self, other: Self) -> Self {
        self.counts.resize(self.counts.len().max(other.counts.len()), 0);
        self.counts.iter_mut().zip(&other.counts).for_each(|(sum, n)| *sum += n);
        self.beyond += other.beyond;
        self
    }

    /// Returns the distances with sites (infinite where there is no boundary), and the number of sites at each.
    fn entries(&self) -> impl Iterator<Item = (f64, u64)> + '_ {
        let distance = |(bin, n): (usize, &u64)| ((bin as f64 + 0.5) * BIN_NM, *n);
        let near = self.counts.iter().enumerate().map(distance);
        near.filter(|(_, n)| *n > 0).chain([(f64::INFINITY, self.beyond)])
    }
}

/// Probability that a site is vacant, as a function of its distance d from the nearest boundary:
/// `min(cap, uniform + amplitude * exp(-d^2 / 2 sigma^2))`.
///
/// The amplitude is chosen so that the mean over the field is the rate. Where the cap limits the probability, the amplitude is greater than
/// it would be without a cap, and the vacancies spread wider.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VacancyProfile {
    /// Probability far from any boundary.
    pub uniform: f64,
    /// Additional probability at a boundary, before the cap.
    pub amplitude: f64,
    /// Width in nm.
    pub sigma_nm: f64,
    /// Upper limit.
    pub cap: f64,
}

impl VacancyProfile {
    /// Fits the profile to the sites of a field. Without boundaries all vacancies are uniform.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the cap leaves no room for the rate.
    pub fn fit(recipe: &Vacancies, sites: &DistanceHistogram) -> Result<Self> {
        let clustered = !sites.counts.is_empty() && recipe.cluster_fraction > 0.0;
        let share = if clustered { 1.0 - recipe.cluster_fraction } else { 1.0 };
        let mut profile = VacancyProfile {
            uniform: share * recipe.rate,
            amplitude: 0.0,
            sigma_nm: recipe.cluster_sigma_nm,
            cap: recipe.max_probability,
        };
        if !clustered || recipe.rate == 0.0 {
            return Ok(profile);
        }
        let total = sites.entries().map(|(_, n)| n).sum::<u64>().max(1) as f64;
        // The gathered share at a distance does not depend on the amplitude.
        let gathered: Vec<(f64, f64)> =
            sites.entries().map(|(d, n)| (profile.gathered(d), n as f64)).collect();
        let rate_at = |amplitude| {
            let trial = VacancyProfile { amplitude, ..profile };
            gathered.iter().map(|&(share, n)| n * trial.with_share(share)).sum::<f64>() / total
        };
        let mut high = recipe.rate;
        while rate_at(high) < recipe.rate {
            high *= 2.0;
            if high > 1e100 {
                let expected = "too high for vacancies.max_probability and cluster_sigma_nm; \
                                raise one of them or lower cluster_fraction";
                return Err(Error::invalid(crate::Setting::VacancyRate, recipe.rate, expected));
            }
        }
        let mut low = 0.0;
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            // No floating-point number lies between the two bounds.
            if middle <= low || middle >= high {
                break;
            }
            if rate_at(middle) < recipe.rate { low = middle } else { high = middle }
        }
        profile.amplitude = high;
        Ok(profile)
    }

    /// Returns the probability at `distance_nm` from the nearest boundary.
    pub fn probability(&self, distance_nm: f64) -> f64 {
        self.with_share(self.gathered(distance_nm))
    }

    /// Returns the share of the amplitude at a distance.
    fn gathered(&self, distance_nm: f64) -> f64 {
        let t = distance_nm / self.sigma_nm;
        libm::exp(-0.5 * t * t)
    }

    fn with_share(&self, share: f64) -> f64 {
        (self.uniform + self.amplitude * share).min(self.cap)
    }
}
