//! Winds of recorded observations, which are turned to the axes of the plane.

use crate::observation::Observation;
use crate::observation_file::{ObservationPlace, ObservationRecord};
use crate::projection::Projection;
use crate::report::Report;
use crate::state_operator::StateOperator;
use isobar_model::Layout;
use std::collections::HashMap;

/// Winds whose components are to the east and to the north, which are turned to the axes of the plane.
pub(super) struct Winds {
    /// Numbers of the variables u and v; `None` if nothing is turned.
    components: Option<[usize; 2]>,
    /// The components of one time, place, station and standard deviation: number in the list of observations, and place.
    together: HashMap<String, [Vec<usize>; 2]>,
    places: HashMap<usize, (f64, f64)>,
}

impl Winds {
    /// No winds yet. `are_turned`: whether components at latitudes and longitudes are to the east and to the north.
    pub fn new(are_turned: bool, layout: &Layout) -> Self {
        let components = layout.variable("u").zip(layout.variable("v")).filter(|_| are_turned).map(|(u, v)| [u, v]);
        Self { components, together: HashMap::new(), places: HashMap::new() }
    }

    /// Takes an observation, if it is a component of a wind on the Earth.
    pub fn add(&mut self, record: &ObservationRecord, variable: usize, sigma: f64, number: usize) {
        let component = self.components.and_then(|components| components.iter().position(|own| *own == variable));
        let (Some(component), ObservationPlace::Geographic { latitude_deg, longitude_deg }) = (component, record.place)
        else {
            return;
        };
        let key = format!("{:?} {latitude_deg} {longitude_deg} {sigma} {:?}", record.valid, record.id);
        self.together.entry(key).or_default()[component].push(number);
        self.places.insert(number, (latitude_deg, longitude_deg));
    }

    /// Turns both components of a wind to the axes of the plane, with their biases. Of a single one, or of two that are not
    /// equally accurate, the row of X is that of the component to the east or to the north.
    pub fn turn(&self, observations: &mut [(usize, Observation)], layout: &Layout, projection: &Projection) {
        let Some(components) = self.components else { return };
        for (number, &(latitude_deg, longitude_deg)) in &self.places {
            let (sin, cos) = projection.north(latitude_deg, longitude_deg).sin_cos();
            let observation = &mut observations[*number].1;
            let is_u = observation.report.variable == components[0];
            let weights = if is_u { [cos, -sin] } else { [sin, cos] };
            let (x_m, y_m) = (observation.report.x_m, observation.report.y_m);
            let turned = (components.iter().zip(weights))
                .flat_map(|(&variable, weight)| {
                    row(layout, variable, x_m, y_m).into_iter().map(move |(index, entry)| (index, weight * entry))
                })
                .filter(|entry| entry.1 != 0.0)
                .collect();
            observation.state = StateOperator::Linear(turned);
        }
        for [u, v] in self.together.values() {
            let (&[u], &[v]) = (&u[..], &v[..]) else { continue };
            let (latitude_deg, longitude_deg) = self.places[&u];
            let (sin, cos) = projection.north(latitude_deg, longitude_deg).sin_cos();
            let [east, north] = [u, v].map(|number| observations[number].1.reading.value());
            let biases = [u, v].map(|number| std::mem::take(&mut observations[number].1.calibration_row));
            // Biases are those of the components that were reported, and one without the other says nothing of the turned ones.
            let lacks_predictor = [u, v].iter().any(|&number| observations[number].1.reading.lacks_predictor());
            for (number, weights) in [(u, [cos, sin]), (v, [-sin, cos])] {
                let observation = &mut observations[number].1;
                let Report { variable, x_m, y_m, .. } = observation.report;
                observation.reading.set_value(east * weights[0] + north * weights[1]);
                observation.reading.set_lacks_predictor(lacks_predictor);
                let turned = biases.iter().zip(weights);
                let turned = turned.flat_map(|(row, weight)| row.iter().map(move |&(column, g)| (column, weight * g)));
                observation.calibration_row = turned.filter(|entry| entry.1 != 0.0).collect();
                observation.state = StateOperator::Linear(row(layout, variable, x_m, y_m));
            }
        }
    }
}

/// The row of X of a variable at a point of the plane; empty outside of the domain.
pub(super) fn row(layout: &Layout, variable: usize, x_m: f64, y_m: f64) -> Vec<(usize, f64)> {
    layout.interpolation(variable, x_m, y_m).unwrap_or_default()
}
