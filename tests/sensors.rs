//! The database of sensors, as the user of the program sees it.

#[cfg(unix)]
use crate::common::{VALID, isobar, text};
use netcdf_reader::NcFile;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rusqlite::Connection;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::tempdir;

const TABLE: &str = "\u{feff}record,sensor,time,value,sigma,reference,other_sensor,unit,x_m,y_m,origin,note\n\
    # a remark\n\
    sensor,sondes/h/B,,,,,,m,1e5,-2.5,,\"type \"\"RS41\"\", new\"\n\
    sensor,polar/offset,,,,,,m,,,,\n\
    calibration,sondes/h/B,2026-01-01T00:00:00Z,3.25,0.1,,,,,,laboratory,\n\
    calibration,polar/offset,2026-01-01T00:00:00Z,-7,0.30000000000000004,,,,,,laboratory,\n\
    covariance,sondes/h/B,2026-01-01T00:00:00Z,0.02,,,polar/offset,,,,laboratory,\n\
    test_point,sondes/h/B,2026-01-02T00:00:00Z,1003.5,0.5,1000,,,,,,\n\
    recalibration,sondes/h/B,2026-01-16T06:00:00Z,5,0.5,,,,,,,new software\n";

/// The small scenario with a database.
fn scenario(writes: bool) -> String {
    let writes = if writes { "writes = \"fkf\"\n" } else { "" };
    format!("{VALID}\n[sensors]\ndatabase = \"known.db\"\n{writes}")
}

fn place() -> tempfile::TempDir {
    let parent = tempdir().unwrap();
    fs::write(parent.path().join("known.csv"), TABLE).unwrap();
    parent
}

fn succeeds(parent: &Path, arguments: &[&str]) -> String {
    let output = isobar(parent, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

fn fails(parent: &Path, arguments: &[&str]) -> String {
    let output = isobar(parent, arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {}", text(&output.stdout));
    // As one line, whatever the width of the terminal.
    text(&output.stderr).replace(['\n', '│', '×'], " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn the_table_in_the_help_can_be_imported() {
    let parent = place();
    let help = succeeds(parent.path(), &["sensors", "import", "--help"]);
    let (_, table) = help.split_once("\n\nrecord,").expect("the help has a table");
    fs::write(parent.path().join("example.csv"), format!("record,{table}")).unwrap();
    let imported = succeeds(parent.path(), &["sensors", "import", "example.db", "example.csv"]);
    assert!(imported.contains("7 of 7 records are new"), "{imported}");
}

#[test]
fn what_is_exported_can_be_imported_to_the_bit_and_twice_is_once() {
    let parent = place();
    let parent = parent.path();
    assert!(succeeds(parent, &["sensors", "import", "known.db", "known.csv"]).contains("7 of 7 records are new"));
    assert!(succeeds(parent, &["sensors", "import", "known.db", "known.csv"]).contains("0 of 7 records are new"));
    let exported = succeeds(parent, &["sensors", "export", "known.db"]);
    assert!(exported.contains("0.30000000000000004") && exported.contains("\"type \"\"RS41\"\", new\""), "{exported}");
    succeeds(parent, &["sensors", "export", "known.db", "--out", "again.csv"]);
    succeeds(parent, &["sensors", "import", "again.db", "again.csv"]);
    assert_eq!(succeeds(parent, &["sensors", "export", "again.db"]), exported);
    let listed = succeeds(parent, &["sensors", "list", "known.db"]);
    assert!(listed.contains("3.2500 ± 0.1000") && listed.contains("2026-01-01T00:00:00Z"), "{listed}");
    let shown = succeeds(parent, &["sensors", "show", "known.db", "sondes/h/B"]);
    for part in ["x = 100000 m", "bias 3.25 ± 0.1", "showed 1003.5 for 1000", "recalibrated by +5 ± 0.5; new software"]
    {
        assert!(shown.contains(part), "{part} is missing: {shown}");
    }
}

#[test]
fn a_table_with_a_bad_row_changes_nothing_and_the_row_is_named() {
    let parent = place();
    let parent = parent.path();
    succeeds(parent, &["sensors", "import", "known.db", "known.csv"]);
    let before = succeeds(parent, &["sensors", "export", "known.db"]);
    let header = TABLE.lines().next().unwrap().trim_start_matches('\u{feff}');
    let good = "sensor,other,,,,,,m,,,,";
    for (row, expected) in [
        ("sensr,a,,,,,,m,,,,", "`record` cannot be \"sensr\"; did you mean `sensor`?"),
        ("sensor,,,,,,,m,,,,", "`sensor` is empty"),
        ("sensor,a,,,,,,,,,,", "`unit` is empty, but a sensor must have it"),
        ("sensor,a,,1,,,,m,,,,", "`value` is \"1\", but a sensor has none"),
        ("sensor,a,,,,,,m,1,,,", "a place has both `x_m` and `y_m`"),
        ("sensor,sondes/h/B,,,,,,K,,,,", "the unit of \"sondes/h/B\" is m, not K"),
        ("sensor,a\u{1b}[2J,,,,,,m,,,,", "`sensor` must be at most 200 printable characters"),
        ("calibration,nobody,2026-01-01T00:00:00Z,1,1,,,,,,lab,", "there is no sensor \"nobody\""),
        (
            "calibration,other,2026-01-01,1,1,,,,,,lab,",
            "`time` is `2026-01-01`, but must be a time such as 2026-01-15T06:00:00Z",
        ),
        ("calibration,other,1700-01-01T00:00:00Z,1,1,,,,,,lab,", "`time` must be from 1900 to 2200"),
        ("calibration,other,2026-01-01T00:00:00Z,one,1,,,,,,lab,", "`value` is `one`, but must be a finite number"),
        ("calibration,other,2026-01-01T00:00:00Z,nan,1,,,,,,lab,", "`value` is `nan`, but must be a finite number"),
        ("calibration,other,2026-01-01T00:00:00Z,1,-1,,,,,,lab,", "`sigma` is -1, but must be a number greater than 0"),
        ("calibration,sondes/h/B,2026-01-01T00:00:00Z,4,0.1,,,,,,laboratory,", "contradicts another record"),
        (
            "covariance,other,2026-01-01T00:00:00Z,1,,,sondes/h/B,,,,laboratory,",
            "\"other\" has no calibration of this time",
        ),
        (
            "covariance,polar/offset,2026-01-01T00:00:00Z,1,,,sondes/h/B,,,,laboratory,",
            "more than the standard deviations",
        ),
        (
            "recalibration,sondes/h/B,2026-01-16T06:00:00Z,-5,0.5,,,,,,,",
            "contradicts another recalibration of \"sondes/h/B\"",
        ),
        ("sensor,a,,,,,,m", "there are 8 fields, but the header has 12 columns"),
    ] {
        fs::write(parent.join("bad.csv"), format!("{header}\n{good}\n\n{row}\n")).unwrap();
        let message = fails(parent, &["sensors", "import", "known.db", "bad.csv"]);
        assert!(message.contains("bad.csv, line 4") && message.contains(expected), "{row}: {message}");
        assert_eq!(succeeds(parent, &["sensors", "export", "known.db"]), before, "{row}");
    }
    for (text, expected) in [
        ("", "has no records"),
        ("record,sensr\n", "unknown column `sensr`; did you mean `sensor`?"),
        ("record,record\n", "two columns `record`"),
        ("record\n", "no column `sensor`"),
    ] {
        fs::write(parent.join("bad.csv"), text).unwrap();
        assert!(fails(parent, &["sensors", "import", "known.db", "bad.csv"]).contains(expected), "{text}");
    }
    fs::write(parent.join("bad.csv"), b"record,sensor\nsensor,\xff\n").unwrap();
    assert!(
        fails(parent, &["sensors", "import", "known.db", "bad.csv"]).contains("line 2: the byte 0xff is not UTF-8")
    );
}

#[test]
fn text_is_text_and_never_sql() {
    let parent = place();
    let parent = parent.path();
    let name = "x'); DROP TABLE sensor; --";
    fs::write(
        parent.join("hostile.csv"),
        format!("record,sensor,unit,note\nsensor,{name},m,'; DELETE FROM calibration; --\n"),
    )
    .unwrap();
    succeeds(parent, &["sensors", "import", "known.db", "known.csv"]);
    succeeds(parent, &["sensors", "import", "known.db", "hostile.csv"]);
    succeeds(parent, &["sensors", "recalibrate", "known.db", name, "--time", "2026-05-01T00:00:00Z", "--step", "-2"]);
    let exported = succeeds(parent, &["sensors", "export", "known.db"]);
    assert!(exported.contains(name) && exported.matches("calibration,").count() == 4, "{exported}");
    let message = fails(parent, &["sensors", "show", "known.db", "sondes/h/b"]);
    assert!(message.contains("did you mean `sondes/h/B`?"), "{message}");
}

/// A name, what is done to the file, and what the message must say.
type SpoiltDatabase = (&'static str, &'static dyn Fn(&Path), &'static str);

#[test]
fn other_databases_are_refused_each_for_its_reason() {
    let parent = place();
    let parent = parent.path();
    succeeds(parent, &["sensors", "import", "known.db", "known.csv"]);
    fs::write(parent.join("run.toml"), scenario(false)).unwrap();
    let good = fs::read(parent.join("known.db")).unwrap();
    let cases: [SpoiltDatabase; 8] = [
        ("gone", &|path| fs::remove_file(path).unwrap(), "there is no such database"),
        ("empty", &|path| fs::write(path, "").unwrap(), "it is empty"),
        ("text", &|path| fs::write(path, TABLE).unwrap(), "it is not an SQLite database"),
        (
            "other",
            &|path| {
                fs::remove_file(path).unwrap();
                Connection::open(path).unwrap().execute_batch("CREATE TABLE a (b)").unwrap();
            },
            "of another program",
        ),
        (
            "version",
            &|path| Connection::open(path).unwrap().pragma_update(None, "user_version", 7).unwrap(),
            "its tables are of version 7, but this isobar knows version 1",
        ),
        (
            "trigger",
            &|path| {
                let sql = "CREATE TRIGGER t AFTER INSERT ON sensor BEGIN DELETE FROM calibration; END";
                Connection::open(path).unwrap().execute_batch(sql).unwrap();
            },
            "its tables are not those of a database of sensors",
        ),
        (
            "contradiction",
            &|path| {
                let sql = "UPDATE calibration SET sigma = -1";
                Connection::open(path).unwrap().execute_batch(sql).unwrap();
            },
            "`sigma` is -1",
        ),
        (
            "unit",
            &|path| {
                let sql = "UPDATE sensor SET unit = 'K'";
                Connection::open(path).unwrap().execute_batch(sql).unwrap();
            },
            "is in m here, but in K there",
        ),
    ];
    for (name, spoil, expected) in cases {
        fs::write(parent.join("known.db"), &good).unwrap();
        spoil(&parent.join("known.db"));
        let message = fails(parent, &["check", "run.toml"]);
        assert!(message.contains("known.db") && message.contains(expected), "{name}: {message}");
        // With its place in the scenario.
        assert!(message.contains("database = \"known.db\""), "{name}: {message}");
    }
    // Whatever happens to its bytes: an error, or what was there, but no panic.
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..60 {
        let mut bytes = good.clone();
        for _ in 0..random.random_range(1..20) {
            let at = random.random_range(0..bytes.len());
            bytes[at] = random.random();
        }
        fs::write(parent.join("known.db"), &bytes).unwrap();
        let output = isobar(parent, &["sensors", "export", "known.db"]);
        let errors = text(&output.stderr);
        assert!(matches!(output.status.code(), Some(0 | 1)) && !errors.contains("panicked"), "{errors}");
    }
}

/// Each import is one transaction: whenever it is killed, all of it is there or nothing.
#[cfg(unix)]
#[test]
fn an_import_that_is_killed_leaves_the_database_as_it_was_or_complete() {
    let parent = place();
    let parent = parent.path();
    let mut table = String::from("record,sensor,unit,time,value,sigma,origin\n");
    for number in 0..4000 {
        writeln!(table, "sensor,s{number},m,,,,").unwrap();
    }
    for number in 0..4000 {
        writeln!(table, "calibration,s{number},,2026-01-01T00:00:00Z,{number}.5,1,lab").unwrap();
    }
    fs::write(parent.join("large.csv"), table).unwrap();
    succeeds(parent, &["sensors", "import", "small.db", "known.csv"]);
    let before = succeeds(parent, &["sensors", "export", "small.db"]);
    fs::copy(parent.join("small.db"), parent.join("whole.db")).unwrap();
    let began = Instant::now();
    succeeds(parent, &["sensors", "import", "whole.db", "large.csv"]);
    let time = began.elapsed();
    let after = succeeds(parent, &["sensors", "export", "whole.db"]);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let (mut untouched, mut complete, mut journals) = (0, 0, 0);
    for _ in 0..60 {
        fs::copy(parent.join("small.db"), parent.join("killed.db")).unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_isobar"))
            .current_dir(parent)
            .args(["sensors", "import", "killed.db", "large.csv"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(time.mul_f64(1.1 * random.random::<f64>()).max(Duration::from_micros(200)));
        child.kill().unwrap();
        child.wait().unwrap();
        journals += usize::from(parent.join("killed.db-journal").exists());
        let found = succeeds(parent, &["sensors", "export", "killed.db"]);
        if found == before {
            untouched += 1;
        } else {
            assert_eq!(found, after);
            complete += 1;
        }
    }
    assert!(untouched > 0, "{untouched} untouched, {complete} complete, {journals} in the middle of a transaction");
}

#[test]
fn a_run_starts_with_what_the_last_one_knew_and_the_same_database_gives_the_same_bits() {
    let parent = place();
    let parent = parent.path();
    let quiet = ["--quiet", "--no-report", "--no-rerun", "--no-netcdf"];
    let run = |scenario: &str, out: &str| succeeds(parent, &[&["run", scenario, "--out", out], &quiet[..]].concat());
    fs::write(parent.join("first.toml"), scenario(true)).unwrap();
    // The first run of a chain finds no database, and makes it.
    assert!(run("first.toml", "out").contains("5 new records in"));
    let first = fs::read_to_string(parent.join("out/first/sensors.csv")).unwrap();
    assert_eq!(succeeds(parent, &["sensors", "export", "known.db"]).trim_end(), first.trim_end());
    // Once more: what it writes is later than its start, so nothing changes.
    assert!(run("first.toml", "again").contains("0 new records in"));
    assert_eq!(fs::read_to_string(parent.join("again/first/sensors.csv")).unwrap(), first);
    // A later run knows it.
    let later = scenario(false).replace("2026-01-15T00:00:00Z", "2026-03-01T00:00:00Z");
    fs::write(parent.join("later.toml"), &later).unwrap();
    fs::write(parent.join("cold.toml"), later.split("[sensors]").next().unwrap()).unwrap();
    fs::write(parent.join("threads.toml"), &later).unwrap();
    run("later.toml", "out");
    run("cold.toml", "out");
    succeeds(parent, &[&["run", "threads.toml", "--out", "out", "--threads", "3"], &quiet[..]].concat());
    let summary = |name: &str| -> serde_json::Value {
        serde_json::from_str(&fs::read_to_string(parent.join(format!("out/{name}/summary.json"))).unwrap()).unwrap()
    };
    let of = |name: &str, score: &str| summary(name)["methods"]["fkf"][score].clone();
    for score in ["rmse_analysis", "bias_rmse", "bias_spread", "innovation_chi2"] {
        assert_eq!(of("later", score), of("threads", score));
    }
    let [warm, cold] = ["later", "cold"].map(|name| of(name, "bias_spread").as_f64().unwrap());
    assert!(warm < 0.8 * cold, "{warm} {cold}");
    // Only the run of a user writes, and only once it is complete.
    assert!(!parent.join("out/later/sensors.csv").exists());
}

/// The true biases of two groups of stations jump by 30 m after a day and a half; whoever is told does better.
#[test]
fn an_announced_recalibration_is_taken_up_when_it_comes() {
    let parent = place();
    let parent = parent.path();
    succeeds(parent, &["init", "mine.toml"]);
    let jump = "sigma = 15\nevolution = { kind = \"jump\", at_hours = 36, size = 30 }\n";
    let text = fs::read_to_string(parent.join("mine.toml")).unwrap().replace("sigma = 15 ", &format!("{jump}# "));
    let text = text.replace("factors = \"auto\"", "factors = 40");
    let text = text.replace("score_from_cycle = 6", "score_from_cycle = 7");
    assert!(text.contains("jump") && text.contains("factors = 40"), "{text}");
    fs::write(parent.join("untold.toml"), &text).unwrap();
    fs::write(parent.join("told.toml"), format!("{text}\n[sensors]\ndatabase = \"two.db\"\n")).unwrap();
    let sensors = "record,sensor,unit\nsensor,sondes/h/B,m\nsensor,sondes/h/C,m\n";
    fs::write(parent.join("two.csv"), sensors).unwrap();
    succeeds(parent, &["sensors", "import", "two.db", "two.csv"]);
    for sensor in ["sondes/h/B", "sondes/h/C"] {
        let announced = ["--time", "2026-01-16T12:00:00Z", "--step", "30", "--sigma", "0.5"];
        succeeds(parent, &[&["sensors", "recalibrate", "two.db", sensor], &announced[..]].concat());
    }
    let errors = |name: &str| -> Vec<f64> {
        let file = format!("{name}.toml");
        let quiet = ["--cycles", "12", "--quiet", "--no-report", "--no-rerun", "--no-netcdf"];
        succeeds(parent, &[&["run", file.as_str()], &quiet[..]].concat());
        let text = fs::read_to_string(parent.join(format!("out/{name}/summary.json"))).unwrap();
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
        ["var", "fkf"].iter().map(|method| summary["methods"][method]["bias_rmse"].as_f64().unwrap()).collect()
    };
    let (told, untold) = (errors("told"), errors("untold"));
    assert!(told.iter().zip(&untold).all(|(told, untold)| 2.0 * told < *untold), "{told:?} {untold:?}");
}

/// A run that is interrupted goes on with the knowledge it began with, or not at all.
#[cfg(unix)]
#[test]
fn a_run_is_resumed_only_with_the_knowledge_it_began_with() {
    let parent = place();
    let parent = parent.path();
    succeeds(parent, &["sensors", "import", "known.db", "known.csv"]);
    fs::write(parent.join("small.toml"), scenario(true)).unwrap();
    let arguments = ["--cycles", "9", "--checkpoint-cycles", "1", "--quiet", "--no-report", "--no-rerun"];
    let start = |out: &str| {
        Command::new(env!("CARGO_BIN_EXE_isobar"))
            .current_dir(parent)
            .args(["run", "small.toml", "--out", out])
            .args(arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    };
    let database = fs::read(parent.join("known.db")).unwrap();
    assert!(start("whole").wait().unwrap().success());
    let whole = crate::outputs::Outputs::of(&parent.join("whole/small"));
    let mut resumed = 0;
    for wait in 0..40 {
        fs::write(parent.join("known.db"), &database).unwrap();
        let out = format!("out{wait}");
        let mut child = start(&out);
        let partial = parent.join(&out).join(".small.partial");
        let has_checkpoint = || {
            let entries = fs::read_dir(&partial).into_iter().flatten();
            let names = entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned());
            names.filter(|name| name.starts_with("checkpoint-") && !name.ends_with("new")).count() > 1
        };
        while !has_checkpoint() && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_micros(300));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        let run = format!("{out}/small");
        if parent.join(&run).exists() || !has_checkpoint() {
            continue;
        }
        // Not with another database.
        succeeds(
            parent,
            &["sensors", "recalibrate", "known.db", "polar/offset", "--time", "2026-01-15T12:00:00Z", "--step", "1"],
        );
        let message = fails(parent, &["resume", &run, "--quiet"]);
        assert!(message.contains("what is known of its sensors has changed since, in known.db"), "{message}");
        // With the same one, to the same bits.
        fs::write(parent.join("known.db"), &database).unwrap();
        assert!(succeeds(parent, &["resume", &run, "--quiet"]).contains("new records in"));
        whole.assert_same(&crate::outputs::Outputs::of(&parent.join(&run)), "resumed");
        resumed += 1;
        if resumed == 3 {
            break;
        }
    }
    assert!(resumed > 0);
}

/// The satellite's bias has no other parameter, so that the correction is the estimate and its error the claim.
#[test]
fn readings_are_the_observations_without_the_biases_that_were_found() {
    let parent = place();
    let parent = parent.path();
    fs::write(parent.join("first.toml"), scenario(true)).unwrap();
    succeeds(parent, &["run", "first.toml", "--quiet", "--no-report", "--no-rerun", "--threads", "1"]);
    let method = NcFile::open(parent.join("out/first/fkf.nc")).unwrap();
    let names = method.read_variable_as_strings("parameter_name").unwrap();
    let offset = names.iter().position(|name| name == "polar/offset").unwrap();
    let series = |name: &str| method.read_variable::<f64>(name).unwrap();
    let (found, claimed) = (series("calibration_analysis"), series("calibration_analysis_spread"));
    let mut table = csv::Reader::from_path(parent.join("out/first/readings.csv")).unwrap();
    let header = table.headers().unwrap().clone();
    let column = |name: &str| header.iter().position(|own| own == name).unwrap_or_else(|| panic!("{name}: {header:?}"));
    // `free` estimates nothing.
    assert!(!header.iter().any(|name| name.starts_with("free")), "{header:?}");
    let observations = NcFile::open(parent.join("out/first/observations.nc")).unwrap();
    let calibrated = observations.read_variable::<f64>("calibrated_value_fkf").unwrap();
    let sigma = observations.read_variable::<f64>("calibrated_value_fkf_sigma").unwrap();
    assert!(observations.variable("calibrated_value_free").is_err());
    let mut of_satellite = 0;
    for (number, row) in table.records().enumerate() {
        let row = row.unwrap();
        let value = |name: &str| row[column(name)].parse::<f64>().unwrap();
        assert_eq!([value("fkf calibrated"), value("fkf sigma")], [calibrated[number], sigma[number]]);
        let cycle = value("cycle") as usize;
        if &row[column("network")] == "polar" {
            let at = (cycle - 1) * names.len() + offset;
            let correction = value("value") - value("fkf calibrated");
            assert!((correction - found.as_slice().unwrap()[at]).abs() < 1e-9 * value("value").abs(), "{row:?}");
            assert!((value("fkf sigma") / claimed.as_slice().unwrap()[at] - 1.0).abs() < 1e-9, "{row:?}");
            of_satellite += 1;
        }
    }
    assert!(of_satellite > 10, "{of_satellite}");
}
