//! The plane's place on the Earth: Lambert's azimuthal equal-area projection of a sphere.

/// Radius of the sphere \[m\] (the one of the WRF and GRIB communities).
pub const EARTH_RADIUS_M: f64 = 6_371_229.0;

/// Lambert azimuthal equal-area projection about a centre that lies at the middle of the domain
/// (Snyder 1987, *Map Projections: A Working Manual*, eqs. 24-2 to 24-4 and 20-14 to 20-18).
#[derive(Clone, Debug, PartialEq)]
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
