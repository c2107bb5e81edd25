//! `kind = "4dvar"`.

use super::{BIAS, ERROR_CORRELATION, MethodSettings, Setup, Surroundings, variational};
use crate::kinds::Kind;
use crate::reader::{Absent, Key, Whole};
use isobar_assim::variational::{FourDVar, FourDVarSettings, ThreeDVarSettings};
use isobar_assim::{Assimilator, Error};

const WINDOW_CYCLES: Key<Whole> = Key::required("window_cycles", "cycles", Whole(1, 1000), "length of the window");

const OUTER_LOOPS: Key<Whole> =
    Key::absent("outer_loops", "", Whole(1, 100), Absent::Means(2), "number of times the problem is linearised anew");

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "4dvar",
    "Strong-constraint incremental 4D-Var over a moving window, with outer loops",
    &[&[&BIAS, &ERROR_CORRELATION, &WINDOW_CYCLES, &OUTER_LOOPS], variational::KEYS],
    |section, _| {
        let ThreeDVarSettings { covariance_scale, tolerance, max_iterations } = variational::read(section)?;
        Ok(Box::new(FourDVarSettings {
            window_cycles: section.get(&WINDOW_CYCLES)?,
            outer_loops: section.get(&OUTER_LOOPS)?,
            covariance_scale,
            tolerance,
            max_iterations,
        }))
    },
);

impl MethodSettings for FourDVarSettings {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        Ok(Box::new(FourDVar::new(setup.problem, self.clone())?))
    }

    fn describe(&self) -> String {
        let loops = if self.outer_loops == 1 { "loop" } else { "loops" };
        let (cycles, count, scale) = (self.window_cycles, self.outer_loops, self.covariance_scale);
        format!("4D-Var over {cycles} cycles, {count} outer {loops}, B × {scale}")
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Err("its window analyses earlier observations again")
    }
}
