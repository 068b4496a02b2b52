//! Values from the literature.

use ndarray::s;

use super::{Case, Group, specimens};
use crate::detect::Detector;
use crate::engine::{GridChoice, Scan, Settings, Site, exit_wave, lens_image};
use crate::error::Result;
use crate::optics::{Aberration, Aberrations, ApertureEdge, Optics};
use crate::potential::scattering::Parametrization;
use crate::validate::check_runner::plan;
use crate::validate::{Check, CheckRunner, Figure, Findings, Limit, Plot, Series, Style};

pub fn cases() -> Vec<Case> {
    vec![
        Case {
            name: "kirkland-5-12",
            title: "Kirkland's figure 5.12: bright-field image of five atoms",
            group: Group::Published,
            about: "C, Si, Cu, Au and U atoms 10 A apart; 200 kV, C_s 1.3 mm, defocus 700 A, aperture 10.37 mrad, 512 x 512 points, \
                    Kirkland's scattering factors. The book gives the extrema of the image to two digits.",
            source: "E. J. Kirkland, Advanced Computing in Electron Microscopy, 2nd ed. (2010), fig. 5.12: 0.72 to 1.03.",
            quick: true,
            seconds: 1.0,
            simulations: 1,
            run: kirkland,
        },
        Case {
            name: "z-exponent",
            title: "HAADF of single atoms grows as a power of Z",
            group: Group::Published,
            about: "Cross sections of seven elements (the image of one atom, integrated over the probe's position) at 200 kV, 21 mrad, \
                    68-200 mrad; the exponent is the slope of a straight line through their logarithms.",
            source: "O. L. Krivanek et al., Nature 464 (2010) 571: 1.64, for 58-200 mrad; usual values lie between 1.5 and 2.",
            quick: true,
            seconds: 2.0,
            simulations: NUMBERS.len(),
            run: exponent,
        },
    ]
}

fn kirkland(runner: &CheckRunner) -> Result<Findings> {
    let site = |(i, number): (usize, &u8)| Site {
        position: [5.0 + 10.0 * i as f64, 25.0, 1.0],
        number: *number,
        sigma_angstrom: 0.0,
        anisotropy: None,
        key: i as u64,
    };
    let sites: Vec<Site> = [6, 14, 29, 79, 92].iter().enumerate().map(site).collect();
    let mut aberrations = Aberrations::defocus(700.0);
    aberrations.0.push(Aberration::parse("C30=1.3e7")?);
    let edge = ApertureEdge::Hard;
    let optics = Optics { semiangle_mrad: 10.37, aberrations, edge, ..Optics::default() };
    let settings = Settings {
        optics: optics.clone(),
        parametrization: Parametrization::Kirkland,
        grid: GridChoice::Points([512, 512]),
        detectors: vec![Detector::new("unused", 0.0, 10.0)],
        ..Settings::default()
    };
    let mut plan = plan(&settings, &sites, [50.0, 50.0, 2.0])?;
    // The book puts the focus on the atoms.
    plan.slices.boundaries = vec![1.0 - 1e-9, 1.0 + 1e-9];
    let share = runner.share();
    let exit = exit_wave(&plan, &sites, 0, &share)?;
    share.complete();
    let image = lens_image(&exit, [50.0, 50.0], &optics).mapv(f64::from);
    let low = image.iter().copied().fold(f64::MAX, f64::min);
    let high = image.iter().copied().fold(0.0, f64::max);
    let row = image.slice(s![256, ..]);
    let points = row.iter().enumerate().map(|(i, v)| (i as f64 * 50.0 / 512.0, *v)).collect();
    let level = |name: &str, value: f64| Series {
        name: name.into(),
        points: vec![(0.0, value), (50.0, value)],
        style: Style::Dashed,
    };
    Ok(Findings {
        checks: vec![
            Check::new("darkest", low, "of the incident intensity", Limit::Between(0.71, 0.73)),
            Check::new("brightest", high, "of the incident intensity", Limit::Between(1.02, 1.04)),
        ],
        figures: vec![Figure::Plot(Plot {
            title: "Image through the atoms C, Si, Cu, Au, U".into(),
            x: "x in A".into(),
            y: "intensity; incident 1".into(),
            logarithmic: [false, false],
            series: vec![
                Series { name: "this program".into(), points, style: Style::Line },
                level("published minimum 0.72", 0.72),
                level("published maximum 1.03", 1.03),
            ],
        })],
    })
}

const NUMBERS: [u8; 7] = [6, 8, 14, 22, 38, 47, 79];

fn exponent(runner: &CheckRunner) -> Result<Findings> {
    let settings = specimens::displaced(0);
    let scan = Scan { origin_angstrom: [4.5; 2], step_angstrom: [0.3; 2], shape: [11, 11] };
    let mut points = Vec::new();
    for number in NUMBERS {
        let site = Site {
            position: [6.0, 6.0, 1.0],
            number,
            sigma_angstrom: 0.08,
            anisotropy: None,
            key: 0,
        };
        let images = runner.simulate(&settings, &[site], [12.0, 12.0, 2.0], &scan)?;
        let sum: f64 = images.data.iter().map(|v| f64::from(*v)).sum();
        // The integral is in square Angstrom.
        points.push((f64::from(number), sum * scan.step_angstrom[0] * scan.step_angstrom[1]));
    }
    let (slope, offset) = line(&points.iter().map(|(z, v)| (z.ln(), v.ln())).collect::<Vec<_>>());
    let fit = |z: f64| (z, (offset + slope * z.ln()).exp());
    Ok(Findings {
        checks: vec![Check::new("exponent of Z", slope, "", Limit::Between(1.5, 2.0))],
        figures: vec![Figure::Plot(Plot {
            title: format!("Cross section for 68-200 mrad; the line is Z^{slope:.2}"),
            x: "atomic number Z".into(),
            y: "cross section in A^2".into(),
            logarithmic: [true, true],
            series: vec![
                Series { name: "this program".into(), points, style: Style::Points },
                Series {
                    name: format!("Z^{slope:.2}"),
                    points: vec![fit(5.0), fit(92.0)],
                    style: Style::Line,
                },
            ],
        })],
    })
}

/// Fits a straight line by least squares; returns slope and offset.
fn line(points: &[(f64, f64)]) -> (f64, f64) {
    let n = points.len() as f64;
    let mean_x = points.iter().map(|p| p.0).sum::<f64>() / n;
    let mean_y = points.iter().map(|p| p.1).sum::<f64>() / n;
    let product: f64 = points.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    let slope = product / points.iter().map(|p| (p.0 - mean_x).powi(2)).sum::<f64>();
    (slope, mean_y - slope * mean_x)
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_straight_line_is_found() {
        let (slope, offset) = super::line(&[(1.0, 5.0), (2.0, 7.0), (4.0, 11.0)]);
        assert!((slope - 2.0).abs() < 1e-12 && (offset - 3.0).abs() < 1e-12);
    }
}
