//! `[sensors]` and `[stability]`: what is known of sensors from run to run, and when a bias is adjusted.

use crate::kinds::methods::Method;
use crate::place::parent_of;
use crate::reader::{Absent, AnyKey, Described, Form, Key, Limits, Read, Section, Whole};
use crate::scores::stability::{Freezing, Hysteresis};
use crate::shell::command;
use crate::text::{clean, listed, shown_path};
use indexmap::IndexMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Component, Path, PathBuf};

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
    /// The directory below which the file must be to be written: the scenario's own. `None`: wherever it is, for the user
    /// has named it on the command line.
    pub within: Option<PathBuf>,
}

impl SensorSettings {
    /// Whether the database can be written back, and may be: a scenario comes from anywhere, and writes into no place but its
    /// own directory and those below.
    ///
    /// # Errors
    /// In words, if not.
    pub fn check_place(&self) -> Result<(), String> {
        if self.writes.is_none() {
            return Ok(());
        }
        let directory = parent_of(&self.database);
        let shown = shown_path(directory);
        let real = directory.canonicalize().ok().filter(|directory| directory.is_dir());
        let real = real.ok_or_else(|| format!("it cannot be written, for there is no directory {shown}"))?;
        if let Some(within) = &self.within {
            let named = self.database.strip_prefix(within).unwrap_or(&self.database);
            let is_below = named.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
            let within = if within.as_os_str().is_empty() { Path::new(".") } else { within };
            let is_link = fs::symlink_metadata(&self.database).is_ok_and(|metadata| metadata.is_symlink());
            if !is_below || is_link || !within.canonicalize().is_ok_and(|within| real.starts_with(within)) {
                let why = if is_link { "it is a link" } else { "it is not below the scenario's directory" };
                return Err(format!(
                    "{why}, and so a scenario may not write there: name it on the command line with `{}`",
                    command("--sensors", &[&self.database])
                ));
            }
        }
        let cannot = |error: std::io::Error| format!("it cannot be written: {error}");
        match fs::metadata(&self.database) {
            // A file without a name: nothing is left of it.
            Err(error) if error.kind() == ErrorKind::NotFound => tempfile::tempfile_in(&real).map(drop).map_err(cannot),
            Ok(metadata) if metadata.is_file() => {
                fs::OpenOptions::new().write(true).open(&self.database).map(drop).map_err(cannot)
            }
            // Neither waits for a pipe.
            _ => Err("it is not a file".into()),
        }
    }
}

/// When a bias counts as determined, and what becomes of one that does not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StabilitySettings {
    /// The largest share of its prior variance that a parameter may keep.
    pub variance_ratio: f64,
    /// When parameters without a stable update are adjusted no more.
    pub freezing: Freezing,
}

impl StabilitySettings {
    /// The key by which parameters are frozen, if they are.
    pub fn freezing_key(&self) -> Option<&'static str> {
        match self.freezing {
            Freezing::Never => None,
            Freezing::AfterCycle(_) => Some(FREEZE_AFTER_CYCLES.name),
            Freezing::WhileUnstable(_) => Some(FREEZE_UNSTABLE_CYCLES.name),
        }
    }
}

const DATABASE: Key<Described> = Key::required(
    "database",
    "",
    Described("a file of `isobar sensors`", Form::text),
    "from what is known there every method that estimates biases starts",
);

const WRITES: Key<Described> = Key::absent(
    "writes",
    "",
    Described("the name of a method that estimates biases", Form::text),
    Absent::Explained("nothing is written back"),
    "the method whose last calibration is written back once the run is complete",
);

/// The keys of `[sensors]`.
pub(super) const KEYS: &[&dyn AnyKey] = &[&DATABASE, &WRITES];

const VARIANCE_RATIO: Key<Limits> = Key::absent(
    "variance_ratio",
    "1",
    Limits::Between(1e-6, 0.999),
    Absent::Means(DEFAULT_VARIANCE_RATIO),
    "share of its prior variance below which a bias counts as determined",
);

const FREEZE_AFTER_CYCLES: Key<Described> = Key::absent(
    "freeze_after_cycles",
    "cycles",
    Described("a whole number from 1 to `cycle.count`", || Form::Whole(1, 1_000_000)),
    Absent::Explained("never"),
    "cycle after which biases without a stable update go back to their prior, and are adjusted no more",
);

const FREEZE_UNSTABLE_CYCLES: Key<Whole> = Key::absent(
    "freeze_unstable_cycles",
    "cycles",
    Whole(1, 1_000_000),
    Absent::Explained("never"),
    "cycles in succession without a stable update, after which a bias keeps estimate and variance, and is adjusted no more until \
     it would have one",
);

const THAW_STABLE_CYCLES: Key<Whole> = Key::absent(
    "thaw_stable_cycles",
    "cycles",
    Whole(1, 1_000_000),
    Absent::Explained("as many as `freeze_unstable_cycles`"),
    "cycles in succession in which a frozen bias would have a stable update, after which it is adjusted again",
);

/// The keys of `[stability]`.
pub(super) const STABILITY_KEYS: &[&dyn AnyKey] =
    &[&VARIANCE_RATIO, &FREEZE_AFTER_CYCLES, &FREEZE_UNSTABLE_CYCLES, &THAW_STABLE_CYCLES];

/// Reads `[sensors]`.
pub(super) fn read(root: &Section<'_>, methods: &IndexMap<String, Method>) -> Read<Option<SensorSettings>> {
    let Some(field) = root.optional("sensors") else { return Ok(None) };
    let section = field.section_with(KEYS)?;
    let file = section.required(DATABASE.name)?;
    let (name, database, within) = (file.text()?, file.path()?, Some(parent_of(&file.file.path).to_path_buf()));
    let Some(field) = section.optional(WRITES.name) else {
        return Ok(Some(SensorSettings { name, database, writes: None, within }));
    };
    let writer = field.text()?;
    if !methods.get(&writer).is_some_and(Method::estimates_biases) {
        let able = methods.iter().filter(|(_, method)| method.estimates_biases());
        let message =
            format!("`{}` cannot be \"{}\": no method of this name estimates biases", field.title(), clean(&writer));
        return Err(field.invalid(message, &format!("one of {}", listed(able.map(|(name, _)| name.as_str())))));
    }
    Ok(Some(SensorSettings { name, database, writes: Some(writer), within }))
}

/// Reads `[stability]`.
pub(super) fn read_stability(root: &Section<'_>, cycles: usize) -> Read<StabilitySettings> {
    let mut settings = StabilitySettings { variance_ratio: DEFAULT_VARIANCE_RATIO, freezing: Freezing::Never };
    let Some(field) = root.optional("stability") else { return Ok(settings) };
    let section = field.section_with(STABILITY_KEYS)?;
    settings.variance_ratio = section.get(&VARIANCE_RATIO)?;
    if let Some(field) = section.optional(FREEZE_AFTER_CYCLES.name) {
        settings.freezing = Freezing::AfterCycle(field.whole(1, cycles)?);
    }
    if let Some(unstable_cycles) = section.find(&FREEZE_UNSTABLE_CYCLES)? {
        let stable_cycles = section.find(&THAW_STABLE_CYCLES)?.unwrap_or(unstable_cycles);
        if settings.freezing != Freezing::Never {
            let message = "biases are frozen after one cycle for good, or while they have no stable update, not both";
            let help = format!("leave out this key or `{}`", FREEZE_AFTER_CYCLES.name);
            return Err(section.required(FREEZE_UNSTABLE_CYCLES.name)?.misplaced(message.into(), &help));
        }
        settings.freezing = Freezing::WhileUnstable(Hysteresis { unstable_cycles, stable_cycles });
    } else if let Some(field) = section.optional(THAW_STABLE_CYCLES.name) {
        let message = "nothing is frozen that could be adjusted again".to_string();
        return Err(field.misplaced(message, &format!("give `{}` as well", FREEZE_UNSTABLE_CYCLES.name)));
    }
    Ok(settings)
}
