//! Libraries as one file, to copy to another machine.
//!
//! All numbers are little-endian. The file begins with `STEMLIB1`, the version of the numerics (u32) and the number of images (u32). For
//! each image, in the order of material and key, follow: the lengths of material and key (u16 each), the sizes of its file in the cache
//! ([`crate::files::array_store`]) and of its packed bytes (u64 each), material, key, and the packed bytes. The SHA-256 of all this ends
//! the file. An image is packed by zlib after its bytes are put in the order 0, 4, 8 ... 1, 5, 9 ...: nothing is lost, and the bytes of the
//! file depend on its images only.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Read, Write};
use std::ops::Range;
use std::path::Path;

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::image_note::ImageNote;
use super::library_cache::{Cache, Holding, checked_image};
use crate::error::{Error, Result};
use crate::files::atomic_write;
use crate::files::whole_file;
use crate::numerics::NUMERICS_VERSION;
use crate::progress::Progress;

const MAGIC: &[u8; 8] = b"STEMLIB1";
const DIGEST: usize = 32;
/// Bytes of a value. The bytes of equal rank in all values are packed next to each other.
const VALUE: usize = 4;
/// The largest archive that is read, in bytes.
const MOST_ARCHIVE_BYTES: usize = 4 << 30;
/// The largest image in bytes; the largest image of the supplied libraries has a hundredth of it. Images are unpacked one after the other,
/// in three copies, so that an archive that claims to be large needs less than 1 GB.
const LARGEST_IMAGE: u64 = 256 << 20;

/// The content of an archive, or the result of an import.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct ArchiveSummary {
    /// Number of images of each material, and their size in the cache.
    pub materials: Vec<Holding>,
    /// Number of images that the cache did not have before; after an export, of all images.
    pub added: usize,
    /// Number of images of other versions of the program, which were left out.
    pub outdated: usize,
    /// Size of the archive in bytes.
    pub archive_bytes: u64,
}

/// An image in an archive.
struct Entry<'a> {
    material: &'a str,
    key: &'a str,
    image_bytes: u64,
    packed: &'a [u8],
}

/// An archive in memory. Its images are unpacked one at a time.
#[derive(Debug)]
pub(crate) struct Archive {
    bytes: Vec<u8>,
    /// The packed bytes of each image and its unpacked size, by material and key.
    images: BTreeMap<(String, String), (Range<usize>, u64)>,
}

impl Archive {
    /// Reads an archive.
    ///
    /// # Errors
    /// [`Error::Parse`] for a file that is no archive, is damaged, or is of another version of the numerics; [`Error::Io`].
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let bytes = whole_file::read(path, MOST_ARCHIVE_BYTES)?;
        let refused = |message: String| Error::Parse { path: path.to_owned(), line: 0, message };
        let place = |entry: Entry<'_>| {
            let start = entry.packed.as_ptr() as usize - bytes.as_ptr() as usize;
            let names = (entry.material.to_owned(), entry.key.to_owned());
            (names, (start..start + entry.packed.len(), entry.image_bytes))
        };
        let images = entries(&bytes).map_err(refused)?.into_iter().map(place).collect();
        Ok(Archive { bytes, images })
    }

    /// Materials and keys of the images.
    pub(crate) fn names(&self) -> impl Iterator<Item = (&str, &str)> {
        self.images.keys().map(|(material, key)| (material.as_str(), key.as_str()))
    }

    /// Whether the archive holds an image.
    pub(crate) fn has(&self, material: &str, key: &str) -> bool {
        self.images.contains_key(&(material.to_owned(), key.to_owned()))
    }

    /// The bytes of an image's file in a cache; `None` if the archive lacks the image.
    ///
    /// # Errors
    /// The fault of the image, in words, if the archive was written with a damaged one.
    pub(crate) fn file(
        &self,
        material: &str,
        key: &str,
    ) -> Option<std::result::Result<Vec<u8>, String>> {
        let ((material, key), (place, image_bytes)) =
            self.images.get_key_value(&(material.to_owned(), key.to_owned()))?;
        let packed = &self.bytes[place.clone()];
        Some(unpacked(&Entry { material, key, image_bytes: *image_bytes, packed }))
    }

    /// The images by material, with their size in a cache.
    pub(crate) fn holdings(&self) -> Vec<Holding> {
        let mut materials = Tally::default();
        for ((material, _), (_, image_bytes)) in &self.images {
            materials.add(material, *image_bytes);
        }
        materials.holdings()
    }
}

/// Writes the images of a material, or of all, from a cache to an archive. Images of other versions of the program are left out.
///
/// # Errors
/// [`Error::Io`]; [`Error::Parse`] for a cache that holds a damaged image.
pub fn export(
    cache: &Cache,
    material: Option<&str>,
    path: &Path,
    progress: &dyn Progress,
) -> Result<ArchiveSummary> {
    let mut files = Vec::new();
    for holding in cache.holdings()? {
        if material.is_none_or(|m| m == holding.material) {
            let of = cache.files(&holding.material)?;
            files.extend(of.into_iter().map(|file| (holding.material.clone(), file)));
        }
    }
    progress.start("packing", "image", files.len() as u64);
    let packed = files.par_iter().map(|(material, file)| {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let key = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let bytes = fs::read(file).map_err(|e| Error::io(file, "read", e))?;
        let note = checked_image(&bytes, &key).map_err(|why| {
            let message = format!("{why}; remove it, and the next build simulates it again");
            Error::Parse { path: file.clone(), line: 0, message }
        })?;
        progress.advance(1);
        let note: Option<ImageNote> = serde_json::from_str(&note).ok();
        let current = note.is_some_and(|note| note.numerics == NUMERICS_VERSION);
        Ok(current.then(|| (material.as_str(), key, bytes.len() as u64, packed(&bytes))))
    });
    let packed: Vec<_> = packed.collect::<Result<_>>()?;
    progress.finish();
    let outdated = packed.iter().filter(|p| p.is_none()).count();
    let images: Vec<_> = packed.into_iter().flatten().collect();
    let mut out = MAGIC.to_vec();
    out.extend(NUMERICS_VERSION.to_le_bytes());
    out.extend((images.len() as u32).to_le_bytes());
    let mut materials = Tally::default();
    for (material, key, bytes, packed) in &images {
        out.extend((material.len() as u16).to_le_bytes());
        out.extend((key.len() as u16).to_le_bytes());
        out.extend(bytes.to_le_bytes());
        out.extend((packed.len() as u64).to_le_bytes());
        out.extend(material.as_bytes());
        out.extend(key.as_bytes());
        out.extend(packed);
        materials.add(material, *bytes);
    }
    let digest = Sha256::digest(&out);
    out.extend(digest);
    atomic_write::write(path, &out)?;
    let archive_bytes = out.len() as u64;
    Ok(ArchiveSummary {
        materials: materials.holdings(),
        added: images.len(),
        outdated,
        archive_bytes,
    })
}

/// Copies the images of an archive into a cache. Images that the cache already has are not replaced.
///
/// # Errors
/// [`Error::Parse`] for a file that is no archive, is damaged, or is of another version of the numerics: then no image is written.
/// [`Error::Io`].
pub fn import(cache: &Cache, path: &Path, progress: &dyn Progress) -> Result<ArchiveSummary> {
    let bytes = whole_file::read(path, MOST_ARCHIVE_BYTES)?;
    let refused = |message: String| Error::Parse { path: path.to_owned(), line: 0, message };
    let entries = entries(&bytes).map_err(refused)?;
    progress.start("unpacking", "image", entries.len() as u64);
    let image = |entry: &Entry<'_>| {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        unpacked(entry).map_err(|why| refused(format!("{}/{}: {why}", entry.material, entry.key)))
    };
    // All images are checked before the first is written. They are unpacked twice, so that none stays in memory meanwhile.
    for entry in &entries {
        image(entry)?;
        progress.advance(1);
    }
    progress.finish();
    let (mut added, mut materials) = (0, Tally::default());
    for entry in &entries {
        materials.add(entry.material, entry.image_bytes);
        added += usize::from(cache.add(entry.material, entry.key, &image(entry)?)?);
    }
    let archive_bytes = bytes.len() as u64;
    Ok(ArchiveSummary { materials: materials.holdings(), added, outdated: 0, archive_bytes })
}

/// The images of an archive, or its fault in words.
fn entries(bytes: &[u8]) -> std::result::Result<Vec<Entry<'_>>, String> {
    if bytes.len() < MAGIC.len() || &bytes[..MAGIC.len()] != MAGIC {
        return Err(
            "is no library of simulations; expected a file that an export of the cache wrote"
                .into(),
        );
    }
    let body = bytes.len().checked_sub(DIGEST).filter(|body| *body >= MAGIC.len() + 8);
    let (body, digest) = bytes.split_at(body.ok_or("is cut off; copy it again")?);
    if Sha256::digest(body).as_slice() != digest {
        return Err("is cut off or damaged: its checksum differs; copy it again".into());
    }
    let mut rest = Reader(&body[MAGIC.len()..]);
    let version = rest.number(4)?;
    if version != u64::from(NUMERICS_VERSION) {
        return Err(format!(
            "holds simulations of version {version} of the numerics, which this program (version {NUMERICS_VERSION}) cannot use; export \
             the library with this version of the program"
        ));
    }
    let mut entries = Vec::new();
    for _ in 0..rest.number(4)? {
        let lengths = [rest.number(2)?, rest.number(2)?];
        let [image_bytes, packed_bytes] = [rest.number(8)?, rest.number(8)?];
        let [material, key] = [rest.text(lengths[0])?, rest.text(lengths[1])?];
        // Material and key become names of a folder and a file.
        if !is_name(material) || !is_key(key) || image_bytes > LARGEST_IMAGE {
            return Err(format!(
                "holds an image with an invalid name or size ({material:?}/{key:?}); export it again"
            ));
        }
        entries.push(Entry { material, key, image_bytes, packed: rest.bytes(packed_bytes)? });
    }
    match rest.0.is_empty() {
        true => Ok(entries),
        false => Err("holds bytes after its last image; export it again".into()),
    }
}

fn is_name(material: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_+.".contains(c);
    !material.is_empty() && !material.starts_with('.') && material.chars().all(plain)
}

fn is_key(key: &str) -> bool {
    key.len() == 2 * DIGEST && key.chars().all(|c| c.is_ascii_hexdigit())
}

/// The unread rest of a file.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn bytes(&mut self, count: u64) -> std::result::Result<&'a [u8], String> {
        let count = usize::try_from(count).ok().filter(|n| *n <= self.0.len());
        let (bytes, rest) =
            self.0.split_at(count.ok_or("is shorter than its header states; export it again")?);
        self.0 = rest;
        Ok(bytes)
    }

    fn number(&mut self, count: u64) -> std::result::Result<u64, String> {
        let bytes = self.bytes(count)?;
        Ok(bytes.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b)))
    }

    fn text(&mut self, count: u64) -> std::result::Result<&'a str, String> {
        std::str::from_utf8(self.bytes(count)?).map_err(|_| "holds a name that is no text".into())
    }
}

fn packed(bytes: &[u8]) -> Vec<u8> {
    let ordered: Vec<u8> =
        (0..VALUE).flat_map(|k| bytes.iter().skip(k).step_by(VALUE)).copied().collect();
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    // Writing to memory cannot fail.
    let _ = encoder.write_all(&ordered);
    encoder.finish().unwrap_or_default()
}

/// The bytes of an image's file, checked to be whole and to have the right name.
fn unpacked(entry: &Entry) -> std::result::Result<Vec<u8>, String> {
    let mut ordered = Vec::new();
    let most = entry.image_bytes + 1;
    let read = ZlibDecoder::new(entry.packed).take(most).read_to_end(&mut ordered);
    read.map_err(|e| format!("does not unpack ({e})"))?;
    if ordered.len() as u64 != entry.image_bytes {
        return Err("unpacks to another size than its header states".into());
    }
    let mut bytes = vec![0; ordered.len()];
    let places = (0..VALUE).flat_map(|k| (k..ordered.len()).step_by(VALUE));
    places.zip(&ordered).for_each(|(at, byte)| bytes[at] = *byte);
    drop(ordered);
    checked_image(&bytes, entry.key)?;
    Ok(bytes)
}

/// Number and size of images by material.
#[derive(Default)]
struct Tally(BTreeMap<String, (usize, u64)>);

impl Tally {
    fn add(&mut self, material: &str, bytes: u64) {
        let sum = self.0.entry(material.to_owned()).or_default();
        *sum = (sum.0 + 1, sum.1 + bytes);
    }

    fn holdings(self) -> Vec<Holding> {
        let holding = |(material, (images, bytes))| Holding { material, images, bytes };
        self.0.into_iter().map(holding).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use ndarray::Array2;

    fn note(numerics: u32) -> String {
        serde_json::json!({ "numerics": numerics, "settings": "", "sigma": "", "sites": "", "process": "", "rate": 0.0, "image": [0, 0] })
            .to_string()
    }

    fn key(n: usize) -> String {
        format!("{n:064x}")
    }

    /// A cache with images of two materials, and its archive.
    fn archive(folder: &Path) -> (Cache, std::path::PathBuf) {
        let cache = Cache::at(folder.join("cache"));
        for (n, material) in ["a", "a", "b"].into_iter().enumerate() {
            let image =
                Array2::from_shape_fn((5, 7), |(i, j)| ((i * 7 + j + n) as f32).sin().abs());
            cache.save(material, &key(n), &note(NUMERICS_VERSION), &image).unwrap();
        }
        let old = Array2::from_elem((2, 2), 1.0);
        cache.save("b", &key(9), &note(NUMERICS_VERSION - 1), &old).unwrap();
        let path = folder.join("all.stemlib");
        let words = export(&cache, None, &path, &Silent).unwrap();
        assert_eq!((words.added, words.outdated), (3, 1));
        assert_eq!(words.materials.iter().map(|m| m.images).collect::<Vec<_>>(), [2, 1]);
        assert_eq!(words.archive_bytes, fs::metadata(&path).unwrap().len());
        (cache, path)
    }

    #[test]
    fn images_travel_and_stay_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let (cache, path) = archive(folder.path());
        let other = Cache::at(folder.path().join("other"));
        assert_eq!(import(&other, &path, &Silent).unwrap().added, 3);
        for (n, material) in ["a", "a", "b"].into_iter().enumerate() {
            let image = cache.load(material, &key(n), [5, 7], &Silent);
            assert!(image.is_some() && image == other.load(material, &key(n), [5, 7], &Silent));
        }
        assert_eq!(import(&other, &path, &Silent).unwrap().added, 0);
        // Damaged images are replaced.
        let damaged = folder.path().join("other/a").join(format!("{}.sheet", key(0)));
        fs::write(&damaged, "no").unwrap();
        assert_eq!(import(&other, &path, &Silent).unwrap().added, 1);
        let again = folder.path().join("again.stemlib");
        export(&other, None, &again, &Silent).unwrap();
        assert!(fs::read(&path).unwrap() == fs::read(&again).unwrap());
        let one = folder.path().join("one.stemlib");
        assert_eq!(export(&other, Some("b"), &one, &Silent).unwrap().added, 1);
    }

    #[test]
    fn nothing_is_taken_from_a_damaged_archive() {
        let folder = tempfile::tempdir().unwrap();
        let (cache, path) = archive(folder.path());
        let whole = fs::read(&path).unwrap();
        let other = Cache::at(folder.path().join("other"));
        let words = |bytes: &[u8]| {
            fs::write(&path, bytes).unwrap();
            let words = import(&other, &path, &Silent).unwrap_err().to_string();
            assert!(
                words.contains("all.stemlib") && other.holdings().unwrap().is_empty(),
                "{words}"
            );
            words
        };
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 1;
            words(&bytes);
            words(&whole[..at]);
        }
        // An archive changed by someone who also renews its digest.
        let signed = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = whole[..whole.len() - DIGEST].to_vec();
            change(&mut bytes);
            let digest = Sha256::digest(&bytes);
            bytes.extend(digest);
            words(&bytes)
        };
        assert!(signed(&|b| b[8] += 1).contains("version"));
        assert!(signed(&|b| b[12] += 1).contains("shorter than its header"));
        assert!(signed(&|b| b[12] -= 1).contains("bytes after its last image"));
        assert!(signed(&|b| b[36] = b'/').contains("an invalid name"));
        assert!(signed(&|b| b[36] = b'.').contains("an invalid name"));
        assert!(signed(&|b| b[20] += 1).contains("another size"));
        assert!(signed(&|b| b[37] ^= 1).contains("another image"));
        // The archive is whole, but its image is impossible.
        for value in [-0.1, 1.2, f32::NAN, f32::INFINITY] {
            let odd = Array2::from_elem((2, 2), value);
            cache.save("a", &key(0), &note(NUMERICS_VERSION), &odd).unwrap();
            let words = export(&cache, None, &path, &Silent).unwrap_err().to_string();
            assert!(words.contains("below 0 or above 1"), "{value}: {words}");
            assert!(cache.load("a", &key(0), [2, 2], &Silent).is_none(), "{value}");
            assert_eq!(cache.verify(None, &Silent).unwrap().1.len(), 1, "{value}");
            let file = fs::read(folder.path().join("cache/a").join(format!("{}.sheet", key(0))));
            let file = file.unwrap();
            let packed = packed(&file);
            let entry = Entry {
                material: "a",
                key: &key(0),
                image_bytes: file.len() as u64,
                packed: &packed,
            };
            assert!(unpacked(&entry).unwrap_err().contains("below 0 or above 1"), "{value}");
        }
    }
}
