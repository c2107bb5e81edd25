//! The claimed uncertainty of corrections of tiles, over many truths with a jet that the model does not have.

use crate::common::{parameters, volume_settings};
use isobar_assim::covariance::{Sum, Univariate, White, randomize};
use isobar_assim::time_volume::{Candidate, Corrections, TimeVolume, tile_patterns};
use isobar_assim::{Assimilator, BiasTreatment, Covariance, Error, Problem};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{
    Advection, AdvectionScheme, Boundary, Duration, Grid, Model, State, Stepped, TangentLinear, Time, TimeScheme, Wind,
    forecast,
};
use isobar_obs::{Calibration, Jacobian, LinearOperator, ObservationWindow, Report, SparseRows};
use rand::seq::SliceRandom;
use rayon::prelude::*;
use std::sync::Arc;

const WINDOW: Duration = Duration::from_seconds(10_800);
const STEP: Duration = Duration::from_seconds(1800);
/// Of the four tiles in the jet.
const TRUTH: f64 = 4.0;

fn grid() -> Grid {
    Grid { nx: 24, ny: 6, dx_m: 1e5, dy_m: 2e5, boundary: Boundary::Periodic }
}

fn model(wind: &Wind) -> Stepped<Advection> {
    let tendency = Advection::new(grid(), wind, AdvectionScheme::ThirdOrderUpwind).unwrap();
    Stepped::new(tendency, STEP, TimeScheme::Rk4).unwrap()
}

fn uniform(u_m_per_s: f64) -> Stepped<Advection> {
    model(&Wind::Uniform { u_m_per_s, v_m_per_s: 0.0 })
}

struct Winds([Candidate; 1]);

impl Corrections for Winds {
    fn candidates(&self) -> &[Candidate] {
        &self.0
    }

    fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error> {
        Ok(Arc::new(uniform(20.0 + corrections[0])))
    }
}

fn observe(places: &[usize], truth: &State, cycle: usize, noise: &[f64]) -> ObservationWindow {
    let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
    for &place in places {
        state.push_row([(place, 1.0)]);
        calibration.push_row([]);
    }
    let time = Time::from_seconds(cycle as i64 * WINDOW.seconds());
    let report = Report { network: "n".into(), platform: "p".into(), variable: 0, x_m: 0.0, y_m: 0.0, scan: None };
    ObservationWindow {
        time,
        cycle,
        reports: vec![report; places.len()],
        times: vec![time; places.len()],
        values: places.iter().zip(noise).map(|(&place, noise)| truth.values()[place] + 0.1 * noise).collect(),
        sigma: vec![0.1; places.len()],
        error_regression: Default::default(),
        aside: Default::default(),
        comparisons: Vec::new(),
        operator: Arc::new(LinearOperator { jacobian: Jacobian { state, calibration } }),
    }
}

/// What is found of the tiles after some cycles.
#[derive(Default)]
struct Found {
    /// (estimate − truth)/σ of each tile in the jet that is chosen.
    chosen: Vec<f64>,
    /// The same of all tiles that are estimated, in the jet or not.
    estimated: Vec<f64>,
}

/// After some numbers of cycles.
fn found<const N: usize>(seed: u64, observations: usize, after: [usize; N]) -> [Found; N] {
    let own = uniform(20.0);
    let layout = own.layout().clone();
    let sum = |sigma: f64, white: f64| -> Arc<dyn Covariance> {
        let smooth = Box::new(Univariate::new(&layout, 0, sigma, 3e5).unwrap());
        Arc::new(Sum::new(layout.len(), vec![smooth, Box::new(White::new(&layout, 0, white))]))
    };
    let (background_error, model_error) = (sum(1.0, 0.02), sum(0.05, 0.005));
    let random = &mut stream(seed, "truth");
    let mut truth = State::from_values(&layout, randomize(&*background_error, random));
    let mut places: Vec<usize> = (0..layout.len()).collect();
    places.shuffle(random);
    places.truncate(observations);
    let problem: Problem = Problem {
        model: Arc::new(own),
        background: State::zeros(&layout).valid_at(Time::from_seconds(0)),
        background_error,
        model_error: Some(Arc::clone(&model_error)),
        calibration: Calibration::default(),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
        most_observations: 0,
    };
    let patterns = tile_patterns(&grid(), [4, 2]);
    let candidate = Candidate {
        name: "u".into(),
        unit: "m s-1".into(),
        step: 0.1,
        sigma_prior: None,
        patterns,
        moves_with_flow: false,
    };
    let family = Arc::new(Winds([candidate]));
    let mut volume = TimeVolume::new(problem, volume_settings(20, Vec::new()), Some(family)).unwrap();
    let jet = Wind::Jet { u_m_per_s: 20.0, jet_m_per_s: TRUTH, center_y_m: 3e5, half_width_m: 6e5 };
    let (jet, mut cycle) = (model(&jet), 0);
    after.map(|count| {
        while cycle < count {
            cycle += 1;
            forecast::forecast(&jet, &mut truth, 6).unwrap();
            let error = randomize(&*model_error, random);
            truth.values_mut().iter_mut().zip(error).for_each(|(value, error)| *value += error);
            let observed = observe(&places, &truth, cycle, &standard_normals(random, observations));
            let from = volume.forecast(WINDOW).unwrap();
            volume.analyse(&from, &observed).unwrap();
        }
        let mut found = Found::default();
        for (number, tile) in parameters(&volume).iter().enumerate() {
            let Some(sigma) = tile.sigma else { continue };
            let z = (tile.value - if number < 4 { TRUTH } else { 0.0 }) / sigma;
            found.estimated.push(z);
            if number < 4 && tile.verdict == "determined" {
                found.chosen.push(z);
            }
        }
        found
    })
}

/// Over many seeds, with some number of observations in each cycle: how many tiles in the jet are chosen, and the root mean square of
/// z of those, and of all that are estimated.
fn scores<const N: usize>(observations: usize, after: [usize; N]) -> [(usize, f64, f64); N] {
    let root_mean_square = |z: &[f64]| (z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64).sqrt();
    let all: Vec<_> = (0..SEEDS).into_par_iter().map(|seed| found(seed, observations, after)).collect();
    std::array::from_fn(|number| {
        let of_all = |own: fn(&Found) -> &Vec<f64>| -> Vec<f64> {
            all.iter().flat_map(|of_seed| own(&of_seed[number])).copied().collect()
        };
        let (chosen, estimated) = (of_all(|it| &it.chosen), of_all(|it| &it.estimated));
        let scores = (chosen.len(), root_mean_square(&chosen), root_mean_square(&estimated));
        println!("{observations} observations, {} cycles: {scores:?} (chosen, their rms, rms of all)", after[number]);
        scores
    })
}

const SEEDS: u64 = 30;

/// A tile that is not chosen although it is wrong would make the σ of its neighbours too small, if it were held at zero, and so does
/// what has been linearised about another estimate. Early not all tiles are chosen that are wrong.
#[test]
fn the_claimed_sigma_of_tiles_is_right() {
    let [early, later @ ..] = scores(60, [10, 20, 30]);
    for (tiles, chosen, estimated) in [early].into_iter().chain(later) {
        assert!((0.8..1.2).contains(&chosen) && (0.8..1.2).contains(&estimated), "{tiles} {chosen} {estimated}");
    }
    assert!(early.0 as f64 > 0.9 * 4.0 * SEEDS as f64, "{early:?}");
    assert!(later.iter().all(|it| it.0 as f64 > 0.97 * 4.0 * SEEDS as f64), "{later:?}");
}

/// With half of the observations a tile is often chosen late, and those that stand out first do so by chance as well: their claims
/// are too small by a quarter at first. Held at zero, or with the likeliest σ², the others would make that a factor of 1.8.
#[test]
fn with_few_observations_the_claimed_sigma_becomes_right() {
    let [early, later @ ..] = scores(30, [10, 20, 30]);
    assert!(early.1 < 1.4 && early.2 < 1.4, "{early:?}");
    for (tiles, chosen, estimated) in later {
        assert!((0.8..1.25).contains(&chosen) && (0.8..1.25).contains(&estimated), "{tiles} {chosen} {estimated}");
        assert!(tiles as f64 > 0.8 * 4.0 * SEEDS as f64, "{later:?}");
    }
}
