//! `stemgen cache`: what it lists, and what it removes.

use super::{fails, file, json, stderr, stdout, stemgen};
use std::path::Path;
use std::process::Command;

/// The program with a cache of its own in `folder`.
fn with_cache(folder: &Path) -> Command {
    let mut command = stemgen(folder);
    command.env("STEMGEN_CACHE", folder.join("cache")).env("STEMGEN_LIBRARY", "");
    command
}

fn cache(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = with_cache(folder);
    command.arg("cache").args(arguments);
    command
}

fn printed(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    stdout(&output)
}

/// Builds a world of the tiny recipe from a library, and the same under another name.
fn fill(folder: &Path) {
    let tiny = std::fs::read_to_string(file("tests/cli/tiny_library.toml")).unwrap();
    for name in ["tiny", "other"] {
        let recipe = tiny.replace("id = \"tiny\"", &format!("id = \"{name}\""));
        std::fs::write(folder.join("recipe.toml"), recipe).unwrap();
        let arguments =
            ["--recipe", "recipe.toml", "--engine", "mosaic", "--audit", "0", "--quiet"];
        let output = format!("{name}.h5");
        let mut command = with_cache(folder);
        printed(command.arg("build").args(arguments).args(["--no-png", "-o", &output]));
    }
}

/// Material and number of images, as `--json` tells them.
fn materials(shown: &serde_json::Value) -> Vec<(String, u64)> {
    let of = |m: &serde_json::Value| {
        assert!(m["bytes"].as_u64().unwrap() > 1000, "{m}");
        (m["material"].as_str().unwrap().to_owned(), m["images"].as_u64().unwrap())
    };
    shown["materials"].as_array().unwrap().iter().map(of).collect()
}

#[test]
fn an_empty_cache_holds_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let shown = printed(&mut cache(here, &["list"]));
    let place = here.join("cache").display().to_string();
    assert!(shown.contains(&place) && shown.contains("nothing"), "{shown}");
    let listed = json(&mut cache(here, &["list"]));
    assert_eq!(listed["folder"].as_str(), Some(place.as_str()));
    assert!(materials(&listed).is_empty());
    assert!(printed(&mut cache(here, &["clear"])).contains("nothing"));
    let shown = fails(&mut cache(here, &["clear", "tiny"]));
    assert!(shown.contains("no simulations of `tiny`; it holds nothing"), "{shown}");
    assert!(!here.join("cache").exists(), "to look makes no folder");
}

#[test]
fn materials_are_listed_and_removed() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fill(here);
    let held = materials(&json(&mut cache(here, &["list"])));
    let [(other, images), (tiny, same)] = &held[..] else { panic!("{held:?}") };
    assert_eq!((other.as_str(), tiny.as_str()), ("other", "tiny"));
    assert!(*images > 0 && images == same, "{held:?}");
    let shown = printed(&mut cache(here, &["list"]));
    assert!(shown.contains(&format!("{images} images")), "{shown}");
    // Those of a recipe of one's own are simulated again too.
    let tiny = file("tests/cli/tiny_library.toml");
    let shown = json(&mut cache(here, &["verify", &tiny, "--recompute", "1"]));
    assert_eq!((&shown["sound"], &shown["images"]), (&true.into(), &(*images).into()), "{shown}");
    assert_eq!(shown["recomputed"][0]["difference"], 0.0, "{shown}");

    let shown = fails(&mut cache(here, &["clear", "srtio3"]));
    assert!(shown.contains("`srtio3`; it holds other, tiny"), "{shown}");
    let shown = printed(&mut cache(here, &["clear", "other"]));
    assert!(shown.contains("other") && shown.contains("removed"), "{shown}");
    assert!(!shown.contains("tiny "), "{shown}");
    assert_eq!(materials(&json(&mut cache(here, &["list"]))), held[1..]);

    assert_eq!(materials(&json(&mut cache(here, &["clear"]))), held[1..], "what was removed");
    assert!(materials(&json(&mut cache(here, &["list"]))).is_empty());
    assert_eq!(std::fs::read_dir(here.join("cache")).unwrap().count(), 0);
}

/// Builds the tiny world, with the cache in a folder of `folder`; returns what it tells.
fn tiny_with(folder: &Path, cache: &str) -> serde_json::Value {
    let mut command = stemgen(folder);
    command.env("STEMGEN_CACHE", folder.join(cache)).args(["build", "--recipe"]);
    command.args([
        &file("tests/cli/tiny_library.toml"),
        "--engine",
        "mosaic",
        "--audit",
        "0",
        "--no-png",
    ]);
    json(command.args(["--overwrite", "--quiet", "-o", "w.h5"]))
}

#[test]
fn a_library_travels_in_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let first = tiny_with(here, "cache");
    assert_eq!(first["library"][0], first["library"][1], "{first}");
    let world = std::fs::read(here.join("w.h5")).unwrap();
    let shown = printed(&mut cache(here, &["export", "tiny", "-o", "tiny.stemlib"]));
    assert!(shown.contains("18 images") && shown.contains("tiny.stemlib"), "{shown}");
    let message = fails(&mut cache(here, &["export", "tiny", "-o", "tiny.stemlib"]));
    assert!(message.contains("--overwrite"), "{message}");
    let message = fails(&mut cache(here, &["export", "gan", "-o", "gan.stemlib"]));
    assert!(message.contains("`gan`; it holds tiny"), "{message}");
    let elsewhere = |arguments: &[&str]| {
        let mut command = stemgen(here);
        command.env("STEMGEN_CACHE", here.join("elsewhere")).arg("cache").args(arguments);
        command
    };
    let cut = std::fs::read(here.join("tiny.stemlib")).unwrap();
    std::fs::write(here.join("cut.stemlib"), &cut[..cut.len() / 2]).unwrap();
    let message = fails(&mut elsewhere(&["import", "cut.stemlib"]));
    assert!(message.contains("cut.stemlib") && message.contains("copy it again"), "{message}");
    let message = fails(&mut elsewhere(&["import", "w.h5"]));
    assert!(message.contains("is no library"), "{message}");
    assert!(!here.join("elsewhere").exists(), "nothing was taken");
    let shown = json(&mut elsewhere(&["import", "tiny.stemlib"]));
    assert_eq!(shown["added"], 18, "{shown}");
    assert_eq!(tiny_with(here, "elsewhere")["library"][1], 0);
    assert!(std::fs::read(here.join("w.h5")).unwrap() == world);
}

#[test]
fn a_library_comes_along() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let simulated = tiny_with(here, "cache");
    let world = std::fs::read(here.join("w.h5")).unwrap();
    std::fs::create_dir(here.join("library")).unwrap();
    printed(&mut cache(here, &["export", "tiny", "-o", "library/tiny.stemlib"]));
    let build = |options: &[&str]| {
        let mut command = stemgen(here);
        command.env("STEMGEN_CACHE", here.join("unused")).env("STEMGEN_LIBRARY", "library");
        command.args([
            "build",
            "--recipe",
            &file("tests/cli/tiny_library.toml"),
            "--engine",
            "mosaic",
        ]);
        command
            .args(["--audit", "0", "--no-png", "--overwrite", "--json", "-o", "w.h5"])
            .args(options);
        let run = command.output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        assert!(std::fs::read(here.join("w.h5")).unwrap() == world, "{options:?}");
        let shown: serde_json::Value = serde_json::from_str(&stdout(&run)).unwrap();
        (shown["library"][1].as_u64().unwrap(), stderr(&run))
    };
    assert_eq!(build(&[]).0, 0);
    assert_eq!(build(&["--no-cache"]).0, 0);
    assert!(!here.join("unused").exists(), "it is read where it is");
    let all = simulated["library"][0].as_u64().unwrap();
    assert_eq!(build(&["--no-library", "--no-cache"]).0, all);
    let listed = |arguments: &[&str]| {
        let mut command = stemgen(here);
        command.env("STEMGEN_CACHE", here.join("unused")).env("STEMGEN_LIBRARY", "library");
        printed(command.arg("cache").args(arguments))
    };
    assert!(listed(&["list"]).contains("installed with the program"), "{}", listed(&["list"]));
    assert!(listed(&["verify", "tiny"]).contains("18 images of the installed library, all whole"));
    // What cannot be used is told, once, and simulated.
    let whole = std::fs::read(here.join("library/tiny.stemlib")).unwrap();
    for (change, word) in [(whole.len() / 2, "damaged"), (8, "damaged")] {
        let mut bytes = whole.clone();
        bytes[change] ^= 1;
        std::fs::write(here.join("library/tiny.stemlib"), bytes).unwrap();
        let (simulated, shown) = build(&["--no-cache"]);
        assert_eq!(
            (simulated, shown.matches("the archive is not used").count()),
            (all, 1),
            "{shown}"
        );
        assert!(shown.contains(word) && shown.contains("tiny.stemlib"), "{shown}");
    }
    std::fs::remove_dir_all(here.join("library")).unwrap();
    let (simulated, shown) = build(&["--no-cache"]);
    assert_eq!(
        (simulated, shown.matches("the folder does not exist").count()),
        (all, 1),
        "{shown}"
    );
}

#[test]
#[ignore = "long"]
fn damaged_and_foreign_images_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let hard = ["srtio3", "--difficulty", "hard"];
    // One image of the smallest kind there is in worlds that come with the program.
    let shown = printed(cache(here, &["fill"]).args(hard).args(["--shard", "5/128"]));
    assert!(shown.contains("srtio3_hard") && shown.contains("1 simulated now, 127 are"), "{shown}");
    let shown = json(&mut cache(here, &["fill", "--all", "--difficulty", "easy", "--dry-run"]));
    let names: Vec<&str> =
        shown.as_array().unwrap().iter().map(|w| w["world"].as_str().unwrap()).collect();
    let crystals = ["srtio3_easy", "batio3_easy", "sige_easy", "gan_easy"];
    assert_eq!(names, [&crystals[..], &["mos2_easy", "wse2_easy", "graphene_easy"]].concat());
    let again = |code: i32| {
        let arguments = ["--recompute", "2", "--json"];
        let run = cache(here, &["verify"]).args(hard).args(arguments).output().unwrap();
        assert_eq!(run.status.code(), Some(code), "{}", stderr(&run));
        serde_json::from_str::<serde_json::Value>(&stdout(&run)).unwrap()
    };
    let shown = again(0);
    assert_eq!((&shown["images"], &shown["recomputed"][0]["difference"]), (&1.into(), &0.0.into()));
    // Whole, with another image's values: its checksum is right.
    let mut files = std::fs::read_dir(here.join("cache/srtio3")).unwrap();
    let path = files.next().unwrap().unwrap().path();
    let mut bytes = std::fs::read(&path).unwrap();
    let body = bytes.len() - 32;
    bytes[body - 1] ^= 1;
    let digest = <sha2::Sha256 as sha2::Digest>::digest(&bytes[..body]);
    bytes[body..].copy_from_slice(&digest);
    std::fs::write(&path, &bytes).unwrap();
    let shown = again(3);
    assert!(shown["sound"] == false && shown["damaged"].as_array().unwrap().is_empty(), "{shown}");
    let difference = shown["recomputed"][0]["difference"].as_f64().unwrap();
    assert!(shown["images"] == 1 && difference > 0.0, "{shown}");
    bytes[body / 2] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let run = cache(here, &["verify"]).output().unwrap();
    assert_eq!(run.status.code(), Some(3));
    assert!(stdout(&run).contains("DAMAGED") && stdout(&run).contains("0 of 1 images"));
    let shown = fails(&mut cache(here, &["verify", "--recompute", "1"]));
    assert!(shown.contains("<MATERIAL|RECIPE.toml>"), "{shown}");
}
