//! Rules that the sources keep.

use std::fs;
use std::path::{Path, PathBuf};

/// A folder of this repository.
fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// All Rust sources of the library and of the command line.
fn all_sources() -> Vec<PathBuf> {
    [sources(&folder("src")), sources(&folder("cli/src"))].concat()
}

/// All Rust sources below `folder`.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(sources(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
    found
}

/// The text literals of Rust source, with the numbers of the lines where they begin.
fn literals(source: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let (mut rest, mut line) = (source, 1);
    while let Some(c) = rest.chars().next() {
        let taken = match c {
            '/' if rest.starts_with("//") => rest.find('\n').unwrap_or(rest.len()),
            '/' if rest.starts_with("/*") => rest.find("*/").map_or(rest.len(), |n| n + 2),
            '\'' => length_of_character(rest),
            'r' if raw_hashes(rest).is_some() => {
                let hashes = raw_hashes(rest).unwrap();
                let end = format!("\"{}", "#".repeat(hashes));
                let text = &rest[hashes + 2..];
                let length = text.find(&end).unwrap();
                found.push((line, text[..length].to_owned()));
                hashes + 2 + length + end.len()
            }
            '"' => {
                let length = length_of_text(rest);
                found.push((line, rest[1..length - 1].to_owned()));
                length
            }
            c if c.is_alphanumeric() || c == '_' => {
                rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len())
            }
            c => c.len_utf8(),
        };
        line += rest[..taken].matches('\n').count();
        rest = &rest[taken..];
    }
    found
}

/// The number of `#` of a raw literal (`r"` or `r#"`) that begins here.
fn raw_hashes(text: &str) -> Option<usize> {
    let hashes = text[1..].bytes().take_while(|b| *b == b'#').count();
    (text.as_bytes().get(1 + hashes) == Some(&b'"')).then_some(hashes)
}

/// Length of the character literal or of the quote of a lifetime that begins here.
fn length_of_character(text: &str) -> usize {
    let second = text[1..].chars().next().map_or(0, char::len_utf8);
    match text.as_bytes() {
        [_, b'\\', ..] => 3 + text[3..].find('\'').unwrap() + 1,
        bytes if bytes.get(1 + second) == Some(&b'\'') => second + 2,
        _ => 1,
    }
}

/// Length of the text literal that begins here, with its quotes.
fn length_of_text(text: &str) -> usize {
    let mut escaped = false;
    for (at, c) in text.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return at + 1,
            _ => {}
        }
    }
    panic!("a text literal has no end: {}", &text[..text.len().min(60)])
}

/// Whether a text names an option of a command line: `--` and a small letter.
fn names_an_option(text: &str) -> bool {
    text.match_indices("--")
        .any(|(at, _)| text[at + 2..].starts_with(|c: char| c.is_ascii_lowercase()))
}

#[test]
fn literals_are_found() {
    let source = "let a = \"x\\\"y\"; // \"no\"\nlet b = r#\"--r \"q\"#; let c: &'static str = \"--s\"; '\"'; '\\''";
    let found = literals(source);
    let texts: Vec<&str> = found.iter().map(|(_, text)| text.as_str()).collect();
    assert_eq!(texts, ["x\\\"y", "--r \"q", "--s"]);
    assert_eq!(found[1].0, 2);
    assert!(names_an_option("use --zone") && !names_an_option("<!-- a --> x -- y"));
}

/// A literal as it is read: lines that end with a backslash run on without the blanks that follow.
fn joined(literal: &str) -> String {
    let mut parts = literal.split("\\\n");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| text + part.trim_start())
}

/// Whether four blanks or more stand between words of one line.
fn has_a_gap(text: &str) -> bool {
    let words = |line: &str| {
        let line = line.trim();
        line.find("    ").is_some_and(|at| {
            let word = |c: Option<char>| c.is_some_and(|c| c.is_alphabetic() || c == ',');
            word(line[..at].chars().last()) && word(line[at..].trim_start().chars().next())
        })
    };
    text.lines().any(words)
}

#[test]
fn no_sentence_has_a_gap() {
    assert!(has_a_gap("which     should do") && !has_a_gap("    indented\n    text"));
    for path in all_sources() {
        for (line, text) in literals(&fs::read_to_string(&path).unwrap()) {
            let text = joined(&text);
            assert!(!has_a_gap(&text), "{}:{line}: {text}", path.display());
        }
    }
}

/// A message of the library is read through other front ends too, which have no such options; the
/// command line adds the option in `cli/src/hints.rs`.
#[test]
fn the_library_names_no_options_of_the_command_line() {
    let mut faults = Vec::new();
    for path in sources(&folder("src")) {
        let source = fs::read_to_string(&path).unwrap();
        for (line, text) in literals(&source) {
            if names_an_option(&text) {
                faults.push(format!("{}:{line}: {text}", path.display()));
            }
        }
    }
    assert!(faults.is_empty(), "options in messages of the library:\n{}", faults.join("\n"));
}

/// The clock of the day can be set while the program runs, so nothing is timed with it, and nothing depends on the times of files.
/// A report tells the date; that is all.
#[test]
fn time_is_measured_with_a_clock_that_nobody_sets() {
    let dated = folder("src/validate/report/mod.rs");
    for path in all_sources().into_iter().filter(|path| *path != dated) {
        let source = fs::read_to_string(&path).unwrap();
        for word in ["SystemTime", "UNIX_EPOCH", ".modified()", "ClockId::Realtime"] {
            assert!(!source.contains(word), "{}: {word}", path.display());
        }
    }
}
