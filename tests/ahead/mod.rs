//! What the tests of forecasts ahead have in common: a world, and all that a run in it says.

pub use crate::common::CARRIED_TRACER as TRACER;
use crate::runs::run_options;
use isobar::event::{Event, RunInfo};
use isobar::options::RunOptions;
use isobar::output::{Sink, SinkError};
use isobar::run::run;
use isobar::scenario::Scenario;
use isobar::scores::{Outlook, Summary, Values, WarningCase};
use isobar::verdict::Verdict;
use isobar_assim::Estimate;
use isobar_model::State;
use isobar_obs::ObservationWindow;
use std::collections::BTreeMap;
use std::path::Path;

pub fn parse(parts: &[&str]) -> Scenario {
    Scenario::parse(Path::new("tracer.toml"), &parts.concat()).unwrap()
}

/// A forecast ahead and its scores, by method, start and lead time in cycles.
pub type Forecasts = BTreeMap<(usize, usize, usize), (Estimate, Values)>;

/// All that a run says of its estimates.
#[derive(Default)]
pub struct Listener {
    pub info: Option<RunInfo>,
    /// By method and cycle.
    pub analysed: BTreeMap<(usize, usize), (Estimate, Estimate, Values)>,
    pub truth: BTreeMap<usize, State>,
    pub observed: BTreeMap<usize, ObservationWindow>,
    pub forecasts: Forecasts,
    /// Likewise.
    pub warned: BTreeMap<(usize, usize, usize), Vec<WarningCase>>,
    /// By method and start.
    pub outlooks: BTreeMap<(usize, usize), Outlook>,
    /// Cycle, method and verdict.
    pub verdicts: Vec<(usize, usize, Verdict)>,
    pub warnings: Vec<String>,
    /// The cycle whose observations end the run.
    pub end: Option<usize>,
}

impl Sink for Listener {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Started(info) => self.info = Some((*info).clone()),
            Event::Truth { cycle, state, .. } => drop(self.truth.insert(*cycle, state.clone().into_owned())),
            Event::Observed { window, .. } => {
                if self.end == Some(window.cycle) {
                    return Err(SinkError { path: "nothing".into(), reason: "this is the end".into() });
                }
                self.observed.insert(window.cycle, window.clone().into_owned());
            }
            Event::Analysed(it) => {
                let mut scores = it.scores.clone().into_owned();
                scores.retain(|key, _| !["seconds_per_cycle", "peak_memory_bytes"].contains(&key.as_str()));
                let estimates = (it.background.clone().into_owned(), it.analysis.estimate.clone(), scores);
                self.analysed.insert((it.method, it.cycle), estimates);
            }
            Event::Forecast(it) => {
                let key = (it.method, it.from_cycle, it.cycle - it.from_cycle);
                let own = (it.estimate.clone().into_owned(), it.scores.clone().into_owned());
                self.warned.insert(key, it.warnings.clone().into_owned());
                assert!(self.forecasts.insert(key, own).is_none(), "{key:?} comes twice");
            }
            Event::Outlook { method, outlook } => {
                self.outlooks.insert((*method, outlook.from_cycle), outlook.clone().into_owned());
            }
            Event::Judged(it) => {
                self.verdicts.extend(it.verdicts.iter().map(|verdict| (it.cycle, it.method, verdict.clone())));
            }
            Event::Warning(text) => self.warnings.push((*text).to_string()),
            _ => {}
        }
        Ok(())
    }
}

pub fn listen(scenario: &Scenario) -> (Listener, Summary) {
    let folder = tempfile::tempdir().unwrap();
    let mut listener = Listener::default();
    let options = RunOptions { threads: Some(1), ..run_options(folder.path(), scenario.cycle.count) };
    let summary = run(scenario, &options, &mut listener).unwrap();
    (listener, summary)
}
