//! Builds the text of a card: Markdown, and the YAML of its header.

/// A page of Markdown.
pub(super) struct Markdown(String);

impl Markdown {
    pub(super) fn new() -> Self {
        Markdown(String::new())
    }

    /// Adds a line.
    pub(super) fn line(&mut self, text: impl AsRef<str>) {
        self.0.push_str(text.as_ref());
        self.0.push('\n');
    }

    /// Adds a heading or a paragraph, with an empty line before it.
    pub(super) fn paragraph(&mut self, text: impl AsRef<str>) {
        if !self.0.is_empty() {
            self.0.push('\n');
        }
        self.line(text);
    }

    /// Adds a list.
    pub(super) fn list(&mut self, items: &[String]) {
        self.0.push('\n');
        items.iter().for_each(|item| self.line(format!("- {item}")));
    }

    /// Adds code. The fence is longer than any row of backticks in the code, so that the code cannot close it.
    pub(super) fn code(&mut self, language: &str, code: &str) {
        let code: String =
            code.trim_end().chars().map(|c| if c == '\n' { c } else { shown(c) }).collect();
        let rows = code.split(|c| c != '`').map(str::len);
        let fence = "`".repeat(rows.max().unwrap_or(0).max(2) + 1);
        self.paragraph(format!("{fence}{language}\n{code}\n{fence}"));
    }

    /// Adds a table.
    pub(super) fn table<const N: usize>(
        &mut self,
        head: [&str; N],
        rows: impl Iterator<Item = [String; N]>,
    ) {
        self.paragraph(format!("| {} |\n|{}", head.join(" | "), "---|".repeat(N)));
        rows.for_each(|row| self.line(format!("| {} |", row.join(" | "))));
    }

    pub(super) fn text(self) -> String {
        self.0
    }
}

/// Makes text safe for a cell of a table, or for a sentence: text from a file must not become markup.
pub(super) fn printable(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match shown(c) {
            c @ ('|' | '<' | '>' | '[' | ']' | '*' | '\\' | '&' | '$' | '~') => {
                out.extend(['\\', c]);
            }
            c => out.push(c),
        }
    }
    out
}

/// Returns the letter, or a blank for characters that are not printed: controls, and characters that reverse or hide the text after them.
fn shown(c: char) -> char {
    match c {
        '\u{200b}'..='\u{200f}'
        | '\u{2028}'..='\u{202e}'
        | '\u{2060}'..='\u{206f}'
        | '\u{feff}' => ' ',
        c if c.is_control() => ' ',
        c => c,
    }
}

/// Quotes text for YAML, as JSON, which is valid YAML.
pub(super) fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// Writes a number with at most `digits` digits behind the point, without zeros at the end.
pub(super) fn short(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// Writes a size: `4.7 MB`.
pub(super) fn size(bytes: u64) -> String {
    match bytes {
        0..1000 => format!("{bytes} B"),
        1000..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.2} GB", bytes as f64 / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_file_holds_is_no_markup() {
        assert_eq!(printable("a|b<script>\nc"), "a\\|b\\<script\\> c");
        assert_eq!(printable("`a` &lt; $b$ \u{202e}\u{1b}[0m"), "`a` \\&lt; \\$b\\$   \\[0m");
        let mut page = Markdown::new();
        page.code("sh", "a ```` b\n```\n# c\u{1b}");
        assert_eq!(page.text(), "`````sh\na ```` b\n```\n# c \n`````\n");
        assert_eq!(quoted("a: \"b\""), "\"a: \\\"b\\\"\"");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(
            [short(100.0, 2), short(0.020_145, 5), short(5.0765, 2)],
            ["100", "0.02014", "5.08"]
        );
        assert_eq!([size(999), size(143_000), size(68_000_000)], ["999 B", "143.0 kB", "68.0 MB"]);
    }

    #[test]
    fn pages_are_put_together() {
        let mut page = Markdown::new();
        page.paragraph("# A");
        page.list(&["b".into()]);
        page.table(["c", "d"], [["1".to_owned(), "2".to_owned()]].into_iter());
        page.code("sh", "e\n");
        assert_eq!(page.text(), "# A\n\n- b\n\n| c | d |\n|---|---|\n| 1 | 2 |\n\n```sh\ne\n```\n");
    }
}
