//! zarr folders, formats 2 and 3 (<https://zarr-specs.readthedocs.io>), as far as abTEM writes them: regular
//! chunks, uncompressed or by zstd, gzip or zlib.

use std::io::Read;
use std::path::{Path, PathBuf};

use ndarray::{ArrayD, Dimension, IxDyn};
use serde_json::Value;

use super::{ForeignArray, abtem_metadata, choose};
use crate::error::{Error, Result};

const REMEDY: &str = "export the image with np.save(\"image.npy\", measurement.array) instead";

/// How chunks are compressed.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Codec {
    None,
    Zstd,
    Gzip,
    Zlib,
}

/// What one number is.
#[derive(Debug, Clone, Copy, PartialEq)]
struct NumberType {
    kind: Kind,
    bytes: usize,
    big_endian: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Float,
    Signed,
    Unsigned,
}

/// An array of the folder.
struct ZarrLayout {
    folder: PathBuf,
    shape: Vec<usize>,
    chunk: Vec<usize>,
    number: NumberType,
    codec: Codec,
    fill: f64,
    /// First index fastest.
    fortran: bool,
    prefix: &'static str,
    separator: String,
}

pub fn read(path: &Path, name: Option<&str>) -> Result<ForeignArray> {
    if is_array(path) {
        super::nameless(path, name)?;
        let data = ZarrLayout::read(path)?.data()?;
        return Ok(ForeignArray::plain(path, "", data));
    }
    if !["zarr.json", ".zgroup"].iter().any(|f| path.join(f).is_file()) {
        let message =
            "is a folder, but no zarr array or group (it has no zarr.json, .zgroup or .zarray)";
        return Err(Error::parse(path, 0, message));
    }
    let entries = std::fs::read_dir(path).map_err(|e| Error::io(path, "read", e))?;
    let mut names: Vec<String> = entries
        .flatten()
        .filter(|e| is_array(&e.path()))
        .map(|e| e.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    let chosen = choose(path, &names, name)?;
    let data = ZarrLayout::read(&path.join(chosen))?.data()?;
    let mut array = ForeignArray::plain(path, chosen, data);
    // abTEM describes `array0` in the attribute `metadata0` of the group.
    let key = chosen.replacen("array", "metadata", 1);
    let attributes = attributes(path)?;
    abtem_metadata::describe(&mut array, &attributes[key]);
    if array.data.ndim() < 2 {
        return Err(array.error("is no image: the array has fewer than two dimensions"));
    }
    Ok(array)
}

fn is_array(folder: &Path) -> bool {
    let v3 = || json(&folder.join("zarr.json")).is_ok_and(|v| v["node_type"] == "array");
    folder.join(".zarray").is_file() || v3()
}

fn attributes(folder: &Path) -> Result<Value> {
    match folder.join("zarr.json") {
        file if file.is_file() => Ok(json(&file)?["attributes"].take()),
        _ => Ok(json(&folder.join(".zattrs")).unwrap_or_default()),
    }
}

fn json(path: &Path) -> Result<Value> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    serde_json::from_slice(&bytes).map_err(|e| Error::parse(path, e.line(), e.to_string()))
}

impl ZarrLayout {
    fn read(folder: &Path) -> Result<Self> {
        match folder.join(".zarray") {
            file if file.is_file() => ZarrLayout::version_2(folder, &json(&file)?),
            _ => ZarrLayout::version_3(folder, &json(&folder.join("zarr.json"))?),
        }
    }

    fn version_2(folder: &Path, v: &Value) -> Result<Self> {
        let dtype = v["dtype"].as_str().unwrap_or_default();
        let number = match dtype.split_at_checked(1) {
            Some((order @ ("<" | ">" | "|"), kind)) => NumberType::named(
                &match kind.split_at_checked(1) {
                    Some(("f", bytes)) => format!("float{}", bits(bytes)),
                    Some(("i", bytes)) => format!("int{}", bits(bytes)),
                    Some(("u", bytes)) => format!("uint{}", bits(bytes)),
                    _ => String::new(),
                },
                order == ">",
            ),
            _ => None,
        };
        let codec = match &v["compressor"] {
            Value::Null => Some(Codec::None),
            c => codec(c["id"].as_str().unwrap_or_default()),
        };
        let codec = if v["filters"].is_null() { codec } else { None };
        Ok(ZarrLayout {
            folder: folder.to_owned(),
            shape: counts(folder, &v["shape"])?,
            chunk: counts(folder, &v["chunks"])?,
            number: number.ok_or_else(|| unreadable(folder, "type", &v["dtype"]))?,
            codec: codec.ok_or_else(|| unreadable(folder, "compression", &v["compressor"]))?,
            fill: v["fill_value"].as_f64().unwrap_or(0.0),
            fortran: v["order"] == "F",
            prefix: "",
            separator: v["dimension_separator"].as_str().unwrap_or(".").to_owned(),
        })
    }

    fn version_3(folder: &Path, v: &Value) -> Result<Self> {
        let codecs = v["codecs"].as_array().map(Vec::as_slice).unwrap_or_default();
        let endian = codecs.iter().find(|c| c["name"] == "bytes");
        let endian = endian.ok_or_else(|| unreadable(folder, "storage", &v["codecs"]))?;
        let rest: Vec<&Value> = codecs.iter().filter(|c| c["name"] != "bytes").collect();
        let compression = match rest[..] {
            [] => Some(Codec::None),
            [one] => codec(one["name"].as_str().unwrap_or_default()),
            _ => None,
        };
        let big = endian["configuration"]["endian"] == "big";
        let number = NumberType::named(v["data_type"].as_str().unwrap_or_default(), big);
        let keys = &v["chunk_key_encoding"];
        let (prefix, usual) = if keys["name"] == "v2" { ("", ".") } else { ("c", "/") };
        let separator = keys["configuration"]["separator"].as_str().unwrap_or(usual);
        Ok(ZarrLayout {
            folder: folder.to_owned(),
            shape: counts(folder, &v["shape"])?,
            chunk: counts(folder, &v["chunk_grid"]["configuration"]["chunk_shape"])?,
            number: number.ok_or_else(|| unreadable(folder, "type", &v["data_type"]))?,
            codec: compression.ok_or_else(|| unreadable(folder, "storage", &v["codecs"]))?,
            fill: v["fill_value"].as_f64().unwrap_or(0.0),
            fortran: false,
            prefix,
            separator: separator.to_owned(),
        })
    }

    /// Reads all chunks. One that is not there holds the fill value.
    fn data(&self) -> Result<ArrayD<f64>> {
        let size = self.chunk.iter().try_fold(1_usize, |n, c| n.checked_mul(*c));
        let fits = self.chunk.len() == self.shape.len() && !self.chunk.contains(&0);
        let size = size.filter(|n| fits && *n < 1 << 31);
        let size =
            size.ok_or_else(|| unreadable(&self.folder, "chunks", &self.chunk.clone().into()))?;
        let total = self.shape.iter().try_fold(1_usize, |n, s| n.checked_mul(*s));
        if total.is_none_or(|n| n > 1 << 31) {
            return Err(unreadable(&self.folder, "shape", &self.shape.clone().into()));
        }
        let mut out = ArrayD::from_elem(IxDyn(&self.shape), self.fill);
        let counts: Vec<usize> =
            self.shape.iter().zip(&self.chunk).map(|(s, c)| s.div_ceil(*c)).collect();
        for place in ndarray::indices(IxDyn(&counts)) {
            let place = place.slice();
            let Some(values) = self.chunk_values(place, size)? else { continue };
            for (i, value) in values.into_iter().enumerate() {
                let mut rest = i;
                let mut at = vec![0; self.chunk.len()];
                let axes: Vec<usize> = match self.fortran {
                    true => (0..at.len()).collect(),
                    false => (0..at.len()).rev().collect(),
                };
                for axis in axes {
                    at[axis] = place[axis] * self.chunk[axis] + rest % self.chunk[axis];
                    rest /= self.chunk[axis];
                }
                // Chunks at the edge go on beyond the array.
                if let Some(slot) = out.get_mut(IxDyn(&at)) {
                    *slot = value;
                }
            }
        }
        Ok(out)
    }

    fn chunk_values(&self, place: &[usize], size: usize) -> Result<Option<Vec<f64>>> {
        let numbers: Vec<String> = place.iter().map(usize::to_string).collect();
        let mut key = numbers.join(&self.separator);
        if !self.prefix.is_empty() {
            key = format!("{}{}{key}", self.prefix, self.separator);
        }
        let path = self.folder.join(key);
        let packed = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io(&path, "read", e)),
        };
        let bad = |reason: String| Error::parse(&path, 0, format!("damaged chunk: {reason}"));
        let bytes = unpack(self.codec, &packed).map_err(bad)?;
        if bytes.len() != size * self.number.bytes {
            let expected = size * self.number.bytes;
            return Err(bad(format!("{} bytes instead of {expected}", bytes.len())));
        }
        Ok(Some(bytes.chunks_exact(self.number.bytes).map(|b| self.number.decode(b)).collect()))
    }
}

fn unpack(codec: Codec, packed: &[u8]) -> std::result::Result<Vec<u8>, String> {
    let mut out = Vec::new();
    let read = match codec {
        Codec::None => return Ok(packed.to_vec()),
        Codec::Zstd => {
            let decoder = ruzstd::decoding::StreamingDecoder::new(packed);
            decoder.map_err(|e| e.to_string())?.read_to_end(&mut out)
        }
        Codec::Gzip => flate2::read::GzDecoder::new(packed).read_to_end(&mut out),
        Codec::Zlib => flate2::read::ZlibDecoder::new(packed).read_to_end(&mut out),
    };
    read.map(|_| out).map_err(|e| e.to_string())
}

fn codec(name: &str) -> Option<Codec> {
    match name {
        "zstd" => Some(Codec::Zstd),
        "gzip" => Some(Codec::Gzip),
        "zlib" => Some(Codec::Zlib),
        _ => None,
    }
}

fn bits(bytes: &str) -> usize {
    8 * bytes.parse::<usize>().unwrap_or(0)
}

fn counts(folder: &Path, value: &Value) -> Result<Vec<usize>> {
    let numbers = value.as_array().and_then(|list| {
        list.iter().map(|v| v.as_u64().map(|n| n as usize)).collect::<Option<Vec<_>>>()
    });
    numbers.ok_or_else(|| unreadable(folder, "shape", value))
}

fn unreadable(folder: &Path, what: &str, value: &Value) -> Error {
    Error::parse(
        folder,
        0,
        format!("cannot be read: {what} {value} of zarr is not supported; {REMEDY}"),
    )
}

impl NumberType {
    fn named(name: &str, big_endian: bool) -> Option<Self> {
        let (kind, bits) = match name {
            "float32" | "float64" => (Kind::Float, &name[5..]),
            "int8" | "int16" | "int32" | "int64" => (Kind::Signed, &name[3..]),
            "uint8" | "uint16" | "uint32" | "uint64" => (Kind::Unsigned, &name[4..]),
            _ => return None,
        };
        Some(NumberType { kind, bytes: bits.parse::<usize>().ok()? / 8, big_endian })
    }

    fn decode(self, bytes: &[u8]) -> f64 {
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

    fn array(folder: &Path, compressor: &str, pack: impl Fn(&[u8]) -> Vec<u8>) {
        std::fs::create_dir_all(folder).unwrap();
        let meta = format!(
            "{{\"shape\":[3,5],\"chunks\":[2,4],\"dtype\":\"<f4\",\"fill_value\":7.0,\"order\":\"C\",\
             \"filters\":null,\"compressor\":{compressor},\"zarr_format\":2}}"
        );
        std::fs::write(folder.join(".zarray"), meta).unwrap();
        // 10 r + c in all chunks but the last, which is not there
        for (r, c) in [(0, 0), (0, 1), (1, 0)] {
            let value = |i: usize| (10 * (2 * r + i / 4) + 4 * c + i % 4) as f32;
            let bytes: Vec<u8> = (0..8).flat_map(|i| value(i).to_le_bytes()).collect();
            std::fs::write(folder.join(format!("{r}.{c}")), pack(&bytes)).unwrap();
        }
    }

    #[test]
    fn chunks_at_the_edge_and_missing_ones() {
        let folder = tempfile::tempdir().unwrap();
        let gzip = |bytes: &[u8]| {
            let mut out = Vec::new();
            let mut encoder = flate2::read::GzEncoder::new(bytes, flate2::Compression::fast());
            encoder.read_to_end(&mut out).unwrap();
            out
        };
        for (name, compressor, pack) in [
            ("plain", "null", (|b: &[u8]| b.to_vec()) as fn(&[u8]) -> Vec<u8>),
            ("gzip", "{\"id\":\"gzip\",\"level\":1}", gzip),
        ] {
            let path = folder.path().join(name);
            array(&path, compressor, pack);
            let data = read(&path, None).unwrap().data;
            for ((r, c), v) in data.into_dimensionality::<ndarray::Ix2>().unwrap().indexed_iter() {
                let expected = if r == 2 && c == 4 { 7.0 } else { (10 * r + c) as f64 };
                assert_eq!(*v, expected, "{name} {r},{c}");
            }
        }
        let path = folder.path().join("plain");
        std::fs::write(path.join("0.0"), [1, 2, 3]).unwrap();
        assert!(read(&path, None).unwrap_err().to_string().contains("3 bytes instead of 32"));
        array(&path, "{\"id\":\"blosc\"}", <[u8]>::to_vec);
        let told = read(&path, None).unwrap_err().to_string();
        assert!(told.contains("blosc") && told.contains("np.save"), "{told}");
    }
}
