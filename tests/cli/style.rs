//! How pages and comments are written, as far as a program can check it; `docs/style.md` says the rest.

use super::file;
use std::path::{Path, PathBuf};

/// Words in whose place a page or a comment names the thing that it speaks of, with what to write instead.
const WORDS: [(&str, &str); 7] = [
    ("told", "prints, says, returns"),
    ("tells", "prints, says, returns"),
    ("those of", "the noun again"),
    ("whatever", "the thing"),
    ("comes along", "is installed with the program"),
    ("come along", "are installed with the program"),
    ("see the module", "one sentence, or a link with its content"),
];

/// Lines that a page may have. A page whose examples take more is listed with its own number.
const MOST_LINES: usize = 172;
const LONG_PAGES: [(&str, usize); 3] =
    [("docs/from-abtem.md", 440), ("docs/tutorials/experiment.md", 190), ("CONTRIBUTING.md", 290)];

/// Words of headings that begin with a capital anywhere.
const NAMES: [&str; 14] = [
    "Slurm",
    "Python",
    "Rust",
    "Windows",
    "Angstrom",
    "Poisson",
    "Gaussian",
    "Fourier",
    "I",
    "A",
    "Debye-Waller",
    "Wulff",
    "Example",
    "Chromium",
];

/// The pages, by their names in the repository. The changelog lists facts of the past; the page of style quotes the words.
fn pages() -> Vec<(String, String)> {
    let folders =
        ["", "docs", "docs/how-to", "docs/tutorials", "worlds", "generate", "library", "benches"];
    let mut pages = Vec::new();
    for folder in folders {
        for entry in std::fs::read_dir(file(folder)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            if name.ends_with(".md") && !["CHANGELOG.md", "style.md"].contains(&name) {
                let name = format!("{folder}{}{name}", if folder.is_empty() { "" } else { "/" });
                pages.push((name, std::fs::read_to_string(&path).unwrap()));
            }
        }
    }
    assert!(pages.len() >= 40, "{}", pages.len());
    pages
}

/// Lines outside blocks of code, by their numbers.
fn prose(text: &str) -> Vec<(usize, &str)> {
    let mut code = false;
    let mut lines = Vec::new();
    for (number, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            code = !code;
        } else if !code && !line.trim_start().starts_with("<!--") {
            lines.push((number + 1, line));
        }
    }
    lines
}

/// The first word of [`WORDS`] in a text, as a word of its own.
fn found(text: &str) -> Option<(&'static str, &'static str)> {
    let text = text.to_lowercase();
    let letter = |c: Option<char>| c.is_some_and(char::is_alphanumeric);
    WORDS.into_iter().find(|(word, _)| {
        text.match_indices(word).any(|(at, _)| {
            let (before, after) = (&text[..at], &text[at + word.len()..]);
            !letter(before.chars().next_back()) && !letter(after.chars().next())
        })
    })
}

#[test]
fn pages_name_the_things_they_speak_of() {
    for (name, text) in pages() {
        for (number, line) in prose(&text) {
            if let Some((word, instead)) = found(line) {
                panic!("{name}:{number}: `{word}`; write {instead} (docs/style.md): {line}");
            }
        }
    }
    assert_eq!(found("It Tells you").map(|(word, _)| word), Some("tells"));
    assert_eq!(found("the hotels of Tollund"), None);
}

#[test]
fn pages_are_short_and_their_headings_in_sentence_case() {
    for (name, text) in pages() {
        let most =
            LONG_PAGES.iter().find(|(long, _)| *long == name).map_or(MOST_LINES, |(_, n)| *n);
        let count = text.lines().count();
        assert!(count <= most, "{name}: {count} lines; split it into use and method");
        for (number, line) in prose(&text).into_iter().filter(|(_, line)| line.starts_with('#')) {
            // A word after a colon, a number or a full stop begins a sentence.
            let mut begins = true;
            for word in line.trim_start_matches('#').split_whitespace() {
                let plain = word.trim_matches(|c: char| !c.is_alphanumeric());
                let capitals = plain.chars().filter(|c| c.is_uppercase()).count();
                let capital = plain.chars().next().is_some_and(char::is_uppercase);
                let name_of_a_thing = capitals > 1 || NAMES.contains(&plain) || word.contains('`');
                let right = begins
                    || !capital
                    || name_of_a_thing
                    || plain.contains(|c: char| c.is_numeric());
                assert!(right, "{name}:{number}: `{word}`; headings are in sentence case");
                begins = word.ends_with([':', '.', '?']);
            }
        }
    }
}

/// Sources below a folder.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn comments_name_the_things_they_speak_of() {
    let mut paths = Vec::new();
    ["src", "cli/src", "python/src"].iter().for_each(|f| sources(Path::new(&file(f)), &mut paths));
    assert!(paths.len() > 400, "{}", paths.len());
    for path in paths {
        let text = std::fs::read_to_string(&path).unwrap();
        for (number, line) in text.lines().enumerate() {
            let Some(comment) = line.trim_start().strip_prefix("//") else { continue };
            if let Some((word, instead)) = found(comment) {
                let at = format!("{}:{}", path.display(), number + 1);
                panic!("{at}: `{word}`; write {instead} (docs/style.md): {comment}");
            }
        }
    }
}

/// The commands that pages show exist, with all of their options.
#[test]
fn commands_of_pages_have_their_options() {
    let mut checked = 0;
    for (name, text) in pages() {
        for block in text.split("```sh\n").skip(1) {
            let block = block.split("```").next().unwrap().replace("\\\n", " ");
            for line in block.lines() {
                let line = line.split(" #").next().unwrap();
                for command in line.split([';', '|', '&']) {
                    let mut words =
                        command.split_whitespace().skip_while(|w| *w != "stemgen").skip(1);
                    let Some(sub) = words.next().filter(|w| !w.starts_with('-')) else { continue };
                    let words: Vec<&str> = words.collect();
                    checked += usize::from(check(&name, sub, &words));
                }
            }
        }
    }
    assert!(checked > 60, "{checked}");
}

/// Compares a command with the stored text of its help; whether there is one.
fn check(page: &str, sub: &str, words: &[&str]) -> bool {
    let action = words.first().filter(|_| sub == "cache").map(|action| format!("cache-{action}"));
    let path = file(&format!("tests/cli/help/{}.txt", action.as_deref().unwrap_or(sub)));
    if sub == "glossary" || sub == "help" {
        return false;
    }
    let Ok(help) = std::fs::read_to_string(&path) else {
        panic!("{page}: no command `stemgen {sub}`")
    };
    for word in words.iter().filter(|w| w.starts_with("--")) {
        let option = word.split('=').next().unwrap().trim_end_matches([')', ',', '"', '\'']);
        let known = help.split(|c: char| !(c.is_alphanumeric() || c == '-')).any(|w| w == option);
        assert!(known, "{page}: `stemgen {sub}` has no {option}");
    }
    true
}
