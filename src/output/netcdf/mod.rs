//! netCDF-3 files by the CF conventions 1.8: `truth.nc` if there is a truth, `<method>.nc` for each method,
//! `observations.nc`, and `<method>_forecast.nc` where there are forecasts ahead; of a complete run also [`members`].
//!
//! All numbers are of 64 bits, so that a file holds exactly what was computed. Missing values are
//! [`FILL_VALUE`](file::FILL_VALUE).

pub mod coordinates;
pub mod file;
mod forecast;
pub mod members;
mod method;
mod observations;
mod truth;

use crate::event::{Event, MethodInfo, RunInfo};
use crate::output::{OutputDirectory, Sink, SinkError};
use crate::scores::Summary;
use forecast::ForecastFile;
use method::MethodFile;
use observations::ObservationsFile;
use std::collections::HashSet;
use std::path::PathBuf;
use truth::TruthFile;

/// Writes the netCDF files of a run: truth and estimates as they come, the observations when all are known.
#[derive(Debug)]
pub struct NetcdfSink {
    info: RunInfo,
    /// `None` in a world without a truth.
    truth: Option<TruthFile>,
    observations: ObservationsFile,
    method_paths: Vec<PathBuf>,
    /// A method's file is made with its first result, which shows whether the method has spreads.
    methods: Vec<Option<MethodFile>>,
    /// The files of forecasts ahead, in the order of the methods; none without such forecasts.
    forecasts: Vec<ForecastFile>,
    /// Whether a method has failed: its file has missing values from then on.
    failed: Vec<bool>,
}

impl NetcdfSink {
    /// Creates the files in `directory`.
    ///
    /// # Errors
    /// If a file cannot be written, or if two methods' names do not lead to distinct names of files.
    pub fn create(info: &RunInfo, directory: &OutputDirectory) -> Result<Self, SinkError> {
        let path = |stem: &str| directory.path().join(format!("{stem}.nc"));
        let mut stems: HashSet<String> = ["truth".into(), "observations".into()].into();
        for method in &info.methods {
            let stem = coordinates::safe_name(&method.name, "_");
            // Without regard to case: some file systems have none.
            let is_new = stems.insert(stem.to_lowercase())
                && (info.lead_times.is_none() || stems.insert(format!("{}_forecast", stem.to_lowercase())));
            if !is_new {
                let reason = format!("the name of method `{}` leads to a file that another output has", method.name);
                return Err(SinkError { path: path(&stem), reason });
            }
        }
        let forecasts = info.lead_times.map_or_else(Vec::new, |times| {
            let file = |(number, method): (usize, &MethodInfo)| {
                let path = path(&format!("{}_forecast", coordinates::safe_name(&method.name, "_-")));
                ForecastFile::new(path, info, number, times)
            };
            info.methods.iter().enumerate().map(file).collect()
        });
        Ok(Self {
            forecasts,
            truth: info.has_truth.then(|| TruthFile::create(&path("truth"), info)).transpose()?,
            observations: ObservationsFile::new(path("observations"), info),
            method_paths: info.methods.iter().map(|method| path(&coordinates::safe_name(&method.name, "_-"))).collect(),
            methods: info.methods.iter().map(|_| None).collect(),
            failed: vec![false; info.methods.len()],
            info: info.clone(),
        })
    }

    /// The file of a method, made if it is not there.
    fn method(
        &mut self,
        number: usize,
        first: Option<&crate::event::Analysed<'_>>,
    ) -> Result<&mut MethodFile, SinkError> {
        let file = &mut self.methods[number];
        match file {
            Some(file) => Ok(file),
            None => {
                let (path, method) = (&self.method_paths[number], &self.info.methods[number]);
                Ok(file.insert(MethodFile::create(path, &self.info, method, first)?))
            }
        }
    }

    /// Writes what is left, and checks that nothing is missing.
    fn finish(&mut self, summary: &Summary) -> Result<(), SinkError> {
        self.forecasts.iter().try_for_each(|file| file.write(&self.info, summary))?;
        self.observations.write(&self.info)?;
        let cycles = self.info.count();
        let info = self.info.clone();
        for number in 0..self.methods.len() {
            if self.failed[number] {
                self.method(number, None)?.fill_up(&info)?;
            }
            check_records(self.method(number, None)?.file(), cycles)?;
        }
        self.truth.as_ref().map_or(Ok(()), |truth| check_records(truth.file(), cycles + 1))
    }
}

impl Sink for NetcdfSink {
    fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Started(_) | Event::Resumed(_) => Ok(()),
            Event::Truth { time, state, calibration, .. } => match &mut self.truth {
                Some(truth) => truth.append(*time, state, calibration),
                None => Ok(()),
            },
            Event::Observed { window, values_bias_removed } => {
                self.observations.add(&self.info, window, values_bias_removed)
            }
            Event::Analysed(analysed) => {
                self.method(analysed.method, Some(analysed))?.append(analysed)?;
                self.observations.add_results(analysed)
            }
            Event::Smoothed(smoothed) => self.method(smoothed.method, None)?.smooth(smoothed),
            Event::Forecast(forecast) => {
                self.forecasts.iter_mut().skip(forecast.method).take(1).for_each(|file| file.add(forecast));
                Ok(())
            }
            Event::Finished(summary) => self.finish(summary),
            Event::Failed { method, .. } => {
                self.failed[*method] = true;
                Ok(())
            }
            Event::Estimated(_)
            | Event::Judged(_)
            | Event::Outlook { .. }
            | Event::CycleEnded(_)
            | Event::Warning(_) => Ok(()),
        }
    }
}

fn check_records(file: &file::NetcdfFile, expected: usize) -> Result<(), SinkError> {
    match file.records() {
        records if records == expected => Ok(()),
        records => Err(file.failure(format!("the run is complete with {records} records instead of {expected}"))),
    }
}
