//! The shape of the project: who may know whom, and what a library may not do.

use crate::circles::{Circle, Crate};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Names of the project's own packages on which a package depends, but for its tests.
fn own_dependencies(metadata: &serde_json::Value, package: &str) -> Vec<String> {
    let packages = metadata["packages"].as_array().unwrap();
    let package = packages.iter().find(|own| own["name"] == package).unwrap();
    let dependencies = package["dependencies"].as_array().unwrap().iter();
    let mut names: Vec<String> = dependencies
        .filter(|dependency| dependency["kind"].is_null())
        .filter_map(|dependency| dependency["name"].as_str())
        .filter(|name| name.starts_with("isobar"))
        .map(str::to_string)
        .collect();
    names.sort();
    names
}

/// What cargo says of the project's packages.
fn metadata() -> serde_json::Value {
    let cargo = std::env::var("CARGO").unwrap_or("cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn every_dependency_is_used() {
    let metadata = metadata();
    let packages = metadata["packages"].as_array().unwrap();
    assert_eq!(packages.len(), 4);
    for package in packages {
        let folder = Path::new(package["manifest_path"].as_str().unwrap()).parent().unwrap();
        let code_in = |folders: &[&str]| -> String {
            let folders = folders.iter().map(|name| folder.join(name)).filter(|folder| folder.is_dir());
            folders.flat_map(|folder| sources(&folder)).map(|path| fs::read_to_string(path).unwrap()).collect()
        };
        let (own, all) = (code_in(&["src"]), code_in(&["src", "tests", "benches", "examples"]));
        for dependency in package["dependencies"].as_array().unwrap() {
            let name = dependency["name"].as_str().unwrap();
            let path = format!("{}::", name.replace('-', "_"));
            let code = if dependency["kind"].is_null() { &own } else { &all };
            assert!(code.contains(&path), "{} does not use {name}", package["name"]);
        }
    }
}

#[test]
fn data_flows_one_way_between_the_packages() {
    let metadata = metadata();
    assert_eq!(own_dependencies(&metadata, "isobar-model"), Vec::<String>::new());
    assert_eq!(own_dependencies(&metadata, "isobar-obs"), ["isobar-model"]);
    assert_eq!(own_dependencies(&metadata, "isobar-assim"), ["isobar-model", "isobar-obs"]);
}

/// The Rust sources below a folder.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(sources(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    found
}

/// The code of a source file, without comments and unit tests, which are at its end or a file `tests.rs`.
fn code(path: &Path) -> String {
    if path.ends_with("tests.rs") {
        return String::new();
    }
    let text = fs::read_to_string(path).unwrap();
    let text = text.split("#[cfg(test)]\nmod tests").next().unwrap();
    text.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

#[test]
fn the_libraries_neither_read_nor_print_nor_look_at_the_clock() {
    let mut read = 0;
    for member in ["model", "obs", "assim"] {
        for path in sources(&root().join(member).join("src")) {
            // A method saves to, and recalls from, what it is given.
            let code = code(&path).replace("use std::io::{Read, Write};", "");
            for forbidden in ["std::fs", "std::io", "println!", "eprintln!", "Instant", "SystemTime", "std::env"] {
                assert!(!code.contains(forbidden), "{} has {forbidden}", path.display());
            }
            read += 1;
        }
    }
    assert!(read > 40, "only {read} files");
}

/// A clock that is set while a run computes can do no harm: only the monotonic one is read.
#[test]
fn nothing_reads_the_time_of_day() {
    for path in sources(&root().join("src")) {
        let code = code(&path);
        for forbidden in ["SystemTime", "Timestamp::now", "Zoned::now", "Utc::now", "Local::now"] {
            assert!(!code.contains(forbidden), "{} has {forbidden}", path.display());
        }
    }
}

#[test]
fn methods_know_no_concrete_model_and_no_truth() {
    for path in sources(&root().join("assim/src")) {
        let code = code(&path);
        for forbidden in ["ShallowWater", "Advection", "ExactShift", "Radiosonde", "Satellite", "truth", "Truth"] {
            assert!(!code.contains(forbidden), "{} has {forbidden}", path.display());
        }
    }
    for name in ["cycle.rs", "influence.rs", "monitor.rs"] {
        let cycle = code(&root().join("src/run").join(name)).to_lowercase();
        assert!(!cycle.contains("truth") && !cycle.contains("true_"), "src/run/{name}");
    }
}

/// The sources of a crate, without the program itself and tests in files of their own.
fn parts(folder: &str) -> Crate {
    let folder = root().join(folder);
    let name = |path: &Path| path.strip_prefix(&folder).unwrap().to_str().unwrap().replace('\\', "/");
    let is_part = |(name, _): &(String, String)| name != "main.rs" && !name.ends_with("_tests.rs");
    let all = sources(&folder).into_iter().map(|path| (name(&path), fs::read_to_string(&path).unwrap()));
    Crate::new(&all.filter(is_part).collect::<Vec<_>>())
}

/// Circles of files that are meant to be: their members, by the beginnings of their names, and why.
const MEANT: [(&[&str], &str); 3] = [
    (&["increment", "state"], "the difference of two states is an increment, and an increment is added to a state"),
    (
        &["reader/field", "reader/section", "reader/key", "reader/form"],
        "a section has fields, the value of a field may be a section, and the form of a value is made of keys",
    ),
    (
        &["shallow_water"],
        "the model and its parameters are in mod.rs, its equations in a file for each way to compute them",
    ),
];

#[test]
fn no_files_know_each_other_in_a_circle() {
    let is_meant = |circle: &Circle| {
        MEANT.iter().any(|(beginnings, _)| {
            circle.members.iter().all(|member| beginnings.iter().any(|beginning| member.starts_with(beginning)))
        })
    };
    let shown = |circle: &Circle| format!("{} (all of them: {:?})", circle.way, circle.members);
    for folder in ["src", "model/src", "obs/src", "assim/src"] {
        let circles = parts(folder).circles_of_files();
        let circles: Vec<String> = circles.iter().filter(|circle| !is_meant(circle)).map(shown).collect();
        assert!(circles.is_empty(), "files of {folder}:\n{}", circles.join("\n"));
    }
    for folder in ["src", "assim/src"] {
        let circles: Vec<String> = parts(folder).circles_of_folders().iter().map(shown).collect();
        assert!(circles.is_empty(), "folders of {folder}:\n{}", circles.join("\n"));
    }
}

#[test]
fn no_source_file_is_too_long_to_read() {
    for folder in ["src", "model/src", "obs/src", "assim/src", "tests"] {
        for path in sources(&root().join(folder)) {
            let lines = fs::read_to_string(&path).unwrap().lines().count();
            assert!(lines <= 450, "{} has {lines} lines", path.display());
        }
    }
}

/// A file of tests that `main.rs` does not name would never run.
#[test]
fn every_file_of_tests_runs() {
    for folder in ["tests", "model/tests", "obs/tests", "assim/tests"] {
        let folder = root().join(folder);
        let main = fs::read_to_string(folder.join("main.rs")).unwrap();
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_str().unwrap();
            let is_module = path.extension().is_some_and(|it| it == "rs") || path.join("mod.rs").is_file();
            if is_module && name != "main" {
                assert!(main.contains(&format!("mod {name};")), "{} is not in main.rs", path.display());
            }
        }
    }
}
