//! What lies on the disk is damaged, foreign, removed, from another time, or written by two at once: pixels are never wrong.

use super::points::{Held, Point, can_trace, meets};
use super::{
    FIRST_IMAGE, Method, assert_done, build, fails, files, names, stderr, subtile, succeeds,
};
use std::fs::{self, File, FileTimes};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// Damages each file in a way of its own.
fn damage(paths: &[PathBuf]) {
    for (number, path) in paths.iter().enumerate() {
        let bytes = fs::read(path).unwrap();
        let flipped = |at: usize| {
            let mut bytes = bytes.clone();
            bytes[at] ^= 1 << (number % 8);
            bytes
        };
        match number % 6 {
            0 => fs::write(path, flipped(bytes.len() / 2)).unwrap(),
            1 => fs::write(path, flipped(20)).unwrap(),
            2 => fs::write(path, &bytes[..bytes.len() - 1]).unwrap(),
            3 => fs::write(path, "").unwrap(),
            // whole, but of another image
            4 => drop(fs::copy(&paths[(number + 1) % paths.len()], path).unwrap()),
            _ => fs::write(path, "a text of somebody else\n".repeat(9)).unwrap(),
        }
    }
}

fn with_ending(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let mut found = files(folder);
    found.retain(|f| f.extension().is_some_and(|e| e == ending));
    found
}

/// A build that was killed at a point.
fn killed(folder: &Path, method: Method, point: Point) {
    let ended = meets(&build(folder, method), point, "signal=SIGKILL");
    assert_eq!(ended.status.code(), None, "{}", stderr(&ended));
}

#[test]
fn damaged_images_of_the_cache_are_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    succeeds(&mut build(here, Method::Library));
    let library_cells = with_ending(&here.join("cache"), "sheet");
    assert!(library_cells.len() >= 12, "{library_cells:?}");
    let whole: Vec<Vec<u8>> = library_cells.iter().map(|s| fs::read(s).unwrap()).collect();
    damage(&library_cells);
    let printed = succeeds(build(here, Method::Library).arg("--overwrite"));
    assert_eq!(printed.matches("; simulated again").count(), library_cells.len(), "{printed}");
    for why in ["is damaged", "is cut off", "holds another image", "is no array of this program"] {
        assert!(printed.contains(why), "no `{why}` in {printed}");
    }
    assert_done(here, Method::Library, "damaged cache");
    let after: Vec<Vec<u8>> = library_cells.iter().map(|s| fs::read(s).unwrap()).collect();
    assert!(whole == after, "the cache is whole again");
}

#[test]
fn damaged_sub_tiles_are_made_again() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    killed(here, Method::Subtiles, subtile(7));
    let tiles = with_ending(&here.join("w.h5.work"), "bin");
    assert_eq!(tiles.len(), 7, "{tiles:?}");
    damage(&tiles);
    let printed = succeeds(&mut build(here, Method::Subtiles));
    assert_eq!(printed.matches("; simulated again").count(), tiles.len(), "{printed}");
    assert_done(here, Method::Subtiles, "damaged sub-tiles");
}

/// What describes the build is damaged, or is a folder: it is said, and the sub-tiles, which tell themselves whose they are, are used.
#[test]
fn a_damaged_key_is_made_again_and_its_sub_tiles_are_used() {
    if !can_trace() {
        return;
    }
    for text in [Some(""), Some("{\"recipe\": \"cut off"), Some("[1, 2]"), None] {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        killed(here, Method::Subtiles, subtile(4));
        let key = here.join("w.h5.work/key.json");
        fs::remove_file(&key).unwrap();
        match text {
            Some(text) => fs::write(&key, text).unwrap(),
            None => fs::create_dir(&key).unwrap(),
        }
        let mut again = build(here, Method::Subtiles);
        let output = again.arg("--json").stdout(std::process::Stdio::piped()).output().unwrap();
        let printed = stderr(&output);
        assert!(output.status.success() && printed.contains("key.json: is damaged"), "{printed}");
        let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(summary["subtiles_resumed"], 4, "{text:?}: {summary}");
        assert_done(here, Method::Subtiles, "damaged key");
    }
}

#[test]
fn a_folder_in_place_of_a_sub_tile_makes_room() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    killed(here, Method::Subtiles, subtile(4));
    let work = here.join("w.h5.work");
    for (name, inside) in [("subtile_000001.bin", None), ("subtile_000006.bin", Some("mine"))] {
        let place = work.join(name);
        let _ = fs::remove_file(&place);
        fs::create_dir(&place).unwrap();
        inside.iter().for_each(|inside| fs::write(place.join(inside), "a text").unwrap());
    }
    let printed = succeeds(&mut build(here, Method::Subtiles));
    for name in ["subtile_000001.bin", "subtile_000006.bin"] {
        let said = format!("{name}: is no regular file; simulated again");
        assert!(printed.contains(&said), "no `{said}` in {printed}");
    }
    // What somebody had put there is not lost.
    let aside = work.join("subtile_000006.bin.aside");
    assert_eq!(fs::read_to_string(aside.join("mine")).unwrap(), "a text");
    fs::remove_dir_all(&work).unwrap();
    assert_done(here, Method::Subtiles, "a folder in the way");
}

#[test]
fn audits_and_libraries_are_kept_in_the_work_folder() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    killed(here, Method::NoCache, subtile(1));
    assert!(!here.join("cache").exists());
    let library = with_ending(&here.join("w.h5.work/library"), "sheet");
    let audits = with_ending(&here.join("w.h5.work/audits"), "audit");
    assert_eq!((library.len(), audits.len()), (18, 1));
    let mut again = build(here, Method::NoCache);
    let output = again.arg("--json").stdout(std::process::Stdio::piped()).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["library"], serde_json::json!([18, 0]), "{summary}");
    assert!(!stderr(&output).contains("auditing"), "{}", stderr(&output));
    assert_done(here, Method::NoCache, "no cache");

    // A damaged audit is made again.
    fs::remove_file(here.join("w.h5")).unwrap();
    fs::remove_file(here.join("w.png")).unwrap();
    killed(here, Method::NoCache, subtile(1));
    let [audit] = &with_ending(&here.join("w.h5.work/audits"), "audit")[..] else { panic!() };
    let text = fs::read_to_string(audit).unwrap();
    fs::write(audit, text.replacen("bright_rms_percent\":", "bright_rms_percent\":1", 1)).unwrap();
    let printed = succeeds(&mut build(here, Method::NoCache));
    assert!(printed.contains("is damaged; audited again"), "{printed}");
    assert_done(here, Method::NoCache, "damaged audit");
}

/// As a kill between the world and its picture leaves it.
#[test]
fn a_world_without_its_picture_is_finished() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    // A folder where the picture goes: the world is put in place, the picture is not.
    let held = Held::at(&build(here, Method::Subtiles), subtile(0));
    fs::create_dir_all(here.join("w.png/in the way")).unwrap();
    assert_eq!(held.go_on().status.code(), Some(1));
    assert!(names(here).contains("w.h5") && names(here).contains("w.h5.work"), "{:?}", names(here));
    fs::remove_dir_all(here.join("w.png")).unwrap();
    let written = fs::metadata(here.join("w.h5")).unwrap().modified().unwrap();
    // Another build of that name is refused as ever.
    assert!(fails(build(here, Method::Subtiles).args(["--seed", "9"])).contains("exists"));
    succeeds(&mut build(here, Method::Subtiles));
    assert_done(here, Method::Subtiles, "finished");
    assert_eq!(fs::metadata(here.join("w.h5")).unwrap().modified().unwrap(), written);
    assert!(fails(&mut build(here, Method::Subtiles)).contains("exists"));
}

#[test]
fn a_cache_that_cannot_be_written_is_reported_once() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::write(here.join("file"), "").unwrap();
    let mut command = build(here, Method::Library);
    let printed = succeeds(command.env("STEMGEN_CACHE", here.join("file/cache")));
    assert_eq!(printed.matches("were not kept for later builds").count(), 1, "{printed}");
    assert_eq!(printed.matches("file/cache").count(), 1, "{printed}");
    fs::remove_file(here.join("file")).unwrap();
    assert_done(here, Method::Library, "no cache");
}

#[test]
fn two_builds_share_a_cache() {
    if !can_trace() {
        return;
    }
    let [a, b] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let cache = a.path().join("cache");
    let [one, mut other] = [&a, &b].map(|folder| {
        let mut command = build(folder.path(), Method::Library);
        command.env("STEMGEN_CACHE", &cache);
        command
    });
    // The other takes the one image that is there, and makes all that the first looked for in vain.
    let held = Held::at(&one, FIRST_IMAGE);
    succeeds(&mut other);
    let ended = held.go_on();
    assert!(ended.status.success(), "{}", stderr(&ended));
    assert_done(a.path(), Method::Library, "one");
    assert_done(b.path(), Method::Library, "the other");
}

#[test]
fn a_folder_deleted_under_a_build_is_an_error_and_no_more() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    // Folders are made again where there is a folder to make them in.
    for (target, code) in [("w.h5.work", 0), ("cache", 0), ("", 1)] {
        let place = here.join("place");
        fs::create_dir(&place).unwrap();
        let held = Held::at(&build(&place, Method::Library), FIRST_IMAGE);
        fs::remove_dir_all(place.join(target)).unwrap();
        let ended = held.go_on();
        let printed = stderr(&ended);
        assert_eq!(ended.status.code(), Some(code), "{target}: {printed}");
        assert!(
            !printed.contains("panicked") && (code == 0 || printed.contains("error: ")),
            "{printed}"
        );
        if code != 0 {
            fs::create_dir_all(&place).unwrap();
            succeeds(&mut build(&place, Method::Library));
        }
        assert_done(&place, Method::Library, target);
        fs::remove_dir_all(&place).unwrap();
    }
}

#[test]
fn times_of_files_change_nothing() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    killed(here, Method::Library, subtile(3));
    for (number, path) in files(here).iter().enumerate() {
        let decades = Duration::from_secs(60 * 365 * 86_400);
        let time = match number % 2 {
            0 => SystemTime::UNIX_EPOCH + Duration::from_secs(1),
            _ => SystemTime::now() + decades,
        };
        let file = File::options().write(true).open(path).unwrap();
        file.set_times(FileTimes::new().set_modified(time).set_accessed(time)).unwrap();
    }
    succeeds(&mut build(here, Method::Library));
    assert_done(here, Method::Library, "file times");
}

/// Files of other people under the names that a build uses beside its output.
#[test]
fn files_of_others_beside_the_output_stay() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for name in ["w.h5.partial", "w.png.partial", "w.h5.lock"] {
        fs::write(here.join(name), "precious").unwrap();
        let printed = fails(&mut build(here, Method::Subtiles));
        assert!(printed.contains(name), "{printed}");
        assert_eq!(fs::read(here.join(name)).unwrap(), b"precious");
        assert_eq!(names(here).len(), 1, "{:?}", names(here));
        fs::remove_file(here.join(name)).unwrap();
    }
    fs::create_dir(here.join("w.h5.work")).unwrap();
    fs::write(here.join("w.h5.work/notes.txt"), "precious").unwrap();
    succeeds(&mut build(here, Method::Subtiles));
    assert_eq!(fs::read(here.join("w.h5.work/notes.txt")).unwrap(), b"precious");
}

/// What a run leaves that was ended in its very last steps: the next one is refused, since the world is whole, and puts all in order.
#[test]
fn nothing_is_left_beside_a_whole_world() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    succeeds(&mut build(here, Method::Library));
    fs::create_dir(here.join("w.h5.work")).unwrap();
    fs::write(here.join("w.h5.lock"), "process 1\n").unwrap();
    let printed = fails(&mut build(here, Method::Library));
    assert!(printed.contains("w.h5: exists"), "{printed}");
    assert_done(here, Method::Library, "leftovers");
}
