//! The taper of covariances over distance.

use isobar_model::Grid;

/// The largest correlation length across a channel, in heights of the domain: a Gaussian of this length is within 5 × 10⁻⁵ of
/// 1 from wall to wall.
pub(super) const MOST_HEIGHTS: f64 = 100.0;

/// Widths of a domain beyond which a larger radius of localisation makes no difference.
pub(crate) const WIDEST: f64 = 10.0;

/// Whether a radius of localisation \[m\] is so wide that nothing is localised.
pub(crate) fn is_wide(grid: &Grid, radius_m: f64) -> bool {
    radius_m >= WIDEST * grid.width_m().max(grid.height_m())
}

/// The compactly supported fifth-order function of Gaspari and Cohn (1999), eq. (4.10), of distance over radius: 1 at 0,
/// near a Gaussian of standard deviation radius × 0.27, and 0 from 1 on.
pub fn gaspari_cohn(distance_over_radius: f64) -> f64 {
    let r = 2.0 * distance_over_radius;
    if r >= 2.0 {
        0.0
    } else if r >= 1.0 {
        4.0 - 5.0 * r + r.powi(2) * (5.0 / 3.0) + r.powi(3) * (5.0 / 8.0) - 0.5 * r.powi(4) + r.powi(5) / 12.0
            - 2.0 / (3.0 * r)
    } else {
        1.0 - r.powi(2) * (5.0 / 3.0) + r.powi(3) * (5.0 / 8.0) + 0.5 * r.powi(4) - 0.25 * r.powi(5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_taper_falls_smoothly_from_one_to_zero() {
        assert_eq!(gaspari_cohn(0.0), 1.0);
        // (4.10) at z = c: 5/24.
        assert!((gaspari_cohn(0.5) - 5.0 / 24.0).abs() < 1e-15);
        assert!(
            gaspari_cohn(1.0 - 1e-9).abs() < 1e-12 && gaspari_cohn(1.0) == 0.0 && gaspari_cohn(f64::INFINITY) == 0.0
        );
        let steps: Vec<f64> = (0..=1000).map(|i| gaspari_cohn(i as f64 / 1000.0)).collect();
        assert!(steps.windows(2).all(|pair| pair[1] <= pair[0] && pair[0] - pair[1] < 0.0025));
    }
}
