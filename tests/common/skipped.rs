//! What a test says that cannot check its promise on this machine.

use std::io::Write;

/// Prints `SKIPPED: reason` straight to standard error: the test harness keeps what tests that pass print
/// with `eprintln!` to itself.
pub fn skipped(reason: &str) {
    let line = format!("SKIPPED: {reason}\n");
    std::io::stderr().write_all(line.as_bytes()).expect("standard error is open");
}
