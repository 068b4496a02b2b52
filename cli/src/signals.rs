//! Ctrl-C and other wishes of the system that the program end.
//!
//! The first signal asks: what runs stops where it can be gone on from, and says so. What has not ended a second later, or at the
//! second signal, is ended then, whatever it does; unfinished files are removed first. A signal that was ignored when the program
//! began (SIGHUP under `nohup`) stays ignored.

use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, LazyLock};

/// Number of the signal that came last, 0 before. The handler itself sets it, so the thread that a signal meets knows of it at once.
static SIGNAL: LazyLock<Arc<AtomicUsize>> = LazyLock::new(Arc::default);

/// Number of SIGINT, where no other is known.
const INTERRUPT: usize = 2;

/// Whether the program was asked to stop.
pub fn asked_to_stop() -> bool {
    SIGNAL.load(Relaxed) != 0
}

/// The exit code of a program that was interrupted, as shells have it: 128 and the number of the signal.
pub fn exit_code() -> u8 {
    let signal = match SIGNAL.load(Relaxed) {
        0 => INTERRUPT,
        signal => signal,
    };
    128 + u8::try_from(signal).unwrap_or_default()
}

/// Listens from now on.
///
/// # Errors
/// Those of the system.
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

/// Elsewhere the system ends the program.
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

    /// How long the program has to end by itself.
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

    /// Ends the program without asking its threads: they may be anywhere, in HDF5 too, so nothing of theirs is run.
    fn end() -> ! {
        unfinished::remove_all();
        text::complain("error: interrupted");
        text::complain("hint: run the same command again; a build goes on from what it has kept");
        signal_hook::low_level::exit(exit_code().into())
    }

    /// A limit of the size of files (`ulimit -f`, quotas) is then an error of the write, which is told, in place of a signal that ends
    /// the program without a word.
    #[allow(unsafe_code)]
    pub fn ignore_file_size() {
        // SAFETY: no handler is installed, and no thread but this one runs yet.
        unsafe {
            libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
        }
    }

    /// Whether the program was started with a signal ignored.
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
