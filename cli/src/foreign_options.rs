//! What other programs have and this one has not, and what comes nearest.

use clap::error::{ContextKind, ContextValue, ErrorKind};

/// Words of options and detectors, and what to say of them.
const NOT_OFFERED: [(&[&str], &str); 5] = [
    (
        &["4d", "4dstem", "4d-stem", "pixelated", "cbed", "diffraction", "ptychography"],
        "diffraction patterns (4D-STEM, CBED) are not offered; several annuli in one run, such as --detector a=0-10 \
         --detector b=10-20, come nearest, and --plane-wave gives exit waves",
    ),
    (
        &["segmented", "segments", "dpc", "idpc", "com", "icom", "quadrant", "df4"],
        "segmented detectors, DPC and centre of mass are not offered; annular detectors of any angles are (--detector \
         NAME=IN-OUT)",
    ),
    (
        &["tilt", "mistilt", "beam-tilt"],
        "a tilt of beam or specimen is not offered; turn the atoms before (ASE: atoms.rotate), or take another --zone",
    ),
    (
        &["eels", "edx", "eds"],
        "spectra are not offered; HAADF images tell elements by their brightness, and the file holds the atoms",
    ),
    (
        &["gpu", "cuda", "device"],
        "there is no version for GPUs; --threads says how many processors compute",
    ),
];

/// What to say of an option or a detector that looks like one of those.
pub fn foreign_options(word: &str) -> Option<&'static str> {
    let word = word.trim_start_matches('-').to_ascii_lowercase().replace('_', "-");
    let word = word.split('=').next().unwrap_or_default();
    NOT_OFFERED.iter().find(|(words, _)| words.contains(&word)).map(|(_, advice)| *advice)
}

/// An error of the command line without advice that misleads, and with what is not offered.
pub fn advised(mut error: clap::Error) -> clap::Error {
    if error.kind() != ErrorKind::UnknownArgument {
        return error;
    }
    // "to pass '--dose' as a value, use '-- --dose'": nobody means that.
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
