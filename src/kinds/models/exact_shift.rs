//! `kind = "exact_shift"`.

use super::advection;
use super::equations::Equations;
use super::integration::TIME_STEP_S;
use crate::kinds::Kind;
use crate::reader::{Absent, Integer, Key};
use isobar_model::{Adjoint, Boundary, Duration, ExactShift, Forced, Forcing, Grid, ModelError};
use std::sync::Arc;

const COLUMNS: Key<Integer> =
    Key::required("columns_per_step", "cells", Integer(-4096, 4096), "eastward shift in a time step");

const ROWS: Key<Integer> =
    Key::absent("rows_per_step", "cells", Integer(-4096, 4096), Absent::Means(0), "northward shift in a time step");

#[derive(Clone, Debug)]
struct ExactShiftSettings {
    columns_per_step: i64,
    rows_per_step: i64,
}

pub(super) const KIND: Kind<dyn Equations, Grid> = Kind::new(
    "exact_shift",
    "A tracer that moves by a whole number of cells in each step, without any numerical error",
    &[&[&TIME_STEP_S, &COLUMNS, &ROWS]],
    |section, grid| {
        if grid.boundary == Boundary::Channel {
            let message = "exact shifts need a doubly periodic domain, but grid.boundary is \"channel\"";
            return Err(section.required("kind")?.invalid(message.into(), "needs grid.boundary = \"periodic\""));
        }
        let (columns_per_step, rows_per_step) = (section.get(&COLUMNS)?, section.get(&ROWS)?);
        Ok(Box::new(ExactShiftSettings { columns_per_step, rows_per_step }))
    },
);

impl Equations for ExactShiftSettings {
    fn variables(&self) -> &[(&'static str, &'static str)] {
        advection::VARIABLES
    }

    fn build(
        &self,
        grid: &Grid,
        time_step: Duration,
        _: Duration,
        forcing: &Arc<Forcing>,
    ) -> Result<Arc<dyn Adjoint>, ModelError> {
        let shift = ExactShift::new(grid.clone(), self.columns_per_step, self.rows_per_step, time_step)?;
        Forced::of(Arc::new(shift), forcing)
    }

    fn boxed_clone(&self) -> Box<dyn Equations> {
        Box::new(self.clone())
    }

    fn is_linear(&self) -> bool {
        true
    }

    fn has_other_resolutions(&self) -> bool {
        false
    }
}
