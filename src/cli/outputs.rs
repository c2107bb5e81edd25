//! The switches of outputs.

use crate::output::{OUTPUTS, Output, Outputs};
use clap::{Arg, ArgAction, ArgMatches, Args, Command, Error, FromArgMatches};

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
    pub fn apply(&self, of_scenario: &Outputs) -> Outputs {
        Outputs::of(OUTPUTS.iter().filter(|output| self.wants(output, of_scenario)).map(|output| output.name))
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
