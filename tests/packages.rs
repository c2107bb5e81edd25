//! What cargo would publish.

use std::fs;
use std::path::Path;
use std::process::Command;

/// The files of a package.
fn files(package: &str) -> Vec<String> {
    let cargo = std::env::var("CARGO").unwrap_or("cargo".into());
    let mut command = Command::new(cargo);
    command.args(["package", "--list", "--allow-dirty", "--offline", "--package", package]);
    let output = command.current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().lines().map(|line| line.replace('\\', "/")).collect()
}

#[test]
fn packages_hold_their_licences_and_documents_and_the_program_its_scenarios() {
    for package in ["isobar", "isobar-model", "isobar-obs", "isobar-assim"] {
        let files = files(package);
        for wanted in ["LICENSE-MIT", "LICENSE-APACHE", "README.md", "Cargo.toml", "src/lib.rs"] {
            assert!(files.iter().any(|file| file == wanted), "{package} has no {wanted}");
        }
    }
    let files = files("isobar");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut scenarios = 0;
    for folder in ["", "fields", "observations", "patterns", "sensors", "stations"] {
        for entry in fs::read_dir(root.join("scenarios").join(folder)).unwrap() {
            let path = entry.unwrap().path();
            if path.is_file() {
                let name = path.strip_prefix(root).unwrap().to_str().unwrap().replace('\\', "/");
                assert!(files.contains(&name), "{name} would be missing");
                scenarios += 1;
            }
        }
    }
    assert!(scenarios > 30 && !files.iter().any(|file| file.starts_with("target/")));
}

/// They are links, so that there is one text; a checkout without links has something else in their place.
#[test]
fn all_packages_have_the_same_licences() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for licence in ["LICENSE-MIT", "LICENSE-APACHE"] {
        let text = fs::read_to_string(root.join(licence)).unwrap();
        for folder in ["model", "obs", "assim"] {
            assert_eq!(fs::read_to_string(root.join(folder).join(licence)).unwrap(), text, "{folder}/{licence}");
        }
    }
}
