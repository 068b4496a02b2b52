//! UnitKinds: columns that share one simulation with their like, and what each of them holds.

pub mod binomial;
pub mod known_tags;
pub mod library_cell;
pub mod occupation;
pub mod patterns;
pub mod unit_kinds;
pub mod unit_tag;
