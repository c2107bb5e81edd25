//! How the tendencies of a model are integrated in time.

use crate::reader::{Absent, AnyKey, Choice, Integer, Key, Limits, Read, Section};
use isobar_model::{
    Adjoint, Duration, Forced, Forcing, Leapfrog, ModelError, RestartedLeapfrog, Stepped, Tendency, TimeScheme,
};
use std::sync::Arc;

/// How a model is integrated in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Integration {
    /// By a scheme that needs one state only.
    Stepped(TimeScheme),
    /// Leapfrog, begun anew with an Euler step in every cycle.
    Leapfrog {
        /// α of Robert's filter.
        robert_filter: f64,
    },
}

const LEAPFROG: Integration = Integration::Leapfrog { robert_filter: ROBERT_FILTER_DEFAULT };

const ROBERT_FILTER_DEFAULT: f64 = 0.01;

const TIME_SCHEME: Key<Choice<Integration>> = Key::absent(
    "time_scheme",
    "",
    Choice(&[
        ("rk4", Integration::Stepped(TimeScheme::Rk4)),
        ("ssp_rk3", Integration::Stepped(TimeScheme::SspRk3)),
        ("leapfrog", LEAPFROG),
    ]),
    Absent::Means(Integration::Stepped(TimeScheme::Rk4)),
    "how the equations are integrated in time; leapfrog begins anew in every cycle",
);

const ROBERT_FILTER: Key<Limits> = Key::absent(
    "robert_filter",
    "",
    Limits::Between(0.0, 0.5),
    Absent::Means(ROBERT_FILTER_DEFAULT),
    "α of Robert's filter, with leapfrog only",
);

pub(super) const TIME_STEP_S: Key<Integer> = Key::required("time_step_s", "s", Integer(1, 86_400), "time step");

/// The keys of the integration.
pub(super) const KEYS: &[&dyn AnyKey] = &[&TIME_SCHEME, &ROBERT_FILTER];

/// The key of the time scheme, for a key that belongs to one of the schemes.
pub(super) fn of_scheme(key: &str) -> Option<&'static str> {
    (key == ROBERT_FILTER.name).then_some(TIME_SCHEME.name)
}

/// Reads how a model is integrated in time.
pub(super) fn read(section: &Section<'_>) -> Read<Integration> {
    let robert_filter = section.get(&ROBERT_FILTER)?;
    match (section.get(&TIME_SCHEME)?, section.optional(ROBERT_FILTER.name)) {
        (Integration::Leapfrog { .. }, _) => Ok(Integration::Leapfrog { robert_filter }),
        (scheme, None) => Ok(scheme),
        (_, Some(field)) => {
            let help = "add time_scheme = \"leapfrog\", or leave it out";
            Err(field.misplaced("only leapfrog has this filter".into(), help))
        }
    }
}

impl Integration {
    /// A tendency with this scheme, for cycles of this length, and a forcing.
    pub fn of<T: Tendency + 'static>(
        self,
        tendency: T,
        time_step: Duration,
        cycle: Duration,
        forcing: &Arc<Forcing>,
    ) -> Result<Arc<dyn Adjoint>, ModelError> {
        match self {
            Integration::Stepped(scheme) => Forced::of(Arc::new(Stepped::new(tendency, time_step, scheme)?), forcing),
            Integration::Leapfrog { robert_filter } => {
                let steps = cycle.steps_of(time_step).expect("the scenario's cycle fits its steps");
                let leapfrog = RestartedLeapfrog::new(Leapfrog::new(tendency, time_step, robert_filter)?, steps)?;
                Ok(Arc::new(leapfrog.forced(Arc::clone(forcing))?))
            }
        }
    }
}
