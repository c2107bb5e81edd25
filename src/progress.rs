//! How far a run is, for whoever waits for it.

use crate::event::{Event, RunInfo};
use crate::sink::{Sink, SinkError};
use crate::summary::Failure;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// Seconds between the lines of a run whose output is not a terminal.
const SECONDS_BETWEEN_LINES: f64 = 10.0;

/// Shows the progress of a run on standard error: a bar on a terminal, an occasional line in a pipe, or nothing.
pub struct Progress {
    display: Display,
    info: Option<RunInfo>,
    done: usize,
    began: Instant,
    last_line: Instant,
}

enum Display {
    Bar(ProgressBar),
    Lines,
    Nothing,
}

impl Progress {
    /// A display that suits standard error; nothing at all if `quiet`.
    pub fn new(quiet: bool) -> Self {
        let display = match (quiet, std::io::stderr().is_terminal()) {
            (true, _) => Display::Nothing,
            (false, true) => {
                Display::Bar(ProgressBar::with_draw_target(Some(0), ProgressDrawTarget::stderr_with_hz(8)))
            }
            (false, false) => Display::Lines,
        };
        let now = Instant::now();
        Self { display, info: None, done: 0, began: now, last_line: now }
    }

    fn analysed(&mut self, method: usize, cycle: usize) {
        self.done += 1;
        let Some(info) = &self.info else { return };
        let name = info.methods.get(method).map_or("", |method| method.name.as_str());
        match &self.display {
            Display::Nothing => {}
            Display::Bar(bar) => {
                bar.set_message(format!("cycle {cycle} of {}, {name}", info.cycles));
                bar.set_position(self.done as u64);
            }
            Display::Lines => {
                if self.last_line.elapsed().as_secs_f64() >= SECONDS_BETWEEN_LINES {
                    self.last_line = Instant::now();
                    let line = line(info, name, cycle, self.done, self.began.elapsed());
                    // A reader who has gone away is no reason to end the run.
                    let _ = writeln!(std::io::stderr(), "{line}");
                }
            }
        }
    }
}

impl Progress {
    fn warn(&self, text: &str) {
        let text = format!("warning: {text}");
        match &self.display {
            Display::Bar(bar) => bar.println(text),
            // Whoever wants no progress wants to know this all the same.
            Display::Lines | Display::Nothing => drop(writeln!(std::io::stderr(), "{text}")),
        }
    }

    fn failed(&mut self, method: usize, failure: &Failure) {
        let Some(info) = &self.info else { return };
        // What it will not do need not be waited for.
        self.done += (info.cycles + 1).saturating_sub(failure.cycle);
        let name = info.methods.get(method).map_or("", |method| method.name.as_str());
        self.warn(&format!("method {name} failed in cycle {}, the others go on: {}", failure.cycle, failure.reason));
    }
}

impl Sink for Progress {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Started(info) => {
                (self.done, self.began, self.last_line) = (0, Instant::now(), Instant::now());
                self.info = Some((*info).clone());
                if let Display::Bar(bar) = &self.display {
                    bar.set_style(style());
                    bar.set_length((info.cycles * info.methods.len()) as u64);
                    bar.set_prefix(info.scenario.clone());
                    bar.enable_steady_tick(Duration::from_millis(250));
                }
            }
            Event::Analysed(analysed) => self.analysed(analysed.method, analysed.cycle),
            Event::Finished(_) => {
                if let Display::Bar(bar) = &self.display {
                    bar.finish_and_clear();
                }
            }
            Event::Warning(text) => self.warn(text),
            Event::Failed { method, failure } => self.failed(*method, failure),
            Event::Truth { .. } | Event::Observed(_) | Event::CycleEnded(_) => {}
        }
        Ok(())
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        // A run that failed leaves no half bar behind its message.
        if let Display::Bar(bar) = &self.display {
            bar.finish_and_clear();
        }
    }
}

fn style() -> ProgressStyle {
    ProgressStyle::with_template("{prefix} {wide_bar} {msg} · {per_sec} · {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// `quickstart: cycle 12 of 40, fkf · 30 % · 2.10 analyses/s · 54 s left`
fn line(info: &RunInfo, method: &str, cycle: usize, done: usize, elapsed: Duration) -> String {
    let all = (info.cycles * info.methods.len()).max(1);
    let rate = done as f64 / elapsed.as_secs_f64().max(1e-9);
    let left_s = all.saturating_sub(done) as f64 / rate.max(1e-9);
    format!(
        "{}: cycle {cycle} of {}, {method} · {} % · {rate:.2} analyses/s · {left_s:.0} s left",
        info.scenario,
        info.cycles,
        100 * done / all
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::MethodInfo;
    use isobar_model::{Boundary, Grid, Layout, Time};
    use std::sync::Arc;

    #[test]
    fn a_line_says_where_the_run_is_and_how_long_it_will_take() {
        let grid = Grid { nx: 4, ny: 4, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
        let method = |name: &str| MethodInfo { name: name.into(), description: String::new() };
        let info = RunInfo {
            scenario: "small".into(),
            title: String::new(),
            scenario_text: String::new(),
            seed: 1,
            layout: Arc::new(Layout { grid, variables: Vec::new() }),
            projection: None,
            start: Time::from_seconds(0),
            window: isobar_model::Duration::from_seconds(60),
            cycles: 10,
            calibration: Default::default(),
            methods: vec![method("free"), method("fkf")],
            stations: Vec::new(),
        };
        let line = line(&info, "fkf", 2, 4, Duration::from_secs(8));
        assert_eq!(line, "small: cycle 2 of 10, fkf · 20 % · 0.50 analyses/s · 32 s left");
    }
}
