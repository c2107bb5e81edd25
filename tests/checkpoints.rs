//! Runs that end before their time: what is left, what goes on from it, and what is refused.
#![cfg(unix)]

use crate::common::{VALID, isobar, one_line, text};
use crate::outputs::Outputs;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const CYCLES: usize = 50;

/// Starts a run of some cycles, with a checkpoint after each.
fn start(parent: &Path, cycles: usize) -> Child {
    let cycles = cycles.to_string();
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    command.current_dir(parent).args(["run", "small.toml", "--no-rerun", "--no-report", "--quiet"]);
    command.args(["--cycles", &cycles, "--checkpoint-cycles", "1"]).stdout(Stdio::null()).stderr(Stdio::piped());
    command.spawn().unwrap()
}

/// Goes on with the run.
fn resume(parent: &Path) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isobar"));
    command.current_dir(parent).args(["resume", "out/small", "--quiet"]).stdout(Stdio::null()).stderr(Stdio::piped());
    command.spawn().unwrap()
}

/// A directory with the scenario, whose satellite observes within the window.
fn place() -> TempDir {
    let parent = tempfile::tempdir().unwrap();
    let scenario = VALID.replace("[networks.polar]\n", "[networks.polar]\ntimes_per_window = 6\n");
    fs::write(parent.path().join("small.toml"), scenario).unwrap();
    parent
}

/// The outputs of a run that nothing interrupts, and how long it takes.
fn undisturbed(cycles: usize) -> (Outputs, Duration) {
    let parent = place();
    let began = Instant::now();
    let output = start(parent.path(), cycles).wait_with_output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    (Outputs::of(&parent.path().join("out/small")), began.elapsed())
}

/// The checkpoints that are there, the oldest first.
fn checkpoints(parent: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(parent.join("out/.small.partial")) else { return Vec::new() };
    let paths = entries.map(|entry| entry.unwrap().path());
    let is_checkpoint = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        name.starts_with("checkpoint-") && !name.ends_with("new")
    };
    let mut all: Vec<PathBuf> = paths.filter(is_checkpoint).collect();
    all.sort();
    all
}

/// A run that was killed when it had at least two checkpoints.
fn interrupted(cycles: usize) -> TempDir {
    let parent = place();
    interrupt(parent.path(), cycles);
    parent
}

/// Starts a run, and kills it when it has two checkpoints.
fn interrupt(parent: &Path, cycles: usize) {
    let mut child = start(parent, cycles);
    while checkpoints(parent).len() < 2 {
        assert!(child.try_wait().unwrap().is_none(), "the run was too fast");
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_run_that_is_killed_a_hundred_times_is_the_same_in_the_end() {
    let (whole, mut time) = undisturbed(CYCLES);
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let (mut kills, mut resumed, mut anew, mut complete) = (0, 0, 0, 0);
    while kills < 100 {
        let parent = place();
        let destination = parent.path().join("out/small");
        let mut child = start(parent.path(), CYCLES);
        loop {
            // Some moments are early, before the first checkpoint; others late, when files are renamed.
            let (began, delay) = (Instant::now(), time.mul_f64(random.random::<f64>()));
            let mut ended = false;
            while !ended && began.elapsed() < delay {
                std::thread::sleep(Duration::from_micros(200));
                ended = child.try_wait().unwrap().is_some();
            }
            child.kill().unwrap();
            let output = child.wait_with_output().unwrap();
            // Others use the machine as well: about as long as a run takes now.
            time = if ended { (time + began.elapsed()) / 2 } else { time.mul_f64(1.03) };
            if ended {
                assert!(output.status.success(), "{}", text(&output.stderr));
                break;
            }
            kills += 1;
            // Complete, or not there at all.
            if destination.exists() {
                break;
            }
            child = if checkpoints(parent.path()).is_empty() {
                anew += 1;
                start(parent.path(), CYCLES)
            } else {
                resumed += 1;
                resume(parent.path())
            };
        }
        whole.assert_same(&Outputs::of(&destination), "after kills");
        complete += 1;
    }
    assert!(resumed > 20 && complete > 5, "{kills} kills, {resumed} resumed, {anew} anew, {complete} complete");
    println!("{kills} kills: {resumed} times resumed, {anew} times begun anew, {complete} complete runs");
}

#[test]
fn a_damaged_checkpoint_is_named_and_the_one_before_it_is_used() {
    let (whole, _) = undisturbed(CYCLES);
    type Spoil<'a> = &'a dyn Fn(&mut Vec<u8>);
    let spoil: [Spoil<'_>; 3] = [
        &|bytes| {
            let middle = bytes.len() / 2;
            bytes[middle] ^= 4;
        },
        &|bytes| bytes.truncate(bytes.len() - 100),
        &|bytes| bytes.clear(),
    ];
    for spoil in spoil {
        let parent = interrupted(CYCLES);
        let all = checkpoints(parent.path());
        let newest = all.last().unwrap();
        let mut bytes = fs::read(newest).unwrap();
        spoil(&mut bytes);
        fs::write(newest, bytes).unwrap();
        let output = resume(parent.path()).wait_with_output().unwrap();
        let said = text(&output.stderr);
        assert!(output.status.success(), "{said}");
        let name = newest.file_name().unwrap().to_string_lossy();
        assert!(said.contains(&*name) && said.contains("the checkpoint before it is used"), "{said}");
        whole.assert_same(&Outputs::of(&parent.path().join("out/small")), "after damage");
    }
}

/// What `isobar resume` says as it refuses, on one line.
fn refusal(parent: &Path) -> String {
    let output = resume(parent).wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(!parent.join("out/small").exists());
    one_line(&text(&output.stderr))
}

#[test]
fn what_is_of_another_version_or_scenario_is_refused_and_stays() {
    let parent = interrupted(CYCLES);
    let all = checkpoints(parent.path());
    let originals: Vec<Vec<u8>> = all.iter().map(|path| fs::read(path).unwrap()).collect();
    let replace = |change: &dyn Fn(&[u8]) -> Vec<u8>| {
        all.iter().zip(&originals).for_each(|(path, bytes)| fs::write(path, change(bytes)).unwrap());
    };
    let version = format!("version {}\n", env!("CARGO_PKG_VERSION"));
    replace(&|bytes| [b"isobar checkpoint 8, version 0.0.1\x1b[2J\n", &bytes[28 + version.len()..]].concat());
    let refused = refusal(parent.path());
    assert!(refused.contains("written by isobar 0.0.1\\u{1b}[2J, and this is"), "{refused}");
    replace(&|bytes| [b"isobar checkpoint 1, ", &bytes[b"isobar checkpoint 8, ".len()..]].concat());
    let refused = refusal(parent.path());
    assert!(refused.contains("it is a checkpoint of another format"), "{refused}");
    replace(&|bytes| b"something else\n".iter().chain(bytes).copied().collect());
    assert!(refusal(parent.path()).contains("it is not a checkpoint"));

    // The checkpoint of another run: it has another seed.
    let other = tempfile::tempdir().unwrap();
    fs::write(other.path().join("small.toml"), VALID.replace("seed = 1", "seed = 2")).unwrap();
    let mut child = start(other.path(), CYCLES);
    while checkpoints(other.path()).len() < 2 {
        assert!(child.try_wait().unwrap().is_none());
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let foreign = fs::read(checkpoints(other.path()).last().unwrap()).unwrap();
    replace(&|_| foreign.clone());
    let refused = refusal(parent.path());
    assert!(refused.contains("its scenario is another one"), "{refused}");

    // A journal that is damaged where it is needed.
    replace(&|bytes| bytes.to_vec());
    let journal = parent.path().join("out/.small.partial/journal");
    let bytes = fs::read(&journal).unwrap();
    let mut spoilt = bytes.clone();
    spoilt[bytes.len() / 3] ^= 1;
    fs::write(&journal, spoilt).unwrap();
    assert!(refusal(parent.path()).contains("journal: it is damaged"));

    // With everything as it was, the run goes on; until then a new run does not touch it.
    fs::write(&journal, bytes).unwrap();
    let again = isobar(parent.path(), &["run", "small.toml", "--no-rerun"]);
    assert_eq!(again.status.code(), Some(1));
    let said = one_line(&text(&again.stderr));
    assert!(said.contains("`isobar resume out/small` continues it"), "{said}");
    assert!(resume(parent.path()).wait().unwrap().success());
    let complete = isobar(parent.path(), &["resume", "out/small"]);
    assert!(text(&complete.stderr).contains("the run is complete"), "{}", text(&complete.stderr));
}

#[test]
fn a_run_goes_on_only_with_the_files_with_which_it_began() {
    let parent = tempfile::tempdir().unwrap();
    let buoys = "[networks.buoys]\nkind = \"file\"\nfile = \"buoys.csv\"\nvariable = \"h\"\nsigma = 5\n";
    let jet = "kind = \"jet\"\nmean_depth_m = 1000\nspeed_m_per_s = 10\nwidth_km = 200";
    assert!(VALID.contains(jet));
    let scenario = VALID
        .replace("{ regular = [3, 2] }", "{ file = \"stations.csv\" }")
        .replace("groups = [\"A\", \"B\"]\n", "group_by = \"group\"\n")
        .replace("[methods.free]", &format!("{buoys}\n[methods.free]"))
        .replace(jet, "kind = \"file\"\nfile = \"state.csv\"");
    let rows = |count, row: &dyn Fn(usize) -> String| (1..=count).map(row).collect::<String>();
    let files = [
        ("small.toml", scenario),
        ("stations.csv", "id,x_m,y_m,group\n1,210000,220000,A\n2,430000,310000,B\n".to_string()),
        ("buoys.csv", "cycle,x_m,y_m,value\n".to_string() + &rows(CYCLES, &|cycle| format!("{cycle},3e5,2e5,1000\n"))),
        ("state.csv", "h,u,v\n".to_string() + &rows(48, &|_| "1000,0,0\n".to_string())),
    ];
    let write = |name: &str, contents: &str| fs::write(parent.path().join(name), contents).unwrap();
    files.iter().for_each(|(name, contents)| write(name, contents));
    interrupt(parent.path(), CYCLES);
    for ((name, contents), (old, new)) in files[1..].iter().zip([
        ("430000", "430001"),
        ("50,3e5,2e5,1000", "50,3e5,2e5,1001"),
        ("1000,0,0", "1000,0.1,0"),
    ]) {
        assert!(contents.contains(old));
        write(name, &contents.replacen(old, new, 1));
        let refused = refusal(parent.path());
        assert!(refused.contains(&format!("what it reads has changed since: {name}")), "{refused}");
        // What it says is the same.
        write(name, &format!("# a remark\n\n{}", contents.replace('\n', "\r\n")));
    }
    assert!(resume(parent.path()).wait().unwrap().success());
}

#[test]
fn a_signal_ends_the_run_after_the_cycle_with_a_checkpoint() {
    // Enough for the signal to come before the last, on any machine.
    let cycles = 4 * CYCLES;
    let (whole, _) = undisturbed(cycles);
    for signal in ["-INT", "-TERM", "-HUP"] {
        let parent = place();
        let mut child = start(parent.path(), cycles);
        while checkpoints(parent.path()).is_empty() {
            assert!(child.try_wait().unwrap().is_none());
        }
        // A terminal that is closed says so twice.
        for _ in 0..if signal == "-HUP" { 2 } else { 1 } {
            let sent = Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
            assert!(sent.success());
        }
        let output = child.wait_with_output().unwrap();
        let said = one_line(&text(&output.stderr));
        assert_eq!(output.status.code(), Some(130), "{said}");
        assert!(said.contains("ending after this cycle") && said.contains("ended by a signal after cycle"), "{said}");
        assert!(said.contains("`isobar resume out/small` continues it"), "{said}");
        assert!(resume(parent.path()).wait().unwrap().success());
        whole.assert_same(&Outputs::of(&parent.path().join("out/small")), signal);
    }
}

/// As `nohup` starts it, a run does not notice that the terminal is closed.
#[test]
#[cfg(target_os = "linux")]
fn a_run_that_is_immune_to_hangups_runs_to_its_end() {
    let parent = place();
    let line =
        "trap '' HUP; exec \"$0\" run small.toml --no-rerun --no-report --quiet --cycles 50 --checkpoint-cycles 1";
    let mut command = Command::new("sh");
    command.current_dir(parent.path()).args(["-c", line, env!("CARGO_BIN_EXE_isobar")]).stdout(Stdio::null());
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    while checkpoints(parent.path()).is_empty() {
        assert!(child.try_wait().unwrap().is_none());
    }
    assert!(Command::new("kill").args(["-HUP", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(parent.path().join("out/small/summary.json").is_file());
}
