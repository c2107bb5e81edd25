//! The reference of kinds and keys is what the reader checks.

use crate::common::{isobar, text};
use isobar::reference;
use std::fs;
use std::path::Path;

#[test]
fn the_file_of_keys_is_what_the_program_would_write() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/KEYS.md");
    let wanted = reference::markdown();
    if std::env::var_os("ISOBAR_WRITE").is_some() {
        fs::write(&path, &wanted).unwrap();
    }
    assert!(
        fs::read_to_string(&path).unwrap() == wanted,
        "run this test with ISOBAR_WRITE=1 and look at the difference"
    );
}

#[test]
fn every_list_of_kinds_is_shown_with_their_keys() {
    let directory = tempfile::tempdir().unwrap();
    for reference in reference::all() {
        let option = format!("--{}", reference.option);
        let list = isobar(directory.path(), &["list", &option]);
        assert!(list.status.success(), "{}", text(&list.stderr));
        for kind in &reference.kinds {
            assert!(text(&list.stdout).lines().any(|line| line.starts_with(kind.name)), "{} is not listed", kind.name);
            let keys = isobar(directory.path(), &["list", &option, kind.name]);
            assert!(keys.status.success(), "{}", text(&keys.stderr));
            for key in &kind.keys {
                assert!(
                    text(&keys.stdout).lines().any(|line| line.starts_with(&key.name)),
                    "{} {}",
                    kind.name,
                    key.name
                );
            }
        }
        let wrong = isobar(directory.path(), &["list", &option, "nothing"]);
        assert_eq!(wrong.status.code(), Some(1));
        assert!(text(&wrong.stderr).contains(&format!("there are: {}", reference.kinds[0].name)));
    }
}
