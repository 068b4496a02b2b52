//! The command line: one file per subcommand.

mod accuracy_report;
mod acquire_command;
mod audit_command;
mod build_command;
mod build_plan;
mod cache_command;
mod common;
mod compare_command;
mod estimate;
mod hdf5_check;
mod hints;
mod imaging_args;
mod list_command;
mod not_offered;
mod output;
mod pictures;
mod plan_report;
mod plane_wave;
mod progress_bar;
mod recipe_args;
mod reference_scan;
mod scan_args;
mod show_recipe_command;
mod signals;
mod simulate_command;
mod simulate_results;
mod slips;
mod specimen_command;
mod structure_args;
mod text;
mod tiles_command;
mod validate_command;
mod validate_reference;
mod values;
mod view_command;
mod view_picture;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Simulates STEM images and generates whole annotated specimens (worlds).
#[derive(Debug, Parser)]
#[command(name = "stemgen", version, max_term_width = 100, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  stemgen simulate si.cif --repeat 3,3,10 --scan-end 5.431,5.431 --png
  stemgen list
  stemgen specimen srtio3 --difficulty easy --grid 2x2 -o atoms.extxyz --png
  stemgen build srtio3 --difficulty easy --grid 2x2
  stemgen view worlds/srtio3_easy_2x2.h5 --overlay defects
  stemgen tiles worlds/srtio3_easy_2x2.h5 --random-dose 1e3,1e5 -n 200 -o train.npz
  stemgen acquire worlds/srtio3_easy_2x2.h5 --profile routine -o tile.h5 --png
  stemgen validate --quick

`stemgen COMMAND --help` explains every option, with more examples; `stemgen glossary` the terms.";

/// What the terms of help and messages mean.
const GLOSSARY: &str = include_str!("../../docs/glossary.md");

#[derive(Debug, Subcommand)]
enum Command {
    Simulate(Box<simulate_command::Simulate>),
    Build(Box<build_command::Build>),
    Specimen(Box<specimen_command::SpecimenCommand>),
    View(Box<view_command::View>),
    Tiles(Box<tiles_command::Tiles>),
    Acquire(Box<acquire_command::Acquire>),
    Audit(Box<audit_command::AuditCommand>),
    Cache(Box<cache_command::CacheCommand>),
    Validate(Box<validate_command::Validate>),
    Compare(Box<compare_command::Compare>),
    List(Box<list_command::List>),
    ShowRecipe(Box<show_recipe_command::ShowRecipe>),
    /// Explain the terms of the program: window, mosaic, library, sub-tile, tail ...
    Glossary,
}

/// Runs the program and reports what went wrong.
pub fn main() -> ExitCode {
    // Before all else: that process hears no signals, and has no options.
    if let Some(ended) = hdf5_check::serve() {
        return ended;
    }
    let done = |()| ExitCode::SUCCESS;
    if let Err(error) = signals::listen() {
        text::complain(&format!("warning: Ctrl-C ends the program at once: {error}"));
    }
    let command = match Cli::try_parse() {
        Ok(cli) => cli.command,
        Err(error) => not_offered::advised(error).exit(),
    };
    let (name, result) = match command {
        Command::Simulate(command) => ("simulate", command.run().map(done)),
        Command::Build(command) => ("build", command.run().map(done)),
        Command::Specimen(command) => ("specimen", command.run().map(done)),
        Command::View(command) => ("view", command.run().map(done)),
        Command::Acquire(command) => ("acquire", command.run().map(done)),
        Command::Tiles(command) => ("tiles", command.run().map(done)),
        Command::Audit(command) => ("audit", command.run().map(done)),
        Command::Cache(command) => ("cache", command.run().map(done)),
        Command::Validate(command) => ("validate", command.run()),
        Command::Compare(command) => ("compare", command.run()),
        Command::List(command) => ("list", command.run().map(done)),
        Command::ShowRecipe(command) => ("show-recipe", command.run().map(done)),
        Command::Glossary => ("glossary", text::print(GLOSSARY.trim_end()).map(done)),
    };
    result.unwrap_or_else(|error| hints::report(&error, name))
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_definition_of_the_command_line_is_consistent() {
        super::Cli::command().debug_assert();
    }
}
