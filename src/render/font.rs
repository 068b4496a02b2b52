//! A stroke font: layout, digits and the letters of units. The other letters are in `letters`.

use super::canvas::Point;
use super::letters;
use super::strokes::{
    Stroke::{self, Arc, Line},
    circle,
};

/// Space between glyphs, in heights of a digit.
const GAP: f64 = 0.2;
/// Width of a space, in heights of a digit.
const SPACE: f64 = 0.3;

/// Width and parts of a character; `None` if the font lacks it.
fn glyph(character: char) -> Option<(f64, Vec<Stroke>)> {
    digit(character).or_else(|| unit(character)).or_else(|| letters::glyph(character))
}

fn digit(character: char) -> Option<(f64, Vec<Stroke>)> {
    Some(match character {
        '0' => (0.58, vec![circle(0.29, 0.5, 0.29, 0.5)]),
        '1' => (0.3, vec![Line(&[[0.0, 0.8], [0.26, 1.0], [0.26, 0.0]])]),
        '2' => (
            0.58,
            vec![
                Arc([0.29, 0.71], [0.28, 0.29], 165.0, -38.0),
                Line(&[[0.511, 0.531], [0.0, 0.0], [0.58, 0.0]]),
            ],
        ),
        '3' => (
            0.58,
            vec![
                Arc([0.28, 0.75], [0.26, 0.25], 150.0, -90.0),
                Arc([0.28, 0.26], [0.3, 0.26], 90.0, -150.0),
            ],
        ),
        '4' => (0.62, vec![Line(&[[0.46, 0.0], [0.46, 1.0], [0.0, 0.28], [0.62, 0.28]])]),
        '5' => (
            0.58,
            vec![
                Line(&[[0.53, 1.0], [0.1, 1.0], [0.05, 0.54]]),
                Arc([0.28, 0.32], [0.3, 0.33], 140.0, -145.0),
            ],
        ),
        '6' => {
            (0.6, vec![circle(0.3, 0.31, 0.3, 0.31), Arc([0.52, 0.31], [0.52, 0.69], 180.0, 105.0)])
        }
        '7' => (0.56, vec![Line(&[[0.0, 1.0], [0.56, 1.0], [0.18, 0.0]])]),
        '8' => (0.6, vec![circle(0.3, 0.76, 0.25, 0.24), circle(0.3, 0.26, 0.3, 0.26)]),
        '9' => {
            (0.6, vec![circle(0.3, 0.69, 0.3, 0.31), Arc([0.08, 0.69], [0.52, 0.69], 0.0, -75.0)])
        }
        _ => return None,
    })
}

fn unit(character: char) -> Option<(f64, Vec<Stroke>)> {
    Some(match character {
        '.' => (0.04, vec![Line(&[[0.02, 0.01], [0.02, 0.02]])]),
        'n' => (
            0.46,
            vec![
                Line(&[[0.0, 0.0], [0.0, 0.68]]),
                Arc([0.23, 0.42], [0.23, 0.26], 180.0, 0.0),
                Line(&[[0.46, 0.42], [0.46, 0.0]]),
            ],
        ),
        'm' => (
            0.78,
            vec![
                Line(&[[0.0, 0.0], [0.0, 0.68]]),
                Arc([0.195, 0.45], [0.195, 0.23], 180.0, 0.0),
                Line(&[[0.39, 0.45], [0.39, 0.0]]),
                Arc([0.585, 0.45], [0.195, 0.23], 180.0, 0.0),
                Line(&[[0.78, 0.45], [0.78, 0.0]]),
            ],
        ),
        '\u{b5}' => (
            0.46,
            vec![
                Line(&[[0.0, -0.28], [0.0, 0.68]]),
                Arc([0.23, 0.24], [0.23, 0.24], 180.0, 360.0),
                Line(&[[0.46, 0.68], [0.46, 0.0]]),
            ],
        ),
        '\u{c5}' => (
            0.66,
            vec![
                Line(&[[0.0, 0.0], [0.33, 0.84], [0.66, 0.0]]),
                Line(&[[0.11, 0.28], [0.55, 0.28]]),
                circle(0.33, 0.97, 0.1, 0.1),
            ],
        ),
        _ => return None,
    })
}

/// Width of a text whose digits are `height` high.
pub(super) fn width(text: &str, height: f64) -> f64 {
    let advance = |c: char| match glyph(c) {
        Some((width, _)) => width + GAP,
        None => SPACE,
    };
    (text.chars().map(advance).sum::<f64>() - GAP).max(0.0) * height
}

/// The lines of a text that begins at `start` on the base line; unknown characters are spaces.
pub(super) fn lines(text: &str, start: Point, height: f64) -> Vec<Vec<Point>> {
    let mut lines = Vec::new();
    let mut x = start[0];
    for character in text.chars() {
        let Some((width, parts)) = glyph(character) else {
            x += SPACE * height;
            continue;
        };
        let place = |p: Point| [x + p[0] * height, start[1] - p[1] * height];
        lines.extend(parts.iter().map(|part| points(part).into_iter().map(place).collect()));
        x += (width + GAP) * height;
    }
    lines
}

fn points(part: &Stroke) -> Vec<Point> {
    match *part {
        Line(points) => points.to_vec(),
        Arc(center, half, from, to) => {
            let steps = 24;
            let point = |i: usize| {
                let angle = (from + (to - from) * i as f64 / steps as f64).to_radians();
                [center[0] + half[0] * angle.cos(), center[1] + half[1] * angle.sin()]
            };
            (0..=steps).map(point).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn glyphs_stay_in_their_width() {
        let printable = (' '..='~').filter(|c| !" \"#$&'*;<>?@\\^`{|}~!".contains(*c));
        for c in printable.chain("\u{b5}\u{c5}".chars()) {
            assert!(glyph(c).is_some(), "{c}");
            let text = c.to_string();
            let right = width(&text, 1.0);
            for [x, y] in lines(&text, [0.0, 0.0], 1.0).into_iter().flatten() {
                assert!((-0.03..=right + 0.03).contains(&x), "{c}: {x} of {right}");
                assert!((-1.1..=0.3).contains(&y), "{c}: {y}");
            }
        }
        assert!(width("10 nm", 20.0) > 2.0 * width("1", 20.0));
        assert_eq!(width("", 20.0), 0.0);
    }
}
