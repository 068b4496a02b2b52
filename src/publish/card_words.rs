//! Describes the data from their files, in sentences: their origin, their uses and their limits.
//!
//! Every statement follows from the files.

use std::collections::BTreeSet;

use super::card_world::CardWorld;

/// Counts from writing the tables.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct DefectShare {
    /// Number of atomic columns in all worlds.
    pub(super) columns: usize,
    /// Number of columns with a vacancy or a substitution.
    pub(super) with_defects: usize,
}

/// The sentences of a card.
pub(super) struct CardWords {
    /// Summary of the data.
    pub(super) summary: String,
    /// Origin of the data.
    pub(super) collection: String,
    /// Places of missing values.
    pub(super) missing: String,
    /// Raw data.
    pub(super) raw: String,
    /// Processing of the values.
    pub(super) preprocessing: Vec<String>,
    /// Origin of the labels.
    pub(super) annotation: String,
    /// Biases: what the data over-represent.
    pub(super) biases: Vec<String>,
    /// Limits: contents that are missing, and uses that are not intended.
    pub(super) limitations: Vec<String>,
    /// Intended uses.
    pub(super) uses: Vec<String>,
    /// Statement about personal data.
    pub(super) personal: String,
    /// Possible effects on people.
    pub(super) social: String,
    /// How the data can be made again.
    pub(super) maintenance: String,
    /// Programs that made the labels.
    pub(super) tools: Vec<String>,
    /// Whether all images are known to be simulated.
    pub(super) all_simulated: bool,
}

impl CardWords {
    pub(super) fn of(worlds: &[CardWorld], share: DefectShare) -> Self {
        let all_simulated = worlds.iter().all(CardWorld::is_ours);
        CardWords {
            summary: summary(worlds),
            collection: collection(worlds),
            missing: "Pixels that hold no data are false in /valid_region of each file. Attributes that a file does \
                      not tell are empty cells in the tables."
                .into(),
            raw: raw(worlds),
            preprocessing: preprocessing(worlds),
            annotation: "Labels are the list of atoms that each image was simulated from, with every vacancy and \
                         substitution. Nobody labelled anything by hand or by eye: labels have no errors of \
                         observers, and also name defects that the noise hides."
                .into(),
            biases: biases(worlds, share),
            limitations: limitations(worlds),
            uses: uses(worlds),
            personal: "None: the data show crystals and particles, and nothing of people.".into(),
            social: "None is known: the data show materials. Who trusts a model that was trained on simulated images \
                     alone should test it on recorded ones first."
                .into(),
            maintenance: maintenance(worlds),
            tools: versions(worlds),
            all_simulated,
        }
    }
}

/// Returns the different texts in alphabetical order.
fn distinct(worlds: &[CardWorld], text: impl Fn(&CardWorld) -> Option<String>) -> Vec<String> {
    worlds.iter().filter_map(text).collect::<BTreeSet<_>>().into_iter().collect()
}

/// Returns the names of the worlds that fulfil a condition.
fn named(worlds: &[CardWorld], which: impl Fn(&CardWorld) -> bool) -> Option<String> {
    let names: Vec<&str> = worlds.iter().filter(|w| which(w)).map(|w| w.name.as_str()).collect();
    match names.len() {
        0 => None,
        n if n == worlds.len() => Some("all worlds".into()),
        _ => Some(names.join(", ")),
    }
}

/// Writes a range: `4`, or `4 to 16`.
fn range(values: impl Iterator<Item = f64>, digits: impl Fn(f64) -> String) -> Option<String> {
    let values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let least = values.iter().copied().reduce(f64::min)?;
    let most = values.iter().copied().reduce(f64::max)?;
    Some(match least < most {
        true => format!("{} to {}", digits(least), digits(most)),
        false => digits(least),
    })
}

fn plain(value: f64) -> String {
    value.to_string()
}

pub(super) fn counted(n: usize, one: &str, many: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { many })
}

fn materials(worlds: &[CardWorld]) -> Vec<String> {
    distinct(worlds, |w| w.facts.material.clone())
}

fn versions(worlds: &[CardWorld]) -> Vec<String> {
    distinct(worlds, |w| w.facts.stemgen_version.as_ref().map(|v| format!("stemgen {v}")))
}

fn summary(worlds: &[CardWorld]) -> String {
    let tiles: usize = worlds.iter().map(|w| w.facts.tiles[0] * w.facts.tiles[1]).sum();
    let kind = match worlds.iter().all(CardWorld::is_ours) {
        true => "simulated ",
        false => "",
    };
    let of = match materials(worlds) {
        names if names.is_empty() => String::new(),
        names => format!(" of {}", names.join(", ")),
    };
    format!(
        "{} ({}): {kind}scanning transmission electron microscopy (STEM) images{of}. Each world is one HDF5 file with the \
         image of a whole specimen and the truth about each of its atoms.",
        counted(worlds.len(), "world", "worlds"),
        counted(tiles, "tile", "tiles")
    )
}

fn collection(worlds: &[CardWorld]) -> String {
    let mut text = Vec::new();
    if worlds.iter().any(CardWorld::is_ours) {
        let engines = distinct(worlds, |w| w.facts.engine.clone()).join(", ");
        text.push(format!(
            "The images were simulated by {} (engines: {engines}); no microscope recorded them. A recipe and a seed decide \
             where every atom is; electrons are propagated through these atoms, and averaged over configurations of \
             their thermal displacements.",
            versions(worlds).join(", ")
        ));
    }
    if let Some(other) = named(worlds, |w| !w.is_ours()) {
        text.push(format!("The files do not tell how these were made: {other}."));
    }
    text.join(" ")
}

fn raw(worlds: &[CardWorld]) -> String {
    match named(worlds, |w| w.recipe.is_some()) {
        Some(which) => format!(
            "There are no raw recordings. The attribute `recipe` of each file holds every value that decides its specimen and its \
             image; it names a crystal that comes with stemgen, or holds one ({which})."
        ),
        None => "The files do not tell.".into(),
    }
}

fn preprocessing(worlds: &[CardWorld]) -> Vec<String> {
    let mut text = vec![
        "Tiles are scaled linearly; where a file gives `scale` and `offset`, value * scale + offset is the fraction of the \
         incident beam."
            .to_owned(),
    ];
    let noisy = |w: &&CardWorld| w.facts.noise == Some(true);
    let doses = worlds.iter().filter(noisy).filter_map(|w| w.facts.dose_electrons_per_angstrom2);
    if let (Some(doses), Some(which)) = (range(doses, plain), named(worlds, |w| noisy(&w))) {
        text.push(format!(
            "Tiles hold the counting noise of {doses} electrons per square Angstrom ({which})."
        ));
    }
    if let Some(which) = named(worlds, |w| w.facts.recording.is_some()) {
        text.push(format!(
            "Scan errors and the noise of a detector were simulated too ({which}); the attribute `acquisition` says which."
        ));
    }
    if let Some(which) = named(worlds, |w| w.facts.noise == Some(false)) {
        text.push(format!("Tiles hold no noise ({which})."));
    }
    if let Some(which) = named(worlds, |w| w.facts.noise_free_image) {
        text.push(format!("The image before noise is in /clean ({which})."));
    }
    text
}

fn biases(worlds: &[CardWorld], share: DefectShare) -> Vec<String> {
    let mut text = Vec::new();
    if share.columns > 0 {
        let percent = 100.0 * share.with_defects as f64 / share.columns as f64;
        text.push(format!(
            "{} of {} columns ({percent:.2} %) hold a vacancy or a substitution.",
            share.with_defects, share.columns
        ));
    }
    let axes = distinct(worlds, |w| {
        let axis = w.facts.zone_axis.as_ref().filter(|axis| *axis != "none");
        Some(format!("{} along {}", w.facts.material.as_ref()?, axis?))
    });
    if !axes.is_empty() {
        text.push(format!("Crystals are seen in one direction each: {}.", axes.join(", ")));
    }
    let probes = distinct(worlds, probe);
    if probes.len() == 1 {
        text.push(format!("Every world has the same probe: {}.", probes[0]));
    }
    let gathered = worlds.iter().filter_map(|w| w.recipe.as_ref()?.vacancies.as_ref());
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let (clustered, gathered): (Vec<_>, Vec<_>) =
        gathered.filter(|v| v.cluster_fraction > 0.0).partition(|v| v.clusters > 0);
    if let Some(count) = range(clustered.iter().map(|v| v.clusters as f64), |n| n.to_string()) {
        let share =
            range(clustered.iter().map(|v| v.cluster_fraction), percent).unwrap_or_default();
        text.push(format!("Vacancies gather in clusters by construction: {share} of them, in {count} clusters a field."));
    }
    let gathered = gathered.into_iter().map(|v| v.cluster_fraction);
    if let Some(gathered) = range(gathered, percent) {
        text.push(format!(
            "Vacancies gather about boundaries by construction: {gathered} of them, where a recipe has boundaries."
        ));
    }
    if let Some(which) = named(worlds, |w| w.facts.engine.as_deref() == Some("mosaic")) {
        text.push(format!(
            "Columns with the same atoms and the same neighbours may share one simulation before noise, also between worlds of one \
             material ({which}). Tiles are therefore less independent than their number says; test on another \
             material, difficulty or seed than the one trained on."
        ));
    }
    text
}

/// Describes the probe: `200 keV, 21 mrad`.
pub(super) fn probe(world: &CardWorld) -> Option<String> {
    let (energy, angle) = (world.facts.energy_kev?, world.facts.convergence_mrad?);
    Some(format!("{energy} keV, {angle} mrad"))
}

fn limitations(worlds: &[CardWorld]) -> Vec<String> {
    let mut text = Vec::new();
    if worlds.iter().any(CardWorld::is_ours) {
        text.push(
            "There is no inelastic scattering besides thermal motion, and potentials are those of free atoms: no \
             bonding, no charge."
                .to_owned(),
        );
        text.push(
            "Atoms vibrate independently of each other (frozen phonons, Einstein model)."
                .to_owned(),
        );
    }
    let configurations =
        worlds.iter().filter_map(|w| w.facts.phonon_configurations).map(|n| n as f64);
    if let Some(n) = range(configurations, plain) {
        text.push(format!("Phonon configurations that each image is the mean of: {n}."));
    }
    if let Some(which) = named(worlds, |w| w.is_ours() && w.facts.recording.is_none()) {
        text.push(format!(
            "The scan is perfect: no drift, no jitter, no distortion, and a detector that counts single electrons ({which})."
        ));
    }
    if let Some(which) = named(worlds, |w| w.recipe.as_ref().is_some_and(|r| r.surface.is_none())) {
        text.push(format!("No amorphous layer lies on the surfaces of the specimen ({which})."));
    }
    let thickness = worlds.iter().filter_map(|w| w.facts.thickness_nm);
    if let Some(nm) = range(thickness, |nm| format!("{nm:.1}")) {
        text.push(format!(
            "Specimens are {nm} nm thick, each the same everywhere but for particles."
        ));
    }
    let errors = worlds.iter().filter_map(|w| Some(w.facts.audit.as_ref()?.bright_rms_percent));
    if let Some(percent) = range(errors, |p| format!("{p:.2}")) {
        text.push(format!(
            "Error of the simulation against multislice without shortcuts, by audits of random regions: {percent} % rms at \
             bright columns."
        ));
    }
    if let Some(which) = named(worlds, |w| w.is_ours() && w.facts.audit.is_none()) {
        text.push(format!(
            "No audit is recorded in the file, so its error is not known ({which})."
        ));
    }
    if let Some(which) = named(worlds, |w| !w.is_ours()) {
        text.push(format!("How these were made, and how right they are, is not known: {which}."));
    }
    text.push(
        "Not for: concentrations or structures of real specimens, or the calibration of a real microscope.".to_owned(),
    );
    text
}

fn uses(worlds: &[CardWorld]) -> Vec<String> {
    let mut text = vec![
        "Training and testing of programs that find atomic columns, vacancies and substitutions, and that tell phases and \
         grains apart."
            .to_owned(),
        "Tests of microscopes that decide by themselves where to look, with a known truth.".to_owned(),
        "Checks of an analysis of images against a known answer.".to_owned(),
    ];
    let replay = |w: &CardWorld| w.facts.source.as_deref() == Some("synthetic_replay");
    if let Some(which) = named(worlds, replay) {
        text.push(format!(
            "Held out, not for training: {which} (to be played back in place of a recording)."
        ));
    }
    text
}

fn maintenance(worlds: &[CardWorld]) -> String {
    let again = match named(worlds, |w| w.command.is_some() && w.note.is_none()) {
        Some(which) => format!(
            " The column `command` of worlds.csv has the command that makes a world again, to the byte with the same version of \
             the numerics on the same kind of processor ({which})."
        ),
        None => String::new(),
    };
    format!("A change of any file changes its SHA-256 in croissant.json and worlds.csv.{again}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_numbers_are_read_aloud() {
        assert_eq!(range([4.0, 16.0, 8.0].into_iter(), plain).unwrap(), "4 to 16");
        assert_eq!(range([0.5, 0.5].into_iter(), plain).unwrap(), "0.5");
        assert_eq!(range([f64::NAN].into_iter(), plain), None);
        assert_eq!(counted(1, "tile", "tiles") + &counted(2, "", "s"), "1 tile2 s");
    }
}
