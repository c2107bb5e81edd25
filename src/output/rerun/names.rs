//! Under which names everything is logged.

use crate::event::RunInfo;
use crate::output::netcdf::coordinates::safe_name;
use isobar_model::Time;
use re_sdk::RecordingStream;
use std::error::Error;

/// The recording's application: the viewer keeps a user's layout by it.
pub const APPLICATION_ID: &str = "isobar";

/// The timelines.
pub const CYCLE: &str = "cycle";
pub const VALID_TIME: &str = "valid_time";

/// The coastlines.
pub const COAST: &str = "coast";

/// The outcome of logging something.
pub type Result<T = ()> = std::result::Result<T, Box<dyn Error>>;

/// Sets the cycle, and its valid time, to which what is logged next belongs.
pub fn set_time(recording: &RecordingStream, cycle: usize, time: Time) {
    recording.set_time_sequence(CYCLE, cycle as i64);
    recording.set_timestamp_secs_since_epoch(VALID_TIME, time.seconds() as f64);
}

/// Names of entities.
#[derive(Debug)]
pub struct Names {
    methods: Vec<String>,
    parameters: Vec<String>,
}

impl Names {
    /// The names in a run.
    pub fn new(info: &RunInfo) -> Self {
        // With their numbers, so that no two are the same.
        let name = |(number, name): (usize, &String)| format!("{:02}_{}", number + 1, safe_name(name, "_"));
        Self {
            methods: info.methods.iter().map(|method| &method.name).enumerate().map(name).collect(),
            parameters: info.calibration.parameters.iter().map(|it| &it.name).enumerate().map(name).collect(),
        }
    }

    /// Something of a method.
    pub fn map(&self, method: usize, part: &str) -> String {
        format!("methods/{}/{part}", self.methods[method])
    }

    /// A method's map of a variable.
    pub fn field(&self, method: usize, variable: &str, part: &str) -> String {
        self.map(method, &format!("maps/{variable}/{part}"))
    }

    /// Something of a method's blocks and common factors.
    pub fn structure(&self, method: usize, part: &str) -> String {
        self.map(method, &format!("structure/{part}"))
    }

    /// A method's curve of a variable.
    pub fn score(&self, method: usize, variable: &str, part: &str) -> String {
        self.map(method, &format!("scores/{variable}/{part}"))
    }

    /// A method's curve of a calibration parameter.
    pub fn parameter(&self, method: usize, parameter: usize, part: &str) -> String {
        self.map(method, &format!("calibration/{}/{part}", self.parameters[parameter]))
    }

    /// A method's stations in the colour of their biases in a variable.
    pub fn stations(&self, method: usize, variable: &str) -> String {
        self.map(method, &format!("stations/{variable}"))
    }

    /// A method's curve of what it estimates beside state and calibration.
    pub fn estimated(&self, method: usize, parameter: &str, part: &str) -> String {
        self.map(method, &format!("estimated/{}/{part}", safe_name(parameter, "_")))
    }

    /// A method's curve in the comparison of all, of a variable or of the method as a whole.
    pub fn comparison(&self, what: &str, method: usize) -> String {
        format!("comparison/{what}/{}", self.methods[method])
    }
}
