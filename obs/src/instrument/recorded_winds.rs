//! Winds of recorded observations, which are turned to the axes of the plane.

use super::recorded_held::{Held, Seen};
use crate::observation_file::{ObservationPlace, ObservationRecord, ValidTime};
use crate::projection::Projection;
use isobar_model::Layout;
use std::collections::HashMap;
use std::sync::Arc;

/// Winds whose components are to the east and to the north, which are turned to the axes of the plane.
pub(super) struct Winds {
    /// Numbers of the variables u and v; `None` if nothing is turned.
    components: Option<[usize; 2]>,
    /// The components of each wind: numbers in the list of observations.
    together: HashMap<Wind, [Vec<usize>; 2]>,
}

/// What the components of one wind have in common: time, place, standard deviation and station; numbers as bits.
#[derive(PartialEq, Eq, Hash)]
struct Wind {
    valid: (bool, i64),
    latitude_deg: u64,
    longitude_deg: u64,
    sigma: u64,
    id: Option<Arc<str>>,
}

impl Wind {
    /// Degrees north and degrees east.
    fn place(&self) -> (f64, f64) {
        (f64::from_bits(self.latitude_deg), f64::from_bits(self.longitude_deg))
    }
}

impl Winds {
    /// No winds yet. `are_turned`: whether components at latitudes and longitudes are to the east and to the north.
    pub fn new(are_turned: bool, layout: &Layout) -> Self {
        let components = layout.variable("u").zip(layout.variable("v")).filter(|_| are_turned).map(|(u, v)| [u, v]);
        Self { components, together: HashMap::new() }
    }

    /// Takes an observation, if it is a component of a wind on the Earth.
    pub fn add(&mut self, record: &ObservationRecord, variable: usize, sigma: f64, number: usize) {
        let component = self.components.and_then(|components| components.iter().position(|own| *own == variable));
        let (Some(component), ObservationPlace::Geographic { latitude_deg, longitude_deg }) = (component, record.place)
        else {
            return;
        };
        let valid = match record.valid {
            ValidTime::Cycle(cycle) => (true, cycle as i64),
            ValidTime::Time(time) => (false, time.seconds()),
        };
        let [latitude_deg, longitude_deg, sigma] = [latitude_deg, longitude_deg, sigma].map(f64::to_bits);
        let wind = Wind { valid, latitude_deg, longitude_deg, sigma, id: record.id.clone() };
        self.together.entry(wind).or_default()[component].push(number);
    }

    /// Turns both components of a wind to the axes of the plane, with their biases. Of a single one, or of two that are not
    /// equally accurate, the row of X is that of the component to the east or to the north.
    pub fn turn(&self, observations: &mut [Held], layout: &Layout, projection: &Projection) {
        let Some(components) = self.components else { return };
        for (wind, numbers) in &self.together {
            let (latitude_deg, longitude_deg) = wind.place();
            let (sin, cos) = projection.north(latitude_deg, longitude_deg).sin_cos();
            let (&[u], &[v]) = (&numbers[0][..], &numbers[1][..]) else {
                for (numbers, weights) in numbers.iter().zip([[cos, -sin], [sin, cos]]) {
                    let turned = [0, 1].map(|component| (components[component], weights[component]));
                    let all = numbers.iter().copied();
                    all.for_each(|number| observations[number].see(Seen::Turned(Box::new(turned)), layout));
                }
                continue;
            };
            let [east, north] = [u, v].map(|number| observations[number].value);
            let biases = [u, v].map(|number| observations[number].biases.entries());
            // Biases are those of the components that were reported, and one without the other says nothing of the turned ones.
            let lacks_predictor = [u, v].iter().any(|&number| observations[number].lacks_predictor);
            for (number, weights) in [(u, [cos, sin]), (v, [-sin, cos])] {
                let observation = &mut observations[number];
                observation.value = east * weights[0] + north * weights[1];
                observation.lacks_predictor = lacks_predictor;
                let turned = biases.iter().zip(weights);
                let turned = turned.flat_map(|(row, weight)| row.iter().map(move |&(column, g)| (column, weight * g)));
                observation.biases = turned.filter(|entry| entry.1 != 0.0).collect();
            }
        }
    }
}
