//! Types of numbers in files of arrays.

/// A type of real number, as NumPy and zarr name it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NumberType {
    kind: Kind,
    /// Number of bytes of one number.
    pub bytes: usize,
    big_endian: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Float,
    Signed,
    Unsigned,
}

impl NumberType {
    /// Returns the type with a name of zarr's format 3, such as `float32`.
    pub fn named(name: &str, big_endian: bool) -> Option<Self> {
        let (kind, bits) = match name {
            "float32" | "float64" => (Kind::Float, &name[5..]),
            "int8" | "int16" | "int32" | "int64" => (Kind::Signed, &name[3..]),
            "uint8" | "uint16" | "uint32" | "uint64" => (Kind::Unsigned, &name[4..]),
            _ => return None,
        };
        Some(NumberType { kind, bytes: bits.parse::<usize>().ok()? / 8, big_endian })
    }

    /// Returns the type with NumPy's description, such as `<f4`.
    pub fn described(description: &str) -> Option<Self> {
        let (kind, bytes, big_endian) = match description.as_bytes() {
            [order @ (b'<' | b'>' | b'|'), kind, bytes @ b'1'..=b'8'] => {
                (*kind, usize::from(bytes - b'0'), *order == b'>')
            }
            _ => return None,
        };
        let kind = match (kind, bytes) {
            (b'f', 4 | 8) => Kind::Float,
            (b'i', 1 | 2 | 4 | 8) => Kind::Signed,
            (b'u', 1 | 2 | 4 | 8) => Kind::Unsigned,
            _ => return None,
        };
        Some(NumberType { kind, bytes, big_endian })
    }

    /// Decodes one number from its bytes.
    pub fn decode(self, bytes: &[u8]) -> f64 {
        let mut word = [0_u8; 8];
        for (i, byte) in bytes.iter().enumerate() {
            word[if self.big_endian { bytes.len() - 1 - i } else { i }] = *byte;
        }
        let raw = u64::from_le_bytes(word);
        let unused = 64 - 8 * bytes.len() as u32;
        match (self.kind, bytes.len()) {
            (Kind::Float, 4) => f64::from(f32::from_bits(raw as u32)),
            (Kind::Float, _) => f64::from_bits(raw),
            (Kind::Unsigned, _) => raw as f64,
            (Kind::Signed, _) => ((raw << unused) as i64 >> unused) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_decoded() {
        let of = |name, big| NumberType::named(name, big).unwrap();
        assert_eq!(of("float32", false).decode(&1.5_f32.to_le_bytes()), 1.5);
        assert_eq!(of("float64", true).decode(&(-2.25_f64).to_be_bytes()), -2.25);
        assert_eq!(of("int16", false).decode(&(-3_i16).to_le_bytes()), -3.0);
        assert_eq!(of("uint8", false).decode(&[200]), 200.0);
        assert_eq!(NumberType::named("complex64", false), None);
    }

    #[test]
    fn descriptions_of_numpy_are_those_types() {
        for (description, name, big) in
            [("<f4", "float32", false), (">i2", "int16", true), ("|u1", "uint8", false)]
        {
            assert_eq!(NumberType::described(description), NumberType::named(name, big));
        }
        for other in ["<f2", "<c8", "|b1", "<f16", "", "f4", "<i3"] {
            assert_eq!(NumberType::described(other), None, "{other}");
        }
    }
}
