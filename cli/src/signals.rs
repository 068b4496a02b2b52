//! Ctrl-C and other signals that ask the program to end.
//!
//! After the first signal, the running command stops at a point from which it can continue. If it has not stopped after a second, or
//! at the second signal, the program removes unfinished files and ends at once. A signal that was ignored when the program began
//! (SIGHUP under `nohup`) stays ignored.

use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, LazyLock};

/// Number of the last signal; 0 before the first. The handler sets it, so that the interrupted thread sees it at once.
static SIGNAL: LazyLock<Arc<AtomicUsize>> = LazyLock::new(Arc::default);

/// Number of SIGINT, used if no other number is known.
const INTERRUPT: usize = 2;

/// Whether the program was asked to stop.
pub fn asked_to_stop() -> bool {
    SIGNAL.load(Relaxed) != 0
}

/// Returns the exit code of an interrupted program, as shells define it: 128 plus the number of the signal.
pub fn exit_code() -> u8 {
    let signal = match SIGNAL.load(Relaxed) {
        0 => INTERRUPT,
        signal => signal,
    };
    128 + u8::try_from(signal).unwrap_or_default()
}

/// Listens to signals from now on.
///
/// # Errors
/// Errors of the system that refuses a handler or a thread.
#[cfg(unix)]
pub fn listen() -> std::io::Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let heard = || [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|s| !unix::is_ignored(*s));
    unix::ignore_file_size();
    for signal in heard() {
        let number = usize::try_from(signal).unwrap_or(INTERRUPT);
        signal_hook::flag::register_usize(signal, SIGNAL.clone(), number)?;
    }
    let signals = signal_hook::iterator::Signals::new(heard())?;
    std::thread::Builder::new().name("signals".into()).spawn(move || unix::serve(signals))?;
    Ok(())
}

/// Does nothing: on other systems a signal ends the program.
///
/// # Errors
/// None.
#[cfg(not(unix))]
pub fn listen() -> std::io::Result<()> {
    Ok(())
}

#[cfg(unix)]
mod unix {
    use crate::signals::exit_code;
    use crate::text;
    use signal_hook::iterator::Signals;
    use std::time::Duration;
    use stemgen::files::unfinished;

    /// Time after which a program that has not stopped is ended.
    const GRACE: Duration = Duration::from_secs(1);

    pub fn serve(mut signals: Signals) {
        for (before, _) in signals.forever().enumerate() {
            if before > 0 {
                end();
            }
            text::complain("\nstopping; the same signal again stops at once");
            let late = std::thread::Builder::new().name("grace".into()).spawn(|| {
                std::thread::sleep(GRACE);
                end();
            });
            if late.is_err() {
                end();
            }
        }
    }

    /// Ends the program at once. Its threads may be inside HDF5, so no clean-up code of theirs is run.
    fn end() -> ! {
        unfinished::remove_all();
        text::complain("error: interrupted");
        text::complain("hint: run the command again; a build continues from its finished work");
        signal_hook::low_level::exit(exit_code().into())
    }

    /// Ignores SIGXFSZ, so that a limit of file sizes (`ulimit -f`, quotas) makes a write fail with an error. The signal would end the
    /// program without a message.
    #[allow(unsafe_code)]
    pub fn ignore_file_size() {
        // SAFETY: no handler is installed, and no thread but this one runs yet.
        unsafe {
            libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
        }
    }

    /// Whether a signal was ignored when the program started.
    #[allow(unsafe_code)]
    pub fn is_ignored(signal: i32) -> bool {
        // SAFETY: with no new action the call writes the present one to `found`, for which all zeros are a valid value.
        unsafe {
            let mut found: libc::sigaction = std::mem::zeroed();
            libc::sigaction(signal, std::ptr::null(), &raw mut found) == 0
                && found.sa_sigaction == libc::SIG_IGN
        }
    }
}
