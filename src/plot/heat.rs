//! Numbers over two axes of words: cells in the colour of their value, with the value in them.

use super::colors::{Scale, hex};
use super::svg::{Anchor, Canvas, INK, Svg};

/// A cell of a figure.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatCell {
    /// Its value, if it has one.
    pub value: Option<f64>,
    /// The value in short.
    pub text: String,
    /// Whether it is marked as the best.
    pub is_best: bool,
}

/// Values by column and row.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatMap {
    /// Its title.
    pub title: String,
    /// What the columns are, and what each is.
    pub columns: (String, Vec<String>),
    /// What the rows are, and what each is, from below.
    pub rows: (String, Vec<String>),
    /// The cells `[row, column]`, from below.
    pub cells: Vec<HeatCell>,
}

/// Least and greatest width of a cell, its height, and room around the cells \[px\].
const CELL: [f64; 2] = [46.0, 92.0];
const HEIGHT: f64 = 26.0;
const ROOM: f64 = 350.0;
const TOP: f64 = 50.0;
const BOTTOM: f64 = 44.0;
const RIGHT: f64 = 16.0;

/// Pixels of a letter of 11 px.
const LETTER: f64 = 6.2;

/// Colours are by the logarithm of values that are further apart than by this factor.
const LOGARITHMIC_FROM: f64 = 8.0;

impl HeatMap {
    /// Draws the figure; nothing in it has an identifier.
    pub fn svg(&self) -> Svg {
        let ((across, columns), (up, rows)) = (&self.columns, &self.rows);
        let longest = |words: &[String]| words.iter().map(|word| word.chars().count()).max().unwrap_or(0) as f64;
        let texts = self.cells.iter().map(|cell| cell.text.chars().count()).max().unwrap_or(0) as f64;
        let needed = LETTER * longest(columns).max(texts) + 12.0;
        let width = (ROOM / columns.len().max(1) as f64).clamp(CELL[0], CELL[1]).max(needed);
        let left = 18.0 + LETTER * longest(rows);
        let (all, bottom) = (width * columns.len() as f64, TOP + HEIGHT * rows.len() as f64);
        let words = |text: &str, letter: f64| letter * text.chars().count() as f64 + 20.0;
        let wide = (left + all + RIGHT).max(words(&self.title, 7.6)).max(words(up, 6.8)).max(left + words(across, 6.8));
        let mut canvas = Canvas::new([wide, bottom + BOTTOM]);
        canvas.text([0.5 * wide, 20.0], 14.0, Anchor::Middle, INK, &self.title);
        let shade = self.shades();
        for (number, (cell, shade)) in self.cells.iter().zip(&shade).enumerate() {
            let (row, column) = (number / columns.len().max(1), number % columns.len().max(1));
            let at = [left + width * column as f64, bottom - HEIGHT * (row + 1) as f64];
            let Some(shade) = shade else {
                canvas.text([at[0] + 0.5 * width, at[1] + 17.0], 11.0, Anchor::Middle, INK, "–");
                continue;
            };
            let color = Scale::State.color(*shade);
            canvas.rectangle([at[0] + 0.5, at[1] + 0.5], [width - 1.0, HEIGHT - 1.0], &hex(color));
            let text = if cell.is_best { format!("{} *", cell.text) } else { cell.text.clone() };
            canvas.text([at[0] + 0.5 * width, at[1] + 17.0], 11.0, Anchor::Middle, on(color), &text);
            if cell.is_best {
                canvas.raw(&format!(
                    "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" stroke=\"{INK}\" \
                     stroke-width=\"2.4\"/>",
                    at[0] + 0.5,
                    at[1] + 0.5,
                    width - 1.0,
                    HEIGHT - 1.0
                ));
            }
        }
        for (word, number) in columns.iter().zip(0..) {
            let x = left + width * (f64::from(number) + 0.5);
            canvas.text([x, bottom + 15.0], 11.0, Anchor::Middle, INK, word);
        }
        for (word, number) in rows.iter().zip(0..) {
            let y = bottom - HEIGHT * (f64::from(number) + 0.5) + 4.0;
            canvas.text([left - 7.0, y], 11.0, Anchor::End, INK, word);
        }
        canvas.text([left, bottom + 33.0], 12.0, Anchor::Start, INK, across);
        canvas.text([8.0, TOP - 8.0], 12.0, Anchor::Start, INK, up);
        canvas.finish(&self.title)
    }

    /// The place of each cell's value on the scale, from 0 for the largest to 1 for the least.
    fn shades(&self) -> Vec<Option<f32>> {
        let finite = || self.cells.iter().filter_map(|cell| cell.value).filter(|value| value.is_finite());
        let (least, most) = finite().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), it| (a.min(it), b.max(it)));
        let is_logarithmic = least > 0.0 && most > LOGARITHMIC_FROM * least;
        let scaled = |value: f64| if is_logarithmic { value.ln() } else { value };
        let place = |value: f64| match scaled(most) - scaled(least) {
            span if span > 0.0 => ((scaled(most) - scaled(value)) / span) as f32,
            _ => 0.5,
        };
        self.cells.iter().map(|cell| cell.value.filter(|value| value.is_finite()).map(place)).collect()
    }
}

/// Black or white, whichever is better read on a colour, by its luminance (ITU-R BT.601).
fn on([red, green, blue]: [u8; 3]) -> &'static str {
    let luminance = 0.299 * f64::from(red) + 0.587 * f64::from(green) + 0.114 * f64::from(blue);
    if luminance > 128.0 { "#101010" } else { "#fafafa" }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: [Option<f64>; 6]) -> HeatMap {
        let cell = |(number, value): (usize, Option<f64>)| HeatCell {
            value,
            text: value.map_or_else(String::new, |value| format!("<{value}>")),
            is_best: number == 4,
        };
        HeatMap {
            title: "<t>".into(),
            columns: ("length".into(), vec!["1".into(), "2".into(), "3".into()]),
            rows: ("scale".into(), vec!["low".into(), "high".into()]),
            cells: values.into_iter().enumerate().map(cell).collect(),
        }
    }

    #[test]
    fn every_cell_has_its_number_and_the_best_a_frame() {
        let svg = map([Some(3.0), Some(2.0), None, Some(1.5), Some(1.0), Some(9.0)]).svg().file;
        for text in [">&lt;3&gt;<", ">&lt;1&gt; *<", ">low<", ">–<", ">scale<", ">&lt;t&gt;<"] {
            assert!(svg.contains(text), "{text}: {svg}");
        }
        assert_eq!(svg.matches("stroke-width=\"2.4\"").count(), 1);
        assert!(svg.contains(&hex(Scale::State.color(1.0))) && svg.contains(&hex(Scale::State.color(0.0))));
        roxmltree::Document::parse(&svg).unwrap();
    }

    #[test]
    fn shades_go_from_the_largest_to_the_least_by_the_logarithm_if_they_are_far_apart() {
        let shades = |values| map(values).shades();
        let near = shades([Some(1.0), Some(2.0), Some(3.0), None, Some(f64::NAN), Some(1.0)]);
        assert_eq!(near, [Some(1.0), Some(0.5), Some(0.0), None, None, Some(1.0)]);
        let far = shades([Some(1.0), Some(10.0), Some(100.0), None, None, None]);
        assert!((far[1].unwrap() - 0.5).abs() < 1e-6, "{far:?}");
        assert_eq!(shades([Some(4.0); 6]), [Some(0.5); 6]);
    }
}
