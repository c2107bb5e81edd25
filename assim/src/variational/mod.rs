//! Variational methods: a cost function in control space and its minimiser.

mod conjugate_gradient;
mod three_d_var;

pub use three_d_var::{ThreeDVar, ThreeDVarSettings};
