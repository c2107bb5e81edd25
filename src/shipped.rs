//! The scenarios of `scenarios/` and the files that they name, inside the program: they are there wherever it runs.
//!
//! A path that begins with `isobar:/` leads to one of them, on the command line and as the name of a file in a scenario,
//! `isobar:/stations/europe.csv`. Whatever reads a file that a user or a scenario names takes such paths.

use std::path::{Component, Path, PathBuf};

/// The directory in which they seem to be.
const ROOT: &str = "isobar:";

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_bytes!(concat!("../scenarios/", $name)))),*]
    };
}

/// All files, by name: every scenario and every table of `scenarios/`.
static FILES: &[(&str, &[u8])] = files![
    "advection_exact.toml",
    "air_mass_bias.toml",
    "compared_sensors.toml",
    "continental_us.toml",
    "correlated_errors.toml",
    "dense_footprints.toml",
    "diurnal_bias.toml",
    "federated_large.toml",
    "fields/pdaf_2d_members.csv",
    "filter_forms.toml",
    "first_calibration.toml",
    "fkf_jet.toml",
    "fkf_linear.toml",
    "fkf_nonlinear.toml",
    "forcing.toml",
    "forecast_skill.toml",
    "fully_observed.toml",
    "growth_12000.toml",
    "growth_16000.toml",
    "growth_4000.toml",
    "growth_8000.toml",
    "growth_jet.toml",
    "growth_nonlinear.toml",
    "linear_advection.toml",
    "linear_forecasts.toml",
    "local_factors.toml",
    "local_wrong_model.toml",
    "million.toml",
    "model_patterns.toml",
    "no_reference_station.toml",
    "observation_times.toml",
    "observations/pdaf_2d.csv",
    "observations/recorded_biases_scanner.csv",
    "observations/recorded_biases_stations.csv",
    "observations/recorded_biases_withheld.csv",
    "patterns/wave.csv",
    "pdaf_2d.toml",
    "quickstart.toml",
    "recorded_biases.toml",
    "satellite_scan_bias.toml",
    "sensor_care.toml",
    "sensors/known.csv",
    "sensors/known.db",
    "smoother.toml",
    "stations/continental_us.csv",
    "stations/europe.csv",
    "stations/ring_of_100.csv",
    "stations/wind_profilers.csv",
    "wind_profilers.toml",
    "winds/flight_1.csv",
    "winds/flight_2.csv",
    "winds/trackers.csv",
    "wrong_errors.toml",
    "wrong_model.toml",
];

/// Whether a path leads into the program.
pub(crate) fn contains(path: &Path) -> bool {
    path.components().next() == Some(Component::Normal(ROOT.as_ref()))
}

/// What a file inside the program holds; `None` if there is no such file.
pub(crate) fn bytes(path: &Path) -> Option<&'static [u8]> {
    let name = path.strip_prefix(ROOT).ok()?;
    FILES.iter().find(|(known, _)| Path::new(known) == name).map(|(_, bytes)| *bytes)
}

/// Whether there is such a file, inside the program or outside.
pub(crate) fn is_file(path: &Path) -> bool {
    path.is_file() || bytes(path).is_some()
}

/// The paths of all scenarios inside the program, by name.
pub fn scenarios() -> impl Iterator<Item = PathBuf> {
    let names = FILES.iter().map(|(name, _)| Path::new(name));
    let at_top = |name: &&Path| name.components().count() == 1 && name.extension().is_some_and(|end| end == "toml");
    names.filter(at_top).map(|name| Path::new(ROOT).join(name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds;
    use crate::reader::{self, Section, SourceFile};
    use crate::scenario::Scenario;
    use crate::scenario::keys;
    use std::fs;

    /// The files of a directory, with those below it.
    fn files(directory: &Path) -> Vec<PathBuf> {
        let entries = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
        entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
    }

    /// What the reader accepts has the form that the keys say: what is said of a broken file beside its reader's faults is no
    /// false alarm.
    #[test]
    fn no_valid_scenario_has_a_fault_of_form() {
        let template = (PathBuf::from("mine.toml"), include_str!("cli/template.toml").to_string());
        let all = scenarios().map(|path| {
            let text = String::from_utf8(bytes(&path).unwrap().to_vec()).unwrap();
            (path, text)
        });
        for (path, text) in all.chain([template]) {
            let file = SourceFile::new(&path, &text);
            let tree = reader::parse(&file, &text).unwrap();
            let faults = reader::of_keys(&Section::root(&file, &tree), keys::ALL, &kinds::list);
            assert!(faults.is_empty(), "{}: {faults:?}", path.display());
        }
    }

    #[test]
    fn the_program_has_all_scenarios_and_tables() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios");
        for path in files(&root).iter().filter(|path| path.extension().is_none_or(|end| end != "md")) {
            let inside = Path::new(ROOT).join(path.strip_prefix(&root).unwrap());
            let wanted = fs::read(path).unwrap();
            assert!(bytes(&inside) == Some(&wanted), "{} is not in FILES of src/shipped.rs", path.display());
        }
        assert!(FILES.is_sorted_by_key(|(name, _)| *name));
    }

    #[test]
    fn every_scenario_in_the_program_is_read_with_its_tables() {
        for path in scenarios() {
            let scenario = Scenario::load(&path).unwrap();
            assert_eq!(Path::new(ROOT).join(format!("{}.toml", scenario.name)), path);
        }
        assert!(!is_file(Path::new("isobar:/../Cargo.toml")) && !is_file(Path::new("isobar:/stations")));
        assert!(!contains(Path::new("isobar/quickstart.toml")) && contains(Path::new("isobar:/none")));
    }
}
