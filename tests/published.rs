//! Scenarios of which others published the results.

use crate::runs::run_options;
use isobar::event::Event;
use isobar::exact::{ExactOptions, exact};
use isobar::output::{Sink, SinkError};
use isobar::run::experiment::ground;
use isobar::scenario::Scenario;
use std::f64::consts::TAU;
use std::path::Path;

/// Root-mean-square errors and spreads of a cycle: background error, analysis error, background spread, analysis spread.
type Row = [f64; 4];

/// The rows of every cycle, method by method; NaN for a spread that is not claimed.
struct Rows(Vec<Vec<Row>>);

impl Sink for Rows {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        if let Event::Analysed(analysed) = event {
            let of = |kind: &str| analysed.scores.get(&format!("{kind}.tracer")).copied().unwrap_or(f64::NAN);
            let row = ["rmse_background", "rmse_analysis", "spread_background", "spread_analysis"].map(of);
            self.0[analysed.method].push(row);
        }
        Ok(())
    }
}

fn scenario(name: &str) -> Scenario {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios");
    Scenario::load(&folder.join(name).with_extension("toml")).unwrap()
}

/// The first cycles of each method, by its name.
fn run(scenario: &Scenario, cycles: usize) -> impl Fn(&str) -> Vec<Row> + use<> {
    let directory = tempfile::tempdir().unwrap();
    let mut rows = Rows(vec![Vec::new(); scenario.methods.len()]);
    isobar::run::run(scenario, &run_options(directory.path(), cycles), &mut rows).unwrap();
    let names: Vec<String> = scenario.methods.keys().cloned().collect();
    move |name| rows.0[names.iter().position(|own| own == name).unwrap()].clone()
}

fn assert_near(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() < 1e-9, "{what}: {found}, not {expected}");
}

/// What PDAF's own Kalman filter and 3D-Var have at steps 2, 4, 6 and 8.
#[test]
fn the_tutorial_of_pdaf_is_reproduced() {
    const KALMAN: [Row; 4] = [
        [1.1427980925, 0.2222098802, 0.5763665074, 0.1274504710],
        [0.2222098802, 0.1597772911, 0.1274504710, 0.0921794277],
        [0.1597772911, 0.1174993870, 0.0921794277, 0.0758717192],
        [0.1174993870, 0.0447735125, 0.0758717192, 0.0659772996],
    ];
    const THREE_D_VAR: [f64; 4] = [0.1895037147, 0.1091882222, 0.1261198146, 0.1738813328];
    let rows = run(&scenario("pdaf_2d"), 4);
    for name in ["kf", "fkf", "etkf", "letkf"] {
        let found = rows(name);
        assert_eq!(found.len(), 4);
        for (cycle, (found, expected)) in found.iter().zip(KALMAN).enumerate() {
            (0..4).for_each(|i| assert_near(found[i], expected[i], &format!("{name}, cycle {}, {i}", cycle + 1)));
        }
    }
    for name in ["var", "oi"] {
        for (cycle, (found, expected)) in rows(name).iter().zip(THREE_D_VAR).enumerate() {
            assert_near(found[1], expected, &format!("{name}, cycle {}", cycle + 1));
        }
    }
}

/// √(trace P/100) of the first analyses of DAPPER's `LA/small`: what the filters claim, and the exact error of the filter.
#[test]
fn linear_advection_has_the_covariances_of_dapper() {
    const FORECAST: [f64; 5] = [1.0, 0.556651770483, 0.250783941054, 0.136383112529, 0.088745978029];
    const ANALYSIS: [f64; 5] = [0.556651770483, 0.250783941054, 0.136383112529, 0.088745978029, 0.074622938178];
    let scenario = scenario("linear_advection");
    let rows = run(&scenario, 5);
    for name in ["kf", "fkf", "etkf"] {
        for (cycle, found) in rows(name).iter().enumerate() {
            assert_near(found[2], FORECAST[cycle], &format!("{name}, cycle {}, background", cycle + 1));
            assert_near(found[3], ANALYSIS[cycle], &format!("{name}, cycle {}, analysis", cycle + 1));
        }
    }
    let mean = |values: &[f64]| (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt();
    for cycles in 1..=5 {
        let options = ExactOptions { methods: Some(vec!["kf".into(), "fkf".into()]), cycles: Some(cycles) };
        for (name, scores) in exact(&scenario, &options).unwrap().methods {
            assert_near(
                scores["rmse_background.tracer"],
                mean(&FORECAST[..cycles]),
                &format!("{name}, {cycles} cycles"),
            );
            assert_near(scores["rmse_analysis.tracer"], mean(&ANALYSIS[..cycles]), &format!("{name}, {cycles} cycles"));
        }
    }
}

/// |g|² of a wave in one step of the Runge–Kutta scheme of fourth order, g = 1 + z + z²/2 + z³/6 + z⁴/24, where upwind
/// differences of first order have z = −c_x (1 − e^(−iθ)) − c_y (1 − e^(−iφ)).
fn damping(courant: [f64; 2], phase: [f64; 2]) -> f64 {
    let z: (f64, f64) = (0..2)
        .fold((0.0, 0.0), |(re, im), i| (re - courant[i] * (1.0 - phase[i].cos()), im - courant[i] * phase[i].sin()));
    let (mut power, mut g) = ((1.0, 0.0), (1.0, 0.0));
    for divisor in 1..=4 {
        let (re, im) = (power.0 * z.0 - power.1 * z.1, power.0 * z.1 + power.1 * z.0);
        power = (re / f64::from(divisor), im / f64::from(divisor));
        g = (g.0 + power.0, g.1 + power.1);
    }
    g.0 * g.0 + g.1 * g.1
}

/// Daley and Ménard (1993): the filter's variances are the means of those that a scalar Riccati equation has for each wave.
#[test]
fn a_fully_observed_plane_decouples_into_waves() {
    let scenario = scenario("fully_observed");
    let grid = &scenario.grid.grid;
    let (nx, ny, r) = (grid.nx, grid.ny, 0.25);
    let courant = [9.0 * 3600.0 / grid.dx_m, 4.0 * 3600.0 / grid.dy_m];
    let model_error = ground(&scenario, scenario.seed, 1).unwrap().problem.model_error.unwrap();
    let row: Vec<f64> = (0..nx * ny).map(|cell| model_error.covariance(0, cell)).collect();
    let (mut background, mut analysis) = (0.0, 0.0);
    for (k, l) in (0..ny).flat_map(|l| (0..nx).map(move |k| (k, l))) {
        let phase = |cell: usize| TAU * ((k * (cell % nx)) as f64 / nx as f64 + (l * (cell / nx)) as f64 / ny as f64);
        let q: f64 = row.iter().enumerate().map(|(cell, covariance)| covariance * phase(cell).cos()).sum();
        let m2 = damping(courant, [TAU * k as f64 / nx as f64, TAU * l as f64 / ny as f64]).powi(6);
        let b = q - r * (1.0 - m2);
        let p = 0.5 * (b + (b * b + 4.0 * q * r).sqrt());
        background += p / (nx * ny) as f64;
        analysis += p * r / (p + r) / (nx * ny) as f64;
    }
    let options = ExactOptions { methods: Some(vec!["kf".into()]), cycles: None };
    let scores = &exact(&scenario, &options).unwrap().methods["kf"];
    assert_near(scores["rmse_background.tracer"], background.sqrt(), "background");
    assert_near(scores["rmse_analysis.tracer"], analysis.sqrt(), "analysis");
    assert_near(scores["spread_analysis.tracer"], analysis.sqrt(), "claimed");
}
