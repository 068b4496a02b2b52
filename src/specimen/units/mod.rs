//! Units: columns that share one simulation with equal units, and the defects that each of them holds.

pub mod binomial;
pub mod known_tags;
pub mod library_cell;
pub mod occupation;
pub mod patterns;
pub mod unit_kinds;
pub mod unit_tag;
