//! The contract battery of observation operators.

use crate::operator::ObservationOperator;
use isobar_model::State;
use isobar_model::random::{standard_normals, stream};

/// What the errors of floating-point sums may amount to, in units of machine epsilon and of the sum of the terms'
/// absolute values.
const ROUNDING: f64 = 100.0 * f64::EPSILON;

/// A clause of the contract of [`ObservationOperator`] that an operator does not keep.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ContractViolation {
    /// `len()`, `simulate()` and `linearize()` do not agree on the number of observations.
    #[error("len() is {len}, but simulate() gives {simulated} values and linearize() {linearized} rows")]
    Lengths {
        /// Of `len()`.
        len: usize,
        /// Of `simulate()`.
        simulated: usize,
        /// Of `linearize()`; X and G may differ, then that of G.
        linearized: usize,
    },
    /// A value or a derivative is infinite or not a number.
    #[error("simulate() or linearize() gives a number that is not finite in row {row}")]
    NotFinite {
        /// The observation.
        row: usize,
    },
    /// Two calls with the same arguments differ.
    #[error("simulate() or linearize() gives something else when called again")]
    NotAFunction,
    /// The Jacobian is not additive and homogeneous.
    #[error("the Jacobian is not linear: row {row} misses by {error:e}")]
    NotLinear {
        /// The observation.
        row: usize,
        /// J(2u + v) − 2 J u − J v.
        error: f64,
    },
    /// h(x + εδx, c + εδc) − h − ε J(δx, δc) is neither zero nor O(ε²).
    #[error("the Jacobian is not the derivative with respect to {argument}: residuals {residuals:?} for ε = 1, 0.1, …")]
    NotTheDerivative {
        /// `the state`, `the calibration` or `both`.
        argument: &'static str,
        /// Norms of the residual for ε = 1, 0.1, … 1e-7.
        residuals: Vec<f64>,
    },
    /// ⟨J δ, w⟩ ≠ ⟨δ, Jᵀ w⟩.
    #[error("the adjoint with respect to {argument} is not that of the Jacobian: {forward:e} ≠ {backward:e}")]
    NotTheAdjoint {
        /// `the state`, `the calibration` or `both`.
        argument: &'static str,
        /// ⟨J δ, w⟩.
        forward: f64,
        /// ⟨δ, Jᵀ w⟩.
        backward: f64,
    },
}

/// Checks that an operator keeps its contract at (x, c): equal lengths, finite numbers and equal results of equal calls; a linear
/// Jacobian; residuals of first order that vanish (up to rounding) or decrease as ε² over at least four decades (slope
/// 2 ± 0.05); and the dot product ⟨J δ, w⟩ = ⟨δ, Jᵀ w⟩ to 100 machine epsilons. The last two with respect to the
/// state, to the calibration, and to both.
///
/// # Errors
/// The first clause that is not kept.
pub fn check_operator(
    operator: &dyn ObservationOperator,
    x: &State,
    calibration: &[f64],
    seed: u64,
) -> Result<(), ContractViolation> {
    let (value, jacobian) = (operator.simulate(x, calibration), operator.linearize(x, calibration));
    let rows = operator.len();
    let (state_rows, calibration_rows) = (jacobian.state.rows(), jacobian.calibration.rows());
    if [value.len(), state_rows, calibration_rows] != [rows; 3] {
        let linearized = if state_rows == rows { calibration_rows } else { state_rows };
        return Err(ContractViolation::Lengths { len: rows, simulated: value.len(), linearized });
    }
    for row in 0..rows {
        let derivatives = jacobian.state.row(row).iter().chain(jacobian.calibration.row(row));
        if !value[row].is_finite() || derivatives.into_iter().any(|entry| !entry.1.is_finite()) {
            return Err(ContractViolation::NotFinite { row });
        }
    }
    if operator.simulate(x, calibration) != value || operator.linearize(x, calibration) != jacobian {
        return Err(ContractViolation::NotAFunction);
    }

    let mut random = stream(seed, "contract/observation operator");
    let mut perturbation = |values: &[f64]| -> Vec<f64> {
        let normals = standard_normals(&mut random, values.len());
        values.iter().zip(normals).map(|(value, normal)| (1.0 + value.abs()) * normal).collect()
    };
    let (dx, dc) = (perturbation(x.values()), perturbation(calibration));
    let (ex, ec) = (perturbation(x.values()), perturbation(calibration));
    let weights = perturbation(&value);
    // Sum of the absolute values of the terms of each row: what rounding errors are relative to.
    let scale = |row: usize, x: &[f64], c: &[f64]| -> f64 {
        let state = jacobian.state.row(row).iter().map(|&(column, value)| (value * x[column]).abs());
        let calibration = jacobian.calibration.row(row).iter().map(|&(column, value)| (value * c[column]).abs());
        state.sum::<f64>() + calibration.sum::<f64>()
    };

    let combined = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| 2.0 * a + b).collect() };
    let (first, second) = (jacobian.apply(&dx, &dc), jacobian.apply(&ex, &ec));
    let (both_x, both_c) = (combined(&dx, &ex), combined(&dc, &ec));
    for (row, sum) in jacobian.apply(&both_x, &both_c).into_iter().enumerate() {
        let error = (sum - 2.0 * first[row] - second[row]).abs();
        let terms = scale(row, &both_x, &both_c) + 2.0 * scale(row, &dx, &dc) + scale(row, &ex, &ec);
        if error > ROUNDING * terms {
            return Err(ContractViolation::NotLinear { row, error });
        }
    }

    let (zero_x, zero_c) = (vec![0.0; dx.len()], vec![0.0; dc.len()]);
    let cases = [("the state", &dx, &zero_c), ("the calibration", &zero_x, &dc), ("both", &dx, &dc)];
    for (argument, dx, dc) in cases {
        let change = jacobian.apply(dx, dc);
        let mut residuals = Vec::with_capacity(8);
        let mut rounding = 0.0;
        for power in 0..8 {
            let size = 10f64.powi(-power);
            let moved = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a + size * b).collect() };
            let (moved_x, moved_c) = (moved(x.values(), dx), moved(calibration, dc));
            let there = operator.simulate(&State::from_values(x.layout(), moved_x.clone()), &moved_c);
            let residual: f64 = (0..rows).map(|row| (there[row] - value[row] - size * change[row]).powi(2)).sum();
            residuals.push(residual.sqrt());
            if power == 0 {
                let terms = |row| {
                    let here = scale(row, x.values(), calibration) + value[row].abs() + there[row].abs();
                    ROUNDING * (here + scale(row, &moved_x, &moved_c) + scale(row, dx, dc))
                };
                rounding = (0..rows).map(|row| f64::powi(terms(row), 2)).sum::<f64>().sqrt();
            }
        }
        let is_linear = residuals.iter().all(|&residual| residual <= rounding);
        if !is_linear && !falls_quadratically(&residuals) {
            return Err(ContractViolation::NotTheDerivative { argument, residuals });
        }

        let (mut back_x, mut back_c) = (zero_x.clone(), zero_c.clone());
        jacobian.apply_ad(&weights, &mut back_x, &mut back_c);
        let forward: f64 = change.iter().zip(&weights).map(|(change, weight)| change * weight).sum();
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let backward = dot(dx, &back_x) + dot(dc, &back_c);
        let terms: f64 = (0..rows).map(|row| scale(row, dx, dc) * weights[row].abs()).sum();
        let error = (forward - backward).abs();
        if error > ROUNDING * terms {
            return Err(ContractViolation::NotTheAdjoint { argument, forward, backward });
        }
    }
    Ok(())
}

/// Whether four successive decades have slopes of 2 ± 0.05.
fn falls_quadratically(residuals: &[f64]) -> bool {
    let slopes: Vec<f64> = residuals.windows(2).map(|pair| (pair[0] / pair[1]).log10()).collect();
    slopes.windows(4).any(|slopes| slopes.iter().all(|slope| (slope - 2.0).abs() <= 0.05))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::layout;
    use crate::{Jacobian, SparseRows};
    use isobar_model::{Boundary, Layout};
    use std::sync::Arc;

    fn random_state(layout: &Arc<Layout>, seed: u64) -> State {
        State::from_values(layout, standard_normals(&mut stream(seed, "test"), layout.len()))
    }

    /// One observation y = x₀² + c₀³ and one y = 2 x₁, with chosen faults.
    #[derive(Clone, Copy, Default)]
    struct Nonlinear {
        claimed_rows: Option<usize>,
        state_factor: Option<f64>,
        calibration_factor: Option<f64>,
    }

    impl ObservationOperator for Nonlinear {
        fn len(&self) -> usize {
            self.claimed_rows.unwrap_or(2)
        }

        fn simulate(&self, x: &State, c: &[f64]) -> Vec<f64> {
            vec![x.values()[0].powi(2) + c[0].powi(3), 2.0 * x.values()[1]]
        }

        fn linearize(&self, x: &State, c: &[f64]) -> Jacobian {
            let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
            state.push_row([(0, self.state_factor.unwrap_or(2.0) * x.values()[0])]);
            state.push_row([(1, 2.0)]);
            calibration.push_row([(0, self.calibration_factor.unwrap_or(3.0) * c[0].powi(2))]);
            calibration.push_row([]);
            Jacobian { state, calibration }
        }
    }

    #[test]
    fn a_right_nonlinear_operator_passes_and_wrong_ones_are_found() {
        let x = random_state(&layout(Boundary::Channel), 4);
        let check = |operator: Nonlinear| check_operator(&operator, &x, &[0.8], 5);
        let right = Nonlinear::default();
        assert_eq!(check(right), Ok(()));
        let lengths = ContractViolation::Lengths { len: 3, simulated: 2, linearized: 2 };
        assert_eq!(check(Nonlinear { claimed_rows: Some(3), ..right }), Err(lengths));
        let wrong = |operator| match check(operator) {
            Err(ContractViolation::NotTheDerivative { argument, .. }) => argument,
            other => panic!("{other:?}"),
        };
        assert_eq!(wrong(Nonlinear { state_factor: Some(2.0001), ..right }), "the state");
        let not_finite = Nonlinear { state_factor: Some(f64::NAN), ..right };
        assert_eq!(check(not_finite), Err(ContractViolation::NotFinite { row: 0 }));
        assert_eq!(wrong(Nonlinear { calibration_factor: Some(-3.0), ..right }), "the calibration");
    }

    /// An operator whose answers depend on how often it was asked.
    struct Moody(std::sync::atomic::AtomicUsize);

    impl ObservationOperator for Moody {
        fn len(&self) -> usize {
            1
        }

        fn simulate(&self, _: &State, _: &[f64]) -> Vec<f64> {
            vec![self.0.fetch_add(1, std::sync::atomic::Ordering::Relaxed) as f64]
        }

        fn linearize(&self, _: &State, _: &[f64]) -> Jacobian {
            let mut empty = SparseRows::new();
            empty.push_row([]);
            Jacobian { state: empty.clone(), calibration: empty }
        }
    }

    #[test]
    fn an_operator_with_a_memory_is_found() {
        let x = random_state(&layout(Boundary::Channel), 4);
        assert_eq!(check_operator(&Moody(0.into()), &x, &[], 5), Err(ContractViolation::NotAFunction));
    }
}
