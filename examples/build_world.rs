//! Builds a small world and reads it again.
//!
//!     cargo run --release --example build_world [FILE.h5]
//!
//! Writes `worlds/example.h5` unless a file is named, one tile of thin SrTiO3 with a grain boundary and oxygen vacancies, and
//! prints how it was made and its columns with most vacancies. A file that exists is replaced.

use std::path::Path;

use stemgen::imaging::Cache;
use stemgen::io::WorldFile;
use stemgen::progress::Silent;
use stemgen::recipe::Recipe;
use stemgen::world::{BuildOptions, WorldBuild};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let own = std::env::args().nth(1);
    run(Path::new(own.as_deref().unwrap_or("worlds/example.h5")))
}

/// Builds the world at `path` and prints what it holds.
pub fn run(path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    // Values of a recipe are changed as on the command line; only a recipe that was checked can be built.
    let changes = ["vacancies.rate=0.1".parse()?, "seed=7".parse()?];
    let recipe = Recipe::load("test", None)?.with_overrides(&changes)?;
    let recipe = recipe.with_grid(1, 1)?.checked()?;

    let options = BuildOptions { overwrite: true, cache: Cache::none(), ..BuildOptions::default() };
    let build = WorldBuild::new(&recipe, &options)?;
    println!("needs {:.1} MB on disk", build.disk_bytes() as f64 / 1e6);
    let summary = build.run(path, &Silent)?;
    let counts = summary.counts;
    println!("{}: {} in {:.1} s", path.display(), summary.engine, summary.wall_time_s);
    println!("{} sites, {} vacancies, {} columns", counts.sites, counts.vacancies, counts.columns);

    let world = WorldFile::open(path)?;
    let mut columns = world.columns()?;
    columns.sort_by_key(|column| std::cmp::Reverse(column.vacancies));
    for column in columns.iter().take(5) {
        let [x, y] = column.position_nm;
        println!("x {x:.3} nm, y {y:.3} nm: {}, {} vacant", column.composition, column.vacancies);
    }
    Ok(())
}
