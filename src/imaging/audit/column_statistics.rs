//! Intensities of columns in an audit, and their statistics by kind of column.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::imaging::pixels::PixelRect;
use crate::lengths;
use crate::plane;
use crate::recipe::Recipe;
use crate::specimen::{SiteKind, Specimen, SpecimenSite};
use crate::structure::elements;

/// Radius in Angstrom over which a column's intensity is averaged.
const COLUMN_ANGSTROM: f64 = 0.45;

/// Statistics of one kind of column, over all regions.
#[derive(Debug, Clone, Serialize, Deserialize, PartialEq)]
#[non_exhaustive]
pub struct KindAudit {
    /// Elements of the column: `Sr`, `O Ti`.
    pub kind: String,
    /// Columns compared.
    pub columns: usize,
    /// Mean intensity of mosaic over exact.
    pub mean_ratio: f64,
    /// Variance over the columns, mosaic over exact.
    pub variance_ratio: f64,
    /// Correlation of the two images' deviations from the mean, column by column.
    pub correlation: f64,
    /// Correlation of neighbours of the kind: mosaic and exact.
    pub neighbours: [f64; 2],
}

/// A column, and its intensity in the two images.
#[non_exhaustive]
pub(crate) struct ColumnPoint {
    /// Elements that belong there.
    pub kind: String,
    /// Position (x, y) in Angstrom from the first pixel of the region.
    pub at: [f64; 2],
    /// Intensity in the audited image, as fraction of the beam.
    pub ours: f64,
    /// Intensity in the exact image, as fraction of the beam.
    pub exact: f64,
}

/// The elements that belong in a column.
fn kind(sites: &[SpecimenSite], recipe: &Recipe) -> String {
    let host = |number: u8| {
        let by = recipe.substitutions.as_ref().map(|s| (&s.by, &s.element));
        let further = recipe.defects.iter().filter_map(|d| Some((d.by.as_ref()?, &d.element)));
        let alloy = recipe.alloy.as_ref().map(|a| (&a.guest, &a.host));
        let symbol = elements::symbol(number);
        let pair = by.into_iter().chain(further).chain(alloy).find(|(guest, _)| *guest == symbol);
        pair.map_or(symbol, |(_, host)| host.as_str()).to_owned()
    };
    let mut symbols: Vec<String> = sites
        .iter()
        .map(|s| {
            if s.kind == SiteKind::Substitution {
                host(s.number)
            } else {
                elements::symbol(s.number).into()
            }
        })
        .collect();
    symbols.sort();
    symbols.dedup();
    symbols.join(" ")
}

/// Measures the columns inside a region in the two images [row, column] of the compared pixels.
pub(crate) fn column_points(
    recipe: &Recipe,
    specimen: &dyn Specimen,
    region: &PixelRect,
    [ours, exact]: [&Array2<f64>; 2],
) -> Vec<ColumnPoint> {
    let pixel_nm = recipe.field.pixel_nm();
    let step = lengths::angstrom(pixel_nm) * region.stride as f64;
    let sites = specimen.query(&region.region(pixel_nm).grown(-0.08));
    let corner = plane::swapped(region.first).map(|n| n as f64 * 10.0 * pixel_nm);
    let mut found = Vec::new();
    for column in &sites.columns {
        let at = plane::sub(lengths::angstrom(column.position_nm), corner);
        let mut near = [0.0; 3];
        for ((i, j), value) in ours.indexed_iter() {
            let d = [at[0] - j as f64 * step, at[1] - i as f64 * step];
            let weight = (-(d[0] * d[0] + d[1] * d[1])
                / (2.0 * COLUMN_ANGSTROM * COLUMN_ANGSTROM / 4.0))
                .exp();
            near = [near[0] + weight, near[1] + weight * value, near[2] + weight * exact[[i, j]]];
        }
        if near[0] > 1e-3 {
            let sites = &sites.sites[column.sites.clone()];
            let [ours, exact] = [near[1], near[2]].map(|v| v / near[0]);
            found.push(ColumnPoint { kind: kind(sites, recipe), at, ours, exact });
        }
    }
    found
}
/// Statistics of the columns of one kind; each column is given with the number of its region.
pub(crate) fn kind_audit(kind: &str, points: &[(usize, &ColumnPoint)]) -> KindAudit {
    let n = points.len() as f64;
    let mean = |of: &dyn Fn(&ColumnPoint) -> f64| points.iter().map(|p| of(p.1)).sum::<f64>() / n;
    let (a, b) = (mean(&|p| p.ours), mean(&|p| p.exact));
    let moment = |of: &dyn Fn(&ColumnPoint) -> f64| mean(of);
    let (aa, bb) = (moment(&|p| (p.ours - a).powi(2)), moment(&|p| (p.exact - b).powi(2)));
    let ab = moment(&|p| (p.ours - a) * (p.exact - b));
    let mut pairs = [0.0; 2];
    let mut count = 0.0;
    for (i, (region, p)) in points.iter().enumerate() {
        let others = points.iter().enumerate().filter(|(j, (r, _))| *j != i && r == region);
        let distance = |q: &ColumnPoint| (p.at[0] - q.at[0]).hypot(p.at[1] - q.at[1]);
        let nearest = others.min_by(|x, y| distance(x.1.1).total_cmp(&distance(y.1.1)));
        if let Some((_, (_, q))) = nearest {
            pairs[0] += (p.ours - a) * (q.ours - a);
            pairs[1] += (p.exact - b) * (q.exact - b);
            count += 1.0;
        }
    }
    let safe = |x: f64, y: f64| if y > 0.0 { x / y } else { f64::NAN };
    KindAudit {
        kind: kind.to_owned(),
        columns: points.len(),
        mean_ratio: safe(a, b),
        variance_ratio: safe(aa, bb),
        correlation: safe(ab, (aa * bb).sqrt()),
        neighbours: [
            safe(pairs[0] / f64::max(count, 1.0), aa),
            safe(pairs[1] / f64::max(count, 1.0), bb),
        ],
    }
}
