//! What becomes of directories, whatever happens to a run.

use super::*;

fn names(directory: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(directory)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

fn finished_run(parent: &Path, text: &str) -> PathBuf {
    let destination = parent.join("quickstart");
    fs::create_dir(&destination).unwrap();
    fs::write(destination.join(SUMMARY_FILE), text).unwrap();
    destination
}

#[test]
fn outputs_appear_under_their_name_only_when_complete() {
    let parent = tempfile::tempdir().unwrap();
    let destination = parent.path().join("out").join("quickstart");
    let output = OutputDirectory::create(&destination, Existing::Refuse).unwrap();
    fs::write(output.path().join(SUMMARY_FILE), "new").unwrap();
    let hidden = names(&parent.path().join("out"));
    assert_eq!(hidden, [".quickstart.partial"]);
    output.complete().unwrap();
    assert_eq!(names(&parent.path().join("out")), ["quickstart"]);
    assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "new");
}

#[cfg(unix)]
#[test]
fn others_may_read_complete_outputs_as_they_may_any_new_directory() {
    use std::os::unix::fs::MetadataExt;
    let parent = tempfile::tempdir().unwrap();
    fs::create_dir(parent.path().join("plain")).unwrap();
    OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap().complete().unwrap();
    let mode = |name: &str| fs::metadata(parent.path().join(name)).unwrap().mode() & 0o777;
    assert_eq!(mode("run"), mode("plain"));
}

#[test]
fn without_completion_nothing_remains() {
    let parent = tempfile::tempdir().unwrap();
    let output = OutputDirectory::create(parent.path().join("run"), Existing::Refuse).unwrap();
    fs::write(output.path().join("truth.nc"), "half").unwrap();
    drop(output);
    assert!(names(parent.path()).is_empty());
}

#[test]
fn existing_outputs_are_refused_unless_overwriting_was_asked_for() {
    let parent = tempfile::tempdir().unwrap();
    let destination = finished_run(parent.path(), "old");
    let error = OutputDirectory::create(&destination, Existing::Refuse).unwrap_err();
    assert!(error.to_string().contains("exists already"), "{error}");
    let output = OutputDirectory::create(&destination, Existing::Overwrite).unwrap();
    assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "old");
    fs::write(output.path().join(SUMMARY_FILE), "new").unwrap();
    output.complete().unwrap();
    assert_eq!(names(parent.path()), ["quickstart"]);
    assert_eq!(names(&destination), [SUMMARY_FILE]);
    assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "new");
}

#[test]
fn a_failed_swap_brings_the_old_outputs_back() {
    let parent = tempfile::tempdir().unwrap();
    let destination = finished_run(parent.path(), "old");
    let output = OutputDirectory::create(&destination, Existing::Overwrite).unwrap();
    fs::remove_dir_all(output.path()).unwrap();
    let error = output.complete().unwrap_err();
    assert!(error.to_string().contains("the outputs cannot be stored"), "{error}");
    assert_eq!(names(parent.path()), ["quickstart"]);
    assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "old");
}

#[test]
fn what_is_not_an_output_is_never_replaced() {
    let parent = tempfile::tempdir().unwrap();
    let (home, file) = (parent.path().join("thesis"), parent.path().join("notes"));
    fs::create_dir(&home).unwrap();
    fs::write(home.join("chapter"), "1").unwrap();
    fs::write(&file, "2").unwrap();
    let error = OutputDirectory::create(&home, Existing::Overwrite).unwrap_err();
    assert!(error.to_string().contains("no summary.json"), "{error}");
    let error = OutputDirectory::create(&file, Existing::Overwrite).unwrap_err();
    assert!(error.to_string().contains("not a directory"), "{error}");
    // It may also come to be there during the run.
    let output = OutputDirectory::create(parent.path().join("late"), Existing::Overwrite).unwrap();
    fs::create_dir(parent.path().join("late")).unwrap();
    fs::write(parent.path().join("late").join("work"), "3").unwrap();
    assert!(output.complete().is_err());
    assert_eq!(names(parent.path()), ["late", "notes", "thesis"]);
    assert_eq!(names(&parent.path().join("late")), ["work"]);
}

#[test]
fn an_impossible_place_is_an_error_that_names_it() {
    let parent = tempfile::tempdir().unwrap();
    fs::write(parent.path().join("file"), "").unwrap();
    let error = OutputDirectory::create(parent.path().join("file").join("run"), Existing::Refuse).unwrap_err();
    assert!(error.to_string().contains("file"), "{error}");
    assert!(OutputDirectory::create("/", Existing::Refuse).is_err());
    assert!(OutputDirectory::create("..", Existing::Overwrite).is_err());
}

#[test]
fn two_runs_cannot_write_to_the_same_place_at_a_time() {
    let parent = tempfile::tempdir().unwrap();
    let destination = parent.path().join("run");
    let first = OutputDirectory::create(&destination, Existing::Refuse).unwrap();
    for existing in [Existing::Refuse, Existing::Overwrite] {
        let error = OutputDirectory::create(&destination, existing).unwrap_err();
        assert!(error.to_string().contains("another run writes there"), "{error}");
    }
    fs::write(first.path().join(SUMMARY_FILE), "first").unwrap();
    first.complete().unwrap();
    assert_eq!(names(parent.path()), ["run"]);
    drop(OutputDirectory::create(&destination, Existing::Overwrite).unwrap());
    assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "first");
}

#[test]
fn a_directory_with_a_checkpoint_is_kept_until_it_is_discarded() {
    let parent = tempfile::tempdir().unwrap();
    let destination = parent.path().join("run");
    let first = OutputDirectory::create(&destination, Existing::Refuse).unwrap();
    fs::write(first.working().join("checkpoint-0000000007"), "").unwrap();
    fs::write(first.path().join("truth.nc"), "half").unwrap();
    drop(first);
    let error = OutputDirectory::create(&destination, Existing::Refuse).unwrap_err().to_string();
    assert!(error.contains("kept up to cycle 7") && error.contains("isobar resume"), "{error}");
    let again = OutputDirectory::resume(&destination, Existing::Refuse).unwrap();
    assert!(names(again.path()).is_empty(), "outputs are made anew");
    drop(again);
    drop(OutputDirectory::create(&destination, Existing::Overwrite).unwrap());
    assert!(names(parent.path()).is_empty());
    let error = OutputDirectory::resume(&destination, Existing::Refuse).unwrap_err().to_string();
    assert!(error.contains("there is no checkpoint"), "{error}");
}

#[test]
fn old_outputs_survive_an_end_in_the_middle_of_their_replacement() {
    let parent = tempfile::tempdir().unwrap();
    let destination = finished_run(parent.path(), "old");
    let working = working(&destination).unwrap();
    // Killed between the two renamings.
    fs::create_dir_all(working.join("outputs")).unwrap();
    fs::rename(&destination, working.join("replaced")).unwrap();
    let output = OutputDirectory::create(&destination, Existing::Overwrite).unwrap();
    assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "old");
    fs::write(output.path().join(SUMMARY_FILE), "new").unwrap();
    output.complete().unwrap();
    assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "new");
    assert_eq!(names(parent.path()), ["quickstart"]);
}

#[test]
fn a_run_that_ended_just_after_it_was_complete_is_complete() {
    let parent = tempfile::tempdir().unwrap();
    let destination = finished_run(parent.path(), "new");
    let working = working(&destination).unwrap();
    fs::create_dir(&working).unwrap();
    fs::write(working.join("checkpoint-0000000007"), "").unwrap();
    let error = OutputDirectory::resume(&destination, Existing::Overwrite).unwrap_err().to_string();
    assert!(error.contains("the run is complete"), "{error}");
    assert_eq!(names(parent.path()), ["quickstart"]);
}
