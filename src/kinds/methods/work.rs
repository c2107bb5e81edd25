//! The work of a method in a cycle, estimated from sizes alone: how much memory it holds, and how often it does what takes time.

use isobar_assim::fast_kalman::Residual;
use isobar_assim::{BiasTreatment, Problem};
use isobar_model::Grid;
use isobar_obs::ByPlacement;

/// The sizes on which the work of a method depends.
#[derive(Clone, Debug, PartialEq)]
pub struct Sizes {
    /// m, values of a state.
    pub values: f64,
    /// Variables of a cell.
    pub variables: f64,
    /// p, biases that the method estimates.
    pub biases: f64,
    /// Those of them that many observations share. The others belong to places, and so to blocks.
    pub shared_biases: f64,
    /// n, the most observations of a cycle.
    pub observations: f64,
    /// Length of the control vector of B.
    pub controls: f64,
    /// Time steps of the model in a cycle.
    pub steps: f64,
    /// Threads.
    pub threads: f64,
    /// The plane.
    pub grid: Grid,
}

/// The work of a method in a cycle, and what it holds at its peak.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Work {
    /// Numbers in double precision that it holds at one time, at most.
    pub numbers: f64,
    /// Steps of the model: those of all members.
    pub steps: f64,
    /// Steps of a column of the tangent-linear model.
    pub tangent_steps: f64,
    /// Steps of a column of its adjoint.
    pub adjoint_steps: f64,
    /// Multiplications, each with an addition, in products and factorisations of dense matrices.
    pub multiplications: f64,
    /// Applications of U or Uᵀ, B = U Uᵀ.
    pub roots: f64,
}

impl Sizes {
    /// Those of a problem whose cycles have this number of steps.
    pub fn new(problem: &Problem, bias: BiasTreatment, grid: &Grid, steps: usize) -> Self {
        let layout = problem.background.layout();
        let ByPlacement { shared, local } = problem.calibration.by_placement();
        let [shared_biases, local_biases] = match bias {
            BiasTreatment::Estimate => [shared.len() as f64, local.len() as f64],
            _ => [0.0; 2],
        };
        Self {
            values: layout.len() as f64,
            variables: layout.len() as f64 / layout.grid.cells() as f64,
            biases: shared_biases + local_biases,
            shared_biases,
            observations: problem.most_observations as f64,
            controls: problem.background_error.control_len() as f64,
            steps: steps as f64,
            threads: rayon::current_num_threads() as f64,
            grid: grid.clone(),
        }
    }

    /// m + p.
    pub fn unknowns(&self) -> f64 {
        self.values + self.biases
    }
}

/// The estimates of background and analysis with their spread, and the state of a forecast, in states.
const ESTIMATES: f64 = 6.0;

impl Work {
    /// A forecast of one state, and nothing else.
    pub fn forecast(sizes: &Sizes) -> Self {
        Self { numbers: ESTIMATES * sizes.values, steps: sizes.steps, ..Self::default() }
    }

    /// A dense Kalman filter: P, Q, the propagator and two products; each column goes through the tangent-linear model, `A P Aᵀ`
    /// takes two products, and an analysis in gain form P Hᵀ and Joseph's two updates.
    pub fn dense(sizes: &Sizes) -> Self {
        let (n, unknowns) = (sizes.observations, sizes.unknowns());
        let of_analysis = 3.0 * unknowns * n + n * n;
        Self {
            numbers: 2.0 * unknowns * unknowns + f64::max(3.0 * unknowns * unknowns, of_analysis),
            tangent_steps: sizes.values * sizes.steps,
            multiplications: 1.5 * unknowns.powi(3) + 3.0 * n * unknowns * unknowns + n.powi(3) / 3.0,
            ..Self::forecast(sizes)
        }
    }

    /// An ensemble: members, their perturbations before and after and the draws of Q, and what the members make of the
    /// observations.
    pub fn ensemble(sizes: &Sizes, members: f64) -> Self {
        let (size, n) = (sizes.unknowns(), sizes.observations);
        Self {
            numbers: 4.0 * size * members + 3.0 * n * members + 2.0 * (members.powi(2) + sizes.biases.powi(2)),
            steps: members * sizes.steps,
            roots: members,
            multiplications: (size + n) * members * members + 10.0 * members.powi(3),
            ..Self::default()
        }
    }

    /// A minimisation with this number of iterations in all: the vectors of conjugate gradients and of the threads, P_c and
    /// what conjugate gradients hold for each bias; two applications of the root of B for each iteration and each bias.
    pub fn minimisation(sizes: &Sizes, controls: f64, iterations: f64) -> Self {
        let Sizes { values: m, biases: p, observations: n, threads, .. } = *sizes;
        Self {
            numbers: 6.0 * (controls + p)
                + threads * (controls + 2.0 * m)
                + 6.0 * p * p
                + 6.0 * n * (p + 1.0)
                + ESTIMATES * m,
            steps: sizes.steps,
            roots: 2.0 * (iterations + p) * controls / sizes.controls.max(1.0),
            ..Self::default()
        }
    }

    /// `self` and `other`, one after the other, with the memory of both.
    pub fn and(self, other: Self) -> Self {
        Self {
            numbers: self.numbers + other.numbers,
            steps: self.steps + other.steps,
            tangent_steps: self.tangent_steps + other.tangent_steps,
            adjoint_steps: self.adjoint_steps + other.adjoint_steps,
            multiplications: self.multiplications + other.multiplications,
            roots: self.roots + other.roots,
        }
    }
}

/// The number of columns that probe how much of the residual blocks a forecast keeps.
pub(super) fn probes(residual: Residual) -> f64 {
    match residual {
        Residual::Probe { count } => count as f64,
        Residual::Exact | Residual::Persist => 0.0,
    }
}

/// The number of iterations that a minimisation usually takes.
pub(super) const ITERATIONS: f64 = 30.0;

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::Boundary;

    fn sizes() -> Sizes {
        let grid = Grid { nx: 10, ny: 10, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
        Sizes {
            values: 300.0,
            variables: 3.0,
            biases: 4.0,
            shared_biases: 4.0,
            observations: 50.0,
            controls: 300.0,
            steps: 12.0,
            threads: 2.0,
            grid,
        }
    }

    /// The exponents of the textbook: a dense filter is quadratic in memory, and cubic in time.
    #[test]
    fn work_grows_with_the_sizes_as_the_textbook_says() {
        let small = Work::dense(&sizes());
        let large = Work::dense(&Sizes { values: 3000.0, biases: 40.0, observations: 500.0, ..sizes() });
        assert_eq!(large.numbers / small.numbers, 100.0);
        assert!((large.multiplications / small.multiplications - 1000.0).abs() < 1e-9);
        assert_eq!(large.tangent_steps / small.tangent_steps, 10.0);
        let members = |count| Work::ensemble(&sizes(), count).steps;
        assert_eq!(members(40.0), 40.0 * 12.0);
    }

    #[test]
    fn the_work_of_two_parts_is_their_sum() {
        let (one, two) = (Work::ensemble(&sizes(), 8.0), Work::forecast(&sizes()));
        let both = one.and(two);
        assert_eq!((both.numbers, both.steps), (one.numbers + two.numbers, one.steps + two.steps));
        assert_eq!(Work::default().and(one), one);
    }
}
