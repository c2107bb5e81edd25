//! Tables of candidates, those with the largest reduction of the variance first.

use super::advised::Advised;
use super::candidates::{Candidate, Kind};
use crate::plot;
use crate::tables::{Cell, Table};

/// A table for each kind of candidate that there is, with its title and the number of its candidates: the first `most` of
/// them.
pub fn tables(advised: &Advised, most: usize) -> Vec<(&'static str, usize, Table)> {
    let table = |kind: Kind| {
        let all: Vec<&Candidate> = advised.candidates.iter().filter(|it| it.kind == kind).collect();
        let with_place = all.iter().any(|it| it.x_m.is_some());
        let unit = plot::unit(&advised.unit);
        let places = ["x\n[km]", "y\n[km]"].into_iter().filter(|_| with_place).map(String::from);
        let header = std::iter::once("candidate".to_string()).chain(places);
        let header = header.chain(["variance\ntaken off".to_string(), format!("σ with it\n[{unit}]")]);
        let row = |it: &&Candidate| {
            let places = [it.x_m, it.y_m].into_iter().filter(|_| with_place);
            let places = places.map(|m| m.map_or_else(Cell::default, |m| format!("{:.0}", m / 1e3).into()));
            let figures = [Cell::percent(Some(it.share)), Cell::figure(Some(it.sigma))];
            std::iter::once(it.name.as_str().into()).chain(places).chain(figures).collect()
        };
        let table = Table { header: header.collect(), rows: all.iter().take(most).map(row).collect() };
        Some((kind.title(), all.len(), table.filled()?))
    };
    Kind::ALL.into_iter().filter_map(table).collect()
}
