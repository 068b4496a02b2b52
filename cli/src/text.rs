//! Standard output, and numbers for people.

use super::invocation::{Invocation, PROGRAM};
use anyhow::Context;
use std::borrow::Cow;
use std::io::{ErrorKind, Write};
use std::ops::RangeInclusive;
pub use stemgen::progress::duration;

/// Prints a line on standard output, with control characters escaped. A reader that has closed the pipe (`| head`) is no error.
pub fn print(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{}", printable(text)).and_then(|()| out.flush()) {
        Err(e) if e.kind() == ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to standard output"),
    }
}

/// Prints a line on standard error, with control characters escaped. A closed standard error is no error.
pub fn complain(text: &str) {
    // If standard error is closed, no stream is left for the message.
    let _ = writeln!(std::io::stderr().lock(), "{}", printable(text));
}

/// Escapes letters that control a terminal, or change the order of the letters shown: texts and names of files may hold them. They are
/// escaped as in JSON, so that printed JSON keeps its meaning. Ends of lines stay.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.chars().any(|c| c != '\n' && commands(c)) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if c != '\n' && commands(c) { push_code(&mut out, c) } else { out.push(c) }
    }
    Cow::Owned(out)
}

/// Escapes control letters and ends of lines, so that a text from a file cannot add lines to a table.
pub fn one_line(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if commands(c) { push_code(&mut out, c) } else { out.push(c) }
    }
    out
}

/// Whether a letter is a control, an end of a line, or turns or hides the letters that follow it.
fn commands(c: char) -> bool {
    const TURN_OR_HIDE: [RangeInclusive<char>; 5] = [
        '\u{200b}'..='\u{200f}',
        '\u{2028}'..='\u{202e}',
        '\u{2060}'..='\u{206f}',
        '\u{feff}'..='\u{feff}',
        '\u{fff9}'..='\u{fffb}',
    ];
    c.is_control() || TURN_OR_HIDE.iter().any(|range| range.contains(&c))
}

fn push_code(out: &mut String, c: char) {
    *out += &format!("\\u{:04x}", u32::from(c));
}

/// Returns rows of cells as a table, with columns as wide as their widest cell.
pub fn table<const N: usize>(rows: &[[String; N]]) -> String {
    let width = |k: usize| rows.iter().map(|row| row[k].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..N).map(width).collect();
    let line = |row: &[String; N]| {
        let padded = row.iter().zip(&widths).map(|(cell, w)| format!("{cell:w$}"));
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// Returns a size such as `1.3 GB`.
pub fn bytes(n: u64) -> String {
    let units = ["B", "kB", "MB", "GB", "TB"];
    let mut value = n as f64;
    let mut unit = 0;
    while value >= 999.5 && unit + 1 < units.len() {
        value /= 1000.0;
        unit += 1;
    }
    match unit {
        0 => format!("{n} B"),
        _ if value < 9.95 => format!("{value:.1} {}", units[unit]),
        _ => format!("{value:.0} {}", units[unit]),
    }
}

/// Returns a range of times in s, from the least to the most: `2 to 5 s`, `40 s to 2 min 10 s`.
pub fn duration_range([least, most]: [f64; 2]) -> String {
    match [least, most].map(duration) {
        [a, b] if a == b => format!("about {a}"),
        [a, b] => format!("{a} to {b}"),
    }
}

/// Returns a number with at least `digits` significant digits, without an exponent unless it is very small.
pub fn significant(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let magnitude = value.abs().log10().floor() as i32;
    if magnitude < -4 {
        return format!("{value:.*e}", (digits - 1).max(0) as usize);
    }
    format!("{value:.*}", (digits - 1 - magnitude).max(0) as usize)
}

/// Returns an integer with a space between thousands: `12 345`.
pub fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) && digits.len() > 4 {
            out.push(' ');
        }
        out.push(c);
    }
    out
}

/// Returns the command line, quoted for a shell where needed, without the number of threads, on which the contents of files do not depend.
pub fn command_line() -> String {
    let words = Invocation::now()
        .arguments
        .iter()
        .map(|word| word.to_string_lossy().into_owned())
        .collect();
    let words = without_threads(words).into_iter().map(|word| quoted(&word));
    std::iter::once(PROGRAM.to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}

/// Removes `--threads N` from the words of a command line.
fn without_threads(words: Vec<String>) -> Vec<String> {
    let mut kept = Vec::with_capacity(words.len());
    let mut words = words.into_iter();
    while let Some(word) = words.next() {
        match word.as_str() {
            "--threads" => drop(words.next()),
            _ if word.starts_with("--threads=") => {}
            _ => kept.push(word),
        }
    }
    kept
}

/// Quotes a word for a shell, if needed.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,=@:+%".contains(c);
    match !word.is_empty() && word.chars().all(plain) {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', r"'\''").replace('\0', "")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    proptest::proptest! {
        #[test]
        fn texts_of_files_only_show_what_they_hold(text in "(\\PC|\\pC|[a-z<>\\n\\t\\x1b\\u{9b}\\u{202e}]){0,40}") {
            let line = one_line(&text);
            proptest::prop_assert!(!line.chars().any(commands), "{line:?}");
            let whole = printable(&text);
            proptest::prop_assert!(whole.chars().all(|c| c == '\n' || !commands(c)), "{whole:?}");
            proptest::prop_assert_eq!(whole.matches('\n').count(), text.matches('\n').count());
            // Escaping must not change the meaning of JSON.
            let json = serde_json::to_string_pretty(&text).unwrap();
            let back: String = serde_json::from_str(&printable(&json)).unwrap();
            proptest::prop_assert_eq!(back, text);
        }
    }

    #[test]
    fn plain_texts_are_printed_as_they_are() {
        for text in ["SrTiO\u{2083}, 0.5 \u{c5}\nHAADF \u{b5}m", "a\\b `c` <d>"] {
            assert_eq!(printable(text), text);
        }
        assert_eq!(one_line("a\nb\u{1b}[31mc"), "a\\u000ab\\u001b[31mc");
    }

    #[test]
    fn numbers_are_readable() {
        assert_eq!(bytes(12), "12 B");
        assert_eq!(bytes(1_340_000_000), "1.3 GB");
        assert_eq!(bytes(999_900), "1.0 MB");
        assert_eq!(duration(0.04), "0.0 s");
        assert_eq!(duration(200.0), "3 min 20 s");
        assert_eq!(duration(7500.0), "2 h 05 min");
        assert_eq!(duration_range([40.0, 200.0]), "40 s to 3 min 20 s");
        assert_eq!(duration_range([40.0, 40.2]), "about 40 s");
        let words = ["live", "r.toml", "--threads", "3", "--dose=5", "--threads=2", "-o", "x.h5"];
        let kept = without_threads(words.map(str::to_owned).into());
        assert_eq!(kept.join(" "), "live r.toml --dose=5 -o x.h5");
        assert_eq!(significant(0.012345, 3), "0.0123");
        assert_eq!(significant(1234.5, 3), "1234");
        assert_eq!(significant(0.000012345, 3), "1.23e-5");
        assert_eq!((count(1234), count(1_234_567)), ("1234".into(), "1 234 567".into()));
    }
}
