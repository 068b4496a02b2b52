//! The command line: one file per subcommand.

mod accuracy_report;
mod acquire_command;
mod audit_command;
mod audit_verdict;
mod build_again;
mod build_all;
mod build_command;
mod build_shard;
mod cache_command;
mod cache_transfer;
mod card_command;
mod common;
mod compare_command;
mod crash_note;
mod detectability_command;
mod foreign_options;
mod hdf5_check;
mod hints;
mod image_plan_text;
mod imaging_args;
mod import_command;
mod info_command;
mod integrate_command;
mod invocation;
mod list_command;
mod live_command;
mod output;
mod patterns_command;
mod picture_args;
mod plan_text;
mod progress_bar;
mod recipe_args;
mod recipe_choice;
mod reference_scan;
mod regenerate_command;
mod request_file;
mod rerun_command;
mod scan_args;
mod show_recipe_command;
mod signals;
mod simulate_command;
mod simulate_parts;
mod simulate_results;
mod slurm_command;
mod specimen_command;
mod structure_args;
mod text;
mod tiles_command;
mod validate_command;
mod validate_reference;
mod values;
mod verify_command;
mod view_command;
mod view_images;
mod view_patterns;
mod world_hspy;
mod world_plan_text;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;
use std::process::ExitCode;

pub use hdf5_check::survive;
pub use invocation::Invocation;
use invocation::PROGRAM;

/// Simulate STEM images, and build worlds: files with the image of a whole specimen and its ground truth
#[derive(Debug, Parser)]
#[command(name = "stemgen", version, max_term_width = 100, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  Simulate the HAADF image of a crystal, or its diffraction patterns:
    stemgen simulate si.cif --repeat 3,3,10 --scan-end 5.431,5.431 --png
    stemgen patterns si.cif --repeat 8,8,10 --scan-end 5.431,5.431 --png
  Find the dose at which a missing atom is seen:
    stemgen detectability srtio3 --difficulty easy --thickness 2,5,10
  List the recipes of specimens, and write the atoms of one:
    stemgen list
    stemgen specimen srtio3 --difficulty easy --grid 2x2 -o atoms.extxyz --png
  Build a world, draw it with its defects, and cut training tiles from it:
    stemgen build srtio3 --difficulty easy --grid 2x2
    stemgen view worlds/srtio3_easy_2x2.h5 --overlay defects
    stemgen tiles worlds/srtio3_easy_2x2.h5 --random-dose 1e3,1e5 -n 200 -o train.npz
  Record a tile as a microscope does, or a specimen that loses atoms under the beam:
    stemgen acquire worlds/srtio3_easy_2x2.h5 --profile routine -o tile.h5 --png
    stemgen live mos2 --difficulty easy --grid 1x1 --set optics.energy_kv=120 --dose-series 10 \\
      --dose 1e5 -o dying.h5 --animation
  Check the program against its references:
    stemgen validate --quick

`stemgen COMMAND --help` explains every option and has more examples. `stemgen glossary` explains
the terms.";

/// Text of `stemgen glossary`, which defines the terms of help and messages.
const GLOSSARY: &str = include_str!("../../docs/glossary.md");

#[derive(Debug, Subcommand)]
enum Command {
    Simulate(Box<simulate_command::Simulate>),
    Patterns(Box<patterns_command::Patterns>),
    Integrate(Box<integrate_command::Integrate>),
    Detectability(Box<detectability_command::Detectability>),
    Rerun(Box<rerun_command::Rerun>),
    Build(Box<build_command::Build>),
    Specimen(Box<specimen_command::SpecimenCommand>),
    View(Box<view_command::View>),
    Tiles(Box<tiles_command::Tiles>),
    Acquire(Box<acquire_command::Acquire>),
    Live(Box<live_command::Live>),
    Import(Box<import_command::ImportImage>),
    Audit(Box<audit_command::AuditCommand>),
    Regenerate(Box<regenerate_command::Regenerate>),
    Slurm(Box<slurm_command::Slurm>),
    Cache(Box<cache_command::CacheCommand>),
    Validate(Box<validate_command::Validate>),
    Compare(Box<compare_command::Compare>),
    Verify(Box<verify_command::Verify>),
    Info(Box<info_command::Info>),
    Card(Box<card_command::CardCommand>),
    List(Box<list_command::List>),
    ShowRecipe(Box<show_recipe_command::ShowRecipe>),
    /// Explain the terms of the program: window, mosaic, library, sub-tile, tail ...
    Glossary,
}

/// Runs the program `stemgen` with the arguments of this process, and reports errors.
pub fn main() -> ExitCode {
    ExitCode::from(run(Invocation::of_process()))
}

/// Runs the program once in a process, reports errors on standard error, and returns the exit code. Listens to signals, and starts
/// the threads of the whole process.
pub fn run(invocation: Invocation) -> u8 {
    let invocation = invocation.remember();
    // The process that reads an HDF5 file through has no options, and must not listen to signals.
    if let Some(ended) = hdf5_check::serve(&invocation.arguments) {
        return ended;
    }
    let done = |()| 0;
    if let Err(error) = signals::listen() {
        text::complain(&format!("warning: Ctrl-C ends the program at once: {error}"));
    }
    let command = match parse(invocation) {
        Ok(cli) => cli.command,
        Err(error) => {
            // If standard error is closed, no stream is left for the message.
            let _ = error.print();
            return u8::try_from(error.exit_code()).unwrap_or(u8::MAX);
        }
    };
    let (name, result) = match command {
        Command::Simulate(command) => ("simulate", command.run().map(done)),
        Command::Patterns(command) => ("patterns", command.run().map(done)),
        Command::Integrate(command) => ("integrate", command.run().map(done)),
        Command::Detectability(command) => ("detectability", command.run().map(done)),
        Command::Rerun(command) => ("rerun", command.run()),
        Command::Build(command) => ("build", command.run()),
        Command::Specimen(command) => ("specimen", command.run().map(done)),
        Command::View(command) => ("view", command.run().map(done)),
        Command::Acquire(command) => ("acquire", command.run().map(done)),
        Command::Live(command) => ("live", command.run().map(done)),
        Command::Import(command) => ("import", command.run().map(done)),
        Command::Tiles(command) => ("tiles", command.run().map(done)),
        Command::Audit(command) => ("audit", command.run()),
        Command::Regenerate(command) => ("regenerate", command.run()),
        Command::Slurm(command) => ("slurm", command.run().map(done)),
        Command::Cache(command) => ("cache", command.run()),
        Command::Validate(command) => ("validate", command.run()),
        Command::Compare(command) => ("compare", command.run()),
        Command::Verify(command) => ("verify", command.run()),
        Command::Info(command) => ("info", command.run().map(done)),
        Command::Card(command) => ("card", command.run().map(done)),
        Command::List(command) => ("list", command.run().map(done)),
        Command::ShowRecipe(command) => ("show-recipe", command.run().map(done)),
        Command::Glossary => ("glossary", text::print(GLOSSARY.trim_end()).map(done)),
    };
    result.unwrap_or_else(|error| hints::report(&error, name))
}

/// Parses the arguments.
fn parse(invocation: &Invocation) -> Result<Cli, clap::Error> {
    let mut definition = Cli::command();
    let program = OsString::from(PROGRAM);
    let words = std::iter::once(&program).chain(&invocation.arguments);
    let matches = definition.try_get_matches_from_mut(words).map_err(foreign_options::advised)?;
    Cli::from_arg_matches(&matches).map_err(|error| error.format(&mut definition))
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_definition_of_the_command_line_is_consistent() {
        super::Cli::command().debug_assert();
    }
}
