//! The `stemgen` program.

fn main() -> std::process::ExitCode {
    stemgen_cli::main()
}
