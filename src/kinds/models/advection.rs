//! `kind = "advection"`.

use super::equations::Equations;
use super::integration::{self, Integration, TIME_STEP_S};
use super::parameter::{ADVECTION_X, ADVECTION_Y, Parameter, SPEED, flow, northward, speed_or_zero};
use crate::kinds::{Kind, Kinds, form, read};
use crate::reader::{Absent, Choice, Described, Key, Limits};
use isobar_model::{Adjoint, Advection, AdvectionScheme, Duration, Forcing, Grid, ModelError, State, Wind};
use std::sync::Arc;

const WIND: Key<Described> = Key::required(
    "wind",
    "",
    Described("a table of kind \"uniform\", \"vortex\" or \"jet\"", || form(WINDS)),
    "the wind that advects the tracer",
);

const SCHEME: Key<Choice<AdvectionScheme>> = Key::absent(
    "scheme",
    "",
    Choice(&[
        ("first_order_upwind", AdvectionScheme::FirstOrderUpwind),
        ("third_order_upwind", AdvectionScheme::ThirdOrderUpwind),
        ("fourth_order_centred", AdvectionScheme::FourthOrderCentred),
    ]),
    Absent::Means(AdvectionScheme::ThirdOrderUpwind),
    "how advection is discretised in space",
);

const U: Key<Limits> =
    Key::required("u_m_per_s", "m/s", SPEED, "eastward component of a uniform wind, or of the wind beside a jet");

const V: Key<Limits> = speed_or_zero("v_m_per_s", "northward component of a uniform wind; 0 in a channel");

const VORTEX_SPEED: Key<Limits> =
    Key::required("speed_m_per_s", "m/s", SPEED, "largest eastward wind of a vortex; clockwise if positive");

const JET: Key<Limits> =
    Key::required("jet_m_per_s", "m/s", SPEED, "by how much the wind is stronger in the middle of the jet");

const CENTER_Y: Key<Limits> =
    Key::required("center_y_km", "km", Limits::Between(-1e5, 1e5), "distance of the jet from the southern edge");

const HALF_WIDTH: Key<Limits> =
    Key::required("half_width_km", "km", Limits::Positive, "distance from its middle at which the jet ends");

#[derive(Clone, Debug)]
struct AdvectionSettings {
    wind: Wind,
    scheme: AdvectionScheme,
    integration: Integration,
}

pub(super) const KIND: Kind<dyn Equations, Grid> = Kind::new(
    "advection",
    "Advection of a tracer by a given wind",
    &[&[&TIME_STEP_S, &WIND, &SCHEME], integration::KEYS],
    |section, grid| {
        Ok(Box::new(AdvectionSettings {
            wind: *read(&section.required(WIND.name)?, WINDS, grid)?,
            scheme: section.get(&SCHEME)?,
            integration: integration::read(section)?,
        }))
    },
);

const WINDS: &Kinds<Wind, Grid> = &[&UNIFORM_WIND, &VORTEX_WIND, &JET_WIND];

const UNIFORM_WIND: Kind<Wind, Grid> =
    Kind::new("uniform", "The same wind everywhere", &[&[&U, &V]], |section, grid| {
        let v_m_per_s = northward(section, &V, grid)?;
        Ok(Box::new(Wind::Uniform { u_m_per_s: section.get(&U)?, v_m_per_s }))
    });

const VORTEX_WIND: Kind<Wind, Grid> = Kind::new(
    "vortex",
    "A vortex about the middle of the domain, at rest at its edges",
    &[&[&VORTEX_SPEED]],
    |section, _| Ok(Box::new(Wind::Vortex { speed_m_per_s: section.get(&VORTEX_SPEED)? })),
);

const JET_WIND: Kind<Wind, Grid> = Kind::new(
    "jet",
    "An eastward wind with a jet, the same at all x",
    &[&[&U, &JET, &CENTER_Y, &HALF_WIDTH]],
    |section, _| {
        Ok(Box::new(Wind::Jet {
            u_m_per_s: section.get(&U)?,
            jet_m_per_s: section.get(&JET)?,
            center_y_m: 1e3 * section.get(&CENTER_Y)?,
            half_width_m: 1e3 * section.get(&HALF_WIDTH)?,
        }))
    },
);

/// The variables of models of a tracer.
pub(super) const VARIABLES: &[(&str, &str)] = &[("tracer", "1")];

impl Equations for AdvectionSettings {
    fn variables(&self) -> &[(&'static str, &'static str)] {
        VARIABLES
    }

    fn build(
        &self,
        grid: &Grid,
        time_step: Duration,
        cycle: Duration,
        forcing: &Arc<Forcing>,
    ) -> Result<Arc<dyn Adjoint>, ModelError> {
        self.integration.of(Advection::new(grid.clone(), &self.wind, self.scheme)?, time_step, cycle, forcing)
    }

    fn boxed_clone(&self) -> Box<dyn Equations> {
        Box::new(self.clone())
    }

    fn is_linear(&self) -> bool {
        true
    }

    fn mean_flow(&self, grid: &Grid, _: &State) -> [f64; 2] {
        let Ok((u, v)) = self.wind.at_faces(grid) else { return [0.0; 2] };
        [u, v].map(|wind| wind.iter().sum::<f64>() / wind.len() as f64)
    }

    fn fastest_m_per_s(&self, grid: &Grid, _: &State) -> f64 {
        let Ok((u, v)) = self.wind.at_faces(grid) else { return 0.0 };
        let largest = |wind: &[f64]| wind.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        largest(&u).hypot(largest(&v))
    }

    /// A wind that depends on place, at the western and southern faces of the cells.
    fn parameter_field(&self, grid: &Grid, name: &str) -> Option<Vec<f64>> {
        let (u, v) = self.wind.at_faces(grid).ok()?;
        [(ADVECTION_X, u), (ADVECTION_Y, v)].into_iter().find(|(parameter, _)| parameter.name == name).map(|it| it.1)
    }

    fn parameters(&mut self, grid: &Grid) -> Vec<(Parameter, &mut f64)> {
        match &mut self.wind {
            Wind::Uniform { u_m_per_s, v_m_per_s } => flow(u_m_per_s, v_m_per_s, grid),
            Wind::Jet { u_m_per_s, .. } => vec![(ADVECTION_X, u_m_per_s)],
            Wind::Vortex { .. } => Vec::new(),
        }
    }
}
