//! The switches of outputs.

use crate::output::{OUTPUTS, Open, Output, Outputs};
use clap::{Arg, ArgAction, ArgMatches, Args, Command, Error, FromArgMatches};
use miette::{Report, miette};

/// The outputs whose switches were given.
#[derive(Debug, Default)]
pub struct OutputArguments {
    switched: Vec<&'static str>,
}

impl OutputArguments {
    /// Whether an output is wanted in addition to, or in spite of, what the scenario says.
    fn wants(&self, output: &Output, of_scenario: &Outputs) -> bool {
        let is_switched = self.switched.contains(&output.name);
        if output.by_default { of_scenario.contains(output.name) && !is_switched } else { is_switched }
    }

    /// The outputs to write.
    ///
    /// # Errors
    /// If a switch asks for one that this build cannot write.
    pub fn apply(&self, of_scenario: &Outputs) -> Result<Outputs, Report> {
        let asked = OUTPUTS.iter().filter(|output| !output.by_default && self.switched.contains(&output.name));
        asked.map(|output| output.switch).try_for_each(check_switch)?;
        Ok(Outputs::of(OUTPUTS.iter().filter(|output| self.wants(output, of_scenario)).map(|output| output.name)))
    }
}

/// Refuses the output of a switch that this build cannot write.
///
/// # Errors
/// If it is one, with what would build an isobar that can.
pub fn check_switch(switch: &str) -> Result<(), Report> {
    match OUTPUTS.iter().find(|output| output.switch == switch).map(|output| &output.open) {
        Some(Open::NeedsFeature(feature)) => {
            let help = format!("`cargo run --release --features {feature} -- run …` builds one that has it, once");
            Err(miette!(help = help, "--{switch} needs the feature `{feature}`, without which this isobar was built"))
        }
        _ => Ok(()),
    }
}

impl Args for OutputArguments {
    fn augment_args(command: Command) -> Command {
        OUTPUTS.iter().fold(command, |command, output| {
            command.arg(Arg::new(output.name).long(output.switch).help(output.about).action(ArgAction::SetTrue))
        })
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for OutputArguments {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        let names = OUTPUTS.iter().map(|output| output.name);
        Ok(Self { switched: names.filter(|name| matches.get_flag(name)).collect() })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}
