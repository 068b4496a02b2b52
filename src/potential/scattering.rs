//! Electron scattering factors of neutral atoms.
//!
//! `f(q)` in Angstrom with `q = (scattering angle) / lambda` in 1/Angstrom, first Born
//! approximation, rest mass. Tables, formulas and papers: `data/*.csv`.

use crate::error::{Error, Result};
use crate::simd::vectorised;
use crate::structure::elements;
use std::f64::consts::PI;
use std::sync::OnceLock;

/// Which table of scattering factors.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, Default, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Parametrization {
    /// Lobato & Van Dyck, Acta Cryst. A70 (2014) 636.
    #[default]
    Lobato,
    /// Kirkland, Advanced Computing in Electron Microscopy (2010), appendix C.
    Kirkland,
    /// Peng, Ren, Dudarev & Whelan, Acta Cryst. A52 (1996) 257, for s up to 6 1/Angstrom.
    Peng,
}

/// One term of a scattering factor as a function of `q`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Term {
    /// `a / (q^2 + b)`
    Lorentzian { a: f64, b: f64 },
    /// `a / (q^2 + b)^2`
    SquaredLorentzian { a: f64, b: f64 },
    /// `a exp(-b q^2)`
    Gaussian { a: f64, b: f64 },
}

/// The scattering factor of one element.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ScatteringFactor {
    pub(super) terms: Vec<Term>,
}

impl ScatteringFactor {
    /// The factor of element `number`.
    ///
    /// # Errors
    /// [`Error::UnknownElement`] for an element beyond the end of the table.
    pub(crate) fn new(parametrization: Parametrization, number: u8) -> Result<Self> {
        let p = table(parametrization)
            .get(number as usize)
            .filter(|p| !p.is_empty())
            .ok_or_else(|| Error::UnknownElement(elements::symbol(number).to_owned()))?;
        let terms = match parametrization {
            // (2 + b q^2) / (1 + b q^2)^2 = 1 / (1 + b q^2) + 1 / (1 + b q^2)^2
            Parametrization::Lobato => (0..5)
                .flat_map(|i| {
                    let (a, b) = (p[i], 1.0 / p[5 + i]);
                    let squared = Term::SquaredLorentzian { a: a * b * b, b };
                    [Term::Lorentzian { a: a * b, b }, squared]
                })
                .collect(),
            Parametrization::Kirkland => (0..3)
                .flat_map(|i| {
                    let gaussian = Term::Gaussian { a: p[6 + i], b: p[9 + i] };
                    [Term::Lorentzian { a: p[i], b: p[3 + i] }, gaussian]
                })
                .collect(),
            // published for s = q / 2
            Parametrization::Peng => {
                (0..5).map(|i| Term::Gaussian { a: p[i], b: p[5 + i] / 4.0 }).collect()
            }
        };
        Ok(ScatteringFactor { terms })
    }

    /// `f` in Angstrom at `q2 = q^2` in 1/Angstrom^2.
    pub(crate) fn at(&self, q2: f64) -> f64 {
        let term = |t: &Term| match *t {
            Term::Lorentzian { a, b } => a / (q2 + b),
            Term::SquaredLorentzian { a, b } => a / ((q2 + b) * (q2 + b)),
            Term::Gaussian { a, b } => a * (-b * q2).exp(),
        };
        self.terms.iter().map(term).sum()
    }

    /// [`ScatteringFactor::at`] at many places, with identical digits.
    pub(crate) fn at_each(&self, q2: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; q2.len()];
        vectorised(
            #[inline(always)]
            || {
                for term in &self.terms {
                    let places = sums.iter_mut().zip(q2);
                    match *term {
                        Term::Lorentzian { a, b } => places.for_each(|(s, q2)| *s += a / (q2 + b)),
                        Term::SquaredLorentzian { a, b } => {
                            places.for_each(|(s, q2)| *s += a / ((q2 + b) * (q2 + b)));
                        }
                        Term::Gaussian { a, b } => {
                            places.for_each(|(s, q2)| *s += a * (-b * q2).exp());
                        }
                    }
                }
            },
        );
        sums
    }

    /// The projected potential at distance `r` (Angstrom, above 0) from the axis, in units of
    /// [`POTENTIAL_PER_SCATTERING_FACTOR`](crate::constants::POTENTIAL_PER_SCATTERING_FACTOR):
    /// `2 pi int f(q) J0(2 pi q r) q dq` in 1/Angstrom, in closed form.
    pub(crate) fn projected(&self, r: f64) -> f64 {
        let term = |t: &Term| match *t {
            Term::Lorentzian { a, b } => 2.0 * PI * a * puruspe::Kn(0, 2.0 * PI * b.sqrt() * r),
            Term::SquaredLorentzian { a, b } => {
                2.0 * PI * a * (PI * r / b.sqrt()) * puruspe::Kn(1, 2.0 * PI * b.sqrt() * r)
            }
            Term::Gaussian { a, b } => a * PI / b * (-(PI * r).powi(2) / b).exp(),
        };
        self.terms.iter().map(term).sum()
    }

    /// The part of `f` that belongs to the potential between `z1` and `z2` (Angstrom, measured from
    /// the nucleus along the beam), at transverse `q2`: `f_slab(q) = int_z1^z2 dz int dk_z f exp(2 pi
    /// i k_z z)`. From minus to plus infinity it is [`ScatteringFactor::at`].
    pub(crate) fn between(&self, q2: f64, z1: f64, z2: f64) -> f64 {
        self.terms.iter().map(|t| t.below(q2, z2) - t.below(q2, z1)).sum()
    }
}

impl Term {
    /// Integral over the potential from minus infinity to `z`, up to a constant: odd in `z`.
    fn below(&self, q2: f64, z: f64) -> f64 {
        match *self {
            Term::Lorentzian { a, b } => {
                let c = (q2 + b).sqrt();
                a / (2.0 * (q2 + b)) * z.signum() * -(-2.0 * PI * c * z.abs()).exp_m1()
            }
            Term::SquaredLorentzian { a, b } => {
                let c = (q2 + b).sqrt();
                let u = 2.0 * PI * c * z.abs();
                let decay = (-u).exp() * (1.0 + 0.5 * u);
                a / (2.0 * c.powi(4)) * z.signum() * (1.0 - decay)
            }
            Term::Gaussian { a, b } => 0.5 * a * (-b * q2).exp() * libm::erf(PI * z / b.sqrt()),
        }
    }
}

/// Parameters by atomic number.
fn table(parametrization: Parametrization) -> &'static [Vec<f64>] {
    static TABLES: [OnceLock<Vec<Vec<f64>>>; 3] = [const { OnceLock::new() }; 3];
    let (index, text) = match parametrization {
        Parametrization::Lobato => (0, include_str!("data/lobato.csv")),
        Parametrization::Kirkland => (1, include_str!("data/kirkland.csv")),
        Parametrization::Peng => (2, include_str!("data/peng.csv")),
    };
    TABLES[index].get_or_init(|| parse(text))
}

/// Reads `Z,symbol,parameters...`. The tables are compiled in and a test parses them all, so a
/// malformed number cannot reach a user; it would read as NaN.
fn parse(text: &str) -> Vec<Vec<f64>> {
    let mut table = vec![Vec::new()];
    let rows = text.lines().filter(|l| !l.starts_with('#') && !l.starts_with('Z'));
    for row in rows {
        table.push(row.split(',').skip(2).map(|v| v.trim().parse().unwrap_or(f64::NAN)).collect());
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Parametrization; 3] =
        [Parametrization::Lobato, Parametrization::Kirkland, Parametrization::Peng];

    #[test]
    fn tables_are_complete_and_finite() {
        for p in ALL {
            for number in 1..=92 {
                let f = ScatteringFactor::new(p, number).unwrap();
                for q in [0.0, 0.5, 2.0, 8.0] {
                    assert!(f.at(q * q).is_finite() && f.at(q * q) > 0.0, "{p:?} {number} {q}");
                }
            }
            let text = match p {
                Parametrization::Lobato => include_str!("data/lobato.csv"),
                Parametrization::Kirkland => include_str!("data/kirkland.csv"),
                Parametrization::Peng => include_str!("data/peng.csv"),
            };
            let rows = text.lines().filter(|l| l.starts_with(|c: char| c.is_ascii_digit()));
            for (i, row) in rows.enumerate() {
                let mut fields = row.split(',');
                assert_eq!(fields.next().unwrap(), (i + 1).to_string());
                assert_eq!(fields.next().unwrap(), elements::symbol(i as u8 + 1));
            }
        }
    }

    #[test]
    fn rutherford_limit_at_large_angles() {
        // f -> Z / (2 pi^2 a0 q^2): Lobato obeys it by construction
        for number in [6, 14, 38, 78] {
            let f = ScatteringFactor::new(Parametrization::Lobato, number).unwrap();
            let q2 = 60.0_f64 * 60.0;
            let bare = f64::from(number) / (2.0 * PI * PI * 0.529_177_21 * q2);
            assert!((f.at(q2) / bare - 1.0).abs() < 0.01, "{number}: {} {bare}", f.at(q2));
        }
    }

    #[test]
    fn many_places_at_once_are_each_by_itself() {
        let q2: Vec<f64> = (0..37).map(|i| 0.003 * f64::from(i * i * i)).collect();
        for p in ALL {
            let f = ScatteringFactor::new(p, 38).unwrap();
            let each: Vec<f64> = q2.iter().map(|q2| f.at(*q2)).collect();
            assert_eq!(f.at_each(&q2), each, "{p:?}");
        }
    }

    #[test]
    fn slabs_add_up_to_the_whole_atom() {
        for p in ALL {
            let f = ScatteringFactor::new(p, 22).unwrap();
            for q2 in [0.0, 0.3, 4.0, 50.0] {
                let cuts = [-300.0, -1.0, -0.1, 0.0, 0.05, 0.7, 300.0];
                let sum: f64 = cuts.windows(2).map(|w| f.between(q2, w[0], w[1])).sum();
                assert!((sum / f.at(q2) - 1.0).abs() < 1e-6, "{p:?} {q2}: {sum} {}", f.at(q2));
            }
        }
    }

    /// `between` against numerical integration of the inverse transform along k_z.
    #[test]
    fn slab_agrees_with_numerical_integration() {
        let term_cases = [
            Term::Lorentzian { a: 0.7, b: 0.3 },
            Term::SquaredLorentzian { a: 0.7, b: 0.3 },
            Term::Gaussian { a: 0.7, b: 0.6 },
        ];
        for term in term_cases {
            let f = ScatteringFactor { terms: vec![term] };
            let (q2, z1, z2) = (0.4, -0.2, 0.35);
            // int dkz f(q2 + kz^2) (sin 2 pi kz z2 - sin 2 pi kz z1) / (2 pi kz)
            let (n, top) = (2_000_000, 400.0);
            let h = top / f64::from(n);
            let sum: f64 = (0..n)
                .map(|i| {
                    let kz = (f64::from(i) + 0.5) * h;
                    let sines = (2.0 * PI * kz * z2).sin() - (2.0 * PI * kz * z1).sin();
                    2.0 * h * f.at(q2 + kz * kz) * sines / (2.0 * PI * kz)
                })
                .sum();
            let exact = f.between(q2, z1, z2);
            assert!((sum - exact).abs() < 1e-6, "{term:?}: {sum} {exact}");
        }
    }
}
