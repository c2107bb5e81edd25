//! A network that begins to report later than the run, `first_cycle`.

use crate::ahead::{Listener, TRACER, listen, parse};
use crate::common::{isobar, one_line, text};
use std::fs;

const METHODS: &str = "[methods]\nkf = { kind = \"kf\" }\nfkf = { kind = \"fkf\", factors = 6 }\n\
                       known = { kind = \"kf\", bias = \"known\" }\n";

fn late(schedule: &str) -> String {
    format!(
        "[networks.late]\nkind = \"radiosonde\"\nstations = {{ random = 5 }}\ngroups = [\"C\"]\n{schedule}\
         observe = {{ tracer = 0.1 }}\nbias = [{{ per = \"group\", variable = \"tracer\", sigma = 0.4 }}]\n"
    )
}

/// Largest difference of two analyses of the state.
fn difference(one: &Listener, other: &Listener, method: usize, cycle: usize) -> f64 {
    let [one, other] = [one, other].map(|it| it.analysed[&(method, cycle)].1.state.values().to_vec());
    one.iter().zip(&other).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Until it reports, everything is as without it; then its observations are there, in every second cycle, and its bias, of which
/// nothing was known but the prior, is found.
#[test]
fn a_network_that_begins_later_is_not_there_before() {
    let (without, _) = listen(&parse(&[TRACER, METHODS]));
    let (with, _) = listen(&parse(&[TRACER, METHODS, &late("interval_cycles = 2\nfirst_cycle = 7\n")]));
    let info = with.info.as_ref().unwrap();
    let bias = info.calibration.parameters.iter().position(|it| it.name == "late/tracer/C").unwrap();
    for cycle in 1..=14 {
        let reports = with.observed[&cycle].reports.iter().filter(|report| &*report.network == "late").count();
        let reporting = cycle >= 7 && cycle % 2 == 1;
        assert_eq!(reports, if reporting { 5 } else { 0 }, "cycle {cycle}");
        assert_eq!(without.observed[&cycle].values, with.observed[&cycle].values[..without.observed[&cycle].len()]);
        for method in 0..3 {
            let difference = difference(&with, &without, method, cycle);
            match cycle < 7 {
                true => assert!(difference < 1e-9, "cycle {cycle}, method {method}: {difference}"),
                false => assert!(difference > 1e-3, "cycle {cycle}, method {method}: {difference}"),
            }
        }
        for method in 0..2 {
            let spread = with.analysed[&(method, cycle)].1.calibration_spread.as_ref().unwrap()[bias];
            assert!(if cycle < 7 { (spread - 0.4).abs() < 1e-9 } else { spread < 0.2 }, "cycle {cycle}: {spread}");
        }
    }
}

/// What is said of its bias before it reports comes from elsewhere: from a comparison with another sensor.
#[test]
fn its_bias_can_be_compared_before_it_reports() {
    let comparison = "[[comparisons]]\nsensor = \"late/tracer/C\"\ntime = \"2026-01-15T13:00:00Z\"\nsigma = 0.1\n";
    let (heard, _) = listen(&parse(&[TRACER, METHODS, &late("first_cycle = 7\n"), comparison]));
    let spread = |cycle: usize| heard.analysed[&(0, cycle)].1.calibration_spread.as_ref().unwrap()[1];
    // One datum of σ 0.1 beside a prior of 0.4.
    let expected = 1.0 / (1.0 / 0.16f64 + 1.0 / 0.01).sqrt();
    assert!((spread(2) - 0.4).abs() < 1e-9 && (spread(3) - expected).abs() < 1e-9, "{} {}", spread(2), spread(3));
    assert!((spread(6) - expected).abs() < 1e-9 && spread(7) < 0.9 * expected, "{} {}", spread(6), spread(7));
}

#[test]
fn one_that_never_reports_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let said = |schedule: &str, arguments: &[&str]| {
        fs::write(folder.path().join("s.toml"), [TRACER, METHODS, &late(schedule)].concat()).unwrap();
        let output = isobar(folder.path(), arguments);
        assert!(output.status.success(), "{}", text(&output.stderr));
        one_line(&(text(&output.stdout) + &text(&output.stderr)))
    };
    let never = "networks.late: it never reports: its first report would be in cycle 15, and the last cycle is 14";
    assert!(said("first_cycle = 15\n", &["check", "s.toml"]).contains(never));
    assert!(!said("first_cycle = 14\n", &["check", "s.toml"]).contains("never reports"));
    let short = said("first_cycle = 14\n", &["run", "s.toml", "--cycles", "5", "--out", "short"]);
    assert!(short.contains("in cycle 14, and the last cycle is 5"), "{short}");
    assert!(short.contains("late/tracer/C"), "{short}");
}
