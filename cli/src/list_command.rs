//! `stemgen list`.

use super::progress_bar::Reporter;
use super::recipe_args::is_recipe_file;
use super::text;
use clap::Args;
use serde::Serialize;
use std::path::Path;
use stemgen::recipe::{CheckedRecipe, Recipe};
use stemgen::specimen::{counted_sites, estimated_sites, specimen};

const EXAMPLES: &str = "\
Examples:
  List the worlds that can be built:
    stemgen list
  Print JSON with exact numbers of sites, for programs:
    stemgen list --count --json

A rate is the fraction of the named sites that is vacant or substituted. Sites are the lattice sites
of the whole field, with vacant ones. Their number is estimated from samples of the field (within
about 1 %), or exact with --count. The dose is in electrons per square Angstrom.";

/// List the recipes that are installed with the program
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct List {
    /// Material to list, or your own recipe file (.toml) [default: all materials]
    #[arg(value_name = "MATERIAL")]
    material: Option<String>,
    /// Count every site, which takes seconds for each tier
    #[arg(long)]
    count: bool,
    /// Print as JSON
    #[arg(long)]
    json: bool,
    /// Print only the list and errors
    #[arg(short, long)]
    quiet: bool,
}

#[derive(Debug, Serialize)]
struct RecipeRow {
    recipe: String,
    difficulty: Option<&'static str>,
    zone_axis: String,
    fov_nm: [f64; 2],
    grid: [usize; 2],
    pixel_nm: f64,
    thickness_nm: f64,
    sites: u64,
    sites_counted: bool,
    rates: Vec<Rate>,
    phonon_configurations: usize,
    dose_electrons_per_angstrom2: f64,
}

/// A rate of defects.
#[derive(Debug, Serialize, PartialEq)]
struct Rate {
    /// Dotted key of the recipe.
    key: String,
    /// Element whose sites are meant.
    element: Option<String>,
    /// Element that replaces it; `None` for vacancies.
    by: Option<String>,
    rate: f64,
}

impl List {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = Reporter::new(self.quiet);
        let names: Vec<String> = match &self.material {
            Some(name) => vec![name.clone()],
            None => Recipe::built_in().map(str::to_owned).collect(),
        };
        let mut rows = Vec::new();
        for name in names {
            let own = is_recipe_file(&name).then(|| Path::new(&name));
            let tiers = match own {
                Some(file) => Recipe::tiers_of_file(file)?,
                None => Recipe::tiers(&name)?,
            };
            let tiers =
                if tiers.is_empty() { vec![None] } else { tiers.into_iter().map(Some).collect() };
            for tier in tiers {
                let recipe = match own {
                    Some(file) => CheckedRecipe::from_file(file, tier)?,
                    None => CheckedRecipe::load(&name, tier)?,
                };
                rows.push(self.row(&recipe, &reporter)?);
            }
        }
        text::print(&if self.json { serde_json::to_string_pretty(&rows)? } else { table(&rows) })
    }

    fn row(&self, recipe: &CheckedRecipe, reporter: &Reporter) -> anyhow::Result<RecipeRow> {
        let specimen = specimen(recipe)?;
        let field = &recipe.field;
        let sites = match self.count {
            true => counted_sites(&*specimen, field, reporter)?,
            false => estimated_sites(&*specimen, field),
        };
        Ok(RecipeRow {
            recipe: recipe.id.clone(),
            difficulty: recipe.tier.map(|t| t.name()),
            zone_axis: recipe.zone_axis.clone(),
            fov_nm: field.fov_nm,
            grid: field.built_grid(),
            pixel_nm: field.pixel_nm(),
            thickness_nm: specimen.facts().thickness_nm,
            sites,
            sites_counted: self.count,
            rates: rates(recipe),
            phonon_configurations: recipe.phonons.configurations,
            dose_electrons_per_angstrom2: recipe.dose.electrons_per_angstrom2,
        })
    }
}

/// Returns all values of the recipe whose key is `rate`.
fn rates(recipe: &Recipe) -> Vec<Rate> {
    fn walk(table: &toml::Table, path: &str, out: &mut Vec<Rate>) {
        if let Some(rate) = table.get("rate").and_then(toml::Value::as_float) {
            let text = |key: &str| table.get(key).and_then(toml::Value::as_str).map(str::to_owned);
            out.push(Rate {
                key: format!("{path}.rate"),
                element: text("element").or_else(|| text("host")),
                by: text("by").or_else(|| text("guest")),
                rate,
            });
        }
        for (key, value) in table {
            if let toml::Value::Table(inner) = value {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                walk(inner, &path, out);
            }
        }
    }
    let mut out = Vec::new();
    if let Ok(table) = toml::from_str(&recipe.to_toml()) {
        walk(&table, "", &mut out);
    }
    out
}

impl Rate {
    fn text(&self) -> String {
        let percent = format!("{} %", text::significant(100.0 * self.rate, 2));
        match (&self.element, &self.by) {
            (Some(element), Some(by)) => format!("{by} for {element} {percent}"),
            (Some(element), None) => format!("{element} vacancies {percent}"),
            _ => format!("{} {percent}", self.key.trim_end_matches(".rate")),
        }
    }
}

fn table(rows: &[RecipeRow]) -> String {
    let head = [
        "recipe",
        "tier",
        "zone",
        "field (nm)",
        "tiles",
        "pixel (nm)",
        "sites",
        "rates",
        "phonons",
        "dose",
    ];
    let mut cells = vec![head.map(str::to_owned)];
    cells.extend(rows.iter().map(RecipeRow::cells));
    text::table(&cells)
}

impl RecipeRow {
    fn cells(&self) -> [String; 10] {
        let rates: Vec<String> = self.rates.iter().map(Rate::text).collect();
        let about = if self.sites_counted { "" } else { "about " };
        let sites = match self.sites {
            n if self.sites_counted => text::count(n),
            n if n >= 1_000_000 => format!("{:.2} million", n as f64 / 1e6),
            n => text::count(n),
        };
        [
            self.recipe.clone(),
            self.difficulty.unwrap_or("-").to_owned(),
            self.zone_axis.clone(),
            format!("{} x {}", self.fov_nm[0], self.fov_nm[1]),
            format!("{} x {}", self.grid[0], self.grid[1]),
            format!("{:.5}", self.pixel_nm),
            format!("{about}{sites}"),
            if rates.is_empty() { "-".into() } else { rates.join(", ") },
            self.phonon_configurations.to_string(),
            self.dose_electrons_per_angstrom2.to_string(),
        ]
    }
}
