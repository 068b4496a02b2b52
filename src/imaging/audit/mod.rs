//! Audits: regions of a world simulated again, exactly, with the very same atoms.

pub mod region_audit;
