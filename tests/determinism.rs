//! Same scenario, same seed: the same bits, on any number of threads.

mod runs;

use isobar::progress::Progress;
use isobar::summary::Summary;
use runs::{run_options, scenarios};
use std::fs;
use std::path::Path;

#[test]
fn one_and_two_threads_write_the_same_bytes() {
    let mut compared = 0;
    for scenario in scenarios() {
        if !["quickstart", "advection_exact"].contains(&scenario.name.as_str()) {
            continue;
        }
        let run = |threads| {
            let directory = tempfile::tempdir().unwrap();
            let mut options = run_options(directory.path(), scenario.cycle.score_from_cycle + 2);
            options.threads = Some(threads);
            options.netcdf = true;
            let summary = isobar::run::run(&scenario, &options, &mut Progress::new(true)).unwrap();
            (directory, summary)
        };
        let ((one, first), (two, second)) = (run(1), run(2));
        for entry in fs::read_dir(one.path().join("run")).unwrap() {
            let name = entry.unwrap().file_name();
            if Path::new(&name).extension().is_some_and(|extension| extension == "nc") {
                let [one, two] =
                    [&one, &two].map(|directory| fs::read(directory.path().join("run").join(&name)).unwrap());
                assert!(one == two, "{}: {name:?} differs", scenario.name);
                compared += 1;
            }
        }
        assert_eq!(untimed(first), untimed(second));
    }
    assert!(compared >= 14, "only {compared} files");
}

/// A summary without its costs.
fn untimed(mut summary: Summary) -> Summary {
    for scores in summary.methods.values_mut() {
        (scores.seconds_per_cycle, scores.peak_memory_bytes) = (0.0, None);
    }
    summary
}
