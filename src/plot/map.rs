//! A field as a map with colour bar, contour lines, coast and marks, as SVG: the cells are a small picture within it.

use super::PlotError;
use super::colors::{Scale, hex};
use super::contours;
use super::curves::{Curve, CurvePlot, Dash};
use super::number;
use super::range::tick_step;
use super::svg::{Anchor, Canvas, INK, Svg};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use png::{BitDepth, ColorType, Compression, Encoder};
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
    /// What is said of it when it is pointed at; may be empty.
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
    /// The values between which there is one colour, from below; nothing for colours without steps.
    pub steps: Vec<f32>,
    /// Values at which lines are drawn.
    pub contours: Vec<f64>,
    /// Coastlines, points (x, y) \[m\].
    pub coast: Vec<Vec<[f64; 2]>>,
    /// Observing platforms.
    pub marks: Vec<Mark>,
}

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
    /// If the field's size is not what it says it is, or the picture cannot be encoded.
    pub fn svg(&self, id: &str) -> Result<Svg, PlotError> {
        let failure = |reason: String| PlotError { figure: self.title.clone(), reason };
        let ([nx, ny], [low, high]) = (self.size, self.range);
        let has_cells = self.field.len() == nx * ny || self.field.is_empty();
        if nx * ny == 0 || !has_cells || low >= high || !(high - low).is_finite() {
            return Err(failure(format!("{} values in {nx} × {ny} cells from {low} to {high}", self.field.len())));
        }
        let frame = Frame::new(self.extent_m);
        let mut canvas = Canvas::new([WIDTH, frame.top + frame.height + BOTTOM]);
        let unit = if self.unit.is_empty() { String::new() } else { format!(" [{}]", self.unit) };
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
                for segment in contours::segments(&self.field, nx, *level as f32) {
                    let [a, b] = segment.map(|[x, y]| {
                        let [x, y] = [f64::from(x) / nx as f64, f64::from(y) / ny as f64];
                        frame.place([x * self.extent_m[0], y * self.extent_m[1]])
                    });
                    // A string takes everything.
                    let _ = write!(path, "M{:.1} {:.1}L{:.1} {:.1}", a[0], a[1], b[0], b[1]);
                }
            }
            let color = if self.scale == Scale::Difference { "#5a5a5a" } else { "#f4f4f4" };
            if !path.is_empty() {
                canvas.raw(&format!("<path d=\"{path}\" stroke=\"{color}\" stroke-width=\"0.7\"/>"));
            }
        }
        let mut path = String::new();
        for line in &self.coast {
            for (number, point) in line.iter().enumerate() {
                let [x, y] = frame.place(*point);
                let _ = write!(path, "{}{x:.1} {y:.1}", if number == 0 { 'M' } else { 'L' });
            }
        }
        if !path.is_empty() {
            // Light under dark: it is seen on any field, and on paper.
            let (under, over) = ("#ffffff", "#303030");
            let under = if self.field.is_empty() {
                String::new()
            } else {
                format!("<path d=\"{path}\" stroke=\"{under}e0\" stroke-width=\"2\"/>\n")
            };
            let over = if self.field.is_empty() { INK } else { over };
            canvas.raw(&format!("{under}<path d=\"{path}\" stroke=\"{over}\" stroke-width=\"0.8\"/>"));
        }
    }

    /// Coloured dots with a dark rim, so that they are seen on any field; all others as one path.
    fn dots(&self, canvas: &mut Canvas, frame: &Frame) {
        let mut path = String::new();
        for mark in &self.marks {
            let place = frame.place([mark.x_m, mark.y_m]);
            match mark.color {
                None => {
                    // A string takes everything.
                    let _ = write!(path, "M{:.1} {:.1}h0", place[0], place[1]);
                }
                Some(color) => {
                    canvas.dot(place, 3.2, "#202020", "");
                    canvas.dot(place, 2.5, &hex(color), &mark.title);
                }
            }
        }
        if !path.is_empty() {
            canvas
                .raw(&format!("<path d=\"{path}\" stroke=\"#202020\" stroke-width=\"2.2\" stroke-linecap=\"round\"/>"));
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
        let unit = if self.unit.is_empty() { String::new() } else { format!("[{}]", self.unit) };
        let curve = Curve { name: None, color: None, dash: Dash::Solid, points, band: None };
        let mut plot = CurvePlot::new(self.title.clone(), "x [km]".into(), unit, vec![curve]);
        plot.from_zero = self.scale == Scale::Spread;
        plot.reference = (self.scale == Scale::Difference).then_some(0.0);
        Some(plot)
    }

    fn axes(&self, canvas: &mut Canvas, frame: &Frame) {
        let [width_km, height_km] = self.extent_m.map(|metres| metres / 1e3);
        let step = tick_step(width_km.max(height_km));
        let (bottom, ticks) = (frame.top + frame.height, |length: f64| {
            (0..).map(move |number| number as f64 * step).take_while(move |&at| at <= length * 1.0001)
        });
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
        for (number, color) in inner.iter().enumerate() {
            let y = top + height - (number + 1) as f64 * part;
            // A little more, that nothing shows between them.
            canvas.rectangle([x, y], [width, part + if number > 0 { 0.5 } else { 0.0 }], &hex(*color));
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
            let first = (low / step).ceil() as i64;
            let values = (first..).map(|number| number as f64 * step).take_while(|&value| value <= high * 1.0001);
            for value in values.take(20) {
                label(top + height * (1.0 - (value - low) / (high - low)), value as f32);
            }
        }
    }
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

/// Symmetric steps for differences of all sizes from `least` to `most`: ±1, ±2, ±5, ±10, … times a power of ten, three to six on
/// either side. Where more would be needed the largest are left out.
pub fn symmetric_steps(least: f32, most: f32) -> Vec<f32> {
    let most = if most.is_finite() && most > 0.0 { most } else { 1.0 };
    let round = |number: i32| [1.0, 2.0, 5.0][number.rem_euclid(3) as usize] * 10f32.powi(number.div_euclid(3));
    let last = (-60..60).rev().find(|&number| round(number) < most).unwrap_or(0);
    let wanted = (-60..60).rev().find(|&number| round(number) <= least.max(0.0)).unwrap_or(last);
    let first = wanted.min(last - 2);
    let above: Vec<f32> = (first..=last.min(first + 5)).map(round).collect();
    above.iter().rev().map(|value| -value).chain(above.iter().copied()).collect()
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
            steps: Vec::new(),
            contours: contour_levels([0.0, 20.0]),
            coast: vec![vec![[0.0, 0.0], [2e5, 1e5]]],
            marks: vec![Mark { x_m: 1e5, y_m: 1e5, color: Some([255, 255, 255]), title: "<b>".into() }],
        }
    }

    fn attribute(svg: &str, element: &str, name: &str) -> f64 {
        let own = &svg[svg.find(&format!("<{element} ")).unwrap()..];
        own.split(&format!(" {name}=\"")).nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
    }

    /// The picture of the cells: colours by rows, from the top.
    fn picture(svg: &str) -> (Vec<[u8; 3]>, u32) {
        let data = svg.split("base64,").nth(1).unwrap().split('"').next().unwrap();
        let mut decoder = png::Decoder::new(std::io::Cursor::new(STANDARD.decode(data).unwrap()));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let frame = reader.next_frame(&mut bytes).unwrap();
        (bytes.as_chunks::<3>().0.to_vec(), frame.width)
    }

    #[test]
    fn a_map_is_always_the_same_and_escapes_its_texts() {
        let svg = map().svg("a").unwrap();
        assert_eq!(svg, map().svg("a").unwrap());
        assert!(svg.file.contains("&lt;h&gt; [m]") && svg.file.contains("<title>&lt;b&gt;</title>"));
        assert!(svg.page.contains("var(--ink)") && svg.page.contains("id=\"a-0\""));
        let other = FieldMap { range: [0.0, 40.0], ..map() }.svg("a").unwrap();
        assert_ne!(picture(&svg.file).0, picture(&other.file).0, "colours must follow the range");
    }

    #[test]
    fn a_square_is_a_square_and_the_south_is_below() {
        for extent_m in [[4e5, 3e5], [3e5, 9e5], [1e6, 1e6], [8e6, 2e6]] {
            let svg = FieldMap { extent_m, ..map() }.svg("a").unwrap().file;
            let [width, height] = ["width", "height"].map(|name| attribute(&svg, "image", name));
            assert!(
                (width / height / (extent_m[0] / extent_m[1]) - 1.0).abs() < 0.01,
                "{extent_m:?}: {width} {height}"
            );
            assert!(attribute(&svg, "image", "x") + width < WIDTH - 50.0);
        }
        let (colors, width) = picture(&map().svg("a").unwrap().file);
        assert_eq!((width, colors.len()), (4, 12));
        assert_eq!(colors[8], Scale::State.color(0.0), "the first value is in the south-west");
    }

    #[test]
    fn steps_have_one_colour_each_and_the_sign_is_seen() {
        let steps = symmetric_steps(2.0, 130.0);
        assert_eq!(steps, [-100.0, -50.0, -20.0, -10.0, -5.0, -2.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]);
        assert_eq!(symmetric_steps(2.0, 15.0), [-10.0, -5.0, -2.0, 2.0, 5.0, 10.0]);
        for (least, most) in [(0.0, 1.0), (5.0, 5.0), (f32::NAN, f32::INFINITY), (1e-9, 1e9), (0.0, 0.0)] {
            let steps = symmetric_steps(least, most);
            assert!(steps.len() >= 6 && steps.len() <= 12 && steps.is_sorted(), "{least} {most}: {steps:?}");
        }
        let field = [-200.0, -30.0, 1.0, -1.0, 30.0, 200.0].to_vec();
        let map = FieldMap { field, size: [6, 1], steps, scale: Scale::Difference, range: [-100.0, 100.0], ..map() };
        let svg = map.svg("a").unwrap().file;
        let (colors, _) = picture(&svg);
        assert_eq!(colors[2], colors[3], "what is small is white");
        assert!(colors[0][2] > colors[0][0] && colors[5][0] > colors[5][2] && colors[1] != colors[0]);
        assert!([">-100<", ">20<", ">100<"].iter().all(|label| svg.contains(label)), "{svg}");
    }

    #[test]
    fn the_values_are_in_the_figure_of_a_small_field() {
        let svg = map().svg("a").unwrap().file;
        let part = |name: &str| svg.split(&format!("{name}=\"")).nth(1).unwrap().split('"').next().unwrap().to_string();
        let step: f64 = part("data-step").parse().unwrap();
        let bytes = STANDARD.decode(part("data-values")).unwrap();
        let values: Vec<f64> =
            bytes.as_chunks::<2>().0.iter().map(|pair| step * f64::from(i16::from_le_bytes(*pair))).collect();
        assert!(
            values.iter().zip(&map().field).all(|(found, value)| (found - f64::from(*value)).abs() < step),
            "{values:?}"
        );
    }

    #[test]
    fn odd_fields_are_drawn_or_refused() {
        let mut one = FieldMap { field: vec![f32::NAN], size: [1, 1], ..map() };
        assert!(one.svg("a").is_ok());
        one.field = vec![f32::INFINITY];
        assert!(one.svg("a").is_ok());
        assert!(FieldMap { field: Vec::new(), ..map() }.svg("a").unwrap().file.contains("<circle"));
        assert!(FieldMap { size: [4, 4], ..map() }.svg("a").unwrap_err().to_string().contains("4 × 4"));
        assert!(FieldMap { range: [1.0, 1.0], ..map() }.svg("a").is_err());
        assert!(FieldMap { range: [f32::NAN, 1.0], ..map() }.svg("a").is_err());
    }

    #[test]
    fn a_ring_is_a_line() {
        let plot = FieldMap { size: [12, 1], ..map() }.line().unwrap();
        assert_eq!((plot.curves[0].points.len(), plot.curves[0].points[11][1]), (12, 11.0));
        assert!(map().line().is_none());
    }

    #[test]
    fn contour_levels_are_round_and_within_the_range() {
        assert_eq!(contour_levels([-20.0, 20.0]), [-20.0, -16.0, -12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0, 16.0]);
        assert!(contour_levels([f32::NAN, 1.0]).is_empty());
    }
}
