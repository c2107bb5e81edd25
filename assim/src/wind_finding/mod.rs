//! Wind-finding: one balloon flight as K consecutive positions and the calibration of the sensors that track it.
//!
//! It is a block-angular regression as in WO 93/22625, eqs. (15), (16) (and WO 90/13794): the positions are the blocks b_k, each
//! seen by the readings of its fix only, and the offsets of the trackers' range, azimuth and elevation are the border c,
//! constant over the flight. The trackers' equations are those of any sensor that measures range and two angles:
//!
//! ```text
//! range     = |b − p|                           + c_r + e
//! azimuth   = atan2(x, y)                       + c_a + e      (x, y, z) = b − p, p the tracker's place; from north,
//! elevation = atan2(z, √(x² + y²))              + c_e + e      clockwise
//! ```
//!
//! No position has a prior. Without a [`Motion`] the positions are independent of each other; with one, eq. (2) links
//! consecutive positions, and the chain of blocks is solved by nested dissection. The equations are linearised about the
//! present estimates and solved again until they stay (Gauss–Newton); the cost is linear in K. The wind between two fixes is the
//! difference of the positions, with its covariance: an error that both have through the calibration cancels.
//!
//! Flight after flight, the offsets with their covariance are the prior of the next flight, y_{K+1} = ĉ_{t−1} of eq. (16).

mod geometry;
mod linearised;
mod readings;

pub use geometry::reading_of;
pub use readings::{Fix, Motion, Reading, Tracker, offset_names};

use crate::block_angular::{BorderRows, Prior};
use crate::error::Error;
use crate::high_pass::in_words;
use faer::Mat;
use geometry::first_guess;
use isobar_model::vector::add;
use linearised::{Linearised, Solved};
use rayon::prelude::*;
use readings::{QUANTITIES, offsets_of};
use std::cmp::Ordering;

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
    /// Offsets of what trackers measure, in the order of [`offset_names`], in m and rad: to be subtracted from readings.
    pub offsets: Vec<f64>,
    /// Their covariance, `[p, p]`.
    pub offsets_covariance: Mat<f64>,
    /// Sum of squares of the whitened residuals over its expectation, the rows less the unknowns; 0 if there are no more
    /// rows than unknowns.
    pub chi2_per_degree: f64,
    /// Number of linearisations.
    pub iterations: usize,
}

/// Linearisations after which there is no hope.
const MOST_ITERATIONS: usize = 50;

/// The largest change of an offset that counts as no change, in standard deviations of the calibration.
const CONVERGED: f64 = 1e-6;

/// The largest change of a position that counts as no change \[m\].
const CONVERGED_M: f64 = 1e-4;

/// Finds positions, winds and offsets from the readings of a flight; `prior` is that of the offsets, in the order of
/// [`offset_names`].
///
/// # Errors
/// [`Error::Setting`] for readings that make no sense, with the fix, and for offsets that the flight does not determine,
/// with their names; [`Error::NotFinite`] if the linearisations do not come to an end; as
/// [`solve`](crate::block_angular::solve) else.
///
/// # Panics
/// If the prior has not as many values as there are offsets.
pub fn find_winds(
    trackers: &[Tracker],
    fixes: &[Fix],
    prior: Option<&Prior>,
    motion: Option<Motion>,
) -> Result<Flight, Error> {
    check(trackers, fixes, motion)?;
    // Eq. (2) links a fix with the one before and the one after it.
    let motion = motion.filter(|_| fixes.len() > 2);
    let mut positions = first_guess(trackers, fixes).ok_or_else(|| {
        let needed = "range and both angles of one tracker, or both angles of two";
        Error::Setting(format!("no fix has {needed}: there is no first guess of the balloon's place"))
    })?;
    let mut offsets = prior.map_or(vec![0.0; offsets_of(trackers).len()], |prior| prior.mean.clone());
    for iterations in 1..=MOST_ITERATIONS {
        let linearised = Linearised::new(trackers, fixes, &positions, &offsets);
        if iterations == 1 {
            check_determined(trackers, &linearised, fixes.len(), (prior.is_some(), motion.is_some()))?;
        }
        let relative = prior.map(|prior| Prior {
            mean: prior.mean.iter().zip(&offsets).map(|(mean, offset)| mean - offset).collect(),
            covariance: prior.covariance.clone(),
        });
        let solved = match motion {
            None => linearised.solve_blocks(relative.as_ref())?,
            Some(motion) => linearised.solve_chain(motion, (fixes, &positions), relative.as_ref())?,
        };
        let changes = solved.changes();
        positions.iter_mut().zip(&changes).for_each(|(position, change)| add(position, change));
        let (of_offsets, covariance) = solved.border();
        add(&mut offsets, of_offsets);
        let in_sigmas = of_offsets.iter().enumerate().map(|(i, change)| change.abs() / covariance[(i, i)].sqrt());
        let largest = |all: f64, it: f64| if it.is_nan() { f64::NAN } else { all.max(it) };
        let change = in_sigmas.fold(0.0, largest);
        let change_m = changes.as_flattened().iter().fold(0.0, |all: f64, it| largest(all, it.abs()));
        if !(change.is_finite() && change_m.is_finite()) {
            break;
        }
        if change < CONVERGED && change_m < CONVERGED_M {
            let rows = linearised.len() + if motion.is_some() { 3 * (fixes.len() - 2) } else { 0 };
            return Ok(flight(fixes, positions, offsets, &solved, (rows, iterations)));
        }
    }
    Err(Error::NotFinite { what: format!("the flight after {MOST_ITERATIONS} linearisations") })
}

fn check(trackers: &[Tracker], fixes: &[Fix], motion: Option<Motion>) -> Result<(), Error> {
    let fault = |what: String| Err(Error::Setting(what));
    let is_positive = |sigma: f64| sigma.is_finite() && sigma > 0.0;
    if fixes.is_empty() || trackers.is_empty() {
        return fault("a flight needs a tracker and a fix".into());
    }
    if motion.is_some_and(|motion| !is_positive(motion.sigma_change_m_per_s)) {
        return fault("the standard deviation of the change of the wind must be above 0".into());
    }
    for tracker in trackers {
        if !tracker.sigmas().iter().flatten().all(|sigma| is_positive(*sigma)) {
            return fault(format!("tracker {}: standard deviations must be above 0", tracker.name));
        }
        if tracker.sigmas().iter().all(Option::is_none) {
            return fault(format!("tracker {} measures nothing: it has no standard deviation", tracker.name));
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
        if fix.readings.iter().all(|reading| *reading == Reading::default()) {
            return fault(format!("{place} has no reading"));
        }
        for (reading, tracker) in fix.readings.iter().zip(trackers) {
            for (kind, (value, sigma)) in reading.values().iter().zip(tracker.sigmas()).enumerate() {
                let Some(value) = value else { continue };
                let (name, quantity) = (&tracker.name, QUANTITIES[kind]);
                if sigma.is_none() {
                    return fault(format!("{place}: {name} does not measure a {quantity}, but has one"));
                }
                if !value.is_finite() || (kind == 0 && *value <= 0.0) {
                    return fault(format!("{place}: {name} cannot read the {quantity} {value}"));
                }
            }
        }
    }
    Ok(())
}

/// Names the fixes and the offsets that the readings cannot determine. A motion helps positions; it is no calibration, so that
/// the offsets must be determined without it.
fn check_determined(
    trackers: &[Tracker],
    linearised: &Linearised,
    fixes: usize,
    (has_prior, has_motion): (bool, bool),
) -> Result<(), Error> {
    let determined: Vec<usize> = (0..fixes).filter(|&fix| linearised.rows_of(fix) >= 3).collect();
    if let Some(fix) = (0..fixes).find(|&fix| !has_motion && linearised.rows_of(fix) < 3) {
        return Err(Error::Setting(format!(
            "fix {} has fewer than three readings, which do not determine a place: leave it out, or assume a motion",
            fix + 1
        )));
    }
    if has_prior {
        return Ok(());
    }
    let blocks: Vec<_> = determined.par_iter().map(|&fix| linearised.block(fix)).collect();
    let scales: Vec<f64> = trackers.iter().flat_map(|tracker| tracker.sigmas().into_iter().flatten()).collect();
    let mut rows = BorderRows::new(scales.len());
    rows.add(&blocks)?;
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

/// Positions and winds with their standard deviations; `numbers` are those of rows and linearisations.
fn flight(
    fixes: &[Fix],
    positions_m: Vec<[f64; 3]>,
    offsets: Vec<f64>,
    solved: &Solved,
    (rows, iterations): (usize, usize),
) -> Flight {
    let moments = solved.moments();
    let sigma_position = |k: usize| {
        let through = solved.through_offsets(solved.sensitivity(k));
        [0, 1, 2].map(|i| (moments.variances[k][i] + through[i]).sqrt())
    };
    let span = |k: usize| fixes[k + 1].seconds - fixes[k].seconds;
    let wind = |k: usize| [0, 1, 2].map(|i| (positions_m[k + 1][i] - positions_m[k][i]) / span(k));
    // Var(b_{k+1} − b_k) = C_{k+1} + C_k − 2 C_{k,k+1} + D S D', D the difference of their sensitivities.
    let sigma_wind = |k: usize| {
        let through = solved.through_offsets((solved.sensitivity(k + 1) - solved.sensitivity(k)).as_ref());
        let given = |i: usize| moments.variances[k][i] + moments.variances[k + 1][i] - 2.0 * moments.with_next[k][i];
        [0, 1, 2].map(|i| (given(i) + through[i]).max(0.0).sqrt() / span(k))
    };
    let winds = 0..fixes.len() - 1;
    let unknowns = 3 * fixes.len() + offsets.len();
    Flight {
        sigma_positions_m: (0..fixes.len()).into_par_iter().map(sigma_position).collect(),
        winds_m_per_s: winds.clone().map(wind).collect(),
        sigma_winds_m_per_s: winds.into_par_iter().map(sigma_wind).collect(),
        chi2_per_degree: if rows > unknowns { solved.residual_chi2() / (rows - unknowns) as f64 } else { 0.0 },
        offsets_covariance: solved.border().1.to_owned(),
        positions_m,
        offsets,
        iterations,
    }
}
