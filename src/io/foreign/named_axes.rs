//! Dimensions of an array as its file describes them, and the search for x and y among them.

/// Description of one dimension of an array.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct NamedAxis {
    /// Name; empty if the file gives none.
    pub name: String,
    /// Distance of neighbouring entries, in [`Self::unit`].
    pub step: Option<f64>,
    /// Position of the first entry, in [`Self::unit`].
    pub first: Option<f64>,
    /// Unit of `step` and `first`; empty if the file gives none.
    pub unit: String,
}

/// Names of the axis to the right, in any case: of most programs, of NeXus for scanning microscopes, and of pictures.
const X: [&str; 4] = ["x", "x_position", "axis_i", "width"];
/// Names of the axis downwards.
const Y: [&str; 4] = ["y", "y_position", "axis_j", "height"];
/// Largest relative deviation of a step from the mean step of an evenly spaced axis.
const EVEN: f64 = 1e-2;

/// Returns the dimensions named x and y, if exactly one has each name.
pub(crate) fn x_and_y<'a>(names: impl Iterator<Item = &'a str>) -> Option<[usize; 2]> {
    let names: Vec<String> = names.map(|name| name.trim().to_ascii_lowercase()).collect();
    let only = |known: [&str; 4]| {
        let mut found = (0..names.len()).filter(|at| known.contains(&names[*at].as_str()));
        found.next().filter(|_| found.next().is_none())
    };
    Some([only(X)?, only(Y)?])
}

/// Returns the step of positions along an axis, if they are evenly spaced. Some programs store only the first two positions.
pub(crate) fn even_step(places: &[f64]) -> Option<f64> {
    let steps = places.len().checked_sub(1).filter(|n| *n > 0)?;
    let step = (places[steps] - places[0]) / steps as f64;
    let even = places.windows(2).all(|pair| (pair[1] - pair[0] - step).abs() <= EVEN * step.abs());
    (step.is_finite() && even).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn x_and_y_are_found_by_their_names() {
        let of = |names: &[&str]| x_and_y(names.iter().copied());
        assert_eq!(of(&["x", "y"]), Some([0, 1]));
        assert_eq!(of(&["t", "height", " Width "]), Some([2, 1]));
        assert_eq!(of(&["axis_j", "axis_i"]), Some([1, 0]));
        // py4DSTEM calls the rows of its images Rx.
        for others in [&["", ""][..], &["x", "x", "y"], &["Rx", "Ry"], &["kx", "ky"], &["x", "z"]] {
            assert_eq!(of(others), None, "{others:?}");
        }
    }

    #[test]
    fn steps_are_those_of_even_places() {
        assert_eq!(even_step(&[1.0, 1.5, 2.0]), Some(0.5));
        assert_eq!(even_step(&[0.0, -0.2]), Some(-0.2));
        for none in [&[][..], &[3.0], &[0.0, 1.0, 3.0], &[0.0, f64::NAN]] {
            assert_eq!(even_step(none), None, "{none:?}");
        }
    }
}
