//! The pictures of `stemgen view`: a part of a world, and what the truth knows of it.

use super::hints::hinted;
use super::{pictures, values};
use anyhow::anyhow;
use clap::{Args, ValueEnum};
use ndarray::Array2;
use std::collections::BTreeMap;
use std::ops::Range;
use stemgen::io::{ParticleBatch, WorldColumn, WorldFile};
use stemgen::render::{Colormap, Contrast, Picture, RgbImage, Scene, Swatch, palette};

/// Rows that are read at a time.
const ROWS_AT_ONCE: usize = 512;
/// How much of the image a tint hides.
const WASH: f64 = 0.3;
const CYAN: [u8; 3] = [86, 220, 233];
const YELLOW: [u8; 3] = [240, 228, 66];

/// Longest side of a picture in pixels.
const SIDES: std::ops::RangeInclusive<i64> = 64..=16_384;

/// What a picture of a world shows, and how.
#[derive(Debug, Args)]
pub struct PictureArgs {
    /// The noiseless image: of a world built with --keep-clean, or what a recording was meant to show
    #[arg(long)]
    pub clean: bool,
    /// Colours
    #[arg(long, value_name = "NAME", default_value = "gray")]
    pub colormap: ColormapName,
    /// Percentiles of the image that become the first and the last colour
    #[arg(long, value_name = "LOW,HIGH", default_value = "0.1,99.9")]
    #[arg(value_parser = values::percentiles)]
    pub contrast: Values,
    /// What is drawn over the image (comma between several)
    #[arg(long, value_name = "WHAT", value_delimiter = ',')]
    pub overlay: Vec<Overlay>,
    /// Longest side of the picture in pixels, without the legend
    #[arg(long, value_name = "PIXELS", default_value_t = 1600, conflicts_with = "html")]
    #[arg(value_parser = clap::value_parser!(u32).range(SIDES))]
    pub size: u32,
}

/// Two numbers of one option.
pub type Values = [f64; 2];

/// Colours of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[expect(missing_docs, reason = "the help shows the names alone")]
pub enum ColormapName {
    Gray,
    Viridis,
    Inferno,
    Magma,
}

impl From<ColormapName> for Colormap {
    fn from(name: ColormapName) -> Self {
        match name {
            ColormapName::Gray => Colormap::Gray,
            ColormapName::Viridis => Colormap::Viridis,
            ColormapName::Inferno => Colormap::Inferno,
            ColormapName::Magma => Colormap::Magma,
        }
    }
}

/// What is drawn over an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Overlay {
    /// Columns with vacant or substituted sites: rings, or a tint where columns are too small
    Defects,
    /// Phases, and the boundaries of phases and grains
    Phases,
    /// The boundaries of phases and grains alone
    Boundaries,
    /// Particles
    Particles,
    /// All atomic columns
    Columns,
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
    /// The picture of these pixels.
    ///
    /// # Errors
    /// Those of the file, and overlays that the world has nothing for.
    pub fn picture(&self, view: &PictureArgs, world: &WorldFile) -> anyhow::Result<RgbImage> {
        let (image, pixel_nm, contrast) = self.image(view, world)?;
        let (rows, columns) = image.dim();
        let values: Vec<f32> = image.into_iter().collect();
        let mut picture = Picture::new(&values, [rows, columns])?;
        picture.max_side = rows.max(columns).max(16);
        picture.colormap = view.colormap.into();
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
            if view.overlay.contains(&overlay) {
                self.draw(overlay, world, &columns, &mut scene)?;
            }
        }
        Ok(scene.render())
    }

    /// The image, averaged or enlarged to about the wanted size, its pixel in nm, and its contrast.
    fn image(
        &self,
        view: &PictureArgs,
        world: &WorldFile,
    ) -> anyhow::Result<(Array2<f32>, f64, Contrast)> {
        let [low, high] = view.contrast;
        let percentiles = Contrast::Percentile { low, high };
        let (height, width, size) = (self.rows.len(), self.columns.len(), view.size as usize);
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
        let wide = pictures::interpolate(image.view(), enlarged(width));
        let large = pictures::interpolate(wide.t(), enlarged(height)).reversed_axes();
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
    fn placed_columns(&self, view: &PictureArgs, world: &WorldFile) -> anyhow::Result<Vec<Placed>> {
        if !view.overlay.iter().any(|o| matches!(o, Overlay::Columns | Overlay::Defects)) {
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
    ) -> anyhow::Result<()> {
        match overlay {
            Overlay::Defects => draw_defects(columns, scene),
            Overlay::Columns => draw_columns(columns, scene)?,
            Overlay::Phases => self.draw_phases(world, scene)?,
            Overlay::Boundaries => self.draw_lines(&boundaries(world)?, scene),
            Overlay::Particles => self.draw_particles(world, scene)?,
        }
        Ok(())
    }

    fn draw_phases(&self, world: &WorldFile, scene: &mut Scene) -> anyhow::Result<()> {
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

    fn draw_particles(&self, world: &WorldFile, scene: &mut Scene) -> anyhow::Result<()> {
        let particles = particles(world)?;
        let sizes = [self.columns.len(), self.rows.len()].map(|n| n as f64 * self.pixel_nm);
        let mut seen: BTreeMap<String, usize> = BTreeMap::new();
        for (i, ([x, y, _], diameter)) in
            particles.centres.iter().zip(&particles.diameters).enumerate()
        {
            let (at, radius) = (self.place([*x, *y]), 0.5 * f64::from(*diameter));
            let nearest = [0, 1].map(|k| at[k].clamp(0.0, sizes[k]) - at[k]);
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

fn draw_columns(columns: &[Placed], scene: &mut Scene) -> anyhow::Result<()> {
    if !scene.has_rings() {
        let fault = anyhow!("the atomic columns are too small to be drawn");
        return Err(hinted(fault, "choose a smaller --region, or a larger --size"));
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
pub fn boundaries(world: &WorldFile) -> anyhow::Result<Vec<Vec<[f32; 2]>>> {
    let lines = [world.phase_boundaries()?, world.boundaries()?].concat();
    if lines.is_empty() {
        let fault = anyhow!("the world has no boundaries");
        return Err(hinted(fault, "leave out --overlay boundaries"));
    }
    Ok(lines)
}

/// The boundaries of a world that has some, or phases.
pub fn boundaries_or_phases(world: &WorldFile) -> anyhow::Result<Vec<Vec<[f32; 2]>>> {
    let lines = [world.phase_boundaries()?, world.boundaries()?].concat();
    if lines.is_empty() && world.phase_map(0..1, 0..1)?.is_none() {
        let fault = anyhow!("the world has no phases and no boundaries");
        return Err(hinted(fault, "leave out --overlay phases"));
    }
    Ok(lines)
}

/// The particles of a world that has some.
pub fn particles(world: &WorldFile) -> anyhow::Result<ParticleBatch> {
    let particles = world.particles()?;
    if particles.centres.is_empty() {
        let fault = anyhow!("the world has no particles");
        return Err(hinted(fault, "leave out --overlay particles"));
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
