//! The database of sensors around a run: which one it is, and what the run has found out on its way there.

use super::console::show;
use crate::run::checkpoint::PlannedRun;
use crate::scenario::Scenario;
use crate::sensors::SensorError;
use crate::sensors::write_back::{SENSORS_FILE, write_back};
use crate::shell::command;
use crate::text::shown_path;
use miette::{Report, miette};
use std::path::Path;

/// Takes the database that the user names in the place of the scenario's.
pub fn name_database(scenario: &mut Scenario, named: Option<&Path>) -> Result<(), Report> {
    let Some(named) = named else { return Ok(()) };
    if !scenario.name_database(named) {
        let help = "[sensors] with `database` makes its methods start from what is known";
        return Err(miette!(help = help, "{} has no [sensors], so that --sensors has no use", scenario.name));
    }
    Ok(())
}

/// The scenario of an interrupted run. Its plan comes from a file, which may come from anywhere: it leads to no database that
/// the user or the scenario's file do not name.
pub fn planned_scenario(plan: &PlannedRun, named: Option<&Path>, out: &Path, writes: bool) -> Result<Scenario, Report> {
    let shown = shown_path(out);
    let scenario = plan.scenario(out);
    let mut scenario = scenario.map_err(|error| Report::from(error).wrap_err(format!("{shown} cannot be resumed")))?;
    name_database(&mut scenario, named)?;
    let Some(settings) = scenario.sensors.as_ref().filter(|_| named.is_none()) else { return Ok(scenario) };
    let say = |database: &Path| {
        let named = command("isobar resume", &[out]) + " " + &command("--sensors", &[database]);
        format!("name it: `{named}`")
    };
    if let Some(database) = plan.named_database() {
        let help = say(database);
        return Err(miette!(help = help, "{shown}: the run was begun with a database of sensors that --sensors named"));
    }
    if writes && settings.writes.is_some() && !plan.is_of(&scenario.path) {
        let (help, path) = (say(&settings.database), shown_path(&scenario.path));
        return Err(miette!(
            help = help,
            "{shown}: {path} is no longer the scenario of this run, and only a scenario's file says into which database \
             the run writes"
        ));
    }
    Ok(scenario)
}

/// What came of writing a run's sensors back; `None` if nothing was to be written.
pub type Written = Option<Result<String, Report>>;

/// Takes what a complete run has found out of its sensors into their database, if the scenario says so.
pub fn write_sensors(scenario: &Scenario, out: &Path) -> Written {
    let settings = scenario.sensors.as_ref().filter(|sensors| sensors.writes.is_some())?;
    let database = shown_path(&settings.database);
    if std::fs::symlink_metadata(out.join(SENSORS_FILE)).is_err() {
        return Some(Ok(format!("Sensors: nothing to write into {database}, the method did not run to the end\n")));
    }
    let place = settings.check_place().map_err(|reason| SensorError::new(&settings.database, reason));
    Some(match place.and_then(|()| write_back(out, &settings.database)) {
        Ok(new) => Ok(format!("Sensors: {new} new records in {database}\n")),
        Err(error) => {
            let resume = command("isobar resume", &[out]);
            let help = format!("the run is complete; `{resume}` takes its sensors into the database");
            Err(miette!(help = help, "{error}"))
        }
    })
}

/// What is to be printed of it; an error is shown at once. And whether all went well.
pub fn report(written: Written) -> (Option<String>, bool) {
    match written {
        None => (None, true),
        Some(Ok(text)) => (Some(text), true),
        Some(Err(error)) => {
            show(&error);
            (None, false)
        }
    }
}
