//! The detectors of a recording.

use crate::acquisition::{Acquisition, DetectorValues};
use crate::detect::{ShownImage, shown_images};
use crate::error::{Error, Result};
use crate::recipe::{CheckedRecipe, Recipe};
use crate::setting::Setting;

/// An image of a recording: an annulus, a sector, or an axis of a centre of mass.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RecordedDetector {
    /// The detector, and the measured images that it needs.
    pub shown: ShownImage,
    /// Values of its detector chain.
    pub values: DetectorValues,
}

impl RecordedDetector {
    /// The settings of the recording on this detector.
    pub fn settings(&self, base: &Acquisition) -> Acquisition {
        self.values.over(base)
    }

    /// The numbers of the measured images that it needs.
    pub fn measured(&self) -> Vec<usize> {
        self.shown.parts().map_or(vec![self.shown.number], |parts| parts.to_vec())
    }
}

/// Returns the images of a recording of all detectors of a recipe, or of those that `names` lists: names of tables, of sectors, or of axes of
/// a centre of mass. Their order is the order of the recipe.
///
/// # Errors
/// [`Error::Invalid`] for an unknown name, or no name.
pub(crate) fn recorded_detectors(
    recipe: &Recipe,
    names: Option<&[String]>,
) -> Result<Vec<RecordedDetector>> {
    let shown = shown_images(&recipe.detector.measured());
    let tables = recipe.detector.tables_of_images();
    let all = shown.into_iter().zip(tables);
    let Some(names) = names else {
        return Ok(all.map(|(shown, (_, values))| RecordedDetector { shown, values }).collect());
    };
    let (mut known, mut found) = (Vec::new(), Vec::new());
    for (shown, (table, values)) in all {
        let own = [table, shown.detector.name.clone()];
        if names.iter().any(|name| own.contains(name)) {
            found.push(RecordedDetector { shown, values });
        }
        for name in own {
            if !known.contains(&name) {
                known.push(name);
            }
        }
    }
    let unknown = names.iter().find(|name| !known.contains(name));
    let unknown = unknown.map(String::as_str).or(names.is_empty().then_some("none"));
    match unknown {
        None => Ok(found),
        Some(name) => {
            let expected = format!("the recipe has {}", known.join(", "));
            Err(Error::invalid(Setting::DetectorName, name, expected))
        }
    }
}

/// Whether the main detector is recorded alone.
pub(crate) fn is_main_alone(detectors: &[RecordedDetector]) -> bool {
    matches!(detectors, [one] if one.shown.number == 0)
}

/// Returns a recipe without the detectors that a recording of the main detector alone does not need.
///
/// # Errors
/// Errors of the recipe.
pub(crate) fn recorded_recipe(
    recipe: Recipe,
    detectors: &[RecordedDetector],
) -> Result<CheckedRecipe> {
    match is_main_alone(detectors) {
        true => Recipe { detector: recipe.detector.main_alone(), ..recipe }.checked(),
        false => recipe.checked(),
    }
}

/// Refuses carbon on a recording of other detectors than the main one.
///
/// # Errors
/// [`Error::Invalid`], with the name of the main detector.
pub(crate) fn check_carbon(detectors: &[RecordedDetector], recipe: &Recipe) -> Result<()> {
    if is_main_alone(detectors) {
        return Ok(());
    }
    let names: Vec<&str> = detectors.iter().map(|d| d.shown.detector.name.as_str()).collect();
    let main = recipe.detector.all().into_iter().next().map_or(String::new(), |d| d.name);
    let expected = format!(
        "carbon is added to the image of the main detector alone: record {main} alone, or without contamination"
    );
    Err(Error::invalid(Setting::DetectorName, names.join(", "), expected))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recipe::Override;

    #[test]
    fn names_of_tables_and_of_images_choose_detectors() {
        let tables = "detector=[{name=\"H\",inner_mrad=50.0,outer_mrad=90.0},\
                      {name=\"S\",inner_mrad=45.0,outer_mrad=70.0,sectors=2,acquisition={gain_counts=2.0}},\
                      {name=\"C\",inner_mrad=0.0,outer_mrad=25.0,centre_of_mass=true}]";
        let change: Override = tables.parse().unwrap();
        let recipe = Recipe::load("test", None).unwrap().with_overrides(&[change]).unwrap();
        let chosen = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            recorded_detectors(&recipe, Some(&names))
        };
        let found = chosen(&["C_y", "S"]).unwrap();
        let names: Vec<&str> = found.iter().map(|one| &one.shown.detector.name[..]).collect();
        assert_eq!(names, ["S_0", "S_1", "C_y"]);
        assert_eq!((found[2].measured(), found[1].measured()), (vec![3, 5, 7], vec![2]));
        assert_eq!(found[0].values.gain_counts, Some(2.0));
        assert!(check_carbon(&found, &recipe).is_err() && !is_main_alone(&found));
        let main = chosen(&["H"]).unwrap();
        assert_eq!(recorded_recipe(recipe.clone(), &main).unwrap().detector.count(), 1);
        assert_eq!(recorded_detectors(&recipe, None).unwrap().len(), 5);
        for (names, part) in
            [(&["BF"][..], "the recipe has H, S, S_0, S_1, C, C_x, C_y"), (&[], "none")]
        {
            let message = chosen(names).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
