//! The number of threads, as the command line and the environment ask for it.

use miette::{IntoDiagnostic, Report, miette};
use rayon::{ThreadPool, ThreadPoolBuilder};

/// The most threads of `--threads`.
pub(super) const MOST_THREADS: u64 = 1024;

/// The variables that rayon obeys where there is no `--threads`.
const VARIABLES: [&str; 2] = ["RAYON_NUM_THREADS", "RAYON_RS_NUM_CPUS"];

/// As many threads as `--threads` asks for, or as are usual without it.
pub(super) fn workers(threads: Option<u64>) -> Result<ThreadPool, Report> {
    let threads = threads.map_or(0, |threads| threads as usize);
    ThreadPoolBuilder::new().num_threads(threads).build().into_diagnostic()
}

/// Refuses more threads than `--threads` may ask for.
///
/// # Errors
/// The variable that does, and what it may be.
pub(super) fn check_environment() -> Result<(), Report> {
    VARIABLES.iter().try_for_each(|name| check(name, std::env::var(name).ok().as_deref()))
}

fn check(name: &str, value: Option<&str>) -> Result<(), Report> {
    // What is no number, rayon takes no notice of.
    let Some(digits) = value.filter(|value| !value.is_empty() && value.bytes().all(|byte| byte.is_ascii_digit()))
    else {
        return Ok(());
    };
    match digits.parse::<u64>() {
        Ok(threads) if threads <= MOST_THREADS => Ok(()),
        _ => {
            let help = format!("a number from 1 to {MOST_THREADS}, or none: one thread for each core");
            Err(miette!(help = help, "the environment variable {name} asks for too many threads"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::check;

    #[test]
    fn the_environment_asks_for_no_more_threads_than_the_command_line() {
        for value in [None, Some("1"), Some("1024"), Some(""), Some("many")] {
            assert!(check("RAYON_NUM_THREADS", value).is_ok(), "{value:?}");
        }
        for value in ["1025", "100000", "99999999999999999999999"] {
            let error = check("RAYON_NUM_THREADS", Some(value)).unwrap_err().to_string();
            assert!(error.contains("RAYON_NUM_THREADS asks for too many threads"), "{error}");
        }
    }
}
