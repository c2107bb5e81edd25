//! What trackers read of a balloon: the equations, their derivatives, and a first guess of the balloon's places.

use super::readings::{Fix, Reading, Tracker};
use faer::Mat;
use faer::linalg::solvers::Solve;
use std::f64::consts::{PI, TAU};

/// What a tracker without errors would read of a balloon, whether it has all three instruments or not.
pub fn reading_of(tracker: &Tracker, position_m: [f64; 3]) -> Reading {
    let [range, azimuth, elevation] = values(from(tracker, position_m));
    Reading { range_m: Some(range), azimuth_rad: Some(azimuth), elevation_rad: Some(elevation) }
}

/// Range \[m\], azimuth and elevation \[rad\] of a place relative to the tracker.
pub(super) fn values([east, north, up]: [f64; 3]) -> [f64; 3] {
    let horizontal = east.hypot(north);
    [horizontal.hypot(up), east.atan2(north), up.atan2(horizontal)]
}

/// Their derivatives by the place; those of the azimuth are bounded above the tracker, where it has no direction.
pub(super) fn derivatives([east, north, up]: [f64; 3]) -> [[f64; 3]; 3] {
    let range = east.hypot(north).hypot(up).max(f64::MIN_POSITIVE);
    let horizontal = east.hypot(north).max(1e-9 * range);
    let (square, along) = (horizontal.powi(2), horizontal * range * range);
    [
        [east / range, north / range, up / range],
        [north / square, -east / square, 0.0],
        [-east * up / along, -north * up / along, horizontal / (range * range)],
    ]
}

/// A place relative to a tracker.
pub(super) fn from(tracker: &Tracker, position_m: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| position_m[i] - tracker.place_m[i])
}

/// The same angle from −π to π.
pub(super) fn half_turn(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

/// A first guess of all positions: where one tracker reads range and both angles, its place; else where the directions of
/// several meet; else that of the nearest fix that has one. `None` if no fix has one.
pub(super) fn first_guess(trackers: &[Tracker], fixes: &[Fix]) -> Option<Vec<[f64; 3]>> {
    let mut guesses: Vec<Option<[f64; 3]>> =
        fixes.iter().map(|fix| polar(trackers, fix).or_else(|| crossing(trackers, fix))).collect();
    let known: Vec<usize> = (0..fixes.len()).filter(|&k| guesses[k].is_some()).collect();
    for k in 0..fixes.len() {
        if guesses[k].is_none() {
            let after = known.partition_point(|&other| other < k);
            let candidates = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|it| known.get(it));
            let distance = |other: &&usize| (fixes[**other].seconds - fixes[k].seconds).abs();
            let nearest = candidates.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
            guesses[k] = guesses[*nearest];
        }
    }
    guesses.into_iter().collect()
}

/// The place that the first tracker with range and both angles reads.
fn polar(trackers: &[Tracker], fix: &Fix) -> Option<[f64; 3]> {
    trackers.iter().zip(&fix.readings).find_map(|(tracker, reading)| {
        let (range, direction) = (reading.range_m?, direction(reading)?);
        Some([0, 1, 2].map(|i| tracker.place_m[i] + range * direction[i]))
    })
}

/// The place with the least sum of squared distances from the lines along which trackers see the balloon:
/// Σ_j (I − d_j d_jᵀ) (b − p_j) = 0.
fn crossing(trackers: &[Tracker], fix: &Fix) -> Option<[f64; 3]> {
    let (mut matrix, mut right, mut lines) = (Mat::<f64>::zeros(3, 3), Mat::<f64>::zeros(3, 1), 0);
    for (tracker, reading) in trackers.iter().zip(&fix.readings) {
        let Some(along) = direction(reading) else { continue };
        lines += 1;
        for i in 0..3 {
            for j in 0..3 {
                let across = f64::from(i == j) - along[i] * along[j];
                matrix[(i, j)] += across;
                right[(i, 0)] += across * tracker.place_m[j];
            }
        }
    }
    if lines < 2 {
        return None;
    }
    let place = matrix.partial_piv_lu().solve(&right);
    let place = [0, 1, 2].map(|i| place[(i, 0)]);
    place.iter().all(|value| value.is_finite()).then_some(place)
}

/// The unit vector towards the balloon.
fn direction(reading: &Reading) -> Option<[f64; 3]> {
    let (azimuth, elevation) = (reading.azimuth_rad?, reading.elevation_rad?);
    Some([elevation.cos() * azimuth.sin(), elevation.cos() * azimuth.cos(), elevation.sin()])
}
