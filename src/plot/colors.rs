//! Colour scales, and their colours at given values.

/// A colour scale: red, green and blue at equally spaced values, linear in between.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Viridis, as the viewer itself draws it: for states.
    State,
    /// Blue through white to red (ColorBrewer's RdBu, reversed; safe for colour-blind eyes): for differences.
    Difference,
    /// Inferno, as the viewer itself draws it: for spreads.
    Spread,
    /// [`GREYS`] greys and then [`HUES`] hues, without anything in between: for the parts of a partition.
    Parts,
}

/// Greys of [`Scale::Parts`], for parts that nothing observes.
pub const GREYS: usize = 4;

/// Hues of [`Scale::Parts`], distinct for colour-blind eyes (Okabe and Ito 2008).
pub const HUES: usize = 7;

const PARTS: [[u8; 3]; GREYS + HUES] = [
    [110, 110, 110],
    [135, 135, 135],
    [90, 90, 90],
    [155, 155, 155],
    [86, 180, 233],
    [230, 159, 0],
    [0, 158, 115],
    [204, 121, 167],
    [213, 94, 0],
    [0, 114, 178],
    [240, 228, 66],
];

const VIRIDIS: [[u8; 3]; 11] = [
    [68, 1, 84],
    [72, 36, 117],
    [65, 68, 135],
    [53, 95, 141],
    [42, 120, 142],
    [33, 145, 140],
    [34, 168, 132],
    [68, 191, 112],
    [122, 209, 81],
    [189, 223, 38],
    [253, 231, 37],
];

const BLUE_RED: [[u8; 3]; 11] = [
    [5, 48, 97],
    [33, 102, 172],
    [67, 147, 195],
    [146, 197, 222],
    [209, 229, 240],
    [247, 247, 247],
    [253, 219, 199],
    [244, 165, 130],
    [214, 96, 77],
    [178, 24, 43],
    [103, 0, 31],
];

const INFERNO: [[u8; 3]; 11] = [
    [0, 0, 4],
    [22, 11, 57],
    [66, 10, 104],
    [106, 23, 110],
    [147, 38, 103],
    [188, 55, 84],
    [221, 81, 58],
    [243, 120, 25],
    [252, 165, 10],
    [246, 215, 70],
    [252, 255, 164],
];

impl Scale {
    /// Its identifier in figures.
    pub fn name(self) -> &'static str {
        match self {
            Scale::State => "scale-state",
            Scale::Difference => "scale-difference",
            Scale::Spread => "scale-spread",
            Scale::Parts => "scale-parts",
        }
    }

    /// The scale from below, as a gradient of its name.
    pub fn gradient(self) -> String {
        let last = self.table().len() - 1;
        let stop = |(number, color): (usize, &[u8; 3])| {
            format!("<stop offset=\"{}\" stop-color=\"{}\"/>", number as f64 / last as f64, hex(*color))
        };
        let stops: String = self.table().iter().enumerate().map(stop).collect();
        format!("<linearGradient id=\"{}\" x1=\"0\" y1=\"1\" x2=\"0\" y2=\"0\">{stops}</linearGradient>", self.name())
    }

    /// Its colours.
    fn table(self) -> &'static [[u8; 3]; 11] {
        match self {
            Scale::State => &VIRIDIS,
            Scale::Difference => &BLUE_RED,
            Scale::Spread => &INFERNO,
            Scale::Parts => &PARTS,
        }
    }

    /// The colour at `position`: 0 is the low end, 1 the high end. Beyond them, and for no number, the ends.
    pub fn color(self, position: f32) -> [u8; 3] {
        let table = self.table();
        let steps = table.len() - 1;
        let position = if position.is_nan() { 0.0 } else { position.clamp(0.0, 1.0) };
        let place = position * steps as f32;
        let place = if self == Scale::Parts { place.round() } else { place };
        let low = (place as usize).min(steps - 1);
        let weight = place - low as f32;
        std::array::from_fn(|channel| {
            let (from, to) = (f32::from(table[low][channel]), f32::from(table[low + 1][channel]));
            (from + weight * (to - from)).round() as u8
        })
    }
}

/// The colour of a difference, with white for zero and the ends for ±`limit`.
pub fn difference(value: f32, limit: f32) -> [u8; 3] {
    Scale::Difference.color(0.5 + 0.5 * value / limit)
}

/// The colour of a part of a partition, by its number from [`parts`](super::parts::numbers).
pub fn part(number: u8) -> [u8; 3] {
    PARTS[usize::from(number).min(PARTS.len() - 1)]
}

/// A colour as SVG names it.
pub fn hex([red, green, blue]: [u8; 3]) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// The colours of curves of methods on white or black paper, in the order of [`of_method`] but darker; those of further
/// methods are the same again, lighter, and then darker.
pub fn of_method_on_paper(number: usize) -> [u8; 3] {
    const COLORS: [[u8; 3]; 7] =
        [[46, 134, 193], [201, 128, 0], [0, 148, 108], [190, 95, 150], [205, 85, 10], [110, 100, 200], [128, 128, 128]];
    let mixed = |paper: f64, share: f64| {
        COLORS[number % COLORS.len()].map(|own| ((1.0 - share) * f64::from(own) + share * paper).round() as u8)
    };
    match number / COLORS.len() % 3 {
        0 => COLORS[number % COLORS.len()],
        1 => mixed(255.0, 0.4),
        _ => mixed(0.0, 0.35),
    }
}

/// The colours of curves of methods, distinct for colour-blind eyes (Okabe and Ito 2008, without yellow).
pub fn of_method(number: usize) -> [u8; 3] {
    const COLORS: [[u8; 3]; 7] =
        [[86, 180, 233], [230, 159, 0], [0, 158, 115], [204, 121, 167], [213, 94, 0], [0, 114, 178], [200, 200, 200]];
    COLORS[number % COLORS.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_white_at_zero_blue_below_and_red_above() {
        assert_eq!(difference(0.0, 3.0), [247, 247, 247]);
        assert_eq!(difference(-3.0, 3.0), [5, 48, 97]);
        assert_eq!(difference(3.0, 3.0), [103, 0, 31]);
        assert_eq!(difference(1e30, 3.0), [103, 0, 31]);
        let [red, _, blue] = difference(0.6, 3.0);
        assert!(red > blue);
        assert_eq!(difference(0.3, 3.0), [250, 233, 223]);
    }

    #[test]
    fn twenty_methods_have_colours_of_their_own() {
        let colors: std::collections::BTreeSet<[u8; 3]> = (0..20).map(of_method_on_paper).collect();
        assert_eq!(colors.len(), 20);
    }

    #[test]
    fn what_is_no_number_has_a_colour_too() {
        assert_eq!(Scale::State.color(f32::NAN), [68, 1, 84]);
        assert_eq!(difference(f32::NAN, 1.0), [5, 48, 97]);
    }
}
