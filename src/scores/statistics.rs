//! How well a mean over cycles is known, and whether two methods differ.
//!
//! The errors of successive cycles resemble each other, so n cycles tell less than n independent ones would. With the
//! lag-1 autocorrelation r of the cycles' mean squares, taken as a first-order autoregressive series, they are worth
//!
//! ```text
//! n' = n (1 − r) / (1 + r)
//! ```
//!
//! independent values (Wilks, Statistical Methods in the Atmospheric Sciences, 3rd ed. 2011, eq. 5.12; Zwiers and von
//! Storch 1995, J. Climate 8, 336–351), with 0 ≤ r and therefore n' ≤ n. The estimate of r from a short series is too
//! small by (1 + 4r)/n on average (Kendall 1954; Marriott and Pope 1954, Biometrika 41, 390–402), which is added. The 95 %
//! interval of the mean is then m ± t s/√n', with s the standard deviation of the values and t the quantile of Student's
//! distribution with n' − 1 degrees of freedom. With n' < 3 there is no interval.

use serde::{Deserialize, Serialize};

/// The fewest independent values that give an interval.
const FEWEST: f64 = 3.0;

/// The mean of a series with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// The mean.
    pub mean: f64,
    /// Number of values.
    pub count: usize,
    /// Number of independent values that they are worth.
    pub effective: f64,
    /// Half the width of the 95 % interval; `None` if there are too few independent values.
    pub half_width: Option<f64>,
}

impl Mean {
    /// `squares` is the sum of squared deviations from the mean.
    fn new(mean: f64, squares: f64, count: usize, effective: f64) -> Self {
        let half_width = (effective >= FEWEST)
            .then(|| student_quantile(effective - 1.0) * (squares / (count as f64 - 1.0) / effective).sqrt())
            .filter(|half_width| half_width.is_finite());
        Self { mean, count, effective, half_width }
    }

    /// The 95 % interval.
    pub fn interval(&self) -> Option<Interval> {
        self.half_width.map(|half_width| Interval { low: self.mean - half_width, high: self.mean + half_width })
    }
}

/// A 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
}

impl Interval {
    /// Half its width.
    pub fn half_width(&self) -> f64 {
        0.5 * (self.high - self.low)
    }

    /// Whether it does not hold zero: whether a difference with this interval is significant at the level of 5 %.
    pub fn excludes_zero(&self) -> bool {
        self.low > 0.0 || self.high < 0.0
    }
}

/// The mean of successive values and how well it is known; `None` if there are none, or one is not finite.
pub fn mean(values: &[f64]) -> Option<Mean> {
    let count = values.len();
    if count == 0 || values.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let n = count as f64;
    let mean = values.iter().sum::<f64>() / n;
    let deviations: Vec<f64> = values.iter().map(|value| value - mean).collect();
    let squares: f64 = deviations.iter().map(|deviation| deviation * deviation).sum();
    let products: f64 = deviations.windows(2).map(|pair| pair[0] * pair[1]).sum();
    let effective = effective_count(n, if squares > 0.0 { products / squares } else { 0.0 });
    Some(Mean::new(mean, squares, count, effective))
}

/// The mean of independent values and how well it is known, with n' = n; `None` as for [`mean`].
pub fn independent_mean(values: &[f64]) -> Option<Mean> {
    let count = values.len();
    if count == 0 || values.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let n = count as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares = values.iter().map(|value| (value - mean).powi(2)).sum();
    Some(Mean::new(mean, squares, count, n))
}

/// The interval of the root of a mean of squares: the ends' roots.
pub fn root_interval(squares: &[f64]) -> Option<Interval> {
    let Mean { mean, half_width, .. } = mean(squares)?;
    let half_width = half_width?;
    Some(Interval { low: (mean - half_width).max(0.0).sqrt(), high: (mean + half_width).sqrt() })
}

/// The difference of two root-mean-square errors over the same cycles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// The second minus the first.
    pub difference: f64,
    /// Its 95 % interval; `None` if there are too few independent cycles.
    pub interval: Option<Interval>,
}

impl Difference {
    /// Whether the interval does not hold zero: the difference is significant at the level of 5 %. `None` without one.
    pub fn is_significant(&self) -> Option<bool> {
        self.interval.map(|interval| interval.excludes_zero())
    }
}

/// Compares the mean squares of the same cycles, pair by pair: what makes a cycle difficult for both drops out.
///
/// With a = RMSE of the first and b of the second, the mean m of the differences of squares is b² − a², hence
/// b − a = m/(a + b), and the interval of m becomes that of b − a in the same way. `None` if the series differ in length,
/// are empty or not finite.
pub fn difference(first: &[f64], second: &[f64]) -> Option<Difference> {
    if first.len() != second.len() {
        return None;
    }
    let pairs: Vec<f64> = first.iter().zip(second).map(|(first, second)| second - first).collect();
    let sum = mean(first)?.mean.sqrt() + mean(second)?.mean.sqrt();
    let Mean { mean, half_width, .. } = mean(&pairs)?;
    let factor = if sum > 0.0 { 1.0 / sum } else { 0.0 };
    let interval = half_width.map(|half| Interval { low: factor * (mean - half), high: factor * (mean + half) });
    Some(Difference { difference: factor * mean, interval })
}

/// n' from the sample's lag-1 autocorrelation.
fn effective_count(n: f64, autocorrelation: f64) -> f64 {
    let r = (autocorrelation + (1.0 + 4.0 * autocorrelation) / n).clamp(0.0, 1.0);
    n * (1.0 - r) / (1.0 + r)
}

/// The 97.5 % quantile of Student's distribution with at least two degrees of freedom, to better than 1 % (Abramowitz and
/// Stegun 1964, eq. 26.7.5).
fn student_quantile(degrees: f64) -> f64 {
    let z: f64 = 1.959_963_984_540_054;
    let powers = |coefficients: &[(f64, i32)]| coefficients.iter().map(|(c, power)| c * z.powi(*power)).sum::<f64>();
    let terms = [
        powers(&[(1.0, 3), (1.0, 1)]) / 4.0,
        powers(&[(5.0, 5), (16.0, 3), (3.0, 1)]) / 96.0,
        powers(&[(3.0, 7), (19.0, 5), (17.0, 3), (-15.0, 1)]) / 384.0,
        powers(&[(79.0, 9), (776.0, 7), (1482.0, 5), (-1920.0, 3), (-945.0, 1)]) / 92_160.0,
    ];
    terms.iter().zip(1..).fold(z, |sum, (term, power)| sum + term / degrees.powi(power))
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    /// A first-order autoregressive series with mean 10 and variance 1.
    fn series(number: usize, length: usize, r: f64) -> Vec<f64> {
        let noise = standard_normals(&mut stream(7, &format!("series {number}")), length);
        let mut value = noise[0];
        let next = |noise: &f64| {
            let now = value;
            value = r * value + (1.0 - r * r).sqrt() * noise;
            10.0 + now
        };
        noise.iter().map(next).collect()
    }

    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (degrees, expected) in [(2.0, 4.303), (3.0, 3.182), (5.0, 2.571), (10.0, 2.228), (30.0, 2.042)] {
            let found = student_quantile(degrees);
            assert!((found / expected - 1.0_f64).abs() < 0.01, "{degrees}: {found}");
        }
    }

    #[test]
    fn the_interval_holds_the_mean_as_often_as_it_says() {
        for (r, length, least) in [(0.0, 40, 0.93), (0.5, 60, 0.92), (0.8, 120, 0.90)] {
            let intervals = (0..1000).filter_map(|number| mean(&series(number, length, r)));
            let intervals: Vec<Mean> = intervals.filter(|mean| mean.half_width.is_some()).collect();
            let hits = intervals.iter().filter(|it| (it.mean - 10.0).abs() < it.half_width.unwrap_or(0.0)).count();
            let share = hits as f64 / intervals.len() as f64;
            assert!(intervals.len() > 900 && share > least && share < 0.985, "r = {r}: {share} of {}", intervals.len());
        }
    }

    #[test]
    fn as_if_independent_the_interval_would_be_far_too_small() {
        let values = series(1, 400, 0.8);
        let mean = mean(&values).unwrap();
        assert!(mean.effective < 0.25 * 400.0 && mean.effective > 10.0, "{mean:?}");
    }

    #[test]
    fn paired_differences_are_found_where_the_scores_alone_would_not_show_them() {
        let first: Vec<f64> = series(3, 60, 0.5).iter().map(|value| value * value).collect();
        let noise = series(4, 60, 0.0);
        let second: Vec<f64> = first.iter().zip(noise).map(|(first, noise)| 0.97 * first + 0.01 * noise).collect();
        let difference = difference(&first, &second).unwrap();
        let root = |values: &[f64]| (values.iter().sum::<f64>() / 60.0).sqrt();
        assert!((difference.difference - (root(&second) - root(&first))).abs() < 1e-12);
        assert_eq!(difference.is_significant(), Some(true));
        let [a, b] = [&first, &second].map(|values| root_interval(values).unwrap());
        assert!(a.low < b.high && b.low < a.high, "the intervals overlap all the same");
        let same = super::difference(&first, &first).unwrap();
        assert_eq!((same.difference, same.is_significant()), (0.0, Some(false)));
    }

    #[test]
    fn too_little_is_no_interval() {
        assert_eq!(mean(&[]), None);
        assert_eq!(mean(&[1.0, f64::NAN]), None);
        assert_eq!(root_interval(&[1.0, 2.0]), None);
        assert_eq!(root_interval(&(0..30).map(f64::from).collect::<Vec<_>>()), None, "a trend has no mean");
        assert_eq!(difference(&[1.0], &[1.0, 2.0]), None);
        assert_eq!(root_interval(&[4.0; 9]), Some(Interval { low: 2.0, high: 2.0 }));
    }
}
