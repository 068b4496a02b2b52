//! Units: columns that share one simulation with equal units, and the defects that each of them holds.

mod binomial;
pub(crate) mod known_tags;
pub(crate) mod library_cell;
pub(crate) mod occupation;
pub(crate) mod patterns;
pub(crate) mod unit_kinds;
pub(crate) mod unit_tag;
