//! A separate process reads every HDF5 file of another program through before this one opens it.
//!
//! With some damaged files the HDF5 library hangs, dies, or takes all memory. So for a file that it has not just written, the program
//! starts itself once more. The second process reads the contents of the file and ends. If it ends without a fault, the program
//! opens the file, and reports errors of the contents itself.

use super::crash_note;
use super::invocation::Invocation;
use super::signals;
use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;
use stemgen::{Error, io};

/// First argument of the process that reads a file through; the second is the file.
const READ_THROUGH: &str = "hdf5-read-through";
/// Processor time in s that this process may take for an empty file ...
const SECONDS: u64 = 4;
/// ... and the bytes of the file for which it may take one second more.
const BYTES_PER_SECOND: u64 = 20_000_000;
/// Address space in bytes that it may take.
const MEMORY_BYTES: u64 = 2 << 30;
/// Pause between two looks whether the process has ended: the first, and the longest.
const LOOKS: [Duration; 2] = [Duration::from_micros(500), Duration::from_millis(20)];

/// Reads a file through if this process was started to do so, and returns its exit code.
pub fn serve(arguments: &[OsString]) -> Option<u8> {
    let [word, file, ..] = arguments else { return None };
    if word != OsStr::new(READ_THROUGH) {
        return None;
    }
    let file = Path::new(file);
    limit(file);
    // The process that opens the file next reports its errors.
    let _ = io::read_through(file);
    Some(0)
}

/// Limits the time and memory of this process, and ends it with the process that started it.
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
            // The call fails if the limit is lower already, which is good enough.
            let _ = setrlimit(resource, Rlimit { current: Some(most), maximum: Some(most) });
        }
        #[cfg(target_os = "linux")]
        let _ =
            rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL));
    }
    #[cfg(not(unix))]
    let _ = file;
}

/// Fails if reading an HDF5 file through ends the process that does it. Files of other kinds and missing files pass; their readers
/// report them.
///
/// # Errors
/// [`Error::Parse`] naming the file; [`Error::Interrupted`].
pub fn check(file: &Path) -> stemgen::Result<()> {
    survive(file)?;
    crash_note::name(file);
    Ok(())
}

/// Checks a file in a process that this program shares with another, such as Python, and whose signals it must not handle.
///
/// # Errors
/// [`Error::Parse`] naming the file; [`Error::Interrupted`].
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

/// Waits for a process, and returns its status; `None` if the user asked to stop.
fn wait(mut child: Child) -> std::io::Result<Option<ExitStatus>> {
    let mut pause = LOOKS[0];
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(if signals::asked_to_stop() { None } else { Some(status) });
        }
        if signals::asked_to_stop() {
            // The call fails if the process has ended meanwhile, and then it needs no signal.
            let _ = child.kill();
            child.wait()?;
            return Ok(None);
        }
        std::thread::sleep(pause);
        pause = (pause * 2).min(LOOKS[1]);
    }
}

/// Describes the fault of the file that the end of the process shows.
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
