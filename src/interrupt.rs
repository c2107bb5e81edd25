//! Signals to end the program: the first one ends it after the cycle, the second one at once.

use std::sync::atomic::{AtomicBool, Ordering};

/// The exit code after a signal.
pub const EXIT_CODE: u8 = 130;

/// Signals concern the whole process, and so does this flag.
static REQUESTED: AtomicBool = AtomicBool::new(false);

/// Listens for SIGINT, SIGTERM and SIGHUP from now on. Where that is not possible, they end the program at once.
pub fn listen() {
    #[cfg(unix)]
    {
        use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
        use std::sync::Once;
        static LISTENING: Once = Once::new();
        LISTENING.call_once(|| {
            let mut signals = vec![SIGINT, SIGTERM];
            if !is_immune_to_hangup() {
                signals.push(SIGHUP);
            }
            let Ok(mut signals) = signal_hook::iterator::Signals::new(signals) else { return };
            // A closed terminal sends SIGHUP, and so does the shell in it: the second one is no second wish.
            let listen = move || signals.forever().for_each(|signal| request(signal != SIGHUP));
            std::thread::spawn(listen);
        });
    }
}

/// Whether SIGHUP is to be ignored, as under `nohup`. Where the system does not tell, it is taken to be, and keeps its effect.
#[cfg(unix)]
fn is_immune_to_hangup() -> bool {
    std::fs::read_to_string("/proc/self/status").map_or(true, |status| ignores_hangup(&status))
}

/// Whether the first bit is set in the mask of ignored signals, in hexadecimal digits.
#[cfg(unix)]
fn ignores_hangup(status: &str) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let last = mask.and_then(|mask| mask.trim().chars().last()?.to_digit(16));
    last.is_none_or(|digit| digit & 1 == 1)
}

/// Asks the program to end after this cycle, as the first signal does.
pub fn request_end() {
    REQUESTED.store(true, Ordering::SeqCst);
}

#[cfg(unix)]
fn request(ends_at_once: bool) {
    use std::io::Write;
    if !REQUESTED.swap(true, Ordering::SeqCst) {
        // There is nowhere to report that standard error is closed.
        let _ = writeln!(std::io::stderr(), "\nending after this cycle; once more to end at once");
    } else if ends_at_once {
        std::process::exit(i32::from(EXIT_CODE));
    }
}

/// Whether the program has been asked to end.
pub fn requested() -> bool {
    REQUESTED.load(Ordering::SeqCst)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn nohup_is_respected() {
        let status = |mask: &str| format!("Name:\tisobar\nSigBlk:\t0000000000000000\nSigIgn:\t{mask}\nSigCgt:\t0\n");
        assert!(!ignores_hangup(&status("0000000000001000")));
        assert!(ignores_hangup(&status("0000000000001001")));
        assert!(ignores_hangup("Name:\tisobar\n"));
    }
}
