//! How the tests start processes.

use std::ffi::OsStr;
use std::os::unix::process::CommandExt;
use std::process::Command;

/// A process that inherits no open file. HDF5 locks what it writes and does not close it in children: a child that another test starts
/// at that moment would hold the lock for as long as it runs.
pub fn process(program: impl AsRef<OsStr>) -> Command {
    const CLOSE_ON_EXEC: libc::c_uint = 4;
    let mut command = Command::new(program);
    // SAFETY: a system call alone, between fork and exec.
    unsafe {
        command.pre_exec(|| {
            libc::syscall(libc::SYS_close_range, 3, libc::c_uint::MAX, CLOSE_ON_EXEC);
            Ok(())
        });
    }
    command
}
