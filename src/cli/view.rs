//! `stemgen view`.

use super::hints::hinted;
use super::{output, pictures, text, values};
use anyhow::anyhow;
use clap::{Args, ValueEnum};
use ndarray::Array2;
use std::ops::Range;
use std::path::{Path, PathBuf};
use stemgen::io::{ParticleBatch, WorldFile};
use stemgen::render::html::WorldPage;
use stemgen::render::{Colormap, Contrast, Picture, RgbImage, Scene, Swatch, palette};

const EXAMPLES: &str = "\
Examples:
  The whole field:
    stemgen view worlds/srtio3_easy_1x1.h5
  A part of it, 2 nm wide, with every defect:
    stemgen view worlds/srtio3_easy_1x1.h5 --region 0.2,0.2,2.2,2.2 --overlay defects
  Phases and their boundaries over the noiseless image:
    stemgen view worlds/batio3_hard_4x4.h5 --clean --overlay phases --colormap inferno -o b.png
  A page for the browser that zooms to single atoms and shows what the truth says of each:
    stemgen view worlds/srtio3_easy_1x1.h5 --html

The page is one file that needs no network: overlays, values and columns under the pointer, line profiles.
x grows to the right and y down, from the centre of pixel (0, 0), as in the world's ground truth.";

/// Longest side of a picture in pixels.
const SIDES: std::ops::RangeInclusive<i64> = 64..=16_384;
/// Rows that are read at a time.
const ROWS_AT_ONCE: usize = 512;
/// How much of the image a tint hides.
const WASH: f64 = 0.3;
const CYAN: [u8; 3] = [86, 220, 233];
const YELLOW: [u8; 3] = [240, 228, 66];

/// Draw a world, or a part of it, as PNG, or make a page to look at it in a browser
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct View {
    /// World file
    #[arg(value_name = "WORLD")]
    world: PathBuf,
    /// Write a page (HTML) that works offline; the options below then say what it shows first
    #[arg(long)]
    html: bool,
    /// Only this part, in nm: left, upper, right and lower edge
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = values::rectangle)]
    #[arg(allow_hyphen_values = true)]
    region: Option<[f64; 4]>,
    /// The noiseless image, of a world built with --keep-clean
    #[arg(long)]
    clean: bool,
    /// Colours
    #[arg(long, value_name = "NAME", default_value = "gray")]
    colormap: Map,
    /// Percentiles of the image that become the first and the last colour
    #[arg(long, value_name = "LOW,HIGH", default_value = "0.1,99.9")]
    #[arg(value_parser = values::percentiles)]
    contrast: Values,
    /// What is drawn over the image (comma between several)
    #[arg(long, value_name = "WHAT", value_delimiter = ',')]
    overlay: Vec<Overlay>,
    /// Longest side of the picture in pixels, without the legend
    #[arg(long, value_name = "PIXELS", default_value_t = 1600, conflicts_with = "html")]
    #[arg(value_parser = clap::value_parser!(u32).range(SIDES))]
    size: u32,
    /// File to write [default: WORLD with the ending .view.png, or .html]
    #[arg(short, long, value_name = "FILE", help_heading = "Results")]
    output: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    /// Print nothing but errors
    #[arg(short, long, help_heading = "Running")]
    quiet: bool,
}

/// Two numbers of one option.
type Values = [f64; 2];

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Map {
    Gray,
    Viridis,
    Inferno,
    Magma,
}

impl From<Map> for Colormap {
    fn from(map: Map) -> Self {
        match map {
            Map::Gray => Colormap::Gray,
            Map::Viridis => Colormap::Viridis,
            Map::Inferno => Colormap::Inferno,
            Map::Magma => Colormap::Magma,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Overlay {
    /// Columns with vacant or substituted sites: rings, or a tint where columns are too small
    Defects,
    /// Phases, and the boundaries of phases and grains
    Phases,
    /// Particles
    Particles,
    /// All atomic columns
    Columns,
}

impl View {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let world = WorldFile::open(&self.world)?;
        let ending = if self.html { "html" } else { "view.png" };
        let path = self.output.clone().unwrap_or_else(|| self.world.with_extension(ending));
        output::check(&path, self.overwrite)?;
        let part = self.part(&world)?;
        if self.html {
            return self.write_page(&world, &path);
        }
        let picture = part.picture(&self, &world)?;
        picture.write_png(&path)?;
        let [h, w] = [&part.rows, &part.columns].map(|r| r.len() as f64 * part.pixel_nm);
        self.tell(&format!("{}: {w:.2} x {h:.2} nm", path.display()))
    }

    fn tell(&self, line: &str) -> anyhow::Result<()> {
        if self.quiet { Ok(()) } else { text::print(line) }
    }

    fn write_page(&self, world: &WorldFile, path: &Path) -> anyhow::Result<()> {
        if self.clean && !world.has_clean() {
            // The reader's own words about it.
            world.stitched_clean(0..1, 0..1)?;
        }
        if self.overlay.contains(&Overlay::Phases) {
            boundaries_or_phases(world)?;
        }
        if self.overlay.contains(&Overlay::Particles) {
            particles(world)?;
        }
        let title = self.world.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let names = |overlay: &Overlay| match overlay {
            Overlay::Defects => vec!["defects"],
            Overlay::Phases => vec!["phases", "boundaries"],
            Overlay::Particles => vec!["particles"],
            Overlay::Columns => vec!["columns"],
        };
        let page = WorldPage {
            title,
            colormap: self.colormap.into(),
            contrast: self.contrast,
            overlays: self.overlay.iter().flat_map(names).map(str::to_owned).collect(),
            region: self.region,
            clean: self.clean,
        };
        page.page(world)?.write(path)?;
        let size = text::bytes(output::size(path));
        self.tell(&format!("{} ({size}); open it in a browser", path.display()))
    }

    /// The pixels of the region.
    fn part(&self, world: &WorldFile) -> anyhow::Result<Part> {
        let [height, width] = world.shape();
        let pixel_nm = world.metadata().pixel_size_nm;
        let Some([x0, y0, x1, y1]) = self.region else {
            return Ok(Part { rows: 0..height, columns: 0..width, pixel_nm });
        };
        let range = |low: f64, high: f64, size: usize| {
            let clamp = |v: f64| v.clamp(0.0, size as f64) as usize;
            clamp((low / pixel_nm + 0.5).floor())..clamp((high / pixel_nm + 0.5).ceil())
        };
        let (rows, columns) = (range(y0, y1, height), range(x0, x1, width));
        if rows.is_empty() || columns.is_empty() {
            let [h, w] = [height, width].map(|n| n as f64 * pixel_nm);
            let fault = anyhow!("--region {x0},{y0},{x1},{y1} lies outside the world");
            let hint = format!("the field goes from 0,0 to {w:.2},{h:.2} nm");
            return Err(hinted(fault, hint));
        }
        Ok(Part { rows, columns, pixel_nm })
    }
}

/// Some pixels of a world.
struct Part {
    rows: Range<usize>,
    columns: Range<usize>,
    pixel_nm: f64,
}

impl Part {
    fn picture(&self, view: &View, world: &WorldFile) -> anyhow::Result<RgbImage> {
        let (image, pixel_nm) = self.image(view, world)?;
        let (rows, columns) = image.dim();
        let values: Vec<f32> = image.into_iter().collect();
        let mut picture = Picture::new(&values, [rows, columns])?;
        picture.max_side = rows.max(columns).max(16);
        picture.colormap = view.colormap.into();
        let [low, high] = view.contrast;
        picture.contrast = Contrast::Percentile { low, high };
        let mut scene = Scene::over(picture.render()?, 1.0 / pixel_nm);
        for overlay in [Overlay::Phases, Overlay::Columns, Overlay::Defects, Overlay::Particles] {
            if view.overlay.contains(&overlay) {
                self.draw(overlay, world, &mut scene)?;
            }
        }
        Ok(scene.render())
    }

    /// The image, averaged or enlarged to about the wanted size, and its pixel in nm.
    fn image(&self, view: &View, world: &WorldFile) -> anyhow::Result<(Array2<f32>, f64)> {
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
            return Ok((out, self.pixel_nm * n as f64));
        }
        let image = read(self.rows.clone())?;
        let factor = size as f64 / longest as f64;
        if factor < 1.5 {
            return Ok((image, self.pixel_nm));
        }
        let enlarged = |n: usize| (n as f64 * factor).round() as usize;
        let wide = pictures::interpolate(image.view(), enlarged(width));
        let large = pictures::interpolate(wide.t(), enlarged(height)).reversed_axes();
        Ok((large, self.pixel_nm / factor))
    }

    /// Position from the upper left corner of the picture; both in nm.
    fn place(&self, [x, y]: [f32; 2]) -> [f64; 2] {
        let from = |v: f32, first: usize| f64::from(v) - (first as f64 - 0.5) * self.pixel_nm;
        [from(x, self.columns.start), from(y, self.rows.start)]
    }

    fn draw(&self, overlay: Overlay, world: &WorldFile, scene: &mut Scene) -> anyhow::Result<()> {
        match overlay {
            Overlay::Defects => self.draw_defects(world, scene),
            Overlay::Columns => self.draw_columns(world, scene),
            Overlay::Phases => self.draw_phases(world, scene),
            Overlay::Particles => self.draw_particles(world, scene),
        }
    }

    fn draw_defects(&self, world: &WorldFile, scene: &mut Scene) -> anyhow::Result<()> {
        let (mut vacancies, mut substitutions) = (0, 0);
        for column in world.columns()? {
            let at = self.place(column.position_nm);
            if !self.holds(at) {
                continue;
            }
            vacancies += column.vacancies;
            substitutions += column.substitutions;
            for (n, color) in [
                (column.vacancies, palette::VACANCY),
                (column.substitutions, palette::SUBSTITUTION),
            ] {
                if n > 0 {
                    scene.mark(at, n as usize, column.sites.max(n) as usize, color);
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
        Ok(())
    }

    fn draw_columns(&self, world: &WorldFile, scene: &mut Scene) -> anyhow::Result<()> {
        if !scene.has_rings() {
            let fault = anyhow!("the atomic columns are too small to be drawn");
            return Err(hinted(fault, "choose a smaller --region, or a larger --size"));
        }
        let places = world.columns()?.into_iter().map(|c| self.place(c.position_nm));
        let inside: Vec<[f64; 2]> = places.filter(|at| self.holds(*at)).collect();
        inside.iter().for_each(|at| scene.mark(*at, 1, 1, CYAN));
        scene.legend(Swatch::Ring(CYAN), format!("{} columns", inside.len()));
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
            for code in codes {
                scene
                    .legend(Swatch::Area(color(code).unwrap_or_default()), format!("phase {code}"));
            }
        }
        for line in &lines {
            let points: Vec<[f64; 2]> = line.iter().map(|p| self.place(*p)).collect();
            scene.line(&points, YELLOW);
        }
        if !lines.is_empty() {
            scene.legend(Swatch::Line(YELLOW), "boundary");
        }
        Ok(())
    }

    fn draw_particles(&self, world: &WorldFile, scene: &mut Scene) -> anyhow::Result<()> {
        let particles = particles(world)?;
        for ([x, y, _], diameter) in particles.centres.iter().zip(&particles.diameters) {
            scene.circle(self.place([*x, *y]), 0.5 * f64::from(*diameter), YELLOW);
        }
        scene.legend(Swatch::Ring(YELLOW), "particle");
        Ok(())
    }

    fn holds(&self, [x, y]: [f64; 2]) -> bool {
        let inside = |v: f64, n: usize| (0.0..n as f64 * self.pixel_nm).contains(&v);
        inside(x, self.columns.len()) && inside(y, self.rows.len())
    }
}

/// The boundaries of a world that has some, or phases.
fn boundaries_or_phases(world: &WorldFile) -> anyhow::Result<Vec<Vec<[f32; 2]>>> {
    let lines = [world.phase_boundaries()?, world.boundaries()?].concat();
    if lines.is_empty() && world.phase_map(0..1, 0..1)?.is_none() {
        let fault = anyhow!("the world has no phases and no boundaries");
        return Err(hinted(fault, "leave out --overlay phases"));
    }
    Ok(lines)
}

/// The particles of a world that has some.
fn particles(world: &WorldFile) -> anyhow::Result<ParticleBatch> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_at_the_edge_are_averages_too() {
        let image = Array2::from_shape_fn((3, 5), |(i, j)| (5 * i + j) as f32);
        let small = averaged(&image, 2);
        assert_eq!(small, ndarray::array![[3.0, 5.0, 6.5], [10.5, 12.5, 14.0]]);
    }
}
