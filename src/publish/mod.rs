//! The card of a folder of worlds: its description for a data hub.
//!
//! `README.md` is for people, and its header for the hub. `croissant.json` is for programs: Croissant 1.1 with the fields of its RAI
//! vocabulary. Programs that read Croissant cannot read HDF5, so the lists of the truth are also written as CSV beside the worlds.

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
