//! Names at the right ends of curves.

use super::svg::escaped;
use std::fmt::Write;

/// The most letters of a name at the end of a curve.
pub(super) const LONGEST: usize = 16;

/// By how much a figure is lower than with a legend of one row \[px\].
pub(super) const LESS: f64 = 22.0;

/// Height of a name, and how far from the end of its curve it may be \[px\].
const LINE: f64 = 12.5;
const FURTHEST: f64 = 26.0;

/// Pixels of a letter, and between the axis and a name.
const LETTER: f64 = 6.4;
const GAP: f64 = 9.0;

/// The end of a curve that has a name.
pub(super) struct End {
    pub name: String,
    /// As SVG names it.
    pub color: String,
    /// Its place \[px\].
    pub at: [f64; 2],
}

/// The room that names need right of the axis \[px\].
pub(super) fn room<'a>(names: impl Iterator<Item = &'a str>) -> f64 {
    let longest = names.map(|name| name.chars().count()).max().unwrap_or(0);
    (GAP + LETTER * longest as f64 + 4.0).max(18.0)
}

/// The names, right of x, between two heights; `None` if one would be too far from the end of its curve.
pub(super) fn names(ends: &[End], x: f64, within: [f64; 2]) -> Option<String> {
    let wanted: Vec<f64> = ends.iter().map(|end| end.at[1]).collect();
    let places = apart(&wanted, within)?;
    if wanted.iter().zip(&places).any(|(wanted, place)| (wanted - place).abs() > FURTHEST) {
        return None;
    }
    let mut text = String::new();
    for (End { name, color, at }, y) in ends.iter().zip(places) {
        // A string takes everything.
        let _ = write!(
            text,
            "<path d=\"M{:.1} {:.1}L{:.1} {y:.1}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"0.9\"/>\n\
             <text x=\"{:.1}\" y=\"{:.1}\" font-size=\"11\" font-family=\"system-ui, sans-serif\" \
             fill=\"{color}\">{}</text>\n",
            at[0] + 1.0,
            at[1],
            x + GAP - 2.0,
            x + GAP,
            y + 4.0,
            escaped(name)
        );
    }
    Some(text)
}

/// The places between two heights that are nearest to those that are wanted, by the sum of the squares of the distances, and
/// at least a line apart: with y′ᵢ = yᵢ − i · line, in the order of the wanted places, the isotonic regression of w′ᵢ, found by pooling
/// adjacent violators (Barlow et al. 1972, Statistical Inference under Order Restrictions), and clamped. `None` if there
/// is no room.
fn apart(wanted: &[f64], [top, bottom]: [f64; 2]) -> Option<Vec<f64>> {
    let least = top;
    let most = bottom - LINE * wanted.len().saturating_sub(1) as f64;
    if least > most || wanted.iter().any(|it| !it.is_finite()) {
        return None;
    }
    let mut order: Vec<usize> = (0..wanted.len()).collect();
    order.sort_by(|&a, &b| wanted[a].total_cmp(&wanted[b]));
    // Sum and number of those that stand next to each other without a gap.
    let mut pools: Vec<(f64, usize)> = Vec::new();
    for (number, &of) in order.iter().enumerate() {
        let mut pool = (wanted[of] - LINE * number as f64, 1);
        while let Some(last) = pools.pop_if(|last| last.0 / last.1 as f64 >= pool.0 / pool.1 as f64) {
            pool = (pool.0 + last.0, pool.1 + last.1);
        }
        pools.push(pool);
    }
    let shifted =
        pools.iter().flat_map(|&(sum, count)| std::iter::repeat_n((sum / count as f64).clamp(least, most), count));
    let mut places = vec![0.0; wanted.len()];
    for (number, (of, shifted)) in order.into_iter().zip(shifted).enumerate() {
        places[of] = shifted + LINE * number as f64;
    }
    Some(places)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_a_line_apart_and_as_near_as_can_be() {
        let found = apart(&[100.0, 20.0, 101.0, 99.0], [0.0, 200.0]).unwrap();
        assert_eq!(found[1], 20.0, "one that is alone stays where it is");
        assert_eq!([found[3], found[0], found[2]], [100.0 - LINE, 100.0, 100.0 + LINE]);
        let found = apart(&[1.0, 1.0], [0.0, 200.0]).unwrap();
        assert_eq!(found, [0.0, LINE], "nothing leaves the figure");
        assert!(apart(&[1.0; 10], [0.0, 100.0]).is_none() && apart(&[f64::NAN], [0.0, 100.0]).is_none());
        assert_eq!(apart(&[], [0.0, 100.0]), Some(vec![]));
    }
}
