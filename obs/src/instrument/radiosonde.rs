//! Radiosondes: networks of stations that report the state at a point.

use super::steady::Steady;
use super::{Instrument, InstrumentSettings, ObservedVariable};
use crate::bias::BiasProcess;
use crate::calibration::Placement;
use crate::error::{ObservationError, list};
use crate::observation::Observation;
use crate::site::Site;
use crate::state_operator::StateOperator;
use crate::station::{PlacedStations, Station, StationSource, place};
use std::collections::HashMap;

/// Error of a radiosonde's height of a pressure level near 500 hPa \[m\] (the WRF model's observation errors: 12.1 m).
pub const HEIGHT_SIGMA_M: f64 = 12.0;
/// Error of a radiosonde's wind component near 500 hPa \[m/s\] (the WRF model's: 2.3 m/s; GSI's: 2.1 m/s).
pub const WIND_SIGMA_M_PER_S: f64 = 2.2;

/// A network of stations that report some variables where they are, by bilinear interpolation between the variable's
/// points.
#[derive(Clone, Debug, PartialEq)]
pub struct RadiosondeSettings {
    /// Where the stations are, and their groups.
    pub stations: StationSource,
    /// Groups that have no bias.
    pub reference_groups: Vec<String>,
    /// What each station reports; at least one.
    pub variables: Vec<ObservedVariable>,
    /// Stations nearer than this to the domain's edges are left out \[m\].
    pub edge_margin_m: f64,
    /// The biases.
    pub biases: Vec<StationBias>,
}

/// A bias of one variable.
#[derive(Clone, Debug, PartialEq)]
pub struct StationBias {
    /// The biased variable; one of those reported.
    pub variable: String,
    /// Whose bias it is.
    pub scope: BiasScope,
    /// How it behaves.
    pub process: BiasProcess,
}

/// Whose bias it is: each scope gives one parameter, or one for each of its members.
#[derive(Clone, Debug, PartialEq)]
pub enum BiasScope {
    /// One parameter `network/variable/group` for each group with a station in the domain, except reference groups.
    EachGroup,
    /// One parameter `network/variable/station` for each station, except those of reference groups.
    EachStation,
    /// One parameter, of the group of this name.
    Group(String),
    /// One parameter, of the station with this identifier.
    Station(String),
}

impl RadiosondeSettings {
    /// A network of published accuracy that reports `h`, `u` and `v`: 12 m and 2.2 m/s, without biases.
    pub fn new(stations: StationSource) -> Self {
        Self {
            stations,
            reference_groups: Vec::new(),
            variables: vec![
                ObservedVariable::new("h", HEIGHT_SIGMA_M),
                ObservedVariable::new("u", WIND_SIGMA_M_PER_S),
                ObservedVariable::new("v", WIND_SIGMA_M_PER_S),
            ],
            edge_margin_m: 0.0,
            biases: Vec::new(),
        }
    }

    /// Number and error of each reported variable.
    fn find_variables(&self, site: &Site<'_>) -> Result<Vec<(usize, f64)>, ObservationError> {
        if self.variables.is_empty() {
            let problem = "variables is empty; it needs at least one entry";
            return Err(ObservationError::in_setting(site.network, "variables", problem));
        }
        let mut variables: Vec<(usize, f64)> = Vec::with_capacity(self.variables.len());
        for observed in &self.variables {
            let variable = observed.find(site.layout, site.network, ["variables", "variables.sigma"])?;
            if variables.iter().any(|&(other, _)| other == variable) {
                return Err(ObservationError::duplicate_name(site.network, "variables", &observed.name));
            }
            variables.push((variable, observed.sigma));
        }
        Ok(variables)
    }

    /// Those who share a parameter of a bias, one entry for each parameter; at least one.
    fn members<'a>(
        &self,
        bias: &'a StationBias,
        network: &str,
        placed: &'a PlacedStations,
    ) -> Result<Vec<Member<'a>>, ObservationError> {
        let stations = &placed.stations;
        let on_reference = |value: &str, group: &str| {
            let problem = format!(
                "a bias is given to `{value}`, which is in the reference group `{group}`; reference groups have no bias"
            );
            ObservationError::in_setting(network, "biases", problem)
        };
        let is_reference = |group: &str| self.reference_groups.iter().any(|reference| reference == group);
        let mut of_groups: HashMap<&str, Vec<usize>> = HashMap::new();
        for (number, station) in stations.iter().enumerate() {
            of_groups.entry(&station.group).or_default().push(number);
        }
        let of_group = |name: &'a str| {
            let stations = of_groups.get(name).cloned().unwrap_or_default();
            Member { name, placement: Placement::Shared, stations }
        };
        let of_station = |number: usize| {
            let Station { name, x_m, y_m, .. } = &stations[number];
            Member { name, placement: Placement::Local { x_m: *x_m, y_m: *y_m }, stations: vec![number] }
        };
        let members: Vec<Member<'a>> = match &bias.scope {
            BiasScope::EachGroup => {
                let groups = placed.groups.iter().filter(|group| !is_reference(group));
                groups.map(|group| of_group(group)).collect()
            }
            BiasScope::EachStation => {
                (0..stations.len()).filter(|&number| !stations[number].is_reference).map(of_station).collect()
            }
            BiasScope::Group(group) if is_reference(group) => return Err(on_reference(group, group)),
            BiasScope::Group(group) => {
                let member = of_group(group);
                if member.stations.is_empty() {
                    return Err(ObservationError::unknown_name(network, "biases.scope", group, &placed.groups));
                }
                vec![member]
            }
            BiasScope::Station(name) => {
                let Some(number) = stations.iter().position(|station| *station.name == **name) else {
                    let valid = if placed.left_out.iter().any(|station| *station.name == **name) {
                        "the stations in the domain, while this one is outside of it".to_owned()
                    } else {
                        format!("the identifiers of the {} stations in the domain", stations.len())
                    };
                    let problem = format!("biases.scope names `{name}`, which is not known; valid: {valid}");
                    return Err(ObservationError::in_setting(network, "biases.scope", problem));
                };
                if stations[number].is_reference {
                    return Err(on_reference(name, &stations[number].group));
                }
                vec![of_station(number)]
            }
        };
        if members.is_empty() {
            let problem = format!(
                "the bias on `{}` applies to nothing, since every station is in a reference group ({})",
                bias.variable,
                list(&self.reference_groups)
            );
            return Err(ObservationError::in_setting(network, "biases", problem));
        }
        Ok(members)
    }
}

impl InstrumentSettings for RadiosondeSettings {
    fn build(&self, site: &mut Site<'_>) -> Result<Box<dyn Instrument>, ObservationError> {
        let variables = self.find_variables(site)?;
        let placed = place(site, &self.stations, &self.reference_groups, self.edge_margin_m)?;
        let layout = site.layout;
        let mut observations = Vec::with_capacity(placed.stations.len() * variables.len());
        for Station { name, x_m, y_m, .. } in &placed.stations {
            for &(variable, sigma) in &variables {
                let row = layout.interpolation(variable, *x_m, *y_m).expect("stations are in the domain");
                let report = site.report(name, variable, *x_m, *y_m);
                observations.push(Observation::new(report, sigma, StateOperator::Linear(row)));
            }
        }
        for bias in &self.biases {
            let Some(number) = self.variables.iter().position(|observed| observed.name == bias.variable) else {
                let valid = self.variables.iter().map(|observed| &observed.name);
                return Err(ObservationError::unknown_name(site.network, "biases.variable", &bias.variable, valid));
            };
            let unit = layout.variables[variables[number].0].unit;
            for member in self.members(bias, site.network, &placed)? {
                let name = format!("{}/{}", bias.variable, member.name);
                if let Some(column) = site.add_bias(&name, unit, member.placement, &bias.process)? {
                    for station in member.stations {
                        observations[station * variables.len() + number].calibration_row.push((column, 1.0));
                    }
                }
            }
        }
        let PlacedStations { stations, left_out, .. } = placed;
        Ok(Box::new(Steady::with_stations(site, observations, stations, left_out)))
    }
}

/// The stations that share a parameter of a bias.
struct Member<'a> {
    /// Of the group, or of the station.
    name: &'a str,
    placement: Placement,
    /// Their numbers among the stations in the domain.
    stations: Vec<usize>,
}
