//! Faults in the files that a scenario names, and in the keys that name them, as the user of the program sees them.

use crate::common::{VALID, isobar, place, text};
use std::fs;
use tempfile::tempdir;

/// What is wrong, with the fault's place in the scenario (what stands there), the files beside it, and what the message must
/// say.
struct Case {
    /// What is replaced in the valid scenario, and by what.
    change: (&'static str, String),
    at: &'static str,
    file: Option<(&'static str, String)>,
    wanted: &'static [&'static str],
}

fn assert_named(cases: &[Case]) {
    let mut faults = Vec::new();
    for (number, Case { change: (old, new), at, file, wanted }) in cases.iter().enumerate() {
        let directory = tempdir().unwrap();
        assert!(VALID.contains(old), "case {number}: {old} is not in the valid scenario");
        let broken = VALID.replacen(old, new, 1);
        fs::write(directory.path().join("broken.toml"), &broken).unwrap();
        if let Some((name, contents)) = file {
            fs::write(directory.path().join(name), contents).unwrap();
        }
        let output = isobar(directory.path(), &["check", "broken.toml"]);
        let message = text(&output.stderr);
        let flat = message.replace("\n  │ ", " ").split_whitespace().collect::<Vec<_>>().join(" ");
        let place = format!("broken.toml:{}]", place(&broken, at));
        if output.status.code() != Some(1) {
            faults.push(format!("case {number} ({new}): exit {:?}\n{message}", output.status));
        }
        for part in std::iter::once(&place.as_str()).chain(*wanted) {
            if !flat.contains(part) {
                faults.push(format!("case {number} ({new}): {part:?} is missing in\n{message}"));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n\n"));
}

#[test]
fn of_observations() {
    const NETWORK: &str = "[networks.buoys]\nkind = \"file\"\nfile = \"buoys.csv\"\nvariable = \"h\"\nsigma = 5\n";
    let with = |network: &str, contents: Option<&str>, wanted| Case {
        change: ("[methods.free]", format!("{network}\n[methods.free]")),
        at: "\"buoys.csv\"",
        file: contents.map(|contents| ("buoys.csv", contents.to_string())),
        wanted,
    };
    let (whole, bare) = (NETWORK, NETWORK.split("variable").next().unwrap());
    assert_named(&[
        with(whole, None, &["the file of observations buoys.csv does not exist", "relative to this scenario"]),
        with(whole, Some(""), &["buoys.csv has no observations", "needs a header line"]),
        with(
            whole,
            Some("# buoys\ncycle,x,y,value\n1,1e5,1e5,1000\n"),
            &[
                "buoys.csv, line 2: the header has no column `x_m` and `y_m`",
                "it has `cycle`, `x`, `y`, `value`",
                "is `x` for `x_m`, `y` for `y_m` meant?",
            ],
        ),
        with(whole, Some("x_m,y_m,value\n1e5,1e5,1000\n"), &["buoys.csv, line 1", "no column `cycle` (or `time`)"]),
        with(
            whole,
            Some("cycle,x_m,y_m,value\n1,1e5,1e5,1000\n\n2,1e5,1e5,deep\n"),
            &["buoys.csv, line 4: `value` is `deep`, but must be a finite number"],
        ),
        with(
            whole,
            Some("cycle,x_m,y_m,value,variable\n1,1e5,1e5,1000,z\n"),
            &["buoys.csv, line 2: `variable` is `z`, but must be one of `h`, `u`, `v`"],
        ),
        with(whole, Some("cycle,column,row,value\n1,9,2,1000\n"), &["buoys.csv, line 2: `column` is `9`"]),
        with(
            whole,
            Some("time,x_m,y_m,value\n2020-01-01T00:00:00Z,1e5,1e5,1000\n"),
            &["none of the 1 observations of buoys.csv is valid after the start"],
        ),
        with(bare, Some("cycle,x_m,y_m,value\n1,1e5,1e5,1000\n"), &["has no column `variable`", "for the network"]),
        with(
            bare,
            Some("cycle,x_m,y_m,value,variable\n1,1e5,1e5,1000,h\n"),
            &["has no column `sigma`", "for the network"],
        ),
    ]);
}

#[test]
fn of_covariances() {
    const OLD: &str = "{ kind = \"white\", variable = \"u\", sigma = 1 }";
    let case = |new: &str, at, wanted| Case { change: (OLD, new.to_string()), at, file: None, wanted };
    assert_named(&[
        case(
            "{ kind = \"by_distance\", variable = \"u\", correlation = \"gaspari_con\", sigma = 1, length_km = 300 }",
            "\"gaspari_con\"",
            &["did you mean \"gaspari_cohn\"?"],
        ),
        case(
            "{ kind = \"by_distance\", variable = \"u\", sigma = 1, length_km = 300 }",
            "{ kind = \"by_distance\"",
            &["`correlation` is missing"],
        ),
        case(
            "{ kind = \"by_distance\", variable = \"u\", correlation = \"gaspari_cohn\", sigma = 1, length_km = 0 }",
            "0 }]",
            &["length_km` is 0", "from 0.001 to 100000"],
        ),
        case(
            "{ kind = \"by_distance\", variable = \"u\", correlation = \"gaspari_cohn\", sigma = 1, length_km = 300, \
             uncorrelated_fraction = 1 }",
            "1 }]",
            &["uncorrelated_fraction` is 1", "from 0 to below 1"],
        ),
        case(
            "{ kind = \"by_distance\", variable = \"z\", correlation = \"gaspari_cohn\", sigma = 1, length_km = 300 }",
            "\"z\"",
            &["valid values: h, u, v"],
        ),
        Case {
            change: (OLD, "{ kind = \"members\", variable = \"u\", file = \"members.csv\" }".to_string()),
            at: "\"members.csv\"",
            file: Some(("members.csv", "1\n".repeat(48))),
            wanted: &["one member has no covariance", "two columns or more"],
        },
    ]);
}

/// 48 rows for the 8 × 6 cells, one of them another.
fn fields(header: &str, row: &str, other: (usize, &str)) -> String {
    let rows = (0..48).map(|number| if number == other.0 { other.1 } else { row }.to_string() + "\n");
    header.to_string() + "\n" + &rows.collect::<String>()
}

#[test]
fn of_states() {
    const JET: &str = "kind = \"jet\"\nmean_depth_m = 1000\nspeed_m_per_s = 10\nwidth_km = 200";
    const TRUTH: &str = "model = { drag_per_s = 1e-6 }";
    let background = |contents: Option<String>, wanted| Case {
        change: (JET, "kind = \"file\"\nfile = \"state.csv\"".to_string()),
        at: "\"state.csv\"",
        file: contents.map(|contents| ("state.csv", contents)),
        wanted,
    };
    let truth = |new: &str, at, contents: Option<String>, wanted| Case {
        change: (TRUTH, new.to_string()),
        at,
        file: contents.map(|contents| ("truth.csv", contents)),
        wanted,
    };
    let good = || fields("h,u,v", "1000,3,0", (0, "1000,3,0"));
    const FROM_FILE: &str = "initial = { kind = \"file\", file = \"truth.csv\" }";
    assert_named(&[
        background(None, &["the file state.csv does not exist", "relative to this scenario"]),
        background(Some(String::new()), &["state.csv has no rows of numbers"]),
        background(
            Some(fields("h,u", "1000,3", (0, "1000,3"))),
            &["state.csv has no column `v` in its header", "needs the columns h, u, v"],
        ),
        background(Some(fields("h,u,u,v", "1000,3,3,0", (0, "1000,3,3,0"))), &["two columns `u`"]),
        background(
            Some(fields("h,u,v", "1000,3,0", (9, "1000,east,0"))),
            &["state.csv, line 11: `u` is `east`, but must be a finite number", "the grid is 8 × 6"],
        ),
        background(Some(good().replacen("1000,3,0\n", "", 1)), &["47 rows of numbers, but should have 48"]),
        background(Some(good() + "1000,3,0\n"), &["line 50: there are more than the 48 rows"]),
        background(
            Some(fields("h,u,v", "1000,3,0", (30, "-1,3,0"))),
            &["the depth h is -1 in row 31", "greater than 0"],
        ),
        background(Some(fields("h,u,v", "1000,3,0", (7, "1000,3,2"))), &["v is 2 in row 8", "southern wall"]),
        truth(FROM_FILE, "\"truth.csv\"", None, &["the file truth.csv does not exist"]),
        truth(
            FROM_FILE,
            "\"truth.csv\"",
            Some(fields("h,u,v", "1000,3,0", (47, "1000,3,nan"))),
            &["truth.csv, line 49: `v` is `nan`, but must be a finite number"],
        ),
        truth("initial = { kind = \"jett\" }", "\"jett\"", None, &["did you mean \"jet\"?"]),
        truth("initial = { kind = \"rest\" }", "{ kind = \"rest\" }", None, &["`mean_depth_m` is missing"]),
        truth(
            "initial = { kind = \"rest\", mean_depth_m = 1000 }\nbackground_error_scale = 1",
            "background_error_scale = 1",
            None,
            &["a truth that starts at a given state", "leave out this key or truth.initial"],
        ),
    ]);
}

#[test]
fn of_patterns() {
    const NEW: &str = "kind = \"time_volume\"\nwindow_cycles = 5\nobservation_factors = [{ name = \"f\", kind = \"constant\", \
                       biases = [\"sondes\"], patterns_file = \"eof.csv\" }]";
    let case = |contents, wanted| Case {
        change: ("kind = \"fkf\"\nblocks = \"cell\"", NEW.to_string()),
        at: "\"eof.csv\"",
        file: Some(("eof.csv", contents)),
        wanted,
    };
    assert_named(&[
        case(
            fields("first,second", "1,2", (4, "1,2o")),
            &["eof.csv, line 6: `second` is `2o`, but must be a finite number", "the grid is 8 × 6"],
        ),
        case(
            fields("first,second", "1,2", (4, "1")),
            &["eof.csv, line 6: there are 1 fields, but the header has 2 columns"],
        ),
        case(fields("first", "1", (0, "1")).replacen("1\n", "", 1), &["47 rows of numbers, but should have 48"]),
    ]);
}

#[test]
fn of_a_forcing() {
    let case = |of: &str, variable: &str, key: &str, contents: String, wanted| Case {
        change: (
            "[cycle]",
            format!("[[{of}]]\nvariable = \"{variable}\"\namplitude_per_day = 1\n{key}, file = \"b.csv\" }}\n[cycle]"),
        ),
        at: if variable == "v" { "{ kind = \"file\", file = \"b.csv\" }" } else { "\"b.csv\"" },
        file: Some(("b.csv", contents)),
        wanted,
    };
    const PATTERN: &str = "pattern = { kind = \"file\"";
    const TIME: &str = "time = { kind = \"table\"";
    let ones = "1\n".repeat(48);
    assert_named(&[
        case(
            "forcing",
            "h",
            PATTERN,
            "1\n".repeat(40),
            &["b.csv has 40 rows of numbers, but should have 48, one for each cell of the grid", "the grid is 8 × 6"],
        ),
        case("forcing", "h", PATTERN, "1,2\n".repeat(48), &["there are 2 columns, more than the 1 allowed"]),
        case("forcing", "h", PATTERN, ones.replacen('1', "inf", 1), &["b.csv, line 1: `column 1` is `inf`"]),
        case(
            "forcing",
            "v",
            PATTERN,
            ones,
            &["the pattern is 1 in row 1 of the numbers, at the southern wall", "must be 0 in the first nx rows"],
        ),
        case(
            "truth.forcing",
            "h",
            TIME,
            "time,value\n2026-01-15T00:00:00Z,1\n2026-01-15T00:00:00Z,1\n".into(),
            &["b.csv, line 3: `time` is `2026-01-15T00:00:00Z`, but must be a time after that of the row before"],
        ),
        case(
            "forcing",
            "h",
            TIME,
            "time,value\n2026-01-15T00:00:00Z,1\n2026-01-17T00:00:00Z,1\n".into(),
            &["the table of source 1 of [[forcing]] goes from 2026-01-15T00:00:00Z to 2026-01-17T00:00:00Z"],
        ),
    ]);
}

#[test]
fn of_methods_that_cannot_freeze() {
    const FKF: &str = "[methods.fkf]\nkind = \"fkf\"\nblocks = \"cell\"";
    let case = |new: &str, at, wanted| Case { change: (FKF, new.to_string()), at, file: None, wanted };
    assert_named(&[
        case(
            "[stability]\nfreeze_after_cycles = 5\n[methods.fkf]\nkind = \"federated_fkf\"",
            "kind = \"federated_fkf\"",
            &["no place for what frozen biases of two systems have in common", "leave out `freeze_after_cycles`"],
        ),
        case(
            "[stability]\nfreeze_after_cycles = 5\n[methods.fkf]\nkind = \"federated_kf\"",
            "kind = \"federated_kf\"",
            &["no place for what frozen biases of two systems have in common", "leave out `freeze_after_cycles`"],
        ),
        case(
            "[stability]\nfreeze_after_cycles = 5\n[methods.fkf]\nkind = \"time_volume\"\nwindow_cycles = 5\n\
             observation_factors = [{ name = \"f\", kind = \"constant\", biases = [\"sondes\"] }]",
            "kind = \"time_volume\"",
            &["factors of a time volume would go on changing the biases", "leave out `freeze_after_cycles`"],
        ),
        case(
            "[stability]\nfreeze_unstable_cycles = 5\n[methods.fkf]\nkind = \"federated_kf\"",
            "kind = \"federated_kf\"",
            &["no place for what frozen biases of two systems have in common", "leave out `freeze_unstable_cycles`"],
        ),
    ]);
}
