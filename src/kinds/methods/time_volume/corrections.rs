//! The parameters of the model that a time volume may correct.

use crate::kinds::Domain;
use crate::kinds::models::Model;
use crate::reader::{Absent, AnyKey, Described, Field, Form, Key, Limits, Read, Section, YesNo, fields};
use crate::text::listed;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use isobar_assim::Error;
use isobar_assim::time_volume::{Candidate, CorrectionPattern, Corrections, tile_patterns};
use isobar_model::{Duration, Grid, ModelError, State, TangentLinear, check_time_step};
use std::sync::Arc;

const CANDIDATE: Key<Described> = Key::required(
    "candidate",
    "",
    Described(
        "one of advection_x_m_per_s, advection_y_m_per_s, mean_depth_m, gravity_m_per_s2, drag_per_s, coriolis_per_s, where the model has it",
        Form::text,
    ),
    "the parameter that may be wrong",
);

const SIGMA: Key<Limits> = Key::absent(
    "sigma",
    "of the parameter",
    Limits::Positive,
    Absent::Explained("no prior"),
    "standard deviation of a prior",
);

const TILES: Key<Described> = Key::absent(
    "tiles",
    "",
    Described("[in x, in y]", || Form::list(Form::Whole(1, 4096))),
    Absent::Explained("the same everywhere"),
    "numbers of tiles, each with an amplitude of its own: smooth functions of place that sum to one",
);

const PATTERNS_FILE: Key<Described> = Key::absent(
    "patterns_file",
    "",
    Described("a CSV file with a column for each pattern and a row for each cell", Form::text),
    Absent::Explained("the same everywhere"),
    "patterns in space such as EOFs, each with an amplitude of its own, in place of `tiles`",
);

const MOVES_WITH_FLOW: Key<YesNo> = Key::absent(
    "moves_with_flow",
    "",
    YesNo,
    Absent::Means(false),
    "whether tiles or patterns move with the flow averaged over the domain, from where they are at the start",
);

/// The keys of a correction.
pub(super) const KEYS: &[&dyn AnyKey] = &[&CANDIDATE, &TILES, &PATTERNS_FILE, &MOVES_WITH_FLOW, &SIGMA];

/// The most amplitudes of all corrections of a method: each is a column of the tangent-linear model.
pub(super) const MOST_AMPLITUDES: usize = 100;

/// Reads a parameter of the model that may be wrong.
pub(super) fn read(field: &Field<'_>, domain: &Domain) -> Read<Candidate> {
    let section = field.section_with(KEYS)?;
    let name_field = section.required(CANDIDATE.name)?;
    let name = name_field.text()?;
    let mut equations = domain.model.equations.boxed_clone();
    let parameters: Vec<_> = equations.parameters(&domain.grid).into_iter().map(|(parameter, _)| parameter).collect();
    let Some(parameter) = parameters.iter().find(|parameter| parameter.name == name) else {
        let message = format!("`{}` is no parameter of this model on this domain", name_field.title());
        let possible = listed(parameters.iter().map(|parameter| parameter.name));
        return Err(name_field.invalid(message, &format!("possible here: {possible}")));
    };
    let (unit, step) = (parameter.unit.into(), parameter.step);
    let (patterns, moves_with_flow) = (patterns(&section, &domain.grid)?, section.get(&MOVES_WITH_FLOW)?);
    if moves_with_flow && patterns.is_empty() {
        let message = "a correction that is the same everywhere has nothing that could move".into();
        let help = "give `tiles` or `patterns_file`, or leave it out";
        return Err(section.required(MOVES_WITH_FLOW.name)?.misplaced(message, help));
    }
    Ok(Candidate { name, unit, step, sigma_prior: section.find(&SIGMA)?, patterns, moves_with_flow })
}

/// How a correction depends on place; no patterns if it does not.
fn patterns(section: &Section<'_>, grid: &Grid) -> Read<Vec<CorrectionPattern>> {
    match (section.optional(TILES.name), section.optional(PATTERNS_FILE.name)) {
        (None, None) => Ok(Vec::new()),
        (Some(tiles), None) => {
            let numbers = tiles.elements(2)?;
            let [nx, ny] = numbers.as_slice() else {
                let allowed = "must be [tiles in x, tiles in y]";
                return Err(tiles.invalid(format!("`{}` needs two numbers", tiles.title()), allowed));
            };
            let (nx, ny) = (nx.whole(1, grid.nx)?, ny.whole(1, grid.ny)?);
            if nx * ny > MOST_AMPLITUDES {
                let message = format!("`{}` are {} tiles", tiles.title(), nx * ny);
                return Err(tiles.invalid(message, &format!("must be at most {MOST_AMPLITUDES}")));
            }
            Ok(tile_patterns(grid, [nx, ny]))
        }
        (None, Some(file)) => {
            let columns = fields::read(&file, grid, MOST_AMPLITUDES)?.columns;
            let named = columns.into_iter().enumerate();
            let pattern = |(k, weights)| CorrectionPattern { name: format!("eof {}", k + 1), weights };
            Ok(named.map(pattern).collect())
        }
        (Some(_), Some(file)) => {
            let message = format!("`{}` stands beside `tiles`", file.title());
            Err(file.misplaced(message, "a correction has tiles or the patterns of a file, not both"))
        }
    }
}

/// The part of a field that its patterns may leave over, relative to the field.
const LEFT_OVER: f64 = 1e-6;

/// The amplitudes, by the names that a time volume gives them, with which the corrected model would be the truth's: where both are of
/// one kind, and the difference of a parameter is a sum of the correction's patterns.
pub(super) fn true_amplitudes(candidates: &[Candidate], truth: &Model, methods: &Domain) -> Vec<(String, f64)> {
    let of_candidate = |candidate: &Candidate| -> Option<Vec<(String, f64)>> {
        let wrong = truth.difference(&methods.model, &methods.grid, &candidate.name)?;
        let name = format!("transition/{}", candidate.name);
        if candidate.patterns.is_empty() {
            let uniform = wrong.iter().all(|value| (value - wrong[0]).abs() <= LEFT_OVER * wrong[0].abs());
            return uniform.then(|| vec![(name, wrong[0])]);
        }
        let amplitudes = amplitudes(&candidate.patterns, &wrong)?;
        let named = candidate.patterns.iter().map(|pattern| format!("{name}/{}", pattern.name));
        Some(named.zip(amplitudes).collect())
    };
    // Where those that move are depends on the flow.
    candidates.iter().filter(|it| !it.moves_with_flow).filter_map(of_candidate).flatten().collect()
}

/// The amplitudes of patterns whose sum is a field, by least squares; `None` if it is no such sum, or the patterns are not
/// independent.
fn amplitudes(patterns: &[CorrectionPattern], field: &[f64]) -> Option<Vec<f64>> {
    let n = patterns.len();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let products = Mat::from_fn(n, n, |i, j| dot(&patterns[i].weights, &patterns[j].weights));
    let right = Mat::from_fn(n, 1, |i, _| dot(&patterns[i].weights, field));
    let root = products.llt(Side::Lower).ok()?;
    let pivots = (0..n).map(|i| root.L()[(i, i)]);
    let (least, most) = pivots.fold((f64::INFINITY, 0.0), |(least, most), own| (own.min(least), own.max(most)));
    if least < LEFT_OVER * most {
        return None;
    }
    let found = root.solve(&right);
    let sum = |cell: usize| (0..n).map(|k| found[(k, 0)] * patterns[k].weights[cell]).sum::<f64>();
    let left: f64 = field.iter().enumerate().map(|(cell, value)| (value - sum(cell)).powi(2)).sum();
    (left <= LEFT_OVER * LEFT_OVER * dot(field, field)).then(|| (0..n).map(|k| found[(k, 0)]).collect())
}

/// The scenario's model with other parameters.
pub(super) struct ModelCorrections {
    pub domain: Domain,
    /// Length of a cycle.
    pub cycle: Duration,
    /// The state for which a corrected model must be stable.
    pub background: State,
    pub candidates: Vec<Candidate>,
}

impl Corrections for ModelCorrections {
    fn candidates(&self) -> &[Candidate] {
        &self.candidates
    }

    fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error> {
        let Domain { grid, model, .. } = &self.domain;
        let changes = self.candidates.iter().map(|candidate| candidate.name.as_str()).zip(corrections.iter().copied());
        let fault = |error: ModelError| Error::Setting(format!("the corrected model: {error}"));
        let model = model.corrected(grid, &changes.collect::<Vec<_>>()).build(grid, self.cycle).map_err(fault)?;
        check_time_step(&*model, &self.background).map_err(fault)?;
        Ok(model)
    }

    fn mean_flow(&self, state: &State) -> [f64; 2] {
        self.domain.model.equations.mean_flow(&self.domain.grid, state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::Boundary;

    #[test]
    fn amplitudes_are_known_of_what_patterns_can_describe() {
        let grid = Grid { nx: 12, ny: 8, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
        let patterns = tile_patterns(&grid, [3, 2]);
        let right = [4.0, -1.0, 0.0, 2.5, 0.0, 1.0];
        let cells = || 0..grid.cells();
        let field: Vec<f64> =
            cells().map(|cell| patterns.iter().zip(right).map(|(it, r)| r * it.weights[cell]).sum()).collect();
        let found = amplitudes(&patterns, &field).unwrap();
        assert!(found.iter().zip(right).all(|(a, b)| (a - b).abs() < 1e-10), "{found:?}");
        let other: Vec<f64> = cells().map(|cell| if cell == 0 { 1.0 } else { field[cell] }).collect();
        assert_eq!(amplitudes(&patterns, &other), None);
        let twice = [patterns.clone(), patterns.clone()].concat();
        assert_eq!(amplitudes(&twice, &field), None);
    }
}
