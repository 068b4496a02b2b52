//! Tables of scattering factors.

use super::{Case, Group};
use crate::error::{Error, Result};
use crate::potential::scattering::{Parametrization, ScatteringFactor};
use crate::setting::Setting;
use crate::structure::elements;
use crate::validate::golden::SCATTERING_FACTORS;
use crate::validate::{Check, CheckRunner, Figure, Findings, Limit, Plot, Series, Style};

pub fn cases() -> Vec<Case> {
    vec![Case {
        name: "scattering-factors",
        title: "Electron scattering factors: tables, and published values",
        group: Group::Published,
        about: "The parametrizations of Lobato and Van Dyck, Kirkland, and Peng as abTEM evaluates them; hydrogen in closed form; and the \
                Gaussians that Doyle and Turner fitted to relativistic Hartree-Fock calculations, which other parametrizations \
                should match to a few per cent.",
        source: "P. A. Doyle, P. S. Turner, Acta Cryst. A 24 (1968) 390; the header of tests/golden/scattering_factors.csv names the rest.",
        quick: true,
        seconds: 0.2,
        simulations: 0,
        run: factors,
    }]
}

struct FactorRow {
    source: String,
    table: Parametrization,
    number: u8,
    /// Scattering vector in 1/Angstrom.
    q: f64,
    /// Expected value in Angstrom.
    expected: f64,
}

fn rows() -> Result<Vec<FactorRow>> {
    let bad =
        |line: &str| Error::invalid(Setting::ScatteringFactor, line, "is not a row of the table");
    let lines =
        SCATTERING_FACTORS.lines().filter(|l| !l.starts_with('#') && !l.starts_with("source"));
    let row = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        let [source, table, number, _, q, expected] = fields[..] else { return Err(bad(line)) };
        let value = |text: &str| text.parse::<f64>().map_err(|_| bad(line));
        Ok(FactorRow {
            source: source.to_owned(),
            table: match table {
                "kirkland" => Parametrization::Kirkland,
                "peng" => Parametrization::Peng,
                _ => Parametrization::Lobato,
            },
            number: number.parse().map_err(|_| bad(line))?,
            q: value(q)?,
            expected: value(expected)?,
        })
    };
    lines.map(row).collect()
}

fn factors(_: &CheckRunner) -> Result<Findings> {
    let rows = rows()?;
    let [mut tables, mut published] = [(0.0_f64, 0); 2];
    let mut series: Vec<Series> = Vec::new();
    for row in &rows {
        let ours = ScatteringFactor::new(row.table, row.number)?.at(row.q * row.q);
        let error = 100.0 * (ours / row.expected - 1.0);
        let of_abtem = row.source == "abtem";
        let kind = if of_abtem { &mut tables } else { &mut published };
        *kind = (kind.0.max(error.abs()), kind.1 + 1);
        if !of_abtem {
            let name = format!("{}, {:?}", elements::symbol(row.number), row.table);
            match series.iter_mut().find(|s| s.name == name) {
                Some(s) => s.points.push((row.q, error)),
                None => {
                    series.push(Series { name, points: vec![(row.q, error)], style: Style::Both })
                }
            }
        }
    }
    let count = |what, n: i32, least| Check::new(what, f64::from(n), "", Limit::AtLeast(least));
    Ok(Findings {
        checks: vec![
            Check::new(
                "tables as abTEM evaluates them: largest error",
                tables.0,
                "%",
                Limit::AtMost(1e-5),
            ),
            count("values compared with abTEM", tables.1, 500.0),
            Check::new(
                "published values: largest difference",
                published.0,
                "%",
                Limit::AtMost(4.0),
            ),
            count("published values", published.1, 20.0),
        ],
        figures: vec![Figure::Plot(Plot {
            title: "Difference from published values".into(),
            x: "spatial frequency in 1/A".into(),
            y: "difference in %".into(),
            logarithmic: [false, false],
            series,
        })],
    })
}
