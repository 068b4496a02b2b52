//! Codes of `atom_types`, in world files and in files of atoms.

use crate::specimen::SiteKind;

/// The atom that belongs there.
pub const PRISTINE: i32 = 0;
/// No atom.
pub(crate) const VACANCY: i32 = 1;
/// Another element.
pub(crate) const SUBSTITUTION: i32 = 2;

/// Returns the code of a site.
pub fn code(kind: SiteKind) -> i32 {
    match kind {
        SiteKind::Pristine => PRISTINE,
        SiteKind::Vacancy => VACANCY,
        SiteKind::Substitution => SUBSTITUTION,
    }
}
