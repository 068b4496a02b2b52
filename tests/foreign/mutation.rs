//! Inputs of the fuzz targets: a counter decides what is changed in which file of the corpus, so that a finding is
//! named by its number.

/// Random numbers that depend on a seed only (S. Vigna's splitmix64).
pub struct Dice(u64);

impl Dice {
    pub fn new(target: &str, number: u64) -> Self {
        let seed =
            target.bytes().fold(number, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3));
        let mut dice = Dice(seed);
        dice.next();
        dice
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }

    pub fn pick<'a, T>(&mut self, from: &'a [T]) -> &'a T {
        &from[self.below(from.len())]
    }

    pub fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }
}

/// Words that readers stumble over.
const WORDS: &[&str] = &[
    "0",
    "-0",
    "1",
    "-1",
    "2",
    "0.5",
    "1e308",
    "-1e308",
    "1e-308",
    "1e999",
    "5e-324",
    "nan",
    "inf",
    "-inf",
    "1D+02",
    "255",
    "256",
    "65536",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "9223372036854775808",
    "18446744073709551615",
    "99999999999999999999999",
    "0x10",
    "?",
    ".",
    "'",
    "\"",
    "{",
    "}",
    "[",
    "]",
    "(",
    ")",
    ",",
    "=",
    ";",
    "#",
    "_",
    "loop_",
    "data_x",
    "x,y,z",
    "-x,y+1/2,z",
    "Sr",
    "Xx",
    "X",
    "true",
    "null",
    "S",
    "R",
    "1e-7",
    "\u{e4}",
    "\u{feff}",
    "\0",
    "\\",
    "1/0",
    "3.9(",
    "3.9(1)",
    "..",
    "//",
    "\r",
    "\t",
    "1_000",
    "[[",
    "\"\"\"",
    "<f8",
    "|b1",
    "zstd",
    "gzip",
    "0.9999999999",
    "1000000",
    "1024",
    "-4",
];

/// A changed text.
pub fn text(corpus: &[Vec<u8>], dice: &mut Dice) -> Vec<u8> {
    let mut bytes = dice.pick(corpus).clone();
    for _ in 0..=dice.below(4) {
        bytes = match dice.below(12) {
            0..=4 => with_token(&bytes, dice),
            5..=8 => with_lines(&bytes, corpus, dice),
            9 => {
                let at = dice.below(bytes.len() + 1);
                bytes.truncate(at);
                bytes
            }
            _ => binary_step(bytes, corpus, dice),
        };
    }
    bytes.truncate(1 << 20);
    bytes
}

/// A changed binary file.
pub fn binary(corpus: &[Vec<u8>], dice: &mut Dice) -> Vec<u8> {
    let mut bytes = dice.pick(corpus).clone();
    for _ in 0..=dice.below(6) {
        bytes = binary_step(bytes, corpus, dice);
    }
    bytes.truncate(1 << 20);
    bytes
}

fn is_word(b: u8) -> bool {
    b.is_ascii_alphanumeric() || matches!(b, b'.' | b'-' | b'+' | b'_')
}

/// Replaces, removes or doubles a word.
fn with_token(bytes: &[u8], dice: &mut Dice) -> Vec<u8> {
    let at = dice.below(bytes.len());
    let start = bytes[..at].iter().rposition(|b| !is_word(*b)).map_or(0, |i| i + 1);
    let end = bytes[at..].iter().position(|b| !is_word(*b)).map_or(bytes.len(), |i| at + i);
    let word = &bytes[start..end.max(start)];
    let new: Vec<u8> = match dice.below(8) {
        0 => Vec::new(),
        1 => [word, b" ", word].concat(),
        2 => [word, b"-"].concat(),
        3 => dice.pick(WORDS).repeat(1 << dice.below(14)).into_bytes(),
        4 => format!("{:e}", f64::from_bits(dice.next())).into_bytes(),
        _ => dice.pick(WORDS).as_bytes().to_vec(),
    };
    [&bytes[..start], &new, &bytes[end.max(start)..]].concat()
}

/// Removes, doubles, moves, repeats or brings in lines.
fn with_lines(bytes: &[u8], corpus: &[Vec<u8>], dice: &mut Dice) -> Vec<u8> {
    let mut lines: Vec<&[u8]> = bytes.split_inclusive(|b| *b == b'\n').collect();
    if lines.is_empty() {
        return bytes.to_vec();
    }
    let (a, b) = (dice.below(lines.len()), dice.below(lines.len()));
    let other: Vec<&[u8]> = dice.pick(corpus).split_inclusive(|b| *b == b'\n').collect();
    match dice.below(6) {
        0 => drop(lines.remove(a)),
        1 => lines.insert(b, lines[a]),
        2 => lines.swap(a, b),
        3 => lines.extend(std::iter::repeat_n(lines[a], dice.below(200))),
        4 if !other.is_empty() => lines.insert(a, other[dice.below(other.len())]),
        _ => lines.truncate(a),
    }
    lines.concat()
}

/// Changes bytes.
fn binary_step(mut bytes: Vec<u8>, corpus: &[Vec<u8>], dice: &mut Dice) -> Vec<u8> {
    if bytes.is_empty() {
        return vec![dice.next() as u8];
    }
    let at = dice.below(bytes.len());
    match dice.below(8) {
        0 => bytes[at] ^= 1 << dice.below(8),
        1 => bytes[at] = dice.next() as u8,
        2..=4 => {
            let edges = [
                0,
                1,
                0x7f,
                0xff,
                0x7fff,
                0xffff,
                0x7fff_ffff,
                0xffff_ffff,
                1 << 40,
                1 << 62,
                u64::MAX,
            ];
            let value = dice.pick(&edges).wrapping_add(dice.below(3) as u64).to_le_bytes();
            let width = *dice.pick(&[1, 2, 4, 8]);
            for (i, byte) in bytes[at..].iter_mut().take(width).enumerate() {
                *byte = value[i];
            }
        }
        5 => bytes.truncate(at),
        6 => {
            let other = dice.pick(corpus);
            let from = dice.below(other.len());
            let part = other[from..(from + dice.below(64)).min(other.len())].to_vec();
            bytes.splice(at..at, part);
        }
        _ => {
            let end = (at + dice.below(32)).min(bytes.len());
            bytes.drain(at..end);
        }
    }
    bytes
}
