//! Manifests of released worlds: digests of recipe, truth and image, digests of all other contents of the file, and values of the image
//! before noise.
//!
//! The truth is identical on every machine. The image is identical in all bytes on processors of one kind. Between kinds it differs by
//! rounding, which may change single counted electrons: there the values before noise show whether the image agrees.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::pinned_contents::PinnedContents;
use crate::error::{Error, Result};
use crate::io::WorldFile;
use crate::numerics::{NUMERICS_VERSION, processor};
use crate::progress::Progress;
use crate::recipe::Difficulty;
use crate::rng::{Purpose, words};
use crate::setting::Setting;

/// Version of the format of manifests.
const VERSION: u32 = 1;
/// Number of values of an image in a manifest.
const SAMPLES: usize = 64;
/// Seed of the places of those values.
const SEED: u64 = 1;
/// Largest difference of the values before noise on two processors, as a fraction of the brightest value.
const SAME: f64 = 1e-5;

/// A list of released worlds with their digests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    version: u32,
    /// Numerics version of the program that made the worlds.
    pub numerics: u32,
    /// The worlds.
    #[serde(default, rename = "world")]
    pub worlds: Vec<PinnedWorld>,
}

/// Digests and values by which a world is recognised.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PinnedWorld {
    /// Name of the world: `srtio3_hard`.
    pub name: String,
    /// Recipe that is installed with the program.
    pub material: String,
    /// Tier of the recipe.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub difficulty: Option<Difficulty>,
    /// Seed.
    pub seed: u64,
    /// SHA-256 of the whole recipe as TOML.
    pub recipe_sha256: String,
    /// SHA-256 of all lists of the truth.
    pub truth_sha256: String,
    /// Values before noise, as fractions of the beam, at random places that are equal for all worlds of a size.
    pub samples: Vec<f32>,
    /// SHA-256 of all tiles, with noise and without, by kind of processor.
    pub image_sha256: BTreeMap<String, String>,
    /// Digests of every dataset and attribute; empty in manifests of earlier versions.
    #[serde(default)]
    pub contents: PinnedContents,
}

/// Result of comparing a world with its manifest.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "sameness", rename_all = "snake_case")]
pub enum PinnedSameness {
    /// Truth, image, and every dataset and attribute agree.
    SameBytes {
        /// Number of datasets and attributes compared, tiles counted as one.
        compared: usize,
        /// Contents that were not compared, with the reason.
        not_compared: Vec<String>,
    },
    /// The truth agrees, and the values before noise are close. The manifest has no digest of this kind of processor, so the other pixels
    /// are not compared.
    SameValues {
        /// Greatest difference of the values before noise, as a fraction of the brightest value.
        difference: f64,
        /// Number of values compared.
        values: usize,
        /// Number of datasets and attributes compared, tiles counted as one.
        compared: usize,
        /// Contents that were not compared, with the reason.
        not_compared: Vec<String>,
    },
    /// Something differs.
    Different {
        /// Names of the contents that differ.
        what: Vec<String>,
    },
}

impl Manifest {
    /// Returns a manifest without worlds, of this version of the numerics.
    pub fn empty() -> Self {
        Manifest { version: VERSION, numerics: NUMERICS_VERSION, worlds: Vec::new() }
    }

    /// Reads a manifest; `name` is used in errors.
    ///
    /// # Errors
    /// [`Error::Parse`] for a text that is no manifest, [`Error::Invalid`] for a manifest of another version of the program.
    pub fn from_toml(name: &str, text: &str) -> Result<Self> {
        let manifest: Manifest = toml::from_str(text).map_err(|e| {
            let line = e.span().map_or(0, |s| 1 + text[..s.start].matches('\n').count());
            Error::Parse { path: name.into(), line, message: e.message().to_owned() }
        })?;
        if manifest.version != VERSION {
            let expected =
                format!("this program reads version {VERSION}; use the manifest of this program");
            let value = format!("{name}, version {}", manifest.version);
            return Err(Error::invalid(Setting::Manifest, value, expected));
        }
        if manifest.numerics != NUMERICS_VERSION {
            let expected = format!(
                "this program has numerics version {NUMERICS_VERSION}, and makes other worlds; use the version of the program that the \
                 manifest belongs to"
            );
            let value = format!("{name}, numerics {}", manifest.numerics);
            return Err(Error::invalid(Setting::Manifest, value, expected));
        }
        Ok(manifest)
    }

    /// Returns the manifest as TOML.
    pub fn to_toml(&self) -> String {
        // Strings and numbers can always be written as TOML.
        toml::to_string(self).unwrap_or_default()
    }

    /// Replaces the entry of a world. Digests of other kinds of processors are kept if truth and values agree.
    pub fn pin(&mut self, world: PinnedWorld) {
        match self.worlds.iter_mut().find(|w| w.name == world.name) {
            Some(old) => {
                let mut new = world;
                if !matches!(old.compare(&new), PinnedSameness::Different { .. }) {
                    let others = std::mem::take(&mut old.image_sha256);
                    new.samples.clone_from(&old.samples);
                    new.image_sha256 = others.into_iter().chain(new.image_sha256).collect();
                    new.contents.keep_others(std::mem::take(&mut old.contents));
                }
                *old = new;
            }
            None => self.worlds.push(world),
        }
    }
}

impl PinnedWorld {
    /// Computes the digests and values of a world, which must hold the image before noise.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a world without recipe, [`Error::Choice`] for a world without an image before noise; errors of the file,
    /// [`Error::Interrupted`].
    pub fn of(name: &str, world: &WorldFile, progress: &dyn Progress) -> Result<Self> {
        let m = world.metadata();
        let lacking = |what: &str| {
            Error::invalid(Setting::WorldFile, world.path().display(), format!("holds no {what}"))
        };
        let recipe = m.recipe.as_ref().ok_or_else(|| lacking("recipe"))?;
        world.need_clean()?;
        let checked = crate::recipe::Recipe::from_toml_str(name, recipe, None)?;
        Ok(PinnedWorld {
            name: name.to_owned(),
            material: checked.id.clone(),
            difficulty: checked.tier,
            seed: checked.seed,
            recipe_sha256: hex(Sha256::digest(recipe)),
            truth_sha256: truth(world)?,
            samples: samples(world)?,
            image_sha256: [(processor(), image(world, progress)?)].into(),
            contents: PinnedContents::of(world)?,
        })
    }

    /// Compares a released world with the digests and values of a file.
    pub fn compare(&self, found: &PinnedWorld) -> PinnedSameness {
        let mut what = Vec::new();
        let digests = [
            ("recipe", &self.recipe_sha256, &found.recipe_sha256),
            ("truth", &self.truth_sha256, &found.truth_sha256),
        ];
        what.extend(
            digests.iter().filter(|(_, a, b)| a != b).map(|(name, _, _)| (*name).to_owned()),
        );
        let brightest = self.samples.iter().fold(0.0_f64, |m, v| m.max(f64::from(v.abs())));
        let apart = |(a, b): (&f32, &f32)| f64::from((a - b).abs()) / brightest;
        let apart: Vec<f64> = self.samples.iter().zip(&found.samples).map(apart).collect();
        let difference = apart.iter().fold(0.0_f64, |m, d| m.max(*d));
        // NaN is not near.
        let near = apart.iter().all(|d| *d <= SAME);
        if self.samples.len() != found.samples.len() || !near {
            what.push(format!("image before noise, by {difference:.1e} of its brightest value"));
        }
        let known =
            |(kind, digest): (&String, &String)| self.image_sha256.get(kind).map(|d| d == digest);
        let whole = found.image_sha256.iter().find_map(known);
        if whole == Some(false) && near {
            what.push(
                "tiles, whose digest differs from the digest for this kind of processor".to_owned(),
            );
        }
        let contents = self.contents.compare(&found.contents);
        what.extend(contents.differs);
        let (compared, not_compared) = (contents.compared, contents.not_compared);
        let values = apart.len();
        match whole {
            _ if !what.is_empty() => PinnedSameness::Different { what },
            Some(_) => PinnedSameness::SameBytes { compared, not_compared },
            None => PinnedSameness::SameValues { difference, values, compared, not_compared },
        }
    }
}

/// Returns the digest of all lists of the truth, value by value.
fn truth(world: &WorldFile) -> Result<String> {
    let mut hash = Sha256::new();
    let pairs = |hash: &mut Sha256, pairs: &[[f32; 2]]| {
        pairs.iter().flatten().for_each(|v| hash.update(v.to_le_bytes()));
    };
    let text = |hash: &mut Sha256, text: &str| {
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    };
    world.for_each_chunk_of_sites(|_, sites| {
        pairs(&mut hash, &sites.positions);
        sites.z.iter().for_each(|v| hash.update(v.to_le_bytes()));
        for list in [&sites.types, &sites.numbers, &sites.columns] {
            list.iter().for_each(|v| hash.update(v.to_le_bytes()));
        }
        sites.defects.iter().for_each(|v| hash.update([u8::from(*v)]));
        sites.defect_names.iter().for_each(|name| text(&mut hash, name));
    })?;
    for column in world.columns()? {
        pairs(&mut hash, &[column.position_nm]);
        for n in [column.sites, column.vacancies, column.substitutions] {
            hash.update(n.to_le_bytes());
        }
        hash.update(column.composition.as_bytes());
    }
    for line in world.boundary_lines()? {
        pairs(&mut hash, &line.points_nm);
        text(&mut hash, &line.text);
    }
    world.phase_boundaries()?.iter().for_each(|line| pairs(&mut hash, line));
    world.phase_names()?.iter().for_each(|name| text(&mut hash, name));
    let [rows, columns] = world.shape();
    if let Some(map) = world.phase_map(0..rows, 0..columns)? {
        map.iter().for_each(|v| hash.update(v.to_le_bytes()));
    }
    let particles = world.particles()?;
    let numbers = particles.centres.iter().flatten().chain(&particles.diameters);
    let numbers = numbers.chain(particles.orientations.iter().flatten());
    numbers.for_each(|v| hash.update(v.to_le_bytes()));
    particles.morphologies.iter().for_each(|name| text(&mut hash, name));
    Ok(hex(hash.finalize()))
}

/// Returns the digest of all tiles of all detectors, with and before noise.
fn image(world: &WorldFile, progress: &dyn Progress) -> Result<String> {
    let mut hash = Sha256::new();
    let others = world.detectors().iter().skip(1).map(|d| world.on_detector(&d.name));
    let others = others.collect::<Result<Vec<_>>>()?;
    let [rows, columns] = world.metadata().grid_shape;
    progress.start("reading tiles", "tile", ((1 + others.len()) * rows * columns) as u64);
    for world in std::iter::once(world).chain(&others) {
        for (row, column) in (0..rows).flat_map(|r| (0..columns).map(move |c| (r, c))) {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            for tile in [world.tile(row, column)?, world.clean_tile(row, column)?] {
                tile.iter().for_each(|v| hash.update(v.to_le_bytes()));
            }
            progress.advance(1);
        }
    }
    progress.finish();
    Ok(hex(hash.finalize()))
}

/// Returns the values before noise at random places.
fn samples(world: &WorldFile) -> Result<Vec<f32>> {
    let m = world.metadata();
    let ([rows, columns], size) = (m.grid_shape, m.tile_size_px);
    let draw = |word: u32, n: usize| ((u64::from(word) * n as u64) >> 32) as usize;
    (0..SAMPLES)
        .map(|k| {
            let [a, b, c, d] = words(SEED, Purpose::Audit, 1 << 20, k as u64);
            let tile = world.clean_tile(draw(a, rows), draw(b, columns))?;
            Ok(tile[[draw(c, size), draw(d, size)]])
        })
        .collect()
}

fn hex(digest: impl AsRef<[u8]>) -> String {
    digest.as_ref().iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn world() -> PinnedWorld {
        PinnedWorld {
            name: "a_easy".into(),
            material: "a".into(),
            difficulty: Some(Difficulty::Easy),
            seed: 3,
            recipe_sha256: "r".into(),
            truth_sha256: "t".into(),
            samples: vec![0.5, 0.25],
            image_sha256: [("one".to_owned(), "i".to_owned())].into(),
            contents: PinnedContents::default(),
        }
    }

    #[test]
    fn what_differs_is_named() {
        let known = world();
        assert!(matches!(known.compare(&world()), PinnedSameness::SameBytes { .. }));
        let other = |change: &dyn Fn(&mut PinnedWorld)| {
            let mut found = world();
            change(&mut found);
            known.compare(&found)
        };
        let rounded = |w: &mut PinnedWorld| {
            w.samples[1] += 2e-6;
            w.image_sha256 = [("two".to_owned(), "j".to_owned())].into();
        };
        let PinnedSameness::SameValues { difference, values, .. } = other(&rounded) else {
            panic!()
        };
        assert!((difference - 4e-6).abs() < 1e-7 && values == 2);
        let named = |change: &dyn Fn(&mut PinnedWorld), word: &str| {
            let PinnedSameness::Different { what } = other(change) else { panic!("{word}") };
            assert!(what.len() == 1 && what[0].contains(word), "{what:?}");
        };
        named(&|w| w.image_sha256 = [("one".to_owned(), "j".to_owned())].into(), "tiles");
        named(&|w| w.truth_sha256 = "u".into(), "truth");
        named(&|w| w.recipe_sha256 = "u".into(), "recipe");
        named(&|w| w.samples[1] += 1e-5, "before noise, by 2.0e-5");
        named(&|w| w.samples[0] = f32::NAN, "before noise");
        named(&|w| w.samples.truncate(1), "before noise");
    }

    #[test]
    fn a_manifest_comes_back_and_others_are_refused() {
        let mut manifest = Manifest::empty();
        manifest.pin(world());
        let mut two = world();
        two.image_sha256 = [("two".to_owned(), "j".to_owned())].into();
        manifest.pin(two);
        assert_eq!(manifest.worlds.len(), 1);
        assert_eq!(manifest.worlds[0].image_sha256.len(), 2);
        let text = manifest.to_toml();
        assert_eq!(Manifest::from_toml("m.toml", &text).unwrap(), manifest);
        let mut changed = world();
        changed.truth_sha256 = "u".into();
        manifest.pin(changed.clone());
        assert_eq!(manifest.worlds, [changed]);
        let reply = |text: &str| Manifest::from_toml("m.toml", text).unwrap_err().to_string();
        let numerics = format!("numerics = {NUMERICS_VERSION}");
        assert!(reply(&text.replace(&numerics, "numerics = 1")).contains("numerics 1"));
        assert!(reply(&text.replacen("version = 1", "version = 9", 1)).contains("version 9"));
        assert!(reply(&text.replace("seed = 3", "seed = \"x\"")).contains("m.toml"));
        assert!(reply("nonsense").contains("m.toml"));
    }
}
