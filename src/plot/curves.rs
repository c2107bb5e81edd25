//! Curves and bands over a common axis, as SVG.

use super::colors::hex;
use super::ends::{self, End};
use super::number;
use super::svg::{GRID, INK, PAPER, Svg};
use crate::text::printable;
use kuva::plot::legend::{LegendEntry, LegendPosition, LegendShape};
use kuva::plot::{BandPlot, LinePlot, ScatterPlot};
use kuva::prelude::{Layout, Plot, Theme, TickFormat};
use kuva::render::annotations::{ReferenceLine, ShadedRegion};
use kuva::render::layout::ComputedLayout;
use std::sync::Arc;

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
    /// Whether the names of curves are shown: at their ends, or where these are too close together below them.
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
        let (layout, names) = match self.ends().and_then(|ends| self.named_at_ends(&plots, ends)) {
            Some((layout, names)) => (layout, names),
            None => (self.with_legend(self.layout(&plots)), String::new()),
        };
        let file = kuva::render_to_svg(plots, layout).replacen("</svg>", &format!("{names}</svg>"), 1);
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
            .with_height(HEIGHT)
            .with_theme(theme)
            .with_title(&*self.title)
            .with_x_label(&*self.x_label)
            .with_y_label(&*self.y_label)
            .with_x_axis_min(left)
            .with_x_axis_max(right)
            .with_title_size(14)
            .with_label_size(12)
            .with_tick_size(11)
            .with_body_size(11);
        if self.is_logarithmic() {
            let format = TickFormat::Custom(Arc::new(number::<f64>));
            layout =
                layout.with_log_y().with_y_tick_format(format).with_y_label(format!("{}, logarithmic", self.y_label));
        } else if self.from_zero {
            layout = layout.with_y_axis_min(0.0);
        }
        layout.show_legend = false;
        if let Some([from, to]) = self.counts.map(|counts| counts.map(|end| end.clamp(left, right))) {
            layout = layout.with_shaded_region(ShadedRegion::vertical(from, to).with_color(GRID).with_opacity(0.35));
        }
        if let Some(value) = self.reference {
            let line = ReferenceLine::horizontal(value).with_color(INK).with_stroke_width(1.0).with_dasharray("2 3");
            layout = layout.with_reference_line(line);
        }
        layout
    }

    /// The names of curves below them.
    fn with_legend(&self, layout: Layout) -> Layout {
        let entries = self.legend_entries();
        if entries.is_empty() {
            return layout;
        }
        let mut layout = layout
            .with_height(HEIGHT + ROW * (self.legend_rows() - 1) as f64)
            .with_legend_position(LegendPosition::OutsideBottomColumns)
            .with_legend_box(false)
            .with_legend_entries(entries);
        layout.show_legend = true;
        layout
    }

    /// The curves that have names, if the names could stand at their ends: short ones, of lines that go to the right edge.
    fn ends(&self) -> Option<Vec<(&str, &Curve, [f64; 2])>> {
        let [[left, right], [bottom, top]] = self.ranges();
        let named = self.curves.iter().filter_map(|curve| Some((curve.name.as_deref()?, curve)));
        let end = |(name, curve)| {
            let [x, y] = *Curve::finite(curve).0.last()?;
            Some((name, curve, [x, y.clamp(bottom, top)]))
        };
        let all: Vec<(&str, &Curve, [f64; 2])> = named.filter_map(end).collect();
        let fits = |&(name, curve, [x, _]): &(&str, &Curve, [f64; 2])| {
            name.chars().count() <= ends::LONGEST && curve.dash != Dash::Points && x >= right - 0.04 * (right - left)
        };
        (self.legend && !all.is_empty() && all.iter().all(fits)).then_some(all)
    }

    /// The figure with names at the ends of curves; `None` where they would be too far from them.
    fn named_at_ends(&self, plots: &[Plot], all: Vec<(&str, &Curve, [f64; 2])>) -> Option<(Layout, String)> {
        let mut layout = self.layout(plots).with_height(HEIGHT - ends::LESS);
        layout.force_margin_right = Some(ends::room(all.iter().map(|it| it.0)));
        let frame = ComputedLayout::from_layout(&layout);
        let color = |curve: &Curve| curve.color.map_or_else(|| INK.to_string(), hex);
        let end = |&(name, curve, [x, y]): &(&str, &Curve, [f64; 2])| End {
            name: name.into(),
            color: color(curve),
            at: [frame.map_x(x), frame.map_y(y)],
        };
        let ends: Vec<End> = all.iter().map(end).collect();
        let within = [frame.margin_top, frame.height - frame.margin_bottom];
        let names = ends::names(&ends, frame.width - frame.margin_right, within)?;
        Some((layout, names))
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
        let [mut x, mut y] = ranges;
        if self.curves.iter().any(|curve| curve.dash == Dash::Points) && x[1] > x[0] {
            // Points at the edges are seen whole.
            let margin = 0.025 * (x[1] - x[0]);
            x = [x[0] - margin, x[1] + margin];
        }
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
#[path = "curves_tests.rs"]
mod tests;
