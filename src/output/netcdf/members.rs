//! `<method>_members.nc` and `<method>_factors.nc`: the members of an ensemble, or the common factors of a Fast Kalman Filter, after
//! the last cycle of a run.

use super::coordinates as cf;
use super::file::{Definition, NetcdfFile, Values, Variable};
use crate::event::{MethodInfo, RunInfo};
use crate::output::SinkError;
use isobar_assim::{CovarianceRoot, RootKind};
use std::path::Path;

/// What the columns are called: the dimension of the file, and the end of its name.
pub fn names(kind: RootKind) -> (&'static str, &'static str) {
    match kind {
        RootKind::Members => ("member", "members"),
        RootKind::Factors => ("factor", "factors"),
    }
}

/// Writes the file of a method whose state is that before the first cycle of `info`.
///
/// # Errors
/// If it cannot be written.
pub fn write(path: &Path, info: &RunInfo, method: &MethodInfo, root: &dyn CovarianceRoot) -> Result<(), SinkError> {
    let (dimension, plural) = names(root.kind());
    let has_parameters = root.columns() > 0 && !root.column(0).1.is_empty();
    let mut file = NetcdfFile::create(path, definition(info, method, root.kind(), has_parameters))?;
    let cells = info.layout.grid.cells();
    for number in 0..root.columns() {
        let (state, calibration) = root.column(number);
        let (number, variables) = ([(number + 1) as f64], info.layout.variables.iter().map(|variable| variable.name));
        let mut record: Vec<(&str, &[f64])> = vec![(dimension, &number)];
        record.extend(variables.zip(state.chunks_exact(cells)));
        record.extend(has_parameters.then_some(("calibration", &*calibration)));
        file.append(&record)?;
    }
    match file.records() {
        0 => Err(file.failure(format!("there are no {plural}"))),
        _ => Ok(()),
    }
}

fn definition(info: &RunInfo, method: &MethodInfo, kind: RootKind, has_parameters: bool) -> Definition {
    let (dimension, plural) = names(kind);
    let mut definition = Definition::new();
    cf::add_global_attributes(&mut definition, info, &format!("{plural} of {}", method.name));
    definition.attribute("method", method.name.as_str());
    definition.attribute("method_description", method.description.as_str());
    definition.record_dimension(dimension);
    let number = Variable::new(dimension, &[]).with("long_name", format!("number of the {dimension}"));
    let number = number.with("units", "1");
    definition.record(match kind {
        RootKind::Members => number.with("standard_name", "realization"),
        RootKind::Factors => number,
    });
    let time = cf::time(Variable::new("time", &[]));
    definition.fixed(time, Values::Numbers(vec![info.begin().seconds() as f64]));
    cf::add_grid(&mut definition, &info.layout, info.projection.as_ref());
    for variable in &info.layout.variables {
        let (meaning, standard_name) = match kind {
            RootKind::Members => (format!("{} of a member", variable.long_name), variable.standard_name),
            RootKind::Factors => (format!("one standard deviation of a common factor in {}", variable.long_name), None),
        };
        let field = cf::field(variable.name, &meaning, variable.unit, variable.location, info.projection.is_some());
        definition.record(field.with_some("standard_name", standard_name).with_more("coordinates", "time"));
    }
    if has_parameters {
        cf::add_parameters(&mut definition, &info.calibration);
        let meaning = format!("calibration parameters of a {dimension}");
        definition.record(cf::parameters("calibration", &meaning, &info.calibration));
    }
    definition
}
