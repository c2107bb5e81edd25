//! All biases of a method in one figure, and its stations in the colour of theirs, cycle by cycle.

use super::maps::{LABEL, Pictures};
use super::names::{Result, set_time};
use super::series::{MOST_PARAMETERS, shown_parameters};
use crate::event::{RunInfo, StationInfo};
use crate::output::bias_errors;
use crate::output::history::{Cycle, MethodCycle};
use crate::plot::colors;
use crate::tables::{NONE, figure};
use re_sdk_types::archetypes::{LineStrips2D, Points2D};

/// Where the frame of the figure is logged, which all methods share.
pub const FRAME: &str = "bias_figure";

/// The figure reaches from −RANGE to RANGE standard deviations of the prior.
const RANGE: f32 = 2.5;

/// Width of the place of names, as a part of the width of the figure.
const NAMES: f32 = 0.36;

/// The fewest rows for which the figure has room.
const FEWEST_ROWS: usize = 12;

/// Colours of the figure's lines, of an estimate within two claimed standard deviations of the truth, and of one beyond.
const GRID: [u8; 3] = [70, 70, 70];
const ZERO: [u8; 3] = [160, 160, 160];
const WITHIN: [u8; 3] = [86, 180, 233];
const BEYOND: [u8; 3] = [230, 120, 60];

/// What the figure shows: x and y, from and to.
pub fn bounds(info: &RunInfo) -> [[f64; 2]; 2] {
    let (rows, width) = (info.calibration.len().min(MOST_PARAMETERS) as f32, width(info));
    [[-(0.5 + NAMES) * width, 0.52 * width], [-0.5, rows + 1.2]].map(|range| range.map(f64::from))
}

/// Width of the figure, where a row has the height 1.
fn width(info: &RunInfo) -> f32 {
    info.calibration.len().clamp(FEWEST_ROWS, MOST_PARAMETERS) as f32
}

/// A bias in words: estimate, claimed standard deviation and truth.
fn label(info: &RunInfo, (cycle, own): (&Cycle, &MethodCycle), number: usize) -> String {
    let parameter = &info.calibration.parameters[number];
    let sigma = own.bias_spread(number).map_or_else(String::new, |sigma| format!(" ± {}", figure(sigma)));
    let truth = cycle.true_bias(number).map_or_else(String::new, |truth| format!(", truth {}", figure(truth)));
    let estimate = own.bias(number).map_or(NONE.into(), figure);
    format!("{}: {estimate}{sigma} {}{truth}", parameter.name, parameter.unit)
}

impl Pictures<'_> {
    /// The frame of the figure: names, axis, and lines at whole standard deviations.
    pub fn log_bias_frame(&self) -> Result {
        let numbers = shown_parameters(&self.info.calibration);
        if numbers.is_empty() {
            return Ok(());
        }
        let (width, rows) = (width(self.info), numbers.len() as f32);
        let ticks = [-2.0_f32, -1.0, 0.0, 1.0, 2.0];
        let lines = ticks.map(|tick| [[self.x(tick), 0.0], [self.x(tick), rows]]);
        let colors = ticks.map(|tick| if tick == 0.0 { ZERO } else { GRID });
        let lines = LineStrips2D::new(lines).with_colors(colors).with_radii([0.002 * width]);
        self.recording.log_static(format!("{FRAME}/lines"), &lines.with_draw_order(1.0))?;
        let of_ticks = ticks.map(|tick| ([self.x(tick), rows + 0.2], format!("{tick} σ")));
        // The viewer writes a label below its place, by a length of the screen and not of the figure.
        let above = 0.017 * width;
        let name = |(row, &number): (usize, &usize)| {
            let place = [-(0.5 + 0.5 * NAMES) * width, row as f32 + 0.5 - above];
            (place, self.info.calibration.parameters[number].name.clone())
        };
        let all = of_ticks.into_iter().chain(numbers.iter().enumerate().map(name));
        let (places, labels): (Vec<[f32; 2]>, Vec<String>) = all.unzip();
        let labels = Points2D::new(places).with_labels(labels).with_show_labels(true).with_radii([0.0]);
        Ok(self.recording.log_static(format!("{FRAME}/names"), &labels.with_colors([LABEL]))?)
    }

    /// All pictures of biases from a cycle on.
    pub fn log_biases(&self, since: usize) -> Result {
        for method in (0..self.info.methods.len()).filter(|&method| self.info.methods[method].estimates_biases) {
            for (cycle, own) in self.history.of_method(method).filter(|(cycle, _)| cycle.number >= since) {
                set_time(self.recording, cycle.number, cycle.time);
                self.log_figure(method, (cycle, own))?;
                for variable in 0..self.info.layout.variables.len() {
                    self.log_stations(method, (cycle, own), variable)?;
                }
            }
        }
        self.recording.reset_time();
        Ok(())
    }

    fn log_figure(&self, method: usize, own: (&Cycle, &MethodCycle)) -> Result {
        let has_truth = self.history.knows_biases();
        let (mut places, mut intervals, mut colors, mut labels) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (row, number) in shown_parameters(&self.info.calibration).into_iter().enumerate() {
            let prior = self.info.calibration.prior_covariance(number, number).sqrt();
            let Some(error) = bias_errors::error(self.history, own, number).filter(|_| prior > 0.0) else { continue };
            let (y, sigma) = (row as f32 + 0.5, own.1.bias_spread(number).unwrap_or(0.0));
            let x = |value: f64| self.x((value / prior) as f32);
            places.push([x(error), y]);
            intervals.push([[x(error - 2.0 * sigma), y], [x(error + 2.0 * sigma), y]]);
            let is_beyond = has_truth && sigma > 0.0 && error.abs() > 2.0 * sigma;
            colors.push(if is_beyond { BEYOND } else { WITHIN });
            labels.push(label(self.info, own, number));
        }
        let strips = LineStrips2D::new(intervals).with_colors(colors.clone()).with_radii([0.07]);
        self.recording.log(self.names.map(method, "biases/intervals"), &strips.with_draw_order(20.0))?;
        let dots = Points2D::new(places).with_radii([0.22]).with_colors(colors).with_labels(labels);
        let dots = dots.with_show_labels(false).with_draw_order(21.0);
        Ok(self.recording.log(self.names.map(method, "biases/estimates"), &dots)?)
    }

    /// Where a value in standard deviations of the prior is; at the end of the figure if it is beyond.
    fn x(&self, value: f32) -> f32 {
        let value = if value.is_finite() { value.clamp(-RANGE, RANGE) } else { RANGE };
        0.5 * width(self.info) * value / RANGE
    }

    fn log_stations(&self, method: usize, own: (&Cycle, &MethodCycle), variable: usize) -> Result {
        let stations = bias_errors::of_stations(self.history, own, variable);
        if stations.is_empty() {
            return Ok(());
        }
        let limit = self.ranges.variables[variable].station_bias;
        let places: Vec<[f32; 2]> = stations.iter().map(|it| self.frame.place(it.0.x_m, it.0.y_m)).collect();
        let colors: Vec<_> = stations.iter().map(|it| colors::difference(it.2, limit)).collect();
        let words = |(station, number, _): &(&StationInfo, usize, f32)| {
            format!("{} ({})\n{}", station.name, station.group, label(self.info, own, *number))
        };
        let labels: Vec<String> = stations.iter().map(words).collect();
        let path = self.names.stations(method, self.info.layout.variables[variable].name);
        let mark = self.frame.mark();
        let rim = Points2D::new(places.clone()).with_radii([0.6 * mark]).with_colors([[0u8, 0, 0]]);
        self.recording.log(format!("{path}/rim"), &rim.with_draw_order(30.0))?;
        let dots = Points2D::new(places).with_radii([0.5 * mark]).with_colors(colors).with_labels(labels);
        Ok(self.recording.log(format!("{path}/dots"), &dots.with_show_labels(false).with_draw_order(31.0))?)
    }
}
