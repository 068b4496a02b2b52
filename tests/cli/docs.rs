//! README and the pages below docs/: what they show runs, and what they link to is there.

use super::{file, interpreter, stderr, stdout, stemgen};
use std::path::{Path, PathBuf};

/// All pages of the repository.
fn pages() -> Vec<PathBuf> {
    let folders = [
        "",
        "docs",
        "docs/how-to",
        "docs/tutorials",
        "worlds",
        "generate",
        "benches",
        "tests/golden",
    ];
    let all = folders.iter().flat_map(|folder| std::fs::read_dir(file(folder)).unwrap());
    let paths = all.map(|entry| entry.unwrap().path());
    let pages: Vec<PathBuf> = paths.filter(|p| p.extension().is_some_and(|e| e == "md")).collect();
    assert!(pages.len() >= 10, "{pages:?}");
    pages
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// What a page links to.
fn links(text: &str) -> Vec<String> {
    let after = text.split("](").skip(1);
    after.filter_map(|rest| Some(rest.split_once(')')?.0.to_owned())).collect()
}

/// The name that a heading has in links.
fn anchor(heading: &str) -> String {
    let plain = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = plain.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
    kept.collect::<String>().replace(' ', "-")
}

#[test]
fn links_of_all_pages_resolve() {
    let mut checked = 0;
    for page in pages() {
        for link in links(&text(&page)) {
            if link.starts_with("http://") || link.starts_with("https://") {
                continue;
            }
            let (path, heading) = link.split_once('#').unwrap_or((&link, ""));
            let target = match path {
                "" => page.clone(),
                path => page.parent().unwrap().join(path),
            };
            assert!(target.exists(), "{}: no {link}", page.display());
            if !heading.is_empty() {
                let headings = text(&target);
                let mut headings = headings.lines().filter(|line| line.starts_with('#'));
                assert!(headings.any(|h| anchor(h) == heading), "{}: no {link}", page.display());
            }
            checked += 1;
        }
    }
    assert!(checked > 15, "{checked}");
    assert_eq!(links("a [b](c.md#d) [e](f)"), ["c.md#d", "f"]);
    assert_eq!(anchor("## How right, how fast?"), "how-right-how-fast");
}

#[test]
fn the_readme_is_short_and_begins_with_what_it_is() {
    let readme = text(Path::new(&file("README.md")));
    assert!(readme.lines().count() <= 150, "{} lines", readme.lines().count());
    let first: Vec<&str> = readme.lines().take(60).collect();
    for part in ["![", "```python", "What it does not do", "abTEM", "first-world.sh"] {
        assert!(first.iter().any(|line| line.contains(part)), "no `{part}` on the first screen");
    }
    let picture = std::fs::metadata(file("docs/world.png")).unwrap();
    assert!(picture.len() <= 200_000, "{} bytes", picture.len());
}

/// The blocks of a page in this language.
fn blocks(text: &str, language: &str) -> Vec<String> {
    let begin = format!("```{language}\n");
    let after = text.split(&begin).skip(1);
    after.filter_map(|rest| Some(rest.split_once("```")?.0.to_owned())).collect()
}

#[test]
fn the_snippets_of_the_readme_run() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    std::fs::create_dir(f.join("worlds")).unwrap();
    let run = |arguments: &[&str]| {
        let run = stemgen(f).args(arguments).arg("--quiet").output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
    };
    // Stand-ins for what the commands before the snippets make, in seconds.
    let thin = ["--grid", "1x1", "--set", "field.thickness_nm=0.4", "--no-png"];
    let world = ["-o", "worlds/srtio3_easy_1x1.h5"];
    run(&[&["build", "test"], &thin[..], &world[..]].concat());
    let readme = text(Path::new(&file("README.md")));
    // Those of the Python package run where it is installed: python/tests/test_docs.py.
    let mut snippets = blocks(&readme, "python");
    snippets.retain(|snippet| !snippet.contains("stemworlds"));
    assert_eq!(snippets.len(), 1, "{snippets:?}");
    for (snippet, check) in snippets
        .iter()
        .zip(["assert image.shape == (128, 128) and 0 <= image.min() < image.max() <= 1\n\
         assert len(x) == len(y) == len(vacant) and 0 < vacant.sum() < len(x)"])
    {
        let script = format!("{snippet}\n{check}\n");
        let mut python = std::process::Command::new(interpreter::with_h5py());
        let run = python.current_dir(f).args(["-c", &script]).output().unwrap();
        assert!(run.status.success(), "{script}\n{}{}", stdout(&run), stderr(&run));
    }
}

/// Whether a word of a command is the name of a file.
fn is_file_name(word: &str) -> bool {
    let endings = ["cif", "xyz", "extxyz", "toml", "h5", "npz", "npy", "emd", "zarr", "sh", "hspy"];
    Path::new(word).extension().is_some_and(|e| endings.iter().any(|ending| e == *ending))
}

/// The world that a line of shell builds, by its usual name.
fn built(words: &[&str]) -> Option<String> {
    if words.contains(&"generate/first-world.sh") {
        return Some("worlds/srtio3_easy_1x1.h5".into());
    }
    let value = |option: &str| Some(*words.get(words.iter().position(|w| *w == option)? + 1)?);
    let material = words.strip_prefix(&["stemgen", "build"])?.first()?;
    let tier = value("--difficulty")?;
    let grid = value("--grid").map_or(String::new(), |grid| format!("_{grid}"));
    Some(format!("worlds/{material}_{tier}{grid}.h5"))
}

/// Who types the commands of the README in their order finds each file: it comes along, or a command before has written it.
#[test]
fn files_that_the_readme_names_are_there() {
    let readme = text(Path::new(&file("README.md")));
    let shell = blocks(&readme, "sh").concat().replace("\\\n", " ");
    assert!(shell.contains("export PATH=\"$PWD/target/release:$PATH\""), "stemgen is on the path");
    let mut made: Vec<String> = Vec::new();
    let mut checked = 0;
    for line in shell.lines() {
        let words: Vec<&str> = line.split(" #").next().unwrap().split_whitespace().collect();
        let mut before = "";
        for word in &words {
            if is_file_name(word) {
                match before {
                    "-o" | "--output" | "--write-request" | "--out" => made.push((*word).into()),
                    _ => {
                        let there =
                            made.iter().any(|m| m == word) || Path::new(&file(word)).is_file();
                        assert!(there, "{word} is nowhere: {line}");
                        checked += 1;
                    }
                }
            }
            before = word;
        }
        made.extend(built(&words));
    }
    assert!(checked > 8, "{checked}");
}

#[test]
fn commands_of_the_pages_are_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let mut tried = 0;
    for page in pages() {
        let text = text(&page);
        let shell: Vec<String> = blocks(&text, "sh");
        let lines = shell.iter().flat_map(|block| block.lines());
        for line in lines.filter(|l| l.starts_with("stemgen ") && !l.contains('|')) {
            let line = line.split(" # ").next().unwrap().split(" > ").next().unwrap();
            let line = line.trim_end().trim_end_matches('\\');
            // Options and their values are read before any file is, and nothing is computed.
            let run =
                stemgen(folder.path()).args(line.split_whitespace().skip(1)).arg("--help").output();
            let run = run.unwrap();
            assert!(run.status.success(), "{}: {line}\n{}", page.display(), stderr(&run));
            tried += 1;
        }
    }
    assert!(tried > 15, "{tried}");
}
