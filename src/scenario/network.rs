//! `[networks.NAME]`: the observing systems.

use super::bias::{self, Bias, RadiosondeBias, SatelliteBias};
use super::grid::GridSettings;
use super::model::{ModelSettings, variable};
use super::quality;
use crate::reader::table_file;
use crate::reader::{Field, Kind, Limits, Read, Section};
use crate::text::clean;
use indexmap::IndexMap;
use isobar_model::{Boundary, Duration};
use isobar_obs::{Faults, Stations, WindAxes};
use std::path::{Path, PathBuf};

/// An observing system: when it reports, and what it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// When it reports.
    pub schedule: Schedule,
    /// Probability that a report is missing.
    pub missing_rate: f64,
    /// Reports that must not be believed.
    pub faults: Faults,
    /// What it is.
    pub instrument: Instrument,
}

impl Network {
    /// Whether a bias that methods must estimate depends on the state.
    pub fn has_air_mass_bias(&self) -> bool {
        let Instrument::Satellite(own) = &self.instrument else { return false };
        own.biases.iter().any(|bias| !bias.known && matches!(bias.pattern, SatelliteBias::AirMass { .. }))
    }
}

/// The cycles in which an observing system reports: `first_cycle`, and every `interval_cycles` from there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// It reports in every so many cycles.
    pub interval_cycles: usize,
    /// The first cycle in which it reports, from 1 to `interval_cycles`.
    pub first_cycle: usize,
}

/// A kind of observing system.
#[derive(Clone, Debug, PartialEq)]
pub enum Instrument {
    /// Stations that stay where they are.
    Radiosonde(RadiosondeSettings),
    /// A polar-orbiting satellite with a cross-track scanner.
    Satellite(SatelliteSettings),
    /// Observations of a file.
    File(FileSettings),
}

/// A network of radiosonde stations.
#[derive(Clone, Debug, PartialEq)]
pub struct RadiosondeSettings {
    /// Where the stations are.
    pub stations: StationLayout,
    /// The column of the station file by which stations form groups; `None`: all are one group.
    pub group_by: Option<String>,
    /// Of a station file: the groups whose stations report; all if empty. Of other stations: the groups to which they
    /// belong in turn; all are in the group `all` if empty.
    pub groups: Vec<String>,
    /// The groups without any bias.
    pub reference_groups: Vec<String>,
    /// Stations nearer than this to the domain's edges are left out \[m\].
    pub edge_margin_m: f64,
    /// What every station observes.
    pub observed: Vec<ObservedVariable>,
    /// The biases.
    pub biases: Vec<Bias<RadiosondeBias>>,
}

/// Where stations are.
#[derive(Clone, Debug, PartialEq)]
pub enum StationLayout {
    /// As a file says.
    File(PathBuf),
    /// In columns and rows at equal distances.
    Regular {
        /// Number of columns.
        columns: usize,
        /// Number of rows.
        rows: usize,
    },
    /// At random places.
    Random {
        /// Number of stations.
        count: usize,
    },
}

/// Observations that somebody else made.
#[derive(Clone, Debug, PartialEq)]
pub struct FileSettings {
    /// The file.
    pub path: PathBuf,
    /// The variable of those of which the file does not say it.
    pub variable: Option<String>,
    /// Standard deviation of the random error of those of which the file does not say it.
    pub sigma: Option<f64>,
    /// Values that mark a missing one.
    pub missing: Option<Vec<f64>>,
    /// How long before or after the end of a window an observation may be valid that is used there.
    pub time_tolerance: Duration,
    /// Along which axes the components of winds are.
    pub winds: Option<WindAxes>,
}

/// A variable that an instrument observes.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservedVariable {
    /// Its name.
    pub variable: String,
    /// Standard deviation of the random error, in the variable's unit.
    pub sigma: f64,
}

/// A satellite.
#[derive(Clone, Debug, PartialEq)]
pub struct SatelliteSettings {
    /// What it observes.
    pub observed: ObservedVariable,
    /// Width of the swath \[m\].
    pub swath_width_m: f64,
    /// Number of scan positions across the swath.
    pub scan_positions: usize,
    /// Distance of scan lines along the track \[m\].
    pub along_track_spacing_m: f64,
    /// Standard deviation of the Gaussian footprint: 0 for a point, else at least half of a cell \[m\].
    pub footprint_sigma_m: f64,
    /// Where the track of cycle 1 crosses the middle row of the domain, as a fraction of its width.
    pub start_x_fraction: f64,
    /// Eastward shift of the track from cycle to cycle \[m\].
    pub shift_per_cycle_m: f64,
    /// Which way it flies.
    pub heading: Heading,
    /// Angle of the track to the y axis, positive when the satellite moves to the east \[degrees\].
    pub track_angle_deg: f64,
    /// The biases: one factor for each term.
    pub biases: Vec<Bias<SatelliteBias>>,
}

/// Which way a satellite flies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heading {
    /// To the north in every pass.
    Northward,
    /// To the south in every pass.
    Southward,
    /// To the north in the first pass, to the south in the second, and so on.
    Alternating,
}

#[derive(Clone, Copy)]
enum What {
    Radiosonde,
    Satellite,
    File,
}

const KINDS: &[Kind<What>] = &[
    (
        "radiosonde",
        What::Radiosonde,
        &[
            "stations",
            "group_by",
            "groups",
            "reference_groups",
            "edge_margin_km",
            "interval_cycles",
            "first_cycle",
            "missing_rate",
            "sigma_height_m",
            "sigma_wind_m_per_s",
            "observe",
            "bias",
            "faults",
        ],
    ),
    (
        "satellite",
        What::Satellite,
        &[
            "variable",
            "sigma",
            "swath_width_km",
            "scan_positions",
            "along_track_spacing_km",
            "footprint_sigma_km",
            "start_x_fraction",
            "shift_per_cycle_km",
            "heading",
            "track_angle_deg",
            "interval_cycles",
            "first_cycle",
            "missing_rate",
            "bias",
            "faults",
        ],
    ),
    ("file", What::File, &["file", "variable", "sigma", "missing", "time_tolerance_minutes", "winds"]),
];

/// The most networks of a scenario.
const MOST_NETWORKS: usize = 100;

const MOST_STATIONS: usize = 100_000;

/// Reads `[networks]`; a scenario without it has no observations.
pub(super) fn read(root: &Section<'_>, grid: &GridSettings, model: &ModelSettings) -> Read<IndexMap<String, Network>> {
    let mut networks = IndexMap::new();
    let Some(field) = root.optional("networks") else { return Ok(networks) };
    for (name, field) in field.any_section()?.fields() {
        check_name(name, &field, "network")?;
        if networks.len() == MOST_NETWORKS {
            return Err(field.misplaced(format!("there are more than {MOST_NETWORKS} networks"), "too many"));
        }
        networks.insert(name.to_string(), network(&field, grid, model)?);
    }
    Ok(networks)
}

/// Refuses a name that could not be part of a file's name or of a parameter's.
pub(super) fn check_name(name: &str, field: &Field<'_>, what: &str) -> Read<()> {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
    if name.is_empty() || name.len() > 40 || !name.chars().all(plain) || name.starts_with('-') {
        let message = format!("\"{}\" cannot be the name of a {what}", clean(name));
        return Err(field.misplaced(message, "a name has 1 to 40 letters a-z, A-Z, digits, underscores and hyphens"));
    }
    Ok(())
}

fn network(field: &Field<'_>, grid: &GridSettings, model: &ModelSettings) -> Read<Network> {
    let (what, section) = field.section_of_kind(KINDS)?;
    let instrument = match what {
        What::Radiosonde => Instrument::Radiosonde(radiosonde(&section, grid, model)?),
        What::Satellite => Instrument::Satellite(satellite(&section, grid, model)?),
        What::File => Instrument::File(file(&section, model)?),
    };
    let interval_cycles = section.whole_or("interval_cycles", 1, 1, 1_000_000)?;
    let first_cycle = section.whole_or("first_cycle", 1, 1, interval_cycles)?;
    Ok(Network {
        schedule: Schedule { interval_cycles, first_cycle },
        missing_rate: section.number_or("missing_rate", 0.0, Limits::Fraction)?,
        faults: quality::faults(&section)?,
        instrument,
    })
}

fn radiosonde(section: &Section<'_>, grid: &GridSettings, model: &ModelSettings) -> Read<RadiosondeSettings> {
    let observed = observed(section, model)?;
    let names: Vec<String> = observed.iter().map(|observed| observed.variable.clone()).collect();
    let stations = stations(&section.required("stations")?, grid)?;
    let from_file = matches!(stations, StationLayout::File(_));
    let group_by = section.optional("group_by").map(|field| match from_file {
        true => field.text(),
        false => Err(field.misplaced("only a station file has columns to group by".into(), "use `groups` instead")),
    });
    let group_by = group_by.transpose()?;
    if let Some(field) = section.optional("groups").filter(|_| from_file && group_by.is_none()) {
        let message = "which of the file's groups to use needs the column that names them".into();
        return Err(field.misplaced(message, "add `group_by`"));
    }
    let texts = |key: &str| section.optional(key).map_or(Ok(Vec::new()), |field| field.texts(1000));
    let (groups, reference_groups) = (texts("groups")?, texts("reference_groups")?);
    if let Some(field) = section.optional("reference_groups").filter(|_| group_by.is_none()) {
        let all = ["all".to_string()];
        let groups = if groups.is_empty() { all.as_slice() } else { &groups };
        let choices: Vec<(&str, ())> = groups.iter().map(|group| (group.as_str(), ())).collect();
        for element in field.elements(1000)? {
            element.choice(&choices)?;
        }
    }
    let biases = bias::read_radiosonde(section.optional("bias"), &names)?;
    let edge_margin_m = section.number_or("edge_margin_km", 0.0, Limits::Between(0.0, 1e5))? * 1e3;
    Ok(RadiosondeSettings { stations, group_by, groups, reference_groups, edge_margin_m, observed, biases })
}

fn file(section: &Section<'_>, model: &ModelSettings) -> Read<FileSettings> {
    let field = section.required("file")?;
    let path = field.file.input(&field.text()?);
    if !path.is_file() {
        let message = format!("the file of observations {} does not exist", clean(&path.display().to_string()));
        return Err(field.invalid(message, "a path relative to this scenario"));
    }
    let sole = match model.variables() {
        [(name, _)] => Some(name.to_string()),
        _ => None,
    };
    let named = section.optional("variable").map(|field| variable(&field, model)).transpose()?;
    let sigma = section.optional("sigma").map(|field| field.number(Limits::Positive)).transpose()?;
    let missing = section
        .optional("missing")
        .map(|field| field.elements(1000)?.iter().map(|marker| marker.number(Limits::Any)).collect::<Read<Vec<f64>>>());
    let minutes = section.number_or("time_tolerance_minutes", 0.0, Limits::Between(0.0, 1e6))?;
    let axes = [("earth", WindAxes::Earth), ("grid", WindAxes::Grid)];
    Ok(FileSettings {
        path,
        variable: named.or(sole),
        sigma,
        missing: missing.transpose()?,
        time_tolerance: Duration::from_seconds((minutes * 60.0).round() as i64),
        winds: section.optional("winds").map(|field| field.choice(&axes)).transpose()?,
    })
}

/// What a radiosonde observes: `sigma_height_m` and `sigma_wind_m_per_s`, or `observe`.
fn observed(section: &Section<'_>, model: &ModelSettings) -> Read<Vec<ObservedVariable>> {
    let mut observed = Vec::new();
    for (key, variables) in [("sigma_height_m", &["h"][..]), ("sigma_wind_m_per_s", &["u", "v"])] {
        let Some(field) = section.optional(key) else { continue };
        if !model.is_shallow_water() {
            let message = format!("`{}` does not fit the model, which has neither height nor wind", field.title());
            return Err(field.misplaced(message, "use `observe = { tracer = 0.1 }`"));
        }
        let sigma = field.number(Limits::Positive)?;
        observed.extend(variables.iter().map(|name| ObservedVariable { variable: name.to_string(), sigma }));
    }
    if let Some(field) = section.optional("observe") {
        let names: Vec<&str> = model.variables().iter().map(|variable| variable.0).collect();
        for (name, sigma) in field.section(&names)?.fields() {
            if observed.iter().any(|other| other.variable == name) {
                let message = format!("`{name}` has its standard deviation already");
                return Err(sigma.misplaced(message, "give it here or by sigma_height_m and sigma_wind_m_per_s"));
            }
            observed.push(ObservedVariable { variable: name.to_string(), sigma: sigma.number(Limits::Positive)? });
        }
    }
    if observed.is_empty() {
        let keys = match model.is_shallow_water() {
            true => "`sigma_height_m`, `sigma_wind_m_per_s` or both must be given here",
            false => "`observe = { tracer = 0.1 }` must be given here",
        };
        let message = format!("[{}] observes nothing", section.title());
        return Err(section.file.error(section.span.clone(), message, keys, None));
    }
    Ok(observed)
}

fn stations(field: &Field<'_>, grid: &GridSettings) -> Read<StationLayout> {
    let section = field.section(&["file", "regular", "random"])?;
    let given: Vec<(&str, Field<'_>)> = section.fields().collect();
    match given.as_slice() {
        [("file", file)] => {
            let path = file.file.input(&file.text()?);
            if !path.is_file() {
                let message = format!("the station file {} does not exist", clean(&path.display().to_string()));
                return Err(file.invalid(message, "a path relative to this scenario"));
            }
            if grid.projection.is_none() && on_the_earth(&path) {
                let message = "stations on the Earth need a plane that lies on it".to_string();
                return Err(file.invalid(message, "needs grid.center_latitude_deg and grid.center_longitude_deg"));
            }
            Ok(StationLayout::File(path))
        }
        [("regular", regular)] => {
            let numbers = regular.elements(2)?;
            let [columns, rows] = numbers.as_slice() else {
                return Err(
                    regular.invalid(format!("`{}` needs two numbers", regular.title()), "must be [columns, rows]")
                );
            };
            Ok(StationLayout::Regular { columns: columns.whole(1, 300)?, rows: rows.whole(1, 300)? })
        }
        [("random", random)] => Ok(StationLayout::Random { count: random.whole(1, MOST_STATIONS)? }),
        _ => {
            let message = format!("`{}` must have exactly one of `file`, `regular` and `random`", field.title());
            Err(field.invalid(message, "{ file = \"…\" }, { regular = [columns, rows] } or { random = count }"))
        }
    }
}

/// Whether a station file gives places on the Earth. A file that cannot be read is refused later, with all of its faults.
fn on_the_earth(path: &Path) -> bool {
    let bytes = table_file::read(path, table_file::LARGEST_FILE).unwrap_or_default();
    let text = isobar_obs::table::decode(&bytes, "").unwrap_or_default();
    Stations::on_the_earth(text, "") == Some(true)
}

fn satellite(section: &Section<'_>, grid: &GridSettings, model: &ModelSettings) -> Read<SatelliteSettings> {
    let length_m = |key: &str| Ok(section.number(key, Limits::Between(1e-3, 1e5))? * 1e3);
    let spacing = section.required("along_track_spacing_km")?;
    let settings = SatelliteSettings {
        observed: ObservedVariable {
            variable: variable(&section.required("variable")?, model)?,
            sigma: section.number("sigma", Limits::Positive)?,
        },
        swath_width_m: length_m("swath_width_km")?,
        scan_positions: section.required("scan_positions")?.whole(1, 1000)?,
        along_track_spacing_m: length_m("along_track_spacing_km")?,
        footprint_sigma_m: footprint_sigma_m(section, grid)?,
        start_x_fraction: section.number_or("start_x_fraction", 0.0, Limits::Between(0.0, 1.0))?,
        shift_per_cycle_m: section.number_or("shift_per_cycle_km", 0.0, Limits::Between(-1e5, 1e5))? * 1e3,
        heading: section.optional("heading").map_or(Ok(Heading::Northward), |field| field.choice(HEADINGS))?,
        track_angle_deg: section.number_or("track_angle_deg", 0.0, Limits::Between(-60.0, 60.0))?,
        biases: bias::read_satellite(section.optional("bias"), model)?,
    };
    let lines = grid.grid.height_m() / settings.along_track_spacing_m;
    if lines * settings.scan_positions as f64 > 1e6 {
        let message = format!("the satellite would report {:.2e} footprints", lines * settings.scan_positions as f64);
        return Err(spacing.invalid(message, "at most a million footprints, scan lines times scan_positions"));
    }
    if let Some(field) = section.optional("swath_width_km").filter(|_| settings.swath_width_m >= grid.grid.width_m()) {
        let message = format!("the swath is not narrower than the domain ({} km)", grid.grid.width_m() / 1e3);
        return Err(field.invalid(message, "must be less than the domain's width"));
    }
    Ok(settings)
}

const HEADINGS: &[(&str, Heading)] =
    &[("northward", Heading::Northward), ("southward", Heading::Southward), ("alternating", Heading::Alternating)];

/// A footprint that the grid resolves and the domain holds, or a point.
fn footprint_sigma_m(section: &Section<'_>, settings: &GridSettings) -> Read<f64> {
    let (field, grid) = (section.required("footprint_sigma_km")?, &settings.grid);
    let sigma_m = field.number(Limits::Between(0.0, 1e5))? * 1e3;
    let extent_m = match grid.boundary {
        Boundary::Periodic => grid.width_m().min(grid.height_m()),
        Boundary::Channel => grid.width_m(),
    };
    let (least_m, most_m) = (0.5 * grid.dx_m.max(grid.dy_m), extent_m / 6.0);
    if sigma_m != 0.0 && !(least_m..most_m).contains(&sigma_m) {
        let message = format!("`{}` is {} km, which this grid cannot hold", field.title(), sigma_m / 1e3);
        let allowed =
            format!("0 for a point, or {} km (half of a cell) to below {:.0} km", least_m / 1e3, most_m / 1e3);
        return Err(field.invalid(message, &allowed));
    }
    Ok(sigma_m)
}
