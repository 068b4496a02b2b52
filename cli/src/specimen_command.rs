//! `stemgen specimen`.

use super::common::Common;
use super::plan_text::Lines;
use super::recipe_args::RecipeArgs;
use super::{output, text, values};
use clap::Args;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;
use stemgen::files::OutputSet;
use stemgen::files::outputs::check_outputs;
use stemgen::io::writable;
use stemgen::progress::Progress;
use stemgen::recipe::Recipe;
use stemgen::specimen::{Specimen, specimen};
use stemgen::structure::Format;
use stemgen::world::footprint::atoms_bytes;
use stemgen::world::{Drawing, ExportOptions, ExportSummary, estimated_rows, export};

const EXAMPLES: &str = "\
Examples:
  The atoms of the central 2 x 2 tiles of the easy SrTiO3 world, with a picture:
    stemgen specimen srtio3 --difficulty easy --grid 2x2 -o atoms.extxyz --png
  The whole field with vacant sites, in the order of the world's ground truth:
    stemgen specimen srtio3 --difficulty hard --vacancies -o atoms.extxyz
  A specimen with more vacancies as CIF, and its image:
    stemgen specimen srtio3 --difficulty easy --grid 1x1 --set vacancies.rate=0.2 -o dirty.cif
    stemgen simulate dirty.cif --png

The columns of the file are species, position, occupancy, atom_type (0 pristine, 1 vacancy, 2
substitution), defect_type, and column, the index of the atomic column in the world's ground truth.
The field is cut out of a larger specimen, so opposite edges do not match; --vacuum separates them
in the periodic cell. Atoms of carbon layers ([surface]) follow the sites, with column -1. z counts
from the entrance face.";

/// Write the atoms of a specimen with their kinds of defects, as extended XYZ or CIF
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct SpecimenCommand {
    #[command(flatten)]
    recipe: RecipeArgs,
    /// Also write vacant sites, as species X with occupancy 0; in CIF, as the missing element with occupancy 0
    #[arg(long, help_heading = "Results")]
    vacancies: bool,
    /// Empty space between opposite edges of the field in the periodic cell, in A
    #[arg(long, value_name = "A", default_value_t = 2.0, value_parser = values::finite)]
    #[arg(allow_negative_numbers = true, help_heading = "Results")]
    vacuum: f64,
    /// File to write: extended XYZ (.extxyz, .xyz) or CIF (.cif) [default: MATERIAL_TIER[_RxC][_seedN].extxyz]
    #[arg(short, long, value_name = "FILE", help_heading = "Results")]
    output: Option<PathBuf>,
    /// Also write a picture (PNG) of the projected specimen, beside the file
    #[arg(long, help_heading = "Results")]
    png: bool,
    /// Replace existing files
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Planned {
    material: String,
    difficulty: Option<&'static str>,
    tiles: [usize; 2],
    fov_nm: [f64; 2],
    thickness_nm: f64,
    estimated_sites: u64,
    estimated_file_bytes: u64,
    output: PathBuf,
}

#[derive(Serialize)]
struct Written {
    output: PathBuf,
    file_bytes: u64,
    picture: Option<PathBuf>,
    material: String,
    difficulty: Option<&'static str>,
    seed: u64,
    tiles: [usize; 2],
    fov_nm: [f64; 2],
    thickness_nm: f64,
    cell_angstrom: [f64; 3],
    sites: u64,
    rows: u64,
    columns: u64,
    layer_atoms: u64,
    atoms: BTreeMap<&'static str, u64>,
    defects: BTreeMap<String, u64>,
    boundaries: usize,
    wall_time_s: f64,
}

impl SpecimenCommand {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let begun = Instant::now();
        let reporter = self.common.start()?;
        let recipe = self.recipe.resolve()?;
        let path = self.output(&recipe);
        let format = writable(&path)?;
        let picture = self.png.then(|| path.with_extension("png"));
        let mut set = OutputSet::of(&path, &text::command_line(), self.overwrite);
        if !self.common.dry_run {
            set.warning().iter().for_each(|warning| reporter.warn(warning));
            let outputs = [Some(&path), picture.as_ref()].into_iter().flatten();
            check_outputs(outputs, self.recipe.files(&recipe), set.replaces())?;
        }
        let specimen = specimen(&recipe)?;
        if self.common.dry_run {
            let planned = planned(&*specimen, &recipe, format, path);
            return self.common.print(&planned, &planned.text());
        }
        let options = ExportOptions {
            vacancies: self.vacancies,
            vacuum_angstrom: self.vacuum,
            overwrite: set.replaces(),
        };
        if picture.is_some() {
            set.begin()?;
        }
        let mut drawing = picture.as_ref().map(|_| Drawing::new(&*specimen, &recipe));
        let summary = export(&*specimen, &recipe, &path, &options, &reporter, |sites| {
            if let Some(drawing) = &mut drawing {
                drawing.add(sites);
            }
        })?;
        if let (Some(picture), Some(drawing)) = (&picture, drawing) {
            drawing.finish(&summary).write_png(picture)?;
        }
        set.finish()?;
        let field = &recipe.field;
        let shape = field.pixels(field.built_grid());
        let ExportSummary { sites, rows, columns, layer_atoms, atoms, defects, cell_angstrom } =
            summary;
        let written = Written {
            file_bytes: output::size(&path),
            output: path,
            picture,
            material: recipe.id.clone(),
            difficulty: recipe.tier.map(|t| t.name()),
            seed: recipe.seed,
            tiles: field.built_grid(),
            fov_nm: shape.map(|n| n as f64 * field.pixel_nm()),
            thickness_nm: specimen.facts().thickness_nm,
            cell_angstrom,
            sites,
            rows,
            columns,
            layer_atoms,
            atoms,
            defects,
            boundaries: specimen.boundaries().len(),
            wall_time_s: begun.elapsed().as_secs_f64(),
        };
        self.common.print(&written, &written.text())
    }

    fn output(&self, recipe: &Recipe) -> PathBuf {
        let default = || PathBuf::from(self.recipe.stem(recipe) + ".extxyz");
        self.output.clone().unwrap_or_else(default)
    }
}

/// Returns the plan.
fn planned(specimen: &dyn Specimen, recipe: &Recipe, format: Format, output: PathBuf) -> Planned {
    let field = &recipe.field;
    let sites = estimated_rows(specimen, recipe);
    Planned {
        material: recipe.id.clone(),
        difficulty: recipe.tier.map(|t| t.name()),
        tiles: field.built_grid(),
        fov_nm: field.pixels(field.built_grid()).map(|n| n as f64 * field.pixel_nm()),
        thickness_nm: specimen.facts().thickness_nm,
        estimated_sites: sites,
        estimated_file_bytes: atoms_bytes(format, sites),
        output,
    }
}

impl Planned {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        let tier = self.difficulty.map(|t| format!(", {t}")).unwrap_or_default();
        lines.add("specimen", format!("{}{tier}", self.material));
        let ([rows, columns], [h, w]) = (self.tiles, self.fov_nm);
        let thick = self.thickness_nm;
        lines.add(
            "field",
            format!("{rows} x {columns} tiles: {h:.2} x {w:.2} nm, {thick:.3} nm thick"),
        );
        lines.add("sites", format!("about {}", text::count(self.estimated_sites)));
        lines.add("file size", format!("at most about {}", text::bytes(self.estimated_file_bytes)));
        lines.add("output", format!("{} (nothing was written)", self.output.display()));
        lines.text()
    }
}

impl Written {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        let tier = self.difficulty.map(|t| format!(", {t}")).unwrap_or_default();
        lines.add("specimen", format!("{}{tier}, seed {}", self.material, self.seed));
        let ([rows, columns], [h, w]) = (self.tiles, self.fov_nm);
        lines.add(
            "field",
            format!(
                "{rows} x {columns} tiles: {h:.2} x {w:.2} nm, {:.3} nm thick",
                self.thickness_nm
            ),
        );
        let list = |counts: &mut dyn Iterator<Item = (&str, u64)>| {
            let each = counts.map(|(name, n)| format!("{name} {}", text::count(n)));
            each.collect::<Vec<_>>().join(", ")
        };
        lines.add("atoms", list(&mut self.atoms.iter().map(|(name, n)| (*name, *n))));
        let defects = list(&mut self.defects.iter().map(|(name, n)| (name.as_str(), *n)));
        lines.add("defects", if defects.is_empty() { "none".into() } else { defects });
        let [sites, columns] = [self.sites, self.columns].map(text::count);
        lines.add("sites", format!("{sites} in {columns} columns"));
        if self.layer_atoms > 0 {
            lines.add("carbon", format!("{} atoms on the faces", text::count(self.layer_atoms)));
        }
        lines.add("boundaries", self.boundaries.to_string());
        lines.add("time", text::duration(self.wall_time_s));
        let size = text::bytes(self.file_bytes);
        lines.add("file", format!("{} ({size})", self.output.display()));
        if let Some(picture) = &self.picture {
            lines.add("picture", picture.display().to_string());
        }
        lines.text()
    }
}
