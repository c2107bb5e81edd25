//! The tests of what runs under an MPI launcher: `cargo test --release --features mpi --test mpi`.

#[path = "../common/mod.rs"]
#[allow(dead_code, reason = "shared with the other tests")]
mod common;

mod shared;
mod speed;

use common::{VALID, isobar, text};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// What a launcher starts on several ranks of this machine, however few processors it has, and as whatever user.
fn launcher(directory: &Path, ranks: usize, arguments: &[&str]) -> Command {
    let mut command = Command::new("mpirun");
    command
        .args(["-n", &ranks.to_string(), "--oversubscribe", env!("CARGO_BIN_EXE_isobar")])
        .args(arguments)
        .current_dir(directory)
        .env("OMPI_ALLOW_RUN_AS_ROOT", "1")
        .env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
    command
}

fn on_ranks(directory: &Path, ranks: usize, arguments: &[&str]) -> Output {
    launcher(directory, ranks, arguments).output().expect("mpirun is on the PATH")
}

fn workplace() -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("small.toml"), VALID).unwrap();
    directory
}

/// The files below a directory, with their names.
fn files(directory: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    let mut left = vec![directory.to_path_buf()];
    while let Some(path) = left.pop() {
        for entry in fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_dir() {
                left.push(entry);
            } else {
                found.push((entry.strip_prefix(directory).unwrap().to_path_buf(), fs::read(&entry).unwrap()));
            }
        }
    }
    found.sort();
    found
}

/// A summary of seeds or of a sweep, without what it says of time, memory and how runs were distributed.
fn scores(path: &Path) -> Value {
    fn strip(value: &mut Value) {
        match value {
            Value::Object(entries) => {
                for cost in ["seconds_per_cycle", "peak_memory_bytes", "schedule", "ranks"] {
                    entries.shift_remove(cost);
                }
                entries.values_mut().for_each(strip);
            }
            Value::Array(values) => values.iter_mut().for_each(strip),
            _ => {}
        }
    }
    let mut value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    strip(&mut value);
    value
}

/// On two ranks one computes, on three two do.
#[test]
fn seeds_on_several_ranks_have_the_bits_of_one_process() {
    let directory = workplace();
    let here = directory.path();
    let arguments = ["run", "small.toml", "--quiet", "--seeds", "5", "--all-files", "--no-report", "--out"];
    let alone = isobar(here, &[&arguments[..], &["alone", "--threads", "1"]].concat());
    assert!(alone.status.success(), "{}", text(&alone.stderr));
    for ranks in [2, 3] {
        let out = format!("on_{ranks}");
        let output = on_ranks(here, ranks, &[&arguments[..], &[&out]].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert_eq!(text(&output.stdout).matches("Mean over 5 seeds").count(), 1, "rank 0 alone prints");
        let folder = |out: &str| here.join(out).join("small");
        assert_eq!(scores(&folder(&out).join("seeds.json")), scores(&folder("alone").join("seeds.json")));
        let fields = |out: &str| {
            let mut files = files(&folder(out));
            files.retain(|(path, _)| path.extension().is_some_and(|it| it == "nc"));
            files
        };
        assert!(fields("alone").len() >= 5);
        assert!(fields(&out) == fields("alone"), "fields differ on {ranks} ranks");
    }
}

#[test]
fn the_settings_of_a_sweep_are_computed_by_the_other_ranks() {
    let directory = workplace();
    let here = directory.path();
    let sweep = "\n[sweep]\nseeds = 2\n[sweep.vary]\n\"cycle.window_hours\" = [3, 6]\n";
    fs::write(here.join("small.toml"), VALID.to_string() + sweep).unwrap();
    let alone = isobar(here, &["sweep", "small.toml", "--quiet", "--threads", "1", "--out", "alone"]);
    assert!(alone.status.success(), "{}", text(&alone.stderr));
    let output = on_ranks(here, 3, &["sweep", "small.toml", "--quiet", "--out", "ranks"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let summary = |out: &str| scores(&here.join(out).join("small-sweep/sweep.json"));
    assert_eq!(summary("ranks"), summary("alone"));
}

#[test]
fn what_is_wrong_is_said_once() {
    let directory = workplace();
    let here = directory.path();
    let output = on_ranks(here, 3, &["run", "missing.toml"]);
    assert!(!output.status.success());
    assert_eq!(text(&output.stderr).matches("missing.toml").count(), 1, "{}", text(&output.stderr));
}

/// The process of a rank below the launcher.
fn process_of(launcher: &Child, rank: usize) -> Option<u32> {
    let wanted = format!("OMPI_COMM_WORLD_RANK={rank}");
    let all = fs::read_dir("/proc").unwrap().filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    all.into_iter().find(|process: &u32| {
        let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
        let environment = fs::read(format!("/proc/{process}/environ")).unwrap_or_default();
        status.lines().any(|line| line.split_whitespace().eq(["PPid:", &launcher.id().to_string()]))
            && environment.split(|byte| *byte == 0).any(|entry| entry == wanted.as_bytes())
    })
}

/// Waits until a run below a directory has a checkpoint.
fn wait_for_checkpoint(below: &Path) {
    let began = Instant::now();
    let has_checkpoint = || {
        let all = fs::read_dir(below).into_iter().flatten().flatten();
        // One that is being written has another extension.
        let is_complete = |path: &Path| {
            path.to_string_lossy().contains("checkpoint-")
                && path.extension().is_none_or(|extension| extension != "new")
        };
        all.flat_map(|entry| files(&entry.path())).any(|(path, _)| is_complete(&path))
    };
    while !has_checkpoint() {
        assert!(began.elapsed() < Duration::from_secs(120), "no run has begun");
        thread::sleep(Duration::from_millis(20));
    }
}

/// By default the launcher ends all processes with the first that dies: what was complete, and the checkpoints, are kept.
#[test]
fn a_batch_goes_on_after_a_process_has_died() {
    let directory = workplace();
    let here = directory.path();
    let longer = VALID.replace("count = 10", "count = 400");
    assert_ne!(longer, VALID);
    fs::write(here.join("small.toml"), longer).unwrap();
    let arguments = ["run", "small.toml", "--quiet", "--seeds", "6", "--no-report", "--out"];
    let begun = [&arguments[..], &["killed", "--checkpoint-cycles", "20"]].concat();
    let mut running =
        launcher(here, 3, &begun).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("mpirun is on the PATH");
    wait_for_checkpoint(&here.join("killed"));
    let worker = process_of(&running, 2).expect("rank 2 is a child of the launcher");
    assert!(Command::new("kill").args(["-9", &worker.to_string()]).status().unwrap().success());
    assert!(!running.wait().unwrap().success());
    assert!(!here.join("killed/small").exists(), "the batch is not complete");
    let resumed = on_ranks(here, 2, &["resume", "killed/small", "--quiet"]);
    assert!(resumed.status.success(), "{}", text(&resumed.stderr));
    let alone = isobar(here, &[&arguments[..], &["alone"]].concat());
    assert!(alone.status.success(), "{}", text(&alone.stderr));
    let summary = |out: &str| scores(&here.join(out).join("small/seeds.json"));
    assert_eq!(summary("killed"), summary("alone"));
}
