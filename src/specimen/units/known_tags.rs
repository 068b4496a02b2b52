//! Tags of units that were computed before.

use std::collections::HashMap;

use super::unit_tag::UnitTag;
use crate::specimen::column_index::ColumnIndex;

/// The tags of the units so far: all columns of a unit have the same tag except for their member number.
#[derive(Default)]
pub(crate) struct KnownTags(HashMap<u64, Option<UnitTag>>);

impl KnownTags {
    /// Returns the tag of column `member` of the unit that is named by its `first` column; `make` computes the tag of any member.
    pub(crate) fn get(
        &mut self,
        (first, member): (ColumnIndex, usize),
        make: impl FnOnce() -> Option<UnitTag>,
    ) -> Option<UnitTag> {
        let tag = *self.0.entry(first.id()).or_insert_with(make);
        tag.map(|tag| UnitTag { member, ..tag })
    }
}
