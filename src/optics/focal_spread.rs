//! Focal spread: the average of images over a Gaussian distribution of the focus, by Gauss-Hermite quadrature.
//!
//! The amplitude behind the specimen is linear in the amplitudes of the aperture, `A(k) exp(-i chi(k))`. A change of focus by d turns them
//! by `pi lambda k^2 d`, so an intensity is a sum of terms `exp(i w d)` with `|w| <= pi semiangle^2 / lambda`. The exact mean of such a
//! term is `exp(-w^2 sigma^2 / 2)`, so the quadrature's error is known beforehand. The number of points is the smallest with an error below
//! [`ALLOWED`] for every w.

use std::f64::consts::PI;

use super::Optics;
use crate::error::{Error, Result};
use crate::setting::Setting;

/// Largest error of any term, as a share of its amplitude. The error of images is smaller, because few terms have the width of the whole
/// aperture.
const ALLOWED: f64 = 1e-3;
/// Most points of the quadrature.
const MOST_POINTS: usize = 15;
/// Number of frequencies at which the error is computed.
const FREQUENCIES: usize = 200;

/// A focus over which images are averaged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Focus {
    /// Added to the defocus, in Angstrom.
    pub offset_angstrom: f64,
    /// Weight of the focus; all weights sum to 1.
    pub weight: f64,
}

/// The foci for some optics. Without focal spread there is one.
///
/// # Errors
/// [`Error::Invalid`] for a spread that is negative, or so large that more than 15 points would be needed.
pub fn foci(optics: &Optics) -> Result<Vec<Focus>> {
    let sigma = optics.focal_spread_angstrom;
    if sigma == 0.0 {
        return Ok(vec![Focus { offset_angstrom: 0.0, weight: 1.0 }]);
    }
    let found = || (3..=MOST_POINTS).step_by(2).find(|n| error(optics, sigma, *n) <= ALLOWED);
    match found().filter(|_| sigma > 0.0 && sigma.is_finite()) {
        Some(points) => Ok(rule(points, sigma)),
        None => {
            let most = largest(optics);
            let semiangle = optics.semiangle_mrad;
            let expected = format!(
                "must be from 0 to {most:.1} at a semiangle of {semiangle} mrad: `C_c dE / E`, 20 to 60 is usual"
            );
            Err(Error::invalid(Setting::FocalSpreadAngstrom, sigma, expected))
        }
    }
}

/// The largest spread in Angstrom that the quadrature can average.
fn largest(optics: &Optics) -> f64 {
    // the error is a function of sigma times the highest frequency
    let (mut low, mut high) = (0.0, 10.0 / highest(optics));
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if error(optics, middle, MOST_POINTS) <= ALLOWED { low = middle } else { high = middle }
    }
    low
}

/// The largest angular frequency of an intensity as a function of the focus, in rad/Angstrom.
fn highest(optics: &Optics) -> f64 {
    let angle = optics.semiangle_mrad * 1e-3;
    PI * angle * angle / optics.wavelength_angstrom()
}

/// The largest error of the quadrature with `points` points.
fn error(optics: &Optics, sigma: f64, points: usize) -> f64 {
    let (rule, highest) = (rule(points, sigma), highest(optics));
    let off = |i: usize| {
        let w = highest * i as f64 / FREQUENCIES as f64;
        let sum: f64 = rule.iter().map(|f| f.weight * libm::cos(w * f.offset_angstrom)).sum();
        (sum - libm::exp(-0.5 * (w * sigma).powi(2))).abs()
    };
    // NaN counts as an infinite error: a maximum would ignore it.
    let worse = |most: f64, off: f64| if off.is_nan() { f64::INFINITY } else { most.max(off) };
    (1..=FREQUENCIES).map(off).fold(0.0, worse)
}

/// The Gauss-Hermite rule for a Gaussian of standard deviation `sigma`, by ascending offset.
fn rule(points: usize, sigma: f64) -> Vec<Focus> {
    let mut foci = Vec::with_capacity(points);
    for x in roots(points) {
        // probabilists' polynomials: w = n! / (n He_(n-1)(x))^2
        let [_, before] = hermite(points, x);
        let factorial: f64 = (1..=points).map(|k| k as f64).product();
        let weight = factorial / (points as f64 * before).powi(2);
        foci.push(Focus { offset_angstrom: sigma * x, weight });
    }
    let total: f64 = foci.iter().map(|f| f.weight).sum();
    foci.iter_mut().for_each(|f| f.weight /= total);
    foci
}

/// The roots of the n-th Hermite polynomial, ascending, by bisection between the roots of the polynomial before it.
fn roots(n: usize) -> Vec<f64> {
    let mut roots: Vec<f64> = Vec::new();
    for degree in 1..=n {
        let end = 2.0 * (degree as f64).sqrt() + 1.0;
        let edges: Vec<f64> = [-end].into_iter().chain(roots).chain([end]).collect();
        let middle = |edges: &[f64]| {
            if degree % 2 == 1 && edges[0] == -edges[1] { 0.0 } else { bisected(degree, edges) }
        };
        roots = edges.windows(2).map(middle).collect();
    }
    roots
}

/// The root of a Hermite polynomial between two edges, by bisection.
fn bisected(degree: usize, edges: &[f64]) -> f64 {
    let (mut low, mut high) = (edges[0], edges[1]);
    let sign = hermite(degree, high)[0].signum();
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if hermite(degree, middle)[0].signum() == sign { high = middle } else { low = middle }
    }
    0.5 * (low + high)
}

/// The Hermite polynomials `He_n` and `He_(n-1)` at x.
fn hermite(n: usize, x: f64) -> [f64; 2] {
    let (mut here, mut before) = (1.0, 0.0);
    for k in 0..n {
        (here, before) = (x * here - k as f64 * before, here);
    }
    [here, before]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spread(focal_spread_angstrom: f64) -> Optics {
        Optics { focal_spread_angstrom, ..Optics::default() }
    }

    /// Abramowitz and Stegun, table 25.10, for n = 5: x = 2.020182870 sqrt 2, w = 0.019953242 / sqrt pi.
    #[test]
    fn the_rule_is_that_of_tables() {
        let rule = rule(5, 1.0);
        assert!((rule[4].offset_angstrom - 2.020_182_870 * 2.0_f64.sqrt()).abs() < 1e-8);
        assert!((rule[4].weight - 0.019_953_242_06 / PI.sqrt()).abs() < 1e-10);
        // exact for polynomials up to degree 9: the 8th moment of a Gaussian is 105
        let moment: f64 = rule.iter().map(|f| f.weight * f.offset_angstrom.powi(8)).sum();
        assert!((moment - 105.0).abs() < 1e-9, "{moment}");
    }

    #[test]
    fn the_number_of_points_follows_from_the_spread() {
        assert_eq!(foci(&spread(0.0)).unwrap().len(), 1);
        let points: Vec<usize> =
            [5.0, 10.0, 25.0, 40.0].map(|s| foci(&spread(s)).unwrap().len()).into();
        assert_eq!(points, [3, 3, 5, 9]);
        for bad in [-1.0, 1e4, 1e308, f64::NAN, f64::INFINITY] {
            let message = foci(&spread(bad)).unwrap_err().to_string();
            assert!(message.contains("must be from 0 to"), "{message}");
        }
    }
}
