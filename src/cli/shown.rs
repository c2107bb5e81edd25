//! Tables for people, or one JSON document for a program.

use super::console::print_json;
use miette::Report;
use serde_json::{Value, json};

/// What becomes of the scores of runs.
pub enum Shown {
    /// They are printed as tables, each run when it is complete.
    Printed,
    /// They are collected, to be printed as one JSON document.
    Collected(Vec<Value>),
}

impl Shown {
    /// Prints what was collected.
    pub fn finish(self) -> Result<(), Report> {
        match self {
            Shown::Printed => Ok(()),
            Shown::Collected(runs) => print_json(&json!({ "runs": runs })),
        }
    }
}
