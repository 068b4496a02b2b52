//! `stemgen cache`: what it lists, and what it removes.

use super::{fails, file, json, stderr, stdout, stemgen};
use std::path::Path;
use std::process::Command;

/// The program with a cache of its own in `folder`.
fn with_cache(folder: &Path) -> Command {
    let mut command = stemgen(folder);
    command.env("STEMGEN_CACHE", folder.join("cache"));
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
    let tiny = std::fs::read_to_string(file("tests/cli/tiny.toml")).unwrap();
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
fn materials(told: &serde_json::Value) -> Vec<(String, u64)> {
    let of = |m: &serde_json::Value| {
        assert!(m["bytes"].as_u64().unwrap() > 1000, "{m}");
        (m["material"].as_str().unwrap().to_owned(), m["images"].as_u64().unwrap())
    };
    told["materials"].as_array().unwrap().iter().map(of).collect()
}

#[test]
fn an_empty_cache_holds_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let told = printed(&mut cache(here, &["list"]));
    let place = here.join("cache").display().to_string();
    assert!(told.contains(&place) && told.contains("nothing"), "{told}");
    let listed = json(&mut cache(here, &["list"]));
    assert_eq!(listed["folder"].as_str(), Some(place.as_str()));
    assert!(materials(&listed).is_empty());
    assert!(printed(&mut cache(here, &["clear"])).contains("nothing"));
    let told = fails(&mut cache(here, &["clear", "tiny"]));
    assert!(told.contains("no simulations of `tiny`; it holds nothing"), "{told}");
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
    let told = printed(&mut cache(here, &["list"]));
    assert!(told.contains(&format!("{images} images")), "{told}");

    let told = fails(&mut cache(here, &["clear", "srtio3"]));
    assert!(told.contains("`srtio3`; it holds other, tiny"), "{told}");
    let told = printed(&mut cache(here, &["clear", "other"]));
    assert!(told.contains("other") && told.contains("removed"), "{told}");
    assert!(!told.contains("tiny "), "{told}");
    assert_eq!(materials(&json(&mut cache(here, &["list"]))), held[1..]);

    assert_eq!(materials(&json(&mut cache(here, &["clear"]))), held[1..], "what was removed");
    assert!(materials(&json(&mut cache(here, &["list"]))).is_empty());
    assert_eq!(std::fs::read_dir(here.join("cache")).unwrap().count(), 0);
}
