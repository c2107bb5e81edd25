//! A process that computes the runs that it is given.

use super::line::Line;
use super::messages::{Failure, FromWorker, Order, ToWorker};
use super::part::Compute;
use super::together;
use crate::batch::JobError;
use crate::event::Event;
use crate::interrupt;
use crate::output::{Sink, SinkError};
use crate::scores::Summary;
use miette::Report;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};

/// How often a worker says how far it is.
const EVERY: Duration = Duration::from_millis(500);

/// How often it looks whether something was said to it.
const LOOK: Duration = Duration::from_millis(20);

/// Computes runs until there are no more.
///
/// # Errors
/// If what rank 0 says cannot be read.
pub fn serve(line: &Line, compute: Compute) -> Result<(), Report> {
    interrupt::listen();
    loop {
        match line.heard()? {
            None => thread::sleep(LOOK),
            Some(ToWorker::Run(order)) => {
                let outcome = obey(line, &order, compute)?;
                line.say(&FromWorker::Done(Box::new(outcome.map_err(Failure::from))));
            }
            Some(ToWorker::Share(order)) => together::take_part(&order),
            Some(ToWorker::End) => {}
            Some(ToWorker::Leave) => return Ok(()),
        }
    }
}

/// Computes a run on another thread, while this one, which alone may speak with other processes, says how far it is.
fn obey(line: &Line, order: &Order, compute: Compute) -> Result<Result<Summary, JobError>, Report> {
    let (sender, news) = mpsc::channel();
    thread::scope(|scope| {
        let run = scope.spawn(move || compute_order(order, compute, &mut Listener(sender)));
        let (mut analyses, mut cycle, mut last) = (0, 0, Instant::now());
        loop {
            match news.recv_timeout(LOOK) {
                Ok(News::Analysed { cycle: at }) => (analyses, cycle) = (analyses + 1, at),
                Ok(News::Said(message)) => line.say(&message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if last.elapsed() > EVERY {
                line.say(&FromWorker::Alive { analyses, cycle });
                (analyses, last) = (0, Instant::now());
            }
            if let Some(ToWorker::End) = line.heard()? {
                interrupt::request_end();
            }
        }
        line.say(&FromWorker::Alive { analyses, cycle });
        Ok(run.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

fn compute_order(order: &Order, compute: Compute, listener: &mut Listener) -> Result<Summary, JobError> {
    let scenario = order.scenario();
    let scenario = scenario.map_err(|report| JobError { report, may_pass: true, cannot_resume: false })?;
    compute(&scenario, &order.options(), listener)
}

/// What the thread that computes tells the one that speaks.
enum News {
    Analysed { cycle: usize },
    Said(FromWorker),
}

/// Hears the run.
struct Listener(Sender<News>);

impl Sink for Listener {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        let news = match event {
            Event::Analysed(analysed) => News::Analysed { cycle: analysed.cycle },
            Event::Failed { failure, .. } => {
                News::Said(FromWorker::MethodFailed { cycle: failure.cycle, reason: failure.reason.clone() })
            }
            Event::Warning(text) => News::Said(FromWorker::Warning(text.to_string())),
            _ => return Ok(()),
        };
        // Nobody hears it where the other thread has ended.
        let _ = self.0.send(news);
        Ok(())
    }
}
