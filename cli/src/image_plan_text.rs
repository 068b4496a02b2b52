//! The plan of recordings and tiles of a recipe as text.

use super::plan_text::{self, Lines};
use super::text;
use stemgen::world::ImagePlan;

/// Adds the simulations that the library lacks, memory and time.
pub fn add(plan: &ImagePlan, lines: &mut Lines) {
    match &plan.library {
        Some(library) if library.missing == 0 => {
            let images = text::count(library.images as u64);
            lines.add("library", format!("{images} images; none has to be simulated"));
        }
        Some(library) => {
            let [images, missing, probes] =
                [library.images, library.missing, library.missing_probes]
                    .map(|n| text::count(n as u64));
            let words = format!(
                "{images} images, {missing} of them to simulate first ({probes} probes); later runs find them in the cache"
            );
            lines.add("library", words);
        }
        None => lines.add("library", "none: pixels are simulated when they are needed"),
    }
    plan_text::costs(&plan.plan, lines);
}

/// Adds the last line of a plan.
pub fn output(path: &std::path::Path, lines: &mut Lines) {
    lines.add("output", format!("{} (nothing was simulated or written)", path.display()));
}
