//! Advice for options and detectors of other programs: the equivalent in this program, or the nearest way.

use clap::error::{ContextKind, ContextValue, ErrorKind};

/// Names of options and detectors of other programs, with the advice for each.
const NOT_OFFERED: [(&[&str], &str); 7] = [
    (
        &["convergence", "convergence-angle", "convergence-mrad", "semiangle-cutoff"],
        "--semiangle MRAD of `stemgen simulate` and `stemgen patterns` sets the convergence semiangle; worlds: --set \
         optics.convergence_mrad=MRAD",
    ),
    (
        &["voltage", "kv", "ht", "energy-kv"],
        "--energy KV of `stemgen simulate` and `stemgen patterns` sets the accelerating voltage; worlds: --set optics.energy_kv=KV",
    ),
    (
        &["4d", "4dstem", "4d-stem", "pixelated", "cbed", "diffraction", "ptychography"],
        "`stemgen patterns` simulates diffraction patterns (4D-STEM, CBED), for a program of your own to reconstruct",
    ),
    (
        &["segmented", "segments", "dpc", "idpc", "com", "icom", "quadrant", "df4"],
        "--detector DPC=0-21:4@45 of `stemgen simulate` divides an annulus into four sectors, --detector COM=0-50:com gives images of \
         the centre of mass; its integral is computed from diffraction patterns: `stemgen patterns`, then `stemgen integrate FILE.emd \
         --com --icom`",
    ),
    (
        &["tilt", "mistilt", "beam-tilt"],
        "--tilt X,Y of `stemgen simulate` and `stemgen patterns` tilts the specimen (mrad, up to 20); worlds: --set \
         optics.mistilt_mrad=[X,Y]. For larger angles take another --zone, or rotate the atoms before (ASE: atoms.rotate)",
    ),
    (
        &["eels", "edx", "eds"],
        "the program simulates no spectra; HAADF images distinguish elements by their brightness, and the file lists the atoms",
    ),
    (
        &["gpu", "cuda", "device"],
        "the program does not use GPUs; --threads sets the number of processors",
    ),
];

/// Returns the advice for an option or a detector of another program.
pub fn foreign_options(word: &str) -> Option<&'static str> {
    let word = word.trim_start_matches('-').to_ascii_lowercase().replace('_', "-");
    let word = word.split('=').next().unwrap_or_default();
    NOT_OFFERED.iter().find(|(words, _)| words.contains(&word)).map(|(_, advice)| *advice)
}

/// Removes misleading advice from an error of the command line, and adds the advice for options of other programs.
pub fn advised(mut error: clap::Error) -> clap::Error {
    if error.kind() != ErrorKind::UnknownArgument {
        return error;
    }
    // clap suggests "to pass '--dose' as a value, use '-- --dose'", which is never the intention.
    error.remove(ContextKind::Suggested);
    let word = match error.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(word)) => word.clone(),
        _ => return error,
    };
    if let Some(advice) = foreign_options(&word) {
        let advice = vec![advice.into()];
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(advice));
        error.remove(ContextKind::SuggestedArg);
    }
    error
}
