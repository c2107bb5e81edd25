//! Curves and bands over a common axis, as SVG.

use super::colors::hex;
use super::svg::{GRID, INK, PAPER, Svg};
use crate::text::printable;
use kuva::plot::legend::{LegendEntry, LegendPosition, LegendShape};
use kuva::plot::{BandPlot, LinePlot, ScatterPlot};
use kuva::prelude::{Layout, Plot, Theme};
use kuva::render::annotations::{ReferenceLine, ShadedRegion};

/// Height of a figure with one row of names \[px\], and of each further row.
const HEIGHT: f64 = 300.0;
const ROW: f64 = 16.5;

/// The axis of y is logarithmic if the medians of two curves are further apart than by this factor: one method without
/// observations would press the curves of all others together at the bottom.
const LOGARITHMIC_FROM: f64 = 8.0;

/// The smallest value on a logarithmic axis.
const LEAST_LOGARITHMIC: f64 = 1e-9;

/// How a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dash {
    /// As a line.
    Solid,
    /// As a broken line.
    Dashed,
    /// As a fine broken line.
    Dotted,
    /// As points.
    Points,
}

/// One curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Its name in the legend; without one it has no place there.
    pub name: Option<String>,
    /// Its colour; `None`: that of text.
    pub color: Option<[u8; 3]>,
    /// How it is drawn.
    pub dash: Dash,
    /// Its points; those that are not finite are left out.
    pub points: Vec<[f64; 2]>,
    /// A band from lower to upper values around it, one pair for each point.
    pub band: Option<Vec<[f64; 2]>>,
}

impl Curve {
    /// A solid curve in a colour, with a name.
    pub fn new(name: &str, color: [u8; 3], points: Vec<[f64; 2]>) -> Self {
        Self { name: Some(name.into()), color: Some(color), dash: Dash::Solid, points, band: None }
    }

    /// A broken curve in the colour of text, with a name.
    pub fn reference(name: &str, points: Vec<[f64; 2]>) -> Self {
        Self { name: Some(name.into()), color: None, dash: Dash::Dashed, points, band: None }
    }

    /// The same, drawn otherwise and without a place in the legend.
    pub fn unnamed(self, dash: Dash) -> Self {
        Self { name: None, dash, ..self }
    }

    /// The same with a band.
    pub fn with_band(self, band: Vec<[f64; 2]>) -> Self {
        Self { band: Some(band), ..self }
    }

    /// Points whose numbers, the band's included, are all finite.
    fn finite(&self) -> (Vec<[f64; 2]>, Option<Vec<[f64; 2]>>) {
        let finite = |pair: &[f64; 2]| pair.iter().all(|value| value.is_finite());
        match &self.band {
            None => (self.points.iter().copied().filter(finite).collect(), None),
            Some(band) => {
                let both = self.points.iter().zip(band).filter(|(point, band)| finite(point) && finite(band));
                let (points, band) = both.map(|(point, band)| (*point, *band)).unzip();
                (points, Some(band))
            }
        }
    }
}

/// A figure of curves.
#[derive(Clone, Debug, PartialEq)]
pub struct CurvePlot {
    /// Its title.
    pub title: String,
    /// What x is, with its unit.
    pub x_label: String,
    /// What y is, with its unit.
    pub y_label: String,
    /// The curves; the first is drawn first.
    pub curves: Vec<Curve>,
    /// A value of y that is marked by a line across.
    pub reference: Option<f64>,
    /// Whether y begins at zero, or is logarithmic if curves are far apart and positive.
    pub from_zero: bool,
    /// The largest y to be shown; `None`: all.
    pub highest: Option<f64>,
    /// Whether the names of curves are shown.
    pub legend: bool,
    /// The part of the x axis that counts, if not all of it does: it is shaded.
    pub counts: Option<[f64; 2]>,
}

impl CurvePlot {
    /// Curves with their names, all of them, from zero on.
    pub fn new(title: String, x_label: String, y_label: String, curves: Vec<Curve>) -> Self {
        Self {
            title,
            x_label,
            y_label,
            curves,
            reference: None,
            from_zero: true,
            highest: None,
            legend: true,
            counts: None,
        }
    }

    /// Draws the figure. `id` is a word that no other figure of the page has. Characters that XML cannot hold or a browser
    /// would obey are written as escapes.
    pub fn svg(&self, id: &str) -> Svg {
        self.clone().with_texts(printable).draw(id)
    }

    /// The same with other texts.
    fn with_texts(mut self, change: impl Fn(&str) -> String) -> Self {
        let names = self.curves.iter_mut().filter_map(|curve| curve.name.as_mut());
        let texts = [&mut self.title, &mut self.x_label, &mut self.y_label].into_iter().chain(names);
        texts.for_each(|text| *text = change(text));
        self
    }

    fn draw(&self, id: &str) -> Svg {
        let [_, [bottom, top]] = self.ranges();
        let plots: Vec<Plot> = self.curves.iter().flat_map(|curve| draw(curve, [bottom, top])).collect();
        let layout = self.layout(&plots);
        let file = kuva::render_to_svg(plots, layout);
        // Identifiers of the plotting crate are numbered through the life of the process.
        let file = unique_identifiers(&file, id);
        Svg::new(file, &self.title)
    }

    fn layout(&self, plots: &[Plot]) -> Layout {
        let [[left, right], [bottom, top]] = self.ranges();
        let theme = Theme {
            background: PAPER.into(),
            axis_color: INK.into(),
            grid_color: GRID.into(),
            tick_color: INK.into(),
            text_color: INK.into(),
            legend_bg: PAPER.into(),
            legend_border: "none".into(),
            font_family: Some("system-ui, sans-serif".into()),
            ..Theme::light()
        };
        let mut layout = Layout::auto_from_plots(plots);
        // For want of plots.
        (layout.x_range, layout.y_range) = ((left, right), (bottom, top));
        let mut layout = layout
            .with_width(440.0)
            .with_height(HEIGHT + ROW * (self.legend_rows() - 1) as f64)
            .with_theme(theme)
            .with_title(&*self.title)
            .with_x_label(&*self.x_label)
            .with_y_label(&*self.y_label)
            .with_x_axis_min(left)
            .with_x_axis_max(right)
            .with_title_size(14)
            .with_label_size(12)
            .with_tick_size(11)
            .with_body_size(11)
            .with_legend_position(LegendPosition::OutsideBottomColumns)
            .with_legend_box(false);
        if self.is_logarithmic() {
            layout = layout.with_log_y().with_y_label(format!("{}, logarithmic", self.y_label));
        } else if self.from_zero {
            layout = layout.with_y_axis_min(0.0);
        }
        let entries = self.legend_entries();
        if entries.is_empty() {
            layout.show_legend = false;
        } else {
            layout = layout.with_legend_entries(entries);
        }
        if let Some([from, to]) = self.counts.map(|counts| counts.map(|end| end.clamp(left, right))) {
            layout = layout.with_shaded_region(ShadedRegion::vertical(from, to).with_color(GRID).with_opacity(0.35));
        }
        if let Some(value) = self.reference {
            let line = ReferenceLine::horizontal(value).with_color(INK).with_stroke_width(1.0).with_dasharray("2 3");
            layout = layout.with_reference_line(line);
        }
        layout
    }

    /// The names of curves. The plotting crate would collect them by itself, but keeps room for one row only.
    fn legend_entries(&self) -> Vec<LegendEntry> {
        let named = self.curves.iter().filter(|curve| self.legend && !curve.finite().0.is_empty());
        let entry = |curve: &Curve| {
            Some(LegendEntry {
                label: curve.name.clone()?,
                color: curve.color.map_or_else(|| INK.to_string(), hex),
                shape: if curve.dash == Dash::Points { LegendShape::Circle } else { LegendShape::Line },
                dasharray: match curve.dash {
                    Dash::Dashed => Some("4 3".into()),
                    Dash::Dotted => Some("2 3".into()),
                    Dash::Solid | Dash::Points => None,
                },
            })
        };
        named.filter_map(entry).collect()
    }

    /// About how many rows they need; the room for the curves is what the height leaves.
    fn legend_rows(&self) -> usize {
        let entries = self.legend_entries();
        let longest = entries.iter().map(|entry| entry.label.chars().count()).max().unwrap_or(0);
        let columns = (370.0 / (38.0 + 7.0 * longest as f64)).max(1.0) as usize;
        entries.len().div_ceil(columns).max(1)
    }

    /// Whether y is on a logarithmic axis.
    fn is_logarithmic(&self) -> bool {
        let mut medians = Vec::new();
        for curve in &self.curves {
            let mut values: Vec<f64> = curve.finite().0.into_iter().map(|point| point[1]).collect();
            if values.iter().any(|&value| value < LEAST_LOGARITHMIC) {
                return false;
            }
            values.sort_by(f64::total_cmp);
            medians.extend(values.get(values.len() / 2));
        }
        let [least, most] = [f64::min, f64::max].map(|of| medians.iter().copied().reduce(of));
        self.from_zero && least.zip(most).is_some_and(|(least, most)| most > LOGARITHMIC_FROM * least)
    }

    /// x and y, from and to.
    fn ranges(&self) -> [[f64; 2]; 2] {
        let is_logarithmic = self.is_logarithmic();
        let mut ranges = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        let mut take = |axis: usize, value: f64| {
            ranges[axis] = [ranges[axis][0].min(value), ranges[axis][1].max(value)];
        };
        for curve in &self.curves {
            let (points, band) = curve.finite();
            for [x, y] in points {
                take(0, x);
                take(1, y);
            }
            // The lower edge of a band may reach zero, where such an axis has no place for it.
            for value in band.into_iter().flatten().flatten().filter(|_| !is_logarithmic) {
                take(1, value);
            }
        }
        if let Some(value) = self.reference {
            take(1, value);
        }
        if self.from_zero && !is_logarithmic {
            take(1, 0.0);
        }
        let [x, mut y] = ranges;
        if let Some(highest) = self.highest.filter(|&highest| highest > y[0]) {
            y[1] = y[1].min(highest);
        }
        [x, y].map(|[low, high]| match high - low {
            span if span.is_finite() && span > 1e-12 * high.abs().max(1e-300) => [low, high],
            _ if low.is_finite() => [low - 0.5 - 1e-3 * low.abs(), high + 0.5 + 1e-3 * high.abs()],
            _ => [0.0, 1.0],
        })
    }
}

fn draw(curve: &Curve, [bottom, top]: [f64; 2]) -> Vec<Plot> {
    let color = curve.color.map_or_else(|| INK.to_string(), hex);
    let (points, band) = curve.finite();
    let mut plots: Vec<Plot> = Vec::new();
    if let Some(band) = band {
        let part = |side: usize| band.iter().map(move |pair| pair[side].clamp(bottom, top));
        let xs = points.iter().map(|point| point[0]);
        plots.push(BandPlot::new(xs, part(0), part(1)).with_color(&*color).with_opacity(0.18).into());
    }
    let points: Vec<(f64, f64)> = points.into_iter().map(|[x, y]| (x, y)).collect();
    if points.is_empty() {
        return plots;
    }
    if curve.dash == Dash::Points {
        let mut scatter = ScatterPlot::new().with_data(points).with_color(color).with_size(2.6);
        if let Some(name) = &curve.name {
            scatter = scatter.with_legend(&**name);
        }
        plots.push(scatter.into());
        return plots;
    }
    let mut line = LinePlot::new().with_data(points).with_color(color);
    line = match curve.dash {
        Dash::Dashed => line.with_dashed().with_stroke_width(1.4),
        Dash::Dotted => line.with_dotted().with_stroke_width(1.2),
        Dash::Solid | Dash::Points => line.with_stroke_width(1.8),
    };
    if let Some(name) = &curve.name {
        line = line.with_legend(&**name);
    }
    plots.push(line.into());
    plots
}

/// The figure with identifiers that begin with `id`, numbered from 0.
fn unique_identifiers(svg: &str, id: &str) -> String {
    const PREFIX: &str = "kuva-clip-";
    let mut parts = svg.split(PREFIX);
    let mut text = parts.next().unwrap_or_default().to_string();
    let mut known: Vec<&str> = Vec::new();
    for part in parts {
        let end = part.find(|character: char| !character.is_ascii_digit()).unwrap_or(part.len());
        let (number, rest) = part.split_at(end);
        let place = known.iter().position(|it| *it == number).unwrap_or_else(|| {
            known.push(number);
            known.len() - 1
        });
        text += &format!("{id}-{place}{rest}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(points: Vec<[f64; 2]>) -> CurvePlot {
        let curves = vec![Curve::new("<script>", [1, 2, 3], points)];
        CurvePlot::new("error of <h> & \"u\"".into(), "time [d]".into(), "error [m]".into(), curves)
    }

    #[test]
    fn a_figure_is_the_same_whenever_it_is_drawn_and_escapes_its_texts() {
        let plot = plot(vec![[0.0, 1.0], [1.0, 2.0]]);
        let first = plot.svg("a");
        assert_eq!(first, plot.svg("a"));
        assert!(!first.file.contains("kuva-clip") && first.file.contains("#010203"));
        for svg in [&first.file, &first.page] {
            assert!(svg.contains("&lt;script&gt;") && !svg.contains("<script"), "{svg}");
            assert!(svg.contains("time [d]") && svg.contains("error [m]") && svg.contains("&lt;h&gt; &amp;"));
        }
        assert!(first.page.contains("var(--ink)") && !first.page.contains(INK), "{}", first.page);
        assert_ne!(first.page, plot.svg("b").page, "identifiers must differ within a page");
    }

    /// However many curves there are, and however long their names: all names are within the figure, and so are the curves.
    #[test]
    fn every_name_has_its_place() {
        for (count, length) in [(1, 4), (2, 4), (3, 40), (9, 12), (14, 14), (40, 6)] {
            let mut plot = plot(vec![[0.0, 1.0], [1.0, 2.0]]);
            let name = |number: usize| format!("{}{number:02}", "n".repeat(length - 2));
            let curve = |number: usize| Curve::new(&name(number), [1, 2, 3], vec![[0.0, 1.0], [1.0, number as f64]]);
            plot.curves = (0..count).map(curve).collect();
            let svg = plot.svg("a").file;
            let number = |text: &str, key: &str| -> f64 {
                let value = text.split(&format!("{key}=\"")).nth(1).unwrap().split('"').next().unwrap();
                value.parse().unwrap()
            };
            let height = number(&svg, " height");
            for name in (0..count).map(name) {
                let end = svg.find(&format!(">{name}</text>")).unwrap_or_else(|| panic!("{name} is missing"));
                let own = &svg[svg[..end].rfind("<text").unwrap()..];
                let (x, y) = (number(own, " x"), number(own, " y"));
                assert!(y < height && x < 440.0, "{count} of {length}: {name} at {x}, {y} of {height}");
            }
            let clip = &svg[svg.find("<clipPath").unwrap()..];
            assert!(number(clip, " height") > 150.0, "{count} of {length}: {}", number(clip, " height"));
        }
    }

    #[test]
    fn curves_far_apart_have_a_logarithmic_axis() {
        let figure = |high: f64, from_zero: bool| {
            let mut plot = plot(vec![[0.0, 1.0], [1.0, 2.0], [2.0, 1.5]]);
            plot.curves.push(Curve::new("free", [3, 2, 1], vec![[0.0, high], [1.0, high]]));
            plot.from_zero = from_zero;
            plot
        };
        assert!(figure(50.0, true).is_logarithmic() && !figure(5.0, true).is_logarithmic());
        assert!(!figure(50.0, false).is_logarithmic());
        let svg = figure(50.0, true).svg("a").file;
        assert!(svg.contains("error [m], logarithmic") && !svg.contains("NaN"), "{svg}");
        // Nothing is logarithmic of zero.
        let mut zero = figure(50.0, true);
        zero.curves[0].points[1][1] = 0.0;
        assert!(!zero.is_logarithmic());
        // A band that reaches zero ends at the axis.
        let mut banded = figure(50.0, true);
        banded.curves[0].band = Some(vec![[-1.0, 3.0]; 3]);
        let [_, [low, high]] = banded.ranges();
        assert_eq!((low, high), (1.0, 50.0));
        assert!(!banded.svg("a").file.contains("NaN"));
    }

    /// Half of the axis counts: the shade is half as wide as the axis, and goes to its end.
    #[test]
    fn what_counts_is_shaded() {
        let mut plot = plot(vec![[0.0, 1.0], [1.0, 2.0], [2.0, 1.5]]);
        assert!(!plot.svg("a").file.contains("pacity=\"0.35"));
        plot.counts = Some([1.0, 9.0]);
        let svg = plot.svg("a").file;
        let rectangle =
            svg.split("<rect").find(|part| part.contains("pacity=\"0.35")).unwrap_or_else(|| panic!("{svg}"));
        let number = |text: &str, key: &str| -> f64 {
            text.split(&format!("{key}=\"")).nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
        };
        let axis = number(&svg[svg.find("<clipPath").unwrap()..], " width");
        assert!((number(rectangle, " width") / axis - 0.5).abs() < 0.01, "{rectangle} of {axis}");
    }

    #[test]
    fn figures_without_points_or_extent_or_finite_numbers_can_be_drawn() {
        for points in [
            vec![],
            vec![[0.0, 0.0]],
            vec![[1.0, 5.0]; 3],
            vec![[0.0, f64::NAN], [1.0, f64::INFINITY], [2.0, 3.0]],
            vec![[0.0, 1e300], [1.0, -1e300]],
            vec![[0.0, 1e-300], [1.0, 2e-300]],
        ] {
            for from_zero in [true, false] {
                let mut plot = plot(points.clone());
                plot.from_zero = from_zero;
                plot.curves[0].band = Some(vec![[f64::NAN, 1.0]; points.len()]);
                let svg = plot.svg("a").file;
                assert!(svg.starts_with("<svg") && !svg.contains("NaN") && !svg.contains("inf"), "{points:?} {svg}");
            }
        }
    }
}
