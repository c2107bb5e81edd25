//! `[sensors]` and `[stability]`: what is known of sensors from run to run, and when a bias is adjusted.

use crate::kinds::methods::Method;
use crate::reader::{Limits, Read, Section};
use crate::text::{clean, listed};
use indexmap::IndexMap;
use std::path::PathBuf;

/// Share of its prior variance above which a parameter is not determined by the data, unless the scenario says what: the
/// data must at least halve its standard deviation.
const DEFAULT_VARIANCE_RATIO: f64 = 0.25;

/// The database of sensors.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSettings {
    /// The file's name in the scenario.
    pub name: String,
    /// The file, which every method that estimates biases reads at its start.
    pub database: PathBuf,
    /// The method whose last calibration is written back once the run is complete; `None`: nothing is.
    pub writes: Option<String>,
}

/// When a bias counts as determined, and what becomes of one that does not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StabilitySettings {
    /// The largest share of its prior variance that a parameter may keep.
    pub variance_ratio: f64,
    /// After this cycle parameters without a stable update go back to their prior and are adjusted no more; `None`: never.
    pub freeze_after_cycles: Option<usize>,
}

/// Reads `[sensors]`.
pub(super) fn read(root: &Section<'_>, methods: &IndexMap<String, Method>) -> Read<Option<SensorSettings>> {
    let Some(field) = root.optional("sensors") else { return Ok(None) };
    let section = field.section(&["database", "writes"])?;
    let file = section.required("database")?;
    let (name, database) = (file.text()?, file.path()?);
    let Some(field) = section.optional("writes") else {
        return Ok(Some(SensorSettings { name, database, writes: None }));
    };
    let writer = field.text()?;
    if !methods.get(&writer).is_some_and(Method::estimates_biases) {
        let able = methods.iter().filter(|(_, method)| method.estimates_biases());
        let message =
            format!("`{}` cannot be \"{}\": no method of this name estimates biases", field.title(), clean(&writer));
        return Err(field.invalid(message, &format!("one of {}", listed(able.map(|(name, _)| name.as_str())))));
    }
    Ok(Some(SensorSettings { name, database, writes: Some(writer) }))
}

/// Reads `[stability]`.
pub(super) fn read_stability(root: &Section<'_>, cycles: usize) -> Read<StabilitySettings> {
    let mut settings = StabilitySettings { variance_ratio: DEFAULT_VARIANCE_RATIO, freeze_after_cycles: None };
    let Some(field) = root.optional("stability") else { return Ok(settings) };
    let section = field.section(&["variance_ratio", "freeze_after_cycles"])?;
    settings.variance_ratio =
        section.number_or("variance_ratio", DEFAULT_VARIANCE_RATIO, Limits::Between(1e-6, 0.999))?;
    settings.freeze_after_cycles = section.optional("freeze_after_cycles").map(|it| it.whole(1, cycles)).transpose()?;
    Ok(settings)
}
