//! How the program was called: by itself, or in a process of the Python package, which installs it too.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::OnceLock;

/// The name of the program.
pub const PROGRAM: &str = "stemgen";

/// How the program was called.
#[derive(Debug, Clone)]
pub struct Invocation {
    /// What was typed behind the name of the program.
    pub arguments: Vec<OsString>,
    /// Program and first arguments that start it once more; this program by itself when empty.
    pub again: Vec<OsString>,
}

static CALLED: OnceLock<Invocation> = OnceLock::new();

impl Invocation {
    /// `stemgen` with the arguments of this process.
    pub fn of_process() -> Self {
        let arguments = std::env::args_os().skip(1).collect();
        Invocation { arguments, again: Vec::new() }
    }

    /// Makes it the one of this process, if there was none before.
    pub fn remember(self) -> &'static Self {
        CALLED.get_or_init(|| self)
    }

    /// The one of this process.
    pub fn now() -> &'static Self {
        CALLED.get_or_init(Self::of_process)
    }

    /// Program and first arguments that start it once more.
    ///
    /// # Errors
    /// Those of the system.
    pub fn again(&self) -> std::io::Result<Vec<OsString>> {
        if !self.again.is_empty() {
            return Ok(self.again.clone());
        }
        // Also where the file of the program was replaced meanwhile.
        let program = match cfg!(target_os = "linux") {
            true => PathBuf::from("/proc/self/exe"),
            false => std::env::current_exe()?,
        };
        Ok(vec![program.into_os_string()])
    }
}
