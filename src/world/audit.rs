//! Audits: regions of a world simulated again, exactly, with the very same atoms.

use std::collections::BTreeMap;

use ndarray::Array2;
use num_complex::Complex;
use serde::Serialize;

use super::build::SubTileEngine;
use super::field_image::FieldImage;
use super::pixel_box::PixelBox;
use super::recipe::Recipe;
use super::simulator::Simulator;
use super::specimen::{Region, SiteKind, Specimen, particles_in};
use super::subprogress::Quiet;
use crate::engine::Algorithm;
use crate::error::{Error, Result};
use crate::potential::slices::Slicing;
use crate::progress::Progress;
use crate::rng::{self, Purpose};
use crate::structure::elements;

/// Columns as bright as this share of the brightest count as bright.
const BRIGHT: f64 = 0.4;
/// Radius in Angstrom over which a column's intensity is averaged.
const COLUMN_ANGSTROM: f64 = 0.45;
/// Distance of the pixels compared in Angstrom, about.
const POINT_ANGSTROM: f64 = 0.5;
/// Slices of the reference where there are particles: thinner than the world's, so that audits show what slices make of them.
const PARTICLE_SPAN_ANGSTROM: f64 = 0.1;
/// Bands of the power spectrum, in 1/Angstrom.
const BANDS: [f64; 4] = [0.1, 0.4, 0.8, 1.2];

/// What is audited.
#[derive(Debug, Clone, PartialEq)]
pub struct AuditOptions {
    /// Number of regions, drawn at random.
    pub regions: usize,
    /// Their edge in nm.
    pub size_nm: f64,
    /// Every how many-th pixel is compared, along each axis; `None`: about every 0.5 Angstrom.
    pub stride: Option<usize>,
    /// Seed of their places.
    pub seed: u64,
    /// Centres (x, y) in nm of the built field, in place of random ones.
    pub at_nm: Vec<[f64; 2]>,
    /// Phonon configurations that are compared, in the mean; all when `None`.
    pub configurations: Option<usize>,
}

impl Default for AuditOptions {
    fn default() -> Self {
        AuditOptions {
            regions: 3,
            size_nm: 1.0,
            stride: None,
            seed: 1,
            at_nm: Vec::new(),
            configurations: None,
        }
    }
}

/// The two images of a region, and what they tell.
#[derive(Debug, Clone, Serialize)]
pub struct RegionAudit {
    /// Centre (x, y) in nm of the built field.
    pub centre_nm: [f64; 2],
    /// Bright columns compared.
    pub bright_columns: usize,
    /// Rms error at bright columns in per cent of their intensity; they have 40 % or more of that of the brightest column of
    /// all regions.
    pub bright_rms_percent: f64,
    /// Mean error at bright columns in per cent.
    pub bright_mean_percent: f64,
    /// Error of the mean over the region in per cent of that mean.
    pub mean_percent: f64,
    /// Rms error off bright columns (more than 1 A from any), in per cent of the brightest column.
    pub off_columns_rms_percent: f64,
    /// Rms error of all pixels in per cent of the brightest column.
    pub all_rms_percent: f64,
    /// Greatest error of any pixel in per cent of the brightest column.
    pub worst_percent: f64,
    /// The mosaic at the pixels compared, fractions of the beam.
    #[serde(skip)]
    pub ours: Array2<f64>,
    /// The exact image there.
    #[serde(skip)]
    pub exact: Array2<f64>,
}

/// Statistics of one kind of column, over all regions.
#[derive(Debug, Clone, Serialize, PartialEq)]
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

/// The result of an audit.
#[derive(Debug, Clone, Serialize)]
pub struct Audit {
    /// Engine that the world was made with.
    pub engine: String,
    /// Width of its windows.
    pub window_angstrom: Option<f64>,
    /// Engine that it was compared with.
    pub reference: String,
    /// Configurations averaged, of how many.
    pub configurations: [usize; 2],
    /// Rms over all bright columns, per cent.
    pub bright_rms_percent: f64,
    /// Rms over all pixels, per cent of the brightest column.
    pub all_rms_percent: f64,
    /// Greatest error, per cent of the brightest column.
    pub worst_percent: f64,
    /// By kind of column.
    pub kinds: Vec<KindAudit>,
    /// Power of the difference over that of the exact image, in bands of spatial frequency: limits in 1/A, and
    /// the ratio of power of mosaic to exact.
    pub power: Vec<PowerBand>,
    /// Region by region.
    pub regions: Vec<RegionAudit>,
}

/// A band of the power spectrum.
#[derive(Debug, Clone, Serialize, PartialEq)]
pub struct PowerBand {
    /// Limits in 1/Angstrom.
    pub band: [f64; 2],
    /// Power of our image over that of the exact one.
    pub ratio: f64,
}

/// Where images and atoms come from.
pub enum Source<'a> {
    /// What makes images of a field out of more than simulations of it.
    Field(&'a dyn FieldImage),
    /// An engine that simulated the field itself.
    Direct(&'a Simulator),
}

impl Source<'_> {
    fn name(&self) -> String {
        match self {
            Source::Field(field) => field.name().to_owned(),
            Source::Direct(simulator) => simulator.name(),
        }
    }

    fn window_angstrom(&self) -> Option<f64> {
        let mut parameters = match self {
            Source::Field(field) => field.parameters(),
            Source::Direct(simulator) => simulator.parameters(),
        };
        match serde_json::from_value(parameters["algorithm"].take()) {
            Ok(Algorithm::Window { width_angstrom }) => Some(width_angstrom),
            _ => None,
        }
    }
}

struct ColumnPoint {
    kind: String,
    at: [f64; 2],
    ours: f64,
    exact: f64,
}

/// Audits a world.
///
/// # Errors
/// [`Error::Invalid`] for regions outside the field, those of the engine, [`Error::Interrupted`].
pub fn audit(
    recipe: &Recipe,
    specimen: &dyn Specimen,
    source: &Source,
    options: &AuditOptions,
    progress: &dyn Progress,
) -> Result<Audit> {
    let all = recipe.phonons.configurations.max(1);
    let configurations = options.configurations.unwrap_or(all).clamp(1, all);
    let mut reference = Simulator::new(recipe, Algorithm::Multislice).with_large_probe_box();
    if specimen.film().is_some() {
        reference = reference.with_slices(Slicing::Grouped(PARTICLE_SPAN_ANGSTROM));
    }
    let pixel = 10.0 * recipe.field.pixel_nm();
    let stride = options.stride.unwrap_or((POINT_ANGSTROM / pixel).round().max(1.0) as usize);
    let places = places(recipe, specimen, options)?;
    let points: usize =
        places.iter().map(|p| points(p.shape, stride).iter().product::<usize>()).sum();
    progress.start("auditing", "probe", (points * configurations) as u64);
    let mut pairs = Vec::new();
    let mut columns = Vec::new();
    for place in &places {
        let job = Job { recipe, specimen, source, reference: &reference, place };
        let ours = job.ours(stride, configurations, progress)?;
        let exact = job.exact(stride, configurations, progress)?;
        columns.push(job.columns(&ours, &exact, pixel * stride as f64));
        pairs.push((place.centre_nm, ours, exact));
    }
    progress.finish();
    let top = columns.iter().flatten().map(|c: &ColumnPoint| c.exact).fold(1e-12, f64::max);
    let of_region = |(pair, columns): ((_, _, _), &Vec<ColumnPoint>)| {
        let (centre, ours, exact) = pair;
        compare(centre, (ours, exact), columns, pixel * stride as f64, top)
    };
    let regions = pairs.into_iter().zip(&columns).map(of_region).collect();
    Ok(summary(source, [configurations, all], regions, &columns, recipe, stride))
}

/// A region in pixels of the full field.
struct Place {
    first: [usize; 2],
    shape: [usize; 2],
    centre_nm: [f64; 2],
}

fn points(shape: [usize; 2], stride: usize) -> [usize; 2] {
    shape.map(|n| n.div_ceil(stride))
}

/// The regions: as given, or at random, but every other one on a particle where there are any.
fn places(recipe: &Recipe, specimen: &dyn Specimen, options: &AuditOptions) -> Result<Vec<Place>> {
    let field = &recipe.field;
    let (shape, pixel) = (field.pixels(field.built_grid()), field.pixel_nm());
    let edge = (options.size_nm / pixel).round() as usize;
    if options.stride == Some(0) || edge < 8 || edge > shape[0].min(shape[1]) {
        let expected = format!("must be from {:.2} to the field's height and width", 8.0 * pixel);
        return Err(Error::invalid(crate::Setting::AuditedRegionNm, options.size_nm, expected));
    }
    let origin = field.crop_origin_px();
    let place = |corner: [usize; 2]| Place {
        first: [0, 1].map(|k| origin[k] + corner[k]),
        shape: [edge; 2],
        centre_nm: [1, 0].map(|k| (corner[k] as f64 + 0.5 * (edge - 1) as f64) * pixel),
    };
    if options.at_nm.is_empty() {
        let particles = particles_in(specimen, &recipe.field.built_region());
        let corner = |n: u64| {
            let u = |k: u32| rng::uniform(options.seed, Purpose::Audit, k, n);
            if n.is_multiple_of(2) && !particles.is_empty() {
                let chosen = &particles[(u(2) * particles.len() as f64) as usize];
                return [0, 1].map(|k: usize| {
                    let off = (u(k as u32) - 0.5) * chosen.diameter_nm;
                    let centre = (chosen.centre_nm[1 - k] + off) / pixel - origin[k] as f64;
                    (centre - 0.5 * edge as f64).round().clamp(0.0, (shape[k] - edge) as f64)
                        as usize
                });
            }
            [0, 1].map(|k| (u(k) * (shape[k as usize] - edge + 1) as f64) as usize)
        };
        return Ok((0..options.regions as u64).map(|n| place(corner(n))).collect());
    }
    let given = |at: &[f64; 2]| {
        let corner = [1, 0].map(|k| (at[k] / pixel - 0.5 * edge as f64).round());
        let inside = |k: usize| corner[k] >= 0.0 && corner[k] as usize + edge <= shape[k];
        match inside(0) && inside(1) {
            true => Ok(place(corner.map(|c| c as usize))),
            false => {
                let extent = shape.map(|n| n as f64 * pixel);
                let expected = format!(
                    "the region must lie in the field of {:.2} x {:.2} nm (x, y)",
                    extent[1], extent[0]
                );
                Err(Error::invalid(crate::Setting::AuditCentreNm, format!("{at:?}"), expected))
            }
        }
    };
    options.at_nm.iter().map(given).collect()
}

struct Job<'a> {
    recipe: &'a Recipe,
    specimen: &'a dyn Specimen,
    source: &'a Source<'a>,
    reference: &'a Simulator,
    place: &'a Place,
}

impl Job<'_> {
    /// The world's image at every `stride`-th pixel.
    fn ours(
        &self,
        stride: usize,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>> {
        let Place { first, shape, .. } = *self.place;
        let thin = |image: Array2<f64>| {
            let [rows, columns] = points(shape, stride);
            Array2::from_shape_fn((rows, columns), |(i, j)| image[[i * stride, j * stride]])
        };
        match self.source {
            Source::Field(field) => {
                Ok(thin(field.mean_of(first, shape, configurations, &Quiet(progress))?))
            }
            Source::Direct(simulator) => {
                self.simulated(simulator, stride, configurations, &Quiet(progress))
            }
        }
    }

    fn exact(
        &self,
        stride: usize,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>> {
        self.simulated(self.reference, stride, configurations, progress)
    }

    fn simulated(
        &self,
        simulator: &Simulator,
        stride: usize,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>> {
        let Place { first, shape, .. } = *self.place;
        let (margin, thickness) = (simulator.margin_angstrom(), self.specimen.thickness_nm());
        let pixel = self.recipe.field.pixel_nm();
        let pixels = PixelBox::new((first, shape, stride), pixel, margin, thickness);
        let atoms = |configuration: usize| match self.source {
            Source::Field(field) => field.atoms(&pixels.area, configuration),
            Source::Direct(_) => {
                let which = (self.recipe.seed, configuration);
                super::mosaic::atoms_by_seed(self.specimen, &pixels.area, which, self.recipe)
            }
        };
        simulator.mean(&pixels, configurations, atoms, progress)
    }

    /// Intensities of the columns inside the region.
    fn columns(&self, ours: &Array2<f64>, exact: &Array2<f64>, pixel: f64) -> Vec<ColumnPoint> {
        let Place { first, shape, .. } = *self.place;
        let area = Region::of_pixels(first, shape, self.recipe.field.pixel_nm()).grown(-0.08);
        let sites = self.specimen.query(&area);
        let corner = [1, 0].map(|k| first[k] as f64 * 10.0 * self.recipe.field.pixel_nm());
        let mut found = Vec::new();
        for column in &sites.columns {
            let at = [0, 1].map(|k| 10.0 * column.position_nm[k] - corner[k]);
            let mut near = [0.0; 3];
            for ((i, j), value) in ours.indexed_iter() {
                let d = [at[0] - j as f64 * pixel, at[1] - i as f64 * pixel];
                let weight = (-(d[0] * d[0] + d[1] * d[1])
                    / (2.0 * COLUMN_ANGSTROM * COLUMN_ANGSTROM / 4.0))
                    .exp();
                near =
                    [near[0] + weight, near[1] + weight * value, near[2] + weight * exact[[i, j]]];
            }
            if near[0] > 1e-3 {
                let sites = &sites.sites[column.sites.clone()];
                let [ours, exact] = [near[1], near[2]].map(|v| v / near[0]);
                found.push(ColumnPoint { kind: kind(sites, self.recipe), at, ours, exact });
            }
        }
        found
    }
}

/// The elements that belong in a column.
fn kind(sites: &[super::SpecimenSite], recipe: &Recipe) -> String {
    let host = |number: u8| {
        let by = recipe.substitutions.as_ref().map(|s| (&s.by, &s.element));
        let alloy = recipe.alloy.as_ref().map(|a| (&a.guest, &a.host));
        let symbol = elements::symbol(number);
        let pair = by.into_iter().chain(alloy).find(|(guest, _)| *guest == symbol);
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

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (n, sum) = values.fold((0.0, 0.0), |(n, sum), v| (n + 1.0, sum + v * v));
    if n > 0.0 { f64::sqrt(sum / n) } else { 0.0 }
}

fn compare(
    centre_nm: [f64; 2],
    (ours, exact): (Array2<f64>, Array2<f64>),
    columns: &[ColumnPoint],
    pixel: f64,
    top: f64,
) -> RegionAudit {
    let bright: Vec<&ColumnPoint> = columns.iter().filter(|c| c.exact > BRIGHT * top).collect();
    let relative = |c: &&ColumnPoint| c.ours / c.exact - 1.0;
    let difference = &ours - &exact;
    let off = difference.indexed_iter().filter(|((i, j), _)| {
        let far = |c: &&ColumnPoint| {
            (c.at[0] - *j as f64 * pixel).hypot(c.at[1] - *i as f64 * pixel) > 1.0
        };
        bright.iter().all(far)
    });
    RegionAudit {
        centre_nm,
        bright_columns: bright.len(),
        bright_rms_percent: 100.0 * rms(bright.iter().map(relative)),
        bright_mean_percent: 100.0 * bright.iter().map(relative).sum::<f64>()
            / bright.len().max(1) as f64,
        mean_percent: 100.0 * (ours.sum() / exact.sum() - 1.0),
        off_columns_rms_percent: 100.0 * rms(off.map(|(_, d)| d / top)),
        all_rms_percent: 100.0 * rms(difference.iter().map(|d| d / top)),
        worst_percent: 100.0 * difference.iter().fold(0.0, |w: f64, d| w.max(d.abs())) / top,
        ours,
        exact,
    }
}

fn summary(
    source: &Source,
    configurations: [usize; 2],
    regions: Vec<RegionAudit>,
    columns: &[Vec<ColumnPoint>],
    recipe: &Recipe,
    stride: usize,
) -> Audit {
    let weighted = |of: &dyn Fn(&RegionAudit) -> (f64, f64)| {
        let (sum, n) = regions.iter().map(of).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        if n > 0.0 { (sum / n).sqrt() } else { 0.0 }
    };
    let mut kinds: BTreeMap<&str, Vec<(usize, &ColumnPoint)>> = BTreeMap::new();
    for (region, points) in columns.iter().enumerate() {
        for point in points {
            kinds.entry(&point.kind).or_default().push((region, point));
        }
    }
    let step = 10.0 * recipe.field.pixel_nm() * stride as f64;
    Audit {
        engine: source.name(),
        window_angstrom: source.window_angstrom(),
        reference: "multislice".into(),
        configurations,
        bright_rms_percent: weighted(&|r| {
            let n = r.bright_columns as f64;
            (n * r.bright_rms_percent.powi(2), n)
        }),
        all_rms_percent: weighted(&|r| {
            let n = r.ours.len() as f64;
            (n * r.all_rms_percent.powi(2), n)
        }),
        worst_percent: regions.iter().map(|r| r.worst_percent).fold(0.0, f64::max),
        kinds: kinds.iter().map(|(kind, points)| kind_audit(kind, points)).collect(),
        power: power(&regions, step),
        regions,
    }
}

fn kind_audit(kind: &str, points: &[(usize, &ColumnPoint)]) -> KindAudit {
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

/// Power of our images over the exact ones by bands of spatial frequency, under a Hann window.
fn power(regions: &[RegionAudit], step: f64) -> Vec<PowerBand> {
    let mut sums = vec![[0.0; 2]; BANDS.len() - 1];
    for region in regions {
        for (which, image) in [&region.ours, &region.exact].into_iter().enumerate() {
            let (rows, columns) = image.dim();
            let mean = image.mean().unwrap_or(0.0);
            let hann = |i: usize, n: usize| {
                (std::f64::consts::PI * (i as f64 + 0.5) / n as f64).sin().powi(2)
            };
            let windowed = Array2::from_shape_fn((rows, columns), |(i, j)| {
                Complex::from((image[[i, j]] - mean) * hann(i, rows) * hann(j, columns))
            });
            for ((i, j), value) in transformed(windowed).indexed_iter() {
                let k = |i: usize, n: usize| crate::fft::frequency(i, n) as f64 / (n as f64 * step);
                let k = k(i, rows).hypot(k(j, columns));
                if let Some(band) = BANDS.windows(2).position(|b| b[0] <= k && k < b[1]) {
                    sums[band][which] += value.norm_sqr();
                }
            }
        }
    }
    let band = |(n, [ours, exact]): (usize, &[f64; 2])| PowerBand {
        band: [BANDS[n], BANDS[n + 1]],
        ratio: if *exact > 0.0 { ours / exact } else { f64::NAN },
    };
    sums.iter().enumerate().map(band).collect()
}

fn transformed(mut image: Array2<Complex<f64>>) -> Array2<Complex<f64>> {
    let mut planner = rustfft::FftPlanner::new();
    for axis in [1, 0] {
        let fft = planner.plan_fft_forward(image.len_of(ndarray::Axis(axis)));
        for mut lane in image.lanes_mut(ndarray::Axis(axis)) {
            let mut line = lane.to_vec();
            fft.process(&mut line);
            lane.iter_mut().zip(line).for_each(|(to, from)| *to = from);
        }
    }
    image
}
