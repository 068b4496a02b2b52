//! Splits CIF 1.1 text into tags, values and loops.
//!
//! Grammar: <https://www.iucr.org/resources/cif/spec/version1.1/cifsyntax>.

use super::super::source_text::SourceText;
use crate::error::Result;
use std::collections::HashMap;

/// A value and the line on which it begins.
#[derive(Debug, Clone, Copy)]
pub struct CifValue<'a> {
    pub line: usize,
    pub text: &'a str,
    /// Quoted values are never `?` or `.`.
    quoted: bool,
}

impl<'a> CifValue<'a> {
    /// Returns the text, or `None` for `?` (unknown) and `.` (not applicable).
    pub fn known(&self) -> Option<&'a str> {
        let absent = !self.quoted && (self.text == "?" || self.text == ".");
        (!absent).then_some(self.text.trim())
    }
}

/// A table: column names and rows of equal length.
#[derive(Debug, Default)]
pub struct Loop<'a> {
    pub line: usize,
    pub tags: Vec<String>,
    /// Values, row after row.
    values: Vec<CifValue<'a>>,
}

impl<'a> Loop<'a> {
    /// Returns the rows, each with a value for every tag.
    pub fn rows(&self) -> std::slice::ChunksExact<'_, CifValue<'a>> {
        self.values.chunks_exact(self.tags.len().max(1))
    }

    /// Returns the index of the column of the first of `tags` that exists.
    pub fn column(&self, tags: &[&str]) -> Option<usize> {
        tags.iter().find_map(|tag| self.tags.iter().position(|t| t == tag))
    }
}

/// One data block. Tags are in lower case, and the dot of `_atom_site.fract_x` is an underscore.
#[derive(Debug, Default)]
pub struct DataBlock<'a> {
    pub line: usize,
    pub name: String,
    pub items: HashMap<String, CifValue<'a>>,
    pub loops: Vec<Loop<'a>>,
}

impl<'a> DataBlock<'a> {
    /// Returns the known value, with its line, of the first of `tags` that has one.
    pub fn get(&self, tags: &[&str]) -> Option<(usize, &'a str)> {
        tags.iter().find_map(|tag| {
            let value = self.items.get(*tag)?;
            value.known().map(|text| (value.line, text))
        })
    }

    /// Returns the loops that have one of the columns.
    pub fn tables(&self, tags: &[&str]) -> Vec<&Loop<'a>> {
        self.loops.iter().filter(|l| l.column(tags).is_some()).collect()
    }

    /// Returns the first loop that has one of the columns.
    pub fn table(&self, tags: &[&str]) -> Option<&Loop<'a>> {
        self.loops.iter().find(|l| l.column(tags).is_some())
    }
}

#[derive(Debug)]
enum Token<'a> {
    Data(String),
    Loop,
    Tag(String),
    Value(CifValue<'a>),
}

/// Splits the file into its data blocks.
pub fn blocks<'a>(text: &SourceText<'a>) -> Result<Vec<DataBlock<'a>>> {
    let mut tokens = Tokens::new(text);
    let mut blocks: Vec<DataBlock> = Vec::new();
    while let Some((line, token)) = tokens.take()? {
        if let Token::Data(name) = token {
            blocks.push(DataBlock { line, name, ..DataBlock::default() });
            continue;
        }
        let Some(block) = blocks.last_mut() else {
            let message = "a CIF begins with a line `data_name`; this one does not";
            return Err(text.error(line, message));
        };
        match token {
            Token::Data(_) => {}
            Token::Value(value) => {
                let message = format!("value `{}` follows no tag", shown(value.text));
                return Err(text.error(line, message));
            }
            Token::Tag(tag) => {
                let Some(value) = tokens.take_value()? else {
                    return Err(text.error(line, format!("`{tag}` has no value")));
                };
                if block.items.insert(tag.clone(), value).is_some() {
                    return Err(text.error(line, format!("`{tag}` is given twice")));
                }
            }
            Token::Loop => block.loops.push(take_loop(text, line, &mut tokens)?),
        }
    }
    blocks.iter_mut().for_each(rows_of_pairs);
    Ok(blocks)
}

/// Converts pairs of a tag and a value to loops of one row: CIF makes no difference between them.
fn rows_of_pairs(block: &mut DataBlock) {
    const SITES: &str = "_atom_site_";
    const ANISOTROPIC: &str = "_atom_site_aniso_";
    for anisotropic in [false, true] {
        let of_category =
            |tag: &str| tag.starts_with(SITES) && tag.starts_with(ANISOTROPIC) == anisotropic;
        let mut pairs: Vec<(&String, &CifValue)> =
            block.items.iter().filter(|(tag, _)| of_category(tag)).collect();
        pairs.sort_by_key(|(tag, value)| (value.line, *tag));
        let Some((_, first)) = pairs.first() else { continue };
        let (tags, values) = pairs.iter().map(|(tag, value)| ((*tag).clone(), **value)).unzip();
        let row = Loop { line: first.line, tags, values };
        block.loops.push(row);
    }
}

/// Returns the first line of a value, shortened if it is long.
fn shown(value: &str) -> String {
    value.lines().next().unwrap_or_default().chars().take(60).collect()
}

fn take_loop<'a>(text: &SourceText, line: usize, tokens: &mut Tokens<'_, 'a>) -> Result<Loop<'a>> {
    let mut table = Loop { line, ..Loop::default() };
    while let Some(tag) = tokens.take_tag()? {
        table.tags.push(tag);
    }
    if table.tags.is_empty() {
        return Err(text.error(line, "`loop_` without column tags"));
    }
    while let Some(value) = tokens.take_value()? {
        table.values.push(value);
    }
    let surplus = table.values.len() % table.tags.len();
    if surplus > 0 {
        let message = format!(
            "the loop of line {line} has {} columns, but its last row only {surplus} values; a value is \
             missing or not quoted",
            table.tags.len(),
        );
        return Err(text.error(table.values.last().map_or(line, |v| v.line), message));
    }
    Ok(table)
}

/// The tokens of a file, one after another.
struct Tokens<'t, 'a> {
    text: &'t SourceText<'a>,
    /// Text after the current line.
    lines: &'a str,
    /// Unread text of the current line.
    rest: &'a str,
    /// Number of the current line.
    number: usize,
    /// A token that was read ahead.
    next: Option<(usize, Token<'a>)>,
}

impl<'t, 'a> Tokens<'t, 'a> {
    fn new(text: &'t SourceText<'a>) -> Self {
        Tokens { text, lines: text.body, rest: "", number: 0, next: None }
    }

    /// Returns the next token, with its line.
    fn take(&mut self) -> Result<Option<(usize, Token<'a>)>> {
        if let Some(token) = self.next.take() {
            return Ok(Some(token));
        }
        loop {
            self.rest = self.rest.trim_start();
            if !self.rest.is_empty() && !self.rest.starts_with('#') {
                let (token, after) = token(self.text, self.number, self.rest)?;
                self.rest = after;
                match token {
                    Some(token) => return Ok(Some((self.number, token))),
                    None => continue,
                }
            }
            let Some(line) = self.next_line() else { return Ok(None) };
            match line.strip_prefix(';') {
                Some(first) => return self.text_field(first).map(Some),
                None => self.rest = line,
            }
        }
    }

    fn take_value(&mut self) -> Result<Option<CifValue<'a>>> {
        match self.take()? {
            Some((_, Token::Value(value))) => Ok(Some(value)),
            other => {
                self.next = other;
                Ok(None)
            }
        }
    }

    fn take_tag(&mut self) -> Result<Option<String>> {
        match self.take()? {
            Some((_, Token::Tag(tag))) => Ok(Some(tag)),
            other => {
                self.next = other;
                Ok(None)
            }
        }
    }

    fn next_line(&mut self) -> Option<&'a str> {
        if self.lines.is_empty() {
            return None;
        }
        self.number += 1;
        let (line, after) = self.lines.split_once('\n').unwrap_or((self.lines, ""));
        self.lines = after;
        Some(line.strip_suffix('\r').unwrap_or(line))
    }

    /// Reads the text from `first` to the line that begins with `;`.
    fn text_field(&mut self, first: &'a str) -> Result<(usize, Token<'a>)> {
        let line = self.number;
        let from = first.as_ptr().addr() - self.text.body.as_ptr().addr();
        let mut end = from + first.len();
        while let Some(next) = self.next_line() {
            if let Some(after) = next.strip_prefix(';') {
                self.rest = after;
                let text = &self.text.body[from..end];
                return Ok((line, Token::Value(CifValue { line, text, quoted: true })));
            }
            end = self.text.body.len() - self.lines.len();
        }
        let message = "the text that begins here with `;` is never closed by another `;`";
        Err(self.text.error(line, message))
    }
}

/// Reads the token at the start of `rest` (none for `stop_`), and returns the text after it.
fn token<'a>(
    text: &SourceText,
    line: usize,
    rest: &'a str,
) -> Result<(Option<Token<'a>>, &'a str)> {
    if let Some(quote @ ('"' | '\'')) = rest.chars().next() {
        return quoted(text, line, quote, rest);
    }
    let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
    let (word, after) = rest.split_at(end);
    let lower = word.to_ascii_lowercase();
    let token = if let Some(name) = lower.strip_prefix("data_") {
        Token::Data(name.to_owned())
    } else if lower.starts_with('_') {
        Token::Tag(lower.replace('.', "_"))
    } else if lower == "loop_" {
        Token::Loop
    } else if lower == "stop_" {
        return Ok((None, after));
    } else if lower == "global_" || lower.starts_with("save_") {
        return Err(text.error(line, format!("`{word}` (STAR, dictionaries) is not supported")));
    } else {
        Token::Value(CifValue { line, text: word, quoted: false })
    };
    Ok((Some(token), after))
}

/// Reads a quoted value. A quote closes only before white space, so that `'O5''` holds an apostrophe.
fn quoted<'a>(
    text: &SourceText,
    line: usize,
    quote: char,
    rest: &'a str,
) -> Result<(Option<Token<'a>>, &'a str)> {
    let body = &rest[1..];
    let close = body
        .char_indices()
        .find(|&(i, c)| c == quote && body[i + 1..].chars().next().is_none_or(char::is_whitespace));
    let Some((end, _)) = close else {
        return Err(text.error(line, format!("the quote {quote} is not closed on this line")));
    };
    let value = CifValue { line, text: &body[..end], quoted: true };
    Ok((Some(Token::Value(value)), &body[end + 1..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn parse(body: &str) -> Result<Vec<DataBlock<'_>>> {
        blocks(&SourceText { path: Path::new("t.cif"), body })
    }

    #[test]
    fn quotes_comments_and_text_fields() {
        let blocks = parse(
            "data_X # comment\n_a 'it's' _b \"x # y\"\n_c\n; one\ntwo\n;\nLOOP_\n_t.d\n_e\n? '?'\n\
             1 a#b\nstop_\n",
        )
        .unwrap();
        let block = &blocks[0];
        assert_eq!(block.name, "x");
        assert_eq!(block.get(&["_a"]), Some((2, "it's")));
        assert_eq!(block.get(&["_b"]), Some((2, "x # y")));
        assert_eq!(block.get(&["_c"]), Some((4, "one\ntwo")));
        let table = block.table(&["_t_d"]).unwrap();
        let rows: Vec<_> = table.rows().collect();
        assert_eq!(rows.len(), 2);
        assert_eq!(rows[0][0].known(), None);
        assert_eq!(rows[0][1].known(), Some("?"));
        assert_eq!(rows[1][1].known(), Some("a#b"));
    }

    #[test]
    fn faults_carry_their_line() {
        let message = |body| parse(body).unwrap_err().to_string();
        assert!(message("data_x\n_a 'b\n").starts_with("t.cif:2: the quote '"));
        assert!(message("data_x\n_a\n;b\n").starts_with("t.cif:3: the text that begins"));
        assert!(message("data_x\n_a\n_b 1\n").starts_with("t.cif:2: `_a` has no value"));
        assert!(message("_a 1\n").starts_with("t.cif:1: a CIF begins with"));
        assert!(message("data_x\nloop_\n_a _b\n1 2\n3\n").starts_with("t.cif:5: the loop of line"));
    }
}
