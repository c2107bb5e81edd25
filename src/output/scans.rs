//! The biases of scanning instruments by scan position.

use crate::event::Analysed;
use isobar_obs::{ObservationType, ObservationWindow};
use std::collections::BTreeMap;

/// The biases of a type of observations by scan position, in one cycle: means over the footprints of each position, which differ
/// only where a bias depends on more than the position.
#[derive(Debug)]
pub struct ScanBiases {
    /// The cycle.
    pub cycle: usize,
    /// The scan positions s ∈ \[−1, 1\], in their order.
    pub positions: Vec<f64>,
    /// The true biases by position.
    pub truth: Vec<f64>,
    /// The bias and its claimed σ that each method has found, by position; nothing of one that estimates no biases.
    pub methods: Vec<Option<Vec<[f64; 2]>>>,
    /// For each footprint the numbers of the observation and of its position.
    pub footprints: Vec<[usize; 2]>,
}

impl ScanBiases {
    /// Those of all types of a window's observations that are made at several scan positions, by a number of methods that have
    /// not analysed them yet.
    pub fn all(
        window: &ObservationWindow,
        values_bias_removed: &[f64],
        methods: usize,
    ) -> BTreeMap<ObservationType, Self> {
        let mut found: BTreeMap<ObservationType, Vec<(usize, f64)>> = BTreeMap::new();
        for (number, report) in window.reports.iter().enumerate() {
            if let Some(scan) = report.scan {
                found.entry(report.observation_type()).or_default().push((number, scan));
            }
        }
        let of_type = |scans: Vec<(usize, f64)>| {
            let mut positions: Vec<f64> = scans.iter().map(|scan| scan.1).collect();
            positions.sort_by(f64::total_cmp);
            positions.dedup();
            let place = |scan: f64| positions.binary_search_by(|own| own.total_cmp(&scan)).ok();
            let footprints = scans.iter().filter_map(|&(number, scan)| Some([number, place(scan)?])).collect();
            let methods = (0..methods).map(|_| None).collect();
            let mut own = Self { cycle: window.cycle, positions, truth: Vec::new(), methods, footprints };
            own.truth = own.means(|number| window.values[number] - values_bias_removed[number]);
            own
        };
        found.into_iter().map(|(kind, scans)| (kind, of_type(scans))).filter(|(_, it)| it.positions.len() > 1).collect()
    }

    /// Takes what a method has found in the values of the window: y − (y − g ĉ) is the estimate of the bias of y.
    pub fn add(&mut self, analysed: &Analysed<'_>, values: &[f64]) {
        let Some(readings) = analysed.readings.as_deref().filter(|it| it.values.len() >= values.len()) else { return };
        let biases = self.means(|number| values[number] - readings.values[number]);
        let sigmas = self.means(|number| readings.sigma[number]);
        self.methods[analysed.method] =
            Some(biases.into_iter().zip(sigmas).map(|(bias, sigma)| [bias, sigma]).collect());
    }

    /// The mean of a number of each footprint by position.
    fn means(&self, of: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut sums = vec![(0.0, 0.0); self.positions.len()];
        for &[number, position] in &self.footprints {
            let sum = &mut sums[position];
            *sum = (sum.0 + of(number), sum.1 + 1.0);
        }
        sums.into_iter().map(|(sum, count)| sum / count).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::Time;
    use isobar_obs::{Aside, LinearOperator, Report};
    use std::sync::Arc;

    #[test]
    fn means_are_over_the_footprints_of_a_position() {
        let scans = [Some(1.0), None, Some(-1.0), Some(1.0)];
        let time = Time::from_seconds(0);
        let report = |scan: &Option<f64>| Report {
            network: if scan.is_some() { "polar".into() } else { "sondes".into() },
            platform: "p".into(),
            variable: 0,
            x_m: 0.0,
            y_m: 0.0,
            scan: *scan,
        };
        let window = ObservationWindow {
            time,
            cycle: 7,
            reports: scans.iter().map(report).collect(),
            times: vec![time; 4],
            values: vec![10.0, 20.0, 30.0, 40.0],
            sigma: vec![1.0; 4],
            error_regression: Default::default(),
            aside: Aside { checks: Vec::new(), unused: Vec::new(), operator: Arc::new(LinearOperator::default()) },
            comparisons: Vec::new(),
            operator: Arc::new(LinearOperator::default()),
        };
        let all = ScanBiases::all(&window, &[8.0, 20.0, 25.0, 36.0], 2);
        let [(kind, own)] = all.iter().collect::<Vec<_>>()[..] else { panic!("{all:?}") };
        assert_eq!((&*kind.network, own.cycle, &own.positions[..]), ("polar", 7, &[-1.0, 1.0][..]));
        // (10 − 8 + 40 − 36) / 2 at the right.
        assert_eq!(own.truth, [5.0, 3.0]);
        assert!(own.methods.iter().all(Option::is_none));
    }
}
