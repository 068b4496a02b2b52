//! An image that somebody else computed, against ours of the same structure.
//!
//! abTEM's arrays are `[x, y]`, ours `[y, x]`. Which of the two a file holds is taken from what it says of
//! itself, or from the caller, or from sizes that leave one possibility; never guessed.

use std::time::Instant;

use ndarray::{Array2, ArrayView2, Axis as Dimension, Ix2, s};

use super::difference::{Difference, best_gain};
use super::{Check, Figure, Findings, ImagePair, Lab, Limit, Outcome, Verdict, overall};
use crate::engine::{Plan, Scan, Site};
use crate::error::Result;
use crate::io::arrays::{ArrayAxis, ForeignArray};
use crate::setting::Setting;

/// Order of the two dimensions of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// First index along x: abTEM.
    Xy,
    /// First index along y: matrices, pictures, this program.
    Yx,
}

/// What the values of a reference are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueUnits {
    /// Fractions of the beam.
    Fraction,
    /// Per cent of the beam.
    Percent,
    /// Anything proportional: the factor is fitted.
    Fitted,
}

/// A reference image: row = y, column = x.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// The values.
    pub data: Array2<f64>,
    /// Distance of pixels along x and y in Angstrom, if the file tells it.
    pub step_angstrom: Option<[f64; 2]>,
    /// Position of the first pixel, (x, y) in Angstrom; zero if the file tells none.
    pub origin_angstrom: [f64; 2],
    /// How the orientation was known.
    pub orientation: &'static str,
}

/// The image of an array (row = y, column = x), in the unit of the file.
///
/// `index` chooses along the dimensions that are not x or y; those of length 1 need no choice. `expected` are
/// the (x, y) numbers of pixels of the scan, if known: where they differ they tell the order.
///
/// # Errors
/// [`crate::Error::Choice`] if a choice is missing or impossible, or the order is not known; [`crate::Error::Parse`]
/// for a value that is not finite.
pub fn reference(
    array: &ForeignArray,
    order: Option<Order>,
    index: &[usize],
    expected: Option<[usize; 2]>,
) -> Result<Reference> {
    let shape = array.data.shape().to_vec();
    if shape.len() < 2 {
        return Err(
            array.error(format!("holds an array of shape {shape:?}; an image has two dimensions"))
        );
    }
    let labelled = labelled(array);
    let plane = labelled.unwrap_or([shape.len() - 2, shape.len() - 1]);
    let image = choose(array, plane, index)?;
    check_finite(array, image.view())?;
    let (order, orientation) = match (labelled, order, by_size(image.dim(), expected)) {
        (Some([x, y]), None, _) if x < y => (Order::Xy, "the file says that its axes are x, y"),
        (Some(_), None, _) => (Order::Yx, "the file says that its axes are y, x"),
        (Some([x, y]), Some(given), _) => {
            let told = if x < y { Order::Xy } else { Order::Yx };
            if told != given {
                let names = if x < y { "x, y" } else { "y, x" };
                return Err(array.choice(
                    Setting::ImageAxes,
                    format!(
                        "says that its axes are {names}, against the order given; give none, or mend the file"
                    ),
                ));
            }
            (given, "as given, and as the file says")
        }
        (None, Some(given), _) => (given, "as given"),
        (None, None, Some(order)) => (order, "the numbers of pixels of the scan"),
        (None, None, None) => {
            let (a, b) = image.dim();
            return Err(array.choice(
                Setting::ImageAxes,
                format!(
                    "does not say which axis is x: its {a} x {b} values may be [x, y] (abTEM) or [y, x]; \
                     give the order, xy or yx"
                ),
            ));
        }
    };
    let data = match order {
        Order::Xy => image.reversed_axes().as_standard_layout().to_owned(),
        Order::Yx => image,
    };
    let axis = |of: usize| array.axes.as_ref().map(|a| &a[of]);
    let [x, y] = match (labelled, order) {
        (Some(places), _) => places,
        (None, Order::Xy) => plane,
        (None, Order::Yx) => [plane[1], plane[0]],
    };
    let step = |of: usize| axis(of).and_then(|a| a.sampling_angstrom).filter(|s| *s > 0.0);
    let origin = |of: usize| axis(of).map_or(0.0, |a: &ArrayAxis| a.origin_angstrom);
    Ok(Reference {
        data,
        step_angstrom: step(x).zip(step(y)).map(|(x, y)| [x, y]),
        origin_angstrom: [origin(x), origin(y)],
        orientation,
    })
}

/// The dimensions called x and y.
fn labelled(array: &ForeignArray) -> Option<[usize; 2]> {
    let axes = array.axes.as_ref()?;
    let find = |name: &str| axes.iter().position(|a| a.label.trim().eq_ignore_ascii_case(name));
    Some([find("x")?, find("y")?])
}

/// The order in which `(first, second)` pixels are those of the scan, where only one is.
fn by_size((first, second): (usize, usize), expected: Option<[usize; 2]>) -> Option<Order> {
    let [x, y] = expected?;
    match ([first, second] == [x, y], [first, second] == [y, x]) {
        (true, false) => Some(Order::Xy),
        (false, true) => Some(Order::Yx),
        _ => None,
    }
}

/// The two dimensions of `plane`, in their order in the file.
fn choose(array: &ForeignArray, plane: [usize; 2], index: &[usize]) -> Result<Array2<f64>> {
    let shape = array.data.shape();
    let others: Vec<usize> =
        (0..shape.len()).filter(|d| !plane.contains(d) && shape[*d] > 1).collect();
    if index.len() != others.len() {
        let lengths: Vec<String> = others.iter().map(|d| shape[*d].to_string()).collect();
        let message = match others.len() {
            0 => "holds one image: an index is not needed".to_owned(),
            n => format!(
                "holds an array of shape {shape:?}: its index takes {n} number{} from 0, below {}",
                if n == 1 { "" } else { "s" },
                lengths.join(", ")
            ),
        };
        return Err(array.choice(Setting::ImageIndex, message));
    }
    let mut view = array.data.view();
    for d in (0..shape.len()).rev().filter(|d| !plane.contains(d)) {
        let at = others.iter().position(|o| *o == d).map_or(0, |i| index[i]);
        if at >= shape[d] {
            let message = format!("index {at} is too large: there are {}, from 0", shape[d]);
            return Err(array.choice(Setting::ImageIndex, message));
        }
        view = view.index_axis_move(Dimension(d), at);
    }
    let image = view.into_dimensionality::<Ix2>();
    image.map(|v| v.to_owned()).map_err(|e| array.error(e.to_string()))
}

fn check_finite(array: &ForeignArray, image: ArrayView2<f64>) -> Result<()> {
    if image.is_empty() {
        return Err(array.error("holds an image without pixels"));
    }
    match image.indexed_iter().find(|(_, v)| !v.is_finite()) {
        Some(((i, j), v)) => Err(array.error(format!(
            "holds {v} at index [{i}, {j}]; expected finite values: the computation that made it failed there"
        ))),
        None => Ok(()),
    }
}

/// The raster of a reference that tells its pixels; `None` if it does not.
pub fn scan(reference: &Reference) -> Option<Scan> {
    let (rows, columns) = reference.data.dim();
    Some(Scan {
        origin_angstrom: reference.origin_angstrom,
        step_angstrom: reference.step_angstrom?,
        shape: [rows, columns],
    })
}

/// Values as fractions of the beam.
///
/// # Errors
/// [`crate::Error::Choice`] for fractions above 1 or below 0.
pub fn in_fractions(
    array: &ForeignArray,
    image: &mut Array2<f64>,
    units: ValueUnits,
) -> Result<()> {
    if units == ValueUnits::Percent {
        *image *= 0.01;
    }
    let range = image.iter().fold([f64::MAX, f64::MIN], |r, v| [r[0].min(*v), r[1].max(*v)]);
    if units != ValueUnits::Fitted && (range[1] > 1.0 || range[0] < -1e-6) {
        return Err(array.choice(
            Setting::ImageUnits,
            format!(
                "holds values from {:.4} to {:.4}, which are no fractions of the beam; give their unit: \
                 percent, or fitted for anything proportional",
                range[0], range[1]
            ),
        ));
    }
    Ok(())
}

/// What a comparison needs to know.
pub struct ImageComparison<'a> {
    /// Plan of the simulation, with one detector.
    pub plan: &'a Plan,
    /// The atoms.
    pub sites: &'a [Site],
    /// Probes on the pixels of the reference.
    pub scan: &'a Scan,
    /// The reference.
    pub reference: &'a Reference,
    /// What its values are.
    pub units: ValueUnits,
    /// Largest difference allowed, as a fraction of the reference's maximum.
    pub tolerance: f64,
    /// Name of the case.
    pub name: String,
    /// What is compared, for the report.
    pub about: String,
    /// The file.
    pub source: String,
    /// With the numerics of abTEM in `plan`: the same converged, so that the report tells what abTEM's grid and slices do.
    pub converged: Option<&'a Plan>,
    /// What to try if the images differ.
    pub remedy: Option<String>,
}

/// Simulates and compares.
///
/// # Errors
/// Those of the engine.
pub fn compare(lab: &Lab, c: &ImageComparison) -> Result<Outcome> {
    let begun = Instant::now();
    let images = lab.execute(c.plan, c.sites, c.scan)?;
    let ours = images.image(0, 0).mapv(f64::from);
    let mut reference = c.reference.data.clone();
    let mut findings = Findings::default();
    if c.units == ValueUnits::Fitted {
        let gain = best_gain(reference.view(), ours.view());
        reference *= gain;
        findings.checks.push(Check::shown("factor fitted to the reference", gain, ""));
    }
    let d = Difference::between(ours.view(), reference.view());
    let limit = Limit::AtMost(100.0 * c.tolerance);
    let largest = "largest difference, of the maximum of the reference";
    findings.checks.splice(0..0, [Check::new(largest, 100.0 * d.largest, "%", limit)]);
    findings.checks.extend([
        Check::shown("rms difference, of the mean", 100.0 * d.rms, "%"),
        Check::shown("ours is brighter on average by", 100.0 * d.bias, "%"),
        Check::shown("correlation coefficient", d.correlation, ""),
    ]);
    let verdict = overall(findings.checks.iter().map(|c| &c.verdict));
    let mut notes = Vec::new();
    let mut both = None;
    if let Some(plan) = c.converged {
        let converged = lab.execute(plan, c.sites, c.scan)?.image(0, 0).mapv(f64::from);
        let off = Difference::between(reference.view(), converged.view());
        findings.checks.extend([
            Check::shown(
                "reference against the converged image: largest",
                100.0 * off.largest,
                "%",
            ),
            Check::shown("the reference is brighter on average by", 100.0 * off.bias, "%"),
        ]);
        both = Some(told_by_both(verdict == Verdict::Pass, &off, c.tolerance));
    }
    if verdict == Verdict::Fail {
        let better = better_otherwise(&ours, &reference);
        notes.extend(better.map(|how| {
            format!("the reference {how} agrees much better: is the orientation or the scan right?")
        }));
        notes.extend(c.remedy.clone());
    }
    notes.extend(both);
    let top = reference.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    findings.figures.push(Figure::Images(Box::new(ImagePair {
        title: format!("{}: ours and the reference", images.detectors[0]),
        ours,
        reference,
        step: c.scan.step_angstrom,
        origin: c.scan.origin_angstrom,
        axis_unit: "A",
        unit: "fraction of the beam",
        difference_scale: c.tolerance * top,
        logarithmic: false,
    })));
    Ok(Outcome {
        name: c.name.clone(),
        title: format!("{} against {}", images.detectors[0], c.name),
        group: "Your reference".into(),
        about: c.about.clone(),
        source: c.source.clone(),
        verdict,
        checks: findings.checks,
        notes,
        figures: findings.figures,
        wall_time_s: begun.elapsed().as_secs_f64(),
    })
}

/// What the two comparisons, in abTEM's numerics and converged, say together.
fn told_by_both(same_numerics: bool, converged: &Difference, tolerance: f64) -> String {
    let off = format!("{:.2} % of the maximum", 100.0 * converged.largest);
    match (same_numerics, converged.largest <= tolerance) {
        (true, true) => {
            "in abTEM's numerics and converged, ours is the same as the reference".into()
        }
        (true, false) => format!(
            "in abTEM's numerics ours is the same as the reference; converged in grid and slices the image differs by up to {off}: \
             that is the error of abTEM's grid and slices"
        ),
        (false, _) => format!(
            "abTEM's grid and slices do not explain the difference; the converged image differs from the reference by up to {off}"
        ),
    }
}

/// How many times smaller the difference must become to be worth a word.
const MUCH_BETTER: f64 = 3.0;
/// Pixels by which the reference is moved.
const SHIFTS: i64 = 6;

/// A transposition, mirror or shift of the reference that agrees much better.
fn better_otherwise(ours: &Array2<f64>, reference: &Array2<f64>) -> Option<String> {
    let rms = |image: ArrayView2<f64>| Difference::between(ours.view(), image).rms;
    let now = rms(reference.view());
    let mut found: Vec<(f64, String)> = Vec::new();
    if reference.is_square() {
        found.push((rms(reference.t()), "transposed".into()));
    }
    found.push((rms(reference.slice(s![..;-1, ..])), "mirrored along y".into()));
    found.push((rms(reference.slice(s![.., ..;-1])), "mirrored along x".into()));
    let (rows, columns) = reference.dim();
    for dy in -SHIFTS..=SHIFTS {
        for dx in -SHIFTS..=SHIFTS {
            let wrap = |i: usize, d: i64, n: usize| (i as i64 - d).rem_euclid(n as i64) as usize;
            let moved = Array2::from_shape_fn((rows, columns), |(y, x)| {
                reference[[wrap(y, dy, rows), wrap(x, dx, columns)]]
            });
            if (dx, dy) != (0, 0) {
                found.push((rms(moved.view()), format!("moved by {dx}, {dy} pixels (x, y)")));
            }
        }
    }
    let best = found.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
    best.filter(|(rms, _)| MUCH_BETTER * rms < now).map(|(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array3, ArrayD};
    use std::path::PathBuf;

    fn array(data: ArrayD<f64>, labels: Option<&[&str]>) -> ForeignArray {
        let axis = |l: &&str| ArrayAxis {
            label: (*l).into(),
            sampling_angstrom: matches!(*l, "x" | "y").then_some(if *l == "x" { 0.1 } else { 0.2 }),
            origin_angstrom: 0.5,
        };
        ForeignArray {
            path: PathBuf::from("r.npy"),
            name: String::new(),
            data,
            axes: labels.map(|l| l.iter().map(axis).collect()),
            energy_ev: None,
            semiangle_mrad: None,
        }
    }

    /// Value 10 i + j at [i, j].
    fn counted(n: usize, m: usize) -> ArrayD<f64> {
        Array2::from_shape_fn((n, m), |(i, j)| (10 * i + j) as f64).into_dyn()
    }

    #[test]
    fn the_order_is_told_given_or_found_but_not_guessed() {
        let plain = array(counted(3, 3), None);
        let told = reference(&plain, None, &[], None).unwrap_err().to_string();
        assert!(told.contains("xy or yx") && told.contains("r.npy"), "{told}");
        assert!(reference(&plain, None, &[], Some([3, 3])).is_err(), "square: sizes say nothing");
        let yx = reference(&plain, Some(Order::Yx), &[], None).unwrap().data;
        let xy = reference(&plain, Some(Order::Xy), &[], None).unwrap().data;
        assert_eq!((yx[[0, 2]], xy[[0, 2]]), (2.0, 20.0));
        let oblong = array(counted(3, 5), None);
        assert!(reference(&oblong, None, &[], None).is_err());
        // 5 along x, 3 along y
        assert_eq!(reference(&oblong, None, &[], Some([5, 3])).unwrap().data.dim(), (3, 5));
        assert_eq!(reference(&oblong, None, &[], Some([3, 5])).unwrap().data.dim(), (5, 3));
        let labelled = array(counted(3, 5), Some(&["x", "y"]));
        let r = reference(&labelled, None, &[], Some([5, 3])).unwrap();
        assert_eq!((r.data.dim(), r.data[[4, 2]]), ((5, 3), 24.0));
        assert_eq!((r.step_angstrom, r.origin_angstrom), (Some([0.1, 0.2]), [0.5; 2]));
        let r = reference(&array(counted(3, 5), Some(&["y", "x"])), None, &[], None).unwrap();
        assert_eq!((r.data.dim(), r.step_angstrom), ((3, 5), Some([0.1, 0.2])));
        assert!(reference(&labelled, Some(Order::Yx), &[], None).is_err(), "against the file");
    }

    #[test]
    fn further_dimensions_need_a_choice() {
        let stack = Array3::from_shape_fn((4, 2, 3), |(t, i, j)| (100 * t + 10 * i + j) as f64);
        let stack = array(stack.into_dyn(), Some(&["z", "x", "y"]));
        assert!(reference(&stack, None, &[], None).unwrap_err().to_string().contains("below 4"));
        assert!(reference(&stack, None, &[4], None).unwrap_err().to_string().contains("too large"));
        assert_eq!(reference(&stack, None, &[2], None).unwrap().data[[2, 1]], 212.0);
        let single = Array3::from_shape_fn((1, 2, 3), |(_, i, j)| (10 * i + j) as f64);
        let single = array(single.into_dyn(), None);
        assert!(reference(&single, Some(Order::Yx), &[0], None).is_err());
        assert_eq!(reference(&single, Some(Order::Yx), &[], None).unwrap().data[[1, 2]], 12.0);
    }

    #[test]
    fn values_are_checked() {
        let mut bad = counted(2, 2);
        bad[[1, 0]] = f64::NAN;
        let told =
            reference(&array(bad, None), Some(Order::Xy), &[], None).unwrap_err().to_string();
        assert!(told.contains("NaN at index [1, 0]"), "{told}");
        let file = array(counted(2, 2), None);
        let mut image = Array2::from_elem((2, 2), 3.0);
        assert!(in_fractions(&file, &mut image, ValueUnits::Fraction).is_err());
        assert!(in_fractions(&file, &mut image, ValueUnits::Percent).is_ok());
        assert_eq!(image[[0, 0]], 0.03);
    }

    #[test]
    fn a_better_orientation_is_found() {
        let ours = Array2::from_shape_fn((9, 9), |(y, x)| ((x * x + 3 * y) % 7) as f64 + 1.0);
        let of = |reference: &Array2<f64>| better_otherwise(&ours, reference);
        assert_eq!(of(&ours), None);
        assert_eq!(of(&ours.t().to_owned()), Some("transposed".into()));
        assert_eq!(of(&ours.slice(s![..;-1, ..]).to_owned()), Some("mirrored along y".into()));
        let moved = Array2::from_shape_fn((9, 9), |(y, x)| ours[[y, (x + 2) % 9]]);
        assert_eq!(of(&moved), Some("moved by 2, 0 pixels (x, y)".into()));
    }
}
