//! `isobar winds`.

use super::console::{print, print_json, warn, width};
use super::out_file;
use super::threads::{MOST_THREADS, workers};
use crate::calendar::utc;
use crate::soundings::{Request, Sounding};
use crate::text::{counted, shown_path};
use clap::Args;
use isobar_assim::wind_finding::Motion;
use miette::{Report, miette};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

pub const WINDS_HELP: &str = "\
The table of trackers has a line for each: `tracker`, its place `x_m,y_m,z_m` (eastward, northward, upward), the standard
deviations of its readings `sigma_range_m,sigma_azimuth_deg,sigma_elevation_deg`, empty for what it does not measure. `sigma_range_offset_m,sigma_azimuth_offset_deg,sigma_elevation_offset_deg` give the prior standard deviations of the offsets,
`drift_range_m_per_sqrt_day` and so on their change within a day.

The table of readings has a line for each tracker and time: `time,tracker,range_m,azimuth_deg,elevation_deg`, azimuth from
north, clockwise; what was not read is empty.

Examples:
  isobar winds isobar:/winds/flight_1.csv --trackers isobar:/winds/trackers.csv    a flight inside isobar
  isobar winds flight.csv --trackers trackers.csv
  isobar winds flight.csv --trackers trackers.csv --wind-change 1 --out winds.csv --page winds.html
  isobar winds today.csv --trackers trackers.csv --sensors trackers.db --write-back    from flight to flight";

/// Levels in the table on the terminal.
const LEVELS: usize = 15;

#[derive(Args, Debug)]
pub struct WindsArguments {
    /// Table of readings of a balloon, CSV
    #[arg(value_name = "FLIGHT")]
    pub flight: PathBuf,
    /// Table of trackers, CSV
    #[arg(long, value_name = "FILE")]
    pub trackers: PathBuf,
    /// Assume that each component of the wind at the balloon changes by this standard deviation within a minute [m/s]; without
    /// it fixes are independent of each other
    #[arg(long, value_name = "M_PER_S", value_parser = change)]
    pub wind_change: Option<f64>,
    /// Start from what this database of sensors knows of the offsets at the time of the flight
    #[arg(long, value_name = "FILE")]
    pub sensors: Option<PathBuf>,
    /// Write the offsets that are found into the database, which is created if it does not exist
    #[arg(long, requires = "sensors")]
    pub write_back: bool,
    /// Write positions and winds of all fixes into this file, CSV
    #[arg(long, short, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write a page with figures into this file
    #[arg(long, value_name = "FILE")]
    pub page: Option<PathBuf>,
    /// Replace these files, if they are those of an earlier computation
    #[arg(long, short = 'f')]
    pub overwrite: bool,
    /// Number of threads [default: RAYON_NUM_THREADS, or one for each core]; results do not depend on it
    #[arg(long, short = 'j', value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MOST_THREADS))]
    pub threads: Option<u64>,
    /// Print all as JSON
    #[arg(long)]
    pub json: bool,
}

fn change(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| *number > 0.0 && *number <= 1e3);
    number.ok_or_else(|| "it must be a number above 0, at most 1000".into())
}

/// Finds positions, winds and offsets, prints them and writes the files.
pub fn run(arguments: &WindsArguments) -> Result<ExitCode, Report> {
    let files = [&arguments.out, &arguments.page];
    if let Some(path) = files.into_iter().flatten().find(|path| !arguments.overwrite && path.exists()) {
        return Err(out_file::exists(path));
    }
    let motion = arguments.wind_change.map(|sigma_change_m_per_s| Motion { sigma_change_m_per_s });
    let request = Request {
        flight: arguments.flight.clone(),
        trackers: arguments.trackers.clone(),
        sensors: arguments.sensors.clone(),
        writes_back: arguments.write_back,
        motion,
    };
    let found = workers(arguments.threads)?.install(|| Sounding::find(&request));
    let sounding = found.map_err(|error| miette!("{error}"))?;
    sounding.warnings.iter().for_each(|warning| warn(warning));
    if let Some(out) = &arguments.out {
        let table = sounding.fixes().csv();
        let header = table.lines().next().unwrap_or_default();
        let is_own = |path: &Path| out_file::is_table(path, header);
        out_file::write(out, arguments.overwrite, table.as_bytes(), "tables of isobar winds", is_own)?;
    }
    if let Some(page) = &arguments.page {
        let html = sounding.html(motion).map_err(|error| miette!("{error}"))?;
        out_file::write(page, arguments.overwrite, html.as_bytes(), "pages of isobar", out_file::is_page)?;
    }
    let stored = match &arguments.sensors {
        Some(database) if arguments.write_back => Some(sounding.store(database)?),
        _ => None,
    };
    if arguments.json {
        print_json(&document(&sounding))?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut text = format!("{}\n\nOffsets, to be subtracted from readings\n", sounding.sentences(motion).join("\n"));
    text +=
        &format!("{}\n\nWind\n{}\n", sounding.offsets().terminal(width()), sounding.levels(LEVELS).terminal(width()));
    for path in files.into_iter().flatten() {
        text += &format!("\nFile: {}", shown_path(path));
    }
    if let (Some(new), Some(database)) = (stored, &arguments.sensors) {
        text += &format!("\nSensors: {} in {}", counted(new, "new record"), shown_path(database));
    }
    print(&text)?;
    Ok(ExitCode::SUCCESS)
}

fn document(sounding: &Sounding) -> Value {
    let flight = &sounding.flight;
    let offsets = sounding.calibration.parameters.iter().enumerate().map(|(i, parameter)| {
        json!({
            "offset": parameter.name,
            "unit": parameter.unit,
            "before": sounding.prior_mean.as_ref().map(|mean| mean[i]),
            "sigma_before": sounding.prior_mean.as_ref().map(|_| parameter.sigma_prior),
            "value": sounding.offset(i),
            "sigma": sounding.sigma_offset(i),
        })
    });
    let fixes = (0..sounding.readings.fixes.len()).map(|k| {
        json!({
            "time": utc(sounding.time(k)),
            "position_m": flight.positions_m[k],
            "sigma_position_m": flight.sigma_positions_m[k],
            "wind_m_per_s": flight.winds_m_per_s.get(k),
            "sigma_wind_m_per_s": flight.sigma_winds_m_per_s.get(k),
        })
    });
    json!({
        "winds": sounding.name,
        "version": crate::VERSION,
        "chi2_per_degree": flight.chi2_per_degree,
        "linearisations": flight.iterations,
        "offsets": offsets.collect::<Vec<_>>(),
        "fixes": fixes.collect::<Vec<_>>(),
    })
}
