//! How many directions of a covariance hold most of its energy.

/// Eigenvalues λ of S⁻¹ (U Uᵀ − W) S⁻¹, with S = diag(scales) and the white part W: the largest multiple of the identity that
/// can be taken from each component.
///
/// A homogeneous component on a periodic plane has an eigenvalue for each wave number, its spectral density there, summed
/// over the variables if they all follow from one field; in a channel each wave of the array that goes on beyond the walls
/// counts as the grid's share of that array, the limit for a wide channel (Szegő; Gray 2006, Toeplitz and Circulant
/// Matrices, section 4.2). The eigenvalues of a sum are taken to be those of its components. That is exact where these are of
/// different variables; else as many directions hold no less (Fan 1949, Proc. Natl. Acad. Sci. 35).
#[derive(Clone, Debug, Default)]
pub struct Spectrum {
    /// Each eigenvalue, and how many directions have it.
    values: Vec<(f64, f64)>,
}

impl Spectrum {
    /// Eigenvalues, each with this number of directions, less the smallest, which is the white part.
    pub(super) fn above_white(eigenvalues: &[f64], directions: f64) -> Self {
        let white = eigenvalues.iter().fold(f64::INFINITY, |least, &value| least.min(value)).max(0.0);
        Self::new(eigenvalues.iter().map(|value| value - white), directions)
    }

    /// Eigenvalues, each with this number of directions.
    pub(super) fn new(eigenvalues: impl Iterator<Item = f64>, directions: f64) -> Self {
        Self { values: eigenvalues.map(|value| (value, directions)).collect() }
    }

    /// That of the sum of independent errors.
    pub(super) fn with(mut self, other: Self) -> Self {
        self.values.extend(other.values);
        self
    }

    /// The number of leading directions that hold this share of what is not white,
    ///
    /// ```text
    /// N(f) = min { n : Σ_(i ≤ n) λ_i ≥ f Σ_i λ_i },    λ_1 ≥ λ_2 ≥ …
    /// ```
    ///
    /// For a Gaussian correlation exp(−r²/2L²) on a plane that is much larger, λ ~ exp(−k²L²/2), with one wave for each
    /// 4π²/area of the plane of wave numbers, so that with x = k²L²/2
    ///
    /// ```text
    /// N = x area / 2πL²,    1 − f = e^−x,    or (1 + x) e^−x for the winds that balance it.
    /// ```
    pub fn holding(&self, share: f64) -> usize {
        let mut values: Vec<(f64, f64)> = self.values.iter().copied().filter(|(value, _)| *value > 0.0).collect();
        values.sort_by(|a, b| b.0.total_cmp(&a.0));
        let all: f64 = values.iter().map(|(value, directions)| value * directions).sum();
        let (mut held, mut number) = (0.0, 0.0);
        for (value, directions) in values {
            // Rounding may leave the last of them a little short.
            if held >= share.min(1.0 - 1e-14) * all {
                break;
            }
            held += value * directions;
            number += directions;
        }
        number.ceil() as usize
    }
}

#[cfg(test)]
mod tests {
    use crate::covariance::{Balanced, BalancedParameters, Covariance, Sum, Univariate, White, dense};
    use faer::Side;
    use isobar_model::{Boundary, Grid, Layout, shallow_water};

    fn layout(n: usize, boundary: Boundary) -> std::sync::Arc<Layout> {
        shallow_water::layout(Grid { nx: n, ny: n, dx_m: 200e3, dy_m: 200e3, boundary })
    }

    fn balanced(layout: &Layout) -> Balanced {
        let parameters = BalancedParameters {
            sigma_height_m: 2.0,
            length_m: 500e3,
            gravity_m_per_s2: 9.8,
            coriolis_per_s: 1e-4,
            beta_per_m_per_s: 0.0,
            balanced_at_walls: false,
        };
        Balanced::new(layout, &parameters).unwrap()
    }

    /// The number by the eigenvalues of the whole matrix.
    fn of_matrix(covariance: &dyn Covariance, scales: &[f64], share: f64) -> usize {
        let mut matrix = dense(covariance);
        for j in 0..matrix.ncols() {
            (0..matrix.nrows()).for_each(|i| matrix[(i, j)] /= scales[i] * scales[j]);
        }
        let values = matrix.self_adjoint_eigenvalues(Side::Lower).unwrap();
        let all: f64 = values.iter().sum();
        let mut held = 0.0;
        1 + values
            .iter()
            .rev()
            .position(|value| {
                held += value;
                held >= share * all
            })
            .unwrap()
    }

    #[test]
    fn on_a_periodic_plane_it_is_that_of_the_matrix() {
        let layout = layout(12, Boundary::Periodic);
        let scales: Vec<f64> = (0..layout.len()).map(|value| [2.0, 0.5, 0.7][value / 144]).collect();
        let univariate = |variable| Univariate::new(&layout, variable, 1.0 + variable as f64, 450e3).unwrap();
        let of_different =
            Sum::new(layout.len(), (0..3).map(|v| Box::new(univariate(v)) as Box<dyn Covariance>).collect());
        let all: [&dyn Covariance; 3] = [&balanced(&layout), &univariate(1), &of_different];
        for covariance in all {
            let spectrum = covariance.spectrum(&scales).unwrap();
            for share in [0.5, 0.9, 0.99, 0.999, 0.9999] {
                // Rounding orders equal eigenvalues, and decides whether the last of them is needed.
                let (found, expected) = (spectrum.holding(share), of_matrix(covariance, &scales, share));
                assert!(found.abs_diff(expected) <= 1, "{share}: {found}, not {expected}");
            }
        }
    }

    #[test]
    fn in_a_channel_it_is_nearly_that_of_the_matrix() {
        let layout = layout(20, Boundary::Channel);
        let scales = vec![1.0; layout.len()];
        for covariance in [&balanced(&layout) as &dyn Covariance, &Univariate::new(&layout, 0, 1.0, 500e3).unwrap()] {
            let spectrum = covariance.spectrum(&scales).unwrap();
            for share in [0.9, 0.99, 0.999] {
                let (found, expected) = (spectrum.holding(share) as f64, of_matrix(covariance, &scales, share) as f64);
                assert!((found / expected - 1.0).abs() < 0.15, "{share}: {found}, not {expected}");
            }
        }
    }

    /// The closed forms of a large plane.
    #[test]
    fn a_gaussian_has_as_many_as_its_spectral_density_says() {
        let layout = layout(40, Boundary::Periodic);
        let (area, length) = (8000e3_f64.powi(2), 600e3);
        let univariate = Univariate::new(&layout, 0, 3.0, length).unwrap().spectrum(&vec![7.0; layout.len()]).unwrap();
        for share in [0.9, 0.99, 0.999_f64] {
            let expected = -(1.0 - share).ln() * area / (std::f64::consts::TAU * length * length);
            assert!((univariate.holding(share) as f64 / expected - 1.0).abs() < 0.05, "{share}");
        }
        // All the energy is in the winds where the height has a large scale.
        let scales: Vec<f64> = (0..layout.len()).map(|value| if value < 1600 { 1e6 } else { 1.0 }).collect();
        let (spectrum, x) = (balanced(&layout).spectrum(&scales).unwrap(), 6.638_352);
        let expected = x * area / (std::f64::consts::TAU * 500e3_f64.powi(2));
        assert!((spectrum.holding(0.99) as f64 / expected - 1.0).abs() < 0.1, "{} {expected}", spectrum.holding(0.99));
    }

    #[test]
    fn what_is_white_has_none_and_more_energy_needs_more() {
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            let layout = layout(12, boundary);
            let scales = vec![1.0; layout.len()];
            let white = |variable| Box::new(White::new(&layout, variable, 3.0)) as Box<dyn Covariance>;
            // Nothing is correlated over a hundredth of a cell.
            let narrow = || Box::new(Univariate::new(&layout, 0, 1.0, 2e3).unwrap()) as Box<dyn Covariance>;
            for terms in [vec![], vec![white(0), white(1)], vec![narrow()], vec![white(0), narrow()]] {
                let spectrum = Sum::new(layout.len(), terms).spectrum(&scales).unwrap();
                assert_eq!([0.5, 1.0].map(|share| spectrum.holding(share)), [0, 0]);
            }
            let smooth = Sum::new(layout.len(), vec![Box::new(balanced(&layout)), white(0)]).spectrum(&scales).unwrap();
            let numbers = [0.5, 0.9, 0.99, 0.999, 0.9999, 1.0].map(|share| smooth.holding(share));
            assert!(numbers[0] > 0 && numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
            assert_eq!(smooth.holding(0.99), balanced(&layout).spectrum(&scales).unwrap().holding(0.99));
        }
    }
}
