//! Reads zarr folders, formats 2 and 3 (<https://zarr-specs.readthedocs.io>), as far as abTEM writes them: regular chunks, uncompressed or
//! by zstd, gzip or zlib.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use ndarray::{ArrayD, Dimension, IxDyn};
use serde_json::Value;

use super::number_type::NumberType;
use super::{ArrayAxis, ForeignArray, abtem_metadata, choose, held};
use crate::error::{Error, Result};

const REMEDY: &str = "export the image with np.save(\"image.npy\", measurement.array) instead";

/// Largest size of an unpacked chunk in bytes.
const LARGEST_CHUNK_BYTES: usize = 1 << 28;
/// Largest number of chunks of an array: each may be a file.
const MOST_CHUNKS: usize = 1 << 18;
/// Largest size of a description in JSON in bytes.
const LARGEST_JSON_BYTES: usize = 16 << 20;

/// Compression of chunks.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Codec {
    None,
    Zstd,
    Gzip,
    Zlib,
}

/// Layout of an array in the folder.
struct ZarrLayout {
    folder: PathBuf,
    shape: Vec<usize>,
    chunk: Vec<usize>,
    number: NumberType,
    codec: Codec,
    fill: f64,
    /// Whether the first index runs fastest.
    fortran: bool,
    prefix: &'static str,
    separator: &'static str,
}

pub fn read(path: &Path, name: Option<&str>) -> Result<ForeignArray> {
    if is_array(path) {
        super::nameless(path, name)?;
        let data = ZarrLayout::read(path)?.data()?;
        let mut array = ForeignArray::plain(path, "", data);
        array.axes = dimension_names(path, array.data.ndim());
        return Ok(array);
    }
    if !["zarr.json", ".zgroup"].iter().any(|f| path.join(f).is_file()) {
        let message =
            "is a folder, but no zarr array or group (it has no zarr.json, .zgroup or .zarray)";
        return Err(Error::parse(path, 0, message));
    }
    let entries = std::fs::read_dir(path).map_err(|e| Error::io(path, "read", e))?;
    let mut names: Vec<String> = entries
        .flatten()
        .filter(|e| e.file_type().is_ok_and(|kind| kind.is_dir()) && is_array(&e.path()))
        .map(|e| e.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    // An array that is named, or the only one, is read even if it is no image: the error then gives the reason.
    let asked = name.filter(|name| names.iter().any(|n| n == name));
    if names.len() > 1 && asked.is_none() {
        names.retain(|name| !is_complex(&path.join(name)));
    }
    let chosen = choose(path, &names, name)?;
    let data = ZarrLayout::read(&path.join(chosen))?.data()?;
    let mut array = ForeignArray::plain(path, chosen, data);
    // abTEM describes `array0` in the attribute `metadata0` of the group.
    let key = chosen.replacen("array", "metadata", 1);
    let attributes = attributes(path)?;
    abtem_metadata::describe(&mut array, &attributes[key]);
    if array.axes.is_none() {
        array.axes = dimension_names(&path.join(chosen), array.data.ndim());
    }
    if array.data.ndim() < 2 {
        return Err(array.error("is no image: the array has fewer than two dimensions"));
    }
    Ok(array)
}

fn is_array(folder: &Path) -> bool {
    let v3 = || json(&folder.join("zarr.json")).is_ok_and(|v| v["node_type"] == "array");
    folder.join(".zarray").is_file() || v3()
}

/// Returns the names of an array's dimensions, from zarr format 3 or xarray. They do not give the size of a pixel.
fn dimension_names(folder: &Path, count: usize) -> Option<Vec<ArrayAxis>> {
    let own = json(&folder.join("zarr.json")).unwrap_or_default();
    let attributes = attributes(folder).ok()?;
    let lists = [&own["dimension_names"], &attributes["_ARRAY_DIMENSIONS"]];
    let names = lists.into_iter().filter_map(Value::as_array).find(|names| names.len() == count)?;
    let axis = |name: &Value| {
        let label = name.as_str().unwrap_or_default().to_owned();
        ArrayAxis { label, ..ArrayAxis::default() }
    };
    Some(names.iter().map(axis).collect())
}

/// Whether an array holds complex numbers.
fn is_complex(folder: &Path) -> bool {
    let v2 = json(&folder.join(".zarray")).unwrap_or_default();
    let v3 = json(&folder.join("zarr.json")).unwrap_or_default();
    let described =
        v2["dtype"].as_str().unwrap_or_default().trim_start_matches(['<', '>', '|', '=']);
    described.starts_with('c') || v3["data_type"].as_str().is_some_and(|t| t.starts_with("complex"))
}

fn attributes(folder: &Path) -> Result<Value> {
    match folder.join("zarr.json") {
        file if file.is_file() => Ok(json(&file)?["attributes"].take()),
        _ => Ok(json(&folder.join(".zattrs")).unwrap_or_default()),
    }
}

fn json(path: &Path) -> Result<Value> {
    let missing = || Error::io(path, "read", std::io::ErrorKind::NotFound.into());
    let file = small_file(path, LARGEST_JSON_BYTES)?.ok_or_else(missing)?;
    let mut bytes = Vec::new();
    let read = file.take(LARGEST_JSON_BYTES as u64).read_to_end(&mut bytes);
    read.map_err(|e| Error::io(path, "read", e))?;
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
        let number = NumberType::described(v["dtype"].as_str().unwrap_or_default());
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
            separator: separator(folder, &v["dimension_separator"], ".")?,
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
        let separator = separator(folder, &keys["configuration"]["separator"], usual)?;
        Ok(ZarrLayout {
            folder: folder.to_owned(),
            shape: counts(folder, &v["shape"])?,
            chunk: counts(folder, &v["chunk_grid"]["configuration"]["chunk_shape"])?,
            number: number.ok_or_else(|| unreadable(folder, "type", &v["data_type"]))?,
            codec: compression.ok_or_else(|| unreadable(folder, "storage", &v["codecs"]))?,
            fill: v["fill_value"].as_f64().unwrap_or(0.0),
            fortran: false,
            prefix,
            separator,
        })
    }

    /// Reads all chunks. A missing chunk holds the fill value.
    fn data(&self) -> Result<ArrayD<f64>> {
        let refused = |reason: String| Error::parse(&self.folder, 0, reason);
        held(&self.shape).map_err(refused)?;
        let size = held(&self.chunk).map_err(refused)?;
        let fits = self.chunk.len() == self.shape.len() && !self.chunk.contains(&0);
        if !fits || size * self.number.bytes > LARGEST_CHUNK_BYTES {
            let chunk = &self.chunk;
            return Err(refused(format!(
                "has chunks of shape {chunk:?}; expected as many axes as the array, and at most \
                 {LARGEST_CHUNK_BYTES} bytes"
            )));
        }
        let counts: Vec<usize> =
            self.shape.iter().zip(&self.chunk).map(|(s, c)| s.div_ceil(*c)).collect();
        let chunks: usize = counts.iter().product();
        if chunks > MOST_CHUNKS {
            return Err(refused(format!("has {chunks} chunks; at most {MOST_CHUNKS} are read")));
        }
        let mut out = ArrayD::from_elem(IxDyn(&self.shape), self.fill);
        for place in ndarray::indices(IxDyn(&counts)) {
            if let Some(bytes) = self.chunk_bytes(place.slice(), size)? {
                self.fill_in(&mut out, place.slice(), &bytes);
            }
        }
        Ok(out)
    }

    /// Copies the values of the chunk at `place` into the array. Chunks at the edge extend beyond the array.
    fn fill_in(&self, out: &mut ArrayD<f64>, place: &[usize], bytes: &[u8]) {
        let axes: Vec<usize> = match self.fortran {
            true => (0..place.len()).collect(),
            false => (0..place.len()).rev().collect(),
        };
        let first: Vec<usize> = place.iter().zip(&self.chunk).map(|(p, c)| p * c).collect();
        let mut at = first.clone();
        for number in bytes.chunks_exact(self.number.bytes) {
            if let Some(slot) = out.get_mut(&at[..]) {
                *slot = self.number.decode(number);
            }
            for &axis in &axes {
                at[axis] += 1;
                if at[axis] < first[axis] + self.chunk[axis] {
                    break;
                }
                at[axis] = first[axis];
            }
        }
    }

    /// Returns the unpacked bytes of a chunk of `size` values; `None` if the chunk is missing.
    fn chunk_bytes(&self, place: &[usize], size: usize) -> Result<Option<Vec<u8>>> {
        let numbers: Vec<String> = place.iter().map(usize::to_string).collect();
        let mut key = numbers.join(self.separator);
        if !self.prefix.is_empty() {
            key = format!("{}{}{key}", self.prefix, self.separator);
        }
        let path = self.folder.join(key);
        let bad = |reason: String| Error::parse(&path, 0, format!("damaged chunk: {reason}"));
        let expected = size * self.number.bytes;
        // Codecs make incompressible values slightly longer.
        let Some(packed) = small_file(&path, expected + expected / 8 + 4096)? else {
            return Ok(None);
        };
        let packed = BufReader::new(packed);
        let bytes = unpack(self.codec, packed, expected).map_err(bad)?;
        if bytes.len() != expected {
            let more = if bytes.len() > expected { "more than " } else { "" };
            let found = bytes.len().min(expected);
            return Err(bad(format!("{more}{found} bytes instead of {expected}")));
        }
        Ok(Some(bytes))
    }
}

/// Opens a file that is neither a link nor larger than `most`; `None` if it does not exist.
fn small_file(path: &Path, most: usize) -> Result<Option<File>> {
    let about = match std::fs::symlink_metadata(path) {
        Ok(about) => about,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(Error::io(path, "read", e)),
    };
    if !about.is_file() {
        return Err(Error::parse(
            path,
            0,
            "is no regular file; copy the file itself to this place",
        ));
    }
    if about.len() > most as u64 {
        let message = format!("has {} bytes; at most {most} are expected here", about.len());
        return Err(Error::parse(path, 0, message));
    }
    File::open(path).map(Some).map_err(|e| Error::io(path, "read", e))
}

/// Unpacks up to one byte more than expected. The packed chunk is read as a stream, and not kept in memory.
fn unpack(
    codec: Codec,
    packed: impl Read,
    expected: usize,
) -> std::result::Result<Vec<u8>, String> {
    let (mut out, most) = (Vec::with_capacity(expected), expected as u64 + 1);
    let read = match codec {
        Codec::None => packed.take(most).read_to_end(&mut out),
        Codec::Zstd => {
            let decoder = ruzstd::decoding::StreamingDecoder::new(packed);
            decoder.map_err(|e| e.to_string())?.take(most).read_to_end(&mut out)
        }
        Codec::Gzip => flate2::read::GzDecoder::new(packed).take(most).read_to_end(&mut out),
        Codec::Zlib => flate2::read::ZlibDecoder::new(packed).take(most).read_to_end(&mut out),
    };
    read.map(|_| out).map_err(|e| e.to_string())
}

/// Returns the separator of the numbers in a chunk's name. Any other text could lead out of the folder.
fn separator(folder: &Path, value: &Value, usual: &'static str) -> Result<&'static str> {
    match value.as_str() {
        None => Ok(usual),
        Some(".") => Ok("."),
        Some("/") => Ok("/"),
        Some(_) => Err(unreadable(folder, "separator", value)),
    }
}

fn codec(name: &str) -> Option<Codec> {
    match name {
        "zstd" => Some(Codec::Zstd),
        "gzip" => Some(Codec::Gzip),
        "zlib" => Some(Codec::Zlib),
        _ => None,
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn array(folder: &Path, compressor: &str, pack: impl Fn(&[u8]) -> Vec<u8>) {
        std::fs::create_dir_all(folder).unwrap();
        let meta = format!(
            "{{\"shape\":[3,5],\"chunks\":[2,4],\"dtype\":\"<f4\",\"fill_value\":7.0,\"order\":\"C\",\
             \"filters\":null,\"compressor\":{compressor},\"zarr_format\":2}}"
        );
        std::fs::write(folder.join(".zarray"), meta).unwrap();
        // The values are 10 r + c in all chunks but the last, which is missing.
        for (r, c) in [(0, 0), (0, 1), (1, 0)] {
            let value = |i: usize| (10 * (2 * r + i / 4) + 4 * c + i % 4) as f32;
            let bytes: Vec<u8> = (0..8).flat_map(|i| value(i).to_le_bytes()).collect();
            std::fs::write(folder.join(format!("{r}.{c}")), pack(&bytes)).unwrap();
        }
    }

    #[test]
    fn what_is_announced_is_held_against_caps() {
        let folder = tempfile::tempdir().unwrap();
        let text = |from: &str, to: &str| {
            array(folder.path(), "null", <[u8]>::to_vec);
            let file = folder.path().join(".zarray");
            let meta = std::fs::read_to_string(&file).unwrap().replace(from, to);
            std::fs::write(file, meta).unwrap();
            read(folder.path(), None).unwrap_err().to_string()
        };
        let shape = "\"shape\":[3,5]";
        for huge in ["[1099511627776,0,1099511627776]", "[50000,50000]", "[18446744073709551615,2]"]
        {
            let found = text(shape, &format!("\"shape\":{huge}"));
            assert!(found.contains("at most 67108864 values"), "{found}");
        }
        assert!(text("[2,4]", "[30000,30000]").contains("at most"));
        let wide = text("[2,4],\"dtype\":\"<f4\"", "[8192,8192],\"dtype\":\"<f8\"");
        assert!(wide.contains("at most 268435456 bytes"), "{wide}");
        assert!(text("[2,4]", "[0,4]").contains("chunks of shape"));
        let many = text("[3,5],\"chunks\":[2,4]", "[1000,1000],\"chunks\":[1,1]");
        assert!(many.contains("at most 262144 are read"), "{many}");
        let nested = text("null", &format!("{}1{}", "[".repeat(100_000), "]".repeat(100_000)));
        assert!(nested.contains("recursion limit"), "{nested}");
        let out = text("\"order\"", "\"dimension_separator\":\"/../../\",\"order\"");
        assert!(out.contains("separator"), "{out}");
    }

    #[cfg(unix)]
    #[test]
    fn links_out_of_the_folder_are_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let inside = folder.path().join("image.zarr");
        array(&inside, "null", <[u8]>::to_vec);
        std::fs::rename(inside.join("0.0"), folder.path().join("secret")).unwrap();
        std::os::unix::fs::symlink("../secret", inside.join("0.0")).unwrap();
        let text = read(&inside, None).unwrap_err().to_string();
        assert!(text.contains("no regular file"), "{text}");
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
        let gzipped = folder.path().join("gzip");
        std::fs::write(gzipped.join("0.0"), gzip(&[0; 1 << 19])).unwrap();
        let bomb = read(&gzipped, None).unwrap_err().to_string();
        assert!(bomb.contains("more than 32 bytes instead of 32"), "{bomb}");
        array(&path, "{\"id\":\"blosc\"}", <[u8]>::to_vec);
        let text = read(&path, None).unwrap_err().to_string();
        assert!(text.contains("blosc") && text.contains("np.save"), "{text}");
    }
}
