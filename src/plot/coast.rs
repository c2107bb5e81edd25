//! Coastlines: Natural Earth, land of the scale 1:50 million, version 4.1 (naturalearthdata.com), which is in the public domain;
//! simplified to 0.12° with the algorithm of Douglas and Peucker, without islands below 0.35°.
//!
//! A line of `coast.txt` is a coastline: longitude and latitude of its first point in twentieths of a degree, and then the
//! steps from each point to the next.

const LINES: &str = include_str!("coast.txt");

/// Twentieths.
const PER_DEGREE: f64 = 20.0;

/// The coastlines that meet a plane of this width and height \[m\], as its points (x, y) \[m\]; `place` gives the point of a
/// latitude and longitude \[degrees\], if there is one.
pub fn lines(extent_m: [f64; 2], place: impl Fn(f64, f64) -> Option<(f64, f64)>) -> Vec<Vec<[f64; 2]>> {
    let of_line = |line| within(extent_m, points(line).map(|[longitude, latitude]| place(latitude, longitude)));
    LINES.lines().flat_map(of_line).collect()
}

/// The parts of a line that are in a plane or near it.
pub(super) fn within(extent_m: [f64; 2], places: impl Iterator<Item = Option<(f64, f64)>>) -> Vec<Vec<[f64; 2]>> {
    // Far from the centre points may lie anywhere, and lines between them go across the plane.
    let longest_m = 0.5 * extent_m[0].max(extent_m[1]);
    let is_near = |[x, y]: [f64; 2]| {
        [(x, extent_m[0]), (y, extent_m[1])].iter().all(|(at, length)| (-0.2 * length..=1.2 * length).contains(at))
    };
    let mut all = Vec::new();
    let mut part: Vec<[f64; 2]> = Vec::new();
    for place in places {
        let next = place.map(|(x, y)| [x, y]).filter(|&point| is_near(point));
        let goes_on = next.zip(part.last().copied()).is_none_or(|([x, y], [a, b])| (x - a).hypot(y - b) < longest_m);
        if next.is_none() || !goes_on {
            all.push(std::mem::take(&mut part));
        }
        part.extend(next);
    }
    all.push(part);
    all.retain(|part| part.len() > 1);
    all
}

/// Longitudes and latitudes \[degrees\].
fn points(line: &str) -> impl Iterator<Item = [f64; 2]> {
    let mut numbers = line.split(' ').map_while(|number| number.parse::<i32>().ok());
    let mut at = [0; 2];
    std::iter::from_fn(move || {
        at = [at[0] + numbers.next()?, at[1] + numbers.next()?];
        Some(at.map(|twentieths| f64::from(twentieths) / PER_DEGREE))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_is_on_the_earth_and_its_points_are_near_each_other() {
        let mut count = 0;
        for line in LINES.lines() {
            let points: Vec<[f64; 2]> = points(line).collect();
            assert_eq!(2 * points.len(), line.split(' ').count(), "{line:.40}");
            assert!(points.len() > 1 && points.iter().all(|[x, y]| x.abs() <= 180.0 && y.abs() <= 90.0), "{line:.40}");
            count += points.len();
        }
        assert!(count > 5000, "{count}");
    }

    /// A plane of degrees about the Alps and the Mediterranean: Cape Finisterre and the toe of Italy are on the coast.
    #[test]
    fn known_capes_are_on_the_coast() {
        let (west, south) = (-12.0, 34.0);
        let place = |latitude: f64, longitude: f64| Some((longitude - west, latitude - south));
        let near = |latitude: f64, longitude: f64| {
            let all = lines([40.0, 20.0], place).into_iter().flatten();
            all.map(|[x, y]| (x - longitude + west).hypot(y - latitude + south)).fold(f64::INFINITY, f64::min)
        };
        assert!(near(42.9, -9.27) < 0.3 && near(37.92, 16.06) < 0.4, "{} {}", near(42.9, -9.27), near(37.92, 16.06));
        assert!(near(47.0, 10.0) > 1.5, "the Alps are not on the coast");
        assert!(lines([40.0, 20.0], |_, _| None).is_empty());
    }
}
