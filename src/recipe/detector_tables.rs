//! The table `[detector]`, or several `[[detector]]`: the annular detectors of a world.

use std::fmt;

use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize as DeriveDeserialize, Serialize};

use super::fault::{Checked, fault, within};
use crate::acquisition::{DetectorValues, Profile};
use crate::detect::Detector;

/// Name of a detector for which the recipe gives none.
const USUAL_NAME: &str = "HAADF";
/// Largest number of detectors in a recipe.
const MOST_DETECTORS: usize = 16;
/// Greatest length of a detector's name.
const LONGEST_NAME: usize = 32;
/// Largest number of angles in a response.
const MOST_ANGLES: usize = 1000;
/// Largest number of sectors of a detector, and of images of a recipe.
const MOST_SECTORS: usize = 16;
const MOST_IMAGES: usize = 64;
/// Largest angle of a detector in mrad, and least width.
const LARGEST_MRAD: f64 = 1000.0;
const LEAST_WIDTH_MRAD: f64 = 0.1;

/// One annular detector without a name.
#[derive(Debug, Clone, PartialEq, Serialize, DeriveDeserialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorTable {
    /// Inner angle in mrad.
    pub inner_mrad: f64,
    /// Outer angle in mrad.
    pub outer_mrad: f64,
    /// Share of the electrons that the detector counts at some angles, `[[mrad, share], ...]`; without it all electrons are counted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub response: Vec<[f64; 2]>,
}

/// One of several detectors: an annulus, its sectors, or its centre of mass.
#[derive(Debug, Clone, PartialEq, Serialize, DeriveDeserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedDetectorTable {
    /// Name of the detector, and of its images in files.
    pub name: String,
    /// Inner angle in mrad.
    pub inner_mrad: f64,
    /// Outer angle in mrad.
    pub outer_mrad: f64,
    /// Share of the electrons that the detector counts at some angles, `[[mrad, share], ...]`; without it all electrons are counted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub response: Vec<[f64; 2]>,
    /// Number of equal sectors into which the annulus is divided, each with an image: `NAME_0`, `NAME_1`, ...
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sectors: Option<usize>,
    /// Azimuth in degrees at which the first sector begins, from +x towards +y, which points down; 0 when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first_sector_deg: Option<f64>,
    /// Whether the detector gives the images `NAME_x` and `NAME_y` of the mean angle of its electrons in mrad.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub centre_of_mass: bool,
    /// Values of `[acquisition]` that recordings have on this detector, in place of the values of the recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acquisition: Option<DetectorValues>,
}

impl NamedDetectorTable {
    /// Number of images: each sector has one, a centre of mass two.
    fn images(&self) -> usize {
        if self.centre_of_mass { 2 } else { self.sectors.unwrap_or(1) }
    }

    fn detectors(&self) -> Vec<Detector> {
        let whole = Detector::new(&self.name, self.inner_mrad, self.outer_mrad);
        let whole = whole.with_response(self.response.clone());
        match self.sectors {
            None if self.centre_of_mass => vec![whole.with_centre_of_mass()],
            None => vec![whole],
            Some(sectors) => whole.divided(sectors, self.first_sector_deg.unwrap_or(0.0)),
        }
    }
}

/// The detectors of a recipe.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum DetectorTables {
    /// `[detector]`: one detector.
    One(DetectorTable),
    /// `[[detector]]`: several detectors, the main one first. All images come from one simulation.
    Several(Vec<NamedDetectorTable>),
}

impl DetectorTables {
    /// Makes one detector without a name.
    pub fn one(inner_mrad: f64, outer_mrad: f64) -> Self {
        DetectorTables::One(DetectorTable { inner_mrad, outer_mrad, response: Vec::new() })
    }

    /// Returns the detectors with their images, the main one first; at least one in a checked recipe. A centre of mass has two.
    pub fn all(&self) -> Vec<Detector> {
        self.asked().iter().flat_map(Detector::images).collect()
    }

    /// Returns the detectors that engines measure, the main one first. A centre of mass is measured by five.
    pub fn measured(&self) -> Vec<Detector> {
        self.asked().iter().flat_map(Detector::measured).collect()
    }

    /// Returns the detectors as they are asked for, the main one first.
    pub(crate) fn asked(&self) -> Vec<Detector> {
        match self {
            DetectorTables::One(d) => {
                let detector = Detector::new(USUAL_NAME, d.inner_mrad, d.outer_mrad);
                vec![detector.with_response(d.response.clone())]
            }
            DetectorTables::Several(tables) => {
                tables.iter().flat_map(NamedDetectorTable::detectors).collect()
            }
        }
    }

    /// Returns the number of images; each sector has one, a centre of mass two.
    pub fn count(&self) -> usize {
        match self {
            DetectorTables::One(_) => 1,
            DetectorTables::Several(tables) => tables.iter().map(NamedDetectorTable::images).sum(),
        }
    }

    /// Returns the name of the table of each image, and the values of its detector chain.
    pub(crate) fn tables_of_images(&self) -> Vec<(String, DetectorValues)> {
        let DetectorTables::Several(tables) = self else {
            return vec![(USUAL_NAME.to_owned(), DetectorValues::default())];
        };
        let of = |table: &NamedDetectorTable| {
            vec![(table.name.clone(), table.acquisition.unwrap_or_default()); table.images()]
        };
        tables.iter().flat_map(of).collect()
    }

    /// Returns the table with the main detector alone.
    #[must_use]
    pub(crate) fn main_alone(&self) -> Self {
        match self {
            DetectorTables::One(_) => self.clone(),
            DetectorTables::Several(tables) => {
                DetectorTables::Several(tables.iter().take(1).cloned().collect())
            }
        }
    }
}

impl<'de> Deserialize<'de> for DetectorTables {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(TableOrArray)
    }
}

/// Distinguishes a table from an array of tables, so that errors describe the form that was written.
struct TableOrArray;

impl<'de> Visitor<'de> for TableOrArray {
    type Value = DetectorTables;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        // Error messages replace the name of the type with the keys of the table.
        f.write_str("struct DetectorTable")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<DetectorTables, A::Error> {
        DetectorTable::deserialize(MapAccessDeserializer::new(map)).map(DetectorTables::One)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<DetectorTables, A::Error> {
        Vec::deserialize(SeqAccessDeserializer::new(list)).map(DetectorTables::Several)
    }
}

/// Checks the limits of names and angles.
pub(crate) fn check_detectors(detectors: &DetectorTables) -> Checked {
    let tables = match detectors {
        DetectorTables::One(d) => {
            within("detector.inner_mrad", d.inner_mrad, 0.0, LARGEST_MRAD)?;
            let least = d.inner_mrad + LEAST_WIDTH_MRAD;
            within("detector.outer_mrad", d.outer_mrad, least, LARGEST_MRAD)?;
            return check_response(&d.response);
        }
        DetectorTables::Several(tables) => tables,
    };
    if !(1..=MOST_DETECTORS).contains(&tables.len()) {
        let expected = format!(
            "expected 1 to {MOST_DETECTORS} tables [[detector]], each with name, inner_mrad and outer_mrad"
        );
        return fault("detector", format!("{} tables", tables.len()), expected);
    }
    for (n, table) in tables.iter().enumerate() {
        check_name(&table.name)?;
        let alike = |other: &&NamedDetectorTable| other.name.eq_ignore_ascii_case(&table.name);
        if let Some(other) = tables[..n].iter().find(alike) {
            let expected = format!(
                "each [[detector]] needs a different name, and `{}` is used already",
                other.name
            );
            return fault("detector.name", &table.name, expected);
        }
        let (inner, outer) = (table.inner_mrad, table.outer_mrad);
        let wide = outer >= inner + LEAST_WIDTH_MRAD;
        if !(0.0..=LARGEST_MRAD).contains(&inner) || !wide || outer > LARGEST_MRAD {
            let value = format!("{}: {inner} to {outer} mrad", table.name);
            let expected = format!(
                "expected 0 <= inner_mrad < outer_mrad <= {LARGEST_MRAD}, at least {LEAST_WIDTH_MRAD} mrad apart"
            );
            return fault("detector", value, expected);
        }
        check_response(&table.response)?;
        check_sectors(n, table)?;
        check_centre_of_mass(n, table)?;
        check_values(n, table)?;
    }
    check_names(tables)
}

/// Checks the number of sectors and their first azimuth.
fn check_sectors(n: usize, table: &NamedDetectorTable) -> Checked {
    let Some(sectors) = table.sectors else {
        return match table.first_sector_deg {
            None => Ok(()),
            Some(_) => {
                fault("detector.first_sector_deg", "(given)", "expected it beside `sectors`")
            }
        };
    };
    if n == 0 {
        let expected = "the first detector is the main one, whose image overviews and agents see; expected a whole annulus, and sectors of later ones";
        return fault("detector.sectors", sectors, expected);
    }
    if !(2..=MOST_SECTORS).contains(&sectors) {
        return fault("detector.sectors", sectors, format!("expected 2 to {MOST_SECTORS} sectors"));
    }
    within("detector.first_sector_deg", table.first_sector_deg.unwrap_or(0.0), -360.0, 360.0)
}

/// Checks that a centre of mass is of a whole annulus, and not the main image.
fn check_centre_of_mass(n: usize, table: &NamedDetectorTable) -> Checked {
    let expected = match (n, table.sectors) {
        _ if !table.centre_of_mass => return Ok(()),
        (0, _) => {
            "the first detector is the main one, whose image overviews and agents see; expected electrons there, and a centre of mass later"
        }
        (_, Some(_)) => "a centre of mass is of a whole annulus; leave `sectors` out",
        (_, None) => return Ok(()),
    };
    fault("detector.centre_of_mass", true, expected)
}

/// Checks the values of a detector chain.
fn check_values(n: usize, table: &NamedDetectorTable) -> Checked {
    let Some(values) = table.acquisition else { return Ok(()) };
    let expected = match (n, table.centre_of_mass) {
        (0, _) => "the first detector has the values of the table [acquisition]; set them there",
        (_, true) => {
            "the camera of a centre of mass counts single electrons, without the values of [acquisition]; leave the table out"
        }
        _ => {
            let all = values.over(&Profile::Ideal.acquisition());
            return all.check().map_err(|fault| fault.in_table("detector.acquisition"));
        }
    };
    fault("detector.acquisition", "(given)", expected)
}

/// Checks that all images together have different names, and are not too many.
fn check_names(tables: &[NamedDetectorTable]) -> Checked {
    let names: Vec<String> = tables
        .iter()
        .flat_map(NamedDetectorTable::detectors)
        .flat_map(|d| d.images())
        .map(|d| d.name.to_ascii_lowercase())
        .collect();
    if names.len() > MOST_IMAGES {
        let expected = format!(
            "expected at most {MOST_IMAGES} images of detectors, sectors and centres of mass together"
        );
        return fault("detector", format!("{} images", names.len()), expected);
    }
    match names.iter().enumerate().find(|(n, name)| names[..*n].contains(name)) {
        None => Ok(()),
        Some((_, name)) => {
            let expected = "a sector or a centre of mass would have the name of another detector; rename one of the two";
            fault("detector.name", name, expected)
        }
    }
}

/// Checks that angles rise, that shares lie between 0 and 1, and that some electrons are counted.
fn check_response(response: &[[f64; 2]]) -> Checked {
    let angles = response.iter().all(|[angle, _]| (0.0..=LARGEST_MRAD).contains(angle));
    let shares = response.iter().all(|[_, share]| (0.0..=1.0).contains(share));
    let rising = response.windows(2).all(|w| w[0][0] < w[1][0]);
    let some = response.is_empty() || response.iter().any(|[_, share]| *share > 0.0);
    if angles && shares && rising && some && response.len() <= MOST_ANGLES {
        return Ok(());
    }
    let expected = format!(
        "expected at most {MOST_ANGLES} pairs [mrad, share] of rising angles up to {LARGEST_MRAD} mrad, with shares from 0 to 1 that \
         are not all 0"
    );
    fault("detector.response", format!("{response:?}"), expected)
}

/// Checks a name, which becomes the name of a group in files.
fn check_name(name: &str) -> Checked {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    let begins = name.starts_with(|c: char| c.is_ascii_alphanumeric());
    match begins && name.len() <= LONGEST_NAME && name.chars().all(plain) {
        true => Ok(()),
        false => fault(
            "detector.name",
            format!("{name:?}"),
            format!(
                "expected at most {LONGEST_NAME} letters, digits, `_`, `-` and `.`, a letter or digit first, such as \"ABF\""
            ),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recipe::{Difficulty, Override, Recipe};

    fn with(value: &str) -> crate::Result<Recipe> {
        let change: Override = format!("detector={value}").parse()?;
        let recipe = Recipe::load("srtio3", Difficulty::Easy)?.with_overrides(&[change])?;
        Ok(recipe.checked()?.recipe().clone())
    }

    const TWO: &str = "[{name=\"HAADF\",inner_mrad=68,outer_mrad=200},{name=\"ABF\",inner_mrad=10,outer_mrad=21}]";

    #[test]
    fn a_table_stays_a_table_and_an_array_an_array() {
        let one = Recipe::load("srtio3", Difficulty::Easy).unwrap();
        assert_eq!(one.detector.all(), [Detector::new("HAADF", 68.0, 200.0)]);
        assert!(one.to_toml().contains("\n[detector]\ninner_mrad = 68.0\nouter_mrad = 200.0\n"));
        let two = with(TWO).unwrap();
        let expected = [Detector::new("HAADF", 68.0, 200.0), Detector::new("ABF", 10.0, 21.0)];
        assert_eq!(two.detector.all(), expected);
        assert!(two.to_toml().contains("[[detector]]\nname = \"ABF\""), "{}", two.to_toml());
        assert_eq!(Recipe::from_toml_str("copy", &two.to_toml(), None).unwrap(), two);
        assert_eq!(two.detector.main_alone().all(), expected[..1]);
    }

    #[test]
    fn sectors_are_detectors_of_their_own() {
        let sectors = TWO.replace("outer_mrad=21", "outer_mrad=21,sectors=4,first_sector_deg=45");
        let recipe = with(&sectors).unwrap();
        let all = recipe.detector.all();
        assert_eq!((all.len(), recipe.detector.count()), (5, 5));
        assert_eq!((all[4].name.as_str(), all[4].sector_degrees), ("ABF_3", Some([315.0, 405.0])));
        assert_eq!(recipe.detector.main_alone().count(), 1);
        assert_eq!(Recipe::from_toml_str("copy", &recipe.to_toml(), None).unwrap(), recipe);
        for (value, part) in [
            (sectors.replace("=4", "=1"), "expected 2 to 16 sectors"),
            (sectors.replace("sectors=4,", ""), "beside `sectors`"),
            (sectors.replace("=45", "=900"), "first_sector_deg"),
            (TWO.replace("200}", "200,sectors=4}"), "the first detector is the main one"),
            (sectors.replace("\"HAADF\"", "\"abf_1\""), "the name of another detector"),
        ] {
            let message = with(&value).unwrap_err().to_string();
            assert!(message.contains(part), "{value}: {message}");
        }
    }

    #[test]
    fn a_centre_of_mass_has_two_images() {
        let com = TWO.replace("outer_mrad=21", "outer_mrad=21,centre_of_mass=true");
        let recipe = with(&com).unwrap();
        let (all, measured) = (recipe.detector.all(), recipe.detector.measured());
        let names: Vec<&str> = all.iter().map(|d| d.name.as_str()).collect();
        assert_eq!((names, recipe.detector.count()), (vec!["HAADF", "ABF_x", "ABF_y"], 3));
        assert_eq!((measured.len(), all[2].units()), (6, "mrad"));
        assert_eq!(Recipe::from_toml_str("copy", &recipe.to_toml(), None).unwrap(), recipe);
        for (value, part) in [
            (com.replace("=true", "=true,sectors=4"), "leave `sectors` out"),
            (TWO.replace("200}", "200,centre_of_mass=true}"), "the first detector is the main one"),
            (com.replace("\"HAADF\"", "\"abf_y\""), "the name of another detector"),
        ] {
            let message = with(&value).unwrap_err().to_string();
            assert!(message.contains(part), "{value}: {message}");
        }
        assert!(!with(TWO).unwrap().to_toml().contains("centre_of_mass"));
    }

    #[test]
    fn later_detectors_may_have_a_chain_of_their_own() {
        let own = |values: &str| {
            TWO.replace("outer_mrad=21", &format!("outer_mrad=21,acquisition={values}"))
        };
        let recipe = with(&own("{gain_counts=2.0,bits=8}")).unwrap();
        let values = recipe.detector.tables_of_images()[1].1;
        assert_eq!((values.gain_counts, values.bits, values.dqe), (Some(2.0), Some(8), None));
        assert_eq!(Recipe::from_toml_str("copy", &recipe.to_toml(), None).unwrap(), recipe);
        assert_eq!(recipe.detector.measured(), with(TWO).unwrap().detector.measured());
        for (value, part) in [
            (own("{bits=9}"), "detector.acquisition.bits"),
            (own("{frames=2}"), "unknown key `frames`"),
            (TWO.replace("200}", "200,acquisition={bits=8}}"), "values of the table [acquisition]"),
            (own("{bits=8},centre_of_mass=true"), "counts single electrons"),
        ] {
            let message = with(&value).unwrap_err().to_string();
            assert!(message.contains(part), "{value}: {message}");
        }
    }

    #[test]
    fn what_is_no_set_of_detectors_is_refused() {
        let named = |name: &str, inner: f64, outer: f64| {
            format!("{{name=\"{name}\",inner_mrad={inner:?},outer_mrad={outer:?}}}")
        };
        let haadf = named("HAADF", 68.0, 200.0);
        for (value, parts) in [
            ("[]".to_owned(), vec!["0 tables", "expected 1 to 16 tables [[detector]]"]),
            (format!("[{haadf},{haadf}]"), vec!["needs a different name", "`HAADF`"]),
            (format!("[{haadf},{}]", named("haadf", 30.0, 60.0)), vec!["needs a different name"]),
            (
                format!("[{haadf},{}]", named("ABF", 21.0, 10.0)),
                vec!["ABF: 21 to 10 mrad", "inner_mrad < outer_mrad"],
            ),
            (format!("[{}]", named("a/b", 21.0, 30.0)), vec!["a/b", "letters, digits"]),
            (format!("[{}]", named("..", 21.0, 30.0)), vec!["a letter or digit first"]),
            (format!("[{}]", named("x", -1.0, 30.0)), vec!["x: -1 to 30 mrad"]),
            ("[{inner_mrad=68,outer_mrad=200}]".to_owned(), vec!["missing field `name`"]),
            (
                "[{name=\"a\",inner_mrad=68,outer=200}]".to_owned(),
                vec!["did you mean `outer_mrad`?"],
            ),
            ("{inner_mrad=68,outer=200}".to_owned(), vec!["did you mean `outer_mrad`?"]),
            ("3".to_owned(), vec!["a table with the keys inner_mrad, outer_mrad", "[[detector]]"]),
            ("[3]".to_owned(), vec!["a table with the keys name, inner_mrad, outer_mrad"]),
        ] {
            let message = with(&value).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{value}: no `{part}` in {message}");
            }
        }
    }

    #[test]
    fn a_tier_may_have_other_detectors_than_the_base() {
        let text = Recipe::load("test", None).unwrap().to_toml();
        let tiered = format!(
            "{text}\n[[difficulty.easy.detector]]\nname = \"ABF\"\ninner_mrad = 10.0\nouter_mrad = 21.0\n"
        );
        let recipe = Recipe::from_toml_str("tiered.toml", &tiered, Some(Difficulty::Easy)).unwrap();
        assert_eq!(recipe.detector.all(), [Detector::new("ABF", 10.0, 21.0)]);
    }
}
