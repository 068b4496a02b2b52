//! Checks of HDF5 files from unknown sources. Nothing outside the file is read, and sizes in headers are compared with the size of the file
//! before memory is requested. Reasons are returned as text, without the name of the file.

use std::collections::HashSet;

use hdf5::plist::dataset_create::Layout;
use hdf5::types::{FixedAscii, FixedUnicode, VarLenArray, VarLenAscii, VarLenUnicode};
use hdf5::{
    Dataset, File, Group, H5Type, LinkType, Location, LocationType, ObjectReference1,
    ReferencedObject,
};

/// Number of bytes of the largest numbers that values are read as.
const LARGEST_NUMBER_BYTES: usize = 8;

/// Largest number of bytes of a text of fixed length.
const LONGEST_TEXT: usize = 256;

/// Largest number of texts in an attribute: one for each axis of an array.
pub(crate) const MOST_TEXTS: usize = 64;

/// Result with the reason for which a file is refused.
pub(crate) type Guarded<T> = std::result::Result<T, String>;

/// Largest depth of nested groups.
const DEEPEST: usize = 64;
/// Largest number of groups, datasets and other objects in a file.
const MOST_OBJECTS: usize = 1 << 20;
/// Largest number of chunks of a dataset.
const MOST_CHUNKS: usize = 1 << 20;
/// Largest number of bytes in the path of a dataset.
const LONGEST_PATH: usize = 4096;
/// Any file may announce this many bytes ...
const ALWAYS_ALLOWED_BYTES: u128 = 256 << 20;
/// ... a larger file may announce this multiple of its size, which compressed images without a specimen reach ...
const LARGEST_EXPANSION: u128 = 64;
/// ... but no more than this, so that a file of a few MB never takes a GiB ...
const MOST_EXPANDED_BYTES: u128 = 896 << 20;
/// ... unless the file is so large that its values are stored nearly uncompressed: bytes become numbers of 8 bytes.
const PLAIN_EXPANSION: u128 = 8;

/// A chunk exists twice in memory while the order of its bytes is restored.
const COPIES_OF_A_CHUNK: u128 = 2;

/// Returns how many bytes may be read from one dataset of a file of `file_bytes` bytes.
fn allowed_bytes(file_bytes: u64) -> u128 {
    let file = u128::from(file_bytes);
    let expanded = (LARGEST_EXPANSION * file).min(MOST_EXPANDED_BYTES);
    ALWAYS_ALLOWED_BYTES.max(expanded).max(PLAIN_EXPANSION * file)
}

/// Returns the paths of all datasets; datasets of a group come before the datasets of its subgroups.
///
/// Refuses links to other files, wherever they are: following a link would open the other file.
pub(crate) fn datasets(file: &File) -> Guarded<Vec<String>> {
    walk(file).map(|walk| walk.datasets)
}

/// Returns all groups and datasets of a file, with the checks of [`datasets`].
pub(crate) fn walk(file: &File) -> Guarded<Walk> {
    if file.userblock() > 0 {
        return Err(
            "begins with a block of other data, which is not read; `h5unjam` takes it out".into()
        );
    }
    let mut walk =
        Walk { seen: HashSet::new(), objects: 0, groups: Vec::new(), datasets: Vec::new() };
    walk.visit(file, "", 0)?;
    Ok(walk)
}

/// The objects found in a file.
pub(crate) struct Walk {
    /// Groups that were visited: links may lead back to a group that holds them.
    seen: HashSet<String>,
    objects: usize,
    /// Paths of the groups, without the first.
    pub groups: Vec<String>,
    /// Paths of the datasets.
    pub datasets: Vec<String>,
}

impl Walk {
    fn visit(&mut self, group: &Group, path: &str, depth: usize) -> Guarded<()> {
        if depth > DEEPEST {
            return Err(format!("has groups more than {DEEPEST} deep in each other"));
        }
        let mut inner = Vec::new();
        for (name, kind) in links(group, path)? {
            self.objects += 1;
            let below = format!("{path}/{name}");
            if self.objects > MOST_OBJECTS {
                return Err(format!("holds more than {MOST_OBJECTS} groups and datasets"));
            }
            if below.len() > LONGEST_PATH {
                return Err(format!("has a path of more than {LONGEST_PATH} bytes"));
            }
            // The target of a soft link is found through hard links, or does not exist.
            if kind == LinkType::Soft {
                continue;
            }
            let info = group.loc_info_by_name(&name);
            let info = info.map_err(|e| format!("{below} cannot be read ({})", first_line(&e)))?;
            match info.loc_type {
                LocationType::Dataset => self.datasets.push(below),
                LocationType::Group if self.seen.insert(format!("{:?}", info.token)) => {
                    inner.push((name, below));
                }
                _ => {}
            }
        }
        for (name, below) in inner {
            let opened = group.group(&name);
            let opened = opened.map_err(|e| format!("{below} {}", damaged(e)))?;
            self.visit(&opened, &below, depth + 1)?;
            self.groups.push(below);
        }
        Ok(())
    }
}

/// Returns names and kinds of the links of a group.
fn links(group: &Group, path: &str) -> Guarded<Vec<(String, LinkType)>> {
    let mut links = Vec::new();
    let mut elsewhere = None;
    let visited = group.iter_visit_default(|name, link| {
        if link.link_type == LinkType::External {
            elsewhere = Some(format!("{path}/{name}"));
        }
        links.push((name.to_owned(), link.link_type));
        Ok(())
    });
    if let Some(link) = elsewhere {
        return Err(format!(
            "has a link to another file, {link}, which is not followed; remove it"
        ));
    }
    visited.map_err(|e| format!("{path}/ cannot be listed ({})", first_line(&e)))?;
    Ok(links)
}

/// Refuses datasets whose values are in other files, and datasets that announce more than a file of `file_bytes` bytes can hold.
pub(crate) fn check_storage(dataset: &Dataset, file_bytes: u64) -> Guarded<()> {
    let plan = dataset.dcpl().map_err(damaged)?;
    // This check comes before the shape: asking a virtual dataset for its shape opens other files.
    let elsewhere = match plan.layout() {
        Layout::Virtual => true,
        _ => !plan.get_external().map_err(damaged)?.is_empty(),
    };
    if elsewhere {
        return Err(
            "refers to values in another file, which is not read; copy the values into this file"
                .into(),
        );
    }
    // Bytes in the file may be read as larger numbers.
    let bytes = dataset.dtype().map_err(damaged)?.size().max(LARGEST_NUMBER_BYTES);
    let shape = dataset.shape();
    check_bytes(&shape, bytes, file_bytes)?;
    let Some(chunk) = plan.chunk() else { return check_end(dataset, file_bytes) };
    check_bytes(&chunk, bytes, file_bytes)?;
    check_chunk(&chunk, &shape, bytes, file_bytes)?;
    let along = shape.iter().zip(&chunk).map(|(n, c)| n.div_ceil((*c).max(1)));
    match along.fold(1_usize, usize::saturating_mul) {
        count if count > MOST_CHUNKS => Err(format!(
            "is cut into {count} chunks; at most {MOST_CHUNKS} are read; save it again in larger chunks"
        )),
        _ => Ok(()),
    }
}

/// Refuses chunks that are too large: unpacking one, in addition to the values, must not take more memory than a file of `file_bytes` bytes
/// may use.
fn check_chunk(chunk: &[usize], shape: &[usize], bytes: usize, file_bytes: u64) -> Guarded<()> {
    let all =
        |lengths: &[usize]| lengths.iter().fold(bytes as u128, |n, k| n.saturating_mul(*k as u128));
    let needed = all(shape).saturating_add(all(chunk).saturating_mul(COPIES_OF_A_CHUNK));
    let allowed = allowed_bytes(file_bytes);
    if needed > allowed {
        return Err(format!(
            "is packed in chunks of {chunk:?} values: unpacking one needs {needed} bytes with the values, and at most {allowed} are \
             allowed for a file of {file_bytes} bytes; save it again in smaller chunks"
        ));
    }
    Ok(())
}

/// Refuses a contiguous dataset that extends beyond the end of the file.
fn check_end(dataset: &Dataset, file_bytes: u64) -> Guarded<()> {
    let bytes = dataset.dtype().map_err(damaged)?.size() as u64 * dataset.size() as u64;
    // libhdf5 1.10.8 reads compact values, which lie in the description of the dataset, beyond their end.
    if dataset.dcpl().map_err(damaged)?.layout() == Layout::Compact
        && bytes > dataset.storage_size()
    {
        return Err("announces more values than it holds".into());
    }
    // Compact data, and data that were never written, have no offset.
    let Some(first) = dataset.offset() else { return Ok(()) };
    match first.checked_add(bytes).is_some_and(|end| end <= file_bytes) {
        true => Ok(()),
        false => Err("reaches beyond the end of the file".into()),
    }
}

/// Compares the size of an array of values of `value_bytes` bytes with a file of `file_bytes` bytes.
pub(crate) fn check_bytes(shape: &[usize], value_bytes: usize, file_bytes: u64) -> Guarded<()> {
    let allowed = allowed_bytes(file_bytes);
    // Axes of length 0 hide the lengths of the others.
    let product = |n: u128, length: &usize| n.saturating_mul((*length).max(1) as u128);
    let announced = shape.iter().fold(value_bytes as u128, product);
    if announced > allowed {
        let packed = announced / u128::from(file_bytes.max(1));
        return Err(format!(
            "announces {shape:?} values, {announced} bytes, in a file of {file_bytes} bytes: packed {packed} : 1; at most {allowed} bytes \
             are read from it ({LARGEST_EXPANSION} times its size up to 896 MiB, {PLAIN_EXPANSION} times beyond); if the file is \
             complete, save it without compression (h5repack -f NONE)"
        ));
    }
    Ok(())
}

/// Reads an attribute that is one number (or another value of fixed size).
pub(crate) fn number<T: H5Type>(at: &Location, name: &str) -> Option<T> {
    at.attr(name).and_then(|a| a.read_scalar()).ok()
}

/// Reads an attribute that is two numbers.
pub(crate) fn pair(at: &Location, name: &str) -> Option<[f64; 2]> {
    let attribute = at.attr(name).ok().filter(|a| a.size() == 2)?;
    attribute.read_raw().ok()?.try_into().ok()
}

/// Reads an attribute that is a text in UTF-8.
pub(crate) fn text(at: &Location, name: &str) -> Option<String> {
    number::<VarLenUnicode>(at, name).as_ref().and_then(string)
}

/// Reads an attribute that is a text in any encoding.
pub(crate) fn any_text(at: &Location, name: &str) -> Option<String> {
    fn of<T: H5Type>(at: &Location, name: &str, bytes: impl Fn(&T) -> &[u8]) -> Option<String> {
        let found = number::<T>(at, name)?;
        Some(String::from_utf8_lossy(bytes(&found)).trim_end_matches('\0').to_owned())
    }
    text(at, name)
        .or_else(|| of::<VarLenAscii>(at, name, |t| t.as_bytes()))
        .or_else(|| of::<FixedUnicode<LONGEST_TEXT>>(at, name, |t| t.as_bytes()))
        .or_else(|| of::<FixedAscii<LONGEST_TEXT>>(at, name, |t| t.as_bytes()))
}

/// Reads an attribute that is `count` texts in UTF-8.
pub(crate) fn texts(at: &Location, name: &str, count: usize) -> Option<Vec<String>> {
    let attribute = at.attr(name).ok().filter(|a| a.size() == count)?;
    let texts: Vec<VarLenUnicode> = attribute.read_raw().ok()?;
    texts.iter().map(string).collect()
}

/// Reads an attribute that is `count` texts in any encoding.
pub(crate) fn any_texts(at: &Location, name: &str, count: usize) -> Option<Vec<String>> {
    fn of<T: H5Type>(
        at: &Location,
        name: &str,
        count: usize,
        bytes: impl Fn(&T) -> &[u8],
    ) -> Option<Vec<String>> {
        let attribute = at.attr(name).ok().filter(|a| a.size() == count)?;
        let texts: Vec<T> = attribute.read_raw().ok()?;
        let plain = |text| String::from_utf8_lossy(bytes(text)).trim_end_matches('\0').to_owned();
        Some(texts.iter().map(plain).collect())
    }
    if count > MOST_TEXTS {
        return None;
    }
    of::<VarLenUnicode>(at, name, count, |t| t.as_bytes())
        .or_else(|| of::<VarLenAscii>(at, name, count, |t| t.as_bytes()))
        .or_else(|| of::<FixedUnicode<LONGEST_TEXT>>(at, name, count, |t| t.as_bytes()))
        .or_else(|| of::<FixedAscii<LONGEST_TEXT>>(at, name, count, |t| t.as_bytes()))
}

/// Returns the paths of the first scale of each dimension of an array, as `H5DSattach_scale` writes them.
pub(crate) fn scale_paths(dataset: &Dataset) -> Vec<Option<String>> {
    let count = dataset.ndim();
    let attribute = dataset.attr("DIMENSION_LIST").ok().filter(|a| a.size() == count);
    let lists = attribute.and_then(|a| a.read_raw::<VarLenArray<ObjectReference1>>().ok());
    let path =
        |list: &VarLenArray<ObjectReference1>| match dataset.dereference(list.first()?).ok()? {
            ReferencedObject::Dataset(scale) => Some(scale.name()),
            _ => None,
        };
    lists.unwrap_or_default().iter().map(path).collect()
}

fn string(text: &VarLenUnicode) -> Option<String> {
    std::str::from_utf8(text.as_bytes()).ok().map(str::to_owned)
}

/// Describes a dataset that the library cannot read.
pub(crate) fn damaged(error: hdf5::Error) -> String {
    format!("cannot be read ({})", first_line(&error))
}

pub(crate) fn first_line(error: &hdf5::Error) -> String {
    error.to_string().lines().next().unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_may_be_read_follows_the_size_of_the_file() {
        let mib = |n: u64| n << 20;
        let found = [1, 8, 13, 20, 112, 1000].map(|n| allowed_bytes(mib(n)) >> 20);
        assert_eq!(found, [256, 512, 832, 896, 896, 8000]);
    }
}
