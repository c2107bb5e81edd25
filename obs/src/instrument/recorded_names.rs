//! Names of recorded observations and of their reports.

use crate::observation_file::ObservationPlace;
use std::collections::HashMap;
use std::sync::Arc;

/// The reports that a file names, numbered in order of appearance.
#[derive(Default)]
pub(super) struct Reports<'a>(HashMap<&'a str, usize>);

impl<'a> Reports<'a> {
    /// The number of the report with this name; 0 if reports have no names.
    pub fn number(&mut self, name: Option<&'a str>) -> usize {
        let next = self.0.len();
        name.map_or(0, |name| *self.0.entry(name).or_insert(next))
    }
}

/// Names of observations without an identifier: their place. Several of one place, variable and cycle are several unless
/// they are equal.
#[derive(Default)]
pub(super) struct Nameless {
    /// By cycle, variable and place.
    seen: HashMap<(usize, usize, String), Vec<Named>>,
}

/// Value and standard deviation of an observation, as bits, and its name.
type Named = ([u64; 2], Arc<str>);

impl Nameless {
    /// The name of an observation of a cycle and a variable at a place, with a value and a standard deviation.
    pub fn platform(&mut self, cycle: usize, variable: usize, place: String, numbers: [f64; 2]) -> Arc<str> {
        let numbers = numbers.map(f64::to_bits);
        let seen = self.seen.entry((cycle, variable, place.clone())).or_default();
        if let Some((_, name)) = seen.iter().find(|(other, _)| *other == numbers) {
            return Arc::clone(name);
        }
        let name: Arc<str> =
            if seen.is_empty() { place.into() } else { format!("{place} ({})", seen.len() + 1).into() };
        seen.push((numbers, Arc::clone(&name)));
        name
    }
}

/// A place in words, by which an observation without a name is known; `on_plane` is its place there \[m\].
pub(super) fn words(place: ObservationPlace, on_plane: (f64, f64)) -> String {
    match place {
        ObservationPlace::Plane { .. } => format!("x {} m, y {} m", on_plane.0, on_plane.1),
        ObservationPlace::Geographic { latitude_deg, longitude_deg } => format!("{latitude_deg} N, {longitude_deg} E"),
        ObservationPlace::GridPoint { column, row } => format!("column {column}, row {row}"),
    }
}
