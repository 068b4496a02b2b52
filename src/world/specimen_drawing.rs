//! Draws the specimen of a recipe in projection along the beam.

use std::collections::BTreeMap;
use std::path::Path;

use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::recipe::CheckedRecipe;
use crate::recipe::region::Region;
use crate::recipe::resolved_recipe::Recipe;
use crate::render::{RgbImage, Scene, Swatch, palette};
use crate::specimen::atom_columns::Sites;
use crate::specimen::sites::SiteKind;
use crate::specimen::specimen;
use crate::specimen::specimen_trait::{Specimen, outlines_in};
use crate::structure::elements;
use crate::world::atoms_export::{ExportOptions, ExportSummary, export};

/// Pixels along the longer side of the field.
const SIDE: usize = 1600;

/// A drawing that receives the sites of the built field piece by piece.
pub struct Drawing<'a> {
    specimen: &'a dyn Specimen,
    recipe: &'a Recipe,
    built: Region,
    scene: Scene,
    colors: BTreeMap<u8, [u8; 3]>,
}

impl<'a> Drawing<'a> {
    /// Starts a drawing with the phases.
    pub fn new(specimen: &'a dyn Specimen, recipe: &'a Recipe) -> Self {
        let built = recipe.field.built_region();
        let mut scene = Scene::new([built.x[1] - built.x[0], built.y[1] - built.y[0]], SIDE);
        if specimen.facts().phases.len() > 1 {
            scene.tint(|[x, y]| ground(specimen.phase_at([x + built.x[0], y + built.y[0]])));
        }
        let symbols = recipe.phonons.sigma_angstrom.keys();
        let mut numbers: Vec<u8> =
            symbols.filter_map(|s| elements::atomic_number(s).ok()).collect();
        numbers.sort_by_key(|z| u8::MAX - z);
        let color = |n: usize| palette::ELEMENTS[n % palette::ELEMENTS.len()];
        let colors = numbers.iter().enumerate().map(|(n, z)| (*z, color(n))).collect();
        Drawing { specimen, recipe, built, scene, colors }
    }

    /// Adds the atoms and marks of some columns.
    pub fn add(&mut self, sites: &Sites) {
        let corner = [self.built.x[0], self.built.y[0]];
        let place = |[x, y]: [f64; 2]| [x - corner[0], y - corner[1]];
        for site in sites.sites.iter().filter(|s| s.kind != SiteKind::Vacancy) {
            let [x, y, _] = site.position_nm;
            let color = self.colors.get(&site.number).copied().unwrap_or_default();
            self.scene.atom(place([x, y]), f32::from(site.number), color);
        }
        for column in &sites.columns {
            let members = &sites.sites[column.sites.clone()];
            for (kind, color) in [
                (SiteKind::Vacancy, palette::VACANCY),
                (SiteKind::Substitution, palette::SUBSTITUTION),
            ] {
                let marked = members.iter().filter(|s| s.kind == kind).count();
                if marked > 0 {
                    self.scene.mark(place(column.position_nm), marked, members.len(), color);
                }
            }
        }
    }

    /// Returns the picture, with boundaries and a legend.
    pub fn finish(mut self, summary: &ExportSummary) -> RgbImage {
        self.legend(summary);
        let corner = [self.built.x[0], self.built.y[0]];
        for boundary in self.specimen.boundaries() {
            let points: Vec<[f64; 2]> =
                boundary.line_nm.iter().map(|[x, y]| [x - corner[0], y - corner[1]]).collect();
            self.scene.line(&points, palette::LINE);
        }
        for particle in &self.specimen.facts().particle_outlines {
            let [x, y] = particle.centre_nm;
            let centre = [x - corner[0], y - corner[1]];
            self.scene.circle(centre, 0.5 * particle.diameter_nm, palette::LINE);
        }
        let stack = self.specimen.facts().stack.as_ref();
        for dislocation in stack.map_or(&[][..], |stack| &stack.dislocations) {
            let [x, y] = dislocation.position_nm;
            let [u, v, _] = dislocation.burgers_nm;
            self.scene.circle([x - corner[0], y - corner[1]], u.hypot(v), palette::LINE);
        }
        for [x, y] in &self.specimen.facts().clusters_nm {
            let radius = self.recipe.vacancies.as_ref().map_or(0.0, |v| v.cluster_sigma_nm);
            self.scene.circle([x - corner[0], y - corner[1]], radius, palette::LINE);
        }
        self.scene.render()
    }

    fn legend(&mut self, summary: &ExportSummary) {
        let recipe = self.recipe;
        let tier = recipe.tier.map(|t| format!(" {}", t.name())).unwrap_or_default();
        let size = [self.built.y, self.built.x].map(|r| r[1] - r[0]);
        let scene = &mut self.scene;
        scene.legend(Swatch::None, format!("{}{tier}", recipe.id));
        scene.legend(Swatch::None, format!("{}, seed {}", recipe.zone_axis, recipe.seed));
        scene.legend(Swatch::None, format!("{:.1} x {:.1} nm", size[0], size[1]));
        scene.legend(Swatch::None, format!("{:.1} nm thick", self.specimen.facts().thickness_nm));
        scene.legend(Swatch::None, "");
        for (number, color) in self.colors.iter().rev() {
            scene.legend(Swatch::Disc(*color), elements::symbol(*number));
        }
        for (name, count) in &summary.defects {
            let color = match name.starts_with("vacancy") {
                true => palette::VACANCY,
                false => palette::SUBSTITUTION,
            };
            let (kind, element) = name.split_once('_').unwrap_or((name, ""));
            let text = match kind {
                "vacancy" => {
                    let sites = count + summary.atoms.get(element).copied().unwrap_or(0);
                    let percent = 100.0 * *count as f64 / sites as f64;
                    format!("{element} vacancies: {count} ({percent:.2} %)")
                }
                _ => format!("{element} {kind}s: {count}"),
            };
            let swatch = if scene.has_rings() { Swatch::Ring(color) } else { Swatch::Area(color) };
            scene.legend(swatch, text);
        }
        for (code, name) in self.specimen.facts().phases.iter().enumerate() {
            scene.legend(Swatch::Area(ground(code)), name.replace('_', " "));
        }
        if !self.specimen.boundaries().is_empty() {
            scene.legend(Swatch::Line(palette::LINE), "boundary");
        }
        if let Some(stack) = &self.specimen.facts().stack
            && !stack.dislocations.is_empty()
        {
            scene.legend(Swatch::Ring(palette::LINE), "dislocation");
        }
        match self.specimen.facts().clusters_nm.len() {
            0 => {}
            n => {
                scene.legend(Swatch::Ring(palette::LINE), format!("{n} clusters in the full field"))
            }
        }
        match outlines_in(self.specimen, &self.built).len() {
            0 => {}
            1 => scene.legend(Swatch::Ring(palette::LINE), "1 particle"),
            n => scene.legend(Swatch::Ring(palette::LINE), format!("{n} particles")),
        }
    }
}

/// Colour of the background of a phase.
fn ground(code: usize) -> [u8; 3] {
    palette::PHASES[code % palette::PHASES.len()]
}
/// Draws the projected specimen of a recipe. The atoms are first listed in a temporary folder.
///
/// # Errors
/// Errors of the specimen and of the file.
pub fn draw_specimen(
    recipe: &CheckedRecipe,
    picture: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let specimen = specimen(recipe)?;
    let mut drawing = Drawing::new(&*specimen, recipe);
    let folder = tempfile::tempdir().map_err(|e| Error::io(&std::env::temp_dir(), "create", e))?;
    let options = ExportOptions { vacancies: true, vacuum_angstrom: 2.0, overwrite: false };
    let atoms = folder.path().join("atoms.extxyz");
    let summary = export(&*specimen, recipe, &atoms, &options, progress, |s| drawing.add(s))?;
    drawing.finish(&summary).write_png(picture)
}
