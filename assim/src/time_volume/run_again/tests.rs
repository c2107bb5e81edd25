//! Cycles that are run again where nothing has moved are what they were.

use super::*;
use crate::covariance::{Sum, Univariate, White};
use crate::fast_kalman::{BiasCoupling, BlockShape, FastKalmanSettings, Precision, Residual};
use crate::time_volume::{Candidate, Corrections, TimeVolumeSettings, tile_patterns};
use crate::{Assimilator, BiasTreatment, Covariance, Problem, Smoother};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{
    Advection, AdvectionScheme, Boundary, Grid, Layout, Model, State, Stepped, TangentLinear, Time, TimeScheme, Wind,
};
use isobar_obs::{Calibration, LinearOperator, ObservationWindow, Report, SparseRows};
use std::sync::Arc;

const WINDOW: Duration = Duration::from_seconds(10_800);
const LAG: usize = 2;

fn grid() -> Grid {
    Grid { nx: 8, ny: 6, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic }
}

fn model(u_m_per_s: f64) -> Stepped<Advection> {
    let wind = Wind::Uniform { u_m_per_s, v_m_per_s: 3.0 };
    let tendency = Advection::new(grid(), &wind, AdvectionScheme::ThirdOrderUpwind).unwrap();
    Stepped::new(tendency, WINDOW, TimeScheme::Rk4).unwrap()
}

struct Winds(Vec<Candidate>);

impl Corrections for Winds {
    fn candidates(&self) -> &[Candidate] {
        &self.0
    }

    fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error> {
        Ok(Arc::new(model(5.0 + corrections[0])))
    }
}

fn volume(selection_threshold: f64) -> TimeVolume {
    let own = model(5.0);
    let layout: Arc<Layout> = own.layout().clone();
    let sum = |sigma: f64| -> Arc<dyn Covariance> {
        let smooth = Box::new(Univariate::new(&layout, 0, sigma, 2e5).unwrap());
        Arc::new(Sum::new(layout.len(), vec![smooth, Box::new(White::new(&layout, 0, 0.1 * sigma))]))
    };
    let problem: Problem = Problem {
        model: Arc::new(own),
        background: State::zeros(&layout).valid_at(Time::from_seconds(0)),
        background_error: sum(1.0),
        model_error: Some(sum(0.1)),
        calibration: Calibration::default(),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
        most_observations: 0,
    };
    let filter = FastKalmanSettings {
        blocks: BlockShape::Domain,
        bias_coupling: BiasCoupling::Carry,
        factors: 0,
        retained_energy: 1.0,
        residual: Residual::Exact,
        largest_component: usize::MAX,
        separator_factors: 0,
        factor_precision: Precision::Double,
    };
    let settings = TimeVolumeSettings {
        filter,
        cycles: 8,
        keep_before: false,
        factors: Vec::new(),
        start: Time::from_seconds(0),
        selection_threshold,
    };
    let patterns = tile_patterns(&grid(), [2, 1]);
    let candidate = Candidate {
        name: "u".into(),
        unit: "m s-1".into(),
        step: 0.05,
        sigma_prior: None,
        patterns,
        moves_with_flow: false,
    };
    let volume = TimeVolume::new(problem, settings, Some(Arc::new(Winds(vec![candidate])))).unwrap();
    volume.smoothing(LAG).unwrap()
}

/// Values that vary from cell to cell and cycle to cycle, of half the cells.
fn observed(volume: &TimeVolume, cycle: usize) -> ObservationWindow {
    let cells = volume.memory.s.state.layout().grid.cells();
    let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
    for row in 0..cells / 2 {
        state.push_row([((2 * row + row / 4 % 2) % cells, 1.0)]);
        calibration.push_row([]);
    }
    let time = Time::from_seconds(cycle as i64 * WINDOW.seconds());
    let report = Report { network: "n".into(), platform: "p".into(), variable: 0, x_m: 0.0, y_m: 0.0, scan: None };
    ObservationWindow {
        time,
        cycle,
        reports: vec![report; cells / 2],
        times: vec![time; cells / 2],
        values: standard_normals(&mut stream(1, &format!("{cycle}")), cells / 2),
        sigma: vec![0.2; cells / 2],
        error_regression: Default::default(),
        aside: Default::default(),
        comparisons: Vec::new(),
        operator: Arc::new(LinearOperator { jacobian: Jacobian { state, calibration } }),
    }
}

fn cycles(volume: &mut TimeVolume, numbers: std::ops::RangeInclusive<usize>) {
    for number in numbers {
        let from = volume.forecast(WINDOW).unwrap();
        volume.analyse(&from, &observed(volume, number)).unwrap();
    }
}

/// All that it believes: state, variances, sensitivities, information of the window, and earlier analyses.
fn believed(volume: &TimeVolume) -> Vec<f64> {
    let Memory { s, sensitivity, window, .. } = &volume.memory;
    let mut all = [s.state.values(), &volume.errors.variances()].concat();
    (0..sensitivity.columns()).for_each(|k| all.extend(sensitivity.state.column(k).iter()));
    let total = window.total();
    (0..total.vector.len()).for_each(|k| all.extend_from_slice(total.matrix.col_as_slice(k)));
    all.extend(total.vector);
    for ago in 0..=LAG {
        let estimate = volume.smoothed(ago).unwrap().unwrap();
        all.extend_from_slice(estimate.state.values());
        all.extend(estimate.state_spread.unwrap());
    }
    all
}

#[test]
fn run_again_where_nothing_has_moved_they_are_what_they_were() {
    // Six cycles are more than half a window of eight: the run goes over a start in the middle.
    let mut volume = volume(f64::INFINITY);
    cycles(&mut volume, 1..=6);
    assert_eq!(volume.memory.history.0.len(), 2);
    let before = believed(&volume);
    let bytes = volume.memory().unwrap();
    volume.settle(vec![0.0; 2]).unwrap();
    assert!(volume.memory().unwrap() == bytes, "what has not moved is not run again");
    volume.run_again().unwrap();
    // As after an analysis.
    volume.remember();
    let largest = before.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    for (after, before) in believed(&volume).iter().zip(&before) {
        assert!((after - before).abs() < 1e-10 * largest, "{after} and not {before}");
    }
}
