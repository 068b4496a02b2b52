//! Splits CIF 1.1 text into tags, values and loops.
//!
//! Grammar: <https://www.iucr.org/resources/cif/spec/version1.1/cifsyntax>.

use super::super::source_text::SourceText;
use crate::error::Result;
use std::collections::HashMap;

/// A value and the line on which it begins.
#[derive(Debug, Clone)]
pub struct CifValue {
    pub line: usize,
    pub text: String,
    /// Quoted values are never `?` or `.`.
    quoted: bool,
}

impl CifValue {
    /// The text, or `None` for `?` (unknown) and `.` (not applicable).
    pub fn known(&self) -> Option<&str> {
        let absent = !self.quoted && (self.text == "?" || self.text == ".");
        (!absent).then_some(self.text.trim())
    }
}

/// A table: column names and rows of equal length.
#[derive(Debug, Default)]
pub struct Loop {
    pub line: usize,
    pub tags: Vec<String>,
    pub rows: Vec<Vec<CifValue>>,
}

impl Loop {
    /// The column of the first of `tags` that is there.
    pub fn column(&self, tags: &[&str]) -> Option<usize> {
        tags.iter().find_map(|tag| self.tags.iter().position(|t| t == tag))
    }
}

/// One data block. Tags are in lower case, and the dot of `_atom_site.fract_x` is an underscore.
#[derive(Debug, Default)]
pub struct DataBlock {
    pub line: usize,
    pub name: String,
    pub items: HashMap<String, CifValue>,
    pub loops: Vec<Loop>,
}

impl DataBlock {
    /// The known value of the first of `tags` that has one.
    pub fn get(&self, tags: &[&str]) -> Option<(usize, &str)> {
        tags.iter().find_map(|tag| {
            let value = self.items.get(*tag)?;
            value.known().map(|text| (value.line, text))
        })
    }

    /// The loop that has one of the columns.
    pub fn table(&self, tags: &[&str]) -> Option<&Loop> {
        self.loops.iter().find(|l| l.column(tags).is_some())
    }
}

#[derive(Debug)]
enum Token {
    Data(String),
    Loop,
    Tag(String),
    Value(CifValue),
}

/// All data blocks of the file.
pub fn blocks(text: &SourceText) -> Result<Vec<DataBlock>> {
    let mut tokens = tokens(text)?.into_iter().peekable();
    let mut blocks: Vec<DataBlock> = Vec::new();
    while let Some((line, token)) = tokens.next() {
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
                let message = format!("value `{}` follows no tag", value.text);
                return Err(text.error(line, message));
            }
            Token::Tag(tag) => {
                let Some((_, Token::Value(value))) =
                    tokens.next_if(|(_, t)| matches!(t, Token::Value(_)))
                else {
                    return Err(text.error(line, format!("`{tag}` has no value")));
                };
                if block.items.insert(tag.clone(), value).is_some() {
                    return Err(text.error(line, format!("`{tag}` is given twice")));
                }
            }
            Token::Loop => block.loops.push(take_loop(text, line, &mut tokens)?),
        }
    }
    Ok(blocks)
}

fn take_loop(
    text: &SourceText,
    line: usize,
    tokens: &mut std::iter::Peekable<impl Iterator<Item = (usize, Token)>>,
) -> Result<Loop> {
    let mut table = Loop { line, ..Loop::default() };
    while let Some((_, Token::Tag(tag))) = tokens.next_if(|(_, t)| matches!(t, Token::Tag(_))) {
        table.tags.push(tag);
    }
    if table.tags.is_empty() {
        return Err(text.error(line, "`loop_` without column tags"));
    }
    let mut row = Vec::new();
    let mut last = line;
    while let Some((at, Token::Value(value))) =
        tokens.next_if(|(_, t)| matches!(t, Token::Value(_)))
    {
        last = at;
        row.push(value);
        if row.len() == table.tags.len() {
            table.rows.push(std::mem::take(&mut row));
        }
    }
    if !row.is_empty() {
        let message = format!(
            "the loop of line {line} has {} columns, but its last row only {} values; a value is \
             missing or not quoted",
            table.tags.len(),
            row.len()
        );
        return Err(text.error(last, message));
    }
    Ok(table)
}

fn tokens(text: &SourceText) -> Result<Vec<(usize, Token)>> {
    let mut tokens = Vec::new();
    let mut lines = text.lines();
    while let Some((number, line)) = lines.next() {
        let mut rest = line;
        if let Some(first) = line.strip_prefix(';') {
            let (value, after) = text_field(text, number, first, &mut lines)?;
            tokens.push((number, Token::Value(value)));
            rest = after;
        }
        loop {
            rest = rest.trim_start();
            if rest.is_empty() || rest.starts_with('#') {
                break;
            }
            let (token, after) = token(text, number, rest)?;
            tokens.extend(token.map(|t| (number, t)));
            rest = after;
        }
    }
    Ok(tokens)
}

/// The text between two lines that begin with `;`, and what follows the second one.
fn text_field<'a>(
    text: &SourceText,
    line: usize,
    first: &str,
    lines: &mut impl Iterator<Item = (usize, &'a str)>,
) -> Result<(CifValue, &'a str)> {
    let mut body = first.to_owned();
    for (_, next) in lines {
        if let Some(after) = next.strip_prefix(';') {
            return Ok((CifValue { line, text: body, quoted: true }, after));
        }
        body.push('\n');
        body.push_str(next);
    }
    Err(text.error(line, "the text that begins here with `;` is never closed by another `;`"))
}

/// The token at the start of `rest` (none for `stop_`), and what follows it.
fn token<'a>(text: &SourceText, line: usize, rest: &'a str) -> Result<(Option<Token>, &'a str)> {
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
        Token::Value(CifValue { line, text: word.to_owned(), quoted: false })
    };
    Ok((Some(token), after))
}

/// A quote closes only before white space, so that `'O5''` holds an apostrophe.
fn quoted<'a>(
    text: &SourceText,
    line: usize,
    quote: char,
    rest: &'a str,
) -> Result<(Option<Token>, &'a str)> {
    let body = &rest[1..];
    let close = body
        .char_indices()
        .find(|&(i, c)| c == quote && body[i + 1..].chars().next().is_none_or(char::is_whitespace));
    let Some((end, _)) = close else {
        return Err(text.error(line, format!("the quote {quote} is not closed on this line")));
    };
    let value = CifValue { line, text: body[..end].to_owned(), quoted: true };
    Ok((Some(Token::Value(value)), &body[end + 1..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn parse(body: &str) -> Result<Vec<DataBlock>> {
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
        assert_eq!(table.rows.len(), 2);
        assert_eq!(table.rows[0][0].known(), None);
        assert_eq!(table.rows[0][1].known(), Some("?"));
        assert_eq!(table.rows[1][1].known(), Some("a#b"));
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
