//! Satellites: a swath of footprints that moves from cycle to cycle, with a bias that depends on the scan position.

use super::{Instrument, InstrumentSettings, ObservedVariable};
use crate::air_mass::AirMassBias;
use crate::bias::BiasProcess;
use crate::calibration::Placement;
use crate::error::{ObservationError, require};
use crate::footprint::{TRUNCATION, footprint};
use crate::observation::{Observation, Reading, ScanLine};
use crate::predictor::Predictor;
use crate::report::Report;
use crate::site::Site;
use crate::state_operator::StateOperator;
use isobar_model::{Boundary, Duration, Grid, Location};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::PI;
use std::sync::Arc;

/// Error of a satellite's height retrieval \[m\]: two to four times that of a radiosonde.
pub const HEIGHT_SIGMA_M: f64 = 30.0;

/// Standard deviations of the three scan-bias parameters (offset, linear, quadratic), in units of the random error.
/// Together they give a bias of 2.9 times the random error, root-mean-square over the swath; with each parameter at
/// one standard deviation it varies by 3.15 from its least to its greatest value along the scan, like AMSU-A's.
pub const SCAN_BIAS_SIGMAS: [f64; 3] = [2.75, 1.4, 1.4];

/// The most footprints that one satellite may report in a cycle.
const MOST_FOOTPRINTS: usize = 1_000_000;

/// The farthest that a track may be or move \[m\]: beyond, the wrapped position would lose its digits.
const FARTHEST_M: f64 = 1e9;

/// A satellite that observes one variable in a swath.
///
/// The ground track crosses the middle row of the domain, y = height/2, at `crossing_x_m` in cycle 1 and
/// `shift_per_cycle_m` further in each following cycle, wrapped in x. Scan lines are perpendicular to the track, one
/// of them through the crossing; footprints whose centre falls beyond the domain in y are not reported.
#[derive(Clone, Debug, PartialEq)]
pub struct SatelliteSettings {
    /// What it observes.
    pub variable: ObservedVariable,
    /// Distance between the outermost footprints' centres of a scan line \[m\].
    pub swath_width_m: f64,
    /// Number of footprints in a scan line, equally spaced; their scan position s runs from −1 at the left of the
    /// heading to 1 at its right (0 if there is one only).
    pub scan_positions: usize,
    /// Distance between scan lines \[m\].
    pub along_track_spacing_m: f64,
    /// σ of the Gaussian footprint, truncated at 3σ \[m\]; 0 for a point, else at least half of a cell.
    pub footprint_sigma_m: f64,
    /// x at which the track of cycle 1 crosses the middle of the domain \[m\].
    pub crossing_x_m: f64,
    /// How far the crossing moves from cycle to cycle, positive to the east \[m\].
    pub shift_per_cycle_m: f64,
    /// Which way it flies.
    pub heading: Heading,
    /// Angle of the track to the y axis \[degrees\], from −60 to 60; positive when the satellite moves to the east.
    pub track_angle_deg: f64,
    /// The biases that depend on the scan position; each term at most once.
    pub biases: Vec<ScanBias>,
    /// The biases that depend on the state.
    pub air_mass_biases: Vec<AirMassBias>,
}

/// Which way a satellite flies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heading {
    /// Towards +y in every pass.
    Northward,
    /// Towards −y in every pass.
    Southward,
    /// Towards +y in the first pass, −y in the second, and so on.
    Alternating,
}

/// One term of a satellite's bias.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanBias {
    /// Its dependence on the scan position.
    pub term: ScanTerm,
    /// How its coefficient behaves.
    pub process: BiasProcess,
}

/// How a term of the bias depends on the scan position s ∈ \[−1, 1\]. The terms are proportional to the Legendre
/// polynomials P₀, P₁ and P₂: orthogonal over the swath, so that each has its own share of the mean square.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanTerm {
    /// 1.
    Offset,
    /// s.
    Linear,
    /// s² − ⅓.
    Quadratic,
}

impl ScanTerm {
    /// The term at scan position s.
    pub fn value(self, s: f64) -> f64 {
        match self {
            ScanTerm::Offset => 1.0,
            ScanTerm::Linear => s,
            ScanTerm::Quadratic => s * s - 1.0 / 3.0,
        }
    }

    /// Its name in that of the parameter: `polar/scan_linear`.
    pub fn name(self) -> &'static str {
        match self {
            ScanTerm::Offset => "offset",
            ScanTerm::Linear => "scan_linear",
            ScanTerm::Quadratic => "scan_quadratic",
        }
    }

    /// The fewest scan positions at which it differs from a combination of the terms before it.
    fn least_positions(self) -> usize {
        match self {
            ScanTerm::Offset => 1,
            ScanTerm::Linear => 2,
            ScanTerm::Quadratic => 3,
        }
    }
}

impl Default for SatelliteSettings {
    /// A satellite like AMSU-A that retrieves `h`: 30 footprints across 2340 km, error 30 m, and constant scan biases
    /// of 2.9 times the error. Its footprints (40 km, about 94 km between the half-power points) are those between
    /// nadir and the swath's edge; the track moves by 1500 km in each cycle.
    fn default() -> Self {
        let terms = [ScanTerm::Offset, ScanTerm::Linear, ScanTerm::Quadratic];
        let bias = |(term, sigma)| ScanBias { term, process: BiasProcess::constant(sigma * HEIGHT_SIGMA_M) };
        Self {
            variable: ObservedVariable::new("h", HEIGHT_SIGMA_M),
            swath_width_m: 2_340e3,
            scan_positions: 30,
            along_track_spacing_m: 80e3,
            footprint_sigma_m: 40e3,
            crossing_x_m: 0.0,
            shift_per_cycle_m: 1_500e3,
            heading: Heading::Alternating,
            track_angle_deg: 0.0,
            biases: terms.into_iter().zip(SCAN_BIAS_SIGMAS).map(bias).collect(),
            air_mass_biases: Vec::new(),
        }
    }
}

impl SatelliteSettings {
    fn validate(&self, name: &str, grid: &Grid) -> Result<(), ObservationError> {
        let (width, height) = (grid.width_m(), grid.height_m());
        let swath = self.swath_width_m;
        let expected = format!("from 0 to below {width} m, narrower than the domain ({} km)", width / 1e3);
        require((0.0..width).contains(&swath), name, "swath_width_m", swath, expected)?;
        let positions = self.scan_positions;
        let expected = format!("from 1 to {MOST_FOOTPRINTS}");
        require((1..=MOST_FOOTPRINTS).contains(&positions), name, "scan_positions", positions as f64, expected)?;
        let angle = self.track_angle_deg;
        require(angle.abs() <= 60.0, name, "track_angle_deg", angle, "from -60 to 60")?;
        let spacing = self.along_track_spacing_m;
        require(spacing > 0.0, name, "along_track_spacing_m", spacing, "above 0")?;
        let footprints = (2.0 * self.half_length_m(grid) / spacing + 1.0) * positions as f64;
        let expected = "large enough for at most a million footprints in a pass";
        require(footprints <= MOST_FOOTPRINTS as f64, name, "along_track_spacing_m", spacing, expected)?;
        for (setting, x) in [("crossing_x_m", self.crossing_x_m), ("shift_per_cycle_m", self.shift_per_cycle_m)] {
            require(x.abs() <= FARTHEST_M, name, setting, x, format!("from -{FARTHEST_M} to {FARTHEST_M} m"))?;
        }

        let least = 0.5 * grid.dx_m.max(grid.dy_m);
        let extent = if grid.boundary == Boundary::Periodic { width.min(height) } else { width };
        let most = extent / (2.0 * TRUNCATION);
        let sigma = self.footprint_sigma_m;
        let right = sigma == 0.0 || (least..most).contains(&sigma);
        let expected = format!(
            "0 for a point, or {} km (half of a cell) to below {:.0} km (the domain holds a radius of 3σ)",
            least / 1e3,
            most / 1e3
        );
        require(right, name, "footprint_sigma_m", sigma, expected)
    }

    /// Distance from the crossing, along the track, to the farthest scan line that reaches into the domain \[m\].
    fn half_length_m(&self, grid: &Grid) -> f64 {
        let (sin, cos) = self.track_angle_deg.to_radians().sin_cos();
        (0.5 * grid.height_m() + 0.5 * self.swath_width_m * sin.abs()) / cos
    }
}

/// A satellite in operation.
struct Satellite {
    settings: SatelliteSettings,
    network: Arc<str>,
    grid: Grid,
    /// Number of the observed variable, and where it lives.
    variable: usize,
    location: Location,
    /// (number in the calibration, term) of each unknown parameter.
    terms: Vec<(usize, ScanTerm)>,
    air_mass_terms: Vec<AirMassTerm>,
    /// Footprints of a pass.
    footprints: usize,
    errors: ChaCha8Rng,
}

/// An unknown parameter whose bias depends on the state.
struct AirMassTerm {
    /// Its number in the calibration.
    parameter: usize,
    /// Number of the predictor's variable, and where it lives.
    variable: usize,
    location: Location,
    mean: f64,
    scale: f64,
}

/// The centre of a footprint.
#[derive(Clone, Debug, PartialEq)]
struct Spot {
    line: usize,
    position: usize,
    s: f64,
    x_m: f64,
    y_m: f64,
}

impl InstrumentSettings for SatelliteSettings {
    fn build(&self, site: &mut Site<'_>) -> Result<Box<dyn Instrument>, ObservationError> {
        let (name, layout) = (site.network, site.layout);
        let variable = self.variable.find(layout, name, ["variable", "variable.sigma"])?;
        self.validate(name, &layout.grid)?;
        let unit = layout.variables[variable].unit;
        let mut terms = Vec::new();
        for ScanBias { term, process } in &self.biases {
            let least = term.least_positions();
            let expected = format!("at least {least} for the bias `{}`", term.name());
            let positions = self.scan_positions;
            require(positions >= least, name, "scan_positions", positions as f64, expected)?;
            if let Some(column) = site.add_bias(term.name(), unit, Placement::Shared, process)? {
                terms.push((column, *term));
            }
        }
        let mut air_mass_terms = Vec::new();
        for bias in &self.air_mass_biases {
            let &AirMassBias { mean, scale, ref process, .. } = bias;
            let variable = bias.find(layout, name)?;
            if let Some(parameter) = site.add_bias(&bias.name(), unit, Placement::Shared, process)? {
                let location = layout.variables[variable].location;
                air_mass_terms.push(AirMassTerm { parameter, variable, location, mean, scale });
            }
        }
        let mut satellite = Satellite {
            settings: self.clone(),
            network: name.into(),
            grid: layout.grid.clone(),
            variable,
            location: layout.variables[variable].location,
            terms,
            air_mass_terms,
            footprints: 0,
            errors: site.stream("observations"),
        };
        satellite.footprints = satellite.spots(1, 0).len();
        Ok(Box::new(satellite))
    }

    fn has_scan_lines(&self) -> bool {
        true
    }

    fn has_air_mass_bias(&self) -> bool {
        self.air_mass_biases.iter().any(|bias| !bias.process.known)
    }
}

impl Satellite {
    /// The predictors at a footprint.
    fn predictors(&self, x_m: f64, y_m: f64) -> Vec<Predictor> {
        let predictor = |&AirMassTerm { parameter, variable, location, mean, scale }: &AirMassTerm| {
            let entries = footprint(&self.grid, location, x_m, y_m, self.settings.footprint_sigma_m);
            let first = variable * self.grid.cells();
            let row = entries.into_iter().map(|(index, weight)| (first + index, weight / scale)).collect();
            Predictor { parameter, constant: -mean / scale, row }
        };
        self.air_mass_terms.iter().map(predictor).collect()
    }

    /// The footprints' centres in `cycle`, which is pass number `pass`, line by line along the heading.
    fn spots(&self, cycle: usize, pass: usize) -> Vec<Spot> {
        let settings = &self.settings;
        let north = match settings.heading {
            Heading::Northward => true,
            Heading::Southward => false,
            Heading::Alternating => pass.is_multiple_of(2),
        };
        let (sin, cos) = settings.track_angle_deg.to_radians().sin_cos();
        let along = if north { (sin, cos) } else { (sin, -cos) };
        let right = (along.1, -along.0);
        let (width, height) = (self.grid.width_m(), self.grid.height_m());
        let crossing = settings.crossing_x_m + (cycle - 1) as f64 * settings.shift_per_cycle_m;
        let half = (settings.half_length_m(&self.grid) / settings.along_track_spacing_m).floor() as i64;
        let last = settings.scan_positions - 1;
        let mut spots = Vec::new();
        for line in -half..=half {
            let distance = line as f64 * settings.along_track_spacing_m;
            for position in 0..=last {
                let s = if last == 0 { 0.0 } else { 2.0 * position as f64 / last as f64 - 1.0 };
                let across = 0.5 * s * settings.swath_width_m;
                let x = (crossing + distance * along.0 + across * right.0).rem_euclid(width);
                let y_m = 0.5 * height + distance * along.1 + across * right.1;
                // The remainder of a tiny negative number rounds to the width itself.
                let x_m = if x < width { x } else { 0.0 };
                if self.grid.contains(x_m, y_m) {
                    spots.push(Spot { line: (line + half + 1) as usize, position: position + 1, s, x_m, y_m });
                }
            }
        }
        spots
    }
}

impl Instrument for Satellite {
    fn observe(&mut self, cycle: usize, pass: usize) -> Vec<Observation> {
        let mut observations = Vec::new();
        let (first, sigma) = (self.variable * self.grid.cells(), self.settings.variable.sigma);
        for Spot { line, position, s, x_m, y_m } in self.spots(cycle, pass) {
            let normal: f64 = StandardNormal.sample(&mut self.errors);
            let entries = footprint(&self.grid, self.location, x_m, y_m, self.settings.footprint_sigma_m);
            observations.push(Observation {
                report: Report {
                    network: Arc::clone(&self.network),
                    platform: format!("line {line} position {position}").into(),
                    variable: self.variable,
                    x_m,
                    y_m,
                    scan: Some(s),
                },
                sigma,
                reading: Reading::Error(sigma * normal),
                state: StateOperator::Linear(
                    entries.into_iter().map(|(index, weight)| (first + index, weight)).collect(),
                ),
                calibration_row: self.terms.iter().map(|&(column, term)| (column, term.value(s))).collect(),
                predictors: self.predictors(x_m, y_m),
                scan_line: Some(ScanLine { number: line, across_m: 0.5 * s * self.settings.swath_width_m }),
                report_number: 0,
                lag: Duration::from_seconds(0),
            });
        }
        observations
    }

    fn most_observations(&self, _cycle: usize) -> usize {
        self.footprints
    }

    fn weights(&self) -> usize {
        let (radius, Grid { dx_m, dy_m, .. }) = (TRUNCATION * self.settings.footprint_sigma_m, &self.grid);
        let side = |step: f64| 2.0 * radius / step + 2.0;
        // A disc in its square, with as much as bilinear interpolation at least.
        let of_footprint = (0.25 * PI * side(*dx_m) * side(*dy_m)).min(self.grid.cells() as f64);
        let rows = self.footprints as f64 * (1 + self.air_mass_terms.len()) as f64;
        (rows * of_footprint) as usize
    }

    fn streams(&mut self) -> Vec<&mut ChaCha8Rng> {
        vec![&mut self.errors]
    }
}
