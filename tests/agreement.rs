//! With one block over the domain and the biases' covariance carried, the Fast Kalman Filter *is* the Kalman filter: on
//! every scenario that is small enough, with its biases and without.

use crate::runs::{run_options, scenarios, with_methods};
use isobar::event::Event;
use isobar::output::{Sink, SinkError};
use isobar_assim::Estimate;

/// The largest state for which this takes seconds, with the biases estimated and without them.
const MOST_VALUES: [usize; 2] = [2000, 1000];

/// From here on two cycles are enough.
const LARGE: usize = 1000;

/// Backgrounds and analyses of each method.
#[derive(Default)]
struct Estimates {
    of_method: [Vec<Estimate>; 2],
}

impl Sink for Estimates {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        if let Event::Analysed(analysed) = event {
            let own = &mut self.of_method[analysed.method];
            own.extend([analysed.background.clone().into_owned(), analysed.analysis.estimate.clone()]);
        }
        Ok(())
    }
}

fn relative_difference(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    found.iter().zip(expected).map(|(a, b)| (a - b).abs() / largest).fold(0.0, f64::max)
}

#[test]
fn one_block_equals_the_kalman_filter_on_every_small_scenario() {
    let mut compared = 0;
    for scenario in scenarios() {
        let values = scenario.model.variables().len() * scenario.grid.grid.cells();
        for (bias, most) in ["estimate", "ignore"].into_iter().zip(MOST_VALUES) {
            if values > most {
                continue;
            }
            let methods = format!(
                "kf = {{ kind = \"kf\", bias = \"{bias}\", memory_limit_gb = 4 }}\n\
                 fkf = {{ kind = \"fkf\", bias = \"{bias}\", blocks = \"domain\", memory_limit_gb = 4 }}"
            );
            let scenario = with_methods(&scenario, &methods);
            let directory = tempfile::tempdir().unwrap();
            let mut estimates = Estimates::default();
            // The fourth cycle is the second with soundings where they come every other cycle; two of a larger state take as long.
            let cycles = if values > LARGE { 2 } else { 4 };
            isobar::run::run(&scenario, &run_options(directory.path(), cycles), &mut estimates).unwrap();
            let [expected, found] = &estimates.of_method;
            assert_eq!((expected.len(), found.len()), (2 * cycles, 2 * cycles));
            for (expected, found) in expected.iter().zip(found) {
                let state = relative_difference(found.state.values(), expected.state.values());
                let spread =
                    relative_difference(found.state_spread.as_ref().unwrap(), expected.state_spread.as_ref().unwrap());
                assert!(state < 1e-8 && spread < 1e-8, "{}, {bias}: {state:e}, {spread:e}", scenario.name);
                if let (Some(found), Some(expected)) = (&found.calibration_spread, &expected.calibration_spread) {
                    let spread = relative_difference(found, expected);
                    assert!(spread < 1e-8, "{}, {bias}: biases' spread {spread:e}", scenario.name);
                }
            }
            compared += 1;
        }
    }
    assert!(compared >= 6, "only {compared} comparisons");
}
