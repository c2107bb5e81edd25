//! The plane's place on the Earth: Lambert's azimuthal equal-area projection of a sphere.

use isobar_model::Grid;
use serde::{Deserialize, Serialize};

/// Radius of the sphere \[m\] (the one of the WRF and GRIB communities).
pub const EARTH_RADIUS_M: f64 = 6_371_229.0;

/// Lambert azimuthal equal-area projection about a centre that lies at the middle of the domain
/// (Snyder 1987, *Map Projections: A Working Manual*, eqs. 24-2 to 24-4 and 20-14 to 20-18).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Projection {
    /// Latitude of the centre \[degrees north\].
    pub center_latitude_deg: f64,
    /// Longitude of the centre \[degrees east\].
    pub center_longitude_deg: f64,
    /// x of the centre on the plane \[m\].
    pub false_easting_m: f64,
    /// y of the centre on the plane \[m\].
    pub false_northing_m: f64,
}

impl Projection {
    /// The projection whose centre lies at the middle of the grid's domain.
    pub fn centered(grid: &Grid, center_latitude_deg: f64, center_longitude_deg: f64) -> Self {
        let (false_easting_m, false_northing_m) = (0.5 * grid.width_m(), 0.5 * grid.height_m());
        Self { center_latitude_deg, center_longitude_deg, false_easting_m, false_northing_m }
    }

    /// The point of the plane (x, y) \[m\] of a place on the sphere; `None` for the centre's antipode.
    pub fn forward(&self, latitude_deg: f64, longitude_deg: f64) -> Option<(f64, f64)> {
        let (sin_lat, cos_lat) = latitude_deg.to_radians().sin_cos();
        let (sin_center, cos_center) = self.center_latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = (longitude_deg - self.center_longitude_deg).to_radians().sin_cos();
        let denominator = 1.0 + sin_center * sin_lat + cos_center * cos_lat * cos_lon;
        if denominator <= 1e-12 {
            return None;
        }
        let scale = EARTH_RADIUS_M * (2.0 / denominator).sqrt();
        let x = scale * cos_lat * sin_lon;
        let y = scale * (cos_center * sin_lat - sin_center * cos_lat * cos_lon);
        Some((self.false_easting_m + x, self.false_northing_m + y))
    }

    /// The direction of north at a place on the sphere: the angle from the plane's y axis to the meridian, positive
    /// clockwise \[radians\]; 0 at the centre's antipode. A wind (u, v) to the east and north there is
    /// (u cos γ + v sin γ, v cos γ − u sin γ) along x and y. The projection keeps areas, not angles: away from the centre the
    /// parallel is not quite perpendicular to the meridian.
    pub fn north(&self, latitude_deg: f64, longitude_deg: f64) -> f64 {
        let (sin_lat, cos_lat) = latitude_deg.to_radians().sin_cos();
        let (sin_center, cos_center) = self.center_latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = (longitude_deg - self.center_longitude_deg).to_radians().sin_cos();
        let denominator = 1.0 + sin_center * sin_lat + cos_center * cos_lat * cos_lon;
        if denominator <= 1e-12 {
            return 0.0;
        }
        // x = k X and y = k Y with k = √(2 / D); derivatives by latitude over k.
        let change = -0.5 * (sin_center * cos_lat - cos_center * sin_lat * cos_lon) / denominator;
        let x = change * cos_lat * sin_lon - sin_lat * sin_lon;
        let y = change * (cos_center * sin_lat - sin_center * cos_lat * cos_lon)
            + cos_center * cos_lat
            + sin_center * sin_lat * cos_lon;
        x.atan2(y)
    }

    /// Latitude and longitude \[degrees\] of a point of the plane; `None` where the plane leaves the sphere.
    pub fn inverse(&self, x_m: f64, y_m: f64) -> Option<(f64, f64)> {
        let (x, y) = (x_m - self.false_easting_m, y_m - self.false_northing_m);
        let rho = x.hypot(y);
        if rho > 2.0 * EARTH_RADIUS_M {
            return None;
        }
        if rho == 0.0 {
            return Some((self.center_latitude_deg, self.center_longitude_deg));
        }
        let (sin_c, cos_c) = (2.0 * (rho / (2.0 * EARTH_RADIUS_M)).asin()).sin_cos();
        let (sin_center, cos_center) = self.center_latitude_deg.to_radians().sin_cos();
        let latitude = (cos_c * sin_center + y * sin_c * cos_center / rho).clamp(-1.0, 1.0).asin();
        let longitude = (x * sin_c).atan2(rho * cos_center * cos_c - y * sin_center * sin_c);
        Some((latitude.to_degrees(), self.center_longitude_deg + longitude.to_degrees()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::Boundary;

    fn about(center_latitude_deg: f64, center_longitude_deg: f64) -> Projection {
        Projection { center_latitude_deg, center_longitude_deg, false_easting_m: 1e6, false_northing_m: 2e6 }
    }

    /// Snyder 1987, numerical example of the spherical form, pp. 332–333: a sphere of radius 3 about 40° N, 100° W;
    /// the point 20° S, 100° E has x = −4.2339303, y = 4.0257775.
    #[test]
    fn forward_and_inverse_are_those_of_snyders_example() {
        let projection = about(40.0, -100.0);
        let scale = EARTH_RADIUS_M / 3.0;
        let (x, y) = projection.forward(-20.0, 100.0).unwrap();
        let (x, y) = ((x - 1e6) / scale, (y - 2e6) / scale);
        assert!((x + 4.2339303).abs() < 1e-7 && (y - 4.0257775).abs() < 1e-7, "{x} {y}");
        let (latitude, longitude) = projection.inverse(1e6 - 4.2339303 * scale, 2e6 + 4.0257775 * scale).unwrap();
        assert!((latitude + 20.0).abs() < 1e-5 && (longitude + 260.0).abs() < 1e-5, "{latitude} {longitude}");
    }

    #[test]
    fn inverse_undoes_forward() {
        let projection = about(52.5, 14.0);
        for latitude in [-80.0, 0.0, 35.0, 52.5, 70.0, 90.0] {
            for longitude in [-100.0, -12.0, 14.0, 40.0, 150.0] {
                let (x, y) = projection.forward(latitude, longitude).unwrap();
                let (back, around) = projection.inverse(x, y).unwrap();
                assert!((back - latitude).abs() < 1e-7, "{latitude} {longitude}: {back}");
                assert!(latitude == 90.0 || (around - longitude).abs() < 1e-6, "{latitude} {longitude}: {around}");
            }
        }
    }

    #[test]
    fn the_centre_is_the_middle_and_its_antipode_has_no_place() {
        let grid = Grid { nx: 64, ny: 48, dx_m: 8e4, dy_m: 8e4, boundary: Boundary::Channel };
        let projection = Projection::centered(&grid, 52.5, 14.0);
        assert_eq!(projection.forward(52.5, 14.0), Some((2_560e3, 1_920e3)));
        assert_eq!(projection.forward(-52.5, -166.0), None);
        assert_eq!(projection.inverse(1.4e7, 1.4e7), None);
        let (_, north) = projection.forward(60.0, 14.0).unwrap();
        let (east, _) = projection.forward(52.5, 20.0).unwrap();
        assert!(north > 1_920e3 && east > 2_560e3);
    }

    /// From finite differences of the projection of a sphere about 40 N 100 W: at 47 N 53 W, γ = -32.889°.
    #[test]
    fn north_is_the_direction_of_the_meridian() {
        let projection = about(40.0, -100.0);
        assert!((projection.north(47.0, -53.0).to_degrees() + 32.889).abs() < 1e-3);
        assert_eq!(projection.north(40.0, -100.0), 0.0);
        for (latitude, longitude) in [(47.0, -53.0), (-10.0, 20.0), (80.0, 170.0), (20.0, -140.0)] {
            let at = |latitude: f64| projection.forward(latitude, longitude).unwrap();
            let (south, north) = (at(latitude - 1e-4), at(latitude + 1e-4));
            let expected = (north.0 - south.0).atan2(north.1 - south.1);
            let angle = projection.north(latitude, longitude);
            assert!((angle - expected).abs() < 1e-8, "{latitude} {longitude}: {angle} {expected}");
        }
    }

    /// The Jacobian determinant of the projection is R² cos φ everywhere: small areas keep their size.
    #[test]
    fn areas_are_true() {
        let projection = about(38.0, -96.0);
        for (latitude, longitude) in [(38.0f64, -96.0), (25.0, -80.0), (49.0, -125.0), (-10.0, 0.0)] {
            let step = 1e-3;
            let at = |north: f64, east: f64| projection.forward(latitude + north * step, longitude + east * step);
            let derivative = |a: Option<(f64, f64)>, b: Option<(f64, f64)>| {
                let (a, b) = (a.unwrap(), b.unwrap());
                let span = 2.0 * step.to_radians() * EARTH_RADIUS_M;
                ((a.0 - b.0) / span, (a.1 - b.1) / span)
            };
            let (north, east) = (derivative(at(1.0, 0.0), at(-1.0, 0.0)), derivative(at(0.0, 1.0), at(0.0, -1.0)));
            let area = east.0 * north.1 - east.1 * north.0;
            assert!((area / latitude.to_radians().cos() - 1.0).abs() < 1e-6, "{latitude} {longitude}: {area}");
        }
    }
}
