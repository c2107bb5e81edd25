//! The corrected model against the model, and its columns against differences of forecasts.

use super::*;
use crate::time_volume::tiles::tile_patterns;
use crate::time_volume::transition::Transition;
use isobar_model::random::{standard_normals, stream};
use isobar_model::{
    Advection, AdvectionScheme, Boundary, Grid, ShallowWater, ShallowWaterParameters, Stepped, TimeScheme,
    VectorInvariant, Wind,
};

const STEP: Duration = Duration::from_seconds(1800);
const STEPS: usize = 6;

fn grid() -> Grid {
    Grid { nx: 12, ny: 8, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic }
}

/// The model with these corrections of its parameters.
type Build = fn(&[f64]) -> Result<Arc<dyn TangentLinear>, Error>;

struct Family {
    candidates: Vec<Candidate>,
    build: Build,
}

impl Corrections for Family {
    fn candidates(&self) -> &[Candidate] {
        &self.candidates
    }

    fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error> {
        (self.build)(corrections)
    }
}

fn transition(steps: [f64; 2], tiles: Option<[usize; 2]>, build: Build) -> Transition {
    let candidate = |step: f64| Candidate {
        name: format!("{step}"),
        unit: "1".into(),
        step,
        sigma_prior: None,
        patterns: tiles.map_or(Vec::new(), |tiles| tile_patterns(&grid(), tiles)),
        moves_with_flow: false,
    };
    let family = Family { candidates: steps.map(candidate).to_vec(), build };
    Transition::new(Arc::new(family), &grid()).unwrap()
}

/// A tracer in a uniform wind (10, 0) m/s, whose components are the candidates.
fn winds(tiles: Option<[usize; 2]>) -> Transition {
    transition([0.05, 0.05], tiles, |r| {
        let wind = Wind::Uniform { u_m_per_s: 10.0 + r[0], v_m_per_s: r[1] };
        let tendency = Advection::new(grid(), &wind, AdvectionScheme::FourthOrderCentred).unwrap();
        Ok(Arc::new(Stepped::new(tendency, STEP, TimeScheme::Rk4).unwrap()))
    })
}

/// Nonlinear shallow water, with gravity and the Coriolis parameter as candidates.
fn water(tiles: Option<[usize; 2]>) -> Transition {
    transition([0.01, 1e-7], tiles, |r| {
        let parameters =
            ShallowWaterParameters { gravity_m_per_s2: 9.8 + r[0], coriolis_per_s: 1e-4 + r[1], ..Default::default() };
        let tendency = ShallowWater::new(grid(), parameters, VectorInvariant::Energy).unwrap();
        Ok(Arc::new(Stepped::new(tendency, Duration::from_seconds(300), TimeScheme::Rk4).unwrap()))
    })
}

fn random_state(transition: &Transition, seed: u64) -> State {
    let layout = transition.model().layout().clone();
    let mut values = standard_normals(&mut stream(seed, "state"), layout.len());
    if layout.variables.len() == 3 {
        values[..layout.grid.cells()].iter_mut().for_each(|h| *h = 1000.0 + 10.0 * *h);
    }
    State::from_values(&layout, values)
}

fn relative_difference(a: &[f64], b: &[f64]) -> f64 {
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|value| value * value).sum::<f64>().sqrt();
    norm(&mut a.iter().zip(b).map(|(a, b)| a - b)) / norm(&mut b.iter().copied())
}

/// Derivative of the forecast by an amplitude, by differences of whole forecasts.
fn difference(transition: &Transition, r: &[f64], k: usize, step: f64, x: &State) -> Vec<f64> {
    let forecast_with = |sign: f64| {
        let (mut moved, mut own, mut state) = (r.to_vec(), transition.clone(), x.clone());
        moved[k] += sign * step;
        own.set(&moved).unwrap();
        forecast::forecast(&*own.model(), &mut state, STEPS).unwrap();
        state
    };
    let (above, below) = (forecast_with(1.0), forecast_with(-1.0));
    above.values().iter().zip(below.values()).map(|(above, below)| (above - below) / (2.0 * step)).collect()
}

/// With the same amplitude in all tiles the model is the one that is corrected everywhere, and the tiles' columns sum to
/// its column, the derivative of the whole forecast.
#[test]
fn tiles_that_are_all_corrected_alike_are_the_whole() {
    for (whole, tiles, r) in [
        (winds(None), winds(Some([3, 2])), [1.5, -1.0]),
        (water(None), water(Some([3, 2])), [0.3, 1e-5]),
        (winds(None), winds(Some([1, 1])), [1.5, -1.0]),
    ] {
        let (mut whole, mut tiles, x) = (whole.clone(), tiles.clone(), random_state(&whole, 1));
        let n = tiles.amplitudes.len() / 2;
        whole.set(&r).unwrap();
        tiles.set(&(0..2 * n).map(|k| r[k / n]).collect::<Vec<_>>()).unwrap();
        let forecast_by = |transition: &Transition| {
            let mut state = x.clone();
            forecast::forecast(&*transition.model(), &mut state, STEPS).unwrap();
            state.values().to_vec()
        };
        assert!(relative_difference(&forecast_by(&tiles), &forecast_by(&whole)) < 1e-13);
        let (of_whole, of_tiles) = (whole.columns(&x, STEPS).unwrap(), tiles.columns(&x, STEPS).unwrap());
        for candidate in 0..2 {
            let mut sum = vec![0.0; x.values().len()];
            for k in 0..n {
                let column = of_tiles.column(candidate * n + k);
                sum.iter_mut().zip(column.iter()).for_each(|(sum, value)| *sum += value);
            }
            let column = of_whole.column(candidate);
            assert!(relative_difference(&sum, &column) < 1e-11);
            let step = whole.family.candidates()[candidate].step;
            let expected = difference(&whole, &r, candidate, step, &x);
            assert!(relative_difference(&column, &expected) < 1e-5);
        }
    }
}

/// At no correction the columns are exact; where the correction varies in space a part of second order is left out.
#[test]
fn a_column_is_the_derivative_of_the_corrected_forecast() {
    for (mut tiles, size) in [(winds(Some([3, 2])), 1.0), (water(Some([3, 2])), 0.1)] {
        let x = random_state(&tiles, 2);
        let n = tiles.amplitudes.len();
        let steps: Vec<f64> = tiles.amplitudes.iter().map(|it| tiles.candidate(it).step).collect();
        let varied: Vec<f64> = (0..n).map(|k| size * steps[k] / steps[0] * ((k % 3) as f64 - 1.0)).collect();
        for (r, tolerance) in [(vec![0.0; n], 1e-5), (varied, 0.03)] {
            tiles.set(&r).unwrap();
            let columns = tiles.columns(&x, STEPS).unwrap();
            for (k, &step) in steps.iter().enumerate() {
                let off = relative_difference(&columns.column(k), &difference(&tiles, &r, k, step, &x));
                assert!(off < tolerance, "{k}: {off}");
            }
        }
    }
}

#[test]
fn the_tangent_linear_is_the_derivative_of_a_step() {
    let mut water = water(Some([3, 2]));
    water
        .set(&(0..12).map(|k| if k < 6 { 0.2 * k as f64 } else { 1e-5 * (k % 2) as f64 }).collect::<Vec<_>>())
        .unwrap();
    let model = water.model();
    let (x, change) = (random_state(&water, 3), random_state(&water, 4));
    let change: Vec<f64> = change.values().iter().map(|value| (value % 10.0) * 1e-2).collect();
    let mut expected = change.clone();
    model.step_tl(&x, &mut expected);
    let error = |size: f64| {
        let with = |sign: f64| {
            let mut state = x.clone();
            state.values_mut().iter_mut().zip(&change).for_each(|(value, change)| *value += sign * size * change);
            model.step(&mut state);
            state
        };
        let (above, below) = (with(1.0), with(-1.0));
        let differences = above.values().iter().zip(below.values());
        let found: Vec<f64> = differences.map(|(above, below)| (above - below) / (2.0 * size)).collect();
        relative_difference(&found, &expected)
    };
    // Central differences have an error of second order.
    let slope = (error(100.0) / error(10.0)).log10();
    assert!((slope - 2.0).abs() < 0.1, "{slope}");
}
