//! Stores arrays on disk, each in a separate file: the sub-tiles of an interrupted build, the images of a library.
//!
//! A file holds a key that describes the array, its shape, its values and a SHA-256 of all these. A damaged file, or a complete file under
//! another name, is therefore never taken for the right one. Files appear complete or not at all; two processes that write the same array
//! do no harm.

use std::fs::{self, File};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use ndarray::Array2;
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};
use crate::files::atomic_write;
use crate::files::outputs::set_aside;

const MAGIC: &[u8; 8] = b"STEMARR1";
/// Number of bytes before the key: magic, rows, columns, lengths of key and note.
const HEAD: usize = 8 + 4 * 4;
const DIGEST: usize = 32;

/// A folder of arrays.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArrayStore {
    folder: PathBuf,
    extension: &'static str,
}

/// Result of looking up a name.
#[derive(Debug, Clone, PartialEq)]
pub enum Stored {
    /// The requested array, [row, column].
    Whole(Array2<f32>),
    /// No file.
    Missing,
    /// A file that cannot be used, with the reason.
    Unusable(&'static str),
}

impl ArrayStore {
    /// Returns the store of arrays in `folder`, in files with this ending. The folder is made at the first write.
    pub fn new(folder: PathBuf, extension: &'static str) -> Self {
        ArrayStore { folder, extension }
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the path of an array's file.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.{}", self.extension))
    }

    /// Loads the array under `name`, if it was saved under this key with this shape (rows, columns) and is complete.
    pub fn load(&self, name: &str, key: &str, shape: [usize; 2]) -> Stored {
        let path = self.path(name);
        // Reading a pipe or a device may never end.
        if fs::metadata(&path).is_ok_and(|there| !there.is_file()) {
            return Stored::Unusable("is no regular file");
        }
        match fs::read(&path) {
            Ok(bytes) => decoded(&bytes, key, shape).map_or_else(Stored::Unusable, Stored::Whole),
            // The folder may also be a file, below which nothing can lie.
            Err(e) if [ErrorKind::NotFound, ErrorKind::NotADirectory].contains(&e.kind()) => {
                Stored::Missing
            }
            Err(_) => Stored::Unusable("cannot be read"),
        }
    }

    /// Saves an array [row, column]. `key` describes everything that decides its values; `note` is for people who look into the file.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn save(&self, name: &str, key: &str, note: &str, array: &Array2<f32>) -> Result<()> {
        fs::create_dir_all(&self.folder).map_err(|e| Error::io(&self.folder, "create", e))?;
        let path = self.path(name);
        set_aside(&path)?;
        atomic_write::write(&path, &encoded(key, note, array))
    }

    /// Stores the bytes of a file that [`checked`] found complete, unless a complete file of this key exists. Returns whether it stored
    /// them.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(crate) fn add(&self, key: &str, file: &[u8]) -> Result<bool> {
        let path = self.path(key);
        let whole = |path: &Path| fs::read(path).is_ok_and(|there| checked(&there, key).is_ok());
        if path.is_file() && whole(&path) {
            return Ok(false);
        }
        fs::create_dir_all(&self.folder).map_err(|e| Error::io(&self.folder, "create", e))?;
        set_aside(&path)?;
        atomic_write::write(&path, file)?;
        Ok(true)
    }

    /// Returns the files of arrays in the folder, and files that killed writers have left; both are empty if there is no folder.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn files(&self) -> Result<StoreFiles> {
        let mut found = StoreFiles::default();
        if !self.folder.is_dir() {
            return Ok(found);
        }
        let fail = |e| Error::io(&self.folder, "read", e);
        for entry in fs::read_dir(&self.folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            if atomic_write::is_leftover(&path) {
                found.leftovers.push(path);
            } else if path.extension().is_some_and(|e| e == self.extension) && is_array(&path) {
                found.arrays.push(path);
            }
        }
        found.arrays.sort();
        found.leftovers.sort();
        Ok(found)
    }

    /// Returns the notes of all readable arrays in the folder.
    pub(crate) fn notes(&self) -> Vec<String> {
        let files = self.files().unwrap_or_default().arrays;
        files.iter().filter_map(|path| note(path)).collect()
    }

    /// Removes all arrays and leftovers, and the folder if it is then empty.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn clear(&self) -> Result<()> {
        let StoreFiles { arrays, leftovers } = self.files()?;
        for path in arrays.iter().chain(&leftovers) {
            fs::remove_file(path).map_err(|e| Error::io(path, "remove", e))?;
        }
        // A folder that holds other files stays.
        let _ = fs::remove_dir(&self.folder);
        Ok(())
    }
}

/// Files of a store.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct StoreFiles {
    /// Arrays, by name.
    pub arrays: Vec<PathBuf>,
    /// Unfinished files.
    pub leftovers: Vec<PathBuf>,
}

fn is_array(path: &Path) -> bool {
    let mut first = [0; MAGIC.len()];
    File::open(path).and_then(|mut f| f.read_exact(&mut first)).is_ok() && first == *MAGIC
}

/// Reads the note of an array's file, which may be incomplete.
fn note(path: &Path) -> Option<String> {
    let mut file = File::open(path).ok()?;
    let mut head = [0; HEAD];
    file.read_exact(&mut head).ok()?;
    let number = |n: usize| {
        let at = MAGIC.len() + 4 * n;
        u64::from(u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]))
    };
    let mut texts = Vec::new();
    file.take(number(2) + number(3)).read_to_end(&mut texts).ok()?;
    String::from_utf8(texts.get(number(2) as usize..)?.to_vec()).ok()
}

fn encoded(key: &str, note: &str, array: &Array2<f32>) -> Vec<u8> {
    let (rows, columns) = array.dim();
    let mut bytes = MAGIC.to_vec();
    for number in [rows, columns, key.len(), note.len()] {
        bytes.extend((number as u32).to_le_bytes());
    }
    bytes.extend(key.as_bytes());
    bytes.extend(note.as_bytes());
    bytes.extend(array.iter().flat_map(|v| v.to_le_bytes()));
    let digest = Sha256::digest(&bytes);
    bytes.extend(digest);
    bytes
}

/// Checks the bytes of a file against a key, and returns the note of its array.
///
/// # Errors
/// The reason for which the file cannot be used.
pub fn checked(bytes: &[u8], key: &str) -> std::result::Result<String, &'static str> {
    array_of(bytes, key)?;
    note_of(bytes)
}

/// Returns the array [row, column] of any shape in the bytes of a file, if it was saved under this key.
///
/// # Errors
/// The reason for which the file cannot be used.
pub(crate) fn array_of(bytes: &[u8], key: &str) -> std::result::Result<Array2<f32>, &'static str> {
    decoded(bytes, key, shape_of(bytes).ok_or("is cut off")?)
}

/// Reads the note in the bytes of a file, which may be incomplete otherwise.
///
/// # Errors
/// The reason for which the file cannot be used.
pub(crate) fn note_of(bytes: &[u8]) -> std::result::Result<String, &'static str> {
    shape_of(bytes).ok_or("is cut off")?;
    let note = HEAD + number(bytes, 2)..HEAD + number(bytes, 2) + number(bytes, 3);
    let note = bytes.get(note).ok_or("is cut off")?;
    Ok(String::from_utf8_lossy(note).into_owned())
}

fn shape_of(bytes: &[u8]) -> Option<[usize; 2]> {
    (bytes.len() >= HEAD).then(|| [number(bytes, 0), number(bytes, 1)])
}

/// Reads a number of the header.
fn number(bytes: &[u8], n: usize) -> usize {
    let at = MAGIC.len() + 4 * n;
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize
}

/// Returns the array [row, column] in the bytes of a file, if it was saved under this key with this shape (rows, columns) and is complete.
///
/// # Errors
/// The reason for which the file cannot be used.
pub(crate) fn decoded(
    bytes: &[u8],
    key: &str,
    shape: [usize; 2],
) -> std::result::Result<Array2<f32>, &'static str> {
    let cut = "is cut off";
    let body = bytes.len().checked_sub(DIGEST).filter(|body| *body >= HEAD).ok_or(cut)?;
    let (head, digest) = bytes.split_at(body);
    if &head[..MAGIC.len()] != MAGIC {
        return Err("is no array of this program");
    }
    if Sha256::digest(head).as_slice() != digest {
        return Err("is damaged");
    }
    let number = |n| number(head, n);
    let (key_end, rest) = (HEAD + number(2), HEAD + number(2) + number(3));
    if head.get(HEAD..key_end).ok_or(cut)? != key.as_bytes() {
        return Err("holds another image");
    }
    let values = head.get(rest..).ok_or(cut)?;
    if [number(0), number(1)] != shape
        || values.len() as u128 != 4 * shape[0] as u128 * shape[1] as u128
    {
        return Err("has another shape");
    }
    let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let values = values.chunks_exact(4).map(value).collect();
    Array2::from_shape_vec(shape, values).map_err(|_| "has another shape")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store() -> (tempfile::TempDir, ArrayStore, Array2<f32>) {
        let folder = tempfile::tempdir().unwrap();
        let store = ArrayStore::new(folder.path().join("store"), "image");
        let array = Array2::from_shape_fn((3, 5), |(i, j)| (i * 5 + j) as f32 * 0.1);
        store.save("a", "key of a", "note", &array).unwrap();
        assert_eq!(store.notes(), ["note"]);
        (folder, store, array)
    }

    #[test]
    fn arrays_come_back_under_their_name_key_and_shape_only() {
        let (_folder, store, array) = store();
        assert_eq!(store.load("a", "key of a", [3, 5]), Stored::Whole(array));
        assert_eq!(store.load("b", "key of a", [3, 5]), Stored::Missing);
        assert!(matches!(store.load("a", "key of a", [5, 3]), Stored::Unusable(_)));
        // A complete file under the name of another.
        fs::copy(store.path("a"), store.path("b")).unwrap();
        let Stored::Unusable(why) = store.load("b", "key of b", [3, 5]) else { panic!() };
        assert!(why.contains("another"), "{why}");
    }

    #[test]
    fn every_damaged_byte_and_every_length_is_noticed() {
        let (_folder, store, _) = store();
        let whole = fs::read(store.path("a")).unwrap();
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 4;
            fs::write(store.path("a"), &bytes).unwrap();
            let found = store.load("a", "key of a", [3, 5]);
            assert!(matches!(found, Stored::Unusable(_)), "byte {at}");
        }
        for length in 0..whole.len() {
            fs::write(store.path("a"), &whole[..length]).unwrap();
            let found = store.load("a", "key of a", [3, 5]);
            assert!(matches!(found, Stored::Unusable(_)), "length {length}");
        }
    }

    #[test]
    fn clearing_leaves_what_is_not_its_own() {
        let (_folder, store, _) = store();
        fs::write(store.folder().join("mine.image"), "precious").unwrap();
        fs::write(store.folder().join(".stemgen-x.partial"), "left").unwrap();
        let files = store.files().unwrap();
        assert_eq!((files.arrays.len(), files.leftovers.len()), (1, 1));
        store.clear().unwrap();
        assert_eq!(fs::read_dir(store.folder()).unwrap().count(), 1);
        assert!(store.folder().join("mine.image").exists());
    }
}
