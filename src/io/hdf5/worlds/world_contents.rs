//! Computes digests of the contents of a world file, name by name: of each group, link, attribute and dataset.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use hdf5::types::{TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5::{Attribute, File, Group, H5Type, Location};
use sha2::{Digest, Sha256};

use super::world_file::WorldFile;
use crate::error::{Error, Result};
use crate::io::hdf5::hdf5_guard::{Guarded, Walk, check_bytes, check_storage, damaged, walk};
use crate::io::hdf5::hdf5_values;

/// Number of bytes of each digest.
const DIGEST_BYTES: usize = 16;

impl WorldFile {
    /// Returns a digest of each group, link, attribute and dataset of the file, by its name: `/overview`, `/overview@factor`. Objects whose
    /// names are numbers, such as tiles, share one digest, `/tiles/*`. A digest covers type, shape and values; the packing of the values
    /// does not matter. For attributes of types that do not occur in worlds it covers the type alone.
    ///
    /// # Errors
    /// [`Error::Parse`] for a damaged file.
    pub(crate) fn contents(&self) -> Result<BTreeMap<String, String>> {
        let refused = |fault: String| Error::parse(self.path(), 0, fault);
        contents_of(&self.file, self.path(), self.bytes).map_err(refused)
    }
}

fn contents_of(file: &File, path: &Path, bytes: u64) -> Guarded<BTreeMap<String, String>> {
    let mut contents = Contents { path, bytes, digests: BTreeMap::new() };
    contents.all(file, walk(file)?)?;
    let hex = |hash: Sha256| {
        hash.finalize().iter().take(DIGEST_BYTES).map(|b| format!("{b:02x}")).collect()
    };
    Ok(contents.digests.into_iter().map(|(name, hash)| (name, hex(hash))).collect())
}

/// The digests so far.
struct Contents<'a> {
    path: &'a Path,
    /// Size of the file in bytes.
    bytes: u64,
    digests: BTreeMap<String, Sha256>,
}

impl Contents<'_> {
    fn all(&mut self, file: &File, mut walk: Walk) -> Guarded<()> {
        walk.groups.sort();
        walk.datasets.sort();
        self.attributes(file, "")?;
        self.links(file, &walk)?;
        for name in &walk.groups {
            let group = file.group(name).map_err(|e| format!("{name} {}", damaged(e)))?;
            self.add(name, "", &["group".as_bytes()]);
            self.attributes(&group, name)?;
        }
        for name in &walk.datasets {
            self.dataset(file, name).map_err(|fault| format!("{name} {fault}"))?;
        }
        Ok(())
    }

    /// Adds the targets of soft links.
    fn links(&mut self, file: &File, walk: &Walk) -> Guarded<()> {
        let token = |name: &str| file.loc_info_by_name(name).ok().map(|i| format!("{:?}", i.token));
        let things = walk.groups.iter().chain(&walk.datasets);
        let places: HashMap<String, &String> =
            things.filter_map(|name| Some((token(name)?, name))).collect();
        for path in std::iter::once("").chain(walk.groups.iter().map(String::as_str)) {
            let group: Group = match path {
                "" => file.group("/").map_err(damaged)?,
                path => file.group(path).map_err(damaged)?,
            };
            let mut soft = Vec::new();
            let visited = group.iter_visit_default(|name, link| {
                if link.link_type == hdf5::LinkType::Soft {
                    soft.push(format!("{path}/{name}"));
                }
                Ok(())
            });
            visited.map_err(damaged)?;
            for link in soft {
                let target = token(&link).and_then(|t| places.get(&t).copied());
                let target = target.map_or("nothing", String::as_str);
                self.add(&link, "", &["link".as_bytes(), target.as_bytes()]);
            }
        }
        Ok(())
    }

    fn dataset(&mut self, file: &File, name: &str) -> Guarded<()> {
        let dataset = file.dataset(name).map_err(damaged)?;
        check_storage(&dataset, self.bytes)?;
        let values = hdf5_values::stored_bytes(&dataset, self.path)?;
        let about =
            format!("{:?} {:?}", dataset.dtype().and_then(|t| t.to_descriptor()), dataset.shape());
        self.add(name, "", &["dataset".as_bytes(), about.as_bytes(), &values]);
        self.attributes(&dataset, name)
    }

    fn attributes(&mut self, at: &Location, path: &str) -> Guarded<()> {
        for name in at.attr_names().map_err(damaged)? {
            let fault = |fault: String| format!("{path}@{name} {fault}");
            let attribute = at.attr(&name).map_err(|e| fault(damaged(e)))?;
            let (about, values) = self.attribute(&attribute).map_err(fault)?;
            self.add(
                path,
                &format!("@{name}"),
                &["attribute".as_bytes(), about.as_bytes(), &values],
            );
        }
        Ok(())
    }

    /// Returns type and shape of an attribute, and its values as bytes; no bytes for a type that does not occur in worlds.
    fn attribute(&self, attribute: &Attribute) -> Guarded<(String, Vec<u8>)> {
        fn texts<T: H5Type>(from: &Attribute, bytes: impl Fn(&T) -> &[u8]) -> Guarded<Vec<u8>> {
            let texts: Vec<T> = from.read_raw().map_err(damaged)?;
            let mut all = Vec::new();
            for text in texts.iter().map(bytes) {
                all.extend((text.len() as u64).to_le_bytes());
                all.extend(text);
            }
            Ok(all)
        }
        let kind = attribute.dtype().map_err(damaged)?;
        let Ok(kind) = kind.to_descriptor() else { return Ok(("unknown".into(), Vec::new())) };
        check_bytes(&attribute.shape(), kind.size(), self.bytes)?;
        let values = match kind {
            TypeDescriptor::VarLenUnicode => texts(attribute, |t: &VarLenUnicode| t.as_bytes())?,
            TypeDescriptor::VarLenAscii => texts(attribute, |t: &VarLenAscii| t.as_bytes())?,
            _ => hdf5_values::attribute_bytes(attribute)?.unwrap_or_default(),
        };
        Ok((format!("{kind:?} {:?}", attribute.shape()), values))
    }

    /// Adds values to the digest of a name, each with its length, so that different lists never give the same bytes.
    fn add(&mut self, path: &str, attribute: &str, values: &[&[u8]]) {
        let hash = self.digests.entry(format!("{}{attribute}", together(path))).or_default();
        for value in [path.as_bytes()].iter().chain(values) {
            hash.update((value.len() as u64).to_le_bytes());
            hash.update(value);
        }
    }
}

/// Returns the name of an object's digest: objects whose names are numbers share one, `/tiles/3_0` has `/tiles/*`.
fn together(path: &str) -> String {
    if path.is_empty() {
        return "/".into();
    }
    let number = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_digit())
            && part.chars().all(|c| c.is_ascii_digit() || c == '_')
    };
    path.split('/').map(|part| if number(part) { "*" } else { part }).collect::<Vec<_>>().join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Changes a small file by `change`, and returns the names of all digests that then differ.
    fn changed(change: &dyn Fn(&File)) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        let contents = |name: &str, change: &dyn Fn(&File)| {
            let path = folder.path().join(name);
            let file = File::create(&path).unwrap();
            let tiles = file.create_group("tiles").unwrap();
            for (number, name) in ["0_0", "0_1"].into_iter().enumerate() {
                let builder = tiles.new_dataset_builder().chunk((2, 2)).deflate(1);
                let values = ndarray::Array2::from_elem((2, 2), number as f32);
                builder.with_data(&values).create(name).unwrap();
            }
            tiles.new_attr::<f64>().create("scale").unwrap().write_scalar(&2.0).unwrap();
            let text: VarLenUnicode = "a text".parse().unwrap();
            tiles.new_attr::<VarLenUnicode>().create("unit").unwrap().write_scalar(&text).unwrap();
            let whole = file.new_dataset_builder().with_data(&[true, false, true]);
            whole.create("valid_region").unwrap();
            file.create_group("detectors").unwrap().link_soft("/tiles", "tiles").unwrap();
            change(&file);
            file.flush().unwrap();
            let bytes = std::fs::metadata(&path).unwrap().len();
            contents_of(&file, &path, bytes).unwrap()
        };
        let (before, after) = (contents("a.h5", &|_| {}), contents("b.h5", change));
        assert_eq!(before.len(), 7, "{before:?}");
        let names = before.keys().chain(after.keys()).collect::<std::collections::BTreeSet<_>>();
        names.into_iter().filter(|n| before.get(*n) != after.get(*n)).cloned().collect()
    }

    #[test]
    fn each_change_is_found_under_its_name() {
        let tiles = |file: &File| file.group("tiles").unwrap();
        let none: [&str; 0] = [];
        assert_eq!(changed(&|_| {}), none);
        let scale = |file: &File| tiles(file).attr("scale").unwrap().write_scalar(&3.0).unwrap();
        assert_eq!(changed(&scale), ["/tiles@scale"]);
        let text = |file: &File| {
            let text: VarLenUnicode = "another".parse().unwrap();
            tiles(file).attr("unit").unwrap().write_scalar(&text).unwrap();
        };
        assert_eq!(changed(&text), ["/tiles@unit"]);
        assert_eq!(changed(&|file| tiles(file).delete_attr("unit").unwrap()), ["/tiles@unit"]);
        let more = |file: &File| {
            file.new_attr::<u8>().create("mine").unwrap().write_scalar(&1).unwrap();
        };
        assert_eq!(changed(&more), ["/@mine"]);
        let valid = |file: &File| {
            file.dataset("valid_region").unwrap().write(&[true, true, true]).unwrap();
        };
        assert_eq!(changed(&valid), ["/valid_region"]);
        let exchange = |file: &File| {
            let tile = |name| tiles(file).dataset(name).unwrap();
            let (a, b) =
                (tile("0_0").read_2d::<f32>().unwrap(), tile("0_1").read_2d::<f32>().unwrap());
            tile("0_0").write(&b).unwrap();
            tile("0_1").write(&a).unwrap();
        };
        assert_eq!(changed(&exchange), ["/tiles/*"]);
        let elsewhere = |file: &File| {
            let detectors = file.group("detectors").unwrap();
            detectors.unlink("tiles").unwrap();
            detectors.link_soft("/valid_region", "tiles").unwrap();
        };
        assert_eq!(changed(&elsewhere), ["/detectors/tiles"]);
        assert_eq!(changed(&|file| drop(file.create_group("mine").unwrap())), ["/mine"]);
        let typed = |file: &File| {
            file.unlink("valid_region").unwrap();
            let values = file.new_dataset_builder().with_data(&[1_u8, 0, 1]);
            values.create("valid_region").unwrap();
        };
        assert_eq!(changed(&typed), ["/valid_region"]);
    }

    #[test]
    fn numbered_things_stand_together() {
        let known =
            ["", "/tiles/3_0", "/ground_truth/grain_boundaries/12", "/ground_truth/columns"];
        let expected =
            ["/", "/tiles/*", "/ground_truth/grain_boundaries/*", "/ground_truth/columns"];
        assert_eq!(known.map(together), expected);
    }
}
