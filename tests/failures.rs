//! Methods that fail: detected, named, marked in every output; and nothing of that touches the other methods.

use crate::common::{VALID, isobar, text};
use isobar::run::cycle::Runner;
use isobar::run::monitor::{DIVERGED_ANALYSES, Fault};
use isobar::scores::Summary;
use isobar_assim::{Analysis, Assimilator, Background, Error};
use isobar_model::{Duration, Time};
use isobar_obs::{Jacobian, LinearOperator, ObservationWindow, SparseRows};
use netcdf_reader::NcFile;
use std::fs;
use std::io::{Read, Write};
use std::path::Path;

const FILL_VALUE: f64 = 9.96921e36;

/// A satellite whose bias is many times the depth of the fluid, two methods that are blind to it (one follows it until
/// the fluid has no depth, the other believes so little in observations that it never comes near them) and two others.
fn scenario() -> String {
    let blind = |name: &str, scale: &str| {
        format!("\n[methods.{name}]\nkind = \"3dvar\"\nbias = \"ignore\"\ncovariance_scale = {scale}\n")
    };
    VALID.replace("value = 10", "value = -8000") + &blind("sinking", "1") + &blind("astray", "1e-9")
}

fn summary(run: &Path) -> Summary {
    serde_json::from_str(&fs::read_to_string(run.join("summary.json")).unwrap()).unwrap()
}

#[test]
fn a_failed_method_is_marked_everywhere_and_the_others_do_not_notice() {
    let parent = tempfile::tempdir().unwrap();
    fs::write(parent.path().join("deep.toml"), scenario()).unwrap();
    let output = isobar(parent.path(), &["run", "deep.toml", "--no-rerun", "--out", "all"]);
    let (said, complaint) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{complaint}");
    assert!(complaint.contains("deep: failed: sinking, astray"), "{complaint}");
    assert!(complaint.contains("warning: method sinking failed in cycle"), "{complaint}");
    assert!(
        said.contains("sinking (failed)") && said.contains("astray: failed in cycle 5: the filter has d"),
        "{said}"
    );

    let run = parent.path().join("all/deep");
    let summary = self::summary(&run);
    let failures: Vec<_> = summary.failures().map(|(name, it)| (name, it.cycle, it.reason.as_str())).collect();
    let [(sinking, sunk, because), (astray, DIVERGED_ANALYSES, diverged)] = failures[..] else {
        panic!("{failures:?}")
    };
    assert_eq!((sinking, astray), ("sinking", "astray"));
    assert!(sunk < 10 && because.contains("the thickness at row") && diverged.contains("χ²/n"), "{because} {diverged}");
    assert!(!summary.methods["sinking"].values.contains_key("rmse_analysis.h"));
    let errors = summary.methods["fkf"].values.keys().filter(|score| score.starts_with("rmse_analysis.")).count();
    assert_eq!(errors, 3);

    // Files: complete, with missing values from the failure on.
    for (name, last) in [("sinking", sunk - 1), ("astray", DIVERGED_ANALYSES - 1), ("fkf", 10)] {
        let file = NcFile::open(run.join(format!("{name}.nc"))).unwrap();
        let times = file.read_variable::<f64>("time").unwrap();
        assert_eq!(times.len(), 10);
        assert_eq!(times[[9]] - times[[0]], 9.0 * 21_600.0);
        let values: Vec<f64> = file.read_variable::<f64>("h_analysis").unwrap().iter().copied().collect();
        let missing: Vec<bool> = values.chunks(48).map(|record| record.iter().all(|&it| it == FILL_VALUE)).collect();
        assert_eq!(missing, (1..=10).map(|cycle| cycle > last).collect::<Vec<_>>(), "{name}");
        let observations = NcFile::open(run.join("observations.nc")).unwrap();
        let cycles = observations.read_variable::<i32>("cycle").unwrap();
        let departures = observations.read_variable::<f64>(&format!("background_departure_{name}")).unwrap();
        let is_right = |(&departure, &cycle): (&f64, &i32)| (departure == FILL_VALUE) == (cycle as usize > last);
        assert!(departures.iter().zip(cycles.iter()).all(is_right), "{name}");
        let scores = fs::read_to_string(run.join("scores.csv")).unwrap();
        assert_eq!(scores.lines().filter(|line| line.contains(&format!(",{name},"))).count(), last);
    }
    let page = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("astray (failed)") && page.contains("the filter has diverged"));

    // The others: the same bits as without the failed ones.
    let arguments = ["run", "deep.toml", "--no-rerun", "--out", "two", "--methods", "free,fkf"];
    assert!(isobar(parent.path(), &arguments).status.success());
    for name in ["free.nc", "fkf.nc", "truth.nc"] {
        let two = fs::read(parent.path().join("two/deep").join(name)).unwrap();
        assert!(fs::read(run.join(name)).unwrap() == two, "{name}");
    }
    let untimed = |summary: &Summary| {
        let mut scores = summary.methods["fkf"].clone();
        scores.values.retain(|key, _| !["seconds_per_cycle", "peak_memory_bytes"].contains(&key.as_str()));
        scores
    };
    assert_eq!(untimed(&summary), untimed(&self::summary(&parent.path().join("two/deep"))));

    // A comparison has the cycles that there are.
    assert!(isobar(parent.path(), &["compare", "all/deep", "two/deep"]).status.success());
    // And no such scores are accepted.
    let accept = isobar(parent.path(), &["regress", "deep.toml", "--accept", "--quiet"]);
    assert_eq!(accept.status.code(), Some(1));
    assert!(text(&accept.stderr).contains("nothing is accepted"), "{}", text(&accept.stderr));
}

/// A method with a fault of its own.
struct Faulty;

impl Assimilator for Faulty {
    fn forecast(&mut self, _: Duration) -> Result<Background, Error> {
        panic!("index out of bounds in block {}", 3)
    }

    fn analyse(&mut self, _: &Background, _: &ObservationWindow) -> Result<Analysis, Error> {
        unreachable!("the forecast fails")
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(Self)
    }

    fn save(&self, _: &mut dyn Write) -> Result<(), Error> {
        Ok(())
    }

    fn recall(&mut self, _: &mut dyn Read) -> Result<(), Error> {
        Ok(())
    }
}

#[test]
fn a_panic_within_a_method_is_a_failure_of_the_method() {
    let mut runner = Runner::new(|| Ok::<Box<dyn Assimilator>, Error>(Box::new(Faulty))).unwrap();
    let jacobian = Jacobian { state: SparseRows::new(), calibration: SparseRows::new() };
    let nothing = ObservationWindow {
        time: Time::from_seconds(0),
        cycle: 1,
        reports: Vec::new(),
        times: Vec::new(),
        values: Vec::new(),
        sigma: Vec::new(),
        error_regression: Default::default(),
        aside: Default::default(),
        comparisons: Vec::new(),
        operator: std::sync::Arc::new(LinearOperator { jacobian }),
    };
    let Err(fault) = runner.cycle(Duration::from_seconds(60), &nothing, false, false) else {
        panic!("it has a result")
    };
    assert_eq!(fault, Fault::Panic("index out of bounds in block 3".into()));
}
