//! abTEM with equal numerics: static atoms on grid points, abTEM's grid and slices.

use ndarray::{Array2, Axis};

use super::{ABTEM, Case, FRACTION, Group, compare_all, percent, shown_percent};
use crate::engine::{
    Algorithm, BeyondLimit, GridChoice, Scan, Settings, Site, Source, SourceBlur, diffraction,
};
use crate::error::Result;
use crate::optics::Aberration;
use crate::potential::projected::{PlacedAtom, PotentialFilter, Projector};
use crate::potential::scattering::Parametrization;
use crate::validate::difference::Difference;
use crate::validate::golden::{Golden, like_abtem};
use crate::validate::{CheckRunner, Figure, Findings, ImagePair};

/// Tolerance of images with equal numerics, as a fraction of the maximum.
const SAME: f64 = 2e-4;

pub fn cases() -> Vec<Case> {
    let case = |name, title, about, quick, seconds, simulations, run| Case {
        name,
        title,
        group: Group::Abtem,
        about,
        source: ABTEM,
        quick,
        seconds,
        simulations,
        run,
    };
    vec![
        case("abtem-srtio3", "SrTiO3 [001], 10.2 nm, multislice", SRTIO3, true, 5.0, 2, srtio3),
        case("abtem-si110", "Si [110], 10.0 nm, multislice", SI110, true, 9.0, 2, si110),
        case("abtem-prism", "SrTiO3 [001], 10.2 nm, PRISM f = 1", PRISM, false, 6.0, 1, prism_f1),
        case(
            "abtem-prism-f2",
            "SrTiO3 with missing Sr, PRISM f = 2",
            PRISM_F2,
            false,
            15.0,
            2,
            prism_f2,
        ),
        case(
            "abtem-prism-f2-si110",
            "Si [110] with missing atoms, PRISM f = 2",
            PRISM_F2_SI,
            false,
            30.0,
            1,
            prism_f2_si,
        ),
        case(
            "abtem-displaced",
            "Displaced atoms, placed and sliced as abTEM does",
            DISPLACED,
            true,
            6.0,
            3,
            displaced,
        ),
        case(
            "abtem-aberrations",
            "Aberrated probes up to fifth order",
            ABERRATED,
            false,
            1.5,
            3,
            aberrated,
        ),
        case(
            "abtem-optics",
            "Mistilt, focal spread and source size",
            OPTICS,
            false,
            9.0,
            7,
            optics,
        ),
        case(
            "abtem-diffraction",
            "A diffraction pattern, pixel by pixel",
            DIFFRACTION,
            true,
            0.2,
            1,
            pattern,
        ),
        case(
            "abtem-potentials",
            "Projected potentials of atomic planes",
            POTENTIALS,
            true,
            0.1,
            0,
            potentials,
        ),
    ]
}

const SRTIO3: &str = "12 x 12 probes over one unit cell, four detectors, 200 kV, 21 mrad. Both programs use a grid of 300 x 300 over 11.7 \
    A, 52 slices with an atomic plane in the middle of each, and atoms on grid points, so that neither placement nor slicing can differ. \
    First with potentials from structure factors with exact phases in both; then abTEM as shipped, whose potentials carry a correction for \
    spreading atoms over pixels even where nothing was spread: with the same correction we agree, and the effect of the correction itself is \
    shown as a number.";
const SI110: &str = "As SrTiO3, with a cell, a grid, a pixel and a raster that are not square, so that a transposition would show.";
const DISPLACED: &str = "One configuration of thermally displaced atoms of SrTiO3, 3.9 nm, 10 x 8 probes, abTEM as shipped on grids of 288 \
    and 576 points over 11.7 A: its spreading of atoms over four pixels, and the factor that does not undo it. On 288 points also with the \
    atomic planes on the boundaries of slices, where displaced atoms fall into one slice or the next. The cases refined-image and \
    slice-boundaries measure how far these images are from the converged one.";
const PRISM: &str = "The same images by PRISM without interpolation, which should be multislice.";
const PRISM_F2: &str = "A quarter of the Sr atoms is missing, since a perfect crystal cannot test the cropping of PRISM. Windows \
    of 11.7 A in a cell of 23.4 A, 3.9 nm thick; also the exact multislice of the same specimen.";
const PRISM_F2_SI: &str =
    "A quarter of the atoms is missing; windows of 10.9 x 11.5 A, 10.0 nm thick.";
const ABERRATED: &str = "8 x 8 probes, 3.9 nm of SrTiO3: no aberrations, coefficients up to third order, and all of abTEM's up to \
    fifth; each turns the edge of the aperture by about a radian or more, so that a wrong sign, order or angle would show. \
    abTEM's plain multislice is the reference (its PRISM normalises aberrated probes wrongly).";
const OPTICS: &str = "10 x 12 probes, 3.9 nm of SrTiO3: the specimen tilted by 3 and 8 mrad in all, by multislice and PRISM; a focal spread of \
    25 A (standard deviation), where abTEM takes 33 evenly spaced foci and we a Gauss-Hermite quadrature; a Gaussian source of \
    0.9 A (full width at half maximum), which abTEM applies in real space and we in Fourier space.";
const DIFFRACTION: &str =
    "One probe at a position without symmetry on 3.9 nm of SrTiO3; all pixels inside 120 mrad.";
const POTENTIALS: &str =
    "Single planes of SrTiO3 by three parametrizations, and atoms off the grid on an oblong grid.";

fn srtio3(runner: &CheckRunner) -> Result<Findings> {
    multislice(runner, "srtio3_001")
}

fn si110(runner: &CheckRunner) -> Result<Findings> {
    multislice(runner, "si_110")
}

/// Compares images with abTEM's exact potentials, and with abTEM as shipped.
fn multislice(runner: &CheckRunner, name: &str) -> Result<Findings> {
    let mut f = against(runner, name, &[("multislice", "", Algorithm::Multislice, [SAME; 4])])?;
    let g = Golden::load(name)?;
    let shipped = g.images("multislice_as_shipped")?;
    let sharpened = Settings { abtem_placement: true, ..g.settings() };
    let images = runner.execute(&g.plan(&sharpened)?, &g.sites, &g.scan())?;
    compare_all(&mut f, "as shipped, ", &images, shipped.outer_iter(), &g.scan(), [SAME; 4]);
    let exact = g.images("multislice")?;
    let effect = Difference::between(shipped.index_axis(Axis(0), 3), exact.index_axis(Axis(0), 3));
    let what = "what abTEM's correction adds to HAADF, largest, of the maximum";
    f.checks.push(shown_percent(what, effect.largest));
    Ok(f)
}

/// Compares images of atoms between grid points with abTEM as shipped.
fn displaced(runner: &CheckRunner) -> Result<Findings> {
    let g = Golden::load("displaced_image")?;
    let slice = g.slice_angstrom();
    let mut findings = Findings::default();
    for (key, moved, points) in [
        ("as_shipped_288", 0.0, 288),
        ("as_shipped_576", 0.0, 576),
        ("boundary_infinite_288", slice / 2.0, 288),
    ] {
        let base = Settings {
            detectors: g.settings().detectors,
            // 288 points end at 199.4 mrad: beyond, both abTEM's detector and ours are empty.
            beyond_limit: BeyondLimit::Warn,
            ..Settings::default()
        };
        let settings = like_abtem(&base, GridChoice::Points([points; 2]), slice);
        let shifted = |s: &Site| {
            let [x, y, z] = s.position;
            Site { position: [x, y, z + moved], ..*s }
        };
        let sites: Vec<Site> = g.sites.iter().map(shifted).collect();
        let [x, y, z] = g.cell_angstrom;
        let images = runner.simulate(&settings, &sites, [x, y, z + 2.0 * moved], &g.scan())?;
        let theirs = g.images(key)?;
        let label = format!("{key}, ");
        compare_all(&mut findings, &label, &images, theirs.outer_iter(), &g.scan(), [SAME; 4]);
    }
    Ok(findings)
}

fn prism_f1(runner: &CheckRunner) -> Result<Findings> {
    against(runner, "srtio3_001", &[("prism_f1", "", prism(1), [SAME; 4])])
}

fn prism_f2(runner: &CheckRunner) -> Result<Findings> {
    let runs = [
        ("multislice", "multislice, ", Algorithm::Multislice, [SAME; 4]),
        ("prism_f2", "PRISM f = 2, ", prism(2), [2e-4; 4]),
    ];
    against(runner, "srtio3_prism_f2", &runs)
}

fn prism_f2_si(runner: &CheckRunner) -> Result<Findings> {
    against(runner, "si_110_prism_f2", &[("prism_f2", "", prism(2), [2e-4; 4])])
}

fn prism(f: usize) -> Algorithm {
    Algorithm::Prism { interpolation: [f, f] }
}

type EngineRun = (&'static str, &'static str, Algorithm, [f64; 4]);

fn against(runner: &CheckRunner, name: &str, runs: &[EngineRun]) -> Result<Findings> {
    let g = Golden::load(name)?;
    let mut findings = Findings::default();
    for &(array, label, algorithm, tolerances) in runs {
        let settings = Settings { algorithm, full_exit_grid: true, ..g.settings() };
        let images = runner.execute(&g.plan_from_plane(&settings)?, &g.sites, &g.scan())?;
        let references = g.images(array)?;
        compare_all(&mut findings, label, &images, references.outer_iter(), &g.scan(), tolerances);
    }
    Ok(findings)
}

fn aberrated(runner: &CheckRunner) -> Result<Findings> {
    let g = Golden::load("srtio3_001_aberrated")?;
    let mut findings = Findings::default();
    for (set, label) in [
        ("perfect", "no aberrations, "),
        ("third_order", "third order, "),
        ("all_orders", "fifth order, "),
    ] {
        let mut settings = g.settings();
        settings.optics.aberrations.0.extend(coefficients(&g, set)?);
        let images = runner.execute(&g.plan(&settings)?, &g.sites, &g.scan())?;
        let references = g.images(set)?;
        compare_all(&mut findings, label, &images, references.outer_iter(), &g.scan(), [SAME; 4]);
    }
    Ok(findings)
}

fn optics(runner: &CheckRunner) -> Result<Findings> {
    let g = Golden::load("srtio3_001_optics")?;
    let mut findings = Findings::default();
    let spread = g.json["focal_spread_A"].as_f64().unwrap_or(f64::NAN);
    let focus = g.json["defocus_A"].as_f64().unwrap_or(f64::NAN);
    let (none, straight) = (Algorithm::Multislice, [0.0; 2]);
    let tilted = |name: &str| Golden::pair(&g.json["tilts_mrad"][name]);
    for (name, label, algorithm, tilt, defocus, sigma) in [
        ("tilt_3", "3 mrad, ", none, tilted("tilt_3"), 0.0, 0.0),
        ("tilt_8", "8 mrad, ", none, tilted("tilt_8"), 0.0, 0.0),
        ("tilt_8", "8 mrad by PRISM, ", prism(1), tilted("tilt_8"), 0.0, 0.0),
        ("focus_20", "in one focus, ", none, straight, focus, 0.0),
        ("focal_spread", "focal spread, ", none, straight, focus, spread),
        ("focal_spread", "focal spread by PRISM, ", prism(1), straight, focus, spread),
    ] {
        let mut settings = Settings { algorithm, full_exit_grid: true, ..g.settings() };
        settings.optics.tilt_mrad = tilt;
        settings.optics.focal_spread_angstrom = sigma;
        settings.optics.aberrations.add_defocus(defocus);
        let images = runner.execute(&g.plan_from_plane(&settings)?, &g.sites, &g.scan())?;
        let references = g.images(name)?;
        compare_all(&mut findings, label, &images, references.outer_iter(), &g.scan(), [SAME; 4]);
    }
    source(runner, &g, &mut findings)?;
    Ok(findings)
}

fn source(runner: &CheckRunner, g: &Golden, findings: &mut Findings) -> Result<()> {
    let references = g.images("source")?;
    let (ny, nx) = (references.dim().1, references.dim().2);
    let [x, y] = Golden::pair(&g.json["scan"]["end_A"]);
    let step_angstrom = [x / nx as f64, y / ny as f64];
    let scan = Scan { step_angstrom, shape: [ny, nx], ..g.scan() };
    let fwhm = g.json["source_fwhm_A"].as_f64().unwrap_or(f64::NAN);
    // One cell of the crystal is a period of the image.
    let blur = SourceBlur::new(Source::gaussian(fwhm), &scan, [x, y])?;
    let mut images = runner.execute(&g.plan_from_plane(&g.settings())?, &g.sites, blur.scan())?;
    for mut image in images.data.index_axis_mut(Axis(0), 0).outer_iter_mut() {
        let blurred = blur.image(image.view());
        image.assign(&blurred);
    }
    compare_all(findings, "source, ", &images, references.outer_iter(), &scan, [SAME; 4]);
    Ok(())
}

/// Reads the aberrations of a set: `C12` with its angle `phi12`.
fn coefficients(g: &Golden, set: &str) -> Result<Vec<Aberration>> {
    let set = &g.json["aberrations_A_rad"][set];
    let names = set.as_object().into_iter().flatten().filter(|(name, _)| name.starts_with('C'));
    let one = |(name, value): (&String, &serde_json::Value)| {
        let azimuth = set[name.replace('C', "phi")].as_f64().unwrap_or(0.0);
        Aberration::parse(&format!("{name}={}@{azimuth}", value.as_f64().unwrap_or(f64::NAN)))
    };
    names.map(one).collect()
}

fn pattern(runner: &CheckRunner) -> Result<Findings> {
    let g = Golden::load("exit_intensity")?;
    let reference = g.matrix("intensity")?;
    let share = runner.share();
    let at = Golden::pair(&g.json["position_A"]);
    let plan = g.plan(&g.settings())?;
    let pattern = diffraction(&plan, &g.sites, at, &share)?;
    share.complete();
    let half = reference.nrows() as i64 / 2;
    let (ny, nx) = pattern.dim();
    let wrap = |i: usize, n: usize| (i as i64 - half).rem_euclid(n as i64) as usize;
    let ours = Array2::from_shape_fn(reference.dim(), |(y, x)| {
        f64::from(pattern[[wrap(y, ny), wrap(x, nx)]])
    });
    let difference = Difference::between(ours.view(), reference.view());
    let top = reference.iter().fold(0.0_f64, |m, v| m.max(*v));
    let dk = plan.wave_grid.dk();
    let figure = ImagePair {
        title: "intensity in the detector plane".into(),
        ours,
        reference,
        step: dk,
        origin: dk.map(|d| -(half as f64) * d),
        axis_unit: "1/A",
        unit: FRACTION,
        difference_scale: 1e-5 * top,
        logarithmic: true,
    };
    Ok(Findings {
        checks: vec![percent("largest difference, of the maximum", difference.largest, 1e-5)],
        figures: vec![Figure::Images(Box::new(figure))],
    })
}

fn potentials(_: &CheckRunner) -> Result<Findings> {
    let g = Golden::load("potential_srtio3")?;
    let plane = |upper: bool| -> Vec<PlacedAtom> {
        let atoms = g.sites.iter().filter(|s| (s.position[2] > 2.0) == upper);
        atoms.map(|s| PlacedAtom { position: s.position, number: s.number }).collect()
    };
    let loose = [(38, 0.513, 0.171), (22, 2.207, 3.049), (8, 3.333, 1.618)];
    let loose = loose.map(|(number, x, y)| PlacedAtom { position: [x, y, 0.0], number });
    let cell = [g.cell_angstrom[0], g.cell_angstrom[1]];
    let (square, oblong) = ((cell, plane(false)), ([4.0, 5.0], loose.to_vec()));
    let upper = (cell, plane(true));
    let cases = [
        ("sr_o_lobato", "SrO, Lobato", Parametrization::Lobato, &square, PotentialFilter::AsIs),
        (
            "sr_o_kirkland",
            "SrO, Kirkland",
            Parametrization::Kirkland,
            &square,
            PotentialFilter::AsIs,
        ),
        ("sr_o_peng", "SrO, Peng", Parametrization::Peng, &square, PotentialFilter::AsIs),
        (
            "sr_o_lobato_as_shipped",
            "SrO, as abTEM ships it",
            Parametrization::Lobato,
            &square,
            PotentialFilter::AbtemPlacement,
        ),
        ("ti_o2_lobato", "TiO2, Lobato", Parametrization::Lobato, &upper, PotentialFilter::AsIs),
        (
            "off_grid",
            "Sr, Ti and O off the grid",
            Parametrization::Lobato,
            &oblong,
            PotentialFilter::AsIs,
        ),
    ];
    let mut findings = Findings::default();
    for (name, title, parametrization, (extent, atoms), shape) in cases {
        let reference = g.matrix(name)?;
        let (ny, nx) = reference.dim();
        let projector = Projector::new((ny, nx), *extent, parametrization, &[8, 22, 38], shape)?;
        let (mut out, mut scratch) = (projector.fft().buffer(), projector.scratch());
        projector.infinite(atoms, &mut out, &mut scratch);
        let value = |(y, x)| f64::from(projector.fft().of_pair(&out, y, x));
        let ours = Array2::from_shape_fn((ny, nx), value);
        let difference = Difference::between(ours.view(), reference.view());
        let what = format!("{title}: largest difference, of the maximum");
        findings.checks.push(percent(what, difference.largest, 1e-5));
        if name == "off_grid" {
            findings.figures.push(Figure::Images(Box::new(ImagePair {
                title: title.into(),
                difference_scale: 1e-5 * reference.iter().fold(0.0, |m: f64, v| m.max(*v)),
                ours,
                reference,
                step: [extent[0] / nx as f64, extent[1] / ny as f64],
                origin: [0.0; 2],
                axis_unit: "A",
                unit: "V A",
                logarithmic: false,
            })));
        }
    }
    Ok(findings)
}
