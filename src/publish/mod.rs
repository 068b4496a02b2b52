//! The card of a folder of worlds: what a data hub shows and reads of it.
//!
//! `README.md` is for people, and its head for the hub. `croissant.json` is for programs: Croissant 1.1 with the fields of its
//! RAI vocabulary. Programs that read Croissant read no HDF5, so what the truth lists lies beside the worlds as CSV.

mod card_about;
mod card_croissant;
mod card_markdown;
mod card_readme;
mod card_tables;
mod card_words;
mod card_world;
mod card_writer;

pub use card_about::{CardAbout, DataCreator, DataLicense};
pub use card_world::{CardPictures, CardWorld};
pub use card_writer::{Card, CardFile, CardSummary};
