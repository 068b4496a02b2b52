//! Labels of columns: heat maps and class masks.

use ndarray::ArrayViewMut2;

use super::region_truth::ColumnTruth;

/// A column outside a tile shows in its labels up to this distance, in standard deviations.
pub(crate) const REACH_SIGMAS: f64 = 4.0;
/// Class masks hold the pixels where the heat map is above this value.
const IN_MASK: f32 = 0.5;

/// Returns the index of a column's class in [`COLUMN_CLASSES`](super::COLUMN_CLASSES).
pub(crate) fn class_of(column: &ColumnTruth) -> u8 {
    class_of_counts(column.vacancies as i32, column.substitutions as i32)
}

/// Returns the index of the class of a column with these numbers of vacancies and substitutions.
pub(crate) fn class_of_counts(vacancies: i32, substitutions: i32) -> u8 {
    1 + u8::from(vacancies > 0) + 2 * u8::from(substitutions > 0)
}

/// Draws a column at (row, column) in pixels: a Gaussian of height 1 in the heat map, and its class where that Gaussian is above one half.
pub(crate) fn draw_column(
    at: [f64; 2],
    class: u8,
    sigma_px: f64,
    heat: &mut ArrayViewMut2<f32>,
    mask: &mut ArrayViewMut2<u8>,
) {
    let (rows, columns) = heat.dim();
    let reach = (REACH_SIGMAS * sigma_px).ceil() as i64;
    let span = |k: usize, size: usize| {
        let centre = at[k].round() as i64;
        (centre - reach).max(0)..(centre + reach + 1).min(size as i64)
    };
    // A Gaussian is the product of one along each axis.
    let along =
        |k: usize, i: i64| libm::exp(-0.5 * (i as f64 - at[k]).powi(2) / (sigma_px * sigma_px));
    let across: Vec<f64> = span(1, columns).map(|j| along(1, j)).collect();
    for i in span(0, rows) {
        let down = along(0, i);
        for (j, across) in span(1, columns).zip(&across) {
            let value = (down * across) as f32;
            let place = [i as usize, j as usize];
            if value > heat[place] {
                heat[place] = value;
                mask[place] = if value > IN_MASK { class } else { 0 };
            }
        }
    }
}

/// Class, sites, vacancies, substitutions and atomic number of the heaviest atom of a column.
pub(crate) fn facts_of(column: &ColumnTruth) -> [i32; 5] {
    let heaviest = column.atoms.iter().map(|(z, _)| i32::from(*z)).max().unwrap_or(0);
    let ColumnTruth { sites, vacancies, substitutions, .. } = *column;
    let [sites, vacancies, substitutions] = [sites, vacancies, substitutions].map(|n| n as i32);
    [i32::from(class_of(column)), sites, vacancies, substitutions, heaviest]
}
