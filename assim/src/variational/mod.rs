//! Variational methods: a cost function in control space and its minimiser.

mod bias_information;
mod conjugate_gradient;
mod control_space;
mod convergence;
mod four_d_var;
mod hybrid;
mod three_d_var;
mod window_cost;

pub use four_d_var::{FourDVar, FourDVarSettings};
pub use hybrid::{HybridSettings, HybridThreeDVar};
pub use three_d_var::{ThreeDVar, ThreeDVarSettings};
