//! Signals to end the program: the first one ends it after the cycle, the second one at once.

use std::sync::atomic::{AtomicBool, Ordering};

/// The exit code after a signal.
pub const EXIT_CODE: u8 = 130;

/// Signals concern the whole process, and so does this flag.
static REQUESTED: AtomicBool = AtomicBool::new(false);

/// Listens for SIGINT and SIGTERM from now on. Where that is not possible, they end the program at once.
pub fn listen() {
    #[cfg(unix)]
    {
        use signal_hook::consts::{SIGINT, SIGTERM};
        use std::sync::Once;
        static LISTENING: Once = Once::new();
        LISTENING.call_once(|| {
            let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGINT, SIGTERM]) else { return };
            std::thread::spawn(move || signals.forever().for_each(|_| request()));
        });
    }
}

#[cfg(unix)]
fn request() {
    use std::io::Write;
    if REQUESTED.swap(true, Ordering::SeqCst) {
        std::process::exit(i32::from(EXIT_CODE));
    }
    // There is nowhere to report that standard error is closed.
    let _ = writeln!(std::io::stderr(), "\nending after this cycle; once more to end at once");
}

/// Whether the program has been asked to end.
pub fn requested() -> bool {
    REQUESTED.load(Ordering::SeqCst)
}
