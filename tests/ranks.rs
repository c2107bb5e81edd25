//! One run computed by several ranks together, here threads: it is the run of one process.

use crate::common::VALID;
use isobar::event::Event;
use isobar::options::{CheckpointPolicy, RunOptions};
use isobar::output::{OUTPUTS, Outputs, STATE_FILE, Sink, SinkError};
use isobar::run::experiment::Experiment;
use isobar::run::{RunError, run};
use isobar::scenario::Scenario;
use isobar::scores::Summary;
use isobar_model::communicator::Communicator;
use isobar_model::testing::on_ranks;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

/// Ends the run in a cycle, if there is one.
struct EndIn(Option<usize>);

impl Sink for EndIn {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Observed { window, .. } if Some(window.cycle) == self.0 => {
                Err(SinkError { path: "nothing".into(), reason: "this is the end".into() })
            }
            _ => Ok(()),
        }
    }
}

fn scenario(more: &str) -> Scenario {
    let letkf = "\n[methods.letkf]\nkind = \"letkf\"\nmembers = 7\nlocalization_radius_km = 400\n";
    let ahead = "\n[forecast]\nlead_hours = 12\nfrom_every_cycles = 2\n";
    let text = VALID.to_string() + letkf + ahead + more;
    Scenario::parse(Path::new("small.toml"), &text).unwrap()
}

fn options(out: &Path) -> RunOptions {
    RunOptions {
        threads: Some(1),
        outputs: Outputs::of(OUTPUTS.iter().filter(|output| output.by_default).map(|output| output.name)),
        checkpoints: Some(CheckpointPolicy { minutes: None, cycles: Some(2) }),
        concurrent: true,
        ..RunOptions::new(out)
    }
}

/// What each rank returns; `end`: the cycle in which all end early.
fn shared(
    scenario: &Scenario,
    ranks: usize,
    end: Option<usize>,
    options: impl Fn(usize) -> RunOptions + Sync,
) -> Vec<Result<Summary, RunError>> {
    on_ranks(ranks, |communicator| {
        let options = options(communicator.rank());
        Experiment::builder(scenario).shared_by(Arc::new(communicator)).run(&options, &mut EndIn(end))
    })
}

/// Whether scores are the same but for rounding, and for what depends on the clock.
fn assert_near(one: &Summary, other: &Summary) {
    assert!(one.methods.keys().eq(other.methods.keys()));
    for (name, scores) in &one.methods {
        assert!(scores.failure.is_none() && scores.values.len() > 5, "{name}");
        for (key, &value) in scores.values.iter().filter(|(key, _)| *key != "seconds_per_cycle") {
            let other = other.methods[name].values[key];
            assert!((value - other).abs() <= 1e-10 * value.abs(), "{name}: {key} is {value} and {other}");
        }
    }
}

fn files(directory: &Path) -> BTreeSet<String> {
    std::fs::read_dir(directory).unwrap().map(|it| it.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn several_ranks_compute_the_run_of_one_process() {
    let parent = tempfile::tempdir().unwrap();
    let scenario = scenario("");
    let here = |name: &str| parent.path().join(name);
    let alone = run(&scenario, &options(&here("alone")), &mut EndIn(None)).unwrap();
    for ranks in [2, 3] {
        let out = here(&format!("on_{ranks}"));
        for summary in shared(&scenario, ranks, None, |_| options(&out)) {
            assert_near(&alone, &summary.unwrap());
        }
        assert_eq!(files(&out), files(&here("alone")));
    }
    assert_eq!(files(parent.path()).len(), 3, "something was left");
}

/// A jet with biased instruments, one on a doubly periodic plane, and the scenario of three million variables with 256 times fewer cells.
#[test]
fn shipped_scenarios_have_the_scores_of_one_process_on_1_to_4_ranks() {
    let parent = tempfile::tempdir().unwrap();
    let small = |text: String| {
        let smaller = [
            ("nx = 1024\nny = 1024\ndx_km = 5", "nx = 64\nny = 64\ndx_km = 80"),
            ("time_step_s = 40", "time_step_s = 450"),
            ("hyperdiffusion_m4_per_s = 5e9", "hyperdiffusion_m4_per_s = 3e14"),
            ("random = 6000", "random = 60"),
            (
                "scan_positions = 300\nalong_track_spacing_km = 15.3",
                "scan_positions = 19\nalong_track_spacing_km = 245",
            ),
        ];
        smaller.iter().fold(text, |text, (from, to)| {
            assert!(text.contains(from), "{from}");
            text.replace(from, to)
        })
    };
    for (name, methods, cycles) in
        [("quickstart", "free,fkf", 10), ("fkf_nonlinear", "letkf,fkf_r40", 22), ("million", "free,fkf", 4)]
    {
        let path = Path::new("scenarios").join(name).with_extension("toml");
        let text = std::fs::read_to_string(&path).unwrap();
        let scenario = Scenario::parse(&path, &if name == "million" { small(text) } else { text }).unwrap();
        let options = |out: &Path| RunOptions {
            methods: Some(methods.split(',').map(str::to_string).collect()),
            cycles: Some(cycles),
            outputs: Outputs::of([]),
            checkpoints: None,
            ..options(out)
        };
        let alone = run(&scenario, &options(&parent.path().join("alone").join(name)), &mut EndIn(None)).unwrap();
        for ranks in 1..=4 {
            let out = parent.path().join(ranks.to_string()).join(name);
            for summary in shared(&scenario, ranks, None, |_| options(&out)) {
                let summary = summary.unwrap();
                assert_near(&alone, &summary);
                assert_eq!(summary.ranks.map(|it| it.count), (ranks > 1).then_some(ranks));
                assert!(summary.ranks.is_none_or(|it| it.messages_per_cycle > 1.0 && it.bytes_per_cycle > 1e3));
            }
        }
    }
}

/// Interrupted on three ranks, it goes on on two, and on one; interrupted on one, on three.
#[test]
fn an_interrupted_run_goes_on_on_any_number_of_ranks() {
    let parent = tempfile::tempdir().unwrap();
    let scenario = scenario("");
    let out = |name: &str| parent.path().join(name);
    let alone = run(&scenario, &options(&out("alone")), &mut EndIn(None)).unwrap();
    let on = |ranks: usize, out: &Path, resume: bool, end: Option<usize>| {
        let options = |_| RunOptions { resume, ..options(out) };
        if ranks > 1 {
            return shared(&scenario, ranks, end, options).swap_remove(0);
        }
        run(&scenario, &options(0), &mut EndIn(end))
    };
    for (before, after) in [(3, 2), (3, 1), (1, 3)] {
        let out = out(&format!("{before}_{after}"));
        assert!(on(before, &out, false, Some(6)).unwrap_err().to_string().contains("this is the end"));
        assert!(!out.exists());
        assert_near(&alone, &on(after, &out, true, None).unwrap());
    }
}

/// Two runs, the second of which goes on from the state in which the first ends, come to the end of one.
#[test]
fn a_run_goes_on_from_an_earlier_one_on_several_ranks() {
    let parent = tempfile::tempdir().unwrap();
    let scenario = scenario("");
    let out = |name: &str| parent.path().join(name);
    let all = |options: &(dyn Fn() -> RunOptions + Sync), scenario: &Scenario| {
        shared(scenario, 2, None, |_| options()).into_iter().for_each(|summary| drop(summary.unwrap()));
    };
    all(&|| RunOptions { cycles: Some(4), ..options(&out("yesterday")) }, &scenario);
    let mut tomorrow = scenario.clone();
    tomorrow.start = scenario.start + scenario.cycle.window * 4;
    let second = || RunOptions { from: Some(out("yesterday")), cycles: Some(6), ..options(&out("today")) };
    all(&second, &tomorrow);
    let once = || RunOptions { cycles: Some(10), ..options(&out("once")) };
    all(&once, &scenario);
    let state = |name: &str| std::fs::read(out(name).join(STATE_FILE)).unwrap();
    assert!(state("today") == state("once"));
}

/// All end with the reason of the rank that cannot begin, and nothing is left.
#[test]
fn what_one_rank_cannot_do_ends_all() {
    let parent = tempfile::tempdir().unwrap();
    let scenario = scenario("");
    let (there, missing) = (parent.path().join("there"), parent.path().join("missing"));
    shared(&scenario, 2, None, |_| options(&there)).into_iter().for_each(|summary| drop(summary.unwrap()));
    let mut later = scenario.clone();
    later.start = scenario.start + scenario.cycle.window * 10;
    let from = |rank: usize| Some(if rank == 1 { missing.clone() } else { there.clone() });
    let out = parent.path().join("out");
    let outcomes = shared(&later, 3, None, |rank| RunOptions { from: from(rank), ..options(&out) });
    for outcome in outcomes {
        let error = outcome.unwrap_err();
        assert!(matches!(&error, RunError::Rank(failure) if failure.rank == 1), "{error}");
        assert!(error.to_string().contains("there is no such directory") && !error.is_of_one_rank(), "{error}");
    }
    // What rank 0 cannot do has its own error there.
    let outcomes = shared(&scenario, 2, None, |_| options(&there));
    assert!(matches!(outcomes[0], Err(RunError::Place(_))) && matches!(outcomes[1], Err(RunError::Rank(_))));
    assert_eq!(files(parent.path()), BTreeSet::from(["there".to_string()]));
}

#[test]
fn methods_that_ranks_do_not_divide_are_refused_by_name() {
    let parent = tempfile::tempdir().unwrap();
    let scenario = scenario(
        "[methods.var]\nkind = \"3dvar\"\n[methods.smoother]\nkind = \"etkf\"\nmembers = 5\nsmoother_lag_cycles = 2\n",
    );
    let out = parent.path().join("out");
    for outcome in shared(&scenario, 2, None, |_| options(&out)) {
        let error = outcome.unwrap_err().to_string();
        assert!(error.contains("var (kind = \"3dvar\")") && error.contains("smoother (its smoother)"), "{error}");
        assert!(!error.contains("letkf"), "{error}");
    }
    assert!(files(parent.path()).is_empty());
    let methods = Some(vec!["free".to_string(), "letkf".to_string()]);
    let outcomes = shared(&scenario, 2, None, |_| RunOptions { methods: methods.clone(), ..options(&out) });
    assert!(outcomes.iter().all(Result::is_ok));
}
