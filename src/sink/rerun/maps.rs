//! Maps: fields, wind arrows and observing platforms, cycle by cycle.

use super::frame::Frame;
use super::history::{Estimates, History, Platform};
use super::ranges::Ranges;
use super::recording::{Names, Result};
use crate::event::RunInfo;
use crate::plot::colors::{self, Scale};
use crate::plot::number;
use ::rerun::components::Colormap;
use ::rerun::{Arrows2D, ChannelDatatype, DepthImage, Image, LineStrips2D, Points2D, RecordingStream};
use isobar_model::Time;

/// What all maps of a run have in common.
pub struct Maps<'a> {
    pub recording: &'a RecordingStream,
    pub info: &'a RunInfo,
    pub history: &'a History,
    pub ranges: &'a Ranges,
    pub names: &'a Names,
    pub frame: Frame<'a>,
}

impl Maps<'_> {
    /// All maps of the run from a cycle on.
    pub fn log_since(&self, since: usize) -> Result {
        for (&cycle, truth) in self.history.truth.range(since..) {
            self.set_time(cycle, truth.time);
            self.log_state("truth/field", &truth.field)?;
            self.log_wind("truth/wind", truth.wind.as_ref())?;
        }
        for (method, cycles) in self.history.methods.iter().enumerate() {
            for (&cycle, estimates) in cycles.range(since..) {
                self.set_time(cycle, estimates.time);
                self.log_method(method, cycle, estimates)?;
            }
        }
        self.recording.reset_time();
        Ok(())
    }

    fn set_time(&self, cycle: usize, time: Time) {
        self.recording.set_time_sequence("cycle", cycle as i64);
        self.recording.set_timestamp_secs_since_epoch("valid_time", time.seconds() as f64);
    }

    /// The colour bars, which stay as they are.
    pub fn log_color_bars(&self) -> Result {
        let Ranges { state, difference, spread, .. } = self.ranges;
        let unit = self.info.layout.variables[self.history.mapped].unit;
        for (name, scale, range) in [
            ("state", Scale::State, *state),
            ("difference", Scale::Difference, [-difference, *difference]),
            ("spread", Scale::Spread, [0.0, *spread]),
        ] {
            let bar = self.frame.color_bar(scale, range, unit);
            let strips =
                LineStrips2D::new(bar.segments).with_colors(bar.colors).with_radii([bar.radius]).with_draw_order(20.0);
            self.recording.log_static(format!("color_bars/{name}/band"), &strips)?;
            let labels = Points2D::new(bar.labels_at).with_labels(bar.labels).with_show_labels(true);
            let labels = labels.with_radii([0.0]).with_colors([[220u8, 220, 220]]);
            self.recording.log_static(format!("color_bars/{name}/labels"), &labels.with_draw_order(40.0))?;
        }
        Ok(())
    }

    fn log_method(&self, method: usize, cycle: usize, estimates: &Estimates) -> Result {
        let Estimates { background, analysis, wind, spread, departures, .. } = estimates;
        let path = |part: &str| self.names.map(method, part);
        self.log_state(&path("background"), background)?;
        self.log_state(&path("analysis/field"), analysis)?;
        self.log_wind(&path("analysis/wind"), wind.as_ref())?;
        self.log_difference(&path("increment"), analysis, background)?;
        if let Some(truth) = self.history.truth.get(&cycle) {
            self.log_difference(&path("analysis_error"), analysis, &truth.field)?;
            self.log_difference(&path("background_error"), background, &truth.field)?;
        }
        if let Some(spread) = spread {
            self.log_scalar(&path("spread"), spread, Colormap::Inferno, [0.0, self.ranges.spread])?;
        }
        if let Some(platforms) = self.history.observed.get(&cycle) {
            self.log_platforms(&path("observations"), platforms, departures)?;
        }
        Ok(())
    }

    fn log_state(&self, path: &str, field: &[f32]) -> Result {
        self.log_scalar(path, field, Colormap::Viridis, self.ranges.state)
    }

    /// A field whose colours the viewer makes, so that it can also tell the values.
    fn log_scalar(&self, path: &str, field: &[f32], colormap: Colormap, [low, high]: [f32; 2]) -> Result {
        let bytes: Vec<u8> = self.frame.pixels(field).flat_map(|value| value.to_le_bytes()).collect();
        let image = DepthImage::from_data_type_and_bytes(bytes, self.frame.resolution(), ChannelDatatype::F32);
        let image = image.with_colormap(colormap).with_depth_range([f64::from(low), f64::from(high)]);
        Ok(self.recording.log(path, &image)?)
    }

    /// A difference of fields in our own colours: the viewer has none with white at zero.
    fn log_difference(&self, path: &str, field: &[f32], other: &[f32]) -> Result {
        let difference: Vec<f32> = field.iter().zip(other).map(|(a, b)| a - b).collect();
        let pixels = self.frame.pixels(&difference);
        let bytes: Vec<u8> = pixels.flat_map(|&value| colors::difference(value, self.ranges.difference)).collect();
        Ok(self.recording.log(path, &Image::from_rgb24(bytes, self.frame.resolution()))?)
    }

    fn log_wind(&self, path: &str, wind: Option<&[Vec<f32>; 2]>) -> Result {
        let Some(wind) = wind else { return Ok(()) };
        let [origins, vectors] = self.frame.arrows(wind, self.ranges.wind);
        let arrows = Arrows2D::from_vectors(vectors).with_origins(origins).with_radii([0.09 * self.frame.mark()]);
        Ok(self.recording.log(path, &arrows.with_colors([[255u8, 255, 255, 210]]).with_draw_order(30.0))?)
    }

    /// Dots in the colour of the mapped variable's background departure, grey where it was not observed.
    fn log_platforms(&self, path: &str, platforms: &[Platform], departures: &[f32]) -> Result {
        let places: Vec<[f32; 2]> = platforms.iter().map(|it| self.frame.place(it.x_m, it.y_m)).collect();
        let colors = platforms.iter().map(|platform| {
            let mapped = platform.reports.iter().find(|report| report.1 == self.history.mapped);
            let departure = mapped.and_then(|report| departures.get(report.0));
            departure.map_or([128, 128, 128], |&departure| colors::difference(departure, self.ranges.difference))
        });
        let labels = platforms.iter().map(|platform| self.label(platform, departures));
        let rim = Points2D::new(places.clone()).with_radii([0.85 * self.frame.mark()]).with_colors([[0u8, 0, 0]]);
        self.recording.log(format!("{path}/rim"), &rim.with_draw_order(30.0))?;
        let dots = Points2D::new(places).with_radii([0.68 * self.frame.mark()]).with_colors(colors).with_labels(labels);
        Ok(self.recording.log(format!("{path}/dots"), &dots.with_show_labels(false).with_draw_order(31.0))?)
    }

    fn label(&self, platform: &Platform, departures: &[f32]) -> String {
        let mut label = platform.name.clone();
        for &(at, variable, value) in &platform.reports {
            let variable = &self.info.layout.variables[variable];
            let departure = departures.get(at).map_or_else(|| "?".into(), |&departure| number(departure));
            let (name, unit, value) = (variable.name, variable.unit, number(value));
            label += &format!("\n{name} = {value} {unit}, departure {departure}");
        }
        label
    }
}
