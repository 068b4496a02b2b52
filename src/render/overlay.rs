//! What is drawn over an image: scale bar and markers.

use super::canvas::{Point, RgbImage};
use super::enlarge::SizeChange;
use super::font;
use crate::error::{Error, Result};
use crate::plane;
use crate::setting::Setting;

const WHITE: [u8; 3] = [255; 3];
const BLACK: [u8; 3] = [0; 3];

/// The form of a marker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MarkerShape {
    /// A ring.
    Circle,
    /// Two diagonal lines.
    Cross,
}

/// A mark on an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marker {
    /// Row and column in pixels of the image; the first pixel's centre is (0, 0).
    pub position: [f64; 2],
    /// Radius in pixels of the image; drawn at least 4 picture pixels large.
    pub radius: f64,
    /// Its form.
    pub shape: MarkerShape,
    /// Red, green and blue.
    pub color: [u8; 3],
}

/// Draws one marker with a thin dark rim.
pub(super) fn draw_marker(image: &mut RgbImage, marker: &Marker, scale: SizeChange) -> Result<()> {
    let [row, column] = marker.position;
    if !(row.is_finite() && column.is_finite() && marker.radius.is_finite()) {
        let value = format!("{:?}, radius {}", marker.position, marker.radius);
        return Err(Error::invalid(Setting::MarkerPosition, value, "expected finite numbers"));
    }
    let center = [scale.place(column), scale.place(row)];
    let radius = (marker.radius * scale.factor()).max(4.0);
    let reach = radius + 10.0;
    let size = [image.width as f64, image.height as f64];
    if (0..2).any(|a| center[a] < -reach || center[a] > size[a] + reach) {
        return Ok(());
    }
    let lines = match marker.shape {
        MarkerShape::Circle => vec![ring(center, radius)],
        MarkerShape::Cross => {
            let arm = radius * std::f64::consts::FRAC_1_SQRT_2;
            let end = |dx: f64, dy: f64| [center[0] + dx * arm, center[1] + dy * arm];
            vec![vec![end(-1.0, -1.0), end(1.0, 1.0)], vec![end(-1.0, 1.0), end(1.0, -1.0)]]
        }
    };
    let thickness = (size[0].max(size[1]) / 400.0).clamp(1.2, 6.0);
    image.stroke(&lines, thickness + 1.6, BLACK, 0.5);
    image.stroke(&lines, thickness, marker.color, 1.0);
    Ok(())
}

fn ring(center: Point, radius: f64) -> Vec<Point> {
    let steps = 64;
    let point = |i: usize| {
        let angle = std::f64::consts::TAU * f64::from(i as u32) / f64::from(steps);
        [center[0] + radius * angle.cos(), center[1] + radius * angle.sin()]
    };
    (0..=steps as usize).map(point).collect()
}

/// Sizes of the scale bar in picture pixels.
struct ScaleBar {
    digit: f64,
    margin: f64,
    padding: f64,
    gap: f64,
    thickness: f64,
}

impl ScaleBar {
    fn new(image: &RgbImage) -> Self {
        let side = image.width.min(image.height) as f64;
        let digit = (0.032 * side).clamp(11.0, 40.0).round();
        ScaleBar {
            digit,
            margin: (0.025 * side).max(4.0).round(),
            padding: (0.55 * digit).round(),
            gap: (0.5 * digit).round(),
            thickness: (0.24 * digit).round().max(3.0),
        }
    }
}

/// Draws the bar with its label in the lower left corner, on a dark translucent ground, and
/// returns its length in Angstrom; `None` if the picture is too small for it.
pub(super) fn draw_bar(image: &mut RgbImage, angstrom_per_pixel: f64) -> Option<f64> {
    let at = ScaleBar::new(image);
    let length = round_below(0.28 * image.width as f64 * angstrom_per_pixel)?;
    let pixels = length / angstrom_per_pixel;
    let label = label(length);
    let text_width = font::width(&label, at.digit);
    let content = pixels.max(text_width);
    // The ring of the letter for Angstrom rises above the digits.
    let rise = 0.08 * at.digit;
    let box_size =
        [content + 2.0 * at.padding, rise + at.digit + at.gap + at.thickness + 2.0 * at.padding];
    if box_size[0] + 2.0 * at.margin > image.width as f64
        || box_size[1] + 2.0 * at.margin > image.height as f64
    {
        return None;
    }
    let low = [at.margin - 0.5, image.height as f64 - 0.5 - at.margin - box_size[1]];
    let high = [low[0] + box_size[0], low[1] + box_size[1]];
    image.fill(low, high, 0.35 * at.digit, BLACK, 0.6);
    let left = low[0] + at.padding + (content - pixels) / 2.0;
    let bottom = (high[1] - at.padding).round() - 0.5;
    image.fill([left, bottom - at.thickness], [left + pixels, bottom], 0.0, WHITE, 1.0);
    let start =
        [low[0] + at.padding + (content - text_width) / 2.0, bottom - at.thickness - at.gap];
    image.stroke(&font::lines(&label, start, at.digit), 0.135 * at.digit, WHITE, 1.0);
    Some(length)
}

/// Draws the colours from the first to the last with their values, in the lower right corner; whether there is room for it.
pub(super) fn draw_grey_bar(
    image: &mut RgbImage,
    colors: &[[u8; 3]; 256],
    [min, max]: [f32; 2],
) -> bool {
    let at = ScaleBar::new(image);
    let labels = [min, max].map(|value| value_label(f64::from(value)));
    let widths = labels.each_ref().map(|label| font::width(label, at.digit));
    let length = (0.24 * image.width as f64).max(widths[0] + widths[1] + 2.0 * at.gap).round();
    let height = (1.2 * at.digit).round();
    let box_size = [length + 2.0 * at.padding, at.digit + at.gap + height + 2.0 * at.padding];
    // The scale bar takes up to a third of the width.
    if box_size[0] + 2.0 * at.margin > 0.6 * image.width as f64
        || box_size[1] + 2.0 * at.margin > image.height as f64
    {
        return false;
    }
    let high = [image.width as f64 - 0.5 - at.margin, image.height as f64 - 0.5 - at.margin];
    let low = plane::sub(high, box_size);
    image.fill(low, high, 0.35 * at.digit, BLACK, 0.6);
    let left = (low[0] + at.padding).round() as usize;
    let bottom = (high[1] - at.padding).round() as usize;
    for x in 0..length as usize {
        let color = colors[x * 255 / (length as usize - 1).max(1)];
        (bottom - height as usize..bottom).for_each(|y| image.blend(left + x, y, color, 1.0));
    }
    let text_bottom = bottom as f64 - height - at.gap;
    let starts = [left as f64, left as f64 + length - widths[1]];
    for (label, start) in labels.iter().zip(starts) {
        let lines = font::lines(label, [start, text_bottom], at.digit);
        image.stroke(&lines, 0.135 * at.digit, WHITE, 1.0);
    }
    true
}

/// A value with three digits.
fn value_label(value: f64) -> String {
    let size = value.abs();
    match size {
        0.0 => "0".into(),
        1e-3..1e5 => {
            let decimals = (2 - size.log10().floor() as i32).max(0) as usize;
            format!("{value:.decimals$}")
        }
        _ => format!("{value:.2e}"),
    }
}

/// Writes a line of text in the upper left corner, on a box as that of the scale bar; nothing where it does not fit.
pub(super) fn draw_caption(image: &mut RgbImage, caption: &str) {
    let at = ScaleBar::new(image);
    let size = [font::width(caption, at.digit) + 2.0 * at.padding, at.digit + 2.0 * at.padding];
    if size[0] + 2.0 * at.margin > image.width as f64 {
        return;
    }
    let low = [at.margin - 0.5; 2];
    let high = plane::add(low, size);
    image.fill(low, high, 0.35 * at.digit, BLACK, 0.6);
    let start = [low[0] + at.padding, high[1] - at.padding];
    image.stroke(&font::lines(caption, start, at.digit), 0.135 * at.digit, WHITE, 1.0);
}

/// The largest of 1, 2, 5 times a power of ten that is not above `limit`.
fn round_below(limit: f64) -> Option<f64> {
    if !(1e-6..=1e12).contains(&limit) {
        return None;
    }
    let exponent = limit.log10().floor() as i32;
    // Powers with negative exponents are not exact, their reciprocals are.
    let times = |digit: f64, exponent: i32| {
        if exponent < 0 { digit / 10f64.powi(-exponent) } else { digit * 10f64.powi(exponent) }
    };
    [(1.0, exponent + 1), (5.0, exponent), (2.0, exponent), (1.0, exponent), (5.0, exponent - 1)]
        .into_iter()
        .map(|(digit, exponent)| times(digit, exponent))
        .find(|&length| length <= limit)
}

/// A length with its unit.
fn label(angstrom: f64) -> String {
    if angstrom < 10.0 {
        format!("{angstrom} \u{c5}")
    } else if angstrom < 10_000.0 {
        format!("{} nm", angstrom / 10.0)
    } else {
        format!("{} \u{b5}m", angstrom / 10_000.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_three_digits() {
        let labels = [0.0, 0.012_345, 1.0, 123.4, 54_321.0, 1.5e-6, -0.5].map(value_label);
        assert_eq!(labels, ["0", "0.0123", "1.00", "123", "54321", "1.50e-6", "-0.500"]);
    }

    #[test]
    fn a_grey_bar_shows_the_first_and_the_last_colour() {
        let colors = std::array::from_fn(|n| [n as u8; 3]);
        let mut image = RgbImage::filled(512, 512, [90, 0, 0]);
        assert!(draw_grey_bar(&mut image, &colors, [0.0, 0.25]));
        // A row through the gradient.
        let row = image.pixels.chunks(3).skip(512 * (512 - 13 - 9 - 8)).take(512);
        let grey: Vec<u8> = row.filter(|p| p[0] == p[1] && p[0] == p[2]).map(|p| p[0]).collect();
        assert_eq!((grey.first(), grey.last()), (Some(&0), Some(&255)), "{grey:?}");
        assert!(grey.is_sorted());
        assert!(!draw_grey_bar(&mut RgbImage::filled(40, 40, [0; 3]), &colors, [0.0, 1.0]));
    }

    #[test]
    fn lengths_are_round_and_have_a_unit() {
        let text = |limit| label(round_below(limit).unwrap());
        assert_eq!(text(0.09), "0.05 \u{c5}");
        assert_eq!(text(0.3), "0.2 \u{c5}");
        assert_eq!(text(4.9), "2 \u{c5}");
        assert_eq!(text(5.0), "5 \u{c5}");
        assert_eq!(text(10.0), "1 nm");
        assert_eq!(text(77.0), "5 nm");
        assert_eq!(text(1000.0), "100 nm");
        assert_eq!(text(99_999.0), "5 \u{b5}m");
        assert_eq!(round_below(f64::NAN), None);
        assert_eq!(round_below(0.0), None);
    }
}
