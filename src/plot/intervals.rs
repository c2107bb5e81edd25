//! Values with intervals, row by row: what is compared stands below each other, over one axis.

use super::colors::hex;
use super::number;
use super::range::{multiples, tick_step};
use super::svg::{Anchor, Canvas, GRID, INK, Svg};

/// A value in a row.
#[derive(Clone, Debug, PartialEq)]
pub struct Known {
    /// The number of its series.
    pub series: usize,
    /// The value.
    pub value: f64,
    /// Its interval, if one is known.
    pub interval: Option<[f64; 2]>,
    /// A value that was claimed for it, shown as a hollow dot.
    pub claimed: Option<f64>,
    /// The text that is shown when it is pointed at.
    pub title: String,
}

/// Values that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// What they are of.
    pub label: String,
    /// The values; those that are not finite are left out.
    pub values: Vec<Known>,
}

/// A figure of values with intervals.
#[derive(Clone, Debug, PartialEq)]
pub struct IntervalPlot {
    /// Its title.
    pub title: String,
    /// What the axis is, with its unit.
    pub label: String,
    /// Names and colours of the series; one without a name has no place in the legend.
    pub series: Vec<(Option<String>, [u8; 3])>,
    /// The rows, from above.
    pub rows: Vec<Row>,
    /// A value that is marked by a line across all rows, and is within the axis.
    pub reference: Option<f64>,
    /// Whether values may be on a logarithmic axis, if all are positive and far apart; otherwise the axis begins at zero if
    /// `from_zero`.
    pub from_zero: bool,
    /// Width \[px\].
    pub width: f64,
}

/// The axis is logarithmic if values are further apart than by this factor.
const LOGARITHMIC_FROM: f64 = 8.0;

/// Height of a row with one series \[px\], and of each further series.
const ROW: f64 = 20.0;
const SERIES: f64 = 7.0;

/// Room above and below the rows, of a row of the legend, and at the right \[px\].
const TOP: f64 = 34.0;
const BOTTOM: f64 = 42.0;
const LEGEND: f64 = 18.0;
const RIGHT: f64 = 18.0;

/// Pixels of a letter, and the most letters of a label.
const LETTER: f64 = 6.2;
const LONGEST: usize = 34;

/// Where values are.
struct Axis {
    from: f64,
    to: f64,
    is_logarithmic: bool,
    left: f64,
    width: f64,
}

impl Axis {
    fn place(&self, value: f64) -> f64 {
        let scaled = |value: f64| if self.is_logarithmic { value.max(1e-300).log10() } else { value };
        let [from, to, at] = [self.from, self.to, value].map(scaled);
        self.left + self.width * ((at - from) / (to - from)).clamp(0.0, 1.0)
    }

    /// Round values within.
    fn ticks(&self) -> Vec<f64> {
        if self.is_logarithmic {
            let steps = |power: i32| [1.0, 2.0, 5.0].map(|step| step * 10f64.powi(power));
            let first = self.from.log10().floor() as i32;
            let all = (first..first + 13).flat_map(steps);
            let within: Vec<f64> = all.filter(|tick| (self.from..=self.to).contains(tick)).collect();
            let every = within.len().div_ceil(8).max(1);
            return within.into_iter().step_by(every).collect();
        }
        multiples(tick_step(self.to - self.from), [self.from, self.to]).take(20).collect()
    }
}

impl IntervalPlot {
    /// Draws the figure; nothing in it has an identifier.
    pub fn svg(&self) -> Svg {
        let shown: Vec<&Row> =
            self.rows.iter().filter(|row| row.values.iter().any(|it| it.value.is_finite())).collect();
        let longest = shown.iter().map(|row| row.label.chars().count().min(LONGEST)).max().unwrap_or(0);
        let left = 14.0 + LETTER * longest as f64;
        let axis = self.axis(&shown, left);
        let most = shown.iter().map(|row| row.values.len()).max().unwrap_or(1);
        let row_height = ROW + SERIES * most.saturating_sub(1) as f64;
        let legend = self.legend_rows();
        let bottom = TOP + row_height * shown.len() as f64;
        let mut canvas = Canvas::new([self.width, bottom + BOTTOM + LEGEND * legend.len() as f64]);
        canvas.text([0.5 * self.width, 20.0], 14.0, Anchor::Middle, INK, &self.title);
        for tick in axis.ticks() {
            let x = axis.place(tick);
            canvas.line([[x, TOP], [x, bottom]], GRID, 0.8);
            canvas.text([x, bottom + 15.0], 11.0, Anchor::Middle, INK, &number(tick));
        }
        if let Some(reference) = self.reference {
            let x = axis.place(reference);
            canvas.line([[x, TOP], [x, bottom]], INK, 1.2);
        }
        for (row, top) in shown.iter().zip((0..).map(|number| TOP + f64::from(number) * row_height)) {
            let middle = top + 0.5 * row_height;
            let label: String = row.label.chars().take(LONGEST).collect();
            canvas.text([left - 8.0, middle + 4.0], 11.0, Anchor::End, INK, &label);
            let first = middle - 0.5 * SERIES * (row.values.len() as f64 - 1.0);
            for (known, y) in row.values.iter().zip((0..).map(|number| first + f64::from(number) * SERIES)) {
                self.draw(&mut canvas, &axis, known, y);
            }
        }
        canvas.line([[left, bottom], [left + axis.width, bottom]], INK, 0.8);
        let label = if axis.is_logarithmic { format!("{}, logarithmic", self.label) } else { self.label.clone() };
        canvas.text([left + 0.5 * axis.width, bottom + 32.0], 12.0, Anchor::Middle, INK, &label);
        for (row, y) in legend.iter().zip((0..).map(|number| bottom + BOTTOM + 8.0 + LEGEND * f64::from(number))) {
            for &(x, name, color) in row {
                canvas.dot([x, y - 4.0], 3.0, &hex(color), "");
                canvas.text([x + 8.0, y], 11.0, Anchor::Start, INK, name);
            }
        }
        canvas.finish(&self.title)
    }

    fn draw(&self, canvas: &mut Canvas, axis: &Axis, known: &Known, y: f64) {
        if !known.value.is_finite() {
            return;
        }
        let color = hex(self.series.get(known.series).map_or([128; 3], |series| series.1));
        if let Some(interval) = known.interval.filter(|interval| interval.iter().all(|end| end.is_finite())) {
            let [low, high] = interval.map(|end| axis.place(end));
            canvas.line([[low, y], [high, y]], &color, 1.8);
        }
        if let Some(claimed) = known.claimed.filter(|claimed| claimed.is_finite()) {
            let x = axis.place(claimed);
            canvas.raw(&format!(
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.6\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.4\"/>"
            ));
        }
        canvas.dot([axis.place(known.value), y], 3.2, &color, &known.title);
    }

    fn axis(&self, rows: &[&Row], left: f64) -> Axis {
        let known = || rows.iter().flat_map(|row| &row.values).filter(|known| known.value.is_finite());
        let own = || known().flat_map(|known| [Some(known.value), known.claimed]).flatten().filter(|it| it.is_finite());
        let (least, most) = own().fold((f64::INFINITY, 0.0_f64), |(least, most), it| (least.min(it), most.max(it)));
        let is_logarithmic = self.from_zero && least > 1e-12 && most > LOGARITHMIC_FROM * least;
        let intervals = known().filter_map(|known| known.interval).flatten().filter(|end| end.is_finite());
        let intervals = intervals.filter(|end| !is_logarithmic || *end > 0.3 * least);
        let zero = (self.from_zero && !is_logarithmic).then_some(0.0);
        let all = own().chain(intervals).chain(self.reference).chain(zero);
        let (from, to) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(from, to), it| (from.min(it), to.max(it)));
        let width = (self.width - left - RIGHT).max(60.0);
        let (from, to) = match to - from {
            _ if is_logarithmic => (from / 1.1, to * 1.1),
            span if span.is_finite() && span > 1e-12 * to.abs().max(1e-300) => {
                (if zero.is_some() { from } else { from - 0.03 * span }, to + 0.03 * span)
            }
            _ if from.is_finite() => (from - 0.5 - 1e-3 * from.abs(), to + 0.5 + 1e-3 * to.abs()),
            _ => (0.0, 1.0),
        };
        Axis { from, to, is_logarithmic, left, width }
    }

    /// Rows of places, names and colours.
    fn legend_rows(&self) -> Vec<Vec<(f64, &str, [u8; 3])>> {
        let mut rows: Vec<Vec<(f64, &str, [u8; 3])>> = Vec::new();
        let mut x = self.width;
        for (name, color) in self.series.iter().filter_map(|(name, color)| Some((name.as_deref()?, *color))) {
            let length = 26.0 + LETTER * name.chars().count() as f64;
            if x + length > self.width {
                rows.push(Vec::new());
                x = 20.0;
            }
            rows.last_mut().expect("there is one").push((x, name, color));
            x += length;
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(values: &[f64]) -> IntervalPlot {
        let row = |(number, &value): (usize, &f64)| {
            let interval = Some([0.9 * value, 1.1 * value]);
            let known = Known { series: 0, value, interval, claimed: Some(value), title: "<i>".into() };
            Row { label: format!("<row {number}>"), values: vec![known] }
        };
        IntervalPlot {
            title: "<t>".into(),
            label: "error [m]".into(),
            series: vec![(Some("<s>".into()), [1, 2, 3])],
            rows: values.iter().enumerate().map(row).collect(),
            reference: None,
            from_zero: true,
            width: 440.0,
        }
    }

    fn places(svg: &str) -> Vec<f64> {
        let dots = svg.split("<circle cx=\"").skip(1).filter(|rest| rest.contains("</circle>"));
        dots.filter(|rest| rest.split('>').nth(1).is_some_and(|next| next.starts_with("<title")))
            .map(|rest| rest.split('"').next().unwrap().parse().unwrap())
            .collect()
    }

    #[test]
    fn larger_values_are_further_to_the_right_within_the_figure_and_texts_are_escaped() {
        for (values, is_logarithmic) in [([1.0, 2.0, 3.0], false), ([1.0, 10.0, 100.0], true)] {
            let svg = plot(&values).svg().file;
            let places = places(&svg);
            assert!(places.len() == 3 && places.is_sorted() && places[2] < 430.0, "{places:?}");
            assert_eq!(svg.contains("logarithmic"), is_logarithmic);
            assert!(svg.contains("&lt;row 0&gt;") && svg.contains("&lt;s&gt;") && !svg.contains("<row"), "{svg}");
            if is_logarithmic {
                let steps = [places[1] - places[0], places[2] - places[1]];
                assert!((steps[0] - steps[1]).abs() < 0.3, "equal ratios are equal distances: {places:?}");
            }
        }
    }

    #[test]
    fn odd_values_are_drawn_or_left_out() {
        for values in [vec![], vec![f64::NAN, 1.0], vec![0.0; 3], vec![1e300, -1e300], vec![f64::INFINITY]] {
            for from_zero in [true, false] {
                let svg = IntervalPlot { from_zero, reference: Some(0.0), ..plot(&values) }.svg().file;
                assert!(svg.starts_with("<svg") && !svg.contains("NaN") && !svg.contains("inf"), "{values:?} {svg}");
            }
        }
    }
}
