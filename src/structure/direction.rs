//! Reads lattice directions from text: `[001]`, `[1-10]`, `[11-20]`, `[3 0 -12]`.

use super::lattice::gcd;

/// Returns the indices of a direction. Single digits may be written without separators, others with spaces or commas between; four indices
/// \[UVTW\] of a hexagonal lattice become the three \[2U+V U+2V W\] (reduced).
///
/// # Errors
/// A sentence that describes how directions are written.
pub fn parse(text: &str) -> Result<[i32; 3], String> {
    let expected = "expected a lattice direction such as \"[001]\", \"[11-20]\" or \"[3 0 -12]\"";
    let inner = text.trim().strip_prefix('[').and_then(|t| t.strip_suffix(']'));
    let Some(inner) = inner else { return Err(expected.into()) };
    let three = match indices(inner).ok_or(expected)?[..] {
        [u, v, w] => [u, v, w],
        [u, v, t, w] => of_four([u, v, t, w])?,
        _ => return Err(expected.into()),
    };
    match three.into_iter().fold(0, gcd).abs() {
        0 => Err(expected.into()),
        divisor => Ok(three.map(|n| n / divisor)),
    }
}

/// Returns the components along the cell vectors of a vector such as `[100]`, `1/2[110]`, `1/6[11-2]` or `1/3[11-20]`. Unlike the indices
/// of a direction, the components of a vector are not reduced. Four components \[UVTW\] of a hexagonal lattice mean
/// U a1 + V a2 + T a3 + W c with a3 = -a1 - a2.
///
/// # Errors
/// A sentence that describes how vectors are written.
pub(crate) fn parse_vector(text: &str) -> Result<[f64; 3], String> {
    let expected = "expected a lattice vector such as \"[100]\", \"1/2[110]\" or \"1/6[11-2]\"";
    let open = text.find('[').ok_or(expected)?;
    let factor = match text[..open].trim() {
        "" => 1.0,
        before => factor(before).ok_or(expected)?,
    };
    let inner = text[open..].trim().strip_prefix('[').and_then(|t| t.strip_suffix(']'));
    let components = match indices(inner.ok_or(expected)?).ok_or(expected)?[..] {
        [u, v, w] => [u, v, w],
        [u, v, t, w] if u + v + t == 0 => [u - t, v - t, w],
        [_, _, _, _] => return Err("the first three of four components must add to 0".into()),
        _ => return Err(expected.into()),
    };
    match components {
        [0, 0, 0] => Err(expected.into()),
        some => Ok(some.map(|n| factor * f64::from(n))),
    }
}

/// Reads `1/6`, `-1/2`, `2`.
fn factor(text: &str) -> Option<f64> {
    let whole = |t: &str| t.trim().parse::<i32>().ok().filter(|n| n.abs() <= 100);
    let (above, below) = match text.split_once('/') {
        Some((above, below)) => (whole(above)?, whole(below)?),
        None => (whole(text)?, 1),
    };
    (above != 0 && below > 0).then(|| f64::from(above) / f64::from(below))
}

/// Returns the Miller indices of a plane such as `(001)`, `(1-11)` or `(11-20)`; of four indices the third is left out.
///
/// # Errors
/// A sentence that describes how planes are written.
pub(crate) fn parse_plane(text: &str) -> Result<[i32; 3], String> {
    let expected = "expected a lattice plane such as \"(001)\" or \"(1-11)\"";
    let inner = text.trim().strip_prefix('(').and_then(|t| t.strip_suffix(')'));
    match indices(inner.ok_or(expected)?).ok_or(expected)?[..] {
        [0, 0, 0] | [0, 0, 0, 0] => Err(expected.into()),
        [h, k, l] => Ok([h, k, l]),
        [h, k, i, l] if h + k + i == 0 => Ok([h, k, l]),
        [_, _, _, _] => Err("the first three of four indices must add to 0".into()),
        _ => Err(expected.into()),
    }
}

/// Reads indices: single digits without separators, others with spaces or commas between.
fn indices(inner: &str) -> Option<Vec<i32>> {
    match inner.contains([' ', ',']) {
        true => inner
            .split([' ', ','])
            .filter(|w| !w.is_empty())
            .map(|w| w.parse::<i32>().ok().filter(|n| n.abs() <= 100))
            .collect(),
        false => digits(inner),
    }
}

/// Returns the three indices \[2U+V U+2V W\], reduced, of the direction \[UVTW\] of a hexagonal lattice.
///
/// # Errors
/// A sentence, for indices that give no direction or are beyond 1000.
pub fn of_four([u, v, t, w]: [i32; 4]) -> Result<[i32; 3], String> {
    if [u, v, t, w].iter().any(|n| !(-1000..=1000).contains(n)) {
        return Err("indices beyond 1000".into());
    }
    if u + v + t != 0 {
        return Err("the first three of four indices must add to 0".into());
    }
    let three = [2 * u + v, u + 2 * v, w];
    match three.into_iter().fold(0, gcd).abs() {
        0 => Err("all indices are 0".into()),
        divisor => Ok(three.map(|n| n / divisor)),
    }
}

/// Reads single digits, each with its sign.
fn digits(text: &str) -> Option<Vec<i32>> {
    let mut out = Vec::new();
    let mut sign = 1;
    for c in text.chars() {
        match c.to_digit(10) {
            Some(d) => {
                out.push(sign * d as i32);
                sign = 1;
            }
            None if c == '-' && sign == 1 => sign = -1,
            None => return None,
        }
    }
    (sign == 1).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_and_planes_are_read() {
        assert_eq!(parse_vector("[200]"), Ok([2.0, 0.0, 0.0]));
        assert_eq!(parse_vector("1/2[110]"), Ok([0.5, 0.5, 0.0]));
        assert_eq!(parse_vector(" -1/6 [11-2]"), Ok([-1.0 / 6.0, -1.0 / 6.0, 2.0 / 6.0]));
        // a1 + a2 = -a3 has the length a.
        assert_eq!(parse_vector("1/3[11-20]"), Ok([1.0, 1.0, 0.0]));
        for bad in ["110", "1/0[110]", "x[110]", "[000]", "1/2[1]", "[1120]", "0[100]"] {
            assert!(parse_vector(bad).is_err(), "{bad}");
        }
        assert_eq!(parse_plane("(1-11)"), Ok([1, -1, 1]));
        assert_eq!(parse_plane("(11-20)"), Ok([1, 1, 0]));
        assert_eq!(parse_plane("(1 0 -12)"), Ok([1, 0, -12]));
        for bad in ["[111]", "(000)", "(1120)", "(1)"] {
            assert!(parse_plane(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn directions_are_read() {
        assert_eq!(parse("[001]"), Ok([0, 0, 1]));
        assert_eq!(parse("[1-10]"), Ok([1, -1, 0]));
        assert_eq!(parse("[11-20]"), Ok([1, 1, 0]));
        assert_eq!(parse("[0001]"), Ok([0, 0, 1]));
        assert_eq!(parse("[1-100]"), Ok([1, -1, 0]));
        assert_eq!(parse("[3, 0,-12]"), Ok([1, 0, -4]));
        for bad in ["001", "[01]", "[000]", "[1120]", "[11-]", "[1--10]", "[a b c]", "[1 2 900]"] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }
}
