//! Writes the atoms of a specimen to a file, with the column and the kind of defect of each.

use std::collections::BTreeMap;
use std::path::Path;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::files::atomic_write;
use crate::files::{OutputLock, disk_space};
use crate::io::{AtomRow, AtomsHeader, AtomsWriter, RowFormat, atom_type, writable};
use crate::lengths;
use crate::models::carbon::network::CARBON;
use crate::plane;
use crate::progress::Progress;
use crate::recipe::region::Region;
use crate::recipe::resolved_recipe::Recipe;
use crate::specimen::atom_columns::{AtomColumn, Sites};
use crate::specimen::census::estimated_sites;
use crate::specimen::sites::SiteKind;
use crate::specimen::specimen_trait::Specimen;
use crate::specimen::stripes::for_each_stripe;
use crate::specimen::surface_layers::SurfaceLayers;
use crate::structure::elements;
use crate::world::footprint;
use crate::world::region_truth::defect_name;

/// Columns that are formatted at a time.
const COLUMNS_AT_ONCE: usize = 4096;

/// How atoms are written.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportOptions {
    /// Write vacant sites as well.
    pub vacancies: bool,
    /// Width in Angstrom of the empty space beside and below the atoms in the cell: the field is cut out of a larger specimen, so its
    /// opposite edges do not fit together.
    pub vacuum_angstrom: f64,
    /// Replace an existing file.
    pub overwrite: bool,
}

impl Default for ExportOptions {
    fn default() -> Self {
        ExportOptions { vacancies: false, vacuum_angstrom: 2.0, overwrite: false }
    }
}

/// Counts of what was written.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ExportSummary {
    /// Lattice sites, vacant ones included.
    pub sites: u64,
    /// Rows of the file.
    pub rows: u64,
    /// Atomic columns.
    pub columns: u64,
    /// Atoms of the layers on the faces of the specimen.
    pub layer_atoms: u64,
    /// Atoms of each element.
    pub atoms: BTreeMap<&'static str, u64>,
    /// Defects of each kind: `vacancy_O`.
    pub defects: BTreeMap<String, u64>,
    /// Edges of the cell in Angstrom.
    pub cell_angstrom: [f64; 3],
}

/// Writes the sites of the built field to `path`; its ending selects the format (`.extxyz`, `.xyz` or `.cif`). Sites and columns have the
/// order and the numbers that they have in the ground truth of a world of this recipe. `visit` receives all sites in that order, with
/// positions in nm in the full field. Atoms of layers on the specimen's faces follow, layer by layer from the top of the field down; they
/// belong to no column. Where a layer lies before the specimen, z counts from the layer's face.
///
/// # Errors
/// [`Error::Invalid`] for another ending or a vacuum out of limits, [`Error::Locked`], [`Error::DiskSpace`], [`Error::Interrupted`], and
/// errors of the file system. An incomplete file is never left at `path`.
pub fn export(
    specimen: &dyn Specimen,
    recipe: &Recipe,
    path: &Path,
    options: &ExportOptions,
    progress: &dyn Progress,
    mut visit: impl FnMut(&Sites) + Send,
) -> Result<ExportSummary> {
    if !(0.0..=1e4).contains(&options.vacuum_angstrom) {
        let expected = "expected a length from 0 to 10000";
        return Err(Error::invalid(
            crate::Setting::VacuumAngstrom,
            options.vacuum_angstrom,
            expected,
        ));
    }
    let _lock = OutputLock::hold(path)?;
    let layers = SurfaceLayers::of(recipe, specimen.facts().thickness_nm);
    let sites = estimated_rows(specimen, recipe);
    disk_space::check_space(path, footprint::atoms_bytes(writable(path)?, sites))?;
    let frame = Frame::new(specimen, recipe, options, layers.as_ref());
    let mut summary = ExportSummary { cell_angstrom: frame.cell, ..ExportSummary::default() };
    atomic_write::write_with(path, options.overwrite, |temporary| {
        let mut writer = AtomsWriter::create(temporary, path, &header(recipe, &frame))?;
        for_each_stripe(specimen, &recipe.field, "writing atoms", progress, |stripe| {
            visit(&stripe.sites);
            for text in frame.format(&stripe.sites, writer.rows(), &summary) {
                writer.append(text)?;
            }
            summary.add(&stripe.sites, options.vacancies);
            Ok(())
        })?;
        if let Some(layers) = &layers {
            write_layers(
                &mut writer,
                layers,
                &recipe.field.built_region(),
                &frame,
                &mut summary,
                progress,
            )?;
        }
        writer.finish(summary.rows)
    })?;
    Ok(summary)
}

/// Estimates the number of rows that [`export`] writes.
pub fn estimated_rows(specimen: &dyn Specimen, recipe: &Recipe) -> u64 {
    let built = recipe.field.built_region();
    let layers = SurfaceLayers::of(recipe, specimen.facts().thickness_nm);
    let of_layers = layers.iter().flat_map(SurfaceLayers::layers);
    estimated_sites(specimen, &recipe.field)
        + of_layers.map(|layer| layer.estimated_atoms(&built)).sum::<u64>()
}

fn write_layers(
    writer: &mut AtomsWriter,
    layers: &SurfaceLayers,
    built: &Region,
    frame: &Frame,
    summary: &mut ExportSummary,
    progress: &dyn Progress,
) -> Result<()> {
    let parts = layers.parts(built);
    progress.start("writing layers", "part", parts.len() as u64);
    for (layer, area) in parts {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let mut out = Vec::new();
        for atom in layer.atoms(&area) {
            let [x, y, z] = lengths::nm(atom.position);
            let row = AtomRow {
                number: atom.number,
                position_angstrom: frame.place([x + area.x[0], y + area.y[0], z]),
                atom_type: atom_type::PRISTINE,
                defect: "",
                column: None,
            };
            summary.layer_atoms += 1;
            writer.rows().push(&mut out, &row, summary.sites + summary.layer_atoms);
        }
        writer.append(out)?;
        progress.advance(1);
    }
    progress.finish();
    summary.rows += summary.layer_atoms;
    *summary.atoms.entry(elements::symbol(CARBON)).or_default() += summary.layer_atoms;
    Ok(())
}

impl ExportSummary {
    fn add(&mut self, sites: &Sites, vacancies: bool) {
        for site in &sites.sites {
            let vacant = site.kind == SiteKind::Vacancy;
            if !vacant {
                *self.atoms.entry(elements::symbol(site.number)).or_default() += 1;
            }
            if site.kind != SiteKind::Pristine {
                let name = defect_name(site.kind, site.number);
                *self.defects.entry(name).or_default() += 1;
            }
            self.rows += u64::from(vacancies || !vacant);
        }
        self.sites += sites.sites.len() as u64;
        self.columns += sites.columns.len() as u64;
    }
}

/// Where the atoms lie in the cell of the file.
struct Frame {
    cell: [f64; 3],
    /// Corner of the cell (x, y) in nm of the full field.
    corner_nm: [f64; 2],
    /// Distance in Angstrom from the face that the beam enters to the face of the specimen.
    before_angstrom: f64,
    vacancies: bool,
}

impl Frame {
    fn new(
        specimen: &dyn Specimen,
        recipe: &Recipe,
        options: &ExportOptions,
        layers: Option<&SurfaceLayers>,
    ) -> Self {
        let built = recipe.field.built_region();
        let vacuum = options.vacuum_angstrom;
        let [width, height] = built.size_angstrom();
        let specimen_angstrom = specimen.facts().thickness_angstrom();
        let thickness = layers.map_or(specimen_angstrom, SurfaceLayers::thickness_angstrom);
        Frame {
            cell: [width + vacuum, height + vacuum, thickness + vacuum],
            corner_nm: [built.x[0] - 0.05 * vacuum, built.y[0] - 0.05 * vacuum],
            before_angstrom: layers.map_or(0.0, SurfaceLayers::before_angstrom),
            vacancies: options.vacancies,
        }
    }

    /// Formats the rows of some sites; `before` counts the sites and rows written so far.
    fn format(&self, sites: &Sites, rows: RowFormat, before: &ExportSummary) -> Vec<Vec<u8>> {
        let chunks = sites.columns.par_chunks(COLUMNS_AT_ONCE).enumerate();
        let format = |(n, columns): (usize, &[AtomColumn])| {
            let mut out = Vec::new();
            for (k, column) in columns.iter().enumerate() {
                let index = before.columns + (n * COLUMNS_AT_ONCE + k) as u64;
                for at in column.sites.clone() {
                    self.row(&mut out, sites, at, rows, index, before.sites + at as u64 + 1);
                }
            }
            out
        };
        chunks.map(format).collect()
    }

    fn row(
        &self,
        out: &mut Vec<u8>,
        sites: &Sites,
        at: usize,
        rows: RowFormat,
        column: u64,
        serial: u64,
    ) {
        let site = &sites.sites[at];
        if site.kind == SiteKind::Vacancy && !self.vacancies {
            return;
        }
        let defect = defect_name(site.kind, site.number);
        let row = AtomRow {
            number: site.number,
            position_angstrom: self.place(site.position_nm),
            atom_type: atom_type::code(site.kind),
            defect: &defect,
            column: Some(column),
        };
        rows.push(out, &row, serial);
    }

    /// Converts a place in nm of the full field, z counted from the face of the specimen, to a position in Angstrom in the cell.
    fn place(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [left, top] = self.corner_nm;
        let [x, y, z] = lengths::angstrom([x - left, y - top, z]);
        [x, y, z + self.before_angstrom]
    }
}

fn header(recipe: &Recipe, frame: &Frame) -> AtomsHeader {
    let field = &recipe.field;
    let pixel = field.pixel_nm();
    let first = field.crop_origin_px();
    let origin = [first[1], first[0]].map(|p| p as f64 * pixel);
    let [x, y] = lengths::angstrom(plane::sub(origin, frame.corner_nm));
    let mut sigmas = recipe.phonons.sigma_angstrom.clone();
    if let Some(surface) = &recipe.surface {
        sigmas.entry(elements::symbol(CARBON).into()).or_insert(surface.sigma_angstrom);
    }
    let sigmas = sigmas.iter().map(|(e, s)| format!("{e}={s}"));
    let tier = recipe.tier.map(|t| format!("_{}", t.name())).unwrap_or_default();
    let mut header = AtomsHeader {
        name: format!("{}{tier}", recipe.id),
        cell_angstrom: frame.cell,
        notes: vec![
            ("material", recipe.id.clone()),
            ("zone_axis", recipe.zone_axis.clone()),
            ("seed", recipe.seed.to_string()),
            ("stemgen_version", env!("CARGO_PKG_VERSION").into()),
            ("pixel_angstrom", field.pixel_angstrom().to_string()),
            ("first_pixel_angstrom", format!("{x} {y}")),
            ("sigma", sigmas.collect::<Vec<_>>().join(",")),
        ],
        recipe: recipe.to_toml(),
    };
    if recipe.surface.is_some() {
        header.notes.push(("specimen_face_angstrom", frame.before_angstrom.to_string()));
    }
    header
}
