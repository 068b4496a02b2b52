//! The steps of CONTRIBUTING.md lead somewhere: its material is built, the files and names of its steps exist. Its Rust runs
//! as a doc test (see the end of `src/lib.rs`).

use std::fs;
use std::path::{Path, PathBuf};

use stemgen::imaging::{Cache, PixelRect};
use stemgen::progress::Silent;
use stemgen::recipe::{Difficulty, Recipe};
use stemgen::specimen::specimen;
use stemgen::world::{BuildMethod, BuildOptions, field_tile};

const GUIDE: &str = include_str!("../../CONTRIBUTING.md");

fn file(name: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join(name)
}

/// The text of the block of a language; blocks of lists are indented.
fn block(language: &str) -> String {
    let start = GUIDE.split(&format!("```{language}\n")).nth(1).expect("a block of the language");
    let text = start.split("```").next().unwrap_or_default();
    text.lines().map(|line| line.strip_prefix("   ").unwrap_or(line).to_owned() + "\n").collect()
}

/// The numbered steps of a section, each with its title.
fn steps(title: &str) -> Vec<String> {
    let section = GUIDE.split("\n## ").find(|s| s.starts_with(title)).expect("a section");
    let mut steps: Vec<String> = Vec::new();
    for line in section.lines() {
        if line.split_once(". ").is_some_and(|(number, _)| number.parse::<u32>().is_ok()) {
            steps.push(String::new());
        }
        if let Some(step) = steps.last_mut() {
            *step += line;
            step.push('\n');
        }
    }
    steps
}

/// What stands between single backquotes.
fn quoted(step: &str) -> Vec<&str> {
    let text = step.split("```").step_by(2);
    text.flat_map(|part| part.split('`').skip(1).step_by(2)).collect()
}

#[test]
fn the_material_is_laid_out_and_imaged() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("mgo.cif"), block("cif")).unwrap();
    let path = folder.path().join("mgo.toml");
    fs::write(&path, block("toml")).unwrap();
    for difficulty in Difficulty::ALL {
        let recipe = Recipe::from_file(&path, Some(difficulty)).unwrap().checked().unwrap();
        let field = recipe.field.full_region();
        let area = (field.x[1] - field.x[0]) * (field.y[1] - field.y[0]);
        let specimen = specimen(&recipe).unwrap();
        let density = specimen.sites(&field).len() as f64 / (area * specimen.facts().thickness_nm);
        let perfect = 8.0 / 0.4211f64.powi(3);
        assert!((density / perfect - 1.0).abs() < 0.02, "{density}, expected {perfect}");
    }
    let easy = Recipe::from_file(&path, Some(Difficulty::Easy)).unwrap();
    let changes = ["field.thickness_nm=1.0", "phonons.configurations=1", "detector.outer_mrad=90"];
    let changes: Vec<_> = changes.iter().map(|change| change.parse().unwrap()).collect();
    let thin = easy.with_overrides(&changes).unwrap().checked().unwrap();
    let specimen = specimen(&thin).unwrap();
    let method = BuildMethod::Window;
    let options = BuildOptions { method, cache: Cache::none(), ..BuildOptions::default() };
    let policy = options.policy(&thin).unwrap();
    let mut imager = policy.imaging.imager(&thin, &specimen).unwrap();
    imager.prepare(&Silent).unwrap();
    let pixels = PixelRect::new([300, 300], [24, 24]);
    let tile = field_tile(&thin, &*specimen, &*imager, &pixels, None, &Silent).unwrap();
    let range = |pick: fn(f32, f32) -> f32| tile.clean.iter().copied().reduce(pick).unwrap();
    let (darkest, brightest) = (range(f32::min), range(f32::max));
    assert!(darkest >= 0.0 && brightest > 2.0 * darkest && brightest < 1.0, "{brightest}");
    assert!(!tile.columns.is_empty());
}

/// Files that the guide tells to write.
fn is_new(name: &str) -> bool {
    name.contains("mgo") || name.contains("NAME") || name.contains(' ')
}

#[test]
fn the_files_and_names_of_all_steps_exist() {
    let mut checked = 0;
    for title in ["Adding a material", "Adding a detector", "Adding a subcommand"] {
        for step in steps(title) {
            let words = quoted(&step);
            let is_file = |word: &&&str| word.contains('/') && !is_new(word);
            let files: Vec<PathBuf> = words.iter().filter(is_file).map(|word| file(word)).collect();
            let missing: Vec<_> = files.iter().filter(|path| !path.exists()).collect();
            assert!(missing.is_empty(), "{missing:?} of: {step}");
            let read = |path: &PathBuf| fs::read_to_string(path).unwrap_or_default();
            let texts: String = files.iter().map(read).collect();
            for word in words.iter().filter(|word| names_code(word)) {
                let own = word.rsplit("::").next().unwrap();
                assert!(texts.contains(own), "`{word}` is in no file of: {step}");
                checked += 1;
            }
        }
    }
    assert!(checked > 8, "{checked}");
}

/// Whether a quoted text is a name of the sources: `LIBRARY`, `fn weight`, `Detector::weight`.
fn names_code(word: &str) -> bool {
    let item = ["fn ", "pub fn ", "enum "].iter().any(|start| word.starts_with(start));
    let constant = word.len() > 4 && word.chars().all(|c| c.is_ascii_uppercase() || c == '_');
    let path = word.contains("::") && word.chars().all(|c| c.is_alphanumeric() || "_:".contains(c));
    (item && !word.contains("->")) || constant || (path && !word.starts_with("Error::"))
}

#[test]
fn every_subcommand_took_the_steps() {
    let commands = fs::read_to_string(file("cli/src/lib.rs")).unwrap();
    let help = fs::read_to_string(file("tests/cli/help.rs")).unwrap();
    let mut count = 0;
    for entry in fs::read_dir(file("cli/src")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let Some(name) = name.strip_suffix("_command.rs") else { continue };
        let words = name.replace('_', "-");
        assert!(commands.contains(&format!("mod {name}_command;")), "{name}");
        assert!(commands.contains(&format!("(Box<{name}_command::")), "{name} in enum Command");
        assert!(help.contains(&format!("compare(\"{words}\"")), "{name} in tests/cli/help.rs");
        assert!(file(&format!("tests/cli/help/{words}.txt")).exists(), "{name}: text of its help");
        count += 1;
    }
    assert!(count >= 10, "{count}");
}
