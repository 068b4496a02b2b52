//! SIGKILL and SIGTERM at random moments.

use super::{
    Method, assert_done, build, fails, files, has_image, has_subtile, names, stderr, stemgen,
    succeeds,
};
use rand::{Rng, RngExt, SeedableRng, rngs::StdRng};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Part of a build that is hit.
#[derive(Debug, Clone, Copy)]
struct Stage {
    name: &'static str,
    method: Method,
    /// Whether the cache is full before.
    warm: bool,
    /// Begins when this holds of the folder; at the start of the program if `None`.
    begins: Option<fn(&Path) -> bool>,
}

const STAGES: [Stage; 8] = [
    Stage { name: "cold library", method: Method::Library, warm: false, begins: None },
    Stage { name: "warm library", method: Method::Library, warm: true, begins: None },
    Stage { name: "library without a cache", method: Method::NoCache, warm: false, begins: None },
    Stage { name: "cache write", method: Method::Library, warm: false, begins: Some(has_image) },
    Stage {
        name: "sub-tiles",
        method: Method::Subtiles,
        warm: false,
        begins: Some(|folder| has_subtile(folder, 0)),
    },
    Stage {
        name: "final write",
        method: Method::Subtiles,
        warm: false,
        begins: Some(|f| has_subtile(f, 3) && f.join("w.h5.partial").exists()),
    },
    Stage {
        name: "rename",
        method: Method::Subtiles,
        warm: false,
        begins: Some(|folder| folder.join("w.h5.work/complete.json").exists()),
    },
    Stage {
        name: "picture",
        method: Method::Library,
        warm: true,
        begins: Some(|folder| folder.join("w.h5").exists()),
    },
];

/// Runs a build until a random moment of a stage and sends a signal; returns how it ended.
fn hit(folder: &Path, stage: Stage, signal: &str, random: &mut impl Rng) -> std::process::Output {
    let child = build(folder, stage.method).stdout(Stdio::null()).spawn().unwrap();
    let wait = match stage.begins {
        // A build of the tiny world takes about so long.
        None => Duration::from_micros(random.random_range(0..1_500_000)),
        Some(_) => Duration::from_micros(random.random_range(0..30_000)),
    };
    let mut child = child;
    if let Some(begins) = stage.begins {
        super::wait_for(|| begins(folder) || has_ended(&mut child));
    }
    let begun = Instant::now();
    while begun.elapsed() < wait && !has_ended(&mut child) {
        std::thread::sleep(Duration::from_micros(100));
    }
    send(&child, signal);
    child.wait_with_output().unwrap()
}

fn has_ended(child: &mut Child) -> bool {
    child.try_wait().unwrap().is_some()
}

/// Sends a signal to a process that may have ended, but was not waited for.
pub fn send(child: &Child, signal: &str) {
    let id = child.id().to_string();
    let _ = Command::new("kill").args([signal, &id]).stderr(Stdio::null()).status().unwrap();
}

/// Hits `count` builds of each stage, some of them more than once, and finishes each. Returns how many signals met a program at work.
fn hit_all(signal: &str, code: Option<i32>, count: usize, seed: u64) -> usize {
    let mut random = StdRng::seed_from_u64(seed);
    let mut met = 0;
    for stage in STAGES {
        println!("{signal} {}: {count} builds", stage.name);
        for number in 0..count {
            let what = format!("{signal} {} {number}, seed {seed}", stage.name);
            let folder = tempfile::tempdir().unwrap();
            let here = folder.path();
            if stage.warm {
                warm(here);
            }
            for _ in 0..random.random_range(1..3) {
                let ended = hit(here, stage, signal, &mut random);
                let told = stderr(&ended);
                assert!(!told.contains("panicked"), "{what}: {told}");
                if ended.status.success() {
                    // Too late; another build of the same name would be refused.
                    break;
                }
                // Before the program listens the system ends it.
                let early = code.is_some() && ended.status.signal() == Some(15);
                assert!(early || ended.status.code() == code, "{what}: {:?} {told}", ended.status);
                met += 1;
                if code.is_some() {
                    assert_nothing_half_written(here, &what);
                }
                if is_complete(here) {
                    // Ended between its last deed and its exit.
                    break;
                }
            }
            if !is_complete(here) {
                succeeds(&mut build(here, stage.method));
            } else if ["w.h5.work", "w.h5.lock"].iter().any(|name| names(here).contains(*name)) {
                // Ended while it removed them, which took no more than two calls of the system.
                let told = fails(&mut build(here, stage.method));
                assert!(told.contains("w.h5: exists"), "{what}: {told}");
            }
            assert_done(here, stage.method, &what);
        }
    }
    met
}

/// Whether the world is there, and nothing is left to do for it but to remove an empty folder and a lock.
fn is_complete(folder: &Path) -> bool {
    names(folder).contains("w.h5") && names(&folder.join("w.h5.work")).is_empty()
}

/// Fills the cache.
fn warm(folder: &Path) {
    let elsewhere = tempfile::tempdir().unwrap();
    let mut command = build(elsewhere.path(), Method::Library);
    succeeds(command.env("STEMGEN_CACHE", folder.join("cache")));
}

/// A program that was asked to end has removed what it had begun.
fn assert_nothing_half_written(folder: &Path, what: &str) {
    let left = files(folder);
    let half = left.iter().find(|path| {
        let name = path.file_name().unwrap().to_string_lossy();
        name.ends_with(".partial") || name.ends_with(".lock")
    });
    assert_eq!(half, None, "{what}: {left:?}");
}

#[test]
fn killed_builds_end_in_the_same_bytes() {
    let met = hit_all("-KILL", None, 2, 1);
    assert!(met >= 10, "{met} builds were killed");
}

#[test]
fn builds_that_are_asked_to_end_leave_nothing_half_written() {
    let met = hit_all("-TERM", Some(143), 2, 2);
    assert!(met >= 10, "{met} builds were asked");
}

/// Files that a simulation writes.
const IMAGES: [&str; 4] = ["s.h5", "s_HAADF.png", "s_HAADF.tif", "s.hspy"];

/// Simulates images of silicon, which takes half a second.
fn simulate(folder: &Path) -> Command {
    let silicon = concat!(env!("CARGO_MANIFEST_DIR"), "/structures/si.cif");
    let mut command = stemgen(folder);
    command.args(["simulate", silicon, "--repeat", "2,2,4", "--scan-end", "5.431,5.431"]);
    command.args(["--scan-points", "8,8"]);
    command.args(["--png", "--tiff", "32", "--hspy", "-o", "s.h5"]);
    command
}

/// What a file of images says; of the HDF5 file, which tells the time that it took, the image.
fn content(folder: &Path, name: &str) -> Vec<u8> {
    let path = folder.join(name);
    match name {
        "s.h5" => {
            let image = stemgen::io::arrays::read(&path, None).unwrap();
            image.data.iter().flat_map(|v| v.to_le_bytes()).collect()
        }
        _ => std::fs::read(path).unwrap(),
    }
}

/// Ends `count` simulations at random moments. What is there is whole, and the same command makes the rest. Returns how many
/// signals met a program at work.
fn hit_simulations(signal: &str, code: Option<i32>, count: usize, seed: u64) -> usize {
    let (mut random, mut met) = (StdRng::seed_from_u64(seed), 0);
    let folder = tempfile::tempdir().unwrap();
    let begun = Instant::now();
    succeeds(&mut simulate(folder.path()));
    let whole = begun.elapsed().as_micros() as u64;
    let expected = IMAGES.map(|name| content(folder.path(), name));
    assert_eq!(names(folder.path()).len(), IMAGES.len());
    for number in 0..count {
        let what = format!("{signal} {number}, seed {seed}");
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        let mut child = simulate(here).spawn().unwrap();
        let wait = Duration::from_micros(random.random_range(0..whole));
        // Every other one while files are written.
        let begins =
            |child: &mut Child| number % 2 == 0 || !names(here).is_empty() || has_ended(child);
        super::wait_for(|| begins(&mut child));
        let wait = if number % 2 == 0 { wait } else { wait / 50 };
        std::thread::sleep(wait);
        send(&child, signal);
        let ended = child.wait_with_output().unwrap();
        let told = stderr(&ended);
        let early = code.is_some() && ended.status.signal() == Some(15);
        let at_work = !ended.status.success();
        met += usize::from(at_work);
        assert!(
            !at_work || early || ended.status.code() == code,
            "{what}: {:?} {told}",
            ended.status
        );
        for name in names(here) {
            match IMAGES.iter().position(|known| *known == name) {
                Some(i) => assert!(content(here, &name) == expected[i], "{what}: {name}"),
                None => assert!(code.is_none() && name.ends_with(".partial"), "{what}: {name}"),
            }
        }
        succeeds(simulate(here).arg("--overwrite"));
        for (name, expected) in IMAGES.iter().zip(&expected) {
            assert!(content(here, name) == *expected, "{what}: {name}");
        }
    }
    met
}

#[test]
fn simulations_that_are_ended_leave_whole_files_only() {
    let met = hit_simulations("-KILL", None, 8, 5) + hit_simulations("-TERM", Some(143), 8, 6);
    assert!(met >= 6, "{met} simulations were ended");
}

/// `cargo test --release --test faults kills::many -- --ignored --nocapture`
#[test]
#[ignore = "takes a quarter of an hour"]
fn many_kills() {
    let met = hit_all("-KILL", None, 30, 3);
    println!("{met} builds were killed; all ended in the same bytes");
    assert!(met >= 200, "{met} builds were killed");
}

#[test]
#[ignore = "takes a quarter of an hour"]
fn many_requests_to_end() {
    // On a quiet machine every other build ends before it is asked to.
    let met = hit_all("-TERM", Some(143), 60, 4);
    println!("{met} builds were asked to end; all ended in the same bytes");
    assert!(met >= 200, "{met} builds were asked");
}

#[test]
#[ignore = "takes minutes"]
fn many_simulations() {
    let met = [("-KILL", None), ("-TERM", Some(143))].map(|(signal, code)| {
        let met = hit_simulations(signal, code, 120, 7);
        println!("{met} simulations were ended by {signal}; all files were whole");
        met
    });
    // Who is asked to end while files are written, which every other one is, writes them first.
    assert!(met[0] >= 100 && met[1] >= 30, "{met:?}");
}
