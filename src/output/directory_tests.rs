//! What becomes of directories, whatever happens to a run.

use super::*;
use crate::output::destination::complete_runs;

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
    contents::list(&destination).unwrap();
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
    assert_eq!(names(&destination), [contents::LIST_FILE, SUMMARY_FILE]);
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
    assert_eq!(names(parent.path()), ["notes", "thesis"]);
}

/// Nothing complete is lost: where outputs cannot have their name now, they can have it later.
#[test]
fn outputs_whose_place_was_taken_during_the_run_are_kept() {
    let parent = tempfile::tempdir().unwrap();
    for existing in [Existing::Refuse, Existing::Overwrite] {
        let destination = parent.path().join("late");
        let output = OutputDirectory::create(&destination, existing).unwrap();
        fs::write(output.path().join(SUMMARY_FILE), "new").unwrap();
        fs::create_dir(&destination).unwrap();
        fs::write(destination.join("work"), "3").unwrap();
        assert!(output.complete().is_err());
        assert_eq!(names(parent.path()), [".late.partial", "late"]);
        assert_eq!(names(&destination), ["work"]);
        let error = OutputDirectory::create(parent.path().join("late"), Existing::Refuse).unwrap_err().to_string();
        assert!(error.contains("exists already"), "{error}");
        assert!(OutputDirectory::finish(&destination).unwrap().complete().is_err());
        assert_eq!(stage(&destination).unwrap(), Stage::Complete);
        fs::remove_dir_all(&destination).unwrap();
        let error = OutputDirectory::create(parent.path().join("late"), Existing::Refuse).unwrap_err().to_string();
        assert!(error.contains("isobar resume"), "{error}");
        OutputDirectory::finish(&destination).unwrap().complete().unwrap();
        assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "new");
        assert_eq!(names(parent.path()), ["late"]);
        fs::remove_dir_all(&destination).unwrap();
    }
}

/// What users put beside the outputs is not deleted, whenever they do so.
#[test]
fn what_no_run_wrote_is_kept() {
    let parent = tempfile::tempdir().unwrap();
    let destination = finished_run(parent.path(), "old");
    fs::write(destination.join("NOTES.md"), "mine").unwrap();
    let error = OutputDirectory::create(&destination, Existing::Overwrite).unwrap_err().to_string();
    assert!(error.contains("NOTES.md"), "{error}");
    fs::remove_file(destination.join("NOTES.md")).unwrap();
    let output = OutputDirectory::create(&destination, Existing::Overwrite).unwrap();
    fs::write(output.path().join(SUMMARY_FILE), "new").unwrap();
    fs::create_dir(destination.join("analysis")).unwrap();
    let error = output.complete().unwrap_err().to_string();
    assert!(error.contains("analysis/"), "{error}");
    assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "old");
    fs::remove_dir(destination.join("analysis")).unwrap();
    OutputDirectory::finish(&destination).unwrap().complete().unwrap();
    assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "new");
    assert_eq!(names(parent.path()), ["quickstart"]);
}

#[test]
fn a_single_run_does_not_replace_a_batch() {
    let parent = tempfile::tempdir().unwrap();
    let batch = parent.path().join("run");
    for seed in 1..=3 {
        let run = batch.join(format!("seed-{seed}"));
        fs::create_dir_all(&run).unwrap();
        fs::write(run.join(SUMMARY_FILE), "").unwrap();
    }
    fs::write(batch.join(SEEDS_FILE), "").unwrap();
    contents::list(&batch).unwrap();
    let error = OutputDirectory::create(&batch, Existing::Overwrite).unwrap_err().to_string();
    assert!(error.contains("a batch of 3 runs"), "{error}");
    drop(OutputDirectory::create_batch(&batch, Existing::Overwrite).unwrap());
    assert_eq!(complete_runs(&batch), 3);
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

/// A run that is killed at any moment while its outputs replace others: what is there, what `isobar run` says, and what is
/// there after `isobar resume`.
#[test]
fn old_outputs_survive_an_end_at_any_moment_of_their_replacement_and_never_come_back_after_it() {
    for moment in 0..6 {
        let parent = tempfile::tempdir().unwrap();
        let destination = finished_run(parent.path(), "old");
        let output = OutputDirectory::create(&destination, Existing::Overwrite).unwrap();
        fs::write(output.path().join(SUMMARY_FILE), "new").unwrap();
        let (working, outputs) = (output.working().to_path_buf(), output.path().to_path_buf());
        let replaced = working.join(REPLACED);
        output.mark_complete().unwrap();
        let steps: [&dyn Fn(); 5] = [
            &|| fs::rename(&destination, &replaced).unwrap(),
            &|| fs::rename(&outputs, &destination).unwrap(),
            &|| fs::remove_file(replaced.join(SUMMARY_FILE)).unwrap(),
            &|| fs::remove_dir_all(&replaced).unwrap(),
            &|| fs::remove_file(working.join(COMPLETE)).unwrap(),
        ];
        steps.iter().take(moment).for_each(|step| step());
        if moment < 5 {
            // Killed: nothing is cleared away, but the lock is free.
            fs::write(working.join(JOURNAL_FILE), "").unwrap();
        }
        drop(output);
        let summary = || fs::read_to_string(destination.join(SUMMARY_FILE)).ok();
        let found = if moment == 0 { Some("old") } else { Some("new").filter(|_| moment > 1) };
        assert_eq!(summary().as_deref(), found, "{moment}");
        if moment < 5 {
            let again = OutputDirectory::create(&destination, Existing::Refuse);
            assert!(again.is_err(), "{moment}");
            // With --overwrite it is begun anew, and until that is complete the newest complete outputs are there.
            let other = tempfile::tempdir().unwrap();
            let copied =
                std::process::Command::new("cp").args(["-a", "."]).arg(other.path()).current_dir(&parent).status();
            assert!(copied.unwrap().success());
            let there = other.path().join("quickstart");
            drop(OutputDirectory::create(&there, Existing::Overwrite).unwrap());
            let newest = if moment < 2 { "old" } else { "new" };
            assert_eq!(fs::read_to_string(there.join(SUMMARY_FILE)).unwrap(), newest, "{moment}");
            assert_eq!(names(other.path()), ["quickstart"]);
            OutputDirectory::finish(&destination).unwrap().complete().unwrap();
        }
        assert_eq!(summary().as_deref(), Some("new"), "{moment}");
        // Nothing comes back once the user has removed them.
        fs::remove_dir_all(&destination).unwrap();
        if moment < 5 {
            assert!(names(parent.path()).is_empty());
            let output = OutputDirectory::create(&destination, Existing::Refuse).unwrap();
            assert!(!destination.exists());
            drop(output);
        }
    }
}

#[test]
fn replaced_outputs_do_not_come_back_when_their_successors_are_removed() {
    let parent = tempfile::tempdir().unwrap();
    let destination = finished_run(parent.path(), "old");
    let output = OutputDirectory::create(&destination, Existing::Overwrite).unwrap();
    fs::write(output.path().join(SUMMARY_FILE), "new").unwrap();
    output.publish().unwrap();
    fs::write(output.working().join(JOURNAL_FILE), "").unwrap();
    drop(output);
    assert_eq!(stage(&destination).unwrap(), Stage::Published);
    fs::remove_dir_all(&destination).unwrap();
    let output = OutputDirectory::create(&destination, Existing::Refuse).unwrap();
    assert!(!destination.exists());
    drop(output);
    assert!(names(parent.path()).is_empty());
}

#[cfg(unix)]
#[test]
fn a_working_directory_that_holds_links_or_pipes_is_left_alone() {
    let parent = tempfile::tempdir().unwrap();
    let precious = parent.path().join("precious");
    fs::create_dir(&precious).unwrap();
    fs::write(precious.join("thesis"), "precious").unwrap();
    let out = parent.path().join("out");
    let destination = out.join("run");
    let working = working::path(&destination).unwrap();
    let names_to_try =
        ["lock", "outputs", "replaced", "journal", "complete", "batch.json", "checkpoint-0000000003", "x"];
    let targets = [precious.clone(), precious.join("thesis"), precious.join("new"), PathBuf::from("/dev/zero")];
    let attempts = || {
        [
            OutputDirectory::create(&destination, Existing::Refuse).map(drop),
            OutputDirectory::create(&destination, Existing::Overwrite).map(drop),
            OutputDirectory::create_batch(&destination, Existing::Overwrite).map(drop),
            OutputDirectory::finish(&destination).map(drop),
            stage(&destination).map(drop),
        ]
    };
    for below in ["", "outputs"] {
        for name in names_to_try {
            for target in targets.iter().map(Some).chain([None]) {
                fs::create_dir_all(working.join(below)).unwrap();
                fs::write(working.join("lock"), "").unwrap();
                let path = working.join(below).join(name);
                let _ = fs::remove_file(&path);
                match target {
                    Some(target) => std::os::unix::fs::symlink(target, &path).unwrap(),
                    None => {
                        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
                    }
                }
                // A process that another test starts at this moment has the lock, too, until it executes its program.
                let errors = loop {
                    let errors = attempts().map(|attempt| attempt.unwrap_err().to_string());
                    if !errors.iter().any(|error| error.contains("another run writes")) {
                        break errors;
                    }
                };
                for error in errors {
                    assert!(error.contains("stays as it is"), "{below} {name} {target:?}: {error}");
                }
                assert_eq!(names(&precious), ["thesis"]);
                assert_eq!(fs::read_to_string(precious.join("thesis")).unwrap(), "precious");
                fs::remove_dir_all(&out).unwrap();
            }
        }
    }
    // The whole directory, and one that has no lock.
    fs::create_dir(&out).unwrap();
    std::os::unix::fs::symlink(&precious, &working).unwrap();
    assert!(attempts().iter().all(Result::is_err));
    fs::remove_file(&working).unwrap();
    fs::create_dir(&working).unwrap();
    fs::write(working.join("thesis"), "").unwrap();
    assert!(
        OutputDirectory::create(&destination, Existing::Overwrite).unwrap_err().to_string().contains("it has no lock")
    );
    assert_eq!(names(&working), ["thesis"]);
}

/// Whoever comes while another run ends is refused, waits for nothing, and takes nothing away from it.
#[test]
fn runs_at_the_end_of_another_do_not_disturb_it() {
    let parent = tempfile::tempdir().unwrap();
    let destination = parent.path().join("run");
    let complete = std::sync::atomic::AtomicUsize::new(0);
    let work = || {
        for _ in 0..30 {
            match OutputDirectory::create(&destination, Existing::Overwrite) {
                Ok(output) => {
                    fs::write(output.path().join(SUMMARY_FILE), "new").unwrap();
                    output.complete().unwrap();
                    complete.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                }
                Err(error) => {
                    let said = error.to_string();
                    // Between the renamings there is no list of files, for the directory is not there.
                    let expected = [
                        "another run writes there",
                        "keeps disappearing",
                        "no list of its files",
                        "no summary.json",
                        "cannot be examined",
                    ];
                    assert!(expected.iter().any(|expected| said.contains(expected)), "{said}");
                }
            }
        }
    };
    std::thread::scope(|scope| (0..4).for_each(|_| drop(scope.spawn(work))));
    assert!(complete.into_inner() > 10);
    assert_eq!(names(parent.path()), ["run"]);
    assert_eq!(fs::read_to_string(destination.join(SUMMARY_FILE)).unwrap(), "new");
}
