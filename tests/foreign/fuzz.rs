//! Fuzzing. Every target runs in a process of its own, so that whatever ends it (a panic, an abort, a stack that
//! overflows, a hang) is found and named by the number of the input.
//!
//! `STEMGEN_FUZZ=1000000 cargo test --release --test foreign fuzz` runs so many executions of each target;
//! `STEMGEN_FUZZ_FROM` is the number of the first. Inputs that fail are kept in the target folder, under `tmp`.

use std::panic::catch_unwind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use super::allocation::watch;
use super::hdf5_process::read_by_the_program;
use super::targets::Target;

/// Executions of each target unless `STEMGEN_FUZZ` says otherwise.
const USUAL: u64 = 2000;
/// Seconds of processor time, and bytes, that a reader may take for a file. Files of this size take milliseconds: the seconds are a
/// guard, which no machine is slow enough to meet.
const MOST_SECONDS: f64 = 100.0;
const MOST_BYTES: usize = 1 << 30;
/// After so many seconds of processor time an execution hangs.
const HANGS_SECONDS: f64 = 200.0;

fn number(variable: &str) -> Option<u64> {
    std::env::var(variable).ok()?.parse().ok()
}

macro_rules! targets {
    ($($name:ident)*) => {$(
        #[test]
        fn $name() {
            campaign(stringify!($name));
        }
    )*};
}

targets! { cif xyz poscar recipe set npy npz zarr tif dm hdf5_bytes hdf5_shapes }

/// Runs a target in other processes, one after another if they end early.
fn campaign(name: &'static str) {
    let count = number("STEMGEN_FUZZ").unwrap_or(USUAL);
    let first = number("STEMGEN_FUZZ_FROM").unwrap_or(0);
    let target = Target::new(name);
    let folder = tempfile::tempdir().unwrap();
    let note = folder.path().join("note");
    let (mut next, mut accepted, mut deaths, mut findings) = (first, 0, 0, Vec::new());
    while next < first + count && findings.len() < 20 {
        let run = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "fuzz::executions", "--ignored", "--nocapture"])
            .env("STEMGEN_FUZZ_TARGET", name)
            .env("STEMGEN_FUZZ_NOTE", &note)
            .env("STEMGEN_FUZZ_FROM", next.to_string())
            .env("STEMGEN_FUZZ", (first + count - next).to_string())
            .output()
            .unwrap();
        let [at, fine] = read_note(&note);
        accepted += fine;
        if run.status.success() && at == first + count {
            break;
        }
        let printed = String::from_utf8_lossy(&run.stderr);
        let printed: Vec<&str> = printed.lines().filter(|l| !l.trim().is_empty()).take(4).collect();
        let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{at}"));
        std::fs::write(&kept, target.input(at)).unwrap();
        next = at + 1;
        // Of these files the library itself may die; the program then says so.
        if name == "hdf5_bytes" && read_by_the_program(&kept).is_ok() {
            std::fs::remove_file(&kept).unwrap();
            deaths += 1;
            continue;
        }
        findings.push(format!("{}: {} {}", kept.display(), run.status, printed.join(" | ")));
    }
    println!(
        "{name}: {count} executions from {first}, {accepted} accepted, the library died of {deaths}, {} findings",
        findings.len()
    );
    assert!(findings.is_empty(), "{}", findings.join("\n"));
}

/// The number of the execution that runs (or of the one after the last), and how many were accepted.
fn read_note(note: &Path) -> [u64; 2] {
    let text = std::fs::read_to_string(note).unwrap_or_default();
    let mut numbers = text.split_whitespace().map(|n| n.parse().unwrap());
    [numbers.next().unwrap(), numbers.next().unwrap()]
}

/// The number of the current execution.
static CURRENT: AtomicU64 = AtomicU64::new(0);

#[test]
#[ignore = "started by the targets"]
fn executions() {
    let Ok(name) = std::env::var("STEMGEN_FUZZ_TARGET") else { return };
    let note = PathBuf::from(std::env::var_os("STEMGEN_FUZZ_NOTE").unwrap());
    let (first, count) = (number("STEMGEN_FUZZ_FROM").unwrap(), number("STEMGEN_FUZZ").unwrap());
    let target = Target::new(&name);
    std::thread::spawn(watchdog);
    let note = std::fs::File::create(note).unwrap();
    let mut accepted = 0_u64;
    for at in first..first + count {
        keep(&note, at, accepted);
        CURRENT.store(at, Relaxed);
        let input = target.input(at);
        let before = processor_seconds();
        let (result, bytes) =
            watch(|| catch_unwind(std::panic::AssertUnwindSafe(|| target.run(&input))));
        let seconds = processor_seconds() - before;
        accepted += u64::from(result.expect("no panic"));
        // A large file may take what its values take as numbers of 8 bytes, beside its own bytes.
        let most = MOST_BYTES.max(10 * target.file_bytes());
        assert!(bytes <= most, "{bytes} bytes for an input of {}", input.len());
        assert!(seconds <= MOST_SECONDS, "{seconds} s of processor time");
    }
    keep(&note, first + count, accepted);
}

fn keep(note: &std::fs::File, at: u64, accepted: u64) {
    use std::os::unix::fs::FileExt;
    note.write_all_at(format!("{at:20} {accepted:20}").as_bytes(), 0).unwrap();
}

/// Ends a process that spends all its time on one execution.
fn watchdog() {
    let (mut current, mut began) = (u64::MAX, 0.0);
    loop {
        let (now, spent) = (CURRENT.load(Relaxed), process_seconds());
        if now != current {
            (current, began) = (now, spent);
        }
        if spent - began > HANGS_SECONDS {
            eprintln!("hangs for more than {HANGS_SECONDS} s");
            std::process::abort();
        }
        std::thread::sleep(Duration::from_secs(1));
    }
}

/// Processor time of this process where the system tells it.
fn process_seconds() -> f64 {
    let printed = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // Behind the name in parentheses; times are in hundredths of a second.
    let fields: Vec<&str> =
        printed.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    [11, 12].iter().filter_map(|i| fields.get(*i)?.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// Processor time of this thread where the system tells it.
pub fn processor_seconds() -> f64 {
    let printed = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    printed.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) / 1e9
}
