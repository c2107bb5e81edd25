//! Contour lines of a field, by marching squares.

use std::collections::HashMap;

/// Segments of the lines at which the field `[y, x]`, in rows of `nx`, has the value `level`: pairs of points (x, y) in cells,
/// with the centre of the first cell at (0.5, 0.5). Where four cells do not say which way a line goes, their mean does.
pub fn segments(field: &[f32], nx: usize, level: f32) -> Vec<[[f32; 2]; 2]> {
    let mut found = Vec::new();
    let ny = field.len() / nx.max(1);
    for y in 0..ny.saturating_sub(1) {
        for x in 0..nx - 1 {
            // Counter-clockwise from the south-west.
            let values = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| field[(y + j) * nx + x + i] - level);
            if values.iter().any(|value| !value.is_finite()) {
                continue;
            }
            let corner = |number: usize| [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]][number % 4];
            let above = values.map(|value| value >= 0.0);
            let cuts: Vec<[f32; 2]> = (0..4)
                .filter(|&side| above[side] != above[(side + 1) % 4])
                .map(|side| {
                    let ([a, b], [from, to]) =
                        ([values[side], values[(side + 1) % 4]], [corner(side), corner(side + 1)]);
                    let part = a / (a - b);
                    let at = |axis: usize| from[axis] + part * (to[axis] - from[axis]) + 0.5;
                    [x as f32 + at(0), y as f32 + at(1)]
                })
                .collect();
            match cuts[..] {
                [a, b] => found.push([a, b]),
                [a, b, c, d] => {
                    let mean_is_above = values.iter().sum::<f32>() >= 0.0;
                    // The corner between the cuts `a` and `b` is cut off, or those beside it.
                    let cut_off = above[1] != mean_is_above;
                    found.extend(if cut_off { [[a, b], [c, d]] } else { [[d, a], [b, c]] });
                }
                _ => {}
            }
        }
    }
    found
}

/// Segments put together to lines, each as long as can be, in both directions from its first segment.
pub fn joined(segments: &[[[f32; 2]; 2]]) -> Vec<Vec<[f32; 2]>> {
    // Two cells compute the place on their common side apart from rounding.
    let key = |point: [f32; 2]| point.map(|it| (it * 4096.0).round() as i64);
    let mut at: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
    for (number, segment) in segments.iter().enumerate() {
        segment.iter().for_each(|&end| at.entry(key(end)).or_default().push(number));
    }
    let mut is_used = vec![false; segments.len()];
    let mut lines = Vec::new();
    for first in 0..segments.len() {
        if std::mem::replace(&mut is_used[first], true) {
            continue;
        }
        let mut line = segments[first].to_vec();
        for _ in 0..2 {
            while let Some(&end) = line.last() {
                let Some(&next) = at[&key(end)].iter().find(|&&next| !is_used[next]) else { break };
                is_used[next] = true;
                let [a, b] = segments[next];
                line.push(if key(a) == key(end) { b } else { a });
            }
            line.reverse();
        }
        lines.push(line);
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of x² + y² the line at r² is a circle: every segment's ends are on it, and together they are as long as it.
    #[test]
    fn a_circle_is_closed_and_as_long_as_it_should_be() {
        let (nx, centre, radius) = (41, 20.5_f32, 15.3_f32);
        let square = |cell: usize| {
            let (x, y) = ((cell % nx) as f32 + 0.5 - centre, (cell / nx) as f32 + 0.5 - centre);
            x * x + y * y
        };
        let field: Vec<f32> = (0..nx * nx).map(square).collect();
        let lines = segments(&field, nx, radius * radius);
        let from_centre = |[x, y]: [f32; 2]| (x - centre).hypot(y - centre);
        assert!(lines.iter().flatten().all(|&point| (from_centre(point) - radius).abs() < 0.02));
        let length: f32 = lines.iter().map(|[a, b]| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
        assert!((length / (2.0 * std::f32::consts::PI * radius) - 1.0).abs() < 0.005, "{length}");
        let joined = joined(&lines);
        assert_eq!((joined.len(), joined[0].len()), (1, lines.len() + 1), "one closed line of all segments");
        let [a, b] = [joined[0][0], joined[0][lines.len()]];
        assert!((a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-3, "{a:?} {b:?}");
        let own: f32 = joined[0].windows(2).map(|it| (it[0][0] - it[1][0]).hypot(it[0][1] - it[1][1])).sum();
        assert!((own / length - 1.0).abs() < 1e-4, "{own} {length}");
    }

    #[test]
    fn a_saddle_and_what_is_no_number_have_lines_that_do_not_cross() {
        let lines = segments(&[1.0, -1.0, -1.0, 1.0], 2, 0.0);
        assert_eq!(lines.len(), 2);
        assert!(lines.iter().all(|[a, b]| a != b), "{lines:?}");
        assert_eq!(joined(&lines).len(), 2);
        assert!(segments(&[f32::NAN, 1.0, -1.0, 1.0], 2, 0.0).is_empty());
        assert!(segments(&[1.0, 2.0], 1, 1.5).is_empty() && segments(&[], 0, 1.0).is_empty());
    }
}
