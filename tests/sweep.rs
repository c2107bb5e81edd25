//! `isobar sweep`, and batches of runs that end before their time.

use crate::common::{VALID, isobar, text, without_script};
use isobar::scores::Summary;
use serde_json::Value;
use std::fs;
use std::path::Path;

const SWEEP: &str = r#"
[methods.var]
kind = "3dvar"
bias = "ignore"
[sweep]
seeds = 3
[sweep.vary]
"methods.var.covariance_scale" = { from = 0.01, to = 1, count = 3, spacing = "logarithmic" }
"methods.fkf.blocks" = ["cell", "domain"]
"networks.sondes.sigma_height_m" = [12, 40]
"#;

fn place(text: &str) -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("small.toml"), text).unwrap();
    directory
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

fn summary(path: &Path) -> Summary {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn every_setting_has_the_scores_of_its_own_runs_and_the_best_is_named() {
    let directory = place(&format!("{VALID}{SWEEP}"));
    let here = directory.path();
    let output = isobar(here, &["sweep", "small.toml", "--quiet", "--cycles", "6"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    let folder = here.join("out/small-sweep");
    let json = json(&folder.join("sweep.json"));
    let settings = |method: &str| json["methods"][method].as_array().unwrap().clone();
    assert_eq!(["free", "var", "fkf"].map(|method| settings(method).len()), [2, 6, 4]);

    // A setting is the run of the same scenario with that value.
    let text_of = |scale: &str, sigma: &str| {
        let own = VALID.replace("sigma_height_m = 12", &format!("sigma_height_m = {sigma}"));
        format!("{own}\n[methods.var]\nkind = \"3dvar\"\nbias = \"ignore\"\ncovariance_scale = {scale}\n")
    };
    fs::write(here.join("plain.toml"), text_of("0.1", "40")).unwrap();
    let arguments = ["run", "plain.toml", "--quiet", "--seed", "2", "--cycles", "6", "--no-rerun", "--methods", "var"];
    assert!(isobar(here, &arguments).status.success());
    let plain = summary(&here.join("out/plain/summary.json"));
    let near = |a: &Value, b: f64| (a.as_f64().unwrap() / b - 1.0).abs() < 1e-12;
    let of_values = |own: &Value, scale: f64, sigma: i64| {
        let values = &own["values"];
        near(&values["methods.var.covariance_scale"], scale) && values["networks.sondes.sigma_height_m"] == sigma
    };
    let all = settings("var");
    let setting = all.iter().find(|own| of_values(own, 0.1, 40)).unwrap();
    let own = summary(&folder.join(setting["directory"].as_str().unwrap()).join("seed-2/summary.json"));
    assert_eq!(own.methods["var"].values["rmse_analysis.h"], plain.methods["var"].values["rmse_analysis.h"]);
    assert_eq!(own.methods.len(), 1, "a method's own keys concern it alone");
    let of_seed = |seed: u64| {
        let path = folder.join(setting["directory"].as_str().unwrap()).join(format!("seed-{seed}/summary.json"));
        summary(&path).methods["var"].values["rmse_analysis.h"]
    };
    let mean = (1..=3).map(of_seed).sum::<f64>() / 3.0;
    assert!(near(&setting["scores"]["rmse_analysis.h"]["mean"], mean));
    assert!(setting["scores"]["rmse_analysis.h"]["interval"].is_object() && setting["scores"]["crps.h"].is_object());

    // The best is the least.
    let score = |own: &Value| own["scores"]["rmse_analysis.h"]["mean"].as_f64().unwrap();
    for method in ["free", "var", "fkf"] {
        let all = settings(method);
        // One for each value of the key that all methods share.
        let best: Vec<&Value> =
            json["best"][method].as_array().unwrap().iter().map(|it| &all[it.as_u64().unwrap() as usize]).collect();
        assert_eq!(best.len(), 2, "{method}");
        for best in best {
            let sigma = |own: &Value| own["values"]["networks.sondes.sigma_height_m"].clone();
            let same = all.iter().filter(|own| sigma(own) == sigma(best));
            assert!(same.into_iter().all(|own| score(own) >= score(best)), "{method}");
        }
    }
    assert!(said.contains("Best settings (*)") && said.contains("methods.var.covariance_scale = "), "{said}");
    let page = fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(page.matches("<svg").count() == 5 && !without_script(&page).contains("<script"));
    assert_eq!(fs::read_dir(folder.join("figures")).unwrap().count(), 5);
    // Two keys of `var`: all its means are in the cells, and a star is at the best of each value of the key that all share.
    let figures = fs::read_dir(folder.join("figures")).unwrap().map(|entry| entry.unwrap().path());
    let of_var = figures
        .filter(|path| path.to_string_lossy().ends_with("_var.svg") && path.to_string_lossy().contains("sweep_pair_"));
    let map = of_var.map(|path| fs::read_to_string(path).unwrap()).collect::<String>();
    let means: Vec<String> = settings("var").iter().map(|own| isobar::tables::figure(score(own))).collect();
    assert!(means.iter().all(|mean| map.contains(&format!(">{mean}"))), "{means:?}: {map}");
    assert_eq!((map.matches(" *</text>").count(), map.matches("stroke-width=\"2.4\"").count()), (2, 2));
    let table = fs::read_to_string(folder.join("sweep.csv")).unwrap();
    let rows = csv::Reader::from_reader(table.as_bytes()).records().map(Result::unwrap).count();
    let scores = |own: &Value| own["scores"].as_object().unwrap().len();
    let expected: usize =
        ["free", "var", "fkf"].iter().flat_map(|method| settings(method)).map(|own| scores(&own)).sum();
    assert_eq!(rows, expected);
    // The scenario of each setting is one that runs.
    let own = folder.join(setting["directory"].as_str().unwrap()).join("scenario.toml");
    assert!(isobar(here, &["check", own.to_str().unwrap()]).status.success());
}

#[test]
fn what_makes_no_sense_is_refused() {
    let complaint = |scenario: &str, arguments: &[&str]| {
        let directory = place(scenario);
        let output = isobar(directory.path(), arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(
            !directory.path().join("out").exists() || fs::read_dir(directory.path().join("out")).unwrap().count() == 0
        );
        text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ")
    };
    assert!(complaint(VALID, &["sweep", "small.toml"]).contains("a sweep needs [sweep]"));
    let wrong = format!("{VALID}[sweep.vary]\n\"methods.fkf.blocks\" = [\"cells\"]\n");
    for command in ["sweep", "check"] {
        let said = complaint(&wrong, &[command, "small.toml"]);
        assert!(said.contains("with methods.fkf.blocks = \"cells\"") && said.contains("small.toml:"), "{said}");
    }
    let score = format!("{VALID}[sweep]\nscore = \"rmse.h\"\nvary = {{ \"methods.fkf.blocks\" = [\"cell\"] }}\n");
    let said = complaint(&score, &["sweep", "small.toml", "--cycles", "2", "--quiet"]);
    assert!(said.contains("`sweep.score` cannot be \"rmse.h\"") && said.contains("rmse_analysis.h"), "{said}");
}

#[cfg(unix)]
mod interrupted {
    use super::*;
    use isobar::output::destination::complete_runs;
    use isobar::output::kept_runs::KeptRuns;
    use std::process::{Child, Command, Stdio};
    use std::time::Duration;

    fn start(here: &Path, arguments: &[&str]) -> Child {
        let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
        command.current_dir(here).args(arguments).stdout(Stdio::null()).stderr(Stdio::piped());
        command.spawn().unwrap()
    }

    /// Starts a batch and ends it when some of its runs are complete; what it says, and its exit code.
    fn interrupt(here: &Path, name: &str, arguments: &[&str], signal: &str) -> (String, Option<i32>) {
        let mut child = start(here, arguments);
        let outputs = here.join(format!("out/.{name}.partial/outputs"));
        while complete_runs(&outputs) < 2 {
            assert!(child.try_wait().unwrap().is_none(), "the batch was too fast");
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
        let output = child.wait_with_output().unwrap();
        (text(&output.stderr), output.status.code())
    }

    /// A file without what depends on times and threads.
    fn without_costs(mut json: Value) -> Value {
        json["schedule"] = Value::Null;
        for method in json["methods"].as_object_mut().unwrap().values_mut() {
            let settings: Vec<&mut Value> = match method {
                Value::Array(settings) => settings.iter_mut().map(|own| &mut own["scores"]).collect(),
                scores => vec![scores],
            };
            settings.into_iter().for_each(|scores| drop(scores.as_object_mut().unwrap().remove("seconds_per_cycle")));
        }
        json
    }

    /// A batch that is interrupted goes on with the runs that are left, and comes to the same.
    fn goes_on(name: &str, file: &str, command: &[&str], signal: &str) {
        let (broken, whole) = (place(&format!("{VALID}{SWEEP}")), place(&format!("{VALID}{SWEEP}")));
        let (here, there) = (broken.path(), whole.path());
        let command = [command, &["--quiet", "--cycles", "40", "--threads", "2"]].concat();
        let (said, code) = interrupt(here, name, &command, signal);
        let outputs = here.join(format!("out/.{name}.partial/outputs"));
        if signal == "-INT" {
            assert_eq!(code, Some(130), "{said}");
            assert!(said.contains("ended by a signal after") && said.contains("isobar resume"), "{said}");
            // Each of two threads had a run under way, or was between two.
            assert!(said.contains(&format!("{} are kept", KeptRuns::of(&outputs))), "{said}");
        }
        assert!(!here.join("out").join(name).exists());
        let kept = complete_runs(&outputs);
        assert!(kept >= 2);
        let again = isobar(here, &command);
        assert_eq!(again.status.code(), Some(1));
        assert!(text(&again.stderr).contains("a batch was interrupted there"), "{}", text(&again.stderr));
        assert_eq!(complete_runs(&outputs), kept, "what was refused took something away");
        let mark = find(&outputs).unwrap().join("mark");
        fs::write(&mark, "").unwrap();
        let mark = mark.strip_prefix(&outputs).unwrap().to_path_buf();

        let output = isobar(here, &["resume", &format!("out/{name}"), "--quiet", "--threads", "1"]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert!(here.join("out").join(name).join(mark).exists(), "a complete run was run again");
        assert!(isobar(there, &command).status.success());
        let [found, expected] =
            [here, there].map(|place| without_costs(json(&place.join("out").join(name).join(file))));
        assert_eq!(found, expected);
        assert_eq!(fs::read_dir(here.join("out")).unwrap().count(), 1, "nothing else is left");
        let complete = isobar(here, &["resume", &format!("out/{name}")]);
        assert!(text(&complete.stderr).contains("is complete"), "{}", text(&complete.stderr));
    }

    /// The directory of a complete run.
    fn find(directory: &Path) -> Option<std::path::PathBuf> {
        let paths = fs::read_dir(directory).ok()?.map(|entry| entry.unwrap().path()).filter(|path| path.is_dir());
        let mut named: Vec<_> =
            paths.filter(|path| !path.file_name().unwrap().to_string_lossy().starts_with('.')).collect();
        named.sort();
        named.into_iter().find_map(|path| if path.join("summary.json").is_file() { Some(path) } else { find(&path) })
    }

    #[test]
    fn seeds_go_on_after_a_signal_and_after_a_kill() {
        for signal in ["-INT", "-KILL"] {
            goes_on("small", "seeds.json", &["run", "small.toml", "--no-rerun", "--seeds", "12"], signal);
        }
    }

    #[test]
    fn sweeps_go_on_after_a_signal_and_after_a_kill() {
        for signal in ["-INT", "-KILL"] {
            goes_on("small-sweep", "sweep.json", &["sweep", "small.toml"], signal);
        }
    }

    #[test]
    fn a_batch_is_discarded_only_if_that_is_asked_for() {
        let directory = place(VALID);
        let here = directory.path();
        let command = ["run", "small.toml", "--quiet", "--no-rerun", "--seeds", "12", "--cycles", "40"];
        interrupt(here, "small", &command, "-KILL");
        let short = ["run", "small.toml", "--quiet", "--no-rerun", "--seeds", "3", "--cycles", "3", "--overwrite"];
        let output = isobar(here, &short);
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert_eq!(json(&here.join("out/small/seeds.json"))["seeds"], serde_json::json!([1, 2, 3]));
        assert_eq!(fs::read_dir(here.join("out")).unwrap().count(), 1);
    }
}
