//! Radiosondes: networks of stations that report the state at a point.

use crate::bias::BiasProcess;
use crate::biases::Biases;
use crate::calibration::Placement;
use crate::error::{ObservationError, list, require};
use crate::faults::Faults;
use crate::instrument::{Instrument, Observation, ObservedVariable, Reading, Schedule};
use crate::network::{Network, Station, StationSource, place};
use crate::projection::Projection;
use crate::report::Report;
use isobar_model::random::stream;
use isobar_model::{Layout, Time};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;

/// Error of a radiosonde's height of a pressure level near 500 hPa \[m\] (the WRF model's observation errors: 12.1 m).
pub const HEIGHT_SIGMA_M: f64 = 12.0;
/// Error of a radiosonde's wind component near 500 hPa \[m/s\] (the WRF model's: 2.3 m/s; GSI's: 2.1 m/s).
pub const WIND_SIGMA_M_PER_S: f64 = 2.2;

/// A network of stations that report some variables where they are, by bilinear interpolation between the variable's
/// points.
#[derive(Clone, Debug, PartialEq)]
pub struct RadiosondeConfig {
    /// Name of the network, unique in the observing system, without `/`.
    pub name: String,
    /// Where the stations are, and their groups.
    pub stations: StationSource,
    /// Groups that have no bias.
    pub reference_groups: Vec<String>,
    /// What each station reports; at least one.
    pub variables: Vec<ObservedVariable>,
    /// In which cycles they report.
    pub schedule: Schedule,
    /// Probability that a station's whole report is missing in a cycle, from 0 to 1.
    pub missing_rate: f64,
    /// Stations nearer than this to the domain's edges are left out \[m\].
    pub edge_margin_m: f64,
    /// The biases.
    pub biases: Vec<StationBias>,
    /// Reports that must not be believed.
    pub faults: Faults,
}

/// A bias of one variable.
#[derive(Clone, Debug, PartialEq)]
pub struct StationBias {
    /// The biased variable; one of those reported.
    pub variable: String,
    /// Whose bias.
    pub scope: BiasScope,
    /// How it behaves.
    pub process: BiasProcess,
}

/// Whose bias it is: each scope gives one parameter, or one for each of its members.
#[derive(Clone, Debug, PartialEq)]
pub enum BiasScope {
    /// One parameter `network/variable/group` for each group with a station in the domain, but for reference groups.
    EachGroup,
    /// One parameter `network/variable/station` for each station, but for those of reference groups.
    EachStation,
    /// One parameter, of the group of this name.
    Group(String),
    /// One parameter, of the station with this identifier.
    Station(String),
}

impl RadiosondeConfig {
    /// A network of published accuracy that reports `h`, `u` and `v` in every cycle: 12 m and 2.2 m/s, no station
    /// missing, none biased.
    pub fn new(name: &str, stations: StationSource) -> Self {
        Self {
            name: name.to_owned(),
            stations,
            reference_groups: Vec::new(),
            variables: vec![
                ObservedVariable::new("h", HEIGHT_SIGMA_M),
                ObservedVariable::new("u", WIND_SIGMA_M_PER_S),
                ObservedVariable::new("v", WIND_SIGMA_M_PER_S),
            ],
            schedule: Schedule::EVERY_CYCLE,
            missing_rate: 0.0,
            edge_margin_m: 0.0,
            biases: Vec::new(),
            faults: Faults::NONE,
        }
    }
}

/// One number that a station reports.
struct Channel {
    variable: usize,
    sigma: f64,
    state_row: Vec<(usize, f64)>,
    calibration_row: Vec<(usize, f64)>,
}

/// A network in operation.
pub(crate) struct Radiosondes {
    network: Arc<str>,
    schedule: Schedule,
    missing_rate: f64,
    stations: Vec<(Station, Vec<Channel>)>,
    errors: ChaCha8Rng,
    missing: ChaCha8Rng,
}

impl Radiosondes {
    /// The network of `config`, with its stations; its parameters are added to `biases`.
    pub fn new(
        config: &RadiosondeConfig,
        layout: &Layout,
        projection: Option<&Projection>,
        seed: u64,
        biases: &mut Biases,
    ) -> Result<(Self, Network), ObservationError> {
        let name = &config.name;
        config.schedule.validate(name)?;
        let rate = config.missing_rate;
        require((0.0..=1.0).contains(&rate), name, "missing_rate", rate, "a probability from 0 to 1")?;
        let variables = find_variables(config, layout)?;
        let (reference, margin) = (&config.reference_groups, config.edge_margin_m);
        let network = place(name, &config.stations, reference, margin, &layout.grid, projection, seed)?;

        let cells = layout.grid.cells();
        let channel = |station: &Station, &(variable, sigma): &(usize, f64)| {
            let stencil = layout.grid.stencil(layout.variables[variable].location, station.x_m, station.y_m);
            let entries = stencil.expect("stations are in the domain").entries;
            let state_row = entries.into_iter().map(|(index, weight)| (variable * cells + index, weight)).collect();
            Channel { variable, sigma, state_row, calibration_row: Vec::new() }
        };
        let mut stations: Vec<(Station, Vec<Channel>)> = (network.stations.iter())
            .map(|station| (station.clone(), variables.iter().map(|variable| channel(station, variable)).collect()))
            .collect();
        for bias in &config.biases {
            add_bias(config, bias, layout, &network, &mut stations, biases)?;
        }
        let radiosondes = Self {
            network: name.as_str().into(),
            schedule: config.schedule,
            missing_rate: rate,
            stations,
            errors: stream(seed, &format!("observations/{name}")),
            missing: stream(seed, &format!("missing/{name}")),
        };
        Ok((radiosondes, network))
    }
}

impl Instrument for Radiosondes {
    fn observe(&mut self, cycle: usize, time: Time, observations: &mut Vec<Observation>) {
        if self.schedule.pass(cycle).is_none() {
            return;
        }
        for (station, channels) in &self.stations {
            // All random numbers are drawn even if the report is missing, so that the rate changes no other report.
            let missing = self.missing.random::<f64>() < self.missing_rate;
            for channel in channels {
                let normal: f64 = StandardNormal.sample(&mut self.errors);
                if missing {
                    continue;
                }
                observations.push(Observation {
                    report: Report {
                        network: Arc::clone(&self.network),
                        platform: Arc::clone(&station.name),
                        variable: channel.variable,
                        time,
                        x_m: station.x_m,
                        y_m: station.y_m,
                        scan: None,
                    },
                    sigma: channel.sigma,
                    reading: Reading::Error(channel.sigma * normal),
                    state_row: channel.state_row.clone(),
                    calibration_row: channel.calibration_row.clone(),
                    predictors: Vec::new(),
                });
            }
        }
    }

    fn streams(&mut self) -> Vec<&mut ChaCha8Rng> {
        vec![&mut self.errors, &mut self.missing]
    }
}

/// Number and error of each reported variable.
fn find_variables(config: &RadiosondeConfig, layout: &Layout) -> Result<Vec<(usize, f64)>, ObservationError> {
    let instrument = config.name.clone();
    if config.variables.is_empty() {
        return Err(ObservationError::EmptyList { instrument, setting: "variables" });
    }
    let mut variables: Vec<(usize, f64)> = Vec::with_capacity(config.variables.len());
    for observed in &config.variables {
        let variable = observed.find(layout, &config.name, ["variables", "variables.sigma"])?;
        if variables.iter().any(|&(other, _)| other == variable) {
            let value = observed.name.clone();
            return Err(ObservationError::DuplicateName { instrument, setting: "variables", value });
        }
        variables.push((variable, observed.sigma));
    }
    Ok(variables)
}

/// Adds the parameters of one bias, and their entries in the rows of G.
fn add_bias(
    config: &RadiosondeConfig,
    bias: &StationBias,
    layout: &Layout,
    network: &Network,
    stations: &mut [(Station, Vec<Channel>)],
    biases: &mut Biases,
) -> Result<(), ObservationError> {
    let name = &config.name;
    let unknown = |setting, value: &str, valid| ObservationError::UnknownName {
        instrument: name.clone(),
        setting,
        value: value.to_owned(),
        valid,
    };
    let Some(channel) = config.variables.iter().position(|observed| observed.name == bias.variable) else {
        let valid = list(config.variables.iter().map(|observed| &observed.name));
        return Err(unknown("biases.variable", &bias.variable, valid));
    };
    let on_reference = |value: &str, group: &str| ObservationError::BiasOnReference {
        instrument: name.clone(),
        value: value.to_owned(),
        group: group.to_owned(),
    };
    let is_reference = |group: &str| config.reference_groups.iter().any(|reference| reference == group);
    let mut members: Vec<(&str, Placement, Vec<usize>)> = Vec::new();
    let group_members = |group: &str| -> Vec<usize> {
        (0..network.stations.len()).filter(|&number| &*network.stations[number].group == group).collect()
    };
    let alone = |number: usize| {
        let Station { name, x_m, y_m, .. } = &network.stations[number];
        (&**name, Placement::Local { x_m: *x_m, y_m: *y_m }, vec![number])
    };
    match &bias.scope {
        BiasScope::EachGroup => members.extend(
            (network.groups.iter().filter(|group| !is_reference(group)))
                .map(|group| (&**group, Placement::Shared, group_members(group))),
        ),
        BiasScope::EachStation => {
            let biased = (0..network.stations.len()).filter(|&number| !network.stations[number].is_reference);
            members.extend(biased.map(alone));
        }
        BiasScope::Group(group) if is_reference(group) => return Err(on_reference(group, group)),
        BiasScope::Group(group) => match group_members(group) {
            numbers if numbers.is_empty() => return Err(unknown("biases.scope", group, list(&network.groups))),
            numbers => members.push((group, Placement::Shared, numbers)),
        },
        BiasScope::Station(station) => {
            let Some(number) = network.stations.iter().position(|other| *other.name == **station) else {
                let left_out = network.left_out.iter().any(|other| *other.name == **station);
                let valid = match left_out {
                    true => "the stations in the domain, while this one is outside of it".to_owned(),
                    false => format!("the identifiers of the {} stations in the domain", network.stations.len()),
                };
                return Err(unknown("biases.scope", station, valid));
            };
            let Station { group, is_reference, .. } = &network.stations[number];
            if *is_reference {
                return Err(on_reference(station, group));
            }
            members.push(alone(number));
        }
    }
    if members.is_empty() {
        return Err(ObservationError::BiasOnNothing {
            instrument: name.clone(),
            variable: bias.variable.clone(),
            reference_groups: list(&config.reference_groups),
        });
    }
    let unit = layout.variable(&bias.variable).map_or("", |variable| layout.variables[variable].unit);
    for (member, placement, numbers) in members {
        let parameter = format!("{name}/{}/{member}", bias.variable);
        if let Some(column) = biases.add(name, parameter, unit, placement, &bias.process)? {
            for number in numbers {
                stations[number].1[channel].calibration_row.push((column, 1.0));
            }
        }
    }
    Ok(())
}
