//! The rooms of the house: what `src/lib.rs` tells of the modules, held against the sources.
//!
//! A room uses only rooms that stand above it in the list of `src/lib.rs`; circles of files that use each other hold
//! three files at most; every file name and every type name stands for one thing.

#[path = "common/skipped.rs"]
mod skipped;

use skipped::skipped;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// A piece of Rust source.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Token {
    Word(String),
    Mark(char),
}

impl Token {
    fn is(&self, mark: char) -> bool {
        *self == Token::Mark(mark)
    }
    fn word(&self) -> Option<&str> {
        match self {
            Token::Word(word) => Some(word),
            Token::Mark(_) => None,
        }
    }
}

/// Words and marks, without comments and literals.
fn tokens(source: &str) -> Vec<Token> {
    let mut found = Vec::new();
    let mut rest = source;
    while let Some(c) = rest.chars().next() {
        let letter = |c: char| c.is_alphanumeric() || c == '_';
        let taken = match c {
            '/' if rest.starts_with("//") => rest.find('\n').unwrap_or(rest.len()),
            '/' if rest.starts_with("/*") => rest.find("*/").map_or(rest.len(), |n| n + 2),
            'r' if rest.starts_with("r\"") || rest.starts_with("r#") => raw_length(rest),
            '"' => text_length(rest),
            '\'' => character_length(rest),
            c if letter(c) => {
                let length = rest.find(|c| !letter(c)).unwrap_or(rest.len());
                found.push(Token::Word(rest[..length].to_owned()));
                length
            }
            c => {
                if !c.is_whitespace() {
                    found.push(Token::Mark(c));
                }
                c.len_utf8()
            }
        };
        rest = &rest[taken..];
    }
    found
}

fn raw_length(rest: &str) -> usize {
    let hashes = rest[1..].bytes().take_while(|b| *b == b'#').count();
    let end = format!("\"{}", "#".repeat(hashes));
    let start = 2 + hashes;
    start + rest[start..].find(&end).expect("a raw literal ends") + end.len()
}

fn text_length(rest: &str) -> usize {
    let mut escaped = false;
    for (at, c) in rest.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return at + 1,
            _ => {}
        }
    }
    panic!("a text literal ends")
}

/// Length of a character literal, or of the quote of a lifetime.
fn character_length(rest: &str) -> usize {
    let second = rest[1..].chars().next().map_or(0, char::len_utf8);
    match rest.as_bytes() {
        [_, b'\\', ..] => 4 + rest[3..].find('\'').expect("a character ends"),
        bytes if bytes.get(1 + second) == Some(&b'\'') => second + 2,
        _ => 1,
    }
}

/// Leaves out what stands behind `#[cfg(test)]`.
fn without_tests(tokens: &[Token]) -> Vec<Token> {
    let attribute = self::tokens("#[cfg(test)]");
    let mut kept = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        if tokens[at..].starts_with(&attribute) {
            at = end_of_item(tokens, at + attribute.len());
        } else {
            kept.push(tokens[at].clone());
            at += 1;
        }
    }
    kept
}

/// Behind the `;` or the outermost `}` that comes next.
fn end_of_item(tokens: &[Token], from: usize) -> usize {
    let mut depth = 0;
    for (at, token) in tokens.iter().enumerate().skip(from) {
        match token {
            Token::Mark('{') => depth += 1,
            Token::Mark('}') => depth -= 1,
            _ => {}
        }
        if depth == 0 && (token.is(';') || token.is('}')) {
            return at + 1;
        }
    }
    tokens.len()
}

/// A file: the module that it is (`["structure", "cif", "tokens"]`), and what it holds besides tests.
struct Source {
    path: PathBuf,
    module: Vec<String>,
    tokens: Vec<Token>,
}

/// The sources of the library and of the command line.
fn roots() -> [PathBuf; 2] {
    ["src", "cli/src"].map(|folder| Path::new(env!("CARGO_MANIFEST_DIR")).join(folder))
}

/// The sources of the library.
fn root() -> PathBuf {
    let [library, _] = roots();
    library
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false if path.extension().is_some_and(|e| e == "rs") => found.push(path),
            false => {}
        }
    }
    found.sort();
    found
}

/// The sources of a crate.
fn crate_of(root: &Path) -> Vec<Source> {
    let program = root.join("main.rs");
    let paths = files(root).into_iter().filter(|path| *path != program);
    paths.map(|path| source(root, path)).collect()
}

fn source(root: &Path, path: PathBuf) -> Source {
    let relative = path.strip_prefix(root).unwrap().with_extension("");
    let mut module: Vec<String> =
        relative.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
    if ["mod", "lib"].contains(&module.last().unwrap().as_str()) {
        module.pop();
    }
    let tokens = without_tests(&tokens(&fs::read_to_string(&path).unwrap()));
    Source { path, module, tokens }
}

/// The modules that a file declares.
fn children(tokens: &[Token]) -> Vec<&str> {
    let declared = |w: &[Token]| w[0].word() == Some("mod") && w[2].is(';');
    tokens.windows(3).filter(|w| declared(w)).filter_map(|w| w[1].word()).collect()
}

/// A path that a file names, counted from the crate, and whether it passes it on with `pub use`.
struct Named {
    path: Vec<String>,
    passed_on: bool,
}

/// All paths of a file that begin with `crate`, `super`, `self` or one of its own modules.
fn named(source: &Source) -> Vec<Named> {
    let tokens = &source.tokens;
    let own = children(tokens);
    let mut found = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        let begins = tokens[at].word().is_some_and(|word| {
            let relative = ["crate", "super", "self"].contains(&word) || own.contains(&word);
            relative && is_colons(tokens, at + 1) && !(at > 0 && tokens[at - 1].is(':'))
        });
        if !begins {
            at += 1;
            continue;
        }
        let passed_on = is_pub_use(&tokens[..at]);
        let mut paths = Vec::new();
        at = read_tree(tokens, at, &[], &mut paths);
        let absolute = paths.iter().map(|path| absolute(&source.module, path));
        found.extend(absolute.map(|path| Named { path, passed_on }));
    }
    found
}

fn is_colons(tokens: &[Token], at: usize) -> bool {
    tokens.get(at).is_some_and(|t| t.is(':')) && tokens.get(at + 1).is_some_and(|t| t.is(':'))
}

/// Whether `pub use` or `pub(...) use` stands at the end.
fn is_pub_use(before: &[Token]) -> bool {
    let Some((last, before)) = before.split_last() else { return false };
    let closed = before.last().is_some_and(|t| t.is(')'));
    let opened = before.iter().rposition(|t| t.is('(')).filter(|_| closed);
    let visible = opened.map_or(before.last(), |open| before[..open].last());
    last.word() == Some("use") && visible.and_then(Token::word) == Some("pub")
}

/// Reads `a::b::{c, d::e as f, *}`, and returns what follows it.
fn read_tree(
    tokens: &[Token],
    mut at: usize,
    prefix: &[String],
    out: &mut Vec<Vec<String>>,
) -> usize {
    let mut path = prefix.to_vec();
    loop {
        match tokens.get(at) {
            Some(Token::Word(word)) => {
                path.push(word.clone());
                at += 1;
            }
            Some(Token::Mark('{')) => {
                at += 1;
                while !tokens[at].is('}') {
                    at = read_tree(tokens, at, &path, out);
                    at += usize::from(tokens[at].is(','));
                }
                return at + 1;
            }
            Some(Token::Mark('*')) => {
                at += 1;
                break;
            }
            _ => break,
        }
        match is_colons(tokens, at) {
            true => at += 2,
            false => break,
        }
    }
    out.push(path);
    match tokens.get(at).and_then(Token::word) == Some("as") {
        true => at + 2,
        false => at,
    }
}

/// A path as counted from the crate.
fn absolute(module: &[String], path: &[String]) -> Vec<String> {
    let mut base = match path[0].as_str() {
        "crate" => Vec::new(),
        _ => module.to_vec(),
    };
    for part in path {
        match part.as_str() {
            "crate" | "self" => {}
            "super" => drop(base.pop()),
            name => base.push(name.to_owned()),
        }
    }
    base
}

/// Where names of the library lie.
struct House {
    sources: Vec<Source>,
    /// Number of the file of each module.
    modules: BTreeMap<Vec<String>, usize>,
    /// What modules pass on with `pub use`: path by which it is named, path at which it lies.
    passed_on: BTreeMap<Vec<String>, Vec<String>>,
}

impl House {
    fn new(root: &Path) -> Self {
        let sources = crate_of(root);
        let modules = sources.iter().enumerate().map(|(k, s)| (s.module.clone(), k)).collect();
        let mut passed_on = BTreeMap::new();
        for source in &sources {
            for named in named(source).into_iter().filter(|n| n.passed_on) {
                let mut alias = source.module.clone();
                alias.extend(named.path.last().cloned());
                passed_on.insert(alias, named.path);
            }
        }
        House { sources, modules, passed_on }
    }

    /// The file in which a name is defined.
    fn file_of(&self, path: &[String]) -> Option<usize> {
        let mut path = path.to_vec();
        for _ in 0..8 {
            let alias = (1..=path.len()).rev().find(|&n| self.passed_on.contains_key(&path[..n]));
            let Some(n) = alias else { break };
            path = [&self.passed_on[&path[..n]], &path[n..]].concat();
        }
        (1..=path.len()).rev().find_map(|n| self.modules.get(&path[..n]).copied())
    }

    /// The files that each file uses.
    fn uses(&self) -> Vec<BTreeSet<usize>> {
        let of = |(k, source): (usize, &Source)| {
            let named = named(source).into_iter().filter(|n| !n.passed_on);
            named.filter_map(|n| self.file_of(&n.path)).filter(|&to| to != k).collect()
        };
        self.sources.iter().enumerate().map(of).collect()
    }

    fn name(&self, file: usize) -> String {
        self.sources[file].path.display().to_string()
    }
}

/// The rooms in the order in which the page of the library lists them.
fn listed() -> Vec<String> {
    let page = fs::read_to_string(root().join("lib.rs")).unwrap();
    let room = |line: &str| {
        let (name, _) = line.strip_prefix("//! - ")?.split_once(':')?;
        Some(name.trim_matches(['[', ']', '`']).to_owned())
    };
    page.lines().filter_map(room).collect()
}

#[test]
fn the_page_of_the_library_lists_every_room() {
    let page = tokens(&fs::read_to_string(root().join("lib.rs")).unwrap());
    let mut declared = children(&page);
    let mut listed = listed();
    declared.sort_unstable();
    listed.sort_unstable();
    assert_eq!(listed, declared, "the list of rooms in src/lib.rs");
}

#[test]
fn a_room_uses_only_rooms_above_it() {
    let house = House::new(&root());
    let listed = listed();
    let place = |file: usize| {
        let room = house.sources[file].module.first()?;
        listed.iter().position(|name| name == room)
    };
    let mut faults = Vec::new();
    for (from, used) in house.uses().iter().enumerate() {
        let below = used.iter().filter(|&&to| place(from) < place(to) && place(from).is_some());
        faults.extend(below.map(|&to| format!("{} uses {}", house.name(from), house.name(to))));
    }
    assert!(faults.is_empty(), "against the order of src/lib.rs:\n{}", faults.join("\n"));
}

#[test]
fn circles_of_files_are_short() {
    for root in roots() {
        let house = House::new(&root);
        let uses = house.uses();
        assert!(uses.iter().any(|used| !used.is_empty()), "{}: no file is used", root.display());
        let circles = (0..uses.len()).filter_map(|first| long_circle(&uses, &mut vec![first]));
        let names = |circle: Vec<usize>| circle.iter().map(|&k| house.name(k)).collect::<Vec<_>>();
        let circles: Vec<String> = circles.map(|circle| names(circle).join(" -> ")).collect();
        assert!(
            circles.is_empty(),
            "files that use each other in a circle:\n{}",
            circles.join("\n")
        );
    }
}

/// A circle of more than three files that goes on from `path` and whose first file has the lowest number.
fn long_circle(uses: &[BTreeSet<usize>], path: &mut Vec<usize>) -> Option<Vec<usize>> {
    let (first, last) = (path[0], path[path.len() - 1]);
    if path.len() > 3 && uses[last].contains(&first) {
        return Some(path.clone());
    }
    for &next in &uses[last] {
        if next > first && !path.contains(&next) && reaches(uses, next, first) {
            path.push(next);
            let found = long_circle(uses, path);
            path.pop();
            if found.is_some() {
                return found;
            }
        }
    }
    None
}

/// Whether a file uses another, or files that do.
fn reaches(uses: &[BTreeSet<usize>], from: usize, to: usize) -> bool {
    let mut reached = BTreeSet::new();
    let mut open = vec![from];
    while let Some(file) = open.pop() {
        open.extend(uses[file].iter().filter(|&&next| reached.insert(next)));
    }
    reached.contains(&to)
}

#[test]
fn long_circles_are_found() {
    let uses = |lists: &[&[usize]]| -> Vec<BTreeSet<usize>> {
        lists.iter().map(|list| list.iter().copied().collect()).collect()
    };
    let star = uses(&[&[1, 2, 3], &[0], &[0], &[0]]);
    assert_eq!(long_circle(&star, &mut vec![0]), None);
    let ring = uses(&[&[1], &[2], &[3], &[0]]);
    assert_eq!(long_circle(&ring, &mut vec![0]), Some(vec![0, 1, 2, 3]));
}

#[test]
fn every_file_name_stands_for_one_file() {
    let mut by_name: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for path in roots().iter().flat_map(|root| files(root)) {
        by_name.entry(path.file_name().unwrap().to_owned()).or_default().push(path);
    }
    by_name.remove(std::ffi::OsStr::new("mod.rs"));
    by_name.remove(std::ffi::OsStr::new("lib.rs"));
    by_name.retain(|_, paths| paths.len() > 1);
    assert!(by_name.is_empty(), "{by_name:#?}");
}

#[test]
fn every_type_name_stands_for_one_type() {
    let mut by_name: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for source in roots().iter().flat_map(|root| crate_of(root)) {
        for name in types(&source.tokens) {
            by_name.entry(name).or_default().push(source.path.clone());
        }
    }
    by_name.retain(|_, paths| paths.len() > 1);
    assert!(by_name.is_empty(), "{by_name:#?}");
}

/// Names of types and traits; associated types and those within functions are left out.
fn types(tokens: &[Token]) -> Vec<String> {
    let mut found = Vec::new();
    let mut depth = 0;
    for pair in tokens.windows(2) {
        match &pair[0] {
            Token::Mark('{') => depth += 1,
            Token::Mark('}') => depth -= 1,
            Token::Word(word) if depth == 0 => {
                let kind = ["struct", "enum", "union", "trait", "type"].contains(&word.as_str());
                found.extend(pair[1].word().filter(|_| kind).map(str::to_owned));
            }
            _ => {}
        }
    }
    found
}

#[test]
fn sources_are_read() {
    let text = "//! x::y\nmod inner; pub use inner::A; use super::{a, b::{C, D as E}, *};\n\
                fn f<'a>(c: char) { let s = \"crate::no\"; if c == '\"' || c == '\\'' { crate::g::h() } }\n\
                #[cfg(test)] mod tests { use crate::no; } pub struct S { x: u8 } impl S { type T = u8; }";
    let tokens = without_tests(&tokens(text));
    let module = vec!["m".to_owned(), "n".to_owned()];
    let source = Source { path: PathBuf::new(), module, tokens };
    let found: Vec<String> = named(&source).iter().map(|n| n.path.join("::")).collect();
    assert_eq!(found, ["m::n::inner::A", "m::a", "m::b::C", "m::b::D", "m", "g::h"]);
    assert!(named(&source)[0].passed_on && !named(&source)[1].passed_on);
    assert_eq!(types(&source.tokens), ["S"]);
}

/// What the top of the tree holds; something new there is named here on purpose.
const TOP: [&str; 26] = [
    ".cargo",
    ".ci",
    ".gitattributes",
    ".gitignore",
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "Cargo.lock",
    "Cargo.toml",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "benches",
    "cli",
    "clippy.toml",
    "deny.toml",
    "docs",
    "examples",
    "generate",
    "library",
    "python",
    "rustfmt.toml",
    "src",
    "structures",
    "tests",
    "worlds",
];

/// Bytes; what is larger is no source, and stays in the history of every clone for good.
const LARGEST_FILE: u64 = 1 << 20;

#[test]
fn only_sources_are_committed() {
    let top = Path::new(env!("CARGO_MANIFEST_DIR"));
    let listed =
        std::process::Command::new("git").args(["ls-files", "-z"]).current_dir(top).output();
    let listed = match listed {
        Ok(output) if output.status.success() => String::from_utf8(output.stdout).unwrap(),
        _ => {
            return skipped("this is no checkout of git");
        }
    };
    let names: Vec<&str> = listed.split('\0').filter(|name| !name.is_empty()).collect();
    assert!(names.contains(&"Cargo.toml"), "{names:?}");
    for name in names {
        let first = name.split('/').next().unwrap();
        assert!(TOP.contains(&first), "{name} is committed; is it a source?");
        // The simulations that come along; `tests/worlds/library.rs` limits their size.
        if first == "library" && name.ends_with(".stemlib") {
            continue;
        }
        // The networks that come along; `python/tests/test_networks.py` limits their size.
        if name.starts_with("python/stemworlds/bench/networks/") && name.ends_with(".onnx") {
            continue;
        }
        let size = fs::metadata(top.join(name)).map_or(0, |file| file.len());
        assert!(
            size <= LARGEST_FILE,
            "{name} has {size} bytes; a source has at most {LARGEST_FILE}"
        );
    }
}
