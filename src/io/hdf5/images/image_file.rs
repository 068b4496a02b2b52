//! Writes files of simulated images. This is the only place where their schema is defined.
//!
//! - `/` attributes: `format` ("stemgen images"), `format_version`, `stemgen_version`, `command_line`, `request` (JSON),
//!   `structure_sha256` (of the structure file), `settings` (JSON), `structure_file`, `wavelength_angstrom`, `band_limit_mrad`,
//!   `accuracy` (JSON: requested and achieved) if one was requested; `source_fwhm_angstrom` and `source_lorentz_share` if the source is
//!   no point;
//! - `/images/NAME`: float32, always (thickness, y, x), with `units`, `axes`, `sampling_angstrom` and `origin_angstrom` as (y, x),
//!   `thicknesses_angstrom`, and `inner_mrad`, `outer_mrad` of a detector, `defocus_angstrom` of a series; `NAME_noisy`: counts divided by
//!   the image's `electrons_per_pixel`;
//! - `/counts/NAME`: uint32, the electrons counted, with the same attributes and `electrons_per_pixel`, `seed`;
//! - `/entry` (NXentry) holds the images again as NXdata, which NeXus readers open with its axes. All images of a detector are one stack
//!   `/entry/NAME/data` (defocus, thickness, y, x), without the axes that have one value; counts are at `/entry/NAME_counts`. `data` is a
//!   link to the images above, or a virtual dataset of them: no value is stored twice. The attributes `default` lead to the first stack;
//! - `/exit_wave` of a plane wave: complex64, (configuration, y, x), with `sampling_angstrom`;
//! - `/specimen`: `cell` (rows are vectors) and `positions` in Angstrom, `numbers`,
//!   `sigma_angstrom`, and `u_square_angstrom` (atom, 3, 3) of anisotropic displacements; mean positions of the atoms that were simulated. The attribute `strain_percent` is the largest principal strain
//!   that made the box orthogonal, if there was any.

use std::path::Path;

use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, File, Group, Hyperslab, Selection, SliceOrIndex};
use ndarray::{ArrayView1, ArrayView2, ArrayView3};
use num_complex::Complex32;

use super::image_series::ImageSeries;
use crate::engine::{Site, Source};
use crate::error::{Error, Result};
use crate::files::{atomic_write, file_digest};
use crate::io::hdf5::At;
use crate::io::hdf5::hdf5_create::{self, number, text};
use crate::setting::Setting;
use crate::simulation::SimulationJob;

/// Version of this schema.
const FORMAT_VERSION: i64 = 1;
const DEFLATE: u8 = 1;
/// Axes of images.
const AXES: [&str; 3] = ["thickness", "y", "x"];
/// The file itself, in virtual datasets.
const THIS_FILE: &str = ".";

/// Origin of the images: command, settings and atoms.
#[derive(Debug, Clone)]
pub struct Origin<'a> {
    /// The command as typed.
    pub command_line: String,
    /// The request as JSON.
    pub request: Option<String>,
    /// SHA-256 of the structure file.
    pub structure_sha256: Option<String>,
    /// Settings as JSON.
    pub settings: String,
    /// Name of the file of the structure.
    pub structure_file: String,
    /// Electron wavelength in Angstrom.
    pub wavelength_angstrom: f64,
    /// Largest angle carried, in mrad.
    pub band_limit_mrad: f64,
    /// The electron source; `None` for a point.
    pub source: Option<Source>,
    /// Requested and achieved accuracy, as JSON.
    pub accuracy: Option<String>,
    /// Edges of the box in Angstrom.
    pub box_angstrom: [f64; 3],
    /// Largest principal strain in per cent that made the box orthogonal, if any did.
    pub strain_percent: Option<f64>,
    /// The atoms.
    pub sites: &'a [Site],
}

impl<'a> Origin<'a> {
    /// Collects the origin of a simulation's results, without an accuracy.
    ///
    /// # Errors
    /// [`Error::Io`] for the structure file, whose digest is taken.
    pub fn of_simulation(job: &'a SimulationJob, command_line: &str) -> Result<Self> {
        let (plan, specimen, request) = (&job.plans()[0], job.specimen(), job.request());
        let file = request.structure.file();
        let digest = file.map(file_digest::sha256_of_file).transpose()?;
        let json = |text: serde_json::Result<String>| {
            text.map_err(|e| Error::invalid(Setting::Output, "request", e.to_string()))
        };
        let name = |file: &'a Path| file.file_name().map_or(file, Path::new).display().to_string();
        Ok(Origin {
            command_line: command_line.to_owned(),
            request: Some(json(serde_json::to_string(request))?),
            structure_sha256: digest.map(|(digest, _)| digest),
            settings: json(serde_json::to_string(&plan.settings))?,
            structure_file: file.map(name).unwrap_or_default(),
            wavelength_angstrom: plan.settings.optics.wavelength_angstrom(),
            band_limit_mrad: plan.band_limit_mrad,
            source: request.microscope.source(),
            accuracy: None,
            box_angstrom: specimen.size_angstrom,
            strain_percent: specimen.strain_percent,
            sites: &specimen.sites,
        })
    }
}

/// The images of one detector, one for each thickness.
#[derive(Debug, Clone)]
pub struct ImageStack<'a> {
    /// Name of the dataset.
    pub name: &'a str,
    /// Values: [thickness, y, x].
    pub data: ArrayView3<'a, f32>,
    /// Unit of the values, which are fractions.
    pub units: &'a str,
    /// Pixel (x, y) in Angstrom.
    pub step_angstrom: [f64; 2],
    /// Position (x, y) of the first pixel in Angstrom.
    pub origin_angstrom: [f64; 2],
    /// Thicknesses in Angstrom.
    pub thicknesses_angstrom: &'a [f64],
    /// Defocus in Angstrom, for an image of a series.
    pub defocus_angstrom: Option<f64>,
    /// Inner and outer angle of the detector in mrad.
    pub annulus_mrad: Option<[f64; 2]>,
    /// Azimuths in degrees of a sector of the annulus.
    pub sector_degrees: Option<[f64; 2]>,
    /// Electrons that fell on a pixel, for an image with noise.
    pub electrons_per_pixel: Option<f64>,
}

/// The electrons counted for an image.
#[derive(Debug, Clone)]
pub struct ImageCounts<'a> {
    /// The image from which the electrons are drawn.
    pub stack: &'a ImageStack<'a>,
    /// Counts: [thickness, y, x].
    pub data: ArrayView3<'a, u32>,
    /// Electrons that fell on a pixel.
    pub electrons_per_pixel: f64,
    /// Seed of the noise.
    pub seed: u64,
}

/// Exit waves of a plane wave.
#[derive(Debug, Clone, Copy)]
pub struct ExitWaves<'a> {
    /// Waves: [configuration, y, x].
    pub data: ArrayView3<'a, Complex32>,
    /// Pixel (x, y) in Angstrom.
    pub step_angstrom: [f64; 2],
}

/// Writes a file of images. It appears complete or not at all; an existing file is replaced only if `overwrite` is set.
///
/// # Errors
/// [`crate::Error::Io`], [`crate::Error::Hdf5`].
pub fn write_images(
    path: &Path,
    overwrite: bool,
    origin: &Origin,
    images: &[ImageStack],
    counts: &[ImageCounts],
    exit_waves: Option<ExitWaves>,
) -> Result<()> {
    atomic_write::write_with(path, overwrite, |temporary| {
        let write = || -> hdf5::Result<()> {
            let file = hdf5_create::file(temporary)?;
            write_origin(&file, "stemgen images", FORMAT_VERSION, origin)?;
            if !origin.sites.is_empty() {
                write_specimen(&hdf5_create::group(&file, "specimen")?, origin)?;
            }
            let group = hdf5_create::group(&file, "images")?;
            images.iter().try_for_each(|stack| write_stack(&group, stack))?;
            if !counts.is_empty() {
                let group = hdf5_create::group(&file, "counts")?;
                counts.iter().try_for_each(|counts| write_counts(&group, counts))?;
            }
            write_entry(&file, images, counts)?;
            if let Some(waves) = exit_waves {
                write_waves(&file, waves)?;
            }
            file.flush()
        };
        write().at(path)
    })
}

pub(crate) fn write_origin(
    file: &File,
    format: &str,
    version: i64,
    o: &Origin,
) -> hdf5::Result<()> {
    text(file, "format", format)?;
    number(file, "format_version", version)?;
    text(file, "stemgen_version", env!("CARGO_PKG_VERSION"))?;
    text(file, "command_line", &o.command_line)?;
    if let Some(request) = &o.request {
        text(file, "request", request)?;
    }
    if let Some(digest) = &o.structure_sha256 {
        text(file, "structure_sha256", digest)?;
    }
    text(file, "settings", &o.settings)?;
    text(file, "structure_file", &o.structure_file)?;
    number(file, "wavelength_angstrom", o.wavelength_angstrom)?;
    number(file, "band_limit_mrad", o.band_limit_mrad)?;
    if let Some(accuracy) = &o.accuracy {
        text(file, "accuracy", accuracy)?;
    }
    if let Some(source) = o.source {
        number(file, "source_fwhm_angstrom", source.fwhm_angstrom)?;
        number(file, "source_lorentz_share", source.lorentz_share)?;
    }
    Ok(())
}

pub(crate) fn write_specimen(group: &Group, o: &Origin) -> hdf5::Result<()> {
    if let Some(strain) = o.strain_percent {
        number(group, "strain_percent", strain)?;
    }
    let [x, y, z] = o.box_angstrom;
    let cell = ndarray::arr2(&[[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]]);
    let cell = group.new_dataset_builder().with_data(&cell).create("cell")?;
    text(&cell, "units", "Angstrom")?;
    let positions: Vec<[f64; 3]> = o.sites.iter().map(|s| s.position).collect();
    let rows = ArrayView2::from_shape((positions.len(), 3), positions.as_flattened())
        .map_err(|e| hdf5::Error::Internal(e.to_string()))?;
    let positions = group.new_dataset_builder().with_data(rows).create("positions")?;
    text(&positions, "units", "Angstrom")?;
    text(&positions, "axes", "x, y, z; the beam runs along +z")?;
    let numbers: Vec<i32> = o.sites.iter().map(|s| i32::from(s.number)).collect();
    group.new_dataset_builder().with_data(&numbers).create("numbers")?;
    let sigmas: Vec<f64> = o.sites.iter().map(|s| s.sigma_angstrom).collect();
    group.new_dataset_builder().with_data(&sigmas).create("sigma_angstrom")?;
    if o.sites.iter().all(|s| s.anisotropy.is_none()) {
        return Ok(());
    }
    let u: Vec<_> = o.sites.iter().map(|s| s.displacement_tensor()).collect();
    let u = ArrayView3::from_shape((u.len(), 3, 3), u.as_flattened().as_flattened())
        .map_err(|e| hdf5::Error::Internal(e.to_string()))?;
    group.new_dataset_builder().with_data(u).create("u_square_angstrom").map(drop)
}

fn write_stack(group: &Group, stack: &ImageStack) -> hdf5::Result<()> {
    let dataset = write_array(group, stack.name, stack.data)?;
    text(&dataset, "units", stack.units)?;
    describe(&dataset, stack)
}

fn write_counts(group: &Group, counts: &ImageCounts) -> hdf5::Result<()> {
    let dataset = write_array(group, counts.stack.name, counts.data)?;
    text(&dataset, "units", "electrons")?;
    number(&dataset, "electrons_per_pixel", counts.electrons_per_pixel)?;
    number(&dataset, "seed", counts.seed)?;
    describe(&dataset, &ImageStack { electrons_per_pixel: None, ..counts.stack.clone() })
}

fn write_array<T: hdf5::H5Type + Clone>(
    group: &Group,
    name: &str,
    data: ArrayView3<T>,
) -> hdf5::Result<Dataset> {
    let (_, rows, columns) = data.dim();
    let builder = group.new_dataset_builder().chunk((1, rows, columns)).shuffle().deflate(DEFLATE);
    builder.with_data(&data.as_standard_layout()).create(name)
}

/// Writes the images again in the layout of NeXus, and of Berkeley's EMD (version 0.2), where `dim1` is another name of the first axis.
fn write_entry(file: &File, images: &[ImageStack], counts: &[ImageCounts]) -> hdf5::Result<()> {
    let series = ImageSeries::group(images);
    let Some(first) = series.first() else { return Ok(()) };
    text(file, "NX_class", "NXroot")?;
    text(file, "default", "entry")?;
    number(file, "version_major", 0_i64)?;
    number(file, "version_minor", 2_i64)?;
    let entry = hdf5_create::group(file, "entry")?;
    text(&entry, "NX_class", "NXentry")?;
    text(&entry, "default", &first.name)?;
    for series in &series {
        let shown = ShownSeries { series, folder: "images", units: series.first().units };
        shown.write::<f32>(&entry, &series.name)?;
    }
    let counted: Vec<ImageStack> = counts.iter().map(|counts| counts.stack.clone()).collect();
    for series in &ImageSeries::group(&counted) {
        let shown = ShownSeries { series, folder: "counts", units: "electrons" };
        shown.write::<u32>(&entry, &format!("{}_counts", series.name))?;
    }
    Ok(())
}

/// A series in the layout of NeXus.
struct ShownSeries<'x, 's, 'a> {
    series: &'x ImageSeries<'s, 'a>,
    /// Group of the series' images in the file.
    folder: &'static str,
    units: &'x str,
}

impl ShownSeries<'_, '_, '_> {
    fn write<T: hdf5::H5Type>(&self, entry: &Group, name: &str) -> hdf5::Result<()> {
        let group = hdf5_create::group(entry, name)?;
        text(&group, "NX_class", "NXdata")?;
        text(&group, "signal", "data")?;
        text(&group, "title", name)?;
        // HyperSpy reads this attribute of the group: the last two axes belong to an image.
        text(&group, "interpretation", "image")?;
        number(&group, "emd_group_type", 1_i64)?;
        self.write_data::<T>(&group)?;
        let stack = self.series.first();
        let (_, rows, columns) = stack.data.dim();
        let along = |k: usize, n: usize| -> Vec<f64> {
            (0..n).map(|i| stack.origin_angstrom[k] + i as f64 * stack.step_angstrom[k]).collect()
        };
        let series = self.series.axes().into_iter().map(|axis| (axis.name, axis.values_angstrom));
        let places = series.chain([("y", along(1, rows)), ("x", along(0, columns))]);
        let places: Vec<(&str, Vec<f64>)> = places.collect();
        axes(&group, &places.iter().map(|(axis, _)| *axis).collect::<Vec<_>>())?;
        for (n, (axis, values)) in places.iter().enumerate() {
            number(&group, &format!("{axis}_indices"), n as i64)?;
            let dataset = group.new_dataset_builder().with_data(values).create(*axis)?;
            text(&dataset, "units", "angstrom")?;
            text(&dataset, "name", axis)?;
            group.link_soft(axis, &format!("dim{}", n + 1))?;
        }
        Ok(())
    }

    /// Writes a link if the stored image has these axes already, else a virtual dataset of the stored images.
    fn write_data<T: hdf5::H5Type>(&self, group: &Group) -> hdf5::Result<()> {
        let shape = self.series.shape();
        let stored = |stack: &ImageStack| format!("/{}/{}", self.folder, stack.name);
        let stack = self.series.first();
        let (images, rows, columns) = stack.data.dim();
        let source = [images, rows, columns];
        if shape == source && self.series.stacks.len() == 1 {
            return group.link_soft(&stored(stack), "data");
        }
        let mut builder = group.new_dataset_builder().empty::<T>().shape(shape.clone());
        for (n, stack) in self.series.stacks.iter().enumerate() {
            let place = match self.series.stacks.len() {
                1 => Selection::from(..),
                _ => {
                    let all = shape.iter().skip(1).map(|_| SliceOrIndex::from(..));
                    let one = std::iter::once(SliceOrIndex::from(n..n + 1));
                    Selection::from(Hyperslab::from(one.chain(all).collect::<Vec<_>>()))
                }
            };
            builder = builder.virtual_map(
                THIS_FILE,
                stored(stack),
                source,
                Selection::from(..),
                shape.clone(),
                place,
            );
        }
        let data = builder.create("data")?;
        text(&data, "units", self.units)?;
        describe_pixel(&data, stack)
    }
}

/// Writes axes, pixel and detector of an image.
fn describe(dataset: &Dataset, stack: &ImageStack) -> hdf5::Result<()> {
    axes(dataset, &AXES)?;
    describe_pixel(dataset, stack)?;
    array(dataset, "thicknesses_angstrom", stack.thicknesses_angstrom)?;
    if let Some(defocus) = stack.defocus_angstrom {
        number(dataset, "defocus_angstrom", defocus)?;
    }
    if let Some(electrons) = stack.electrons_per_pixel {
        number(dataset, "electrons_per_pixel", electrons)?;
    }
    match stack.annulus_mrad {
        None => Ok(()),
        Some([inner, outer]) => {
            number(dataset, "inner_mrad", inner)?;
            number(dataset, "outer_mrad", outer)
        }
    }?;
    stack.sector_degrees.map_or(Ok(()), |sector| array(dataset, "sector_degrees", &sector))
}

fn describe_pixel(dataset: &Dataset, stack: &ImageStack) -> hdf5::Result<()> {
    // With this attribute NeXus readers show an image at once.
    text(dataset, "interpretation", "image")?;
    let [x, y] = stack.step_angstrom;
    array(dataset, "sampling_angstrom", &[y, x])?;
    let [x, y] = stack.origin_angstrom;
    array(dataset, "origin_angstrom", &[y, x])
}

fn write_waves(file: &File, waves: ExitWaves) -> hdf5::Result<()> {
    let data = waves.data.as_standard_layout();
    let dataset = file.new_dataset_builder().with_data(&data).create("exit_wave")?;
    text(&dataset, "units", "amplitude; that of the incident wave is 1")?;
    axes(&dataset, &["configuration", "y", "x"])?;
    let [x, y] = waves.step_angstrom;
    array(&dataset, "sampling_angstrom", &[y, x])
}

pub(crate) fn axes(at: &hdf5::Location, names: &[&str]) -> hdf5::Result<()> {
    let bad = |_| hdf5::Error::Internal("axis holds a NUL".into());
    let names = names.iter().map(|n| n.parse().map_err(bad));
    let names = names.collect::<hdf5::Result<Vec<VarLenUnicode>>>()?;
    at.new_attr_builder().with_data(&names).create("axes").map(drop)
}

fn array(at: &hdf5::Location, name: &str, values: &[f64]) -> hdf5::Result<()> {
    at.new_attr_builder().with_data(ArrayView1::from(values)).create(name).map(drop)
}
