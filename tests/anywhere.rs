//! The program without its sources: in an empty directory it has all scenarios.

use crate::common::{VALID, isobar, text};
use isobar::scenario::Scenario;
use isobar::shipped;
use std::fs;
use std::path::Path;
use tempfile::tempdir;

/// The scenario of a name, in a checkout.
fn in_checkout(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios").join(name)).unwrap()
}

#[test]
fn the_quickstart_is_listed_checked_and_run_in_an_empty_directory() {
    let directory = tempdir().unwrap();
    let here = directory.path();
    let list = isobar(here, &["list"]);
    assert!(list.status.success() && text(&list.stdout).contains("quickstart"), "{}", text(&list.stderr));
    assert!(!text(&list.stdout).contains("In isobar"), "a heading without a second list");
    let check = isobar(here, &["check", "quickstart", "isobar:/sensor_care.toml"]);
    assert!(check.status.success(), "{}", text(&check.stderr));
    let run = isobar(here, &["run", "quickstart", "--methods", "free,var", "--cycles", "9", "--quiet", "--no-rerun"]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    assert!(here.join("out/quickstart/var.nc").is_file() && here.join("out/quickstart/report.html").is_file());
    let unknown = isobar(here, &["check", "quikstart"]);
    assert!(text(&unknown.stderr).contains("did you mean `quickstart`?"), "{}", text(&unknown.stderr));
    for name in ["isobar:/none.toml", "isobar:/../Cargo.toml"] {
        assert_eq!(isobar(here, &["check", name]).status.code(), Some(1), "{name}");
    }
    let accepted = isobar(here, &["regress", "quickstart", "--accept"]);
    assert!(text(&accepted.stderr).contains("isobar init --from quickstart quickstart.toml"));
}

/// The database of sensors is read where it is, too.
#[test]
fn a_run_with_a_database_inside_the_program_is_that_of_the_checkout() {
    let directory = tempdir().unwrap();
    let scores = |scenario: &str, out: &str| {
        let run =
            ["run", scenario, "--cycles", "11", "--quiet", "--no-rerun", "--no-report", "--no-netcdf", "--out", out];
        let run = isobar(directory.path(), &run);
        assert!(run.status.success(), "{}", text(&run.stderr));
        fs::read(directory.path().join(out).join("sensor_care/readings.csv")).unwrap()
    };
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/sensor_care.toml");
    assert!(scores("sensor_care", "a") == scores(file.to_str().unwrap(), "b"));
}

#[test]
fn a_scenario_of_the_user_goes_before_the_one_of_that_name_inside_the_program() {
    let directory = tempdir().unwrap();
    let here = directory.path();
    fs::create_dir(here.join("scenarios")).unwrap();
    fs::write(here.join("scenarios/quickstart.toml"), VALID).unwrap();
    let cells = |output: std::process::Output| text(&output.stdout).split(';').nth(1).map(String::from).unwrap();
    let own = cells(isobar(here, &["check", "quickstart"]));
    assert_eq!(own, cells(isobar(here, &["check", "scenarios/quickstart.toml"])));
    assert_ne!(own, cells(isobar(here, &["check", "isobar:/quickstart.toml"])));
    let list = text(&isobar(here, &["list"]).stdout);
    let (before, after) = list.split_once("In isobar\n").expect("two lists");
    assert!(before.starts_with("In ./scenarios\n") && before.contains("quickstart") && !after.contains("quickstart"));
}

#[test]
fn every_scenario_inside_the_program_can_be_written_with_its_files() {
    let mut files = 0;
    for path in shipped::scenarios() {
        let directory = tempdir().unwrap();
        let name = path.file_stem().unwrap().to_str().unwrap();
        let init = isobar(directory.path(), &["init", "--from", name, "mine.toml"]);
        assert!(init.status.success(), "{name}: {}", text(&init.stderr));
        let mine = Scenario::load(&directory.path().join("mine.toml")).unwrap();
        assert_eq!(mine.text, in_checkout(&format!("{name}.toml")));
        for (file, path) in mine.files() {
            assert!(text(&init.stdout).contains(file) && path.is_file(), "{name}: {file} is not named or not there");
            files += 1;
        }
    }
    assert!(files >= 8, "{files}");
}

#[test]
fn init_writes_everything_or_nothing() {
    let directory = tempdir().unwrap();
    let here = directory.path();
    let init = |name: &str| isobar(here, &["init", "--from", "quickstart", name]);
    assert!(init("mine.toml").status.success());
    assert_eq!(init("mine.toml").status.code(), Some(1), "a file is replaced");
    // The stations are there already.
    let again = init("other.toml");
    assert!(
        again.status.success() && text(&again.stdout).starts_with("wrote other.toml; now"),
        "{}",
        text(&again.stdout)
    );
    fs::write(here.join("stations/europe.csv"), "mine").unwrap();
    let refused = init("third.toml");
    let message = text(&refused.stderr);
    assert!(message.contains("stations/europe.csv exists; nothing was written"), "{message}");
    assert!(!here.join("third.toml").exists());
    assert_eq!(fs::read_to_string(here.join("stations/europe.csv")).unwrap(), "mine");
    // A file is where a directory should be.
    fs::create_dir(here.join("sub")).unwrap();
    fs::write(here.join("sub/stations"), "").unwrap();
    assert_eq!(init("sub/mine.toml").status.code(), Some(1));
    assert_eq!(fs::read_dir(here.join("sub")).unwrap().count(), 1, "something is left");
    let missing = isobar(here, &["init", "no/such/mine.toml"]);
    assert!(text(&missing.stderr).contains("mkdir -p no/such"), "{}", text(&missing.stderr));
}

/// What a run leaves names files inside the program in a way that leads there from anywhere.
#[test]
fn the_text_of_a_scenario_inside_the_program_can_stand_anywhere() {
    let path = shipped::scenarios().find(|path| path.ends_with("model_patterns.toml")).unwrap();
    let scenario = Scenario::load(&path).unwrap();
    let directory = tempdir().unwrap();
    let moved = directory.path().join("moved.toml");
    fs::write(&moved, scenario.text_in(directory.path())).unwrap();
    let moved = Scenario::load(&moved).unwrap();
    assert!(moved.text.contains("\"isobar:/patterns/wave.csv\""));
    assert!(moved.tables.values().eq(scenario.tables.values()) && !moved.tables.is_empty());
    assert_eq!(moved.text_in(Path::new("elsewhere")), moved.text);
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_of_a_scenario_inside_the_program_goes_on() {
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};
    let directory = tempdir().unwrap();
    let here = directory.path();
    let options = ["--methods", "free", "--quiet", "--no-rerun", "--no-report", "--checkpoint-cycles", "1"];
    let arguments = [&["run", "continental_us"], &options[..]].concat();
    let mut child = Command::new(env!("CARGO_BIN_EXE_isobar"));
    let mut child =
        child.current_dir(here).args(&arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begun = Instant::now();
    let has_checkpoint = || {
        let working = fs::read_dir(here.join("out")).ok()?.next()?.ok()?.path();
        let mut names = fs::read_dir(working).ok()?.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        names.find(|name| name.starts_with("checkpoint") && !name.contains('.'))
    };
    while has_checkpoint().is_none() && child.try_wait().unwrap().is_none() {
        assert!(begun.elapsed() < Duration::from_secs(60), "there is no checkpoint");
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let resume = isobar(here, &["resume", "out/continental_us", "--quiet"]);
    assert!(resume.status.success(), "{}", text(&resume.stderr));
    assert!(here.join("out/continental_us/free.nc").is_file());
}
