//! `kind = "4dvar"`.

use super::work::ITERATIONS;
use super::{
    BIAS, COMPARISONS, ERROR_CORRELATION, FIRST_GUESS, MethodSettings, Setup, Sizes, Surroundings, Work, variational,
};
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
    &[&[&BIAS, &ERROR_CORRELATION, &FIRST_GUESS, &COMPARISONS, &WINDOW_CYCLES, &OUTER_LOOPS], variational::KEYS],
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

    fn work(&self, sizes: &Sizes) -> Work {
        // Every iteration goes through the window forth and back, and the trajectory is stored.
        let [loops, cycles] = [self.outer_loops, self.window_cycles].map(|count| count as f64);
        let iterations = loops * ITERATIONS.min(self.max_iterations as f64);
        let window_steps = cycles * sizes.steps;
        let inner = Work::minimisation(sizes, sizes.controls, iterations);
        let columns = iterations + sizes.biases;
        Work {
            numbers: inner.numbers + sizes.values * (window_steps + 3.0 * (sizes.biases + 1.0)),
            steps: (loops + 1.0) * window_steps,
            tangent_steps: columns * window_steps,
            adjoint_steps: columns * window_steps,
            ..inner
        }
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
