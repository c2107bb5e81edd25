//! How progress is shown: a bar on a terminal, an occasional line in a pipe, or nothing.

use crate::text::printable;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// Seconds between the lines of a run whose output is not a terminal.
const SECONDS_BETWEEN_LINES: f64 = 10.0;

/// Shows on standard error how many of a number of analyses are done.
pub(super) struct Display {
    kind: Kind,
    title: String,
    all: usize,
    /// What was done before the run was resumed.
    before: usize,
    began: Instant,
    last_line: Instant,
}

enum Kind {
    Bar(ProgressBar),
    Lines,
    Nothing,
}

impl Display {
    /// A display that suits standard error; nothing at all if `quiet`.
    pub fn new(quiet: bool) -> Self {
        let kind = match (quiet, std::io::stderr().is_terminal()) {
            (true, _) => Kind::Nothing,
            (false, true) => Kind::Bar(ProgressBar::with_draw_target(Some(0), ProgressDrawTarget::stderr_with_hz(8))),
            (false, false) => Kind::Lines,
        };
        let now = Instant::now();
        Self { kind, title: String::new(), all: 0, before: 0, began: now, last_line: now }
    }

    /// Begins anew, with `all` analyses to come.
    pub fn start(&mut self, title: &str, all: usize) {
        (self.title, self.all, self.before) = (title.into(), all, 0);
        (self.began, self.last_line) = (Instant::now(), Instant::now());
        if let Kind::Bar(bar) = &self.kind {
            bar.set_style(style());
            bar.set_length(all as u64);
            bar.set_prefix(self.title.clone());
            bar.enable_steady_tick(Duration::from_millis(250));
        }
    }

    /// So many had been done before: the time begins to count now.
    pub fn resume(&mut self, done: usize) {
        (self.before, self.began) = (done, Instant::now());
        if let Kind::Bar(bar) = &self.kind {
            bar.reset_eta();
        }
    }

    /// So many are done; `message` says where the work is.
    pub fn advance(&mut self, done: usize, message: impl FnOnce() -> String) {
        match &self.kind {
            Kind::Nothing => {}
            Kind::Bar(bar) => {
                bar.set_message(message());
                bar.set_position(done as u64);
            }
            Kind::Lines => {
                if self.last_line.elapsed().as_secs_f64() >= SECONDS_BETWEEN_LINES {
                    self.last_line = Instant::now();
                    let line = line(&self.title, &message(), [self.before, done], self.all, self.began.elapsed());
                    // A reader who has gone away is no reason to end the run.
                    let _ = writeln!(std::io::stderr(), "{line}");
                }
            }
        }
    }

    /// Shows a warning, also to those who want no progress.
    pub fn warn(&self, text: &str) {
        let text = printable(&format!("warning: {text}"));
        match &self.kind {
            Kind::Bar(bar) => bar.println(text),
            Kind::Lines | Kind::Nothing => drop(writeln!(std::io::stderr(), "{text}")),
        }
    }

    /// Does something that prints, without the bar in its way.
    pub fn aside(&self, work: impl FnOnce()) {
        match &self.kind {
            Kind::Bar(bar) => bar.suspend(work),
            Kind::Lines | Kind::Nothing => work(),
        }
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        if let Kind::Bar(bar) = &self.kind {
            bar.finish_and_clear();
        }
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        // A run that failed leaves no half bar behind its message.
        self.finish();
    }
}

fn style() -> ProgressStyle {
    ProgressStyle::with_template("{prefix} {wide_bar} {msg} · {per_sec} · {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// `quickstart: cycle 12 of 40, fkf · 30 % · 2.10 analyses/s · 54 s left`, with the number of analyses done when the time began to
/// count, and the number done now.
fn line(title: &str, message: &str, [before, done]: [usize; 2], all: usize, elapsed: Duration) -> String {
    let all = all.max(1);
    let rate = (done - before) as f64 / elapsed.as_secs_f64().max(1e-9);
    let left_s = all.saturating_sub(done) as f64 / rate.max(1e-9);
    format!("{title}: {message} · {} % · {rate:.2} analyses/s · {left_s:.0} s left", 100 * done / all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_where_the_run_is_and_how_long_it_will_take() {
        let line = line("small", "cycle 2 of 10, fkf", [0, 4], 20, Duration::from_secs(8));
        assert_eq!(line, "small: cycle 2 of 10, fkf · 20 % · 0.50 analyses/s · 32 s left");
    }
}
