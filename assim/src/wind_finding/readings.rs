//! Trackers, what they read of a balloon, and how it moves between readings.

/// A tracking sensor. It does not measure the quantities that have no standard deviation.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracker {
    /// Its name.
    pub name: String,
    /// Its place: eastward, northward and upward \[m\].
    pub place_m: [f64; 3],
    /// Standard deviation of the random error of a range \[m\].
    pub sigma_range_m: Option<f64>,
    /// Standard deviation of the random error of an azimuth \[rad\].
    pub sigma_azimuth_rad: Option<f64>,
    /// Standard deviation of the random error of an elevation \[rad\].
    pub sigma_elevation_rad: Option<f64>,
}

/// What a tracker reads at one time; nothing where it lost the balloon.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// Distance \[m\].
    pub range_m: Option<f64>,
    /// Direction from north, clockwise \[rad\].
    pub azimuth_rad: Option<f64>,
    /// Height above the horizon \[rad\].
    pub elevation_rad: Option<f64>,
}

/// All readings at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    /// The time \[s\] since any time.
    pub seconds: f64,
    /// One for each tracker.
    pub readings: Vec<Reading>,
}

/// How the balloon moves: its velocity changes at random, eq. (2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Standard deviation of the change of each component of the velocity within a minute \[m/s\].
    pub sigma_change_m_per_s: f64,
}

/// Names of what trackers measure.
pub(super) const QUANTITIES: [&str; 3] = ["range", "azimuth", "elevation"];

impl Tracker {
    /// Standard deviations of range \[m\], azimuth and elevation \[rad\].
    pub fn sigmas(&self) -> [Option<f64>; 3] {
        [self.sigma_range_m, self.sigma_azimuth_rad, self.sigma_elevation_rad]
    }
}

impl Reading {
    /// Range \[m\], azimuth and elevation \[rad\].
    pub fn values(&self) -> [Option<f64>; 3] {
        [self.range_m, self.azimuth_rad, self.elevation_rad]
    }
}

impl Motion {
    /// Variance of the change of a component of the velocity over a time \[m² s⁻²\].
    pub(super) fn variance(self, seconds: f64) -> f64 {
        self.sigma_change_m_per_s.powi(2) * seconds / 60.0
    }
}

/// Names of the offsets, tracker after tracker: `radar/range`.
pub fn offset_names(trackers: &[Tracker]) -> Vec<String> {
    offsets_of(trackers).iter().map(|&(j, kind)| format!("{}/{}", trackers[j].name, QUANTITIES[kind])).collect()
}

/// Tracker and quantity of each offset: those that trackers measure.
pub(super) fn offsets_of(trackers: &[Tracker]) -> Vec<(usize, usize)> {
    let of = |(j, tracker): (usize, &Tracker)| {
        let sigmas = tracker.sigmas();
        (0..3).filter(move |&kind| sigmas[kind].is_some()).map(move |kind| (j, kind))
    };
    trackers.iter().enumerate().flat_map(of).collect()
}
