//! The `stemgen` program.

fn main() -> std::process::ExitCode {
    stemgen::cli::main()
}
