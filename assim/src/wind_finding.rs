//! Wind-finding: one balloon flight as K consecutive positions and the calibration of the sensors that track it.
//!
//! It is a block-angular regression as in WO 90/13794, eqs. (15), (16): the positions are the blocks b_k, of which each fix is
//! seen by its own rows only, and the offsets of the trackers' range, azimuth and elevation are the border c, constant over the
//! flight. The trackers' equations are those of any that measure range and two angles, and not of the patent:
//!
//! ```text
//! range     = |b − p|                           + c_r + e
//! azimuth   = atan2(x, y)                       + c_a + e      (x, y, z) = b − p, p the tracker's place; from north,
//! elevation = atan2(z, √(x² + y²))              + c_e + e      clockwise
//! ```
//!
//! No position has a prior, and no motion of the balloon is assumed. The equations are linearised about the present
//! estimates and solved again until they stay (Gauss–Newton): each time one block-angular regression, whose cost is linear
//! in K. The wind between two fixes is the difference of the positions, with its covariance; what the two share through
//! the calibration cancels as far as it is the same.

use crate::block_angular::{Block, BorderRows, Prior, RegressionRows, Solution, solve};
use crate::error::Error;
use crate::high_pass::in_words;
use crate::linalg::product;
use faer::Mat;
use isobar_model::vector::add;
use rayon::prelude::*;
use std::cmp::Ordering;
use std::f64::consts::{PI, TAU};

/// A tracking sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracker {
    /// Its name.
    pub name: String,
    /// Its place: eastward, northward and upward \[m\].
    pub place_m: [f64; 3],
    /// Standard deviation of the random error of a range \[m\].
    pub sigma_range_m: f64,
    /// Standard deviation of the random error of an azimuth \[rad\].
    pub sigma_azimuth_rad: f64,
    /// Standard deviation of the random error of an elevation \[rad\].
    pub sigma_elevation_rad: f64,
}

/// What a tracker reads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Distance \[m\].
    pub range_m: f64,
    /// Direction from north, clockwise \[rad\].
    pub azimuth_rad: f64,
    /// Height above the horizon \[rad\].
    pub elevation_rad: f64,
}

/// All readings at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    /// When, in seconds since any time.
    pub seconds: f64,
    /// One for each tracker, `None` where it lost the balloon.
    pub readings: Vec<Option<Reading>>,
}

/// A flight as the readings have it.
#[derive(Clone, Debug)]
pub struct Flight {
    /// The position at each fix \[m\].
    pub positions_m: Vec<[f64; 3]>,
    /// Standard deviations of the positions' coordinates \[m\].
    pub sigma_positions_m: Vec<[f64; 3]>,
    /// Eastward, northward and upward speed between each fix and the next \[m/s\].
    pub winds_m_per_s: Vec<[f64; 3]>,
    /// Standard deviations of these.
    pub sigma_winds_m_per_s: Vec<[f64; 3]>,
    /// Offsets of range \[m\], azimuth and elevation \[rad\], tracker after tracker: what is to be taken from readings.
    pub offsets: Vec<f64>,
    /// Their covariance.
    pub offsets_covariance: Mat<f64>,
    /// Sum of squares of the whitened residuals over its expectation, the rows less the unknowns; 0 if there are no more
    /// rows than unknowns.
    pub chi2_per_degree: f64,
    /// Linearisations that it took.
    pub iterations: usize,
}

/// Linearisations after which there is no hope.
const MOST_ITERATIONS: usize = 50;

/// What counts as no change, in standard deviations of the calibration.
const CONVERGED: f64 = 1e-6;

/// Names of the offsets, tracker after tracker: `radar/range`.
pub fn offset_names(trackers: &[Tracker]) -> Vec<String> {
    let of = |tracker: &Tracker| ["range", "azimuth", "elevation"].map(|kind| format!("{}/{kind}", tracker.name));
    trackers.iter().flat_map(of).collect()
}

/// What a tracker without errors would read of a balloon.
pub fn reading_of(tracker: &Tracker, position_m: [f64; 3]) -> Reading {
    let [x, y, z] = from(tracker, position_m);
    let horizontal = x.hypot(y);
    Reading { range_m: horizontal.hypot(z), azimuth_rad: x.atan2(y), elevation_rad: z.atan2(horizontal) }
}

/// Finds positions, winds and offsets from the readings of a flight; `prior` holds what is known of the offsets before.
///
/// # Errors
/// [`Error::Setting`] for readings that make no sense, with the fix, and for offsets that the flight does not determine,
/// with their names; [`Error::NotFinite`] if the linearisations do not come to an end.
///
/// # Panics
/// If the prior has not three offsets for each tracker.
pub fn find_winds(trackers: &[Tracker], fixes: &[Fix], prior: Option<&Prior>) -> Result<Flight, Error> {
    check(trackers, fixes)?;
    let p = 3 * trackers.len();
    let mut positions: Vec<[f64; 3]> = fixes.iter().map(|fix| first_guess(trackers, fix)).collect();
    let mut offsets = prior.map_or(vec![0.0; p], |prior| prior.mean.clone());
    for iterations in 1..=MOST_ITERATIONS {
        let block = |(fix, position): (&Fix, &[f64; 3])| rows(trackers, fix, *position, &offsets);
        let blocks: Vec<Block> = fixes.par_iter().zip(&positions).map(block).collect();
        if prior.is_none() && iterations == 1 {
            check_determined(trackers, &blocks)?;
        }
        let relative = prior.map(|prior| Prior {
            mean: prior.mean.iter().zip(&offsets).map(|(mean, offset)| mean - offset).collect(),
            covariance: prior.covariance.clone(),
        });
        let solution = solve(&blocks, p, relative.as_ref())?;
        positions.par_iter_mut().zip(&solution.blocks).for_each(|(position, block)| {
            add(position, &block.estimate);
        });
        add(&mut offsets, &solution.border);
        let sigma = |i: usize| solution.border_covariance[(i, i)].sqrt();
        let change = solution.border.iter().enumerate().map(|(i, change)| (change / sigma(i)).abs());
        let change = change.fold(0.0, |a: f64, b| if b.is_nan() { f64::NAN } else { a.max(b) });
        if !change.is_finite() {
            break;
        }
        if change < CONVERGED {
            return Ok(flight(fixes, positions, offsets, &solution, iterations));
        }
    }
    Err(Error::NotFinite { what: format!("the flight after {MOST_ITERATIONS} linearisations") })
}

fn check(trackers: &[Tracker], fixes: &[Fix]) -> Result<(), Error> {
    let fault = |what: String| Err(Error::Setting(what));
    if fixes.is_empty() || trackers.is_empty() {
        return fault("a flight needs a tracker and a fix".into());
    }
    for tracker in trackers {
        let sigmas = [tracker.sigma_range_m, tracker.sigma_azimuth_rad, tracker.sigma_elevation_rad];
        if !sigmas.iter().all(|sigma| sigma.is_finite() && *sigma > 0.0) {
            return fault(format!("tracker {}: standard deviations must be above 0", tracker.name));
        }
        if !tracker.place_m.iter().all(|place| place.is_finite()) {
            return fault(format!("tracker {}: its place is not finite", tracker.name));
        }
    }
    for (number, fix) in fixes.iter().enumerate() {
        let place = format!("fix {}", number + 1);
        if fix.readings.len() != trackers.len() {
            return fault(format!("{place} has {} readings for {} trackers", fix.readings.len(), trackers.len()));
        }
        if number > 0 && fix.seconds.partial_cmp(&fixes[number - 1].seconds) != Some(Ordering::Greater) {
            return fault(format!("{place} is not after the one before it"));
        }
        if fix.readings.iter().all(Option::is_none) {
            return fault(format!("{place} has no reading"));
        }
        for (reading, tracker) in fix.readings.iter().zip(trackers).filter_map(|(it, own)| Some((it.as_ref()?, own))) {
            let values = [reading.range_m, reading.azimuth_rad, reading.elevation_rad];
            if !values.iter().all(|value| value.is_finite()) || reading.range_m <= 0.0 {
                return fault(format!("{place}: the reading of {} is none", tracker.name));
            }
        }
    }
    Ok(())
}

/// Names the offsets that the flight cannot determine.
fn check_determined(trackers: &[Tracker], blocks: &[Block]) -> Result<(), Error> {
    let mut rows = BorderRows::new(3 * trackers.len());
    rows.add(blocks)?;
    let scales: Vec<f64> =
        (trackers.iter()).flat_map(|it| [it.sigma_range_m, it.sigma_azimuth_rad, it.sigma_elevation_rad]).collect();
    let names = offset_names(trackers);
    let undetermined: Vec<String> = (rows.solve(&scales).undetermined.iter())
        .map(|it| {
            it.iter().zip(&names).filter(|it| *it.0 != 0.0).map(|(c, name)| (*c, name.clone())).collect::<Vec<_>>()
        })
        .map(|it| in_words(&it))
        .collect();
    if undetermined.is_empty() {
        return Ok(());
    }
    let undetermined = undetermined.join("; ");
    Err(Error::Setting(format!(
        "the flight does not determine {undetermined}: give a prior of the offsets, or another tracker"
    )))
}

fn from(tracker: &Tracker, position: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| position[i] - tracker.place_m[i])
}

/// Where the first tracker that saw it has the balloon.
fn first_guess(trackers: &[Tracker], fix: &Fix) -> [f64; 3] {
    let seen = fix.readings.iter().zip(trackers).find_map(|(reading, tracker)| Some((reading.as_ref()?, tracker)));
    let (reading, tracker) = seen.expect("a fix has a reading");
    let horizontal = reading.range_m * reading.elevation_rad.cos();
    let relative = [
        horizontal * reading.azimuth_rad.sin(),
        horizontal * reading.azimuth_rad.cos(),
        reading.range_m * reading.elevation_rad.sin(),
    ];
    [0, 1, 2].map(|i| tracker.place_m[i] + relative[i])
}

/// The rows of a fix, linearised about a position.
fn rows(trackers: &[Tracker], fix: &Fix, position: [f64; 3], offsets: &[f64]) -> Block {
    let seen: Vec<usize> = (0..trackers.len()).filter(|&j| fix.readings[j].is_some()).collect();
    let n = 3 * seen.len();
    let (mut x, mut g) = (Mat::zeros(n, 3), Mat::zeros(n, 3 * trackers.len()));
    let (mut v, mut y) = (Mat::zeros(n, n), vec![0.0; n]);
    for (number, &j) in seen.iter().enumerate() {
        let (tracker, row) = (&trackers[j], 3 * number);
        let (read, model) = (fix.readings[j].expect("it was seen"), reading_of(tracker, position));
        let [east, north, up] = from(tracker, position);
        let range = model.range_m.max(f64::MIN_POSITIVE);
        let horizontal = east.hypot(north).max(1e-9 * range);
        let derivatives = [
            [east / range, north / range, up / range],
            [north / horizontal.powi(2), -east / horizontal.powi(2), 0.0],
            [
                -east * up / (horizontal * range * range),
                -north * up / (horizontal * range * range),
                horizontal / (range * range),
            ],
        ];
        let sigmas = [tracker.sigma_range_m, tracker.sigma_azimuth_rad, tracker.sigma_elevation_rad];
        let left = [
            read.range_m - model.range_m - offsets[3 * j],
            half_turn(read.azimuth_rad - model.azimuth_rad - offsets[3 * j + 1]),
            half_turn(read.elevation_rad - model.elevation_rad - offsets[3 * j + 2]),
        ];
        for kind in 0..3 {
            (0..3).for_each(|i| x[(row + kind, i)] = derivatives[kind][i]);
            g[(row + kind, 3 * j + kind)] = 1.0;
            v[(row + kind, row + kind)] = sigmas[kind].powi(2);
            y[row + kind] = left[kind];
        }
    }
    Block::Regression(RegressionRows { x, g, y, v })
}

/// The same angle from −π to π.
fn half_turn(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

fn flight(
    fixes: &[Fix],
    positions_m: Vec<[f64; 3]>,
    offsets: Vec<f64>,
    solution: &Solution,
    iterations: usize,
) -> Flight {
    let s = &solution.border_covariance;
    // C + D S D' of a position, or of the difference of two with D the difference of theirs.
    let sigmas = |covariances: &[&Mat<f64>], d: &Mat<f64>| {
        let spread = product(d.as_ref(), s.as_ref());
        let through = |i: usize| (0..d.ncols()).map(|j| spread[(i, j)] * d[(i, j)]).sum::<f64>();
        let own = |i: usize| covariances.iter().map(|it| it[(i, i)]).sum::<f64>();
        [0, 1, 2].map(|i| (own(i) + through(i)).sqrt())
    };
    let blocks = &solution.blocks;
    let sigma_positions_m = blocks.par_iter().map(|it| sigmas(&[&it.covariance], &it.sensitivity)).collect();
    let span = |k: usize| fixes[k + 1].seconds - fixes[k].seconds;
    let winds_m_per_s = (0..fixes.len() - 1)
        .map(|k| [0, 1, 2].map(|i| (positions_m[k + 1][i] - positions_m[k][i]) / span(k)))
        .collect();
    let sigma_wind = |k: usize| {
        let difference = &blocks[k + 1].sensitivity - &blocks[k].sensitivity;
        sigmas(&[&blocks[k].covariance, &blocks[k + 1].covariance], &difference).map(|sigma| sigma / span(k))
    };
    let rows: usize = fixes.iter().map(|fix| 3 * fix.readings.iter().flatten().count()).sum();
    let unknowns = 3 * fixes.len() + offsets.len();
    Flight {
        sigma_positions_m,
        winds_m_per_s,
        sigma_winds_m_per_s: (0..fixes.len() - 1).into_par_iter().map(sigma_wind).collect(),
        chi2_per_degree: if rows > unknowns { solution.residual_chi2 / (rows - unknowns) as f64 } else { 0.0 },
        positions_m,
        offsets,
        offsets_covariance: s.clone(),
        iterations,
    }
}
