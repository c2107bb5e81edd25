//! Conjugate gradients for a symmetric positive definite system (Hestenes and Stiefel 1952).

/// When the minimiser stops.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stopping {
    /// Residual norm relative to that of the right-hand side.
    pub tolerance: f64,
    /// The most iterations.
    pub max_iterations: usize,
}

/// Solves A v = b from v = 0; `multiply(p, out)` writes A p.
pub(super) fn solve(b: &[f64], stopping: Stopping, mut multiply: impl FnMut(&[f64], &mut [f64])) -> Vec<f64> {
    let mut solution = vec![0.0; b.len()];
    let mut residual = b.to_vec();
    let mut direction = b.to_vec();
    let mut image = vec![0.0; b.len()];
    let mut residual_squared = dot(&residual, &residual);
    let goal = residual_squared * stopping.tolerance.powi(2);
    for _ in 0..stopping.max_iterations {
        if residual_squared <= goal {
            break;
        }
        multiply(&direction, &mut image);
        let step = residual_squared / dot(&direction, &image);
        for i in 0..b.len() {
            solution[i] += step * direction[i];
            residual[i] -= step * image[i];
        }
        let next = dot(&residual, &residual);
        let ratio = next / residual_squared;
        residual_squared = next;
        for i in 0..b.len() {
            direction[i] = residual[i] + ratio * direction[i];
        }
    }
    solution
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
