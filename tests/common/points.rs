//! Programs that meet a signal or an error at a named call of the system, and not at a moment of the clock: `strace` delivers it.
//!
//! A signal that ends or holds the program (KILL, STOP) is sent when the call begins. KILL ends the program before the call takes
//! effect; every other signal arrives when the call is done.

#![allow(dead_code, reason = "each program of tests uses its part")]

use super::skipped::skipped;
use std::ffi::OsString;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::LazyLock;
use std::time::Duration;

/// A call of the system, as strace names it.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    /// What the program does there, in words.
    pub name: &'static str,
    pub call: &'static str,
    /// Only calls that name this file count, as the program names it; all of them if empty. A relative name lies below the folder of
    /// the program.
    pub path: &'static str,
    /// Which of these calls of one thread it is, from 1.
    pub count: usize,
}

impl Point {
    /// The first call on a file.
    pub const fn on(name: &'static str, call: &'static str, path: &'static str) -> Point {
        Point { name, call, path, count: 1 }
    }
}

/// Whether programs can be traced here; says so where they cannot. `STEMGEN_REQUIRE_STRACE` makes that a failure.
pub fn can_trace() -> bool {
    static CAN: LazyLock<bool> = LazyLock::new(|| {
        let run = Command::new("strace").args(["-qq", "-o", "/dev/null", "true"]).output();
        run.is_ok_and(|o| o.status.success())
    });
    let needed = std::env::var_os("STEMGEN_REQUIRE_STRACE").is_some();
    assert!(*CAN || !needed, "strace cannot trace programs here");
    if !*CAN {
        skipped("strace is not installed, or may not trace (apt-get install strace)");
    }
    *CAN
}

/// The same command below strace, which injects `what` at a point and writes what it sees to `log`.
fn traced(command: &Command, point: Point, what: &str, log: &Path) -> Command {
    let mut strace = Command::new("strace");
    strace.args(["-f", "-qq", "-o"]).arg(log);
    strace.args(["-e", &format!("trace={}", point.call)]);
    let inject = format!("inject={}:{what}:when={}", point.call, point.count);
    strace.args(["-e", &inject]);
    if let Some(folder) = command.get_current_dir() {
        strace.current_dir(folder);
        if !point.path.is_empty() {
            // Calls on open files are known by their whole names.
            let whole = folder.canonicalize().unwrap().join(point.path);
            strace.args(["-P", point.path]).arg("-P").arg(whole);
        }
    }
    strace.arg("--").arg(command.get_program()).args(command.get_args());
    let changed: Vec<(OsString, Option<OsString>)> =
        command.get_envs().map(|(k, v)| (k.to_owned(), v.map(ToOwned::to_owned))).collect();
    for (name, value) in changed {
        match value {
            Some(value) => strace.env(name, value),
            None => strace.env_remove(name),
        };
    }
    strace.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    strace
}

/// Runs a command that meets `what` (`signal=SIGTERM`, `error=ENOSPC`) at a point; returns how it ended.
///
/// # Panics
/// If the program ends without coming to that point: the test then tests nothing.
pub fn meets(command: &Command, point: Point, what: &str) -> Output {
    let beside = tempfile::tempdir().unwrap();
    let log = beside.path().join("log");
    let output = traced(command, point, what, &log).output().unwrap();
    let log = std::fs::read_to_string(log).unwrap();
    let struck = match what.split_once('=').unwrap() {
        ("signal", "SIGKILL") => output.status.code().is_none(),
        ("signal", signal) => log.contains(&format!("--- {signal} ")),
        _ => log.contains("(INJECTED)"),
    };
    let printed = String::from_utf8_lossy(&output.stderr);

    assert!(struck, "{what} did not meet {point:?}: {:?} {printed}\n{log}", output.status);
    output
}

/// A program that stands still just after a call.
#[derive(Debug)]
pub struct Held {
    /// strace, which ends with the program and as the program does.
    strace: Option<Child>,
    program: i32,
    _log: tempfile::TempDir,
}

impl Held {
    /// Starts a command and waits until it stands still.
    ///
    /// # Panics
    /// If the program ends before.
    pub fn at(command: &Command, point: Point) -> Held {
        let beside = tempfile::tempdir().unwrap();
        let log = beside.path().join("log");
        let mut strace = traced(command, point, "signal=SIGSTOP", &log).spawn().unwrap();
        loop {
            let text = std::fs::read_to_string(&log).unwrap_or_default();
            let stopped = text.lines().find(|line| line.ends_with("--- stopped by SIGSTOP ---"));
            if let Some(line) = stopped {
                let thread = line.split_whitespace().next().unwrap().parse().unwrap();
                let program = status_of(thread, "Tgid:");
                return Held { strace: Some(strace), program, _log: beside };
            }
            if strace.try_wait().unwrap().is_some() {
                let ended = strace.wait_with_output().unwrap();
                let printed = String::from_utf8_lossy(&ended.stderr);
                panic!(
                    "the program did not come to {point:?}: {:?} {printed}\n{text}",
                    ended.status
                );
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Number of the process.
    pub fn id(&self) -> i32 {
        self.program
    }

    /// Number of the process that started this one: the traced program itself, where a process of its own stands still.
    pub fn parent(&self) -> i32 {
        status_of(self.program, "PPid:")
    }

    /// Waits for the end of the traced program while a process of its own stands still.
    pub fn wait(mut self) -> Output {
        self.strace.take().unwrap().wait_with_output().unwrap()
    }

    /// Sends a signal, which the program hears when it goes on.
    pub fn send(&self, signal: i32) {
        // SAFETY: a process that strace has not seen end, so its number is no other's.
        assert_eq!(unsafe { libc::kill(self.program, signal) }, 0);
    }

    /// Lets the program go on to its end.
    pub fn go_on(mut self) -> Output {
        self.send(libc::SIGCONT);
        self.strace.take().unwrap().wait_with_output().unwrap()
    }

    /// Ends the program where it stands.
    pub fn kill(mut self) {
        self.send(libc::SIGKILL);
        self.strace.take().unwrap().wait().unwrap();
    }
}

impl Drop for Held {
    /// Nothing of a test that fails stays.
    fn drop(&mut self) {
        if let Some(mut strace) = self.strace.take() {
            // SAFETY: as in `send`.
            unsafe { libc::kill(self.program, libc::SIGKILL) };
            let _ = strace.wait();
        }
    }
}

/// A number that the system tells of a process or thread.
fn status_of(thread: i32, field: &str) -> i32 {
    let status = std::fs::read_to_string(format!("/proc/{thread}/status")).unwrap();
    let value = status.lines().find_map(|line| line.strip_prefix(field)).unwrap();
    value.trim().parse().unwrap()
}
