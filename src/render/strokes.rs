//! What the glyphs of the stroke font are drawn with.

use super::canvas::Point;

/// Part of a glyph; x to the right and y up from the base line, in heights of a digit.
pub(super) enum Stroke {
    /// Straight lines through points.
    Line(&'static [Point]),
    /// Centre, half axes, and angles from and to in degrees.
    Arc(Point, Point, f64, f64),
}

/// An ellipse about (`x`, `y`) with half axes `rx` and `ry`, in heights of a digit.
pub(super) fn circle(x: f64, y: f64, rx: f64, ry: f64) -> Stroke {
    Stroke::Arc([x, y], [rx, ry], 0.0, 360.0)
}
