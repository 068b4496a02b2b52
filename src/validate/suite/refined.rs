//! Displaced atoms and slice boundaries, where grids of the usual size are inexact: our images and abTEM's images are compared with one
//! reference, refined in the grid.

use ndarray::{Array1, Array2, Axis, s};

use super::{ABTEM, Case, Group, pair, percent, shown_percent, widened};
use crate::engine::{Plan, Scan, Settings, Site};
use crate::error::Result;
use crate::optics::Aberrations;
use crate::potential::slices::Slicing;
use crate::validate::difference::{Difference, extrapolated};
use crate::validate::golden::Golden;
use crate::validate::{Check, CheckRunner, Figure, Findings, Limit, Plot, Series, Style};

pub fn cases() -> Vec<Case> {
    vec![
        Case {
            name: "refined-image",
            title: "Displaced atoms: an image, ours and abTEM's against the refined answer",
            group: Group::Refined,
            about: IMAGE,
            source: ABTEM,
            quick: true,
            seconds: 1.0,
            simulations: 1,
            run: image,
        },
        Case {
            name: "refined-positions",
            title: "Displaced atoms: convergence with the grid at ten positions",
            group: Group::Refined,
            about: POSITIONS,
            source: ABTEM,
            quick: false,
            seconds: 6.0,
            simulations: 10,
            run: positions,
        },
        Case {
            name: "slice-boundaries",
            title: "Atomic planes on the boundaries of slices",
            group: Group::Refined,
            about: BOUNDARIES,
            source: ABTEM,
            quick: false,
            seconds: 3.0,
            simulations: 3,
            run: boundaries,
        },
    ]
}

const IMAGE: &str = "One configuration of thermally displaced atoms of SrTiO3 [001], 3.9 nm, 10 x 8 probes; 200 kV, 21 mrad. The \
    refined answer is abTEM's multislice fed with potentials of exact phases on grids of 576 and 1152 points over 11.7 A, \
    extrapolated to an infinitely fine one. Ours is computed with the defaults of this program. abTEM as shipped spreads each atom \
    bilinearly over four pixels, which costs amplitude at high angles for atoms off the grid; its numbers at three grids are shown \
    beside ours, against the same answer. Where abTEM's grid is fine it agrees with us: both converge to one answer.";
const POSITIONS: &str = "HAADF 68-200 mrad at ten positions of another specimen (19.5 A wide), against exact potentials on 960 and 1920 \
    points, extrapolated. The plot shows how abTEM, as shipped and with exact potentials, approaches the answer as its pixel shrinks; ours \
    is computed on the grid that this program chooses by default.";
const BOUNDARIES: &str = "The specimen of refined-image once with its planes in the middle of slices and once moved by half a slice, as in \
    a cell that starts on an atomic plane. The specimen is the same, so the image should be. With infinite projection abTEM then throws \
    displaced atoms into one slice or the next by chance; with finite projection it cuts each in two, a slice apart. We put the boundaries \
    into the gaps between planes wherever the cell starts. Moving the planes by half a slice also moves abTEM's focus by about 1 A; this \
    effect is shown.";

/// HAADF is the last of four detectors.
const HAADF: usize = 3;

/// Returns the refined images.
fn limit(g: &Golden) -> Result<ndarray::Array3<f64>> {
    let (coarse, fine) = (g.images("exact_576")?, g.images("exact_1152")?);
    Ok((&fine * 4.0 - &coarse) / 3.0)
}

fn largest(image: &Array2<f64>, reference: &Array2<f64>) -> f64 {
    Difference::between(image.view(), reference.view()).largest
}

fn image(runner: &CheckRunner) -> Result<Findings> {
    let g = Golden::load("displaced_image")?;
    let limit = limit(&g)?;
    let images = runner.execute(&g.plan(&g.converged_settings())?, &g.sites, &g.scan())?;
    let mut f = Findings::default();
    for (d, name) in images.detectors.iter().enumerate() {
        let ours = widened(images.image(0, d));
        let reference = limit.index_axis(Axis(0), d).to_owned();
        let what = format!("{name}: largest difference, of the maximum");
        f.checks.push(percent(what, largest(&ours, &reference), 2e-3));
        if d == HAADF {
            f.checks.push(percent(
                "HAADF: rms difference, of the mean",
                Difference::between(ours.view(), reference.view()).rms,
                2e-3,
            ));
            let title = "HAADF: ours against the refined answer";
            f.figures.push(pair(title, ours, reference.clone(), &g.scan(), 0.1));
        }
    }
    let reference = limit.index_axis(Axis(0), HAADF).to_owned();
    for pixels in [288, 576, 1152] {
        let theirs =
            g.images(&format!("as_shipped_{pixels}"))?.index_axis(Axis(0), HAADF).to_owned();
        let pixel = g.cell_angstrom[0] / f64::from(pixels);
        let what = format!(
            "HAADF of abTEM as shipped, {pixel:.3} A pixel: largest difference, of the maximum"
        );
        f.checks.push(shown_percent(what, largest(&theirs, &reference)));
        if pixels == 288 {
            let title =
                format!("HAADF: abTEM as shipped ({pixel:.3} A pixel) against the refined answer");
            f.figures.push(pair(title, theirs, reference.clone(), &g.scan(), 0.1));
        }
    }
    Ok(f)
}

fn positions(runner: &CheckRunner) -> Result<Findings> {
    let g = Golden::load("displaced_refined")?;
    let haadf =
        |name: &str| -> Result<Array1<f64>> { Ok(g.matrix(name)?.column(HAADF).to_owned()) };
    let (coarse, fine) = (g.matrix("exact_960")?, g.matrix("exact_1920")?);
    let limit = extrapolated(&coarse, &fine, 2.0).column(HAADF).to_owned();
    let settings = Settings { detectors: Settings::default().detectors, ..g.converged_settings() };
    let plan = g.plan(&settings)?;
    let mut ours = Array1::zeros(limit.len());
    for (value, origin_angstrom) in ours.iter_mut().zip(g.positions()) {
        let scan = Scan { origin_angstrom, step_angstrom: [1.0; 2], shape: [1, 1] };
        *value = f64::from(runner.execute(&plan, &g.sites, &scan)?.data[[0, 0, 0, 0]]);
    }
    let errors = |values: &Array1<f64>| (values / &limit - 1.0).mapv(|e| 100.0 * e);
    let largest = |values: &Array1<f64>| errors(values).iter().fold(0.0_f64, |m, e| m.max(e.abs()));
    let mut f = Findings::default();
    f.checks.push(Check::new(
        "ours: largest relative error of ten positions",
        largest(&ours),
        "%",
        Limit::AtMost(0.15),
    ));
    let pixel = |n: i32| g.cell_angstrom[0] / f64::from(n);
    let mut series = Vec::new();
    for (kind, name, sizes) in [
        ("as_shipped", "abTEM as shipped", [480, 960, 1920, 2400].as_slice()),
        ("exact", "abTEM, exact potentials", &[480, 720, 960, 1920]),
    ] {
        let mut points = Vec::new();
        for n in sizes {
            let error = largest(&haadf(&format!("{kind}_{n}"))?);
            points.push((pixel(*n), error));
            let what = format!("{name}, {:.3} A pixel: largest relative error", pixel(*n));
            f.checks.push(Check::shown(what, error, "%"));
        }
        series.push(Series { name: name.into(), points, style: Style::Both });
    }
    let own = plan.wave_grid.sampling_angstrom()[0];
    series.push(Series {
        name: "this program, by default".into(),
        points: vec![(own, largest(&ours))],
        style: Style::Points,
    });
    f.figures.push(Figure::Plot(Plot {
        title: "Error of HAADF against the refined answer, worst of ten positions".into(),
        x: "pixel of the wave in A".into(),
        y: "error in %".into(),
        logarithmic: [true, true],
        series,
    }));
    f.figures.push(Figure::Plot(Plot {
        title: "Error of HAADF at each position".into(),
        x: "position (0-3 columns, 4-7 between them, 8-9 anywhere)".into(),
        y: "error in %".into(),
        logarithmic: [false, false],
        series: vec![
            numbered("abTEM as shipped, 0.041 A", &errors(&haadf("as_shipped_480")?)),
            numbered("abTEM as shipped, 0.020 A", &errors(&haadf("as_shipped_960")?)),
            numbered("this program, by default", &errors(&ours)),
        ],
    }));
    Ok(f)
}

fn numbered(name: &str, values: &Array1<f64>) -> Series {
    let points = values.iter().enumerate().map(|(i, v)| (i as f64, *v)).collect();
    Series { name: name.into(), points, style: Style::Both }
}

fn boundaries(runner: &CheckRunner) -> Result<Findings> {
    let g = Golden::load("displaced_image")?;
    let reference = limit(&g)?.index_axis(Axis(0), HAADF).to_owned();
    let slice = g.slice_angstrom();
    let moved: Vec<Site> = g
        .sites
        .iter()
        .map(|s| Site {
            position: [s.position[0], s.position[1], s.position[2] + slice / 2.0],
            ..*s
        })
        .collect();
    let [x, y, z] = g.cell_angstrom;
    // Slices are chosen by the mean heights of the atoms: the planes, one slice apart, from which the atoms were displaced, and on which
    // the reference puts them. The focus is on the first plane, as in the reference.
    let run = |sites: &[Site], height: f64, first: f64, focus: f64| -> Result<Array2<f64>> {
        let mut settings = Settings { slicing: Slicing::Planes, ..Settings::default() };
        settings.optics.aberrations = Aberrations::defocus(focus);
        let plane = |s: &Site| first + ((s.position[2] - first) / slice).round() * slice;
        let heights: Vec<f64> = sites.iter().map(plane).collect();
        let plan = Plan::new(&settings, [x, y, height], &heights)?;
        Ok(widened(runner.execute(&plan, sites, &g.scan())?.image(0, 0)))
    };
    let centred = run(&g.sites, z, slice / 2.0, slice / 2.0)?;
    let shifted = run(&moved, z + slice, slice, slice)?;
    let defocused = run(&g.sites, z, slice / 2.0, slice)?;
    let mut f = Findings::default();
    let what = "ours, planes on the boundaries: largest difference from the refined answer, of the maximum";
    f.checks.push(percent(what, largest(&shifted, &reference), 2e-3));
    let what = "ours, planes centred: largest difference from the refined answer, of the maximum";
    f.checks.push(percent(what, largest(&centred, &reference), 2e-3));
    let what = "ours: moving the planes by half a slice changes at most, of the maximum";
    f.checks.push(percent(what, largest(&shifted, &centred), 1e-4));
    let what = "ours: moving the focus by half a slice changes at most, of the maximum";
    f.checks.push(shown_percent(what, largest(&defocused, &centred)));
    for pixels in [288, 576] {
        let pixel = x / f64::from(pixels);
        for (key, name) in [
            ("as_shipped", "planes centred"),
            ("boundary_infinite", "planes on the boundaries, infinite projection"),
            ("boundary_finite", "planes on the boundaries, finite projection"),
        ] {
            let images = g.images(&format!("{key}_{pixels}"))?;
            let theirs = images.index_axis(Axis(0), HAADF).to_owned();
            let what = format!(
                "abTEM as shipped, {pixel:.3} A pixel, {name}: largest difference, of the maximum"
            );
            f.checks.push(shown_percent(what, largest(&theirs, &reference)));
        }
    }
    f.figures.push(Figure::Plot(profile(&g, &reference, &shifted)?));
    let title = "HAADF: ours with planes on the boundaries against the refined answer";
    f.figures.push(pair(title, shifted, reference.clone(), &g.scan(), 0.1));
    for (key, name) in [("boundary_infinite_576", "infinite"), ("boundary_finite_576", "finite")] {
        let theirs = g.images(key)?.index_axis(Axis(0), HAADF).to_owned();
        let title = format!(
            "HAADF: abTEM as shipped (0.020 A pixel), {name} projection, planes on the boundaries, against \
             the refined answer"
        );
        f.figures.push(pair(title, theirs, reference.clone(), &g.scan(), 0.1));
    }
    Ok(f)
}

/// Plots profiles along x through the brightest row.
fn profile(g: &Golden, reference: &Array2<f64>, ours: &Array2<f64>) -> Result<Plot> {
    let row = super::brightest(reference)[0];
    let scan = g.scan();
    let series = |name: &str, image: &Array2<f64>, style| {
        let values = image.slice(s![row, ..]);
        let points = values.iter().enumerate();
        let points = points.map(|(i, v)| (i as f64 * scan.step_angstrom[0], *v)).collect();
        Series { name: name.into(), points, style }
    };
    let theirs = |key: &str| -> Result<Array2<f64>> {
        Ok(g.images(key)?.index_axis(Axis(0), HAADF).to_owned())
    };
    Ok(Plot {
        title: "HAADF along x with planes on the boundaries of slices (abTEM: 0.020 A pixel)"
            .into(),
        x: "x in A".into(),
        y: "fraction of the beam".into(),
        logarithmic: [false, false],
        series: vec![
            series("refined answer", reference, Style::Line),
            series("this program, by default", ours, Style::Points),
            series("abTEM, infinite projection", &theirs("boundary_infinite_576")?, Style::Dashed),
            series("abTEM, finite projection", &theirs("boundary_finite_576")?, Style::Dashed),
        ],
    })
}
