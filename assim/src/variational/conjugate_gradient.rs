//! Conjugate gradients for symmetric positive definite systems (Hestenes and Stiefel 1952).

use isobar_model::vector::dot;

/// When the minimiser stops.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stopping {
    /// Residual norm relative to that of the right-hand side.
    pub tolerance: f64,
    /// The most iterations.
    pub max_iterations: usize,
}

/// One system under way.
struct System {
    solution: Vec<f64>,
    residual: Vec<f64>,
    direction: Vec<f64>,
    residual_squared: f64,
    goal: f64,
}

impl System {
    fn new(b: &[f64], stopping: Stopping) -> Self {
        let residual_squared = dot(b, b);
        Self {
            solution: vec![0.0; b.len()],
            residual: b.to_vec(),
            direction: b.to_vec(),
            residual_squared,
            goal: residual_squared * stopping.tolerance.powi(2),
        }
    }

    fn is_solved(&self) -> bool {
        self.residual_squared <= self.goal
    }

    /// An iteration, with A times the direction.
    fn iterate(&mut self, image: &[f64]) {
        let step = self.residual_squared / dot(&self.direction, image);
        for i in 0..image.len() {
            self.solution[i] += step * self.direction[i];
            self.residual[i] -= step * image[i];
        }
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
pub(super) fn solve(
    right: &[Vec<f64>],
    stopping: Stopping,
    mut multiply: impl FnMut(&[Vec<f64>]) -> Vec<Vec<f64>>,
) -> Vec<Vec<f64>> {
    let mut systems: Vec<System> = right.iter().map(|b| System::new(b, stopping)).collect();
    for _ in 0..stopping.max_iterations {
        let mut open: Vec<&mut System> = systems.iter_mut().filter(|system| !system.is_solved()).collect();
        if open.is_empty() {
            break;
        }
        let directions: Vec<Vec<f64>> = open.iter().map(|system| system.direction.clone()).collect();
        for (system, image) in open.iter_mut().zip(multiply(&directions)) {
            system.iterate(&image);
        }
    }
    systems.into_iter().map(|system| system.solution).collect()
}
