//! Biases of recorded observations, of whose true values nothing is known.

use super::recorded_held::Held;
use crate::bias::{BiasProcess, Evolution, InitialBias};
use crate::calibration::Placement;
use crate::error::{ObservationError, list, require};
use crate::observation_file::{ObservationFile, ObservationRecord};
use crate::recorded_use::BiasUse;
use crate::site::Site;
use std::collections::HashMap;
use std::sync::Arc;

/// A bias of one variable of recorded observations, which methods estimate:
///
/// ```text
/// bias = β,   or with a predictor   bias = β (z − mean) / scale
/// ```
///
/// with z the number in a column of the file. β has the unit of the variable: with a predictor it is the change of the bias
/// where z changes by `scale`. A bias of a wind's component is that of the component as it was reported, to the east or to the
/// north.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedBias {
    /// The biased variable.
    pub variable: String,
    /// Whose bias it is.
    pub scope: RecordedScope,
    /// What it is proportional to; `None`: it is the same for all observations in its scope.
    pub predictor: Option<ColumnPredictor>,
    /// What methods assume of β: `sigma`, and that it is constant, a random walk or an AR(1) process.
    pub process: BiasProcess,
}

/// Whose bias it is: each scope gives one parameter, or one for each of its members with an observation that can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordedScope {
    /// One parameter `network/variable/station` for each station, of the file's column `id`, except reference stations.
    EachStation,
    /// One parameter `network/variable/group` for each group, of the file's column of groups, except reference groups.
    EachGroup,
    /// One parameter `network/variable/all`, of all stations except those that are references.
    All,
}

/// A number in a column of the file to which a bias is proportional. An observation without it cannot be used. It comes in the
/// names of parameters after the variable: `network/variable/column`, or `network/variable/column/station`.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnPredictor {
    /// The column.
    pub column: String,
    /// What is subtracted from the number, in its unit; near its mean, so that β is not taken for an offset.
    pub mean: f64,
    /// What it is divided by, in its unit; above 0.
    pub scale: f64,
}

impl RecordedScope {
    /// Its name in scenarios.
    fn name(self) -> &'static str {
        match self {
            RecordedScope::EachStation => "station",
            RecordedScope::EachGroup => "group",
            RecordedScope::All => "all",
        }
    }

    /// To whom an observation belongs; `None` if the file does not say it.
    fn member(self, record: &ObservationRecord) -> Option<&str> {
        match self {
            RecordedScope::EachStation => record.id.as_deref(),
            RecordedScope::EachGroup => record.group.as_deref(),
            RecordedScope::All => Some("all"),
        }
    }
}

/// A station, a group or all, and its observations of the biased variable.
struct Member<'a> {
    name: &'a str,
    /// Their numbers, each with the factor of β.
    factors: Vec<(usize, f64)>,
    /// The place of the first that can be used.
    place: Option<(f64, f64)>,
    /// Whether another that can be used has another place.
    moves: bool,
}

impl Member<'_> {
    /// Local if it is a station that stays where it is.
    fn placement(&self, scope: RecordedScope) -> Placement {
        match self.place {
            Some((x_m, y_m)) if scope == RecordedScope::EachStation && !self.moves => Placement::Local { x_m, y_m },
            _ => Placement::Shared,
        }
    }
}

/// Adds the biases of a network to the parameters of the site and to the rows of its observations, which have the order of
/// `records`; how many there are. What lacks a predictor is marked.
pub(super) fn add(
    biases: &[RecordedBias],
    references: &References<'_>,
    site: &mut Site<'_>,
    records: &[&ObservationRecord],
    observations: &mut [Held],
) -> Result<Vec<BiasUse>, ObservationError> {
    references.check(site.network)?;
    biases.iter().map(|bias| bias.add(references, site, records, observations)).collect()
}

impl RecordedBias {
    fn add(
        &self,
        references: &References<'_>,
        site: &mut Site<'_>,
        records: &[&ObservationRecord],
        observations: &mut [Held],
    ) -> Result<BiasUse, ObservationError> {
        let (network, layout) = (site.network, site.layout);
        let variable = layout.variable(&self.variable).ok_or_else(|| {
            let valid = layout.variables.iter().map(|variable| variable.name);
            ObservationError::unknown_name(network, "biases.variable", &self.variable, valid)
        })?;
        self.check_process(network)?;
        let predictor = self.find_predictor(references.file, network)?;
        let mut members: Vec<Member<'_>> = Vec::new();
        let mut numbers: HashMap<&str, usize> = HashMap::new();
        let (mut observed, mut is_any_free) = (false, false);
        for (number, (record, observation)) in records.iter().zip(&mut *observations).enumerate() {
            let name = self.scope.member(record).ok_or_else(|| self.no_column(references.file, network))?;
            let is_of_variable = observation.variable as usize == variable;
            observed |= is_of_variable;
            if references.contain(record) {
                continue;
            }
            is_any_free |= is_of_variable;
            let place = *numbers.entry(name).or_insert_with(|| {
                members.push(Member { name, factors: Vec::new(), place: None, moves: false });
                members.len() - 1
            });
            if !is_of_variable {
                continue;
            }
            let factor = match predictor {
                Some((column, of)) => record.predictors[column].map(|z| (z - of.mean) / of.scale),
                None => Some(1.0),
            };
            let Some(factor) = factor else {
                observation.lacks_predictor = true;
                continue;
            };
            let member = &mut members[place];
            member.factors.push((number, factor));
            if observation.is_in_time_and_inside() {
                let place = (observation.x_m, observation.y_m);
                member.moves |= *member.place.get_or_insert(place) != place;
            }
        }
        if observed && !is_any_free {
            let problem =
                format!("the bias of `{}` applies to nothing, since every station is a reference", self.variable);
            return Err(ObservationError::in_setting(network, "biases", problem));
        }
        if self.scope == RecordedScope::EachGroup {
            members.sort_by_key(|member| member.name);
        }
        let (present, without): (Vec<_>, Vec<_>) = members.into_iter().partition(|member| member.place.is_some());
        for member in &present {
            let placement = member.placement(self.scope);
            let name = self.parameter_name(member.name);
            let column = site.add_recorded_bias(&name, layout.variables[variable].unit, placement, &self.process)?;
            for &(number, factor) in &member.factors {
                observations[number].biases.push(column, factor);
            }
        }
        Ok(BiasUse {
            variable: self.variable.clone(),
            column: self.predictor.as_ref().map(|predictor| predictor.column.clone()),
            per: self.scope.name(),
            parameters: present.len(),
            without: without.into_iter().map(|member| member.name.to_owned()).collect(),
        })
    }

    /// What comes after the network in the name of a parameter.
    fn parameter_name(&self, member: &str) -> String {
        match (&self.predictor, self.scope) {
            (Some(predictor), RecordedScope::All) => format!("{}/{}", self.variable, predictor.column),
            (Some(predictor), _) => format!("{}/{}/{member}", self.variable, predictor.column),
            (None, _) => format!("{}/{member}", self.variable),
        }
    }

    fn check_process(&self, network: &str) -> Result<(), ObservationError> {
        let is_drawn = matches!(self.process.initial, InitialBias::Drawn { .. });
        let is_assumed = match self.process.evolution {
            Evolution::Constant | Evolution::RandomWalk { .. } | Evolution::FirstOrder { .. } => true,
            Evolution::Jump { .. } | Evolution::Sinusoid { .. } => false,
        };
        if is_drawn && is_assumed && !self.process.known {
            return Ok(());
        }
        let problem = format!(
            "nothing is known of the true bias of `{}`, since it was observed elsewhere: give its standard deviation, and an \
             evolution that is constant, a random walk or an AR(1) process",
            self.variable
        );
        Err(ObservationError::in_setting(network, "biases", problem))
    }

    /// The predictor, with the number of its column among those that were read.
    fn find_predictor(
        &self,
        file: &ObservationFile,
        network: &str,
    ) -> Result<Option<(usize, &ColumnPredictor)>, ObservationError> {
        let Some(predictor) = &self.predictor else { return Ok(None) };
        require(predictor.scale > 0.0, network, "biases.scale", predictor.scale, "above 0, in the unit of the column")?;
        require(true, network, "biases.mean", predictor.mean, "finite")?;
        if predictor.column == "value" {
            let problem = "a bias cannot be proportional to `value`, which has random errors of its own";
            return Err(ObservationError::in_setting(network, "biases.column", problem));
        }
        let read = &file.further().predictors;
        let column = read.iter().position(|column| *column == predictor.column);
        let column =
            column.ok_or_else(|| ObservationError::unknown_name(network, "biases.column", &predictor.column, read))?;
        Ok(Some((column, predictor)))
    }

    /// That the file does not say whose bias it is.
    fn no_column(&self, file: &ObservationFile, network: &str) -> ObservationError {
        let (file, per) = (file.file(), self.scope.name());
        let column = if self.scope == RecordedScope::EachStation { "`id`" } else { "of groups that is read" };
        let problem = format!("{file} has no column {column}, without which there is no bias per {per}");
        ObservationError::in_setting(network, "biases", problem)
    }
}

/// The stations and groups of a file that have no bias.
pub(super) struct References<'a> {
    pub file: &'a ObservationFile,
    pub stations: &'a [String],
    pub groups: &'a [String],
}

/// What the file says of an observation: its station, or its group.
type Said = fn(&ObservationRecord) -> Option<&str>;

impl References<'_> {
    /// Refuses names that are not in the file, or there twice.
    fn check(&self, network: &str) -> Result<(), ObservationError> {
        let (station, group): (Said, Said) = (|record| record.id.as_deref(), |record| record.group.as_deref());
        for (setting, names, said) in
            [("reference_stations", self.stations, station), ("reference_groups", self.groups, group)]
        {
            for (number, name) in names.iter().enumerate() {
                if names[..number].contains(name) {
                    return Err(ObservationError::duplicate_name(network, setting, name));
                }
                if !self.file.records().iter().any(|record| said(record) == Some(name.as_str())) {
                    return Err(self.unknown(network, setting, name, said));
                }
            }
        }
        Ok(())
    }

    fn contain(&self, record: &ObservationRecord) -> bool {
        let contains = |names: &[String], own: &Option<Arc<str>>| {
            own.as_deref().is_some_and(|own| names.iter().any(|name| name == own))
        };
        contains(self.stations, &record.id) || contains(self.groups, &record.group)
    }

    /// That a reference is not in the file.
    fn unknown(&self, network: &str, setting: &'static str, name: &str, said: Said) -> ObservationError {
        const MOST_LISTED: usize = 20;
        let mut valid: Vec<&str> = self.file.records().iter().filter_map(said).collect();
        valid.sort_unstable();
        valid.dedup();
        let more = valid.len().saturating_sub(MOST_LISTED);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        let valid = list(valid.into_iter().take(MOST_LISTED));
        let problem = format!("{setting} names `{name}`, which is not in {}; valid: {valid}{more}", self.file.file());
        ObservationError::in_setting(network, setting, problem)
    }
}
