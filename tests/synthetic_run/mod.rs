//! A made-up run for the sinks: a vortex drifts through a channel, and each method's errors shrink at its own pace.

use isobar::correlations::Correlations;
use isobar::event::{Analysed, Event, MethodInfo, RunInfo, StationInfo};
use isobar::output::{Sink, SinkError};
use isobar::readings::Readings;
use isobar::scores::stability::{ComparisonNeed, ParameterNeeds, ParameterStability, Stability};
use isobar::scores::{MethodScores, Summary, Values};
use isobar_assim::block_angular::PartitionReport;
use isobar_assim::{Analysis, CommonFactor, Estimate, Structure};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Boundary, Duration, Grid, Increment, Layout, Location, State, Time, Variable};
use isobar_obs::{
    Calibration, Jacobian, LinearOperator, ObservationWindow, Parameter, Placement, Projection, Report, SparseRows,
};
use std::borrow::Cow;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Everything that happened, held so that tests can compare it with what was written.
pub struct SyntheticRun {
    pub info: RunInfo,
    /// For cycles 0 to N.
    pub truth: Vec<State>,
    pub true_calibration: Vec<Vec<f64>>,
    /// For cycles 1 to N.
    pub windows: Vec<ObservationWindow>,
    /// The values of `windows` without their biases.
    pub values_bias_removed: Vec<Vec<f64>>,
    /// For each method, for cycles 1 to N.
    pub results: Vec<Vec<(Estimate, Analysis, MethodScores)>>,
    pub summary: Summary,
}

const METHODS: [(&str, &str, f64, bool); 5] = [
    ("fast_kalman", "Fast Kalman filter, 24 blocks", 0.25, true),
    ("kalman", "extended Kalman filter", 0.3, true),
    ("letkf-40", "LETKF, 40 members", 0.45, true),
    ("3dvar", "3D-Var, static background covariance", 0.6, true),
    ("free", "no observations at all", 1.0, false),
];

impl SyntheticRun {
    pub fn new(nx: usize, ny: usize, cycles: usize, methods: usize) -> Self {
        let info = info(nx, ny, cycles, methods);
        let truth: Vec<State> = (0..=cycles).map(|cycle| vortex(&info, cycle)).collect();
        let true_calibration: Vec<Vec<f64>> =
            (0..=cycles).map(|cycle| vec![12.0, -8.0, 5.0 + 0.05 * cycle as f64, 0.75]).collect();
        let (windows, values_bias_removed): (Vec<_>, Vec<_>) =
            (1..=cycles).map(|cycle| observe(&info, cycle, &truth, &true_calibration)).unzip();
        let results: Vec<Vec<_>> = (0..methods)
            .map(|method| {
                windows
                    .iter()
                    .map(|window| {
                        let cycle = window.cycle;
                        analyse(&info, method, window, &truth[cycle], &true_calibration[cycle])
                    })
                    .collect()
            })
            .collect();
        let last = |method: usize| results[method].last().map(|result| result.2.clone()).unwrap_or_default();
        let summary = Summary {
            scenario: info.scenario.clone(),
            seed: info.seed,
            cycles,
            scored_from_cycle: cycles / 2,
            version: "0.1.0".into(),
            observations: Default::default(),
            methods: (0..methods).map(|method| (info.methods[method].name.clone(), last(method))).collect(),
            ranks: None,
        };
        Self { info, truth, true_calibration, windows, values_bias_removed, results, summary }
    }

    pub fn time(&self, cycle: usize) -> Time {
        self.info.start + Duration::from_seconds(self.info.window.seconds() * cycle as i64)
    }

    /// Tells `sink` all that happened, cycle by cycle.
    pub fn play(&self, sink: &mut dyn Sink) -> Result<(), SinkError> {
        sink.record(&Event::Started(&self.info))?;
        self.play_truth(sink, 0)?;
        for ((window, values_bias_removed), cycle) in self.windows.iter().zip(&self.values_bias_removed).zip(1..) {
            self.play_truth(sink, cycle)?;
            let window = Cow::Borrowed(window);
            sink.record(&Event::Observed { window, values_bias_removed: values_bias_removed.into() })?;
            for (method, results) in self.results.iter().enumerate() {
                let (background, analysis, scores) = &results[cycle - 1];
                let (background, analysis) = (Cow::Borrowed(background), Cow::Borrowed(analysis));
                let scores = Cow::Borrowed(&scores.values);
                let time = self.time(cycle);
                let structure = (method == 0).then(|| self.structure(cycle));
                let structure = structure.map(Cow::Owned);
                let correlations = (method == 0).then(|| self.correlations());
                let correlations = correlations.map(Cow::Owned);
                let unused = Cow::Owned(Default::default());
                let readings = (method == 0).then(|| Cow::Owned(self.readings(cycle)));
                let analysed = Analysed {
                    method,
                    cycle,
                    time,
                    background,
                    analysis,
                    unused,
                    readings,
                    scores,
                    structure,
                    correlations,
                };
                sink.record(&Event::Analysed(analysed))?;
            }
            sink.record(&Event::CycleEnded(cycle))?;
        }
        sink.record(&Event::Finished(&self.summary))
    }

    /// A correction of −0.5 ± 0.25 of everything.
    pub fn readings(&self, cycle: usize) -> Readings {
        let values = &self.windows[cycle - 1].values;
        Readings { values: values.iter().map(|value| value - 0.5).collect(), sigma: vec![0.25; values.len()] }
    }

    /// Columns of cells in pairs, every second pair observed; common factors in odd cycles.
    pub fn structure(&self, cycle: usize) -> Structure {
        let layout = &self.info.layout;
        let parts = layout.grid.nx.div_ceil(2);
        let factor = |number: usize| CommonFactor {
            increment: Increment::from_values(layout, vec![1.0 / (number + 1) as f64; layout.len()]),
            calibration: (0..self.info.calibration.len()).map(|it| if it == number { -7.26 } else { 0.0 }).collect(),
            share: 0.3 / (number + 1) as f64,
        };
        Structure {
            part_of_cell: (0..layout.grid.cells()).map(|cell| cell % layout.grid.nx / 2).collect(),
            observed: (0..parts).map(|part| part % 2 == 0).collect(),
            factors: if cycle % 2 == 1 { vec![factor(0), factor(1)] } else { Vec::new() },
        }
    }

    /// Errors of the eastern half go with that in the middle, those of the western half against it.
    pub fn correlations(&self) -> Correlations {
        let layout = &self.info.layout;
        let sign = |i: usize| if i % layout.grid.nx >= layout.grid.nx / 2 { 0.5 } else { -0.5 };
        Correlations {
            of: Correlations::middle(layout),
            state: (0..layout.len()).map(sign).collect(),
            calibration: (0..self.info.calibration.len()).map(|it| if it == 0 { -0.25 } else { 0.0 }).collect(),
        }
    }

    pub fn play_truth(&self, sink: &mut dyn Sink, cycle: usize) -> Result<(), SinkError> {
        let calibration = self.true_calibration[cycle].iter().copied().map(Some).collect();
        let state = Cow::Borrowed(&self.truth[cycle]);
        sink.record(&Event::Truth { cycle, time: self.time(cycle), state, calibration })
    }
}

fn info(nx: usize, ny: usize, cycles: usize, methods: usize) -> RunInfo {
    let variable = |name, long_name, standard_name, unit, location| Variable {
        name,
        long_name,
        standard_name: Some(standard_name),
        unit,
        location,
    };
    let grid = Grid { nx, ny, dx_m: 250_000.0, dy_m: 250_000.0, boundary: Boundary::Channel };
    let projection = Projection {
        center_latitude_deg: 50.0,
        center_longitude_deg: 10.0,
        false_easting_m: 0.5 * grid.width_m(),
        false_northing_m: 0.5 * grid.height_m(),
    };
    let variables = vec![
        variable("h", "geopotential height", "geopotential_height", "m", Location::Center),
        variable("u", "eastward wind", "eastward_wind", "m s-1", Location::XFace),
        variable("v", "northward wind", "northward_wind", "m s-1", Location::YFace),
    ];
    let parameter = |name: &str, sigma_prior| Parameter {
        name: name.into(),
        unit: "m".into(),
        placement: Placement::Shared,
        sigma_prior,
        drift: isobar_obs::Drift::CONSTANT,
    };
    let parameters = vec![
        parameter("europe/h/FR", 15.0),
        parameter("europe/h/DE", 15.0),
        parameter("polar/constant", 10.0),
        parameter("polar/scan_linear", 5.0),
    ];
    let stations = (0..14).map(|number| StationInfo {
        network: "europe".into(),
        name: format!("{}{:03}", if number % 2 == 0 { "FR" } else { "DE" }, 7 * number + 3).into(),
        group: if number % 2 == 0 { "FR".into() } else { "DE".into() },
        x_m: grid.width_m() * (0.3 + 0.45 * (number as f64 * 0.618).fract()),
        y_m: grid.height_m() * (0.25 + 0.5 * (number as f64 * 0.381).fract()),
    });
    RunInfo {
        scenario: "quickstart".into(),
        title: "A vortex over a channel".into(),
        scenario_text: "title = \"A vortex over a channel\"\nseed = 42\n\n[grid]\nnx = 32\nny = 24\n".into(),
        seed: 42,
        threads: 2,
        has_truth: true,
        truth_file: None,
        keeps_sensors: false,
        lead_times: None,
        warnings: Vec::new(),
        networks: Vec::new(),
        notes: Vec::new(),
        stations: stations.collect(),
        layout: Arc::new(Layout { grid, variables }),
        projection: Some(projection),
        start: Time::from_seconds(1_767_225_600),
        window: Duration::from_seconds(21_600),
        done: 0,
        cycles,
        score_from_cycle: cycles / 2,
        calibration: Calibration { parameters, ..Calibration::default() },
        methods: METHODS[..methods]
            .iter()
            .map(|&(name, description, ..)| MethodInfo {
                name: name.into(),
                description: description.into(),
                smoother_lag_cycles: None,
                estimates_biases: true,
            })
            .collect(),
    }
}

fn vortex(info: &RunInfo, cycle: usize) -> State {
    let mut state = State::zeros(&info.layout);
    let grid = &info.layout.grid;
    let (width, height) = (grid.width_m(), grid.height_m());
    let center = (width * (0.15 + 0.02 * cycle as f64).fract(), height * (0.5 + 0.12 * (cycle as f64 * 0.2).sin()));
    let (radius, depth, jet) = (0.12 * width, 240.0, 18.0);
    for (number, variable) in info.layout.variables.iter().enumerate() {
        for cell in 0..grid.cells() {
            let (x, y) = (grid.x_m(variable.location, cell % grid.nx), grid.y_m(variable.location, cell / grid.nx));
            let dx = (x - center.0 + 1.5 * width).rem_euclid(width) - 0.5 * width;
            let dy = y - center.1;
            let bell = (-(dx * dx + dy * dy) / (2.0 * radius * radius)).exp();
            state.field_mut(number)[cell] = match variable.name {
                "h" => 5500.0 - 150.0 * (TAU * 0.5 * (y / height - 0.5)).sin() - depth * bell,
                "u" => jet * (TAU * 0.5 * y / height).sin() - 25.0 * dy / radius * bell,
                _ => 25.0 * dx / radius * bell,
            };
        }
    }
    state
}

/// The observations of a cycle, and their values without biases.
fn observe(info: &RunInfo, cycle: usize, truth: &[State], calibration: &[Vec<f64>]) -> (ObservationWindow, Vec<f64>) {
    let grid = &info.layout.grid;
    let mut reports = Vec::new();
    let mut jacobian = Jacobian { state: SparseRows::new(), calibration: SparseRows::new() };
    let mut add = |report: Report, bias: Vec<(usize, f64)>| {
        let location = info.layout.variables[report.variable].location;
        let Some(stencil) = grid.stencil(location, report.x_m, report.y_m) else { return };
        let offset = report.variable * grid.cells();
        jacobian.state.push_row(stencil.entries.into_iter().map(|(index, weight)| (offset + index, weight)));
        jacobian.calibration.push_row(bias);
        reports.push(report);
    };
    for station in &info.stations {
        for variable in 0..2 {
            let (network, platform) = (Arc::clone(&station.network), Arc::clone(&station.name));
            let report = Report { network, platform, variable, x_m: station.x_m, y_m: station.y_m, scan: None };
            let group = if &*station.group == "FR" { 0 } else { 1 };
            add(report, if variable == 0 { vec![(group, 1.0)] } else { vec![] });
        }
    }
    for along in 0..8 {
        for across in 0..5 {
            let scan = across as f64 / 2.0 - 1.0;
            let report = Report {
                network: "polar".into(),
                platform: format!("line {along}, spot {across}").into(),
                variable: 0,
                x_m: (grid.width_m() * (0.07 * cycle as f64 + 0.03 * across as f64 + 0.02 * along as f64))
                    .rem_euclid(grid.width_m()),
                y_m: grid.height_m() * (along as f64 + 0.5) / 8.0,
                scan: Some(scan),
            };
            add(report, vec![(2, 1.0), (3, scan)]);
        }
    }
    let unbiased = jacobian.apply(truth[cycle].values(), &[0.0; 4]);
    let biased = jacobian.apply(truth[cycle].values(), &calibration[cycle]);
    let noise = standard_normals(&mut stream(info.seed, &format!("observations {cycle}")), unbiased.len());
    let sigma: Vec<f64> = reports.iter().map(|report| if report.variable == 0 { 4.0 } else { 1.5 }).collect();
    let with_noise = |values: Vec<f64>| (0..values.len()).map(|k| values[k] + sigma[k] * noise[k]).collect::<Vec<_>>();
    let window = ObservationWindow {
        time: info.start + Duration::from_seconds(info.window.seconds() * cycle as i64),
        cycle,
        times: vec![info.start + Duration::from_seconds(info.window.seconds() * cycle as i64); sigma.len()],
        values: with_noise(biased),
        sigma: sigma.clone(),
        reports,
        error_regression: Default::default(),
        aside: Default::default(),
        comparisons: Vec::new(),
        operator: Arc::new(LinearOperator { jacobian }),
    };
    (window, with_noise(unbiased))
}

fn analyse(
    info: &RunInfo,
    method: usize,
    window: &ObservationWindow,
    truth: &State,
    calibration: &[f64],
) -> (Estimate, Analysis, MethodScores) {
    let (_, _, level, has_spread) = METHODS[method];
    let estimate = |stage: &str| {
        let decay = level + (1.0 - level) * (-(window.cycle as f64) / 6.0).exp();
        let size = decay * if stage == "analysis" && has_spread { 0.7 } else { 1.0 };
        let mut random = stream(info.seed, &format!("{method} {} {stage}", window.cycle / 2));
        let mut state = truth.clone();
        let mut spread = vec![0.0; truth.values().len()];
        let grid = &info.layout.grid;
        for (number, unit) in [30.0, 4.0, 4.0].into_iter().enumerate() {
            let waves = standard_normals(&mut random, 12);
            for cell in 0..grid.cells() {
                let (x, y) = (cell % grid.nx, cell / grid.nx);
                let (x, y) = (x as f64 / grid.nx as f64, y as f64 / grid.ny as f64);
                let mut error = 0.0;
                for (k, wave) in waves.chunks(3).enumerate() {
                    let phase = TAU * (wave[1] + (k + 1) as f64 * x);
                    error += wave[0] * phase.sin() * (TAU * 0.5 * (k + 1) as f64 * y + wave[2]).sin();
                }
                state.field_mut(number)[cell] += size * unit * error;
                spread[number * grid.cells() + cell] = size * unit * (1.0 + 0.5 * (TAU * x).cos());
            }
        }
        let errors = standard_normals(&mut random, calibration.len());
        Estimate {
            state,
            calibration: calibration.iter().zip(errors).map(|(bias, error)| bias + 4.0 * decay * error).collect(),
            state_spread: has_spread.then_some(spread),
            calibration_spread: has_spread.then(|| vec![4.0 * decay; calibration.len()]),
        }
    };
    let (background, analysed) = (estimate("background"), estimate("analysis"));
    let departures = |estimate: &Estimate| {
        let simulated = window.operator.simulate(&estimate.state, &estimate.calibration);
        window.values.iter().zip(simulated).map(|(value, simulated)| value - simulated).collect::<Vec<_>>()
    };
    let cells = info.layout.grid.cells();
    let mut values = Values::new();
    let mut insert = |kind: &str, all: &[f64]| {
        for (variable, own) in info.layout.variables.iter().zip(all.chunks_exact(cells)) {
            let mean = own.iter().map(|v| v * v).sum::<f64>() / cells as f64;
            values.insert(format!("{kind}.{}", variable.name), mean.sqrt());
        }
    };
    for (stage, estimate) in [("background", &background), ("analysis", &analysed)] {
        insert(&format!("rmse_{stage}"), (&estimate.state - truth).values());
        if let Some(spread) = &estimate.state_spread {
            insert(&format!("spread_{stage}"), spread);
        }
    }
    if has_spread {
        let others = [("bias_rmse", 2.5 * level), ("bias_spread", 2.6 * level), ("innovation_chi2", 1.0 + 0.1 * level)];
        values.extend(others.map(|(score, value)| (score.to_string(), value)));
    }
    values.extend([("seconds_per_cycle".to_string(), 0.0123), ("peak_memory_bytes".to_string(), 1_500_000.0)]);
    let parameters = info.calibration.parameters.iter().map(|parameter| ParameterStability {
        name: parameter.name.clone(),
        unit: parameter.unit.clone(),
        observations: 12,
        variance_ratio: 0.5,
        lag_correlation: None,
        stable: false,
        frozen: false,
        why: vec!["the observations leave 50 % of its prior variance".into()],
        needs: Some(ParameterNeeds {
            further_cycles: Some(24),
            test_point_sigma: Some(7.5),
            comparison: Some(ComparisonNeed { with: "somewhere/else".into(), sigma: 3.25 }),
            reconfiguration: None,
        }),
    });
    let stability = Stability { parameters: parameters.collect(), ..Stability::default() };
    let scores = MethodScores {
        values,
        stability: Some(stability),
        partition: (method == 0).then_some(PartitionReport {
            blocks: 24,
            components: 3,
            merged_components: 2,
            largest_component_blocks: 9,
            largest_component_variables: 324,
            unobserved_blocks: 7,
            fewest_factors: 3,
            most_factors: 4,
            separators: 2,
            separator_unknowns: 5,
            nested: false,
            border: 4,
        }),
        ..MethodScores::default()
    };
    let analysis = Analysis {
        background_departures: departures(&background),
        analysis_departures: departures(&analysed),
        estimate: analysed,
        innovation_chi2: has_spread.then_some(1.0),
        partition: None,
        warnings: Vec::new(),
    };
    (background, analysis, scores)
}
