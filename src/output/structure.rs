//! A method's blocks and common factors as pictures show them.

use crate::event::RunInfo;
use crate::plot::{Thinning, number, parts};
use crate::tables::figure;
use crate::text::counted;
use isobar_assim::{CommonFactor, Structure};
use serde::{Deserialize, Serialize};

/// The structure of a method after one analysis.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ShownStructure {
    /// The number of the colour of each cell's part, `[y, x]`, thinned.
    pub parts: Vec<u8>,
    /// What there is to say about the parts.
    pub summary: String,
    /// The leading common factors.
    pub factors: Vec<ShownFactor>,
}

/// A common factor.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ShownFactor {
    /// One standard deviation of it, for each variable `[y, x]`, thinned.
    pub fields: Vec<Vec<f32>>,
    /// The largest change of each variable.
    pub largest: Vec<f32>,
    /// Its share, and the bias that goes with it.
    pub summary: String,
}

impl ShownStructure {
    /// The structure as maps of the run show it.
    pub fn new(structure: &Structure, info: &RunInfo, thinning: &Thinning) -> Self {
        let Structure { part_of_cell, observed, factors } = structure;
        let [nx, _] = thinning.size();
        Self {
            parts: parts::numbers(&thinning.pick(part_of_cell), observed, nx),
            summary: summary(part_of_cell, observed),
            factors: factors.iter().map(|factor| ShownFactor::new(factor, info, thinning)).collect(),
        }
    }
}

impl ShownFactor {
    fn new(factor: &CommonFactor, info: &RunInfo, thinning: &Thinning) -> Self {
        let cells = thinning.cells();
        let fields: Vec<Vec<f32>> =
            factor.increment.values().chunks_exact(cells).map(|field| thinning.apply(field)).collect();
        let largest = fields.iter().map(|field| field.iter().fold(0.0, |a: f32, b| a.max(b.abs()))).collect();
        let mut summary = format!("{} % of the claimed variance", number(0.1 * (1000.0 * factor.share).round()));
        // The bias that it moves most, compared with what was known of it at the start.
        let moved = factor.calibration.iter().zip(&info.calibration.parameters);
        let moved = moved.map(|(value, parameter)| (*value, parameter, value.abs() / parameter.sigma_prior));
        let most = moved.filter(|it| it.2 > 0.02).max_by(|a, b| a.2.total_cmp(&b.2));
        if let Some((value, parameter, _)) = most {
            let sign = if value < 0.0 { '−' } else { '+' };
            summary += &format!(", {} {sign}{} {}", parameter.name, figure(value.abs()), parameter.unit);
        }
        Self { fields, largest, summary }
    }
}

fn summary(part_of_cell: &[usize], observed: &[bool]) -> String {
    let mut sizes = vec![0_usize; observed.len()];
    part_of_cell.iter().for_each(|&part| sizes[part] += 1);
    let seen = sizes.iter().zip(observed).filter(|(size, observed)| **observed && **size > 0).map(|(size, _)| *size);
    let (count, largest) = seen.clone().fold((0, 0), |(count, largest), size| (count + 1, size.max(largest)));
    let unseen = part_of_cell.len() - seen.sum::<usize>();
    format!("{}, the largest of {largest} cells; {unseen} cells unobserved", counted(count, "observed part"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_counted() {
        let text = summary(&[0, 0, 1, 2, 2, 2, 3, 4], &[true, false, true, false, true, true]);
        assert_eq!(text, "3 observed parts, the largest of 3 cells; 2 cells unobserved");
    }
}
