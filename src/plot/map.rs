//! A field as a map with colour bar, contour lines, coast and marks, as SVG: the cells are a small picture within it.

use super::PlotError;
use super::colors::{Scale, hex};
use super::contours;
use super::curves::{Curve, CurvePlot, Dash};
use super::graticule;
use super::number;
use super::range::{multiples, round_up, tick_step};
use super::svg::{self, Anchor, Canvas, INK, Svg};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use png::{BitDepth, ColorType, Compression, Encoder};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Width of a figure \[px\], and what labels and colour bar take beside the map and above and below it.
const WIDTH: f64 = 440.0;
const LEFT: f64 = 48.0;
const RIGHT: f64 = 66.0;
const TOP: f64 = 34.0;
const BOTTOM: f64 = 42.0;

/// The tallest map, and the lowest \[px\]: beyond, the map is narrower, or its cells are not squares.
const TALLEST: f64 = 460.0;
const LOWEST: f64 = 36.0;

/// Steps of colours that have no steps of their own: more than the eye tells apart.
const SMOOTH: usize = 64;

/// The most cells on a side for which contour lines are drawn, and for which the values are part of the figure.
const MOST_CELLS: usize = 128;

/// The largest whole number that stands for a value of the field.
const LARGEST: f64 = 32_000.0;

/// An observing platform on a map.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// x \[m\].
    pub x_m: f64,
    /// y \[m\].
    pub y_m: f64,
    /// Its colour; `None`: a small dark dot.
    pub color: Option<[u8; 3]>,
    /// The text that is shown when it is pointed at; may be empty.
    pub title: String,
}

/// A map of a field.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldMap {
    /// Its title.
    pub title: String,
    /// Unit of the field; empty if it has none.
    pub unit: String,
    /// Values `[y, x]`, from the south; nothing for a map with marks alone.
    pub field: Vec<f32>,
    /// Columns and rows.
    pub size: [usize; 2],
    /// Width and height \[m\].
    pub extent_m: [f64; 2],
    /// The colours.
    pub scale: Scale,
    /// The values at the ends of the colours.
    pub range: [f32; 2],
    /// The values at which the colour changes, from below; empty for colours without steps.
    pub steps: Vec<f32>,
    /// Values at which lines are drawn.
    pub contours: Vec<f64>,
    /// Parallels and meridians.
    pub graticule: Vec<graticule::Line>,
    /// Coastlines, points (x, y) \[m\].
    pub coast: Vec<Vec<[f64; 2]>>,
    /// Observing platforms.
    pub marks: Vec<Mark>,
}

/// The identifiers of coast and graticule, which are the same on all maps of a page: they are of one plane.
const COAST: &str = "coast";
const GRATICULE: &str = "graticule";

/// Where the map is in the figure.
struct Frame {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
    extent_m: [f64; 2],
}

impl Frame {
    /// As wide as there is room, with squares as squares.
    fn new(extent_m: [f64; 2]) -> Self {
        let room = WIDTH - LEFT - RIGHT;
        let aspect = extent_m[1] / extent_m[0];
        let height = (room * aspect).clamp(LOWEST, TALLEST);
        let width = (height / aspect).clamp(LOWEST, room);
        Self { left: LEFT + 0.5 * (room - width), top: TOP, width, height, extent_m }
    }

    /// The place of a point of the plane \[m\].
    fn place(&self, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
        let [x, y] = [x_m / self.extent_m[0], y_m / self.extent_m[1]];
        [self.left + x * self.width, self.top + (1.0 - y) * self.height]
    }
}

impl FieldMap {
    /// Draws the map. `id` is a word that no other figure of the page has.
    ///
    /// # Errors
    /// If the field does not have its `size`, if its range is empty, or if the picture cannot be encoded.
    pub fn svg(&self, id: &str) -> Result<Svg, PlotError> {
        let failure = |reason: String| PlotError { figure: self.title.clone(), reason };
        let ([nx, ny], [low, high]) = (self.size, self.range);
        let has_cells = self.field.len() == nx * ny || self.field.is_empty();
        if nx * ny == 0 || !has_cells || low >= high || !(high - low).is_finite() {
            return Err(failure(format!("{} values in {nx} × {ny} cells from {low} to {high}", self.field.len())));
        }
        let frame = Frame::new(self.extent_m);
        let mut canvas = Canvas::new([WIDTH, frame.top + frame.height + BOTTOM]);
        let unit = if self.unit.is_empty() { String::new() } else { format!(" [{}]", number::unit(&self.unit)) };
        let title = format!("{}{unit}", self.title);
        canvas.text([frame.left + 0.5 * frame.width, 20.0], 14.0, Anchor::Middle, INK, &title);
        if !self.field.is_empty() {
            canvas.raw(&self.cells(&frame).map_err(failure)?);
        }
        let Frame { left, top, width, height, .. } = frame;
        canvas.raw(&format!(
            "<clipPath id=\"{id}-0\"><rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\"/>\
             </clipPath>\n<g clip-path=\"url(#{id}-0)\" fill=\"none\">"
        ));
        self.lines(&mut canvas, &frame);
        canvas.raw("</g>");
        self.dots(&mut canvas, &frame);
        canvas.raw(&format!(
            "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"none\" stroke=\"{INK}\" \
             stroke-width=\"0.8\"/>"
        ));
        self.axes(&mut canvas, &frame);
        if self.scale != Scale::Parts {
            self.color_bar(&mut canvas, &frame);
        }
        Ok(canvas.finish(&self.title))
    }

    /// The thresholds between colours, from below; one less than there are colours.
    fn thresholds(&self) -> Vec<f32> {
        let [low, high] = self.range;
        match self.scale {
            Scale::Parts => (0..SMOOTH.min(high as usize)).map(|number| number as f32 + 0.5).collect(),
            _ if !self.steps.is_empty() => self.steps.clone(),
            _ => (1..SMOOTH).map(|step| low + (high - low) * step as f32 / SMOOTH as f32).collect(),
        }
    }

    /// The colour of each step, from below. Those of steps are spread evenly over the scale, whatever their widths.
    fn palette(&self) -> Vec<[u8; 3]> {
        let last = self.thresholds().len();
        (0..=last).map(|number| self.scale.color(number as f32 / last.max(1) as f32)).collect()
    }

    /// The cells as a small picture, which is spread over the map, with the values for whoever points at them.
    fn cells(&self, frame: &Frame) -> Result<String, String> {
        let ([nx, ny], thresholds) = (self.size, self.thresholds());
        let number = |value: &f32| thresholds.partition_point(|threshold| value > threshold) as u8;
        // Pictures begin at the top.
        let indices: Vec<u8> = self.field.chunks(nx).rev().flatten().map(number).collect();
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, nx as u32, ny as u32);
        encoder.set_color(ColorType::Indexed);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_compression(Compression::High);
        encoder.set_palette(self.palette().concat());
        let mut writer = encoder.write_header().map_err(|error| error.to_string())?;
        writer.write_image_data(&indices).map_err(|error| error.to_string())?;
        writer.finish().map_err(|error| error.to_string())?;
        let Frame { left, top, width, height, extent_m } = frame;
        Ok(format!(
            "<image x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
             preserveAspectRatio=\"none\" style=\"image-rendering:pixelated\" data-nx=\"{nx}\" data-km=\"{:.4} {:.4}\"{} \
             href=\"data:image/png;base64,{}\"/>",
            extent_m[0] / 1e3,
            extent_m[1] / 1e3,
            self.values(),
            STANDARD.encode(bytes)
        ))
    }

    /// The values as attributes: whole numbers of 16 bits, of a unit that is given; nothing of a field that is large or has no
    /// values.
    fn values(&self) -> String {
        let most =
            self.field.iter().filter(|value| value.is_finite()).fold(0.0_f32, |most, value| most.max(value.abs()));
        if self.scale == Scale::Parts || self.size.iter().any(|&cells| cells > MOST_CELLS) || most == 0.0 {
            return String::new();
        }
        let step = f64::from(most) / LARGEST;
        let whole = |value: &f32| if value.is_finite() { (f64::from(*value) / step).round() as i16 } else { i16::MIN };
        let bytes: Vec<u8> = self.field.iter().flat_map(|value| whole(value).to_le_bytes()).collect();
        format!(" data-step=\"{step:e}\" data-values=\"{}\"", STANDARD.encode(bytes))
    }

    /// Contour lines and coast.
    fn lines(&self, canvas: &mut Canvas, frame: &Frame) {
        let [nx, ny] = self.size;
        let [low, high] = self.range.map(f64::from);
        if nx > 1 && ny > 1 && nx.max(ny) <= MOST_CELLS && !self.field.is_empty() {
            let mut path = String::new();
            for level in self.contours.iter().filter(|&&level| (low..high).contains(&level)) {
                for line in contours::joined(&contours::segments(&self.field, nx, *level as f32)) {
                    path += &svg::path(line.into_iter().map(|[x, y]| {
                        let [x, y] = [f64::from(x) / nx as f64, f64::from(y) / ny as f64];
                        frame.place([x * self.extent_m[0], y * self.extent_m[1]])
                    }));
                }
            }
            let color = if self.scale == Scale::Difference { "#5a5a5a" } else { "#f4f4f4" };
            if !path.is_empty() {
                canvas.raw(&format!("<path d=\"{path}\" stroke=\"{color}\" stroke-width=\"0.7\"/>"));
            }
        }
        let of_line = |line: &Vec<[f64; 2]>| svg::path(line.iter().map(|point| frame.place(*point)));
        let path: String = self.coast.iter().map(of_line).collect();
        if !path.is_empty() {
            canvas.share(&format!("<path id=\"{COAST}\" d=\"{path}\"/>"));
            let has_field = !self.field.is_empty();
            if has_field {
                // Light under dark is seen on any field.
                canvas.raw(&format!("<use href=\"#{COAST}\" stroke=\"#ffffffe0\" stroke-width=\"2\"/>"));
            }
            let color = if has_field { "#303030" } else { INK };
            canvas.raw(&format!("<use href=\"#{COAST}\" stroke=\"{color}\" stroke-width=\"0.8\"/>"));
        }
        self.graticule(canvas, frame);
    }

    /// Parallels and meridians with their names.
    fn graticule(&self, canvas: &mut Canvas, frame: &Frame) {
        if self.graticule.is_empty() {
            return;
        }
        let parts = self.graticule.iter().flat_map(|line| &line.parts);
        let path: String = parts.map(|part| svg::path(part.iter().map(|point| frame.place(*point)))).collect();
        let label = |line: &graticule::Line| {
            let [x, y] = frame.place(line.at?);
            // Of those that come from the west above, of those from the south at the right.
            Some(format!("<text x=\"{:.1}\" y=\"{:.1}\">{}</text>", x + 2.5, y - 2.5, svg::escaped(&line.label)))
        };
        let labels: String = self.graticule.iter().filter_map(label).collect();
        canvas.share(&format!(
            "<g id=\"{GRATICULE}\"><path d=\"{path}\" fill=\"none\" stroke=\"#808080\" stroke-width=\"0.8\" \
             stroke-dasharray=\"2 2\"/><g font-size=\"8.5\" fill=\"#303030\" stroke=\"#ffffffb0\" stroke-width=\"2\" \
             paint-order=\"stroke\">{labels}</g></g>"
        ));
        canvas.raw(&format!("<use href=\"#{GRATICULE}\"/>"));
    }

    /// Coloured dots with a dark rim, so that they are seen on any field: those with a title one by one, those without in a
    /// path for each colour; all others as one path.
    fn dots(&self, canvas: &mut Canvas, frame: &Frame) {
        let mut path = String::new();
        let mut colors: BTreeMap<[u8; 3], String> = BTreeMap::new();
        let titled = self.marks.iter().any(|mark| mark.color.is_some() && !mark.title.is_empty());
        if titled {
            canvas.raw("<g stroke=\"#202020\" stroke-width=\"0.7\">");
        }
        for mark in &self.marks {
            let place = frame.place([mark.x_m, mark.y_m]);
            match mark.color {
                None => {
                    // A string takes everything.
                    let _ = write!(path, "M{:.1} {:.1}h0", place[0], place[1]);
                }
                Some(color) if mark.title.is_empty() => {
                    let _ = write!(colors.entry(color).or_default(), "M{:.1} {:.1}h0", place[0], place[1]);
                }
                Some(color) => {
                    canvas.dot(place, 2.8, &hex(color), &mark.title);
                }
            }
        }
        if titled {
            canvas.raw("</g>");
        }
        let mut points = |path: &str, color: &str, width: f64| {
            canvas.raw(&format!(
                "<path d=\"{path}\" stroke=\"{color}\" stroke-width=\"{width}\" stroke-linecap=\"round\"/>"
            ));
        };
        if !colors.is_empty() {
            points(&colors.values().map(String::as_str).collect::<String>(), "#202020", 6.3);
            colors.iter().for_each(|(color, path)| points(path, &hex(*color), 4.9));
        }
        if !path.is_empty() {
            points(&path, "#202020", 2.2);
        }
    }

    /// The field of a ring or a row of cells as a line; `None` for any other.
    pub fn line(&self) -> Option<CurvePlot> {
        let [nx, ny] = self.size;
        if ny != 1 || nx == 1 || self.field.len() != nx || self.scale == Scale::Parts {
            return None;
        }
        let x_km = |cell: usize| (cell as f64 + 0.5) * self.extent_m[0] / 1e3 / nx as f64;
        let points = self.field.iter().enumerate().map(|(cell, value)| [x_km(cell), f64::from(*value)]).collect();
        let unit = if self.unit.is_empty() { String::new() } else { format!("[{}]", number::unit(&self.unit)) };
        let curve = Curve { name: None, color: None, dash: Dash::Solid, points, band: None };
        let mut plot = CurvePlot::new(self.title.clone(), "x [km]".into(), unit, vec![curve]);
        plot.from_zero = self.scale == Scale::Spread;
        plot.reference = (self.scale == Scale::Difference).then_some(0.0);
        Some(plot)
    }

    fn axes(&self, canvas: &mut Canvas, frame: &Frame) {
        let [width_km, height_km] = self.extent_m.map(|metres| metres / 1e3);
        let step = tick_step(width_km.max(height_km));
        let (bottom, ticks) = (frame.top + frame.height, |length: f64| multiples(step, [0.0, length * 1.0001]));
        for at in ticks(width_km) {
            let [x, _] = frame.place([at * 1e3, 0.0]);
            canvas.line([[x, bottom], [x, bottom + 4.0]], INK, 0.8);
            canvas.text([x, bottom + 16.0], 11.0, Anchor::Middle, INK, &number(at));
        }
        for at in ticks(height_km) {
            let [_, y] = frame.place([0.0, at * 1e3]);
            canvas.line([[frame.left - 4.0, y], [frame.left, y]], INK, 0.8);
            canvas.text([frame.left - 7.0, y + 4.0], 11.0, Anchor::End, INK, &number(at));
        }
        let middle = frame.left + 0.5 * frame.width;
        canvas.text([middle, bottom + 32.0], 12.0, Anchor::Middle, INK, "x and y [km]");
    }

    /// The colours from below, with the thresholds between steps, and arrows at the ends, beyond which there are values too.
    fn color_bar(&self, canvas: &mut Canvas, frame: &Frame) {
        let colors = self.palette();
        let (x, width) = (frame.left + frame.width + 14.0, 13.0);
        let has_steps = !self.steps.is_empty();
        let end = if has_steps { 12.0 } else { 0.0 };
        let (top, height) = (frame.top + end, frame.height - 2.0 * end);
        let inner = if has_steps { &colors[1..colors.len() - 1] } else { &colors[..] };
        let part = height / inner.len().max(1) as f64;
        if has_steps {
            for (number, color) in inner.iter().enumerate() {
                let y = top + height - (number + 1) as f64 * part;
                // A little more, so that nothing shows between them.
                canvas.rectangle([x, y], [width, part + if number > 0 { 0.5 } else { 0.0 }], &hex(*color));
            }
        } else {
            canvas.share(&self.scale.gradient());
            canvas.rectangle([x, top], [width, height], &format!("url(#{})", self.scale.name()));
        }
        let mut label = |y: f64, value: f32| {
            canvas.text([x + width + 5.0, y + 4.0], 11.0, Anchor::Start, INK, &number(value));
        };
        if has_steps {
            let all = self.steps.iter().enumerate();
            all.for_each(|(number, value)| label(top + height - number as f64 * part, *value));
            let [first, last] = [colors[0], colors[colors.len() - 1]].map(hex);
            let (bottom, tip) = (top + height, x + 0.5 * width);
            canvas.raw(&format!(
                "<path d=\"M{x:.1} {top:.1}h{width}L{tip:.1} {:.1}z\" fill=\"{last}\"/>\n\
                 <path d=\"M{x:.1} {bottom:.1}h{width}L{tip:.1} {:.1}z\" fill=\"{first}\"/>",
                top - end,
                bottom + end
            ));
        } else {
            let [low, high] = self.range.map(f64::from);
            let step = tick_step(high - low);
            for value in multiples(step, [low, high * 1.0001]).take(20) {
                label(top + height * (1.0 - (value - low) / (high - low)), value as f32);
            }
        }
    }
}

/// About ten round values between the ends of a range, at which contour lines are drawn.
pub fn contour_levels([low, high]: [f32; 2]) -> Vec<f64> {
    let step = f64::from(round_up(Some((high - low) / 11.0)));
    let (low, high) = (f64::from(low), f64::from(high));
    if !(step > 0.0 && (high - low) / step < 100.0) {
        return Vec::new();
    }
    multiples(step, [low, high]).filter(|&level| level < high).collect()
}

/// Symmetric steps for differences of all sizes from `least` to `most`: ±1, ±2, ±5, ±10, … times a power of ten, three to six on
/// either side. Where more would be needed the largest are left out.
pub fn symmetric_steps(least: f32, most: f32) -> Vec<f32> {
    let most = if most.is_finite() && most > 0.0 { most } else { 1.0 };
    let round = |number: i32| [1.0, 2.0, 5.0][number.rem_euclid(3) as usize] * 10f32.powi(number.div_euclid(3));
    let last = (-60..60).rev().find(|&number| round(number) < most).unwrap_or(0);
    let wanted = (-60..60).rev().find(|&number| round(number) <= least.max(0.0)).unwrap_or(last);
    let first = wanted.min(last - 2);
    both_signs(&(first..=last.min(first + 5)).map(round).collect::<Vec<f32>>())
}

/// Steps above zero, from below, with their negatives.
pub fn both_signs(above: &[f32]) -> Vec<f32> {
    above.iter().rev().map(|value| -value).chain(above.iter().copied()).collect()
}

#[cfg(test)]
#[path = "map_tests.rs"]
mod tests;
