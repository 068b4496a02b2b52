//! The page of a world.

use std::ops::Range;

use ndarray::Array2;

use super::blobs::Blobs;
use super::column_list::columns;
use super::header::{PageBoundary, PageHeader, PageImage, PageParticle, Phases, Start};
use super::pyramid::{Pyramid, TILE};
use super::{Page, colormaps};
use crate::detect::Detector;
use crate::error::{Error, Result};
use crate::io::{WorldFile, WorldMetadata};
use crate::lengths;
use crate::render::Colormap;
use crate::setting::Setting;

/// What a world's page shows at first.
#[derive(Debug, Clone)]
pub(crate) struct WorldPage {
    /// Name of the world.
    pub title: String,
    /// Colours.
    pub colormap: Colormap,
    /// Percentiles that become the first and the last colour.
    pub contrast: [f64; 2],
    /// Overlays by their names: defects, phases, boundaries, particles, columns.
    pub overlays: Vec<String>,
    /// Left, upper, right and lower edge in nm; the whole field if none.
    pub region: Option<[f64; 4]>,
    /// The noiseless image.
    pub clean: bool,
}

impl WorldPage {
    /// Makes the page. Memory holds the page and a third of the image.
    ///
    /// # Errors
    /// Errors of the reader; [`Error::Invalid`] for a pixel that is no number.
    pub(crate) fn page(&self, world: &WorldFile) -> Result<Page> {
        let metadata = world.metadata();
        let [rows, columns_px] = world.shape();
        let pixel = metadata.pixel_size_nm;
        let mut blobs = Blobs::default();
        let mut images = Vec::new();
        let mut pyramids = Vec::new();
        for clean in [false, true] {
            if clean && !world.has_clean() {
                continue;
            }
            let pyramid = Pyramid::new([rows, columns_px], &|rows| read(world, rows, clean))?;
            images.push(image(metadata, clean, pyramid.exact));
            pyramids.push(pyramid);
        }
        let mut map = world.phase_map(0..rows, 0..columns_px)?.map(|m| Pyramid::of_codes(m.view()));
        place(&mut images, &mut pyramids, 1, &mut blobs);
        let truth = columns(world, &mut blobs)?;
        let phases = match &mut map {
            None => None,
            Some(map) => {
                let coarse: Vec<_> =
                    (0..map.len()).rev().map(|l| map.place(l, &mut blobs)).collect();
                Some(Phases {
                    names: world.phase_names()?,
                    levels: coarse.into_iter().rev().collect(),
                })
            }
        };
        place(&mut images, &mut pyramids, 0, &mut blobs);
        let header = PageHeader {
            title: self.title.clone(),
            unit: "nm",
            size: [columns_px, rows],
            pixel: [pixel; 2],
            origin: [0.0; 2],
            facts: facts(world)?,
            tile: TILE,
            world_tile: Some([metadata.tile_size_px, metadata.tile_size_px - metadata.overlap_px]),
            images,
            phases,
            boundaries: boundaries(world)?,
            particles: particles(world)?,
            columns: truth,
            colormaps: colormaps(),
            start: Start {
                colormap: self.colormap.name().into(),
                contrast: self.contrast,
                overlays: self.overlays.clone(),
                region: self.region,
                image: usize::from(self.clean && world.has_clean()),
            },
        };
        Page::new(&header, &blobs)
    }
}

/// Gives the levels `from` and coarser that have none yet a place, the coarsest first.
pub(super) fn place(
    images: &mut [PageImage],
    pyramids: &mut [Pyramid],
    from: usize,
    blobs: &mut Blobs,
) {
    for (image, pyramid) in images.iter_mut().zip(pyramids) {
        // Those already placed are the coarsest.
        for level in (from..pyramid.len() - image.levels.len()).rev() {
            let level = pyramid.place(level, blobs);
            image.levels.insert(0, level);
        }
    }
}

fn read(world: &WorldFile, rows: Range<usize>, clean: bool) -> Result<Array2<f32>> {
    let [_, width] = world.shape();
    let first = rows.start;
    let image = match clean {
        true => world.stitched_clean(rows, 0..width)?,
        false => world.stitched(rows, 0..width)?,
    };
    world.check_finite(&image, [first, 0], clean)?;
    Ok(image)
}

fn image(metadata: &WorldMetadata, clean: bool, exact: bool) -> PageImage {
    let dose = metadata.dose_electrons_per_angstrom2.filter(|_| metadata.noise != Some(false));
    let noisy = dose.is_some();
    let scaling = metadata.scaling.filter(|_| !clean);
    let fraction = Detector::FRACTION_OF_BEAM;
    let [scale, offset] = scaling.unwrap_or([1.0, 0.0]);
    PageImage {
        name: match (clean, noisy) {
            (true, _) => "noise-free".into(),
            (false, true) => "with noise".into(),
            (false, false) => "image".into(),
        },
        thickness: None,
        number: None,
        quantity: if clean || scaling.is_some() { fraction } else { "normalised intensity" }.into(),
        scale,
        offset,
        stored: scaling.map(|_| "normalised intensity"),
        electrons: dose.map(|d| d * lengths::square_angstrom2(metadata.pixel_size_nm)),
        exact,
        levels: Vec::new(),
    }
}

fn boundaries(world: &WorldFile) -> Result<Vec<PageBoundary>> {
    let lines = world.boundary_lines()?;
    Ok(lines.into_iter().map(|l| PageBoundary { text: l.text, points: l.points_nm }).collect())
}

fn particles(world: &WorldFile) -> Result<Vec<PageParticle>> {
    let p = world.particles()?;
    let count = p.centres.len();
    if p.diameters.len() != count || p.morphologies.len() != count {
        let expected = "has lists of particles of unequal length";
        return Err(Error::invalid(Setting::WorldFile, world.path().display(), expected));
    }
    let particle = |i: usize| {
        let [x, y, _] = p.centres[i];
        let text = format!("{}, {:.2} nm", p.morphologies[i].as_str(), p.diameters[i]);
        PageParticle { centre: [x, y], diameter: p.diameters[i], text }
    };
    Ok((0..count).map(particle).collect())
}

fn facts(world: &WorldFile) -> Result<Vec<(String, String)>> {
    let m = world.metadata();
    let [rows, columns] = world.shape();
    let [height, width] = [rows, columns].map(|n| n as f64 * m.pixel_size_nm);
    let mut facts = Vec::new();
    let mut add = |name: &str, value: Option<String>| {
        facts.extend(value.map(|value| (name.to_owned(), value)));
    };
    add("material", m.material.clone());
    add("source", m.source.clone());
    add("field", Some(format!("{width:.2} \u{d7} {height:.2} nm")));
    add("pixels", Some(format!("{columns} \u{d7} {rows} of {:.5} nm", m.pixel_size_nm)));
    let [r, c] = m.grid_shape;
    add("tiles", Some(format!("{r} \u{d7} {c} of {} px", m.tile_size_px)));
    add("thickness", m.thickness_nm.map(|t| format!("{t:.2} nm")));
    add("lattice sites", Some(world.site_count()?.to_string()));
    let dose = m.dose_electrons_per_angstrom2.filter(|_| m.noise != Some(false));
    add("dose", dose.map(|d| format!("{d} electrons/\u{c5}\u{b2}")));
    add("engine", m.engine.clone());
    add("seed", m.seed.map(|s| s.to_string()));
    add("stemgen", m.version.clone());
    Ok(facts)
}
