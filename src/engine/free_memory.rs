//! The memory that a simulation may use: the machine's free memory, and limits on the process.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// Limits above this value mean no limit. Version 1 of control groups writes about 2^63.
const NO_LIMIT: u64 = 1 << 60;

/// Fails if fewer bytes are free than are needed.
///
/// # Errors
/// [`Error::Memory`], with `remedy` as advice.
pub fn check_memory(needed_bytes: u64, remedy: &str) -> Result<()> {
    match free_memory() {
        Some(free_bytes) if free_bytes < needed_bytes => {
            Err(Error::Memory { needed_bytes, free_bytes, remedy: remedy.to_owned() })
        }
        _ => Ok(()),
    }
}

/// Bytes of memory that this process may still allocate, or `None` where the system does not report it. It is the least of three: the
/// machine's free memory, the rest in the process's control groups (containers, batch systems), and the rest below its limit of addresses
/// (`ulimit -v`).
pub(crate) fn free_memory() -> Option<u64> {
    [machine(), of_groups(Path::new("/")), of_addresses()].into_iter().flatten().min()
}

fn machine() -> Option<u64> {
    kilobytes(Path::new("/proc/meminfo"), "MemAvailable:")
}

fn of_addresses() -> Option<u64> {
    #[cfg(target_os = "linux")]
    {
        let limit = rustix::process::getrlimit(rustix::process::Resource::As).current?;
        let taken = kilobytes(Path::new("/proc/self/status"), "VmSize:")?;
        Some(limit.saturating_sub(taken))
    }
    #[cfg(not(target_os = "linux"))]
    None
}

/// Bytes left in the control groups of this process, below `root` of the file system. A group is limited by the groups that contain it.
fn of_groups(root: &Path) -> Option<u64> {
    let groups = fs::read_to_string(root.join("proc/self/cgroup")).ok()?;
    let mounted = root.join("sys/fs/cgroup");
    let of_line = |line: &str| {
        let mut parts = line.splitn(3, ':');
        let (_, controllers, path) = (parts.next()?, parts.next()?, parts.next()?);
        let path = path.trim_start_matches('/');
        // Version 2 has one tree, whose line names no controllers; version 1 one for each controller.
        match controllers {
            "" => Some(chain(&mounted, path, ["memory.max", "memory.current"])),
            some if some.split(',').any(|c| c == "memory") => {
                let files = ["memory.limit_in_bytes", "memory.usage_in_bytes"];
                Some(chain(&mounted.join("memory"), path, files))
            }
            _ => None,
        }
    };
    groups.lines().filter_map(of_line).flatten().min()
}

/// Bytes left in each group from `path` up to the top of a tree, for groups with a limit.
fn chain(top: &Path, path: &str, [limit, taken]: [&str; 2]) -> Vec<u64> {
    let groups: Vec<PathBuf> = Path::new(path).ancestors().map(|group| top.join(group)).collect();
    let left = |group: &PathBuf| {
        let limit = number(&group.join(limit)).filter(|l| *l < NO_LIMIT)?;
        let taken = number(&group.join(taken))?;
        // The system frees pages of files when memory is needed.
        let cached = statistic(&group.join("memory.stat"), "inactive_file").unwrap_or_default();
        Some(limit.saturating_sub(taken.saturating_sub(cached)))
    };
    groups.iter().filter_map(left).collect()
}

/// The number in a file; `None` for `max`.
fn number(path: &Path) -> Option<u64> {
    fs::read_to_string(path).ok()?.trim().parse().ok()
}

/// Bytes of a line `name N kB`.
fn kilobytes(path: &Path, name: &str) -> Option<u64> {
    statistic(path, name)?.checked_mul(1024)
}

fn statistic(path: &Path, name: &str) -> Option<u64> {
    let text = fs::read_to_string(path).ok()?;
    let line = text.lines().find(|l| l.split_whitespace().next() == Some(name))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file system with some files.
    fn root(files: &[(&str, &str)]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for (path, text) in files {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        root
    }

    #[test]
    fn the_tightest_control_group_counts() {
        let v2 = root(&[
            ("proc/self/cgroup", "0::/job/step\n"),
            ("sys/fs/cgroup/job/memory.max", "5000\n"),
            ("sys/fs/cgroup/job/memory.current", "3000\n"),
            ("sys/fs/cgroup/job/memory.stat", "anon 2000\ninactive_file 1000\n"),
            ("sys/fs/cgroup/job/step/memory.max", "max\n"),
            ("sys/fs/cgroup/job/step/memory.current", "10\n"),
        ]);
        assert_eq!(of_groups(v2.path()), Some(3000));
        let v1 = root(&[
            ("proc/self/cgroup", "5:cpu:/\n4:memory:/box\n0::/\n"),
            ("sys/fs/cgroup/memory/box/memory.limit_in_bytes", "900\n"),
            ("sys/fs/cgroup/memory/box/memory.usage_in_bytes", "1000\n"),
            ("sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n"),
            ("sys/fs/cgroup/memory/memory.usage_in_bytes", "1\n"),
        ]);
        assert_eq!(of_groups(v1.path()), Some(0));
        let none = root(&[("proc/self/cgroup", "0::/\n")]);
        assert_eq!(of_groups(none.path()), None);
        assert_eq!(of_groups(Path::new("/nowhere")), None);
    }

    #[test]
    fn what_no_machine_has_is_refused() {
        if free_memory().is_some() {
            let message = check_memory(1 << 60, "one thread takes less").unwrap_err().to_string();
            assert!(message.contains("are free") && message.contains("one thread"), "{message}");
        }
        check_memory(0, "").unwrap();
    }
}
