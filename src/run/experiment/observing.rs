//! `[networks.NAME]` as instruments.

use super::ExperimentError;
use crate::reader::table_file;
use crate::scenario::{
    Bias, BiasEvolution, BiasOwner, FileSettings, InitialBias, Instrument, Network, RadiosondeSettings, SatelliteBias,
    SatelliteSettings, Scenario, Schedule, StationLayout,
};
use isobar_model::Grid;
use isobar_obs::table::decode;
use isobar_obs::{
    AirMassBias, BiasProcess, BiasScope, Evolution, Heading, InstrumentConfig, ObservationError, ObservationFile,
    ObservedVariable, RadiosondeConfig, RecordedConfig, SatelliteConfig, ScanBias, ScanTerm, StationBias,
    StationSource, Stations,
};
use std::path::Path;

pub(super) fn configs(scenario: &Scenario) -> Result<Vec<InstrumentConfig>, ExperimentError> {
    let grid = &scenario.grid.grid;
    let config = |(name, network): (&String, &Network)| match &network.instrument {
        Instrument::Radiosonde(own) => Ok(InstrumentConfig::Radiosonde(radiosondes(name, network, own, scenario)?)),
        Instrument::Satellite(own) => Ok(InstrumentConfig::Satellite(satellite(name, network, own, grid))),
        Instrument::File(own) => Ok(InstrumentConfig::Recorded(recorded(name, own, scenario)?)),
    };
    scenario.networks.iter().map(config).collect()
}

fn called(file: &Path, scenario: &Scenario) -> String {
    table_file::called(file, scenario.path.parent().unwrap_or(Path::new("")))
}

/// The keys that lead to the setting of which an error speaks.
pub(super) fn place<'a>(error: &'a ObservationError, scenario: &'a Scenario) -> Vec<&'a str> {
    let mut path = vec!["networks"];
    if let Some(file) = error.file() {
        let keys = |(name, network): (&'a String, &Network)| match &network.instrument {
            Instrument::File(own) if called(&own.path, scenario) == file => Some(vec![name.as_str(), "file"]),
            Instrument::Radiosonde(RadiosondeSettings { stations: StationLayout::File(own), .. })
                if called(own, scenario) == file =>
            {
                Some(vec![name.as_str(), "stations", "file"])
            }
            _ => None,
        };
        path.extend(scenario.networks.iter().find_map(keys).unwrap_or_default());
        return path;
    }
    path.extend(error.instrument());
    path.extend(error.setting().map(|setting| match setting {
        "swath_width_m" => "swath_width_km",
        "along_track_spacing_m" => "along_track_spacing_km",
        "footprint_sigma_m" => "footprint_sigma_km",
        "shift_per_cycle_m" => "shift_per_cycle_km",
        "edge_margin_m" => "edge_margin_km",
        "time_tolerance" => "time_tolerance_minutes",
        setting if setting.starts_with("faults") => "faults",
        setting if setting.starts_with("biases") => "bias",
        setting => setting,
    }));
    path
}

fn radiosondes(
    name: &str,
    network: &Network,
    own: &RadiosondeSettings,
    scenario: &Scenario,
) -> Result<RadiosondeConfig, ExperimentError> {
    let groups = own.groups.clone();
    let stations = match &own.stations {
        StationLayout::File(path) => {
            let file = called(path, scenario);
            let mut stations = Stations::parse(decode(&read(path)?, &file)?, &file)?;
            if let (Some(column), false) = (&own.group_by, groups.is_empty()) {
                stations = stations.only(name, column, &groups)?;
            }
            StationSource::File { stations, group_by: own.group_by.clone() }
        }
        &StationLayout::Regular { columns, rows } => StationSource::Regular { columns, rows, groups },
        &StationLayout::Random { count } => StationSource::Random { count, groups },
    };
    let mut config = RadiosondeConfig::new(name, stations);
    config.reference_groups.clone_from(&own.reference_groups);
    config.variables =
        own.observed.iter().map(|observed| ObservedVariable::new(&observed.variable, observed.sigma)).collect();
    config.schedule = schedule(network.schedule);
    config.missing_rate = network.missing_rate;
    config.faults = network.faults;
    config.edge_margin_m = own.edge_margin_m;
    config.biases = own
        .biases
        .iter()
        .map(|bias| StationBias {
            variable: bias.pattern.variable.clone(),
            scope: match bias.pattern.per {
                BiasOwner::Group => BiasScope::EachGroup,
                BiasOwner::Station => BiasScope::EachStation,
            },
            process: process(bias),
        })
        .collect();
    Ok(config)
}

fn satellite(name: &str, network: &Network, own: &SatelliteSettings, grid: &Grid) -> SatelliteConfig {
    let mut config = SatelliteConfig::new(name);
    config.variable = ObservedVariable::new(&own.observed.variable, own.observed.sigma);
    config.swath_width_m = own.swath_width_m;
    config.scan_positions = own.scan_positions;
    config.along_track_spacing_m = own.along_track_spacing_m;
    config.footprint_sigma_m = own.footprint_sigma_m;
    config.crossing_x_m = own.start_x_fraction * grid.width_m();
    config.shift_per_cycle_m = own.shift_per_cycle_m;
    config.heading = match own.heading {
        crate::scenario::Heading::Northward => Heading::Northward,
        crate::scenario::Heading::Southward => Heading::Southward,
        crate::scenario::Heading::Alternating => Heading::Alternating,
    };
    config.track_angle_deg = own.track_angle_deg;
    config.schedule = schedule(network.schedule);
    config.missing_rate = network.missing_rate;
    config.faults = network.faults;
    config.biases.clear();
    for bias in &own.biases {
        let process = process(bias);
        match &bias.pattern {
            SatelliteBias::Scan(term) => config.biases.push(ScanBias { term: scan_term(*term), process }),
            &SatelliteBias::AirMass { ref variable, mean, scale } => {
                config.air_mass_biases.push(AirMassBias { variable: variable.clone(), mean, scale, process });
            }
        }
    }
    config
}

fn scan_term(term: crate::scenario::ScanTerm) -> ScanTerm {
    match term {
        crate::scenario::ScanTerm::Offset => ScanTerm::Offset,
        crate::scenario::ScanTerm::Linear => ScanTerm::Linear,
        crate::scenario::ScanTerm::Quadratic => ScanTerm::Quadratic,
    }
}

fn recorded(name: &str, own: &FileSettings, scenario: &Scenario) -> Result<RecordedConfig, ExperimentError> {
    let file = called(&own.path, scenario);
    let observations = ObservationFile::parse(decode(&read(&own.path)?, &file)?, &file, own.missing.as_deref())?;
    Ok(RecordedConfig {
        name: name.to_string(),
        observations,
        variable: own.variable.clone(),
        sigma: own.sigma,
        time_tolerance: own.time_tolerance,
        winds: own.winds,
    })
}

fn schedule(schedule: Schedule) -> isobar_obs::Schedule {
    let every_cycles = schedule.interval_cycles;
    isobar_obs::Schedule { every_cycles, offset_cycles: schedule.first_cycle % every_cycles }
}

fn process<Pattern>(bias: &Bias<Pattern>) -> BiasProcess {
    BiasProcess {
        initial: match bias.initial {
            InitialBias::Sigma(sigma) => isobar_obs::InitialBias::Drawn { sigma },
            InitialBias::Value(value) => isobar_obs::InitialBias::Given { value },
        },
        evolution: match bias.evolution {
            BiasEvolution::Constant => Evolution::Constant,
            BiasEvolution::RandomWalk { sigma_per_sqrt_day } => Evolution::RandomWalk { sigma_per_sqrt_day },
            BiasEvolution::Jump { at_hours, size } => Evolution::Jump { at_hours, size },
            BiasEvolution::Sinusoid { amplitude, period_hours, peak_hours } => {
                Evolution::Sinusoid { amplitude, period_hours, peak_hours }
            }
        },
        assumed_sigma_prior: bias.assumed_sigma,
        assumed_sigma_drift_per_sqrt_day: bias.assumed_drift_per_sqrt_day,
        known: bias.known,
    }
}

/// The bytes of a file.
fn read(path: &Path) -> Result<Vec<u8>, ExperimentError> {
    let failure = |reason| ExperimentError::File { path: path.to_path_buf(), reason };
    table_file::read(path, table_file::LARGEST_FILE).map_err(failure)
}
