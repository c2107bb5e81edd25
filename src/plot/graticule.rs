//! Parallels and meridians.

use super::coast::within;

/// A parallel or a meridian.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Its latitude or longitude in words: `50° N`.
    pub label: String,
    /// Where it comes into the plane, from the west or from the south, if it does \[m\].
    pub at: Option<[f64; 2]>,
    /// Its parts that are in the plane or near it, points (x, y) \[m\].
    pub parts: Vec<Vec<[f64; 2]>>,
}

/// Metres of a degree of latitude.
const DEGREE_M: f64 = 111_195.0;

/// The steps between lines \[degrees\].
const STEPS: [f64; 7] = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0];

/// Labels have this distance from the other edges, as a part of the plane.
const EDGE: f64 = 0.05;

/// The parallels and meridians that meet a plane of this width and height \[m\], at most about six of each; `place` gives the
/// point of a latitude and longitude \[degrees\], if there is one.
pub fn lines(extent_m: [f64; 2], place: impl Fn(f64, f64) -> Option<(f64, f64)>) -> Vec<Line> {
    let least = extent_m[0].max(extent_m[1]) / DEGREE_M / 6.0;
    let step = STEPS.into_iter().find(|step| *step >= least).unwrap_or(STEPS[STEPS.len() - 1]);
    let (fine, count) = (step / 8.0, |degrees: f64| (degrees / step) as i32);
    let along = |length: f64| (0..=(2.0 * length / fine) as i32).map(move |number| f64::from(number) * fine - length);
    let parallel = |number: i32| {
        let latitude = f64::from(number) * step;
        let parts = within(extent_m, along(180.0).map(|longitude| place(latitude, longitude)));
        Line { label: label(latitude, ["N", "S"]), at: crossing(&parts, extent_m, 0), parts }
    };
    let meridian = |number: i32| {
        let longitude = f64::from(number) * step;
        let parts = within(extent_m, along(90.0).map(|latitude| place(latitude, longitude)));
        Line { label: label(longitude, ["E", "W"]), at: crossing(&parts, extent_m, 1), parts }
    };
    let parallels = (-count(89.9)..=count(89.9)).map(parallel);
    let meridians = (1 - count(180.0)..=count(180.0)).map(meridian);
    parallels.chain(meridians).filter(|line| !line.parts.is_empty()).collect()
}

fn label(degrees: f64, [positive, negative]: [&str; 2]) -> String {
    let side = if degrees == 0.0 {
        ""
    } else if degrees > 0.0 {
        positive
    } else {
        negative
    };
    format!("{}°{}{side}", degrees.abs(), if side.is_empty() { "" } else { " " })
}

/// Where a line crosses the edge at which a coordinate is zero, away from the corners.
fn crossing(parts: &[Vec<[f64; 2]>], extent_m: [f64; 2], axis: usize) -> Option<[f64; 2]> {
    let other = 1 - axis;
    let cut = |pair: &[[f64; 2]]| {
        let [a, b] = [pair[0], pair[1]];
        let at = a[other] - a[axis] * (b[other] - a[other]) / (b[axis] - a[axis]);
        let mut place = [0.0; 2];
        place[other] = at;
        let is_inside = (EDGE * extent_m[other]..=(1.0 - EDGE) * extent_m[other]).contains(&at);
        ((a[axis] < 0.0) != (b[axis] < 0.0) && is_inside).then_some(place)
    };
    parts.iter().flat_map(|part| part.windows(2)).find_map(cut)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In a plane of degrees, with a degree for a hundred kilometres, lines are straight and at round values.
    #[test]
    fn lines_are_at_round_degrees_and_named_where_they_come_in() {
        let (west, south) = (-12.0, 33.0);
        let place = |latitude: f64, longitude: f64| Some((1e5 * (longitude - west), 1e5 * (latitude - south)));
        let all = lines([4e6, 2e6], place);
        let names: Vec<&str> = all.iter().filter(|line| line.at.is_some()).map(|line| line.label.as_str()).collect();
        assert_eq!(names, ["40° N", "50° N", "10° W", "0°", "10° E", "20° E"]);
        let [forty, ten] = ["40° N", "10° E"].map(|name| all.iter().find(|line| line.label == name).unwrap());
        assert!(forty.parts.iter().flatten().all(|point| (point[1] - 7e5).abs() < 1e-6));
        assert!((forty.at.unwrap()[1] - 7e5).abs() < 1e-6 && forty.at.unwrap()[0] == 0.0);
        assert!((ten.at.unwrap()[0] - 2.2e6).abs() < 1e-6 && ten.at.unwrap()[1] == 0.0);
        assert!(lines([4e6, 2e6], |_, _| None).is_empty());
    }
}
