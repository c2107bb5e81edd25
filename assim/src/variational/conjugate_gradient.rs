//! Conjugate gradients for symmetric positive definite systems (Hestenes and Stiefel 1952).

use isobar_model::vector::dot;

/// A residual below this number of machine epsilons of the right-hand side is rounding.
const ROUNDING: f64 = 32.0 * f64::EPSILON;

/// When the minimiser stops.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stopping {
    /// Residual norm relative to that of the right-hand side.
    pub tolerance: f64,
    /// The most iterations.
    pub max_iterations: usize,
}

/// What the minimiser came to.
pub(super) struct Solution {
    /// v.
    pub values: Vec<f64>,
    /// b − A v.
    pub residual: Vec<f64>,
    /// How it ended.
    pub ending: Ending,
}

/// How a minimisation ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ending {
    /// Products with A.
    pub iterations: usize,
    /// |b − A v|/|b|, as the recursion has it.
    pub relative_residual: f64,
    /// Whether the system is solved to its tolerance.
    pub reached: bool,
}

/// One system under way.
struct System {
    solution: Vec<f64>,
    residual: Vec<f64>,
    direction: Vec<f64>,
    residual_squared: f64,
    /// |b|².
    right_squared: f64,
    /// |b − A v|² of a system that is solved.
    goal: f64,
    iterations: usize,
}

impl System {
    /// A v = b, solved when |b − A v| has fallen to the tolerance times |b|, and to at most `largest`.
    fn new(b: Vec<f64>, stopping: Stopping, largest: f64) -> Self {
        let right_squared = dot(&b, &b);
        Self {
            solution: vec![0.0; b.len()],
            direction: b.clone(),
            residual: b,
            residual_squared: right_squared,
            right_squared,
            goal: (right_squared * stopping.tolerance.powi(2)).min(largest * largest),
            iterations: 0,
        }
    }

    fn is_solved(&self) -> bool {
        self.residual_squared <= self.goal
    }

    /// Whether another iteration could bring it closer.
    fn is_open(&self) -> bool {
        !self.is_solved() && self.residual_squared > self.right_squared * ROUNDING.powi(2)
    }

    /// An iteration, with A times the direction.
    fn iterate(&mut self, image: &[f64]) {
        let step = self.residual_squared / dot(&self.direction, image);
        for i in 0..image.len() {
            self.solution[i] += step * self.direction[i];
            self.residual[i] -= step * image[i];
        }
        self.iterations += 1;
        let next = dot(&self.residual, &self.residual);
        let ratio = next / self.residual_squared;
        self.residual_squared = next;
        for i in 0..image.len() {
            self.direction[i] = self.residual[i] + ratio * self.direction[i];
        }
    }
}

/// Solves A v = b for several b, each from v = 0; `multiply` takes the directions of all that are not solved yet to A times
/// each.
///
/// In control space A = I + KᵀK is the Hessian of the cost J, so that 2 J(v) exceeds its minimum by
/// (b − A v)ᵀ A⁻¹ (b − A v) ≤ |b − A v|², whatever the units. A tolerance relative to |b| alone stops far from the minimum
/// where one term of the cost is much steeper than the others, as with a very accurate observation or a very wide prior.
/// So the residual of each system must also fall to at most `largest` of its number.
pub(super) fn solve(
    right: Vec<Vec<f64>>,
    largest: impl Fn(usize) -> f64,
    stopping: Stopping,
    multiply: impl Fn(&[&[f64]]) -> Vec<Vec<f64>>,
) -> Vec<Solution> {
    let mut systems: Vec<System> =
        right.into_iter().enumerate().map(|(number, b)| System::new(b, stopping, largest(number))).collect();
    for _ in 0..stopping.max_iterations {
        let mut open: Vec<&mut System> = systems.iter_mut().filter(|system| system.is_open()).collect();
        if open.is_empty() {
            break;
        }
        let directions: Vec<&[f64]> = open.iter().map(|system| &*system.direction).collect();
        let images = multiply(&directions);
        for (system, image) in open.iter_mut().zip(images) {
            system.iterate(&image);
        }
    }
    let solution = |system: System| {
        let relative = if system.right_squared > 0.0 { system.residual_squared / system.right_squared } else { 0.0 };
        let ending =
            Ending { iterations: system.iterations, relative_residual: relative.sqrt(), reached: system.is_solved() };
        Solution { values: system.solution, residual: system.residual, ending }
    };
    systems.into_iter().map(solution).collect()
}

/// Minimises a cost with the Hessian A and the gradient −b at zero. For n observations the residual ends at √(tolerance n)
/// at most: 2 J is then within the tolerance of its expectation n.
pub(super) fn minimise(
    right: Vec<f64>,
    observations: usize,
    stopping: Stopping,
    hessian: impl Fn(&[f64]) -> Vec<f64>,
) -> Solution {
    let largest = (stopping.tolerance * observations as f64).sqrt();
    let solutions =
        solve(vec![right], |_| largest, stopping, |directions| directions.iter().map(|v| hessian(v)).collect());
    solutions.into_iter().next().expect("one system has one solution")
}
