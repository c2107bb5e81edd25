//! The page that a run leaves behind: complete, self-contained, and safe whatever the scenario says.

use crate::common::{SCRIPT, without_script};
use crate::synthetic_run::SyntheticRun;
use base64::Engine;
use isobar::event::{Estimated, Event, RunInfo, Smoothed};
use isobar::output::recorded::SavedRun;
use isobar::output::{Existing, OutputDirectory, Outputs, Sink, SinkError, open_all};
use isobar::scores::kind;
use isobar_assim::EstimatedParameter;
use sha2::{Digest, Sha256};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

fn report() -> Outputs {
    Outputs::of(["report"])
}

/// Plays the run into a new directory, and lets `look` see it.
fn written(run: &SyntheticRun, look: impl FnOnce(&Path)) {
    let parent = tempfile::tempdir().unwrap();
    let destination = parent.path().join("run");
    let directory = OutputDirectory::create(&destination, Existing::Refuse).unwrap();
    run.play(&mut open_all(&run.info, &directory, &report()).unwrap()).unwrap();
    directory.complete().unwrap();
    look(&destination);
}

fn page(run: &SyntheticRun) -> String {
    let mut text = String::new();
    written(run, |directory| text = fs::read_to_string(directory.join("report.html")).unwrap());
    text
}

/// All files below, by name.
fn files(directory: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            all.extend(files(&path).into_iter().map(|(below, bytes)| (format!("{name}/{below}"), bytes)));
        } else {
            all.insert(name, fs::read(&path).unwrap());
        }
    }
    all
}

/// What stands between the first `from` and the next `to`.
fn between<'a>(text: &'a str, from: &str, to: &str) -> &'a str {
    let rest = text.split_once(from).unwrap_or_else(|| panic!("no {from}")).1;
    rest.split_once(to).unwrap_or_else(|| panic!("no {to}")).0
}

/// Values of an attribute.
fn attributes<'a>(text: &'a str, name: &str) -> Vec<&'a str> {
    text.split(&format!(" {name}=\"")).skip(1).map(|rest| rest.split('"').next().unwrap()).collect()
}

/// A browser runs the script whose hash the page's policy has, and no other.
#[test]
fn the_policy_of_the_page_allows_its_own_script_alone() {
    let text = page(&SyntheticRun::new(8, 6, 2, 2));
    assert_eq!(text.matches(&format!("<script>{SCRIPT}</script>")).count(), 1);
    let policy = between(&text, "Content-Security-Policy\" content=\"", "\"");
    let hash = base64::engine::general_purpose::STANDARD.encode(Sha256::digest(SCRIPT));
    assert!(policy.contains(&format!("script-src 'sha256-{hash}';")), "put sha256-{hash} into page.rs: {policy}");
    for loose in ["unsafe-eval", "script-src 'unsafe", "default-src 'self'", "connect-src"] {
        assert!(!policy.contains(loose), "{policy}");
    }
    for reaching_out in ["fetch(", "XMLHttpRequest", "import(", "eval(", "innerHTML", "localStorage", "WebSocket"] {
        assert!(!SCRIPT.contains(reaching_out), "{reaching_out}");
    }
}

#[test]
fn the_page_loads_nothing() {
    let text = page(&SyntheticRun::new(8, 6, 5, 5));
    let without_namespace = without_script(&text).replace("http://www.w3.org/2000/svg", "");
    for forbidden in ["http:", "https:", "<script", "<iframe", "<object", "@import", "srcset", "javascript:"] {
        assert!(!without_namespace.contains(forbidden), "{forbidden}");
    }
    for source in attributes(&text, "src").into_iter().chain(attributes(&text, "href")) {
        assert!(source.starts_with("data:") || source.starts_with('#'), "{source:.80}");
    }
    for url in text.split("url(").skip(1) {
        assert!(url.starts_with('#') || url.starts_with("&quot;#"), "{url:.80}");
    }
}

#[test]
fn identifiers_are_unique_and_references_lead_somewhere() {
    let text = page(&SyntheticRun::new(8, 6, 5, 5));
    let mut ids = attributes(&text, "id");
    let count = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), count, "an identifier is used twice");
    for url in text.split("url(#").skip(1) {
        let id = url.split(')').next().unwrap();
        assert!(ids.binary_search(&id).is_ok(), "{id} is nowhere");
    }
}

#[test]
fn every_score_has_its_place_in_the_table() {
    let run = SyntheticRun::new(8, 6, 5, 5);
    let text = page(&run);
    let table = between(&text, "<table>", "</table>");
    let rows: Vec<&str> = between(table, "<tbody>", "</tbody>").split("<tr>").skip(1).collect();
    assert_eq!(rows.len(), run.info.methods.len());
    let columns = between(table, "<thead>", "</thead>").matches("<th ").count();
    assert_eq!(columns, 1 + 3 * 3 + 3);
    for (row, (name, scores)) in rows.iter().zip(&run.summary.methods) {
        assert_eq!(row.matches("<td").count() + 1, columns);
        assert!(row.contains(&format!(">{name}</th>")), "{row}");
        let error = scores.values["rmse_analysis.h"];
        let digits = format!("{error:.*}", (2 - error.log10().floor() as i32).max(0) as usize);
        assert!(row.contains(&digits), "{digits} is not in {row}");
    }
    for method in &run.info.methods {
        assert!(text.contains(&method.description), "{}", method.description);
    }
    for heading in [
        "Scores",
        "Error over time",
        "Biases",
        "Which errors go together",
        "What the observations say",
        "Partition and cost",
        "Scenario",
    ] {
        assert!(text.contains(&format!("<h2>{heading}</h2>")), "{heading}");
    }
}

#[test]
fn figures_are_on_the_page_and_in_files() {
    let run = SyntheticRun::new(8, 6, 5, 5);
    written(&run, |directory| {
        let all = files(&directory.join("figures"));
        for name in ["rmse_h.svg", "rmse_u.svg", "rmse_v.svg", "innovation_chi2.svg", "departure_europe_h.svg"] {
            assert!(all.contains_key(name), "{name} is missing");
        }
        let count = |part: &str| all.keys().filter(|name| name.contains(part)).count();
        assert_eq!(count("bias_"), run.info.calibration.len());
        for name in ["biases.svg", "scores_h.svg"] {
            assert!(all.contains_key(name), "{name} is missing");
        }
        assert_eq!((count("spread_error_"), count("normalised_error_")), (3, 3));
        // In all five cycles.
        assert_eq!((count("_truth.svg"), count("_error.svg"), count("_background.svg")), (5, 25, 25));
        assert_eq!(count("_spread.svg"), 5 * 4, "one method has no spread");
        assert_eq!((count("_correlation.svg"), count("_correlation_")), (1, 2));
        // The other variables at the end.
        for variable in ["u", "v"] {
            let curves = 2;
            assert_eq!(count(&format!("_error_{variable}.svg")), 5 + curves, "{variable}");
            assert_eq!(count(&format!("_spread_{variable}.svg")), 4, "{variable}");
        }
        assert_eq!((count("_blocks.svg"), count("01_fast_kalman_factor_")), (1, 2));
        for (name, bytes) in &all {
            assert!(bytes.starts_with(b"<svg") && bytes.len() > 1000, "{name}");
            let text = std::str::from_utf8(bytes).unwrap();
            roxmltree::Document::parse(text).unwrap_or_else(|error| panic!("{name}: {error}"));
        }
        let text = fs::read_to_string(directory.join("report.html")).unwrap();
        let svgs = all.keys().filter(|name| name.ends_with(".svg")).count();
        // All of them, and the coast, which all maps have in common.
        assert_eq!(text.matches("<svg").count(), svgs + 1);
        assert_eq!(text.matches("id=\"coast\"").count(), 1);
        assert_eq!(text.matches("<figure").count(), text.matches("<figcaption>").count());
    });
}

/// What the slider shows: of every cycle the truth, and of every method background, analysis, error and spread.
#[test]
fn maps_say_of_which_cycle_and_method_they_are() {
    let run = SyntheticRun::new(8, 6, 5, 3);
    let text = page(&run);
    let figures: Vec<&str> = text.split("<figure").skip(1).map(|rest| rest.split('>').next().unwrap()).collect();
    let of = |cycle: usize, kind: &str, method: Option<&str>| {
        let own = format!(" data-kind=\"{kind}\"");
        let of_method = method.map(|method| format!(" data-method=\"{method}\""));
        let is_it = |figure: &&&str| {
            figure.contains(&format!(" data-cycle=\"{cycle}\""))
                && figure.contains(&own)
                && of_method.as_ref().map_or(!figure.contains("data-method"), |own| figure.contains(own))
        };
        figures.iter().filter(is_it).count()
    };
    for cycle in 1..=5 {
        assert_eq!(of(cycle, "truth", None), 1, "cycle {cycle}");
        for method in &run.info.methods {
            for kind in ["background", "analysis", "error", "spread"] {
                assert_eq!(of(cycle, kind, Some(&method.name)), 1, "cycle {cycle}: {kind} of {}", method.name);
            }
        }
    }
    assert_eq!(figures.iter().filter(|it| it.contains("data-cycle")).count(), 5 * (1 + 3 * 4));
    assert!(text.contains(" data-when=\"cycle 5, "));
    // Large grids have maps of two cycles.
    let large = page(&SyntheticRun::new(160, 120, 3, 2));
    let cycles: std::collections::BTreeSet<&str> = attributes(&large, "data-cycle").into_iter().collect();
    assert_eq!(cycles.into_iter().collect::<Vec<_>>(), ["2", "3"]);
}

#[test]
fn biases_of_a_scanner_are_drawn_by_scan_position() {
    let mut run = SyntheticRun::new(8, 6, 4, 2);
    let figure = |run: &SyntheticRun| {
        let mut text = None;
        written(run, |directory| text = fs::read_to_string(directory.join("figures/scan_polar_h.svg")).ok());
        text.unwrap_or_default()
    };
    let svg = figure(&run);
    // The first method has readings, and there is a truth.
    assert!(svg.contains(">fast_kalman</text>") && svg.contains(">truth</text>"), "{svg}");
    assert!(!svg.contains(">kalman</text>"), "it has none");
    assert!(page(&run).contains("by scan position, all its terms together, after the analysis of cycle 4"));
    run.windows.iter_mut().flat_map(|window| &mut window.reports).for_each(|report| report.scan = None);
    assert!(figure(&run).is_empty());
}

/// Tells more of the first method than its analyses: parameters beside state and biases, and smoothed estimates.
struct Telling(Vec<Box<dyn Sink>>);

impl Sink for Telling {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        self.0.record(event)?;
        let Event::Analysed(analysed) = event else { return Ok(()) };
        let parameter = |name: &str, value, sigma: Option<f64>, verdict: &str| EstimatedParameter {
            name: name.into(),
            unit: "m s-1".into(),
            value,
            sigma,
            verdict: verdict.into(),
        };
        let parameters = [
            parameter("adapt/<b>", 1.25 * analysed.cycle as f64, Some(0.25), "determined"),
            parameter("hats/1", 0.0, None, "not determined: the same as <i>"),
        ];
        let (method, cycle, time) = (analysed.method, analysed.cycle, analysed.time);
        if method > 0 {
            return Ok(());
        }
        let parameters = parameters.as_slice().into();
        self.0.record(&Event::Estimated(Estimated { method, cycle, time, parameters }))?;
        let scores = Cow::Owned([("rmse_smoothed.h".to_string(), 0.5)].into());
        let estimate = Cow::Borrowed(&analysed.analysis.estimate);
        self.0.record(&Event::Smoothed(Smoothed { method, cycle, later_cycles: 2, estimate, scores }))
    }
}

#[test]
fn what_methods_estimate_beside_state_and_biases_is_shown_and_smoothed_errors_are() {
    let mut run = SyntheticRun::new(8, 6, 4, 2);
    let without = page(&run);
    assert!(!without.contains("What else is estimated") && !without.contains("once smoothed"));
    run.info.methods[0].smoother_lag_cycles = Some(2);
    let parent = tempfile::tempdir().unwrap();
    let directory = OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap();
    run.play(&mut Telling(open_all(&run.info, &directory, &report()).unwrap())).unwrap();
    directory.complete().unwrap();
    let all = files(&parent.path().join("run"));
    let text = |name: &str| String::from_utf8(all[name].clone()).unwrap();
    let page = text("report.html");
    let section = between(&page, "<h2>What else is estimated</h2>", "<h2>");
    // Of the one that nothing determines there is only the reason.
    assert_eq!(section.matches("<svg").count(), 1);
    let table = between(section, "<tbody>", "</tbody>");
    for part in ["adapt&#x2f;&lt;b&gt;", "m\u{a0}s⁻¹", "5.00<small>± 0.500", "not determined: the same as &lt;i&gt;"]
    {
        assert!(table.contains(part), "{part} is not in {table}");
    }
    assert!(!table.contains(&run.info.methods[1].name), "it estimates none of them");
    let parameters: Vec<&String> = all.keys().filter(|name| name.contains("parameter_")).collect();
    assert!(parameters.len() == 1 && text(parameters[0]).contains("[m\u{a0}s⁻¹]"), "{parameters:?}");
    assert!(page.contains("error once smoothed (dotted)"));
    let dotted = |name: &str| text(name).contains("stroke-dasharray=\"2 4\"");
    assert!(dotted("figures/rmse_h.svg") && !dotted("figures/rmse_u.svg"));
}

#[test]
fn nothing_of_a_scenario_becomes_part_of_the_page() {
    const BAD: &str = "<script>alert(1)</script><img src=x onerror=alert(2)>\"'&]]>";
    let mut run = SyntheticRun::new(8, 6, 3, 3);
    let bad = |text: &mut String| *text = BAD.to_string();
    bad(&mut run.info.title);
    bad(&mut run.info.scenario);
    run.info.scenario_text = format!("phenomenon = '''{BAD}'''\nsource = '''{BAD}'''\n# </pre>{BAD}");
    run.info.methods.iter_mut().for_each(|method| bad(&mut method.description));
    bad(&mut run.info.methods[1].name);
    run.info.calibration.parameters.iter_mut().for_each(|parameter| bad(&mut parameter.name));
    bad(&mut run.info.calibration.parameters[0].unit);
    run.windows.iter_mut().flat_map(|window| &mut window.reports).for_each(|report| report.network = BAD.into());
    let renamed = run.summary.methods.values().zip(&run.info.methods);
    run.summary.methods = renamed.map(|(scores, info)| (info.name.clone(), scores.clone())).collect();
    written(&run, |directory| {
        for (name, bytes) in files(directory) {
            if name.ends_with(".html") || name.ends_with(".svg") {
                let text = String::from_utf8(bytes).unwrap();
                let text = without_script(&text);
                assert!(!text.contains("<script") && !text.contains("<img src=x"), "{name}");
                assert!(!text.contains("</pre>&lt;") || text.matches("</pre>").count() == 1, "{name}");
                assert!(text.contains("&lt;script&gt;") || !name.starts_with("report"), "{name}");
            }
        }
    });
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let once = |directory: &Path| files(directory);
    let (mut first, mut second) = (BTreeMap::new(), BTreeMap::new());
    written(&SyntheticRun::new(8, 6, 4, 2), |directory| first = once(directory));
    written(&SyntheticRun::new(8, 6, 4, 2), |directory| second = once(directory));
    assert!(first.len() > 20);
    for (name, bytes) in &first {
        assert_eq!(Some(bytes), second.get(name), "{name}");
    }
    written(&SyntheticRun::new(8, 6, 4, 3), |directory| {
        assert_ne!(first["report.html"], files(directory)["report.html"]);
    });
}

#[test]
fn runs_without_methods_biases_or_observations_have_a_page() {
    let text = page(&SyntheticRun::new(8, 6, 1, 0));
    assert!(text.contains("<h2>Scores</h2>"));
    let mut run = SyntheticRun::new(4, 3, 1, 1);
    let empty: RunInfo = RunInfo { calibration: Default::default(), ..run.info.clone() };
    run.info = empty;
    for (_, analysis, _) in run.results.iter_mut().flatten() {
        analysis.background_departures.clear();
        analysis.analysis_departures.clear();
    }
    run.windows.iter_mut().for_each(|window| window.reports.clear());
    let text = page(&run);
    assert!(!text.contains("<h2>Biases</h2>") && text.contains("map"));
}

#[test]
fn fields_gone_astray_do_not_end_the_run() {
    let mut run = SyntheticRun::new(8, 6, 2, 2);
    for (number, value) in [f64::NAN, f64::INFINITY, -1e300].into_iter().enumerate() {
        let (_, analysis, scores) = &mut run.results[0][1];
        analysis.estimate.state.values_mut()[number] = value;
        analysis.estimate.calibration[0] = value;
        scores.values["rmse_analysis.h"] = value;
        scores.values.insert("innovation_chi2".into(), value);
        let text = page(&run);
        assert!(text.contains("<h2>Scores</h2>"), "{value}");
    }
}

/// Every number of `scores.csv` is a row of `scores_long.csv`, and nothing else is.
#[test]
fn long_scores_are_those_of_the_wide_file() {
    written(&SyntheticRun::new(8, 6, 3, 2), |directory| {
        let table = |name: &str| {
            let mut reader = csv::Reader::from_path(directory.join(name)).unwrap();
            let header: Vec<String> = reader.headers().unwrap().iter().map(String::from).collect();
            let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
            (header, rows)
        };
        let (titles, wide) = table("scores.csv");
        let (header, long) = table("scores_long.csv");
        assert_eq!(header, ["cycle", "valid_time", "method", "score", "variable", "unit", "value"]);
        let mut expected = Vec::new();
        for row in &wide {
            for (title, value) in titles.iter().zip(row).skip(3).filter(|(_, value)| !value.is_empty()) {
                let (score, rest) = title.split_once(' ').unwrap_or((title, ""));
                let (variable, _) = rest.split_once(' ').unwrap_or_default();
                expected.push([&row[0], &row[1], &row[2], score, variable, value].map(String::from));
            }
        }
        let found: Vec<_> = long.iter().map(|row| [0, 1, 2, 3, 4, 6].map(|at| row[at].to_string())).collect();
        assert!(found == expected && found.len() > 20, "{found:?}");
        assert!(long.iter().any(|row| &row[3] == "rmse_analysis" && &row[4] == "u" && &row[5] == "m s-1"));
    });
}

#[test]
fn scores_of_all_cycles_are_read_back() {
    let run = SyntheticRun::new(8, 6, 5, 5);
    written(&run, |directory| {
        // The summary that a synthetic run makes up holds what its last cycle had.
        let saved = SavedRun::open(directory).unwrap();
        assert_eq!((&saved.summary.scenario, saved.summary.seed), (&run.summary.scenario, run.summary.seed));
        for (name, expected) in &run.summary.methods {
            let found = &saved.summary.methods[name];
            assert_eq!(found.partition, expected.partition);
            for (score, value) in &expected.values {
                assert!((found.values[score] / value - 1.0).abs() < 1e-14, "{name} {score}");
            }
        }
        let scores = saved.scores().unwrap();
        let units = ["m", "m s-1", "m s-1"].map(String::from);
        assert_eq!(scores.variables, ["h", "u", "v"].map(String::from).into_iter().zip(units).collect::<Vec<_>>());
        for (method, results) in run.info.methods.iter().zip(&run.results) {
            let series = &scores.methods[&method.name];
            assert_eq!(series.len(), 5);
            for (cycle, (_, _, expected)) in (1..).zip(results) {
                let mut expected = expected.values.clone();
                expected.retain(|score, _| kind(score.split('.').next().unwrap()).unwrap().is_of_cycles());
                assert!(series[&cycle] == expected && expected.len() >= 6, "{expected:?}");
            }
        }
    });
}
