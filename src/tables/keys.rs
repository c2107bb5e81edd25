//! Keys of a scenario, with what they may be and mean.

use super::{Cell, Table};
use crate::reference::KeyReference;

/// A row for each key.
pub fn table(keys: &[KeyReference]) -> Table {
    let row = |KeyReference { name, unit, allowed, default, meaning }: &KeyReference| {
        [name.as_str(), *unit, allowed, default, meaning].map(Cell::from).into()
    };
    Table::new(&["key", "unit", "value", "default", "meaning"], keys.iter().map(row).collect())
}
