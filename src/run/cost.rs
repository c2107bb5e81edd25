//! What a method costs, among its scores.

use crate::scores::Values;
use crate::scores::kinds::{MEMORY, SECONDS};

/// Adds the wall-clock seconds per cycle and, where it is known, the most memory held at one time \[bytes\].
pub(super) fn with_cost(mut values: Values, seconds: f64, bytes: Option<u64>) -> Values {
    values.insert(SECONDS.into(), seconds);
    values.extend(bytes.map(|bytes| (MEMORY.into(), bytes as f64)));
    values
}
