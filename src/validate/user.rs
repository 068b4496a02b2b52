//! Reads an image of another program: its orientation, its scan, its unit.
//!
//! abTEM's arrays are `[x, y]`, ours `[y, x]`. The order of a file comes from the file's own labels, from the caller, or from sizes that
//! allow only one order; it is never guessed.

use ndarray::{Array2, ArrayView2, Axis as Dimension, Ix2};

use crate::error::Result;
use crate::io::arrays::{ArrayAxis, ForeignArray};
use crate::setting::Setting;

/// Order of the two dimensions of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// First index along x, as in abTEM.
    Xy,
    /// First index along y, as in matrices, pictures and this program.
    Yx,
}

/// Unit of the values of a reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueUnits {
    /// Fractions of the beam.
    Fraction,
    /// Per cent of the beam.
    Percent,
    /// Any unit proportional to the intensity: the factor is fitted.
    Fitted,
}

/// A reference image: row = y, column = x.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// The values.
    pub data: Array2<f64>,
    /// Distance of pixels along x and y in Angstrom, if the file gives it.
    pub step_angstrom: Option<[f64; 2]>,
    /// Position of the first pixel, (x, y) in Angstrom, if the file gives it.
    pub origin_angstrom: Option<[f64; 2]>,
    /// Origin of the orientation: file, caller or sizes.
    pub orientation: &'static str,
}

/// Extracts the image of an array (row = y, column = x), in the unit of the file.
///
/// `index` chooses along the dimensions other than x and y; dimensions of length 1 need no choice. `expected` are the (x, y) numbers of
/// pixels of the scan, if known: if they differ, they determine the order.
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
        (Some([x, y]), None, _) if x < y => (Order::Xy, "the file names its axes x, y"),
        (Some(_), None, _) => (Order::Yx, "the file names its axes y, x"),
        (Some([x, y]), Some(given), _) => {
            let by_steps = if x < y { Order::Xy } else { Order::Yx };
            if by_steps != given {
                let names = if x < y { "x, y" } else { "y, x" };
                return Err(array.choice(
                    Setting::ImageAxes,
                    format!(
                        "names its axes {names}, which contradicts the given order; give no order, or correct the file"
                    ),
                ));
            }
            (given, "as given, and as in the file")
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
    let origin = |of: usize| axis(of).and_then(|a: &ArrayAxis| a.origin_angstrom);
    Ok(Reference {
        data,
        step_angstrom: step(x).zip(step(y)).map(|(x, y)| [x, y]),
        origin_angstrom: origin(x).zip(origin(y)).map(|(x, y)| [x, y]),
        orientation,
    })
}

/// Returns the dimensions that are labelled x and y.
fn labelled(array: &ForeignArray) -> Option<[usize; 2]> {
    ArrayAxis::x_and_y(array.axes.as_ref()?)
}

/// Returns the order in which `(first, second)` pixels fit the scan, if only one order fits.
fn by_size((first, second): (usize, usize), expected: Option<[usize; 2]>) -> Option<Order> {
    let [x, y] = expected?;
    match ([first, second] == [x, y], [first, second] == [y, x]) {
        (true, false) => Some(Order::Xy),
        (false, true) => Some(Order::Yx),
        _ => None,
    }
}

/// Extracts the two dimensions of `plane`, in their order in the file.
fn choose(array: &ForeignArray, plane: [usize; 2], index: &[usize]) -> Result<Array2<f64>> {
    let shape = array.data.shape();
    let others: Vec<usize> =
        (0..shape.len()).filter(|d| !plane.contains(d) && shape[*d] > 1).collect();
    if index.len() != others.len() {
        let lengths: Vec<String> = others.iter().map(|d| shape[*d].to_string()).collect();
        let message = match others.len() {
            0 => "holds one image: an index is not needed".to_owned(),
            n => format!(
                "holds an array of shape {shape:?}: its index has {n} number{} from 0, below {}",
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

/// Converts values to fractions of the beam.
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
                "holds values from {:.4} to {:.4}, which are no fractions of the beam; give their unit: percent, or fitted for values \
                 proportional to the intensity",
                range[0], range[1]
            ),
        ));
    }
    Ok(())
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
            origin_angstrom: Some(0.5),
        };
        ForeignArray {
            path: PathBuf::from("r.npy"),
            name: String::new(),
            data,
            axes: labels.map(|l| l.iter().map(axis).collect()),
            energy_kev: None,
            semiangle_mrad: None,
            notes: Vec::new(),
            pixel_unsaid: None,
        }
    }

    /// An array with the value 10 i + j at [i, j].
    fn counted(n: usize, m: usize) -> ArrayD<f64> {
        Array2::from_shape_fn((n, m), |(i, j)| (10 * i + j) as f64).into_dyn()
    }

    #[test]
    fn the_order_is_stated_given_or_found_but_not_guessed() {
        let plain = array(counted(3, 3), None);
        let text = reference(&plain, None, &[], None).unwrap_err().to_string();
        assert!(text.contains("xy or yx") && text.contains("r.npy"), "{text}");
        assert!(reference(&plain, None, &[], Some([3, 3])).is_err(), "square: sizes say nothing");
        let yx = reference(&plain, Some(Order::Yx), &[], None).unwrap().data;
        let xy = reference(&plain, Some(Order::Xy), &[], None).unwrap().data;
        assert_eq!((yx[[0, 2]], xy[[0, 2]]), (2.0, 20.0));
        let oblong = array(counted(3, 5), None);
        assert!(reference(&oblong, None, &[], None).is_err());
        // The scan has 5 pixels along x and 3 along y.
        assert_eq!(reference(&oblong, None, &[], Some([5, 3])).unwrap().data.dim(), (3, 5));
        assert_eq!(reference(&oblong, None, &[], Some([3, 5])).unwrap().data.dim(), (5, 3));
        let labelled = array(counted(3, 5), Some(&["x", "y"]));
        let r = reference(&labelled, None, &[], Some([5, 3])).unwrap();
        assert_eq!((r.data.dim(), r.data[[4, 2]]), ((5, 3), 24.0));
        assert_eq!((r.step_angstrom, r.origin_angstrom), (Some([0.1, 0.2]), Some([0.5; 2])));
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
        let text =
            reference(&array(bad, None), Some(Order::Xy), &[], None).unwrap_err().to_string();
        assert!(text.contains("NaN at index [1, 0]"), "{text}");
        let file = array(counted(2, 2), None);
        let mut image = Array2::from_elem((2, 2), 3.0);
        assert!(in_fractions(&file, &mut image, ValueUnits::Fraction).is_err());
        assert!(in_fractions(&file, &mut image, ValueUnits::Percent).is_ok());
        assert_eq!(image[[0, 0]], 0.03);
    }
}
