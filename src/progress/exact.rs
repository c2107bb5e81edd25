//! How far an exact computation is, whose methods run at the same time.

use super::display::Display;
use crate::exact::CycleDone;
use std::sync::{Mutex, PoisonError};

/// Shows the progress of an exact computation.
pub struct ExactProgress {
    title: String,
    shared: Mutex<(Display, usize)>,
}

impl ExactProgress {
    /// A display that suits standard error; nothing at all if `quiet`.
    pub fn new(quiet: bool, title: &str) -> Self {
        Self { title: title.into(), shared: Mutex::new((Display::new(quiet), 0)) }
    }

    /// A method has done a cycle.
    pub fn heard(&self, CycleDone { method, cycle, all }: CycleDone<'_>) {
        let mut shared = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        let (display, done) = &mut *shared;
        if *done == 0 {
            display.start(&self.title, all);
        }
        *done += 1;
        display.advance(*done, || format!("{method}, cycle {cycle}"));
    }
}
