//! Localisation: correlations over long distances, which a small ensemble cannot know, are tapered off.

use crate::covariance::{WIDEST, gaspari_cohn, is_wide};
use isobar_model::{Boundary, Grid};

/// A taper on a plane: Gaspari and Cohn's function, where the plane is periodic summed over the images of a place and
/// divided by the sum for the place itself. So it is positive semidefinite for any radius; with that of the nearest image
/// alone it would not be where the radius exceeds half of the domain.
#[derive(Clone, Debug)]
pub(super) struct Taper {
    radius_m: f64,
    /// Distances between the images in x and in y \[m\], and how many there are to either side.
    periods_m: [f64; 2],
    images: [i32; 2],
    /// Whether all weights are 1.
    is_wide: bool,
    /// The sum for the place itself.
    total: f64,
}

impl Taper {
    /// The taper that ends at a radius \[m\]; infinite for none.
    pub fn new(grid: &Grid, radius_m: f64) -> Self {
        let periods_m = [grid.width_m(), grid.height_m()];
        let [x, y] = periods_m.map(|period| (radius_m / period).min(WIDEST).ceil() as i32);
        let images = [x, if grid.boundary == Boundary::Periodic { y } else { 0 }];
        let is_wide = is_wide(grid, radius_m);
        let mut taper = Self { radius_m, periods_m, images, is_wide, total: 1.0 };
        taper.total = taper.weight((0.0, 0.0), (0.0, 0.0));
        taper
    }

    /// Where it ends \[m\]; infinite where it is the same everywhere.
    pub fn radius_m(&self) -> f64 {
        if self.is_wide { f64::INFINITY } else { self.radius_m }
    }

    /// The share of the plane that is near a place.
    pub fn reach(&self) -> f64 {
        let [width, height] = self.periods_m.map(|period| (2.0 * self.radius_m / period).min(1.0));
        width * height
    }

    /// Whether a distance in one direction, and that the other way round, is too far for a weight. Beyond the period it is
    /// not known.
    fn is_far(&self, distance_m: f64, direction: usize) -> bool {
        let distance_m = distance_m.abs();
        let around_m = if self.images[direction] > 0 { self.periods_m[direction] - distance_m } else { f64::INFINITY };
        distance_m >= self.radius_m && around_m >= self.radius_m
    }

    /// The weight of one place in the analysis of another.
    pub fn weight(&self, a: (f64, f64), b: (f64, f64)) -> f64 {
        if self.is_wide {
            return 1.0;
        }
        if self.is_far(a.0 - b.0, 0) || self.is_far(a.1 - b.1, 1) {
            return 0.0;
        }
        let mut sum = 0.0;
        for i in -self.images[0]..=self.images[0] {
            let dx = a.0 - b.0 + f64::from(i) * self.periods_m[0];
            if dx.abs() < self.radius_m {
                for j in -self.images[1]..=self.images[1] {
                    let dy = a.1 - b.1 + f64::from(j) * self.periods_m[1];
                    if dy.abs() < self.radius_m {
                        sum += gaspari_cohn((dx * dx + dy * dy).sqrt() / self.radius_m);
                    }
                }
            }
        }
        sum / self.total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_go_around_a_periodic_domain_but_not_through_walls() {
        let grid = |boundary| Grid { nx: 10, ny: 8, dx_m: 1.0, dy_m: 1.0, boundary };
        let (near, far) = ((0.5, 0.5), (9.5, 7.5));
        let periodic = Taper::new(&grid(Boundary::Periodic), 4.0);
        assert!((periodic.weight(near, far) - gaspari_cohn(2f64.sqrt() / 4.0)).abs() < 1e-15);
        let channel = Taper::new(&grid(Boundary::Channel), 4.0);
        assert_eq!(channel.weight(near, far), 0.0);
        assert!((channel.weight(near, (9.5, 0.5)) - gaspari_cohn(0.25)).abs() < 1e-15);
        assert_eq!(Taper::new(&grid(Boundary::Channel), f64::INFINITY).weight(near, far), 1.0);
    }

    #[test]
    fn it_is_positive_semidefinite_for_any_radius() {
        let grid = Grid { nx: 5, ny: 4, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
        for radius in [1.5, 3.5, 8.0, 30.0] {
            let taper = Taper::new(&grid, radius);
            let place = |cell: usize| ((cell % 5) as f64, (cell / 5) as f64);
            let matrix = faer::Mat::from_fn(20, 20, |i, j| taper.weight(place(i), place(j)));
            let eigenvalues = matrix.self_adjoint_eigenvalues(faer::Side::Lower).unwrap();
            assert!(eigenvalues[0] > -1e-12, "{radius}: {}", eigenvalues[0]);
            assert!((taper.weight(place(7), place(7)) - 1.0).abs() < 1e-15);
        }
    }
}
