//! `stemgen card`: the folder that it makes, and what it refuses.

use super::{fails, file, json, python, stderr, stdout, stemgen};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use stemgen::files::sha256_of_file;

/// Two small worlds: `test.h5`, and `own.h5` of a recipe file.
fn worlds(folder: &Path) {
    std::fs::create_dir_all(folder).unwrap();
    let own = file("tests/cli/tiny.toml");
    let small = ["test", "--grid", "1x1", "--set", "field.thickness_nm=0.4", "--audit", "0"];
    for arguments in
        [[&small[..], &["-o", "test.h5"]].concat(), vec!["--recipe", &own, "-o", "own.h5"]]
    {
        let mut command = stemgen(folder);
        let output = command.arg("build").args(&arguments).args(["--no-png", "--quiet"]).output();
        let output = output.unwrap();
        assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    }
}

fn card<'a>(here: &Path, arguments: impl IntoIterator<Item = &'a str>) -> Command {
    let mut command = stemgen(here);
    command.arg("card").args(arguments);
    command
}

/// All files below a folder, hidden ones too, by their paths in it.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![PathBuf::new()];
    while let Some(below) = open.pop() {
        for entry in std::fs::read_dir(folder.join(&below)).unwrap() {
            let entry = entry.unwrap();
            let path = below.join(entry.file_name());
            match entry.path().is_dir() {
                true => open.push(path),
                false => {
                    let name = path.to_str().unwrap().to_owned();
                    found.insert(name, std::fs::read(entry.path()).unwrap());
                }
            }
        }
    }
    found
}

/// The lines of a table, each by the names of its columns. None of the values here is quoted.
fn table(path: &Path) -> Vec<BTreeMap<String, String>> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let names = lines.next().unwrap();
    let record = |cells: Vec<String>| {
        assert_eq!(cells.len(), names.len(), "{}: {cells:?}", path.display());
        names.iter().cloned().zip(cells).collect()
    };
    lines.map(record).collect()
}

const SAID: [&str; 16] = [
    "--title",
    "Two small worlds",
    "--license",
    "cc-by-4.0",
    "--creator",
    "A. Person",
    "--organization",
    "An Institute",
    "--url",
    "https://example.org/worlds",
    "--date",
    "2026-11-23",
    "--cite",
    "A. Person: Worlds",
    "--description",
    "For a test.",
];

#[test]
fn the_folder_holds_what_the_card_says() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    worlds(&here.join("w"));
    let printed = json(&mut card(here, ["w", "-o", "hub"].into_iter().chain(SAID)));
    let hub = here.join("hub");
    assert_eq!(printed["missing"].as_array().unwrap().len(), 0);
    let files = contents(&hub);
    let names: Vec<&str> = files.keys().map(String::as_str).collect();
    let expected = [
        "README.md",
        "columns/own.csv",
        "columns/test.csv",
        "croissant.json",
        "defects/test.csv",
        "own.h5",
        "pictures/own.png",
        "pictures/test.png",
        "recipes/own.toml",
        "test.h5",
        "worlds.csv",
    ];
    assert_eq!(names, expected);
    assert_eq!(files["own.h5"], std::fs::read(here.join("w/own.h5")).unwrap());

    // Every file but the two that describe them is listed with its size and checksum.
    let croissant: serde_json::Value = serde_json::from_slice(&files["croissant.json"]).unwrap();
    let objects = croissant["distribution"].as_array().unwrap();
    assert_eq!(objects.len(), names.len() - 2);
    for object in objects {
        let (digest, bytes) =
            sha256_of_file(&hub.join(object["contentUrl"].as_str().unwrap())).unwrap();
        assert_eq!(
            (object["sha256"].as_str(), object["contentSize"].as_str()),
            (Some(digest.as_str()), Some(format!("{bytes} B").as_str()))
        );
    }
    assert_eq!(croissant["conformsTo"][0], "http://mlcommons.org/croissant/1.1");
    for (name, value) in [
        ("name", "Two small worlds"),
        ("license", "https://spdx.org/licenses/CC-BY-4.0.html"),
        ("datePublished", "2026-11-23"),
        ("url", "https://example.org/worlds"),
        ("citeAs", "A. Person: Worlds"),
    ] {
        assert_eq!(croissant[name], value, "{name}");
    }
    assert_eq!(croissant["creator"][1]["@type"], "Organization");
    assert_eq!(croissant["rai:hasSyntheticData"], true);
    for name in [
        "dataCollection",
        "dataBiases",
        "dataLimitations",
        "dataUseCases",
        "dataAnnotationProtocol",
    ] {
        assert!(croissant[format!("rai:{name}")].to_string().len() > 20, "{name}");
    }
    let sets: Vec<&str> = croissant["recordSet"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s["@id"].as_str().unwrap())
        .collect();
    assert_eq!(sets, ["worlds", "columns_own", "columns_test", "defects_test"]);

    let readme = String::from_utf8(files["README.md"].clone()).unwrap();
    assert!(
        readme.starts_with("---\npretty_name: \"Two small worlds\"\nlicense: cc-by-4.0\n"),
        "{readme}"
    );
    let (digest, _) = sha256_of_file(&hub.join("test.h5")).unwrap();
    for part in [
        digest.as_str(),
        "(pictures/own.png)",
        "A. Person",
        "For a test.",
        "import h5py",
        "import stemworlds",
    ] {
        assert!(readme.contains(part), "no {part} in\n{readme}");
    }
    for picture in ["pictures/own.png", "pictures/test.png"] {
        assert!(files[picture].starts_with(b"\x89PNG") && files[picture].len() > 10_000);
    }
}

#[test]
fn tables_are_the_truth_of_the_worlds() {
    let folder = tempfile::tempdir().unwrap();
    let hub = folder.path().join("hub");
    worlds(&hub);
    assert!(card(folder.path(), ["hub", "--quiet"]).status().unwrap().success());
    let world = hdf5::File::open(hub.join("test.h5")).unwrap();
    let truth = |name: &str| world.dataset(&format!("ground_truth/{name}")).unwrap();
    let places = truth("columns/position").read_2d::<f32>().unwrap();
    let vacancies = truth("columns/vacancies").read_1d::<i32>().unwrap();
    let columns = table(&hub.join("columns/test.csv"));
    assert_eq!(columns.len(), vacancies.len());
    for (i, line) in columns.iter().enumerate() {
        assert_eq!(
            (line["column"].as_str(), line["world"].as_str()),
            (i.to_string().as_str(), "test")
        );
        assert_eq!(
            [&line["x_nm"], &line["y_nm"]].map(|v| v.parse::<f32>().unwrap()),
            [places[(i, 0)], places[(i, 1)]]
        );
        assert_eq!(line["vacancies"].parse(), Ok(vacancies[i]));
    }
    let types = truth("atom_types").read_1d::<i32>().unwrap();
    let (depths, of_column) = (
        truth("atom_z").read_1d::<f32>().unwrap(),
        truth("atom_columns").read_1d::<i32>().unwrap(),
    );
    let defects = table(&hub.join("defects/test.csv"));
    assert_eq!(defects.len(), types.iter().filter(|t| **t != 0).count());
    for line in &defects {
        let site: usize = line["site"].parse().unwrap();
        assert_eq!(
            (types[site], line["type"].as_str(), line["element"].as_str()),
            (1, "vacancy", "O")
        );
        assert_eq!(line["z_nm"].parse(), Ok(depths[site]));
        assert_eq!(line["column"].parse(), Ok(of_column[site]));
    }
    let all = table(&hub.join("worlds.csv"));
    let line = &all[1];
    assert_eq!(line["world"], "test");
    assert_eq!(line["vacancies"], defects.len().to_string());
    assert_eq!((line["tile_rows"].as_str(), line["noise"].as_str()), ("1", "true"));

    // The command beside a recipe of one's own makes its world again, where that recipe is.
    let again = tempfile::tempdir().unwrap();
    std::fs::create_dir(again.path().join("recipes")).unwrap();
    std::fs::copy(hub.join("recipes/own.toml"), again.path().join("recipes/own.toml")).unwrap();
    let command = &all[0]["command"];
    assert_eq!(command, "stemgen build --recipe recipes/own.toml -o own.h5");
    let words = command.split(' ').skip(1);
    let run = stemgen(again.path()).args(words).args(["--no-png", "--quiet"]).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let digest = |folder: &Path| python("digest.py", &[&folder.join("own.h5")]);
    assert_eq!(digest(&hub), digest(again.path()));
}

#[test]
fn the_same_worlds_make_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    worlds(&here.join("w"));
    let run = |arguments: &[&str]| {
        let output =
            card(here, arguments.iter().copied().chain(["--title", "T"])).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        stdout(&output) + &stderr(&output)
    };
    let printed = run(&["w/test.h5", "w/own.h5", "-o", "a"]);
    for option in ["--license", "--creator", "--url", "--date", "--cite"] {
        assert!(printed.contains(option), "{printed}");
    }
    let first = contents(&here.join("a"));
    run(&["w", "-o", "b"]);
    assert!(
        contents(&here.join("b")) == first,
        "the order of arguments, or the folder, changes the card"
    );
    run(&["w", "-o", "a", "--threads", "1"]);
    assert!(contents(&here.join("a")) == first, "a second card has other bytes");
    // In the folder itself.
    run(&["w"]);
    assert!(contents(&here.join("w")) == first);
    let text = String::from_utf8(first["README.md"].clone()).unwrap();
    assert!(text.contains("license: unknown") && text.contains("not stated"), "{text}");

    // What belongs to no world of the card is named, and kept.
    std::fs::remove_file(here.join("w/own.h5")).unwrap();
    let printed = run(&["w"]);
    assert!(printed.contains("warning: ") && printed.contains("columns/own.csv"), "{printed}");
    assert!(here.join("w/columns/own.csv").exists());
}

#[test]
fn of_a_wide_field_a_part_is_drawn_too() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let (own, wide) = (file("tests/cli/tiny.toml"), "field.fov_nm=[18,18]");
    for (name, more) in [("narrow.h5", &[][..]), ("wide.h5", &["--set", wide, "--audit", "0"])] {
        let mut command = stemgen(here);
        command.args(["build", "--recipe", &own, "-o", name, "--no-png", "--quiet"]).args(more);
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let output = card(here, [".", "--quiet"]).output().unwrap();
    assert!(output.status.success() && output.stdout.is_empty(), "{}", stderr(&output));
    let files = contents(here);
    assert!(files.contains_key("parts/wide.png") && !files.contains_key("parts/narrow.png"));
    assert!(files["parts/wide.png"] != files["pictures/wide.png"]);
    let readme = String::from_utf8(files["README.md"].clone()).unwrap();
    assert!(
        readme.contains("](parts/wide.png)") && readme.contains(" nm of it, from x = "),
        "{readme}"
    );
    let planned = json(&mut card(here, [".", "--dry-run"]));
    let planned = planned["outputs"].as_array().unwrap();
    let planned =
        |name: &str| planned.iter().any(|p| Path::new(p.as_str().unwrap()).ends_with(name));
    assert!(
        files.keys().filter(|n| !n.ends_with(".h5")).all(|name| planned(name)),
        "{:?}",
        files.keys()
    );
    assert!(contents(here) == files, "a dry run writes");
}

#[test]
fn what_is_no_folder_of_worlds_is_refused_and_nothing_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    worlds(&here.join("w"));
    std::fs::create_dir(here.join("empty")).unwrap();
    std::fs::write(here.join("file"), "text").unwrap();
    let world = std::fs::read(here.join("w/test.h5")).unwrap();
    for (name, bytes) in [("half", &world[..world.len() / 2]), ("text", b"text")] {
        std::fs::create_dir(here.join(name)).unwrap();
        std::fs::copy(here.join("w/test.h5"), here.join(name).join("a.h5")).unwrap();
        std::fs::write(here.join(name).join("broken.h5"), bytes).unwrap();
    }
    std::fs::create_dir(here.join("odd")).unwrap();
    std::fs::write(here.join("odd/a b.h5"), &world).unwrap();
    let before = contents(here);
    let cases: [(&[&str], &str); 14] = [
        (&["empty"], "holds no worlds"),
        (&["gone"], "gone"),
        (&["half"], "half/broken.h5: is not HDF5, or is truncated"),
        (&["text", "-o", "new"], "text/broken.h5: is not HDF5"),
        (&["odd"], "rename it"),
        (&["w/test.h5"], "--output"),
        (&["w", "empty"], "--output"),
        (&["w", "half/a.h5", "w/test.h5", "-o", "new"], "has the name of"),
        (&["w", "-o", "file"], "is a file"),
        (&["w", "-o", "file/new"], "would lie in file, which is a file"),
        (&["w", "-o", "new", "--license", "free"], "CC-BY-4.0"),
        (&["w", "-o", "new", "--date", "today"], "2026-11-23"),
        (&["w", "-o", "new", "--url", "example.org"], "https://"),
        (&["w", "-o", "new", "--title", " "], "title"),
    ];
    for (arguments, expected) in cases {
        let printed = fails(&mut card(here, arguments.iter().copied()));
        assert!(printed.contains(expected), "{arguments:?}: {printed}");
        assert!(
            contents(here) == before && !here.join("new").exists(),
            "{arguments:?} left something"
        );
    }
}

#[test]
fn files_of_others_are_not_replaced_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    worlds(&here.join("w"));
    for name in ["README.md", "worlds.csv"] {
        std::fs::write(here.join("w").join(name), "mine").unwrap();
        let before = contents(&here.join("w"));
        let printed = fails(&mut card(here, ["w"]));
        assert!(printed.contains(name) && printed.contains("--overwrite"), "{printed}");
        assert!(contents(&here.join("w")) == before);
        std::fs::remove_file(here.join("w").join(name)).unwrap();
    }
    std::fs::write(here.join("w/README.md"), "mine").unwrap();
    assert!(card(here, ["w", "--overwrite", "--quiet"]).status().unwrap().success());
    // A world of the same name that holds something else is one of value.
    std::fs::create_dir(here.join("hub")).unwrap();
    std::fs::copy(here.join("w/test.h5"), here.join("hub/own.h5")).unwrap();
    let printed = fails(&mut card(here, ["w", "-o", "hub"]));
    assert!(printed.contains("own.h5") && printed.contains("exists"), "{printed}");
    assert_eq!(contents(&here.join("hub")).len(), 1);
}

#[test]
fn what_a_file_does_not_tell_is_not_said() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    worlds(here);
    let world = hdf5::File::open_rw(here.join("test.h5")).unwrap();
    let metadata = world.group("metadata").unwrap();
    for name in [
        "recipe",
        "stemgen_version",
        "numerics_version",
        "engine",
        "engine_parameters",
        "material",
        "seed",
    ] {
        metadata.delete_attr(name).unwrap();
    }
    let truth = world.group("ground_truth").unwrap();
    for name in ["columns", "atom_columns", "atom_z"] {
        truth.unlink(name).unwrap();
    }
    drop((metadata, truth));
    world.close().unwrap();
    let output = card(here, ["."]).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let readme = std::fs::read_to_string(here.join("README.md")).unwrap();
    assert!(readme.contains("The files do not tell how these were made: test."), "{readme}");
    assert!(!readme.contains("machine-generated") && !readme.contains("Labels are"));
    let croissant: serde_json::Value =
        serde_json::from_slice(&std::fs::read(here.join("croissant.json")).unwrap()).unwrap();
    assert_eq!(croissant["rai:hasSyntheticData"], serde_json::Value::Null);
    let line = &table(&here.join("worlds.csv"))[1];
    assert_eq!(["seed", "engine", "command", "material"].map(|name| line[name].as_str()), [""; 4]);
    let defects = table(&here.join("defects/test.csv"));
    assert!(
        defects
            .iter()
            .all(|d| d["column"].is_empty() && d["z_nm"].is_empty() && d["element"] == "O")
    );
    assert!(!defects.is_empty());
}
