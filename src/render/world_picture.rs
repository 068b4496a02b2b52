//! Pictures of worlds: a part of the image, and what the truth knows of it.

use std::collections::BTreeMap;
use std::ops::Range;

use ndarray::Array2;

use super::html::{Page, WorldPage};
use super::image_pictures::interpolate;
use super::{Colormap, Contrast, Picture, RgbImage, Scene, Swatch, palette};
use crate::error::{Error, Result};
use crate::io::{ParticleBatch, WorldColumn, WorldFile};
use crate::plane;
use crate::setting::Setting;

/// Rows that are read at a time.
const ROWS_AT_ONCE: usize = 512;
/// How much of the image a tint hides.
const WASH: f64 = 0.3;
const CYAN: [u8; 3] = [86, 220, 233];
const YELLOW: [u8; 3] = [240, 228, 66];

/// Longest side of a picture in pixels.
const SIDES: std::ops::RangeInclusive<u32> = 64..=16_384;

/// What a picture of a world shows, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldPicture {
    /// The noiseless image.
    pub clean: bool,
    /// Colours.
    pub colormap: Colormap,
    /// Percentiles of the image that become the first and the last colour.
    pub contrast_percentiles: [f64; 2],
    /// What is drawn over the image.
    pub overlays: Vec<Overlay>,
    /// Longest side of the picture in pixels, without the legend.
    pub longest_side_px: u32,
}

impl Default for WorldPicture {
    fn default() -> Self {
        WorldPicture {
            clean: false,
            colormap: Colormap::Gray,
            contrast_percentiles: [0.1, 99.9],
            overlays: Vec::new(),
            longest_side_px: 1600,
        }
    }
}

/// What is drawn over an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Overlay {
    /// Columns with vacant or substituted sites: rings, or a tint where columns are too small.
    Defects,
    /// Phases, and the boundaries of phases and grains.
    Phases,
    /// The boundaries of phases and grains alone.
    Boundaries,
    /// Particles.
    Particles,
    /// All atomic columns.
    Columns,
}

impl Overlay {
    /// Names of the overlays that it draws: its own, and of overlays that belong to it.
    fn names(self) -> &'static [&'static str] {
        match self {
            Overlay::Defects => &["defects"],
            Overlay::Phases => &["phases", "boundaries"],
            Overlay::Boundaries => &["boundaries"],
            Overlay::Particles => &["particles"],
            Overlay::Columns => &["columns"],
        }
    }
}

impl WorldPicture {
    /// The page (HTML) of a world that shows this first, at a region x0, y0, x1, y1 in nm.
    ///
    /// # Errors
    /// Errors of the file; [`Error::Invalid`] for an overlay of which the world has nothing.
    pub fn page(&self, world: &WorldFile, title: String, region: Option<[f64; 4]>) -> Result<Page> {
        self.check()?;
        if self.clean && !world.has_clean() {
            // The reader's own words about it.
            world.stitched_clean(0..1, 0..1)?;
        }
        for overlay in &self.overlays {
            match overlay {
                Overlay::Phases => drop(boundaries_or_phases(world)?),
                Overlay::Boundaries => drop(boundaries(world)?),
                Overlay::Particles => drop(particles(world)?),
                Overlay::Columns | Overlay::Defects => {}
            }
        }
        let names = self.overlays.iter().flat_map(|overlay| overlay.names());
        let page = WorldPage {
            title,
            colormap: self.colormap,
            contrast: self.contrast_percentiles,
            overlays: names.map(|name| (*name).to_owned()).collect(),
            region,
            clean: self.clean,
        };
        page.page(world)
    }

    fn check(&self) -> Result<()> {
        let [low, high] = self.contrast_percentiles;
        if !(0.0 <= low && low < high && high <= 100.0) {
            let expected = "two percentages that rise, from 0 to 100";
            let value = format!("{low}, {high}");
            return Err(Error::invalid(Setting::ContrastPercentiles, value, expected));
        }
        if !SIDES.contains(&self.longest_side_px) {
            let expected = "expected 64 to 16384";
            return Err(Error::invalid(Setting::LongestSidePixels, self.longest_side_px, expected));
        }
        Ok(())
    }
}

/// A file that has nothing for an overlay.
fn none(overlay: &str, why: &str) -> Error {
    Error::invalid(Setting::Overlay, overlay, why)
}

/// A column and its position from the upper left corner of the picture in nm.
type Placed = ([f64; 2], WorldColumn);

/// Some pixels of a world.
pub struct WorldPart {
    /// Rows.
    pub rows: Range<usize>,
    /// Columns.
    pub columns: Range<usize>,
    /// Edge of a pixel in nm.
    pub pixel_nm: f64,
}

impl WorldPart {
    /// The pixels of a region x0, y0, x1, y1 in nm; all of them where there is none.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a region outside the world.
    pub fn of_region(world: &WorldFile, region_nm: Option<[f64; 4]>) -> Result<Self> {
        let [height, width] = world.shape();
        let pixel_nm = world.metadata().pixel_size_nm;
        let Some([x0, y0, x1, y1]) = region_nm else {
            return Ok(WorldPart { rows: 0..height, columns: 0..width, pixel_nm });
        };
        let range = |low: f64, high: f64, size: usize| {
            let clamp = |v: f64| v.clamp(0.0, size as f64) as usize;
            clamp((low / pixel_nm + 0.5).floor())..clamp((high / pixel_nm + 0.5).ceil())
        };
        let (rows, columns) = (range(y0, y1, height), range(x0, x1, width));
        if rows.is_empty() || columns.is_empty() {
            let [h, w] = [height, width].map(|n| n as f64 * pixel_nm);
            let expected =
                format!("lies outside the world; the field goes from 0,0 to {w:.2},{h:.2} nm");
            return Err(Error::invalid(Setting::Region, format!("{x0},{y0},{x1},{y1}"), expected));
        }
        Ok(WorldPart { rows, columns, pixel_nm })
    }

    /// The picture of these pixels.
    ///
    /// # Errors
    /// Errors of the file; [`Error::Invalid`] for an overlay of which the world has nothing.
    pub fn picture(&self, view: &WorldPicture, world: &WorldFile) -> Result<RgbImage> {
        view.check()?;
        let (image, pixel_nm, contrast) = self.image(view, world)?;
        let (rows, columns) = image.dim();
        let values: Vec<f32> = image.into_iter().collect();
        let mut picture = Picture::new(&values, [rows, columns])?;
        picture.max_side = rows.max(columns).max(16);
        picture.colormap = view.colormap;
        picture.contrast = contrast;
        let mut scene = Scene::over(picture.render()?, 1.0 / pixel_nm);
        let columns = self.placed_columns(view, world)?;
        scene.fit_rings(columns.len() as f64 / self.area_nm2());
        let order = [
            Overlay::Phases,
            Overlay::Boundaries,
            Overlay::Columns,
            Overlay::Defects,
            Overlay::Particles,
        ];
        for overlay in order {
            if view.overlays.contains(&overlay) {
                self.draw(overlay, world, &columns, &mut scene)?;
            }
        }
        Ok(scene.render())
    }

    /// The image, averaged or enlarged to about the wanted size, its pixel in nm, and its contrast.
    fn image(
        &self,
        view: &WorldPicture,
        world: &WorldFile,
    ) -> Result<(Array2<f32>, f64, Contrast)> {
        let [low, high] = view.contrast_percentiles;
        let percentiles = Contrast::Percentile { low, high };
        let (height, width, size) =
            (self.rows.len(), self.columns.len(), view.longest_side_px as usize);
        let longest = height.max(width);
        let n = longest.div_ceil(size);
        let columns = self.columns.clone();
        let read = |rows: Range<usize>| {
            let first = [rows.start, columns.start];
            let image = match view.clean {
                true => world.stitched_clean(rows, columns.clone())?,
                false => world.stitched(rows, columns.clone())?,
            };
            world.check_finite(&image, first, view.clean).map(|()| image)
        };
        if n > 1 {
            let mut out = Array2::zeros((height.div_ceil(n), width.div_ceil(n)));
            let step = (ROWS_AT_ONCE / n).max(1) * n;
            for first in self.rows.clone().step_by(step) {
                let strip = read(first..self.rows.end.min(first + step))?;
                let start = (first - self.rows.start) / n;
                for ((i, j), sum) in averaged(&strip, n).indexed_iter() {
                    out[(start + i, j)] = *sum;
                }
            }
            return Ok((out, self.pixel_nm * n as f64, percentiles));
        }
        let image = read(self.rows.clone())?;
        let factor = size as f64 / longest as f64;
        if factor < 1.5 {
            return Ok((image, self.pixel_nm, percentiles));
        }
        // Interpolation overshoots; contrast is that of the pixels.
        let values: Vec<f32> = image.iter().copied().collect();
        let mut pixels = Picture::new(&values, image.dim().into())?;
        pixels.contrast = percentiles;
        let contrast = match pixels.limits()? {
            [min, max] if min < max => Contrast::Range { min, max },
            _ => percentiles,
        };
        let enlarged = |n: usize| (n as f64 * factor).round() as usize;
        let wide = interpolate(image.view(), enlarged(width));
        let large = interpolate(wide.t(), enlarged(height)).reversed_axes();
        Ok((large, self.pixel_nm / factor, contrast))
    }

    /// Position from the upper left corner of the picture; both in nm.
    fn place(&self, [x, y]: [f32; 2]) -> [f64; 2] {
        let from = |v: f32, first: usize| f64::from(v) - (first as f64 - 0.5) * self.pixel_nm;
        [from(x, self.columns.start), from(y, self.rows.start)]
    }

    fn area_nm2(&self) -> f64 {
        (self.rows.len() * self.columns.len()) as f64 * self.pixel_nm.powi(2)
    }

    /// The columns in the picture, if they are to be drawn.
    fn placed_columns(&self, view: &WorldPicture, world: &WorldFile) -> Result<Vec<Placed>> {
        if !view.overlays.iter().any(|o| matches!(o, Overlay::Columns | Overlay::Defects)) {
            return Ok(Vec::new());
        }
        let placed = world.columns()?.into_iter().map(|c| (self.place(c.position_nm), c));
        Ok(placed.filter(|(at, _)| self.holds(*at)).collect())
    }

    fn draw(
        &self,
        overlay: Overlay,
        world: &WorldFile,
        columns: &[Placed],
        scene: &mut Scene,
    ) -> Result<()> {
        match overlay {
            Overlay::Defects => draw_defects(columns, scene),
            Overlay::Columns => draw_columns(columns, scene)?,
            Overlay::Phases => self.draw_phases(world, scene)?,
            Overlay::Boundaries => self.draw_lines(&boundaries(world)?, scene),
            Overlay::Particles => self.draw_particles(world, scene)?,
        }
        Ok(())
    }

    fn draw_phases(&self, world: &WorldFile, scene: &mut Scene) -> Result<()> {
        let lines = boundaries_or_phases(world)?;
        let map = world.phase_map(self.rows.clone(), self.columns.clone())?;
        if let Some(map) = map {
            let (rows, columns) = map.dim();
            let code = |[x, y]: [f64; 2]| {
                let index = |v: f64, n: usize| ((v / self.pixel_nm) as usize).min(n - 1);
                map[(index(y, rows), index(x, columns))]
            };
            let color = |code: i32| {
                let known = usize::try_from(code).ok().filter(|code| *code > 0);
                known.map(|code| palette::ELEMENTS[(code - 1) % palette::ELEMENTS.len()])
            };
            scene.wash(|at| color(code(at)), WASH);
            let mut codes: Vec<i32> = map.iter().copied().filter(|c| *c > 0).collect();
            codes.sort_unstable();
            codes.dedup();
            let names = world.phase_names()?;
            for code in codes {
                let name = phase_name(&names, code);
                let shown = over_grey(color(code).unwrap_or_default());
                scene.legend(Swatch::Area(shown), name);
            }
        }
        self.draw_lines(&lines, scene);
        Ok(())
    }

    fn draw_lines(&self, lines: &[Vec<[f32; 2]>], scene: &mut Scene) {
        for line in lines {
            let points: Vec<[f64; 2]> = line.iter().map(|p| self.place(*p)).collect();
            scene.line(&points, YELLOW);
        }
        if !lines.is_empty() {
            scene.legend(Swatch::Line(YELLOW), "boundary");
        }
    }

    fn draw_particles(&self, world: &WorldFile, scene: &mut Scene) -> Result<()> {
        let particles = particles(world)?;
        let sizes = [self.columns.len(), self.rows.len()].map(|n| n as f64 * self.pixel_nm);
        let mut seen: BTreeMap<String, usize> = BTreeMap::new();
        for (i, ([x, y, _], diameter)) in
            particles.centres.iter().zip(&particles.diameters).enumerate()
        {
            let (at, radius) = (self.place([*x, *y]), 0.5 * f64::from(*diameter));
            let nearest = plane::per_axis(at, sizes, |at, size| at.clamp(0.0, size) - at);
            if nearest[0].hypot(nearest[1]) > radius {
                continue;
            }
            scene.circle(at, radius, YELLOW);
            let kind = particles.morphologies.get(i).map_or("particle", |m| m.as_str());
            *seen.entry(kind.to_owned()).or_default() += 1;
        }
        if seen.is_empty() {
            scene.legend(Swatch::Ring(YELLOW), "no particle here");
        }
        for (kind, count) in seen {
            scene.legend(Swatch::Ring(YELLOW), format!("{count} {kind}"));
        }
        Ok(())
    }

    fn holds(&self, [x, y]: [f64; 2]) -> bool {
        let inside = |v: f64, n: usize| (0.0..n as f64 * self.pixel_nm).contains(&v);
        inside(x, self.columns.len()) && inside(y, self.rows.len())
    }
}

fn draw_defects(columns: &[Placed], scene: &mut Scene) {
    let (mut vacancies, mut substitutions) = (0, 0);
    for (at, column) in columns {
        vacancies += column.vacancies;
        substitutions += column.substitutions;
        for (n, color) in
            [(column.vacancies, palette::VACANCY), (column.substitutions, palette::SUBSTITUTION)]
        {
            if n > 0 {
                scene.mark(*at, n as usize, column.sites.max(n) as usize, color);
            }
        }
    }
    let swatch = if scene.has_rings() { Swatch::Ring } else { Swatch::Area };
    for (n, name, color) in [
        (vacancies, "vacancies", palette::VACANCY),
        (substitutions, "substitutions", palette::SUBSTITUTION),
    ] {
        if n > 0 {
            scene.legend(swatch(color), format!("{n} {name}"));
        }
    }
}

fn draw_columns(columns: &[Placed], scene: &mut Scene) -> Result<()> {
    if !scene.has_rings() {
        let why = "the atomic columns are too small to be drawn; choose a smaller region, or a larger picture";
        return Err(none("columns", why));
    }
    columns.iter().for_each(|(at, _)| scene.mark(*at, 1, 1, CYAN));
    scene.legend(Swatch::Ring(CYAN), format!("{} columns", columns.len()));
    Ok(())
}

/// A colour as the wash shows it, over a middle grey.
fn over_grey(color: [u8; 3]) -> [u8; 3] {
    color.map(|v| (WASH * f64::from(v) + (1.0 - WASH) * 128.0).round() as u8)
}

/// The boundaries of a world that has some.
///
/// # Errors
/// Errors of the file; [`Error::Invalid`] for a world that has none.
fn boundaries(world: &WorldFile) -> Result<Vec<Vec<[f32; 2]>>> {
    let lines = all_lines(world)?;
    if lines.is_empty() {
        return Err(none("boundaries", "the world has no boundaries; leave it out"));
    }
    Ok(lines)
}

/// The lines between phases and grains, and of planar faults.
fn all_lines(world: &WorldFile) -> Result<Vec<Vec<[f32; 2]>>> {
    Ok([world.phase_boundaries()?, world.boundaries()?, world.fault_lines()?].concat())
}

/// The boundaries of a world that has some, or phases.
///
/// # Errors
/// Errors of the file; [`Error::Invalid`] for a world that has none.
fn boundaries_or_phases(world: &WorldFile) -> Result<Vec<Vec<[f32; 2]>>> {
    let lines = all_lines(world)?;
    if lines.is_empty() && world.phase_map(0..1, 0..1)?.is_none() {
        return Err(none("phases", "the world has no phases and no boundaries; leave it out"));
    }
    Ok(lines)
}

/// The particles of a world that has some.
///
/// # Errors
/// Errors of the file; [`Error::Invalid`] for a world that has none.
fn particles(world: &WorldFile) -> Result<ParticleBatch> {
    let particles = world.particles()?;
    if particles.centres.is_empty() {
        return Err(none("particles", "the world has no particles; leave it out"));
    }
    Ok(particles)
}

/// Means of blocks of `n` by `n` pixels; those at the lower and right edge may be smaller.
fn averaged(image: &Array2<f32>, n: usize) -> Array2<f32> {
    let (rows, columns) = image.dim();
    Array2::from_shape_fn((rows.div_ceil(n), columns.div_ceil(n)), |(i, j)| {
        let (i, j) = (i * n, j * n);
        let block = image.slice(ndarray::s![i..rows.min(i + n), j..columns.min(j + n)]);
        block.mean().unwrap_or(0.0)
    })
}

/// The name that the file gives to the phase of a code, if it gives one.
fn phase_name(names: &[String], code: i32) -> String {
    let known = usize::try_from(code).ok().and_then(|code| names.get(code));
    known.filter(|name| !name.is_empty()).cloned().unwrap_or_else(|| format!("phase {code}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_legend_shows_colours_as_the_picture_does() {
        // three tenths of the colour, the rest grey
        assert_eq!(over_grey([0, 114, 178]), [90, 124, 143]);
    }

    #[test]
    fn blocks_at_the_edge_are_averages_too() {
        let image = Array2::from_shape_fn((3, 5), |(i, j)| (5 * i + j) as f32);
        let small = averaged(&image, 2);
        assert_eq!(small, ndarray::array![[3.0, 5.0, 6.5], [10.5, 12.5, 14.0]]);
    }

    #[test]
    fn phases_have_the_names_of_the_file() {
        let names = ["matrix".to_owned(), "well".to_owned(), String::new()];
        assert_eq!(phase_name(&names, 1), "well");
        assert_eq!(phase_name(&names, 2), "phase 2");
        assert_eq!(phase_name(&[], 1), "phase 1");
    }
}
