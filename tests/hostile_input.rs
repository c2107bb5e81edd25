//! Files that mean harm: no escape to the terminal, no markup on the page, no path out of the output directory, and no more
//! memory or time than a file of an honest size takes.

use crate::common::{VALID, isobar, text, without_script};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::{Duration, Instant};

const MARKUP: [&str; 3] = ["</title><script>alert(1)</script>", "\"><img src=x onerror=alert(2)>", "'</svg><script>"];

/// All that a command said, if nothing in it is an order to a terminal.
fn harmless(output: &Output) -> String {
    let said = text(&output.stdout) + &text(&output.stderr);
    let hidden =
        |c: char| (c.is_control() && c != '\n') || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}');
    assert!(!said.chars().any(hidden), "{said:?}");
    said
}

/// All files below a directory.
fn files(directory: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found
}

/// A scenario whose stations are those of a file, with biases by country.
fn with_stations(parent: &Path, csv: &str) -> String {
    fs::write(parent.join("stations.csv"), csv).unwrap();
    VALID
        .replace("{ regular = [3, 2] }", "{ file = \"stations.csv\" }")
        .replace("groups = [\"A\", \"B\"]\n", "group_by = \"country\"\n")
}

#[test]
fn markup_in_any_text_stays_text_on_the_page() {
    let parent = tempfile::tempdir().unwrap();
    let [a, b, c] = MARKUP;
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let csv = format!(
        "id,name,x_m,y_m,country\n{},{},210000,220000,A\n2,{},430000,310000,{}\n3,three,650000,400000,{}\n",
        quoted(a),
        quoted(b),
        quoted(c),
        quoted(b),
        quoted(c)
    );
    let title = format!("title = '''{a}'''");
    let scenario = with_stations(parent.path(), &csv)
        .replace("title = \"A test\"", &title)
        .replace("phenomenon = \"None\"", &format!("phenomenon = '''{b}'''"))
        .replace("source = \"The tests\"", &format!("source = \"\"\"{c}\"\"\""));
    fs::write(parent.path().join("hostile.toml"), scenario).unwrap();
    let output = isobar(parent.path(), &["run", "hostile.toml", "--no-rerun"]);
    assert!(output.status.success(), "{}", harmless(&output));
    harmless(&output);
    let compare = isobar(parent.path(), &["compare", "out/hostile", "out/hostile"]);
    assert!(compare.status.success(), "{}", harmless(&compare));
    let mut pages = 0;
    for path in files(parent.path()) {
        let is_page = path.extension().is_some_and(|it| it == "html" || it == "svg");
        if is_page {
            let page = fs::read_to_string(&path).unwrap();
            for tag in ["<script", "<img src=x", "</svg><", "<title></title>"] {
                assert!(!without_script(&page).contains(tag), "{} has {tag}", path.display());
            }
            pages += 1;
        }
        let inside = path.starts_with(parent.path().join("out/hostile")) || path.parent() == Some(parent.path());
        assert!(inside, "{}", path.display());
    }
    assert!(pages > 5, "only {pages} pages");
    assert!(fs::read_to_string(parent.path().join("out/hostile/report.html")).unwrap().contains("&lt;script"));
}

#[test]
fn orders_to_a_terminal_are_shown_and_not_obeyed() {
    let parent = tempfile::tempdir().unwrap();
    let order = "\u{1b}]0;owned\u{7}\u{1b}[2J\u{9b}31m\u{202e}";
    for csv in [
        format!("id,x_m,y_m,country\n{order},1e5,2e5,A\n{order},3e5,2e5,B\n"),
        format!("id,x_m,y_m,country\n1,{order},2e5,A\n"),
        format!("id,x_m,y_m,{order}\n1,1e5,2e5,A\n"),
        format!("id,x_m,y_m,country\n1,1e5,2e5,A,{order}\n"),
        format!("id,x_m,y_m,country\n{order},1e5,2e5,{order}\n2,3e5,2e5,B\n3,3e5,3e5,A\n"),
    ] {
        let scenario = with_stations(parent.path(), &csv);
        fs::write(parent.path().join("hostile.toml"), scenario).unwrap();
        harmless(&isobar(parent.path(), &["check", "hostile.toml"]));
        harmless(&isobar(parent.path(), &["run", "hostile.toml", "--no-rerun", "--overwrite", "--cycles", "2"]));
    }
    // The directory of a run that somebody else made.
    fs::write(parent.path().join("small.toml"), VALID).unwrap();
    assert!(isobar(parent.path(), &["run", "small.toml", "--no-rerun", "--out", "mine"]).status.success());
    let run = parent.path().join("mine/small");
    let [scores, summary] = ["scores.csv", "summary.json"].map(|name| fs::read_to_string(run.join(name)).unwrap());
    let version = format!("\"version\": \"{}\"", isobar::VERSION);
    for (name, contents) in [
        ("scores.csv", scores.replace("free", &format!("free{order}"))),
        ("scores.csv", scores.replacen("1,", &format!("{order},"), 1)),
        ("scores.csv", scores.replace(" [m]", &format!("{order} [m]"))),
        ("summary.json", summary.replace(&version, "\"version\": \"\\u001b[2J\"")),
        ("summary.json", summary.replace("\"seed\"", &format!("\"{order}\""))),
        ("summary.json", summary.replace("\"small\"", "\"\\u001b[2J\\u202e\"")),
    ] {
        let original = if name == "scores.csv" { &scores } else { &summary };
        assert_ne!(&contents, original, "{name}");
        fs::write(run.join(name), contents).unwrap();
        harmless(&isobar(parent.path(), &["compare", "mine/small", "--overwrite"]));
        harmless(&isobar(parent.path(), &["view", "mine/small"]));
        fs::write(run.join(name), original).unwrap();
    }
}

/// A scenario with observations and the first state of files, `buoys.csv` and `state.csv`.
fn with_observations_and_state() -> String {
    let jet = "kind = \"jet\"\nmean_depth_m = 1000\nspeed_m_per_s = 10\nwidth_km = 200";
    let buoys = "[networks.buoys]\nkind = \"file\"\nfile = \"buoys.csv\"\nsigma = 5\n\n[methods.free]";
    assert!(VALID.contains(jet));
    VALID.replace(jet, "kind = \"file\"\nfile = \"state.csv\"").replace("[methods.free]", buoys)
}

#[test]
fn text_of_observations_and_fields_is_text() {
    let parent = tempfile::tempdir().unwrap();
    let state = |header: &str, first: &str| format!("{header}\n{first}\n{}", "1000,0,0\n".repeat(47));
    let good_state = state("h,u,v", "1000,0,0");
    let [a, b, _] = MARKUP.map(|text| format!("\"{}\"", text.replace('"', "\"\"")));
    let buoys = format!(
        "cycle,x_m,y_m,value,variable,id,{a}\n1,3e5,2e5,1000,h,{a},{b}\n1,4e5,2e5,1000,h,{b},\n2,4e5,2e5,1003,h,{b},\n"
    );
    let write = |buoys: &str, state: &str| {
        for (name, contents) in
            [("hostile.toml", &*with_observations_and_state()), ("buoys.csv", buoys), ("state.csv", state)]
        {
            fs::write(parent.path().join(name), contents).unwrap();
        }
    };
    write(&buoys, &good_state);
    let output = isobar(parent.path(), &["run", "hostile.toml", "--no-rerun"]);
    assert!(output.status.success(), "{}", harmless(&output));
    harmless(&output);
    let page = fs::read_to_string(parent.path().join("out/hostile/report.html")).unwrap();
    for tag in ["<script", "<img src=x", "</svg><script"] {
        assert!(!without_script(&page).contains(tag), "the page has {tag}");
    }
    let order = "\u{1b}]0;owned\u{7}\u{1b}[2J\u{9b}31m\u{202e}";
    let head = "cycle,x_m,y_m,value,variable,id";
    for (buoys, state) in [
        (format!("{head}\n1,3e5,2e5,1000,h,{order}\n"), good_state.clone()),
        (format!("{head}\n1,3e5,2e5,1000,h,{order}\n1,3e5,2e5,1000,h,{order}\n"), good_state.clone()),
        (format!("{head}\n1,3e5,2e5,1000,{order},a\n"), good_state.clone()),
        (format!("{head}\n1,3e5,2e5,{order},h,a\n"), good_state.clone()),
        (format!("{head}\n{order},3e5,2e5,1000,h,a\n"), good_state.clone()),
        (format!("time,x_m,y_m,value\n{order},3e5,2e5,1000\n"), good_state.clone()),
        (format!("cycle,x_m,{order},value\n1,3e5,2e5,1000\n"), good_state.clone()),
        (buoys.clone(), state(order, "1000,0,0")),
        (buoys.clone(), state(&format!("h,u,{order}"), "1000,0,0")),
        (buoys.clone(), state("h,u,v", &format!("1000,{order},0"))),
        (buoys.clone(), state("h,u,v", &format!("1000,0,0,{order}"))),
    ] {
        write(&buoys, &state);
        harmless(&isobar(parent.path(), &["check", "hostile.toml"]));
        harmless(&isobar(parent.path(), &["run", "hostile.toml", "--no-rerun", "--overwrite", "--cycles", "2"]));
    }
    // A file with a hole as long as a terabyte.
    write(&buoys, &good_state);
    for name in ["buoys.csv", "state.csv"] {
        let contents = fs::read(parent.path().join(name)).unwrap();
        fs::File::create(parent.path().join(name)).unwrap().set_len(1 << 40).unwrap();
        let began = Instant::now();
        let output = isobar(parent.path(), &["check", "hostile.toml"]);
        assert_eq!(output.status.code(), Some(1));
        assert!(harmless(&output).contains("larger than 100 MB"), "{}", harmless(&output));
        assert!(began.elapsed() < Duration::from_secs(20), "{name}");
        fs::write(parent.path().join(name), contents).unwrap();
    }
}

#[test]
fn no_name_leads_out_of_the_output_directory() {
    let parent = tempfile::tempdir().unwrap();
    let inner = parent.path().join("inner");
    fs::create_dir(&inner).unwrap();
    for name in ["..toml", "...toml", ".hidden.toml"] {
        fs::write(inner.join(name), VALID).unwrap();
        let output = isobar(&inner, &["run", name, "--no-rerun"]);
        assert!(!output.status.success() && !inner.join("out").exists(), "{name}: {}", harmless(&output));
    }
    for name in ["../../fkf", "/etc/fkf", "a/b", "..", ".", "a\\u0000b", "-x"] {
        let scenario = VALID.replace("[methods.fkf]", &format!("[methods.\"{name}\"]"));
        fs::write(inner.join("hostile.toml"), scenario).unwrap();
        let output = isobar(&inner, &["run", "hostile.toml", "--no-rerun"]);
        assert_eq!(output.status.code(), Some(1), "{name}");
        assert!(harmless(&output).contains("cannot be the name of a method"), "{name}");
    }
    assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1);
}

#[test]
fn files_that_are_too_large_or_none_are_refused_at_once() {
    let parent = tempfile::tempdir().unwrap();
    let scenario = with_stations(parent.path(), "")
        .replace("dx_km = 100", "dx_km = 100\ncenter_latitude_deg = 50\ncenter_longitude_deg = 10");
    fs::write(parent.path().join("small.toml"), scenario).unwrap();
    let refused = |arguments: &[&str], wanted: &str| {
        let began = Instant::now();
        let output = isobar(parent.path(), arguments);
        assert_eq!(output.status.code(), Some(1));
        assert!(harmless(&output).contains(wanted), "{}", harmless(&output));
        assert!(began.elapsed() < Duration::from_secs(20), "{arguments:?}");
    };
    // Files with holes: their size costs nothing.
    fs::File::create(parent.path().join("stations.csv")).unwrap().set_len(1 << 40).unwrap();
    refused(&["check", "small.toml"], "larger than 100 MB");
    fs::File::create(parent.path().join("large.toml")).unwrap().set_len(1 << 40).unwrap();
    refused(&["check", "large.toml"], "larger than 1000 kB");
    fs::create_dir(parent.path().join("run")).unwrap();
    fs::File::create(parent.path().join("run/summary.json")).unwrap().set_len(1 << 40).unwrap();
    refused(&["compare", "run"], "larger than 1000 MB");
    #[cfg(unix)]
    {
        // A pipe into which nobody ever writes.
        fs::remove_file(parent.path().join("stations.csv")).unwrap();
        let made = std::process::Command::new("mkfifo").arg(parent.path().join("stations.csv")).status().unwrap();
        assert!(made.success());
        refused(&["check", "small.toml"], "does not exist");
    }
    for (open, close) in [("[", "]"), ("{a=", "}")] {
        let nested = format!("{}\nx = {}{}\n", VALID, open.repeat(100_000), close.repeat(100_000));
        fs::write(parent.path().join("nested.toml"), nested).unwrap();
        assert_eq!(isobar(parent.path(), &["check", "nested.toml"]).status.code(), Some(1));
    }
}

#[test]
fn more_than_a_scenario_may_have_is_refused_before_it_takes_memory() {
    let parent = tempfile::tempdir().unwrap();
    let methods: String = (0..100).map(|number| format!("[methods.m{number}]\nkind = \"free\"\n")).collect();
    let networks: String = (0..100)
        .map(|number| {
            format!(
                "[networks.n{number}]\nkind = \"radiosonde\"\nstations = {{ random = 100000 }}\nsigma_height_m = 12\n"
            )
        })
        .collect();
    for (name, scenario, wanted) in [
        ("methods", format!("{VALID}\n{methods}"), "more than 100 methods"),
        ("networks", VALID.replace("[methods.free]", &format!("{networks}\n[methods.free]")), "more than 100 networks"),
        ("factors", format!("{VALID}\nfactors = 100000\nmemory_limit_gb = 0.01\n"), "more than the 144 variables"),
        ("cells", VALID.replace("nx = 8", "nx = 5000"), "from 4 to 4096"),
        ("stations", VALID.replace("{ regular = [3, 2] }", "{ regular = [3000, 3000] }"), "from 1 to 300"),
    ] {
        fs::write(parent.path().join(format!("{name}.toml")), scenario).unwrap();
        let began = Instant::now();
        let output = isobar(parent.path(), &["run", &format!("{name}.toml"), "--no-rerun"]);
        let said = harmless(&output);
        assert_eq!(output.status.code(), Some(1), "{name}: {said}");
        assert!(said.contains(wanted), "{name}: {said}");
        assert!(began.elapsed() < Duration::from_secs(10), "{name}");
    }
}

/// Wherever a path is shown: scenarios beside the one that is not there, outputs, runs, databases, arguments.
#[test]
#[cfg(unix)]
fn names_of_files_give_no_orders_to_the_terminal() {
    let parent = tempfile::tempdir().unwrap();
    let here = parent.path();
    let raw = "e\u{1b}[31m\u{202e}";
    fs::create_dir(here.join("scenarios")).unwrap();
    fs::write(here.join(format!("scenarios/{raw}.toml")), VALID).unwrap();
    fs::write(here.join("small.toml"), VALID).unwrap();
    fs::write(here.join(raw), "a file").unwrap();
    let (below, other) = (format!("{raw}/x"), format!("o{raw}"));
    let quick = ["--quiet", "--cycles", "2", "--methods", "free", "--no-report", "--no-rerun"];
    let run = |out: &str| harmless(&isobar(here, &[&["run", "small.toml", "--out", out], &quick[..]].concat()));
    assert!(run(raw).contains("e\\u{1b}[31m\\u{202e}"));
    run(&other);
    assert!(run(&other).contains("it exists already"));
    let run = format!("{other}/small");
    for arguments in [
        &["check", "nosuch"][..],
        &["check", raw],
        &["check", &below],
        &["list"],
        &["run", "small.toml", "--seeds", "3", "--out", raw],
        &["sweep", "small.toml", "--out", raw],
        &["compare", raw],
        &["compare", &run, "--out", &below],
        &["compare", &run, "--out", raw],
        &["compare", &run, "--out", &format!("new{raw}")],
        &["compare", &other],
        &["diagnose", raw],
        &["view", &run],
        &["resume", raw, &below],
        &["resume", &run],
        &["sensors", "list", raw],
        &["sensors", "import", raw, raw],
        &["sensors", "export", raw, "--out", raw],
        &["init", raw],
        &["init", &below],
        &["regress", &below],
        &["exact", raw],
        &[raw],
        &["run", "small.toml", &format!("--{raw}")],
        &["run", "small.toml", "--cycles", raw],
    ] {
        harmless(&isobar(here, arguments));
    }
}

/// Characters that XML cannot hold are written as escapes on the page and in every figure, and a browser loads nothing.
#[test]
fn figures_are_well_formed_whatever_the_names_are() {
    let parent = tempfile::tempdir().unwrap();
    let raw = "A\u{1}\u{b}\u{fffe}\u{ffff}\u{1fffe}\u{202e}\0\u{7f}&<";
    // What is not text is refused by its beginning.
    let beginning = "x".repeat(1000);
    let csv = format!("# {beginning}\nid,x_m,y_m,country\n1,210000,220000,{raw}\n2,430000,310000,\"B\u{c}\"\n");
    let scenario = with_stations(parent.path(), &csv).replace("reference_groups = [\"A\"]\n", "");
    let scenario = scenario.replace("# A comment", "# \u{fffe}\u{202e} A comment");
    fs::write(parent.path().join("names.toml"), scenario).unwrap();
    let output = isobar(parent.path(), &["run", "names.toml", "--no-rerun", "--quiet", "--cycles", "3"]);
    assert!(output.status.success(), "{}", harmless(&output));
    let run = parent.path().join("out/names");
    let (mut svgs, mut escaped) = (0, 0);
    for path in files(&run).into_iter().filter(|path| path.extension().is_some_and(|end| end == "svg")) {
        let svg = fs::read_to_string(&path).unwrap();
        roxmltree::Document::parse(&svg).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        svgs += 1;
        escaped += usize::from(svg.contains("\\u{1}\\u{b}\\u{fffe}"));
    }
    assert!(svgs > 5 && escaped > 0, "{svgs}, {escaped}");
    let page = fs::read_to_string(run.join("report.html")).unwrap();
    let wrong = |c: char| c.is_control() && c != '\n' || ['\u{fffe}', '\u{ffff}', '\u{1fffe}', '\u{202e}'].contains(&c);
    assert!(!page.chars().any(wrong));
    for svg in page.split("<svg").skip(1) {
        let svg = format!("<svg{}</svg>", svg.split("</svg>").next().unwrap());
        roxmltree::Document::parse(&svg).unwrap();
    }
    let policy =
        page.find("http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:").unwrap();
    assert!(policy < page.find("<style").unwrap() && !without_script(&page).contains("<script"));
}
