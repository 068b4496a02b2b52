//! Faster engines, audited against the exact one.

use super::specimens::{displaced, srtio3, unit_cell};
use super::{Case, Group, pair, percent, shown_percent, widened};
use crate::engine::settings::EXACT_BAND_FRACTION;
use crate::engine::{Algorithm, ProbeBox, Settings, window_for};
use crate::error::Result;
use crate::validate::difference::{Difference, extrapolated};
use crate::validate::{CheckRunner, Figure, Findings, Plot, Series, Style};

const EXACT: &str =
    "Multislice of this program on the full grid, which the cases above compare with abTEM.";

pub fn cases() -> Vec<Case> {
    let case = |name, title, about, quick, seconds, simulations, run| Case {
        name,
        title,
        group: Group::Engines,
        about,
        source: EXACT,
        quick,
        seconds,
        simulations,
        run,
    };
    vec![
        case(
            "windows",
            "Windows that follow the probe",
            "HAADF of SrTiO3 [001], 23.4 A wide, 3.9 nm thick, one configuration of displaced atoms, 10 x 10 probes over a cell, in the \
             windows chosen for an accuracy. The limit is the accuracy that was asked for (rms, of the mean).",
            false,
            8.0,
            1 + WINDOWS.len(),
            windows,
        ),
        case(
            "prism",
            "PRISM: without interpolation multislice, with it nearly",
            "HAADF of SrTiO3 [001], 1.2 nm thick, displaced atoms; 11.7 A wide for f = 1, else 23.4 A. An interpolated probe is periodic \
             in extent / f; the error from its cropped tails is measured.",
            false,
            8.0,
            6,
            prism,
        ),
        case(
            "band-fraction",
            "Anti-aliasing disk at 0.8 of Nyquist",
            "The default against 2/3, which excludes aliasing altogether: HAADF of SrTiO3 [001], 19.5 A, 3.9 nm, displaced atoms.",
            false,
            3.0,
            2,
            band,
        ),
        case(
            "cores",
            "Cores of the atoms in closed form",
            "HAADF of SrTiO3 [001], 11.7 A, 1.6 nm, static atoms, against potentials exponentiated on grids 3 and 6 times finer and \
             extrapolated.",
            false,
            2.0,
            3,
            cores,
        ),
    ]
}

const WINDOWS: [f64; 3] = [3.3, 0.8, 0.4];

fn windows(runner: &CheckRunner) -> Result<Findings> {
    let (sites, cell) = srtio3([6, 6, 10])?;
    let (base, scan) = (displaced(2), unit_cell(10));
    // Windows image an infinite specimen, so the reference must not be periodic.
    let alike = Settings { probe_box: Some(ProbeBox::Large), ..base.clone() };
    let exact = widened(runner.simulate(&alike, &sites, cell, &scan)?.image(0, 0));
    let mut f = Findings::default();
    let mut points = Vec::new();
    for accuracy in WINDOWS {
        let width_angstrom = window_for(accuracy, &base, cell[2])?.width_angstrom;
        let algorithm = Algorithm::Window { width_angstrom };
        let settings = Settings { algorithm, ..base.clone() };
        let ours = widened(runner.simulate(&settings, &sites, cell, &scan)?.image(0, 0));
        let difference = Difference::between(ours.view(), exact.view());
        let what = format!("windows of {width_angstrom:.1} A: rms difference, of the mean");
        f.checks.push(percent(what, difference.rms, accuracy / 100.0));
        let what = format!("windows of {width_angstrom:.1} A: difference of the means");
        f.checks.push(shown_percent(what, difference.bias));
        points.push((width_angstrom, 100.0 * difference.rms));
        let title = format!("windows of {width_angstrom:.1} A (ours) and multislice (reference)");
        f.figures.push(pair(title, ours, exact.clone(), &scan, 0.02));
    }
    let asked = points.iter().zip(WINDOWS).map(|((w, _), a)| (*w, a)).collect();
    f.figures.push(Figure::Plot(Plot {
        title: "Error of windows".into(),
        x: "width of the window in A".into(),
        y: "rms difference, % of the mean".into(),
        logarithmic: [false, true],
        series: vec![
            Series { name: "measured here".into(), points, style: Style::Both },
            Series { name: "limit".into(), points: asked, style: Style::Dashed },
        ],
    }));
    Ok(f)
}

fn prism(runner: &CheckRunner) -> Result<Findings> {
    let mut f = Findings::default();
    for (cells, factor, limit) in [(3, 1, Some(1e-5)), (6, 2, Some(0.03)), (6, 3, None)] {
        let (sites, cell) = srtio3([cells, cells, 3])?;
        let (base, scan) = (displaced(3), unit_cell(6));
        let exact = widened(runner.simulate(&base, &sites, cell, &scan)?.image(0, 0));
        let algorithm = Algorithm::Prism { interpolation: [factor; 2] };
        let settings = Settings { algorithm, ..base.clone() };
        let ours = widened(runner.simulate(&settings, &sites, cell, &scan)?.image(0, 0));
        let largest = Difference::between(ours.view(), exact.view()).largest;
        let window = cell[0] / factor as f64;
        let what =
            format!("f = {factor}, windows of {window:.1} A: largest difference, of the maximum");
        f.checks.push(match limit {
            Some(limit) => percent(what, largest, limit),
            None => shown_percent(what, largest),
        });
        let title = format!("PRISM f = {factor} (ours) and multislice (reference)");
        f.figures.push(pair(title, ours, exact, &scan, limit.unwrap_or(0.1)));
    }
    Ok(f)
}

fn band(runner: &CheckRunner) -> Result<Findings> {
    let (sites, cell) = srtio3([5, 5, 10])?;
    let (base, scan) = (displaced(2), unit_cell(6));
    let wide = Settings { band_fraction: EXACT_BAND_FRACTION, ..base.clone() };
    let run = |settings| -> Result<_> {
        Ok(widened(runner.simulate(settings, &sites, cell, &scan)?.image(0, 0)))
    };
    let (ours, exact) = (run(&base)?, run(&wide)?);
    let largest = Difference::between(ours.view(), exact.view()).largest;
    Ok(Findings {
        checks: vec![percent("largest difference, of the maximum", largest, 1e-3)],
        figures: vec![pair("0.8 (ours) and 2/3 (reference)", ours, exact, &scan, 1e-3)],
    })
}

fn cores(runner: &CheckRunner) -> Result<Findings> {
    let (sites, cell) = srtio3([3, 3, 4])?;
    let scan = unit_cell(6);
    let run = |oversampling| -> Result<_> {
        let settings = Settings { oversampling, ..Settings::default() };
        Ok(widened(runner.simulate(&settings, &sites, cell, &scan)?.image(0, 0)))
    };
    let (ours, coarse, fine) = (run(None)?, run(Some(3))?, run(Some(6))?);
    let limit = extrapolated(&coarse, &fine, 2.0);
    let rms = |image: &ndarray::Array2<f64>| Difference::between(image.view(), limit.view()).rms;
    Ok(Findings {
        checks: vec![
            percent("cores in closed form: rms difference, of the mean", rms(&ours), 2e-3),
            shown_percent(
                "potentials on a grid 3 times finer: rms difference, of the mean",
                rms(&coarse),
            ),
        ],
        figures: vec![pair("closed form (ours) and refined (reference)", ours, limit, &scan, 2e-3)],
    })
}
