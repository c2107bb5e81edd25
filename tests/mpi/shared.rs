//! One run that all ranks compute together.

use super::common::{VALID, isobar, text};
use super::{files, launcher, on_ranks, process_of, scores, wait_for_checkpoint};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tempfile::TempDir;

const LETKF: &str = "\n[methods.letkf]\nkind = \"letkf\"\nmembers = 7\nlocalization_radius_km = 400\n";

/// A directory with a scenario of this number of cycles.
fn workplace(cycles: usize) -> TempDir {
    let directory = tempfile::tempdir().unwrap();
    let text = VALID.replace("count = 10", &format!("count = {cycles}")) + LETKF;
    fs::write(directory.path().join("small.toml"), text).unwrap();
    directory
}

fn run_alone(here: &Path, out: &str) {
    let output = isobar(here, &["run", "small.toml", "--quiet", "--threads", "1", "--out", out]);
    assert!(output.status.success(), "{}", text(&output.stderr));
}

/// Panics unless two summaries have the same scores but for rounding, which grows over hundreds of cycles.
fn assert_near(one: &Value, other: &Value) {
    match (one, other) {
        (Value::Object(one), Value::Object(other)) => {
            assert!(one.keys().eq(other.keys()), "{one:?} and {other:?}");
            one.iter().zip(other).for_each(|((_, one), (_, other))| assert_near(one, other));
        }
        (Value::Array(one), Value::Array(other)) => {
            assert_eq!(one.len(), other.len());
            one.iter().zip(other).for_each(|(one, other)| assert_near(one, other));
        }
        (Value::Number(one), Value::Number(other)) => {
            let [one, other] = [one, other].map(|it| it.as_f64().unwrap());
            assert!((one - other).abs() <= 1e-7 * one.abs().max(1e-3), "{one} and {other}");
        }
        _ => assert_eq!(one, other),
    }
}

fn assert_same_run(here: &Path, one: &str, other: &str) {
    let folder = |out: &str| here.join(out).join("small");
    let summary = |out: &str| scores(&folder(out).join("summary.json"));
    assert_near(&summary(one), &summary(other));
    let names = |out: &str| files(&folder(out)).into_iter().map(|(path, _)| path).collect::<BTreeSet<PathBuf>>();
    assert_eq!(names(one), names(other));
}

#[test]
fn a_run_on_several_ranks_is_that_of_one_process() {
    let directory = workplace(10);
    let here = directory.path();
    run_alone(here, "alone");
    for ranks in [2, 3] {
        let out = format!("on_{ranks}");
        let output = on_ranks(here, ranks, &["run", "small.toml", "--quiet", "--threads", "1", "--out", &out]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert_eq!(text(&output.stderr), "");
        assert_eq!(text(&output.stdout).matches("Files: ").count(), 1, "rank 0 alone prints");
        assert_same_run(here, "alone", &out);
    }
}

/// One after the other; a batch between them is computed as always.
#[test]
fn two_scenarios_are_computed_one_after_the_other() {
    let directory = workplace(10);
    let here = directory.path();
    fs::copy(here.join("small.toml"), here.join("other.toml")).unwrap();
    run_alone(here, "alone");
    let output = on_ranks(here, 2, &["run", "small.toml", "other.toml", "--quiet", "--out", "both"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_same_run(here, "alone", "both");
    assert!(here.join("both/other/summary.json").is_file());
}

/// The launcher ends all processes with the first that dies; the checkpoint is continued on fewer ranks, and without MPI.
#[test]
fn a_run_goes_on_after_a_process_has_died() {
    let directory = workplace(300);
    let here = directory.path();
    let begin = |out: &str| {
        let arguments = ["run", "small.toml", "--quiet", "--threads", "1", "--checkpoint-cycles", "5", "--out", out];
        let mut command = launcher(here, 3, &arguments);
        command.stdout(Stdio::null()).stderr(Stdio::null());
        let running = command.spawn().expect("mpirun is on the PATH");
        wait_for_checkpoint(&here.join(out));
        running
    };
    let mut resume_on_two = launcher(here, 2, &["resume", "killed/small", "--quiet", "--threads", "1"]);
    let mut resume_alone = Command::new(env!("CARGO_BIN_EXE_isobar"));
    resume_alone.args(["resume", "asked/small", "--quiet", "--threads", "1"]).current_dir(here);
    run_alone(here, "alone");
    let mut killed = begin("killed");
    let worker = process_of(&killed, 2).expect("rank 2 is a child of the launcher");
    assert!(Command::new("kill").args(["-9", &worker.to_string()]).status().unwrap().success());
    assert!(!killed.wait().unwrap().success());
    // Asked to end in good order, by a signal to one rank.
    let mut asked = begin("asked");
    let worker = process_of(&asked, 1).expect("rank 1 is a child of the launcher");
    assert!(Command::new("kill").args(["-TERM", &worker.to_string()]).status().unwrap().success());
    assert!(!asked.wait().unwrap().success());
    for (out, resume) in [("killed", &mut resume_on_two), ("asked", &mut resume_alone)] {
        assert!(!here.join(out).join("small").exists(), "the run is not complete");
        let output = resume.output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert_same_run(here, "alone", out);
    }
}

#[test]
fn what_ranks_cannot_compute_together_is_refused() {
    let directory = workplace(10);
    let here = directory.path();
    let path = here.join("small.toml");
    let more = fs::read_to_string(&path).unwrap() + "[methods.var]\nkind = \"3dvar\"\n";
    fs::write(&path, more).unwrap();
    let output = on_ranks(here, 3, &["run", "small.toml", "--quiet", "--out", "out"]);
    let message = text(&output.stderr);
    assert!(!output.status.success() && message.contains("var (kind = \"3dvar\")"), "{message}");
    assert!(message.contains("--methods") && message.matches("3dvar").count() == 1, "{message}");
    assert!(!here.join("out").exists());
    let arguments = ["run", "small.toml", "--quiet", "--out", "out", "--methods", "free,letkf"];
    let output = on_ranks(here, 3, &arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    // Another run is there now: in good order, and once.
    let output = on_ranks(here, 3, &arguments);
    let message = text(&output.stderr);
    assert!(!output.status.success() && message.contains("--overwrite"), "{message}");
    assert!(!message.contains("rank 1") && !message.contains("MPI_ABORT"), "{message}");
}

/// If rank 0 cannot write a checkpoint, the job ends, and the other ranks do not hang.
#[test]
fn a_rank_that_fails_ends_the_job() {
    let directory = workplace(300);
    let here = directory.path();
    let arguments = ["run", "small.toml", "--quiet", "--threads", "1", "--checkpoint-cycles", "5", "--out", "out"];
    let running = launcher(here, 3, &arguments).stderr(Stdio::piped()).spawn().expect("mpirun is on the PATH");
    wait_for_checkpoint(&here.join("out"));
    fs::rename(here.join("out/.small.partial"), here.join("moved")).unwrap();
    let output = running.wait_with_output().unwrap();
    let message = text(&output.stderr);
    assert!(!output.status.success() && message.contains("cannot write"), "{message}");
    assert!(files(&here.join("moved")).iter().any(|(path, _)| path.to_string_lossy().starts_with("checkpoint-")));
}
