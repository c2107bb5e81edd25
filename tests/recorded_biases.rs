//! Biases of recorded observations: estimated as those of any network, and of an unknown truth everywhere.

use crate::common::{CARRIED_TRACER, TRACER, isobar, text};
use crate::runs::run_options;
use faer::prelude::Solve;
use faer::{Mat, Side};
use isobar::event::Event;
use isobar::output::{Sink, SinkError};
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use isobar_assim::Estimate;
use isobar_assim::covariance::{Univariate, dense};
use isobar_model::{Boundary, Grid, Layout, Location, Variable};
use netcdf_reader::NcFile;
use std::collections::HashMap;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use tempfile::{TempDir, tempdir};

const FILL_VALUE: f64 = 9.96921e36;

/// What happens in a run.
#[derive(Default)]
struct Heard {
    /// Of each method, cycle after cycle.
    analyses: Vec<Vec<Estimate>>,
    /// Cycle after cycle from the start.
    truths: Vec<Vec<Option<f64>>>,
    parameters: Vec<String>,
    /// The groups of stations.
    groups: HashMap<String, String>,
    /// The observations as a file of them.
    csv: String,
}

impl Sink for Heard {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Started(info) => {
                self.analyses = vec![Vec::new(); info.methods.len()];
                self.parameters = info.calibration.parameters.iter().map(|it| it.name.clone()).collect();
                self.csv = "cycle,x_m,y_m,value,sigma,id,group\n".into();
                self.groups = info.stations.iter().map(|it| (it.name.to_string(), it.group.to_string())).collect();
            }
            Event::Truth { calibration, .. } => self.truths.push(calibration.to_vec()),
            Event::Observed { window, .. } => {
                for ((report, value), sigma) in window.reports.iter().zip(&window.values).zip(&window.sigma) {
                    let (x, y, id) = (report.x_m, report.y_m, &*report.platform);
                    let group = self.groups.get(id).map_or("none", String::as_str);
                    writeln!(self.csv, "{},{x},{y},{value},{sigma},{id},{group}", window.cycle).unwrap();
                }
            }
            Event::Analysed(it) => self.analyses[it.method].push(it.analysis.estimate.clone()),
            _ => {}
        }
        Ok(())
    }
}

/// Runs a scenario whose file of observations is `csv`, with a seed; what is heard, and the summary.
fn heard(scenario: &str, csv: &str, seed: u64) -> (Heard, Summary) {
    let directory = tempdir().unwrap();
    fs::write(directory.path().join("buoys.csv"), csv).unwrap();
    let scenario = Scenario::parse(&directory.path().join("s.toml"), scenario).unwrap();
    let mut heard = Heard::default();
    let options =
        isobar::options::RunOptions { seed: Some(seed), ..run_options(directory.path(), scenario.cycle.count) };
    let summary = isobar::run::run(&scenario, &options, &mut heard).unwrap();
    (heard, summary)
}

/// A directory in which `isobar ARGUMENTS` has run, and what it said, as one line.
fn command(arguments: &[&str], scenario: &str, csv: &str) -> (TempDir, bool, String) {
    let directory = tempdir().unwrap();
    fs::write(directory.path().join("s.toml"), scenario).unwrap();
    fs::write(directory.path().join("buoys.csv"), csv).unwrap();
    let output = isobar(directory.path(), arguments);
    let said = (text(&output.stdout) + &text(&output.stderr)).replace(['│', '×'], " ");
    (directory, output.status.success(), said.split_whitespace().collect::<Vec<_>>().join(" "))
}

fn numbers(file: &Path, variable: &str) -> Vec<f64> {
    NcFile::open(file).unwrap().read_variable::<f64>(variable).unwrap().iter().copied().collect()
}

const STILL: &str = r#"
[networks.buoys]
kind = "file"
file = "buoys.csv"
"#;

const KALMAN: &str = "[methods]\nkf = { kind = \"kf\" }\nfkf = { kind = \"fkf\", blocks = \"domain\" }\n";

fn difference(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    found.iter().zip(expected).map(|(a, b)| (a - b).abs() / largest).fold(0.0, f64::max)
}

/// In a world at rest the last analysis is the least-squares estimate of the state, of constant biases of stations, and of
/// the last value of a coefficient that changes, from the observations of all cycles: `ẑ = P Hᵀ (H P Hᵀ + R)⁻¹ y` with the
/// unknowns z = (x, c, β_1, β_2, β_3), whose prior has `Cov(β_s, β_t) = σ² + σ_w² min(s, t) Δt` for a random walk and
/// `σ² exp(−|s − t| Δt/τ)` for an AR(1) process.
#[test]
fn estimates_are_those_of_least_squares_with_the_biases_as_unknowns() {
    assert_least_squares("{ kind = \"random_walk\", sigma_per_sqrt_day = 0.7 }", |s, t| {
        2.25 + 0.49 * s.min(t) as f64 * 0.25
    });
    assert_least_squares("{ kind = \"ar1\", correlation_hours = 20 }", |s, t| {
        2.25 * (-6.0 * s.abs_diff(t) as f64 / 20.0).exp()
    });
}

fn assert_least_squares(evolution: &str, covariance: impl Fn(usize, usize) -> f64) {
    const ROWS: [(usize, usize, usize, f64, &str, f64); 12] = [
        (1, 3, 2, 2.5, "A", 10.0),
        (1, 7, 5, -1.0, "B", -35.0),
        (1, 4, 2, 0.3, "R", 0.0),
        (1, 6, 6, 1.1, "M", 40.0),
        (2, 3, 2, 2.9, "A", 55.0),
        (2, 7, 5, -0.4, "B", 3.0),
        (2, 4, 2, 0.1, "R", 9.0),
        (2, 9, 4, 0.8, "M", -15.0),
        (3, 3, 2, 2.2, "A", -8.0),
        (3, 7, 5, -1.7, "B", 21.0),
        (3, 12, 9, 0.6, "R", 2.0),
        (3, 2, 10, -0.2, "M", 27.0),
    ];
    let mut csv = String::from("cycle,column,row,value,id,scan_angle,remark\n");
    for (cycle, column, row, value, id, angle) in ROWS {
        writeln!(csv, "{cycle},{column},{row},{value},{id},{angle},x").unwrap();
    }
    let network = format!(
        "{STILL}sigma = 0.4\nreference_stations = [\"R\"]\n\
         [[networks.buoys.bias]]\nper = \"station\"\nvariable = \"tracer\"\nsigma = 2\n\
         [[networks.buoys.bias]]\nterm = \"column\"\ncolumn = \"scan_angle\"\nmean = 10\nscale = 20\nvariable = \"tracer\"\n\
         sigma = 1.5\nevolution = {evolution}\n"
    );
    let scenario = format!("{}{network}{KALMAN}", TRACER.replace("count = 1", "count = 3"));
    let (heard, _) = heard(&scenario, &csv, 1);
    let names = ["A", "B", "M", "scan_angle"].map(|name| format!("buoys/tracer/{name}"));
    assert_eq!(heard.parameters, names);

    let grid = Grid { nx: 16, ny: 12, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
    let cells = grid.cells();
    let tracer =
        Variable { name: "tracer", long_name: "tracer", standard_name: None, unit: "1", location: Location::Center };
    let of_state = dense(&Univariate::new(&Layout { grid, variables: vec![tracer] }, 0, 1.0, 2e5).unwrap());
    let unknowns = cells + 3 + 3;
    let prior = Mat::from_fn(unknowns, unknowns, |i, j| match (i.min(j), i.max(j)) {
        (_, high) if high < cells => of_state[(i, j)],
        (low, high) if high < cells + 3 && low == high => 4.0,
        (low, high) if low >= cells + 3 => covariance(low - cells - 2, high - cells - 2),
        _ => 0.0,
    });
    let mut rows = Mat::<f64>::zeros(ROWS.len(), unknowns);
    for (number, (cycle, column, row, _, id, angle)) in ROWS.into_iter().enumerate() {
        rows[(number, (row - 1) * 16 + column - 1)] = 1.0;
        if let Some(station) = ["A", "B", "M"].iter().position(|name| *name == id) {
            rows[(number, cells + station)] = 1.0;
            rows[(number, cells + 2 + cycle)] = (angle - 10.0) / 20.0;
        }
    }
    let noise = Mat::<f64>::from_fn(ROWS.len(), ROWS.len(), |i, j| if i == j { 0.16 } else { 0.0 });
    let system = (&rows * &prior * rows.transpose() + noise).llt(Side::Lower).unwrap();
    let values = Mat::from_fn(ROWS.len(), 1, |i, _| ROWS[i].3);
    let seen = &prior * rows.transpose();
    let estimate = &seen * system.solve(&values);
    let explained = &seen * system.solve(seen.transpose());
    let sigma = |i: usize| (prior[(i, i)] - explained[(i, i)]).sqrt();
    let last: Vec<usize> = (cells..cells + 3).chain([unknowns - 1]).collect();
    for analyses in &heard.analyses {
        let Estimate { state, calibration, state_spread, calibration_spread } = &analyses[2];
        let at =
            |numbers: &[usize], of: &dyn Fn(usize) -> f64| -> Vec<f64> { numbers.iter().map(|&i| of(i)).collect() };
        let of_state: Vec<usize> = (0..cells).collect();
        for (found, expected) in [
            (state.values(), at(&of_state, &|i| estimate[(i, 0)])),
            (calibration, at(&last, &|i| estimate[(i, 0)])),
            (state_spread.as_ref().unwrap(), at(&of_state, &sigma)),
            (calibration_spread.as_ref().unwrap(), at(&last, &sigma)),
        ] {
            let found = difference(found, &expected);
            assert!(found < 1e-9, "{found:e}");
        }
    }
}

/// A world of biased stations, whose observations are written to a file and assimilated again from there.
fn twin(network: &str) -> String {
    let world = CARRIED_TRACER.split("[networks.fixed]").next().unwrap();
    format!("{world}{network}[methods]\nkf = {{ kind = \"kf\" }}\n")
}

const STATIONS: &str = "[networks.buoys]\nkind = \"radiosonde\"\nstations = { regular = [5, 4] }\ngroups = [\"A\", \"B\"]\n\
                        reference_groups = [\"A\"]\nobserve = { tracer = 0.2 }\n\
                        bias = [{ per = \"station\", variable = \"tracer\", sigma = 0.3 }]\n";

#[test]
fn the_biases_of_a_twin_come_back_from_its_file_of_observations() {
    let of_file = format!(
        "{STILL}reference_groups = [\"A\"]\nbias = [{{ per = \"station\", variable = \"tracer\", sigma = 0.3 }}]\n"
    );
    let (mut squares, mut count) = (0.0, 0.0);
    for seed in 0..8 {
        let (made, _) = heard(&twin(STATIONS), "", seed);
        let (read, summary) = heard(&twin(&of_file), &made.csv, seed);
        assert_eq!((&read.parameters, read.truths.len()), (&made.parameters, 0));
        assert_eq!(read.parameters.len(), 10);
        let [found, expected] = [&read, &made].map(|heard| heard.analyses[0].last().unwrap());
        assert!(difference(&found.calibration, &expected.calibration) < 1e-12);
        assert!(difference(found.state.values(), expected.state.values()) < 1e-12);
        let truth = made.truths.last().unwrap();
        let spread = found.calibration_spread.as_ref().unwrap();
        for ((estimate, truth), sigma) in found.calibration.iter().zip(truth).zip(spread) {
            let z = (estimate - truth.unwrap()) / sigma;
            assert!(*sigma < 0.15 && z.abs() < 4.5, "{z} of {sigma}, where the prior has 0.3");
            (squares, count) = (squares + z * z, count + 1.0);
        }
        let values = &summary.methods["kf"].values;
        assert!(values.contains_key("bias_spread") && !values.contains_key("bias_rmse"), "{values:?}");
    }
    // χ² of at least 8 independent variables is beyond these in less than one of a thousand cases.
    let mean = squares / count;
    assert!((0.1..3.3).contains(&mean), "{mean}");
}

#[test]
fn a_bias_that_can_only_be_tiny_changes_nothing() {
    let (made, _) = heard(&twin(STATIONS), "", 2);
    let analysed = |keys: &str| {
        let (heard, _) = heard(&twin(&format!("{STILL}{keys}")), &made.csv, 2);
        heard.analyses[0].last().unwrap().clone()
    };
    let plain = analysed("");
    for per in ["station", "group", "all"] {
        let tiny = analysed(&format!("bias = [{{ per = \"{per}\", variable = \"tracer\", sigma = 1e-9 }}]\n"));
        let [found, expected] = [&tiny, &plain].map(|it| it.state.values());
        let small = difference(found, expected);
        assert!(small < 1e-12 && tiny.calibration.iter().all(|bias| bias.abs() < 1e-12), "{per}: {small:e}");
        let large = analysed(&format!("bias = [{{ per = \"{per}\", variable = \"tracer\", sigma = 0.3 }}]\n"));
        assert!(difference(large.state.values(), plain.state.values()) > 1e-2, "{per}");
    }
}

const BUOYS: &str = "cycle,x_m,y_m,value,sigma,id\n1,1e5,1e5,0.9,0.2,A\n3,1e5,1e5,0.8,0.2,A\n4,5e5,3e5,0.1,0.2,B\n";

#[test]
fn a_twin_with_a_file_beside_it_scores_the_biases_whose_truth_is_known() {
    let keys = "bias = [{ per = \"station\", variable = \"tracer\", sigma = 0.4 }]\n";
    let scenario = format!("{}{STILL}{keys}", CARRIED_TRACER.replace("count = 14", "count = 5") + KALMAN);
    let (heard, summary) = heard(&scenario, BUOYS, 3);
    assert_eq!(heard.parameters, ["fixed/tracer/B", "buoys/tracer/A", "buoys/tracer/B"]);
    assert!(heard.truths.iter().all(|truth| truth[0].is_some() && truth[1..] == [None, None]));
    let scored = heard.analyses[0].iter().zip(&heard.truths[1..]).skip(2);
    let (errors, spreads): (Vec<f64>, Vec<f64>) = scored
        .map(|(own, truth)| (own.calibration[0] - truth[0].unwrap(), own.calibration_spread.as_ref().unwrap()[0]))
        .unzip();
    let rms = |values: &[f64]| (values.iter().map(|it| it * it).sum::<f64>() / values.len() as f64).sqrt();
    let values = &summary.methods["kf"].values;
    for (score, expected) in [("bias_rmse", rms(&errors)), ("bias_spread", rms(&spreads))] {
        assert!((values[score] - expected).abs() < 1e-12, "{score}: {} is not {expected}", values[score]);
    }
    let diagnostics = summary.methods["kf"].diagnostics.as_ref().unwrap();
    assert_eq!(diagnostics.biases.keys().collect::<Vec<_>>(), ["fixed/tracer/B"]);

    let (directory, ok, said) = command(&["run", "s.toml", "--threads", "1", "--quiet"], &scenario, BUOYS);
    assert!(ok, "{said}");
    let out = directory.path().join("out/s");
    let calibration = numbers(&out.join("truth.nc"), "calibration");
    assert_eq!(calibration.len(), 3 * 6);
    for (cycle, own) in calibration.chunks(3).enumerate() {
        assert_eq!(own, [heard.truths[cycle][0].unwrap(), FILL_VALUE, FILL_VALUE]);
    }
    let report = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.contains("and the truth (broken) where it is known"));
    assert!(
        report.contains("buoys/tracer/A")
            && report.contains("networks.buoys: bias of tracer per station: 2 to estimate")
    );
}

#[test]
fn without_a_truth_there_is_no_true_bias_anywhere() {
    let keys = "bias = [{ per = \"station\", variable = \"tracer\", sigma = 0.4 }]\n";
    let scenario = format!("{}{STILL}{keys}{KALMAN}", TRACER.replace("count = 1", "count = 4"));
    let (directory, ok, said) = command(&["run", "s.toml", "--threads", "1"], &scenario, BUOYS);
    assert!(ok && said.contains("bias spread") && !said.contains("bias RMSE"), "{said}");
    let out = directory.path().join("out/s");
    for name in ["true_bias", "value_bias_removed"] {
        assert_eq!(numbers(&out.join("observations.nc"), name), [FILL_VALUE; 3], "{name}");
    }
    let values = numbers(&out.join("observations.nc"), "value");
    let calibrated = numbers(&out.join("observations.nc"), "calibrated_value_kf");
    assert!(values.iter().zip(&calibrated).all(|(value, calibrated)| (value - calibrated).abs() > 1e-3));
    let report = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.contains("buoys/tracer/A") && !report.contains("truth (broken)") && !report.contains("<th>truth"));
    let summary: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
    let own = &summary["methods"]["kf"];
    assert!(own.get("bias_rmse").is_none() && own["bias_spread"].as_f64().is_some(), "{own}");
    assert!(own["diagnostics"]["biases"].as_object().is_none_or(|biases| biases.is_empty()), "{own}");
}

#[test]
fn an_observation_without_its_predictor_is_rejected_by_name() {
    let csv = BUOYS.replace("id\n", "id,angle\n").replace("0.2,A\n3", "0.2,A,5\n3").replace(",A\n4", ",A,\n4")
        + "4,6e5,3e5,0.1,0.2,C,7\n";
    let csv = csv.replace("0.2,B\n", "0.2,B,-999\n");
    let keys = "missing = [-999]\n[[networks.buoys.bias]]\nterm = \"column\"\ncolumn = \"angle\"\nmean = 0\nscale = 10\n\
                variable = \"tracer\"\nsigma = 0.4\n";
    let scenario = format!("{}{STILL}{keys}{KALMAN}", TRACER.replace("count = 1", "count = 4"));
    let (directory, ok, said) =
        command(&["run", "s.toml", "--threads", "1", "--no-report", "--no-rerun"], &scenario, &csv);
    assert!(ok && said.contains("2 of 4 observations can be used: 2 without a predictor of their bias"), "{said}");
    let file = NcFile::open(directory.path().join("out/s/observations.nc")).unwrap();
    let codes: Vec<i32> = file.read_variable::<i32>("quality_code").unwrap().iter().copied().collect();
    assert_eq!(codes, [0, 7, 0, 7]);
    for name in ["calibrated_value_kf", "analysis_departure_kf"] {
        let numbers = numbers(&directory.path().join("out/s/observations.nc"), name);
        let is_missing: Vec<bool> = numbers.iter().map(|number| *number == FILL_VALUE).collect();
        assert_eq!(is_missing, [false, true, false, true], "{name}: {numbers:?}");
    }
    let meanings =
        file.variable("quality_code").unwrap().attribute("flag_meanings").unwrap().value.as_string().unwrap();
    assert!(meanings.ends_with("no_predictor passive"), "{meanings}");
    let (_directory, ok, said) = command(&["check", "s.toml"], &scenario, &csv);
    assert!(ok && said.contains("networks.buoys: bias of tracer by angle, the same for all: 1 to estimate"), "{said}");
}

#[test]
fn mistakes_are_named_with_their_places() {
    let check = |keys: &str, methods: &str| {
        let (_directory, ok, said) = command(&["check", "s.toml"], &format!("{TRACER}{STILL}{keys}{methods}"), BUOYS);
        assert!(!ok, "{keys}: {said}");
        said
    };
    let bias = |keys: &str| format!("bias = [{{ variable = \"tracer\", {keys} }}]\n");
    for (keys, expected) in [
        (bias("sigma = 1"), "`per` is missing in [networks.buoys.bias[0]]"),
        (bias("per = \"country\", sigma = 1"), "valid values: station, group, all"),
        (bias("per = \"all\""), "`sigma` is missing"),
        (bias("per = \"all\", value = 3"), "unknown key `value`"),
        (bias("per = \"all\", sigma = 1, known = true"), "unknown key `known`"),
        (bias("per = \"all\", sigma = 1, column = \"angle\""), "unknown key `column`"),
        (
            bias("per = \"all\", sigma = 1, evolution = { kind = \"jump\", at_hours = 1, size = 2 }"),
            "cannot be \"jump\"",
        ),
        (bias("term = \"column\", sigma = 1, mean = 0, scale = 1"), "`column` is missing"),
        (
            bias("term = \"column\", column = \"angle\", sigma = 1, mean = 0, scale = 0"),
            "must be a number greater than 0",
        ),
        (
            bias("term = \"column\", column = \"angle\", sigma = 1, mean = 0, scale = 1"),
            "no column `angle`; it has `cycle`",
        ),
        (
            bias("term = \"column\", column = \"value\", sigma = 1, mean = 0, scale = 1"),
            "cannot be proportional to `value`",
        ),
        (bias("per = \"group\", sigma = 1"), "no column `group`"),
        ("reference_groups = [\"A\"]\n".into(), "no column `group`"),
        (
            "reference_stations = [\"Z\"]\n".into(),
            "reference_stations names `Z`, which is not in buoys.csv; valid: `A`, `B`",
        ),
        ("group_by = \"id\"\n".into(), "`networks.buoys.group_by` has no effect"),
        (
            format!("assimilate = false\n{}", bias("per = \"all\", sigma = 1")),
            "assimilate is false, but the network has unknown biases",
        ),
    ] {
        let said = check(&keys, KALMAN);
        assert!(said.contains(expected), "{keys} gives {said}");
    }
    let said = check(&bias("per = \"all\", sigma = 1"), "[methods.kf]\nkind = \"kf\"\nbias = \"known\"\n");
    assert!(
        said.contains("method kf has `bias = \"known\"`, but nothing is known of the true bias buoys/tracer/all"),
        "{said}"
    );
    let twin = format!("{}{STILL}{}", CARRIED_TRACER.to_owned() + KALMAN, bias("per = \"all\", sigma = 1"));
    let (_directory, ok, said) = command(&["exact", "s.toml"], &twin, BUOYS);
    assert!(!ok && said.contains("nothing is known of the true biases of network buoys"), "{said}");
}
