//! How the program was started: as a program, or in a process of the Python package, which installs it too.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::OnceLock;

/// The name of the program.
pub const PROGRAM: &str = "stemgen";

/// How the program was started.
#[derive(Debug, Clone)]
pub struct Invocation {
    /// The words after the name of the program.
    pub arguments: Vec<OsString>,
    /// Program and first arguments that start it once more; if empty, the file of this program.
    pub again: Vec<OsString>,
}

static CALLED: OnceLock<Invocation> = OnceLock::new();

impl Invocation {
    /// Returns the start of `stemgen` with the arguments of this process.
    pub fn of_process() -> Self {
        let arguments = std::env::args_os().skip(1).collect();
        Invocation { arguments, again: Vec::new() }
    }

    /// Stores this start for the process, unless another is stored already; returns the stored one.
    pub fn remember(self) -> &'static Self {
        CALLED.get_or_init(|| self)
    }

    /// Returns how this process was started.
    pub fn now() -> &'static Self {
        CALLED.get_or_init(Self::of_process)
    }

    /// Returns program and first arguments that start it once more.
    ///
    /// # Errors
    /// Errors of the system that does not find the file of this program.
    pub fn again(&self) -> std::io::Result<Vec<OsString>> {
        if !self.again.is_empty() {
            return Ok(self.again.clone());
        }
        // This link works even if the file of the program was replaced while it runs.
        let program = match cfg!(target_os = "linux") {
            true => PathBuf::from("/proc/self/exe"),
            false => std::env::current_exe()?,
        };
        Ok(vec![program.into_os_string()])
    }
}
