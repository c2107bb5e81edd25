//! Linear algebra of several small matrices at a time, one in each lane of the processor's vectors.
//!
//! | file | what |
//! |---|---|
//! | `functions` | functions of a symmetric matrix on vectors |
//! | `fractions` | the inverse square root as a sum of simple fractions |

mod fractions;
mod functions;

pub(crate) use fractions::Fractions;
pub(crate) use functions::{Aligned, Functions, lanes};
