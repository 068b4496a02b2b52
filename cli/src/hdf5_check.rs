//! HDF5 files of strangers are first read through by a process of their own.
//!
//! The HDF5 library does not come back from some damaged files: it hangs, dies, or takes all memory. The program therefore starts
//! itself once more for a file that it did not write just now; that process reads what the file holds and ends. If it ends in
//! order, the program opens the file and says itself what is wrong with it, if anything is.

use super::crash_note;
use super::invocation::Invocation;
use super::signals;
use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;
use stemgen::{Error, io};

/// First argument of the process that reads through the file in the second.
const READ_THROUGH: &str = "hdf5-read-through";
/// Processor time that it may take: so many seconds ...
const SECONDS: u64 = 4;
/// ... and one more for so many bytes of the file.
const BYTES_PER_SECOND: u64 = 20_000_000;
/// Addresses that it may take.
const MEMORY_BYTES: u64 = 2 << 30;
/// How long to wait before looking whether it has ended, at first and at most.
const LOOKS: [Duration; 2] = [Duration::from_micros(500), Duration::from_millis(20)];

/// Where this process was started for nothing but that, does it.
pub fn serve(arguments: &[OsString]) -> Option<u8> {
    let [word, file, ..] = arguments else { return None };
    if word != OsStr::new(READ_THROUGH) {
        return None;
    }
    let file = Path::new(file);
    limit(file);
    // Whoever opens the file next tells what is wrong with it.
    let _ = io::read_through(file);
    Some(0)
}

/// Limits what this process may take, and has it end with the one that started it.
fn limit(file: &Path) {
    #[cfg(unix)]
    {
        use rustix::process::{Resource, Rlimit, setrlimit};
        let bytes = std::fs::metadata(file).map_or(0, |m| m.len());
        let limits = [
            (Resource::Core, 0),
            (Resource::Cpu, SECONDS + bytes / BYTES_PER_SECOND),
            (Resource::As, MEMORY_BYTES),
        ];
        for (resource, most) in limits {
            // A limit that is lower already stays.
            let _ = setrlimit(resource, Rlimit { current: Some(most), maximum: Some(most) });
        }
        #[cfg(target_os = "linux")]
        let _ =
            rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL));
    }
    #[cfg(not(unix))]
    let _ = file;
}

/// Fails if reading through an HDF5 file ends the process that does it. Files of other kinds, and those that are not there, are
/// left to their readers.
///
/// # Errors
/// [`Error::Parse`] naming the file; [`Error::Interrupted`].
pub fn check(file: &Path) -> stemgen::Result<()> {
    survive(file)?;
    crash_note::name(file);
    Ok(())
}

/// The same check for a process that is not this program alone, and whose signals are not its own.
///
/// # Errors
/// As there.
pub fn survive(file: &Path) -> stemgen::Result<()> {
    if !file.is_file() {
        return Ok(());
    }
    let again = Invocation::now().again().map_err(|e| Error::io(file, "check", e))?;
    let started = Command::new(&again[0])
        .args(&again[1..])
        .arg(READ_THROUGH)
        .arg(file)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    let ended = started.map_err(|e| Error::io(file, "start a process that checks", e))?;
    let ended = wait(ended).map_err(|e| Error::io(file, "check", e))?;
    match ended {
        None => Err(Error::Interrupted),
        Some(status) if status.success() => Ok(()),
        Some(status) => Err(Error::parse(
            file,
            0,
            format!("is damaged: {}; copy or build it again", said(status)),
        )),
    }
}

/// How a process ended; `None` where the user asked to stop.
fn wait(mut child: Child) -> std::io::Result<Option<ExitStatus>> {
    let mut pause = LOOKS[0];
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(if signals::asked_to_stop() { None } else { Some(status) });
        }
        if signals::asked_to_stop() {
            // It may have ended meanwhile.
            let _ = child.kill();
            child.wait()?;
            return Ok(None);
        }
        std::thread::sleep(pause);
        pause = (pause * 2).min(LOOKS[1]);
    }
}

/// What the end of the process says of the file.
fn said(status: ExitStatus) -> String {
    #[cfg(unix)]
    {
        use std::os::unix::process::ExitStatusExt;
        match status.signal() {
            Some(libc::SIGXCPU) => {
                return format!("the HDF5 library reads in it for more than {SECONDS} s");
            }
            Some(signal) => return format!("the HDF5 library dies of it (signal {signal})"),
            None => {}
        }
    }
    format!("it cannot be read through ({status})")
}
