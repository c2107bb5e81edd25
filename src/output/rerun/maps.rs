//! Maps: fields, wind arrows and observing platforms, cycle by cycle.

use super::frame::Frame;
use super::names::{self, Names, Result, set_time};
use super::ranges::{Ranges, VariableRanges};
use crate::event::RunInfo;
use crate::output::history::{Cycle, Fields, History, MethodMaps};
use crate::output::structure::ShownStructure;
use crate::plot::colors::{self, Scale};
use crate::plot::number as number_text;
use indexmap::IndexMap;
use isobar_obs::Report;
use re_sdk::RecordingStream;
use re_sdk_types::archetypes::{Arrows2D, DepthImage, Image, LineStrips2D, Points2D};
use re_sdk_types::components::Colormap;
use re_sdk_types::datatypes::ChannelDatatype;

/// Colours of arrows on dark and on light maps, of labels, and of the coast.
const LIGHT: [u8; 4] = [255, 255, 255, 210];
const DARK: [u8; 4] = [40, 40, 40, 220];
pub const LABEL: [u8; 3] = [220, 220, 220];
const COAST: [u8; 4] = [110, 110, 110, 255];

/// All reports of a station or footprint in one cycle, with their numbers; at least one.
type Platform<'a> = Vec<(usize, &'a Report)>;

/// What all pictures of a run have in common.
pub struct Pictures<'a> {
    pub recording: &'a RecordingStream,
    pub info: &'a RunInfo,
    pub history: &'a History,
    pub ranges: &'a Ranges,
    pub names: &'a Names,
    pub frame: Frame<'a>,
}

impl Pictures<'_> {
    /// All maps of the run from a cycle on.
    pub fn log_maps(&self, since: usize) -> Result {
        for cycle in self.history.cycles.iter().filter(|cycle| cycle.number >= since) {
            let Some(truth) = &cycle.truth else { continue };
            set_time(self.recording, cycle.number, cycle.time);
            for (number, variable) in self.info.layout.variables.iter().enumerate() {
                self.log_state(&format!("truth/{}", variable.name), number, &truth[number])?;
            }
            self.log_wind("truth/wind", truth, self.ranges.wind, LIGHT)?;
        }
        for method in 0..self.info.methods.len() {
            for (cycle, maps) in self.history.maps(method).filter(|(cycle, _)| cycle.number >= since) {
                set_time(self.recording, cycle.number, cycle.time);
                let platforms = platforms(&cycle.reports);
                for variable in 0..self.info.layout.variables.len() {
                    self.log_variable(method, variable, cycle, maps)?;
                    self.log_platforms(method, variable, (cycle, &platforms), &maps.departures)?;
                }
                for (name, fields) in [("background_wind", &maps.background), ("wind", &maps.analysis)] {
                    self.log_wind(&self.names.map(method, name), fields, self.ranges.wind, LIGHT)?;
                }
                if let Some(structure) = &maps.structure {
                    self.log_structure(method, cycle.number, structure)?;
                }
            }
        }
        self.recording.reset_time();
        Ok(())
    }

    /// Coast and colour bars, which stay as they are.
    pub fn log_frames(&self, coast: Vec<Vec<[f64; 2]>>) -> Result {
        if !coast.is_empty() {
            let lines = coast.into_iter().map(|line| line.into_iter().map(|[x, y]| self.frame.place(x, y)));
            let strips = LineStrips2D::new(lines.map(Iterator::collect::<Vec<_>>)).with_colors([COAST]);
            self.recording
                .log_static(names::COAST, &strips.with_radii([0.05 * self.frame.mark()]).with_draw_order(10.0))?;
        }
        for (variable, ranges) in self.info.layout.variables.iter().zip(&self.ranges.variables) {
            let &VariableRanges { state, difference, spread, station_bias, .. } = ranges;
            for (name, scale, range) in [
                ("state", Scale::State, state),
                ("difference", Scale::Difference, [-difference, difference]),
                ("spread", Scale::Spread, [0.0, spread]),
                ("station_bias", Scale::Difference, [-station_bias, station_bias]),
            ] {
                let bar = self.frame.color_bar(scale, range, variable.unit);
                let path = format!("color_bars/{}/{name}", variable.name);
                let strips = LineStrips2D::new(bar.segments).with_colors(bar.colors).with_radii([bar.radius]);
                self.recording.log_static(format!("{path}/band"), &strips.with_draw_order(20.0))?;
                let labels = Points2D::new(bar.labels_at).with_labels(bar.labels).with_show_labels(true);
                let labels = labels.with_radii([0.0]).with_colors([LABEL]);
                self.recording.log_static(format!("{path}/labels"), &labels.with_draw_order(40.0))?;
            }
        }
        Ok(())
    }

    fn log_variable(&self, method: usize, number: usize, cycle: &Cycle, maps: &MethodMaps) -> Result {
        let name = self.info.layout.variables[number].name;
        let path = |part: &str| self.names.field(method, name, part);
        let (background, analysis) = (&maps.background[number], &maps.analysis[number]);
        let limit = self.ranges.variables[number].difference;
        self.log_state(&path("background"), number, background)?;
        self.log_state(&path("analysis"), number, analysis)?;
        self.log_difference(&path("increment"), &difference(analysis, background), limit)?;
        if let Some(truth) = &cycle.truth {
            let truth = &truth[number];
            self.log_difference(&path("analysis_error"), &difference(analysis, truth), limit)?;
            self.log_difference(&path("background_error"), &difference(background, truth), limit)?;
        }
        if let Some(smoothed) = &maps.smoothed {
            self.log_state(&path("smoothed"), number, &smoothed[number])?;
            if let Some(truth) = &cycle.truth {
                let error = difference(&smoothed[number], &truth[number]);
                self.log_difference(&path("smoothed_error"), &error, limit)?;
            }
        }
        if let Some(spread) = &maps.spread {
            let range = [0.0, self.ranges.variables[number].spread];
            self.log_scalar(&path("spread"), &spread[number], Colormap::Inferno, range)?;
        }
        Ok(())
    }

    fn log_structure(&self, method: usize, cycle: usize, structure: &ShownStructure) -> Result {
        let path = |part: &str| self.names.structure(method, part);
        let bytes: Vec<u8> = self.frame.pixels(&structure.parts).flat_map(|&number| colors::part(number)).collect();
        self.recording.log(path("parts/map"), &Image::from_rgb24(bytes, self.frame.resolution()))?;
        self.log_headline(&path("parts/headline"), &structure.summary)?;
        let mapped = self.history.mapped;
        let unit = self.info.layout.variables[mapped].unit;
        for (factor, number) in structure.factors.iter().zip(1..) {
            let path = |part: &str| path(&format!("factor_{number}/{part}"));
            // Each in its own range: the factors shrink as the method learns, and their shapes are what is to be seen.
            let (largest, fastest) = (factor.largest[mapped], self.frame.highest_speed(&factor.fields));
            self.log_difference(&path("map"), &factor.fields[mapped], largest.max(f32::MIN_POSITIVE))?;
            self.log_wind(&path("wind"), &factor.fields, fastest, DARK)?;
            let headline = format!("cycle {cycle}: ±{} {unit}, {}", number_text(largest), factor.summary);
            self.log_headline(&path("headline"), &headline)?;
        }
        Ok(())
    }

    fn log_headline(&self, path: &str, text: &str) -> Result {
        let label = Points2D::new([self.frame.headline()]).with_labels([text]).with_show_labels(true);
        Ok(self.recording.log(path, &label.with_radii([0.0]).with_colors([LABEL]).with_draw_order(40.0))?)
    }

    fn log_state(&self, path: &str, variable: usize, field: &[f32]) -> Result {
        self.log_scalar(path, field, Colormap::Viridis, self.ranges.variables[variable].state)
    }

    /// A field in colours of the viewer, which therefore also shows its numbers.
    fn log_scalar(&self, path: &str, field: &[f32], colormap: Colormap, [low, high]: [f32; 2]) -> Result {
        let bytes: Vec<u8> = self.frame.pixels(field).flat_map(|value| value.to_le_bytes()).collect();
        let image = DepthImage::from_data_type_and_bytes(bytes, self.frame.resolution(), ChannelDatatype::F32);
        let image = image.with_colormap(colormap).with_depth_range([f64::from(low), f64::from(high)]);
        Ok(self.recording.log(path, &image)?)
    }

    /// A difference in colours of isobar, since the viewer has no scale with white at zero. Under the colours are the numbers,
    /// which the viewer shows where the map is pointed at.
    fn log_difference(&self, path: &str, difference: &[f32], limit: f32) -> Result {
        self.log_scalar(&format!("{path}/values"), difference, Colormap::Grayscale, [-limit, limit])?;
        let bytes: Vec<u8> =
            self.frame.pixels(difference).flat_map(|&value| colors::difference(value, limit)).collect();
        // The viewer would make what is above another image half transparent.
        Ok(self.recording.log(path, &Image::from_rgb24(bytes, self.frame.resolution()).with_opacity(1.0))?)
    }

    /// Arrows of the wind; those of the speed `fastest` are as long as arrows are apart.
    fn log_wind(&self, path: &str, fields: &Fields, fastest: f32, color: [u8; 4]) -> Result {
        let Some(wind) = self.frame.wind(fields) else { return Ok(()) };
        let [origins, vectors] = self.frame.arrows(wind, fastest);
        let arrows = Arrows2D::from_vectors(vectors).with_origins(origins).with_radii([0.09 * self.frame.mark()]);
        Ok(self.recording.log(path, &arrows.with_colors([color]).with_draw_order(30.0))?)
    }

    /// Dots in the colour of the variable's background departure, the smaller the more there are. On the maps of the
    /// first variable platforms that did not report it are grey, on those of others they are left out.
    fn log_platforms(
        &self,
        method: usize,
        number: usize,
        (cycle, platforms): (&Cycle, &[Platform<'_>]),
        departures: &[f32],
    ) -> Result {
        let variable = &self.info.layout.variables[number];
        let path = self.names.field(method, variable.name, "observations");
        let limit = self.ranges.variables[number].difference;
        let at = |platform: &Platform<'_>| platform.iter().find(|(_, it)| it.variable == number).map(|(at, _)| *at);
        let all = number == self.history.mapped;
        let platforms: Vec<&Platform<'_>> = platforms.iter().filter(|it| all || at(it).is_some()).collect();
        let places: Vec<[f32; 2]> = platforms.iter().map(|it| self.frame.place(it[0].1.x_m, it[0].1.y_m)).collect();
        let colors = platforms.iter().map(|platform| {
            let departure = at(platform).and_then(|at| departures.get(at));
            departure.map_or([128, 128, 128], |&departure| colors::difference(departure, limit))
        });
        let labels = platforms.iter().map(|platform| self.label(platform, &cycle.values, departures));
        let mark = self.frame.mark() * (120.0 / places.len() as f32).sqrt().clamp(0.3, 1.0);
        let rim = Points2D::new(places.clone()).with_radii([0.85 * mark]).with_colors([[0u8, 0, 0]]);
        self.recording.log(format!("{path}/rim"), &rim.with_draw_order(30.0))?;
        let dots = Points2D::new(places).with_radii([0.68 * mark]).with_colors(colors).with_labels(labels);
        Ok(self.recording.log(format!("{path}/dots"), &dots.with_show_labels(false).with_draw_order(31.0))?)
    }

    fn label(&self, platform: &Platform<'_>, values: &[f64], departures: &[f32]) -> String {
        let Report { network, platform: name, .. } = platform[0].1;
        let mut label = format!("{network} {name}");
        for &(at, report) in platform {
            let variable = &self.info.layout.variables[report.variable];
            let departure = departures.get(at).map_or_else(|| "?".into(), |&departure| number_text(departure));
            let (name, unit, value) = (variable.name, variable.unit, number_text(values[at]));
            label += &format!("\n{name} = {value} {unit}, departure {departure}");
        }
        label
    }
}

/// The platforms that reported, in the order of their first reports.
fn platforms(reports: &[Report]) -> Vec<Platform<'_>> {
    let mut platforms: IndexMap<_, Platform<'_>> = IndexMap::new();
    for (number, report) in reports.iter().enumerate() {
        let place = (&report.network, &report.platform, report.x_m.to_bits(), report.y_m.to_bits());
        platforms.entry(place).or_default().push((number, report));
    }
    platforms.into_values().collect()
}

fn difference(field: &[f32], other: &[f32]) -> Vec<f32> {
    field.iter().zip(other).map(|(a, b)| a - b).collect()
}
