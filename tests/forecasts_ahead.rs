//! Forecasts ahead of the analyses: what they are, what they claim, and that nothing else depends on them.

use crate::ahead::{Listener, TRACER, listen, parse};
use crate::runs::run_options;
use isobar::kinds::covariances;
use isobar::options::{CheckpointPolicy, RunOptions};
use isobar::output::Outputs;
use isobar::run::experiment::Experiment;
use isobar::run::{RunError, run};
use isobar::scenario::Scenario;
use isobar::scores::VerifiedBy;
use isobar::scores::forecast::{DEPARTURE, RMSE, SPREAD, SPREAD_PER_ERROR, STANDARDISED_DEPARTURE};
use isobar_assim::free::FreeRun;
use isobar_assim::{Analysis, Assimilator, Background, Error, Unknown};
use isobar_model::{Duration, State, forecast::forecast};
use isobar_obs::ObservationWindow;
use netcdf_reader::NcFile;
use std::collections::BTreeMap;
use std::fs;
use std::io::{Read, Write};

const FORECAST: &str = "[forecast]\nlead_hours = 36\nevery_hours = 12\n";
const EVERY_CYCLE: &str = "[forecast]\nlead_hours = 18\n";

const WARNING: &str = "[[warnings]]\nname = \"much\"\nvariable = \"tracer\"\nabove = 1\nprobability = 0.5\n";

const METHODS: &str = r#"
[methods.kf]
kind = "kf"
smoother_lag_cycles = 2
[methods.serial]
kind = "serial_kf"
[methods.fkf]
kind = "fkf"
blocks = "cell"
factors = 6
[methods.var]
kind = "3dvar"
[methods.four]
kind = "4dvar"
window_cycles = 2
[methods.adaptive]
kind = "kf"
adapt = { observation_error = true, model_error = true }
[methods.letkf]
kind = "letkf"
members = 8
localization_radius_km = 400
[methods.free]
kind = "free"
"#;

/// diag(A^k P A^kᵀ + Σ A^i Q A^iᵀ), computed densely, is what the Kalman filter claims at each lead time.
#[test]
fn the_claimed_spread_is_that_of_the_dense_recursion() {
    let scenario = parse(&[TRACER, FORECAST, "[methods.kf]\nkind = \"kf\"\n"]);
    let (listener, summary) = listen(&scenario);
    let folder = tempfile::tempdir().unwrap();
    let options = run_options(folder.path(), scenario.cycle.count);
    let mut experiment = Experiment::builder(&scenario).build(&options).unwrap();
    let window = scenario.cycle.window;
    let layout = experiment.info.layout.clone();
    let m = layout.len();
    let model = scenario.model.build(&scenario.grid.grid, window).unwrap();
    let steps = window.steps_of(model.time_step()).unwrap();
    let columns: Vec<Vec<f64>> = (0..m)
        .map(|j| {
            let mut unit = State::from_values(&layout, (0..m).map(|i| f64::from(u8::from(i == j))).collect());
            forecast(&*model, &mut unit, steps).unwrap();
            unit.values().to_vec()
        })
        .collect();
    let times_a = |p: &[Vec<f64>]| -> Vec<Vec<f64>> {
        // Rows of A P: (A P)_ij = Σ_k A_ik P_kj.
        (0..m).map(|i| (0..m).map(|j| (0..m).map(|k| columns[k][i] * p[k][j]).sum()).collect()).collect()
    };
    let transposed = |p: &[Vec<f64>]| -> Vec<Vec<f64>> { (0..m).map(|i| (0..m).map(|j| p[j][i]).collect()).collect() };
    let q = covariances::build(&scenario.model_error, &layout).unwrap();
    let mut compared = 0;
    for cycle in 1..=scenario.cycle.count {
        experiment.truth.as_mut().unwrap().advance().unwrap();
        let state = experiment.truth.as_ref().unwrap().state().clone();
        let observed = experiment.observing.observe_checked(Some((&state).into()), None);
        let runner = &mut experiment.methods[0].runner;
        let analysis = runner.cycle(window, &observed, false, false).unwrap().analysis.estimate;
        let Some((first, _)) = listener.forecasts.get(&(0, cycle, 0)) else { continue };
        assert_eq!(*first, analysis, "lead time 0 is the analysis");
        let errors = runner.method().can().joint_errors.unwrap();
        let column = |j| errors.covariance_column(Unknown::Value(j)).unwrap();
        let mut p: Vec<Vec<f64>> =
            (0..m).map(column).map(|own| (0..m).map(|i| own.with(Unknown::Value(i))).collect()).collect();
        for lead in 1..=6 {
            p = times_a(&transposed(&times_a(&p)));
            for (i, row) in p.iter_mut().enumerate() {
                row.iter_mut().enumerate().for_each(|(j, value)| *value += q.covariance(i, j));
            }
            let Some((forecast, _)) = listener.forecasts.get(&(0, cycle, lead)) else { continue };
            for (i, sigma) in forecast.state_spread.as_ref().unwrap().iter().enumerate() {
                assert!(
                    (sigma * sigma / p[i][i] - 1.0).abs() < 1e-9,
                    "cycle {cycle}, lead {lead}: {sigma}² is not {}",
                    p[i][i]
                );
                compared += 1;
            }
        }
    }
    // Starts 3 to 14, of which those to 8 reach 36 h, those to 10 24 h, and those to 12 12 h.
    assert_eq!(compared, m * (6 + 8 + 10));
    let forecasts = summary.methods["kf"].forecasts.as_ref().unwrap();
    assert_eq!(forecasts.leads.iter().map(|lead| lead.cases).collect::<Vec<_>>(), [12, 10, 8, 6]);
    assert_eq!((forecasts.verified_by, forecasts.failed), (VerifiedBy::Truth, 0));
    let last = forecasts.at(36.0).unwrap();
    assert_eq!(summary.methods["kf"].values["rmse_forecast.tracer"], last.score(RMSE, "tracer").unwrap().value);
}

/// A forecast over one cycle is the background of the next, to the bit, whatever the method; and so are its scores.
#[test]
fn a_forecast_of_one_cycle_is_the_next_background() {
    let scenario = parse(&[TRACER, EVERY_CYCLE, METHODS]);
    let (listener, summary) = listen(&scenario);
    for (number, name) in scenario.methods.keys().enumerate() {
        let mut squares = Vec::new();
        for cycle in 4..=14 {
            let (background, _, scores) = &listener.analysed[&(number, cycle)];
            let (forecast, own) = &listener.forecasts[&(number, cycle - 1, 1)];
            assert!(forecast == background, "{name}, cycle {cycle}");
            assert_eq!(own["rmse.tracer"], scores["rmse_background.tracer"], "{name}, cycle {cycle}");
            assert_eq!(own.get("spread.tracer"), scores.get("spread_background.tracer"), "{name}, cycle {cycle}");
            squares.push(own["rmse.tracer"].powi(2));
        }
        let forecasts = summary.methods[name].forecasts.as_ref().unwrap();
        let lead = forecasts.at(6.0).unwrap();
        let rmse = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!((lead.score(RMSE, "tracer").unwrap().value / rmse - 1.0).abs() < 1e-12, "{name}");
        let (spread, ratio) = (lead.score(SPREAD, "tracer"), lead.score(SPREAD_PER_ERROR, "tracer"));
        assert_eq!(spread.is_some(), ratio.is_some(), "{name}");
        if let Some((spread, ratio)) = spread.zip(ratio) {
            assert!((ratio.value * rmse / spread.value - 1.0).abs() < 1e-12, "{name}");
        }
    }
}

/// Without observations a forecast from any analysis is the one from the beginning.
#[test]
fn the_free_run_has_the_errors_of_its_background_at_all_lead_times() {
    let scenario = parse(&[TRACER, FORECAST, METHODS]);
    let (listener, _) = listen(&scenario);
    let free = scenario.methods.get_index_of("free").unwrap();
    let mut compared = 0;
    for ((_, from, lead), (forecast, scores)) in listener.forecasts.iter().filter(|(key, _)| key.0 == free) {
        let (background, _, own) = &listener.analysed[&(free, from + lead)];
        assert!(forecast == background, "from {from}, lead {lead}");
        assert_eq!(scores["rmse.tracer"], own["rmse_background.tracer"]);
        compared += 1;
    }
    assert_eq!(compared, 12 + 10 + 8 + 6);
}

#[test]
fn nothing_else_depends_on_them() {
    let [with, without] = [FORECAST, ""].map(|forecast| listen(&parse(&[TRACER, forecast, METHODS])));
    assert!(with.0.analysed == without.0.analysed && without.0.forecasts.is_empty());
    for (name, own) in &without.1.methods {
        let other = &with.1.methods[name];
        assert!(own.forecasts.is_none() && other.forecasts.is_some(), "{name}");
        for (key, value) in
            own.values.iter().filter(|(key, _)| !["seconds_per_cycle", "peak_memory_bytes"].contains(&key.as_str()))
        {
            assert_eq!(*value, other.values[key], "{name}, {key}");
        }
        assert_eq!((&own.diagnostics, &own.stability), (&other.diagnostics, &other.stability), "{name}");
    }
}

/// A run that ends in a cycle and goes on writes the same files, those of forecasts that were under way included.
#[test]
fn an_interruption_changes_no_bit() {
    let scenario = parse(&[TRACER, FORECAST, WARNING, METHODS]);
    let files = |end: Option<usize>| -> BTreeMap<String, Vec<u8>> {
        let folder = tempfile::tempdir().unwrap();
        let options = RunOptions {
            threads: Some(1),
            outputs: Outputs::of(["netcdf"]),
            checkpoints: Some(CheckpointPolicy { minutes: None, cycles: Some(2) }),
            ..run_options(folder.path(), scenario.cycle.count)
        };
        if end.is_some() {
            let stopped = run(&scenario, &options, &mut Listener { end, ..Listener::default() });
            assert!(matches!(stopped, Err(RunError::Sink(_))));
        }
        let options = RunOptions { resume: end.is_some(), ..options };
        run(&scenario, &options, &mut Listener::default()).unwrap();
        let out = folder.path().join("run");
        let of_forecasts = |name: &str| name.ends_with(".nc") || name == "forecasts.csv" || name.starts_with("warning");
        let names = fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.filter(|name| of_forecasts(name)).map(|name| (name.clone(), fs::read(out.join(name)).unwrap())).collect()
    };
    let whole = files(None);
    assert_eq!(whole.len(), 2 * scenario.methods.len() + 5);
    for end in [6, 11] {
        assert!(whole == files(Some(end)), "{end}");
    }
}

/// Forecasts in worlds without a truth: departures are those of the observations of the valid time, used or passive.
#[test]
fn without_a_truth_observations_verify() {
    let scenario = r#"
        title = "t"
        phenomenon = "p"
        source = "s"
        seed = 1
        start = "2026-01-15T00:00:00Z"
        grid = { nx = 9, ny = 6, dx_km = 100, boundary = "periodic" }
        initial = { kind = "cosine_wave", amplitude = 1, waves_x = 2 }
        [model]
        kind = "advection"
        time_step_s = 3600
        wind = { kind = "uniform", u_m_per_s = 9, v_m_per_s = 4 }
        [background_error]
        components = [{ kind = "univariate", variable = "tracer", sigma = 0.5, length_km = 200 }]
        [model_error]
        components = [{ kind = "univariate", variable = "tracer", sigma = 0.15, length_km = 200 }]
        [cycle]
        count = 8
        window_hours = 6
        [forecast]
        lead_hours = 12
        [methods.kf]
        kind = "kf"
        [methods.free]
        kind = "free"
        [networks.stations]
        kind = "file"
        file = "observations.csv"
    "#;
    let folder = tempfile::tempdir().unwrap();
    let mut rows = "cycle,x_m,y_m,variable,value,sigma,id\n".to_string();
    for cycle in 1..=8 {
        for (number, id) in ["A", "B", "C"].iter().enumerate() {
            let (x, value) = (50e3 + 3e5 * number as f64, (0.7 * f64::from(cycle) + number as f64).sin());
            rows += &format!("{cycle},{x},150e3,tracer,{value},0.2,{id}\n");
        }
    }
    fs::write(folder.path().join("observations.csv"), rows).unwrap();
    let path = folder.path().join("s.toml");
    let passive =
        format!("{scenario}\n[networks.check]\nkind = \"file\"\nfile = \"observations.csv\"\nassimilate = false\n");
    for (text, by) in [(scenario, VerifiedBy::UsedObservations), (passive.as_str(), VerifiedBy::PassiveObservations)] {
        let (listener, summary) = listen(&Scenario::parse(&path, text).unwrap());
        let mut squares: BTreeMap<(usize, usize), Vec<[f64; 2]>> = BTreeMap::new();
        for ((method, from, lead), (estimate, _)) in &listener.forecasts {
            let window = &listener.observed[&(from + lead)];
            // Both networks observe the same places, which are grid points.
            let simulated = window.operator.simulate(&estimate.state, &estimate.calibration);
            let rows = window.operator.linearize(&estimate.state, &estimate.calibration).state;
            for (row, value) in window.values.iter().enumerate() {
                let &[(index, weight)] = rows.row(row) else { panic!("the stations are at grid points") };
                let spread = estimate.state_spread.as_ref().map_or(0.0, |spread| weight * spread[index]);
                let square = (value - simulated[row]).powi(2);
                squares.entry((*method, *lead)).or_default().push([square, square / (spread * spread + 0.04)]);
            }
        }
        for (number, name) in ["kf", "free"].into_iter().enumerate() {
            let forecasts = summary.methods[name].forecasts.as_ref().unwrap();
            assert_eq!(forecasts.verified_by, by);
            for (lead, scores) in forecasts.leads.iter().enumerate() {
                let own = &squares[&(number, lead)];
                let mean = |part: usize| own.iter().map(|it| it[part]).sum::<f64>() / own.len() as f64;
                let found = scores.score(DEPARTURE, "tracer").unwrap().value;
                assert!((found / mean(0).sqrt() - 1.0).abs() < 1e-12, "{name}, lead {lead}: {found}");
                match scores.score(STANDARDISED_DEPARTURE, "tracer") {
                    Some(known) => {
                        assert!((known.value / mean(1) - 1.0).abs() < 1e-12, "{name}, lead {lead}: {known:?}")
                    }
                    None => assert_eq!(name, "free"),
                }
                assert!(scores.score(RMSE, "tracer").is_none());
            }
            let last = forecasts.at(12.0).unwrap().score(DEPARTURE, "tracer").unwrap().value;
            assert_eq!(summary.methods[name].values["departure_forecast.tracer"], last);
        }
    }
}

/// Fields and scores in the file are those that were computed, with lead time and reference time.
#[test]
fn the_netcdf_file_holds_the_last_complete_forecast_and_all_scores() {
    let scenario = parse(&[TRACER, FORECAST, METHODS]);
    let folder = tempfile::tempdir().unwrap();
    let options = RunOptions {
        outputs: Outputs::of(["netcdf", "report", "rerun"]),
        ..run_options(folder.path(), scenario.cycle.count)
    };
    let mut listener = Listener::default();
    let summary = run(&scenario, &options, &mut listener).unwrap();
    let file = NcFile::open(folder.path().join("run/kf_forecast.nc")).unwrap();
    let numbers = |name: &str| -> Vec<f64> { file.read_variable::<f64>(name).unwrap().iter().copied().collect() };
    assert_eq!(numbers("lead_time"), [0.0, 12.0, 24.0, 36.0]);
    let info = listener.info.as_ref().unwrap();
    assert_eq!(numbers("forecast_reference_time"), [info.time(8).seconds() as f64]);
    assert_eq!(numbers("time"), [8, 10, 12, 14].map(|cycle| info.time(cycle).seconds() as f64));
    let expected = [0, 2, 4, 6].map(|lead| listener.forecasts[&(0, 8, lead)].0.state.values().to_vec()).concat();
    assert_eq!(numbers("tracer_forecast"), expected);
    let forecasts = summary.methods["kf"].forecasts.as_ref().unwrap();
    let rmse = forecasts.leads.iter().map(|lead| lead.score(RMSE, "tracer").unwrap().value).collect::<Vec<_>>();
    assert_eq!((numbers("rmse_tracer"), numbers("cases")), (rmse.clone(), vec![12.0, 10.0, 8.0, 6.0]));
    let csv = fs::read_to_string(folder.path().join("run/forecasts.csv")).unwrap();
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines.len(), 1 + 4 * scenario.methods.len());
    assert!(
        lines[0].starts_with("method,lead_hours,variable,unit,cases,rmse,rmse_low,rmse_high,spread,"),
        "{}",
        lines[0]
    );
    assert!(lines[4].starts_with(&format!("kf,36,tracer,1,6,{},", rmse[3])), "{}", lines[4]);
    let page = fs::read_to_string(folder.path().join("run/report.html")).unwrap();
    assert!(page.contains("Forecasts ahead") && page.contains("12 cases at 0 h, 6 at 36 h"));
    assert!(folder.path().join("run/figures/forecast_tracer.svg").is_file());
    assert!(folder.path().join("run/figures/forecast_anomaly_tracer.svg").is_file());
}

/// The free run, but for its third forecast without an analysis, which fails.
#[derive(Clone)]
struct Weary(FreeRun, usize);

impl Assimilator for Weary {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        self.1 += 1;
        if self.1 > 2 { Err(Error::NotFinite { what: "the third forecast".into() }) } else { self.0.forecast(window) }
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        self.1 = 0;
        self.0.analyse(from, observed)
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        self.0.save(to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        self.0.recall(from)
    }
}

/// A forecast ahead that fails is no failure of the method: what was made before counts, and the rest is said.
#[test]
fn a_forecast_that_fails_ends_there_and_the_method_goes_on() {
    let scenario = parse(&[TRACER, EVERY_CYCLE, "[methods.free]\nkind = \"free\"\n"]);
    let folder = tempfile::tempdir().unwrap();
    let options = run_options(folder.path(), scenario.cycle.count);
    let experiment = Experiment::builder(&scenario);
    let experiment = experiment.method("weary", "it tires", |problem| Ok(Weary(FreeRun::new(problem), 0)));
    let mut listener = Listener::default();
    let summary = experiment.run(&options, &mut listener).unwrap();
    let [free, weary] = ["free", "weary"].map(|name| &summary.methods[name]);
    assert_eq!((&weary.failure, weary.values["rmse_analysis.tracer"]), (&None, free.values["rmse_analysis.tracer"]));
    let [of_free, of_weary] = [free, weary].map(|scores| scores.forecasts.as_ref().unwrap());
    // Starts from 3 to 11 have room for a third cycle.
    assert_eq!((of_free.failed, of_weary.failed), (0, 9));
    assert_eq!((of_free.leads.len(), &of_free.leads[..3]), (4, &of_weary.leads[..]));
    assert!(!weary.values.contains_key("rmse_forecast.tracer"));
    assert_eq!(listener.warnings.len(), 1);
    let said = "method weary: a forecast ahead of cycle 3 cannot be made to its end: the third forecast is not finite; said of";
    assert!(listener.warnings[0].starts_with(said), "{}", listener.warnings[0]);
    let table = isobar::tables::scores::on_terminal(&summary, &[("tracer", "1")], 100);
    assert!(table.contains("weary: 9 forecasts could not be made to their end"), "{table}");
}
