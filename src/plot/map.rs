//! A field as a map with colour bar, contour lines and marks, as PNG.

use super::PlotError;
use super::colors::{Scale, hex};
use super::number;
use super::palette::indexed;
use kuva::plot::colormap::ColorMap;
use kuva::plot::{ContourPlot, Heatmap, ScatterPlot};
use kuva::prelude::{Layout, Plot, Theme};
use kuva::render::layout::TickFormat;
use std::sync::Arc;

/// Pixels of the picture for each of its units: sharp on a fine display.
const PIXELS: f32 = 1.2;

/// Width of the map's frame, and what the labels around it take.
const FRAME: f64 = 330.0;
const AROUND: [f64; 2] = [105.0, 88.0];

/// Steps of the colour scales: more than the eye tells apart, and few enough for a small picture.
const STEPS: f32 = 64.0;

/// An observing platform on a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// x \[m\].
    pub x_m: f64,
    /// y \[m\].
    pub y_m: f64,
    /// Its colour; `None`: a small dark dot.
    pub color: Option<[u8; 3]>,
}

/// A map of a field.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldMap {
    /// Its title.
    pub title: String,
    /// Unit of the field; empty if it has none.
    pub unit: String,
    /// Values `[y, x]`, from the south.
    pub field: Vec<f32>,
    /// Columns and rows.
    pub size: [usize; 2],
    /// Width and height \[m\].
    pub extent_m: [f64; 2],
    /// The colours.
    pub scale: Scale,
    /// The values at the ends of the colours.
    pub range: [f32; 2],
    /// Values at which lines are drawn.
    pub contours: Vec<f64>,
    /// Observing platforms.
    pub marks: Vec<Mark>,
}

impl FieldMap {
    /// Draws the map.
    ///
    /// # Errors
    /// If the field's size is not what it says it is, or the picture cannot be encoded.
    pub fn png(&self) -> Result<Vec<u8>, PlotError> {
        let failure = |reason: String| PlotError { figure: self.title.clone(), reason };
        let [nx, ny] = self.size;
        let [low, high] = self.range.map(f64::from);
        if nx * ny == 0 || self.field.len() != nx * ny || low >= high || !(high - low).is_finite() {
            return Err(failure(format!("{} values in {nx} × {ny} cells from {low} to {high}", self.field.len())));
        }
        let [width, height] = self.extent_m.map(|metres| metres / 1000.0);
        let rows = self.rows();
        let mut plots = Vec::new();
        if self.scale != Scale::Parts {
            plots.push(self.color_bar([width, height]));
        }
        plots.push(self.cells(&rows, [width, height]));
        if nx > 1 && ny > 1 {
            plots.extend(self.lines(rows, [width, height]));
        }
        plots.extend(self.dots());
        let layout = self.layout(&plots, [width, height]);
        kuva::render_to_png(plots, layout, PIXELS).and_then(indexed).map_err(failure)
    }

    fn layout(&self, plots: &[Plot], [width, height]: [f64; 2]) -> Layout {
        let aspect = (height / width).clamp(0.25, 2.0);
        let theme = Theme { show_grid: false, ..Theme::light() };
        let unit = if self.unit.is_empty() { String::new() } else { format!(" [{}]", self.unit) };
        let mut layout = Layout::auto_from_plots(plots)
            .with_width(FRAME + AROUND[0])
            .with_height(FRAME * aspect + AROUND[1])
            .with_theme(theme)
            .with_title(format!("{}{unit}", self.title))
            // Rotated labels look smudged in pictures of this crate.
            .with_x_label("x and y [km]")
            .with_x_axis_min(0.0)
            .with_x_axis_max(width)
            .with_y_axis_min(0.0)
            .with_y_axis_max(height)
            .with_title_size(14)
            .with_label_size(12)
            .with_tick_size(11)
            .with_body_size(11)
            .with_colorbar_tick_format(TickFormat::Custom(Arc::new(number::<f64>)));
        layout.show_colorbar = self.scale != Scale::Parts;
        layout
    }

    /// Rows of values within the range; what is no number is at its low end.
    fn rows(&self) -> Vec<Vec<f64>> {
        let [low, high] = self.range;
        let value = |&value: &f32| f64::from(if value.is_nan() { low } else { value.clamp(low, high) });
        self.field.chunks(self.size[0]).map(|row| row.iter().map(value).collect()).collect()
    }

    /// The crate's colour bars span the values of a plot and not a given range: this plot has nothing but the two ends of
    /// the range, and is hidden behind the cells.
    fn color_bar(&self, [width, height]: [f64; 2]) -> Plot {
        let [low, high] = self.range.map(f64::from);
        let scale = self.scale;
        let colors = ColorMap::Custom(Arc::new(move |part| color(scale, part as f32)));
        let grid = vec![vec![low, high], vec![low, high]];
        let (xs, ys) = (vec![0.4 * width, 0.6 * width], vec![0.4 * height, 0.6 * height]);
        let bar = ContourPlot::new().with_grid(grid, xs, ys).with_filled().with_n_levels(2).with_colormap(colors);
        bar.into()
    }

    fn cells(&self, rows: &[Vec<f64>], [width, height]: [f64; 2]) -> Plot {
        // The crate spreads the colours over the values that there are.
        let values = || rows.iter().flatten().copied();
        let (from, to) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        let [low, high] = self.range.map(f64::from);
        let scale = self.scale;
        let color = move |part: f64| {
            let value = from + part * (to - from);
            self::color(scale, ((value - low) / (high - low)) as f32)
        };
        let heatmap = Heatmap::new().with_data(rows.iter().cloned()).with_color_map(ColorMap::Custom(Arc::new(color)));
        heatmap.with_x_range(0.0, width).with_y_range(0.0, height).with_cell_size(1.0).into()
    }

    fn lines(&self, rows: Vec<Vec<f64>>, [width, height]: [f64; 2]) -> Option<Plot> {
        let [low, high] = self.range.map(f64::from);
        let levels: Vec<f64> = self.contours.iter().copied().filter(|level| (low..high).contains(level)).collect();
        if levels.is_empty() {
            return None;
        }
        let centres = |count: usize, length: f64| {
            (0..count).map(|number| (number as f64 + 0.5) * length / count as f64).collect::<Vec<_>>()
        };
        let (xs, ys) = (centres(self.size[0], width), centres(self.size[1], height));
        let color = if self.scale == Scale::Difference { "#5a5a5a" } else { "#f4f4f4" };
        let plot = ContourPlot::new().with_grid(rows, xs, ys).with_levels(&levels);
        Some(plot.with_line_color(color).with_line_width(0.7).into())
    }

    /// Each mark with a dark rim if it has a colour, so that it is seen on any field.
    fn dots(&self) -> Vec<Plot> {
        if self.marks.is_empty() {
            return Vec::new();
        }
        let place = |mark: &Mark| (mark.x_m / 1000.0, mark.y_m / 1000.0);
        let points: Vec<(f64, f64)> = self.marks.iter().map(place).collect();
        let colored = self.marks.iter().filter_map(|mark| Some((place(mark), hex(mark.color?))));
        let (places, colors): (Vec<(f64, f64)>, Vec<String>) = colored.unzip();
        let size = if places.is_empty() { 0.9 } else { 2.8 };
        let mut plots = vec![ScatterPlot::new().with_data(points).with_color("#202020").with_size(size).into()];
        if !places.is_empty() {
            plots.push(ScatterPlot::new().with_data(places).with_size(2.2).with_colors(colors).into());
        }
        plots
    }
}

/// The colour at a position on a scale, in steps.
fn color(scale: Scale, position: f32) -> String {
    let position = if scale == Scale::Parts { position } else { (position * STEPS).round() / STEPS };
    hex(scale.color(position))
}

/// About ten round values between the ends of a range, at which contour lines are drawn.
pub fn contour_levels([low, high]: [f32; 2]) -> Vec<f64> {
    let step = f64::from(super::range::round_up(Some((high - low) / 11.0)));
    let (low, high) = (f64::from(low), f64::from(high));
    if !(step > 0.0 && (high - low) / step < 100.0) {
        return Vec::new();
    }
    let first = (low / step).ceil() as i64;
    (first..).map(|number| number as f64 * step).take_while(|&level| level < high).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map() -> FieldMap {
        FieldMap {
            title: "<h>".into(),
            unit: "m".into(),
            field: (0..12).map(|value| value as f32).collect(),
            size: [4, 3],
            extent_m: [4e5, 3e5],
            scale: Scale::State,
            range: [0.0, 20.0],
            contours: contour_levels([0.0, 20.0]),
            marks: vec![Mark { x_m: 1e5, y_m: 1e5, color: Some([255, 255, 255]) }],
        }
    }

    #[test]
    fn a_map_is_a_picture_and_always_the_same() {
        let png = map().png().unwrap();
        assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
        assert_eq!(png[25], 3, "not a picture with a palette");
        assert_eq!(png, map().png().unwrap());
        let mut other = map();
        other.range = [0.0, 40.0];
        assert_ne!(png, other.png().unwrap(), "colours must follow the range");
    }

    #[test]
    fn odd_fields_are_drawn_or_refused() {
        let mut one = FieldMap { field: vec![f32::NAN], size: [1, 1], ..map() };
        assert!(one.png().is_ok());
        one.field = vec![f32::INFINITY];
        assert!(one.png().is_ok());
        assert!(FieldMap { size: [4, 4], ..map() }.png().unwrap_err().to_string().contains("4 × 4"));
        assert!(FieldMap { range: [1.0, 1.0], ..map() }.png().is_err());
        assert!(FieldMap { range: [f32::NAN, 1.0], ..map() }.png().is_err());
    }

    #[test]
    fn contour_levels_are_round_and_within_the_range() {
        assert_eq!(contour_levels([-20.0, 20.0]), [-20.0, -16.0, -12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0, 16.0]);
        assert!(contour_levels([f32::NAN, 1.0]).is_empty());
    }
}
