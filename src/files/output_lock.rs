//! Locks for outputs, so that only one process writes an output.

use super::outputs::{LOCK, beside};
use super::unfinished::Unfinished;
use crate::error::{Error, Result};
use crate::setting::Setting;
use std::fs::File;
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The right to write an output: a locked file `<output>.lock` beside it, which names the holder. The system releases the lock whenever the
/// process ends; the file is removed when this value is dropped.
#[derive(Debug)]
pub struct OutputLock {
    path: PathBuf,
    /// The open file holds the lock.
    file: File,
    _unfinished: Option<Unfinished>,
}

/// Other holders that a lock allows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Holders {
    /// No other process.
    One,
    /// Other processes that share the lock.
    Several,
}

impl OutputLock {
    /// Locks `output` for this process. The folder must exist. If the system has no locks, the output is not locked.
    ///
    /// # Errors
    /// [`Error::Locked`] naming the holder, [`Error::Io`].
    pub fn hold(output: &Path) -> Result<Self> {
        Self::lock(output, Holders::One)
    }

    /// Locks `output` for this process together with all processes that make parts of it.
    ///
    /// # Errors
    /// As [`OutputLock::hold`], if a process holds the lock alone.
    pub fn share(output: &Path) -> Result<Self> {
        Self::lock(output, Holders::Several)
    }

    fn lock(output: &Path, holders: Holders) -> Result<Self> {
        let path = beside(output, LOCK);
        let foreign = || {
            let why = "is no lock of this program, and the build would replace it; move it away, or name another output";
            Err(Error::invalid(Setting::Output, path.display(), why))
        };
        let mut patience = match holders {
            Holders::One => MOMENTS,
            Holders::Several => MANY_MOMENTS,
        };
        loop {
            let fail = |e| Error::io(&path, "create", e);
            // Through a link, a file elsewhere would be made or changed.
            if std::fs::symlink_metadata(&path).is_ok_and(|there| !there.is_file()) {
                return foreign();
            }
            let mut file = File::options()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .open(&path)
                .map_err(fail)?;
            if !try_lock(&file, holders).map_err(fail)? {
                // If the name of the holder cannot be read, the message is less informative, but the lock still holds.
                let found = beginning(&file).unwrap_or_default();
                // The last of the processes that share the lock holds it alone for a moment.
                if found.starts_with(SHARED) && patience > 0 {
                    patience -= 1;
                    std::thread::sleep(MOMENT);
                    continue;
                }
                let holder = match found.trim() {
                    text if text.starts_with(PROCESS) => text.to_owned(),
                    _ => "another process".to_owned(),
                };
                return Err(Error::Locked { path: output.to_owned(), holder });
            }
            // The last holder may have removed the file between opening and locking.
            if !is_still(&file, &path) {
                continue;
            }
            // The file is empty if its holder ended between making and filling it.
            let found = beginning(&file).map_err(fail)?;
            if !(found.is_empty() || found.starts_with(PROCESS)) {
                return foreign();
            }
            let write = |file: &mut File| {
                file.set_len(0)?;
                file.rewind()?;
                writeln!(file, "{}", myself())?;
                file.flush()
            };
            let unfinished = match holders {
                Holders::One => {
                    write(&mut file).map_err(fail)?;
                    Some(Unfinished::at(&path))
                }
                Holders::Several if found.starts_with(SHARED) => None,
                Holders::Several => {
                    // All processes that share the lock write the same text.
                    file.set_len(0).and_then(|()| file.rewind()).map_err(fail)?;
                    file.write_all(SHARED.as_bytes()).map_err(fail)?;
                    None
                }
            };
            return Ok(OutputLock { path, file, _unfinished: unfinished });
        }
    }
}

impl Drop for OutputLock {
    fn drop(&mut self) {
        // A lock file that stays behind holds no lock. The last of the processes that share it removes it.
        if !try_lock(&self.file, Holders::One).unwrap_or(false) {
            return;
        }
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Number and length of the waits for a shared lock. A process that wants the lock alone waits [`MOMENTS`] times: it is refused while
/// others share the lock. A process that shares it waits [`MANY_MOMENTS`] times: only the last sharer's moment keeps it out, even on a slow
/// machine.
const MOMENTS: usize = 10;
const MANY_MOMENTS: usize = 500;
const MOMENT: Duration = Duration::from_millis(20);
/// Prefix of the text in a lock.
const PROCESS: &str = "process ";
/// The text in a shared lock.
const SHARED: &str = "process that makes a part of it (a shard)\n";
/// Number of bytes of a lock that are read.
const READ_BYTES: u64 = 1 << 16;

/// Returns the first part of a file; bytes that are no text are replaced.
fn beginning(file: &File) -> std::io::Result<String> {
    let mut bytes = Vec::new();
    file.take(READ_BYTES).read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Describes this process for others: `process 1234 on host (stemgen build srtio3 ...)`.
fn myself() -> String {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let on = match host.trim() {
        "" => String::new(),
        host => format!(" on {host}"),
    };
    let words: Vec<String> =
        std::env::args_os().skip(1).map(|a| a.to_string_lossy().into_owned()).collect();
    let command = match words.is_empty() {
        true => String::new(),
        false => format!(" ({})", words.join(" ").replace('\n', " ")),
    };
    format!("{PROCESS}{}{on}{command}", std::process::id())
}

#[cfg(unix)]
fn try_lock(file: &File, holders: Holders) -> std::io::Result<bool> {
    use rustix::fs::{FlockOperation, flock};
    let operation = match holders {
        Holders::One => FlockOperation::NonBlockingLockExclusive,
        Holders::Several => FlockOperation::NonBlockingLockShared,
    };
    match flock(file, operation) {
        Ok(()) => Ok(true),
        Err(rustix::io::Errno::WOULDBLOCK) => Ok(false),
        // The file system has no locks.
        Err(rustix::io::Errno::NOTSUP | rustix::io::Errno::NOSYS | rustix::io::Errno::NOLCK) => {
            Ok(true)
        }
        Err(e) => Err(e.into()),
    }
}

#[cfg(not(unix))]
fn try_lock(_: &File, _: Holders) -> std::io::Result<bool> {
    Ok(true)
}

/// Whether `path` still names the open file.
fn is_still(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let id = |m: std::io::Result<std::fs::Metadata>| m.ok().map(|m| (m.dev(), m.ino()));
        let open = id(file.metadata());
        open.is_some() && open == id(std::fs::metadata(path))
    }
    #[cfg(not(unix))]
    {
        let _ = (file, path);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn an_output_is_held_by_one_and_given_back() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("w.h5");
        let first = OutputLock::hold(&output).unwrap();
        let message = OutputLock::hold(&output).unwrap_err().to_string();
        let own = format!("process {}", std::process::id());
        assert!(message.contains("w.h5") && message.contains(&own), "{message}");
        OutputLock::hold(&folder.path().join("other.h5")).unwrap();
        drop(first);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        // Lock files that a killed process leaves.
        for left in ["process 1", ""] {
            std::fs::write(folder.path().join("w.h5.lock"), left).unwrap();
            OutputLock::hold(&output).unwrap();
        }
    }

    #[cfg(unix)]
    #[test]
    fn shards_share_an_output_and_the_end_is_alone() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("w.h5");
        let shards: Vec<_> = (0..3).map(|_| OutputLock::share(&output).unwrap()).collect();
        let reply = OutputLock::hold(&output).unwrap_err().to_string();
        assert!(reply.contains("a shard"), "{reply}");
        let mut shards = shards.into_iter();
        drop(shards.next());
        assert!(OutputLock::hold(&output).is_err());
        shards.for_each(drop);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let end = OutputLock::hold(&output).unwrap();
        let reply = OutputLock::share(&output).unwrap_err().to_string();
        assert!(reply.contains(&format!("process {}", std::process::id())), "{reply}");
        drop(end);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[cfg(unix)]
    #[test]
    fn files_of_others_under_the_name_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let refused = || {
            let reply = OutputLock::hold(&at("w.h5")).unwrap_err().to_string();
            assert!(
                reply.contains("w.h5.lock") && reply.contains("no lock of this program"),
                "{reply}"
            );
        };
        for precious in [&b"my notes"[..], b"\xff\xfe", b"\n"] {
            std::fs::write(at("w.h5.lock"), precious).unwrap();
            refused();
            assert_eq!(std::fs::read(at("w.h5.lock")).unwrap(), precious);
        }
        std::fs::remove_file(at("w.h5.lock")).unwrap();
        std::os::unix::fs::symlink(at("elsewhere"), at("w.h5.lock")).unwrap();
        refused();
        assert!(!at("elsewhere").exists() && at("w.h5.lock").is_symlink());
        std::fs::remove_file(at("w.h5.lock")).unwrap();
        std::fs::create_dir(at("w.h5.lock")).unwrap();
        refused();
    }
}
