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
    let indices = match inner.contains([' ', ',']) {
        true => inner
            .split([' ', ','])
            .filter(|w| !w.is_empty())
            .map(|w| w.parse::<i32>().ok().filter(|n| n.abs() <= 100))
            .collect::<Option<Vec<i32>>>(),
        false => digits(inner),
    };
    let three = match indices.ok_or(expected)?[..] {
        [u, v, w] => [u, v, w],
        [u, v, t, w] => of_four([u, v, t, w])?,
        _ => return Err(expected.into()),
    };
    match three.into_iter().fold(0, gcd).abs() {
        0 => Err(expected.into()),
        divisor => Ok(three.map(|n| n / divisor)),
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
