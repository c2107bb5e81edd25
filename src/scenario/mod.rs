//! Scenarios: an experiment is a TOML file, read into a [`Scenario`] in which everything that the file itself can get
//! wrong is checked.
//!
//! No default is hidden from a reader of the file but those that the settings' documentation names.

mod accept;
mod comparisons;
mod cycle;
mod expected;
mod fault;
mod grid;
mod initialise;
pub(crate) mod keys;
mod moved;
mod quality;
mod sensors;
mod sweep;
mod truth;

pub use crate::reader::ScenarioError;
pub use crate::scores::Expected;
pub use accept::{AcceptError, accept, with_expected};
pub use comparisons::ComparisonSettings;
pub use cycle::CycleSettings;
pub use grid::GridSettings;
pub use initialise::Initialise;
pub use sensors::{SensorSettings, StabilitySettings};
pub use sweep::SweepSettings;
pub use truth::{TruthSeries, TruthSettings, TwinSettings};

use crate::kinds::covariances::{self, Components};
use crate::kinds::initial::{self, GivenState, INITIAL, InitialState};
use crate::kinds::instruments;
use crate::kinds::methods::{self, Method, Surroundings};
use crate::kinds::models::{self, Model};
use crate::kinds::{self, Domain, distinct_name, forcing, forecast, plain_name, warnings};
use crate::lead_times::LeadTimes;
use crate::output::Outputs;
use crate::reader::{self, AnyKey, Faults, Field, FileName, Read, Section, SourceFile};
use crate::safe_file;
use crate::scores::expected::TOLERANCE_KEY;
use crate::scores::kinds::BRIER;
use crate::scores::{Part, ScoreKind};
use crate::text;
use crate::threshold_warning::ThresholdWarning;
use indexmap::IndexMap;
use isobar_model::{Adjoint, Layout, State, Time};
use isobar_obs::{Network, QualityControl};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The largest scenario file \[bytes\].
const LARGEST_FILE: u64 = 1_000_000;

/// An experiment, as its file describes it.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// The file's stem.
    pub name: String,
    /// The file.
    pub path: PathBuf,
    /// The file's text, to the letter.
    pub text: String,
    /// The names of files in it.
    file_names: Vec<FileName>,
    /// Checksums of what the tables say that it names and on which the results depend, of stations, observations and fields;
    /// by their names in the file.
    pub tables: BTreeMap<String, u32>,
    /// Title, in one line.
    pub title: String,
    /// The phenomenon that the experiment shows.
    pub phenomenon: String,
    /// The paper or other origin.
    pub source: String,
    /// The seed of all random streams.
    pub seed: u64,
    /// Valid time of the initial state.
    pub start: Time,
    /// The plane.
    pub grid: GridSettings,
    /// The methods' model.
    pub model: Model,
    /// The first background.
    pub initial: Arc<dyn InitialState>,
    /// B: covariance of the truth's deviation from the first background, and static covariance of 3D-Var.
    pub background_error: Components,
    /// Q: covariance of the error that the model makes in one cycle; empty for a perfect model.
    pub model_error: Components,
    /// How the true world differs from that; `None` without a truth, where there are only recorded observations.
    pub truth: Option<TruthSettings>,
    /// The cycles.
    pub cycle: CycleSettings,
    /// The lead times of forecasts ahead, if there are such forecasts.
    pub forecast: Option<LeadTimes>,
    /// The events of which forecasts ahead warn.
    pub warnings: Vec<ThresholdWarning>,
    /// How the values of observations are checked, if they are.
    pub quality_control: Option<QualityControl>,
    /// The networks, in the order of the file.
    pub networks: Vec<Network>,
    /// Comparisons of sensors and test points within the run.
    pub comparisons: Vec<ComparisonSettings>,
    /// The methods, in the order of the file.
    pub methods: IndexMap<String, Method>,
    /// What some methods start from instead of the biases' priors.
    pub initialise: Option<Initialise>,
    /// Number of cycles between two in which the influence of each type of observations is computed; `None`: never.
    pub influence_every_cycles: Option<usize>,
    /// Which keys vary in a sweep, if any do.
    pub sweep: Option<SweepSettings>,
    /// What is known of sensors from run to run.
    pub sensors: Option<SensorSettings>,
    /// When a bias is adjusted.
    pub stability: StabilitySettings,
    /// What is written.
    pub outputs: Outputs,
    /// Whether it is run for regression with all others: `false` for scenarios too expensive for that.
    pub regression: bool,
    /// The accepted scores.
    pub expected: Expected,
}

impl Scenario {
    /// The plane, with the methods' model.
    pub fn domain(&self) -> Domain {
        self.domain_of(&self.model)
    }

    /// Whether some observations are valid before the end of their window, and are compared with the states then.
    pub fn observes_within_window(&self) -> bool {
        self.networks.iter().any(Network::is_within_window)
    }

    /// The plane, with another model.
    pub fn domain_of(&self, model: &Model) -> Domain {
        self.grid.domain(model)
    }

    /// Whether the truth's model has a key with another value than `[model]`.
    pub fn truth_has_other_model(&self) -> bool {
        let file: toml::Table = self.text.parse().expect("the text has been read before");
        let changes = file.get("truth").and_then(|truth| truth.get("model")?.as_table());
        changes.is_some_and(|changes| changes.iter().any(|(key, value)| file["model"].get(key) != Some(value)))
    }

    /// The database of sensors, if the user has named it.
    pub fn named_database(&self) -> Option<&Path> {
        let sensors = self.sensors.as_ref().filter(|sensors| sensors.within.is_none())?;
        Some(&sensors.database)
    }

    /// Takes the database of sensors that the user names; whether the scenario has one that it can take the place of.
    pub(crate) fn name_database(&mut self, named: &Path) -> bool {
        let Some(settings) = &mut self.sensors else { return false };
        settings.database = named.to_path_buf();
        settings.within = None;
        true
    }

    /// Reads a scenario file.
    ///
    /// # Errors
    /// All faults in the file that do not follow from others, with their places.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        let bytes = safe_file::read_named(path, LARGEST_FILE);
        let bytes = bytes.map_err(|error| ScenarioError::of_file(path, error.to_string()))?;
        match String::from_utf8(bytes) {
            Ok(text) => Self::parse(path, &text),
            Err(error) => {
                let place = error.utf8_error().valid_up_to();
                let text = String::from_utf8_lossy(error.as_bytes());
                let message = "the file is not UTF-8 text".to_string();
                Err(SourceFile::new(path, &text).error(place..place + 1, message, "not a character", None))
            }
        }
    }

    /// Reads the text of a scenario file. Station files are sought beside `path`.
    ///
    /// # Errors
    /// As [`Scenario::load`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, ScenarioError> {
        Self::read(path, text, None)
    }

    /// As [`Scenario::parse`], with a model that is made by code and the first background: the text has no `[grid]`, `[model]`
    /// and `[initial]`.
    ///
    /// Each cycle is a forecast with this one model, and [`TwinSettings::model`] is it, too. A truth of another model can be set
    /// there.
    ///
    /// # Errors
    /// As [`Scenario::load`]; if the background is not a state of the model.
    pub fn parse_with_model(
        path: &Path,
        text: &str,
        model: impl Adjoint + 'static,
        background: State,
    ) -> Result<Self, ScenarioError> {
        if background.layout() != model.layout() {
            return Err(ScenarioError::of_file(path, "the background is not a state of the given model"));
        }
        Self::read(path, text, Some((Model::given(Arc::new(model)), background)))
    }

    fn read(path: &Path, text: &str, given: Option<(Model, State)>) -> Result<Self, ScenarioError> {
        if text.len() as u64 > LARGEST_FILE {
            let reason = format!("it is larger than {} kB, the largest scenario", LARGEST_FILE / 1000);
            return Err(ScenarioError::of_file(path, reason));
        }
        let file = SourceFile::new(path, text);
        let tree = reader::parse(&file, text)?;
        let root = Section::root(&file, &tree);
        let is_given = |key: &&&dyn AnyKey| given.is_some() && WORLD.contains(&key.name());
        let keys: Vec<&dyn AnyKey> = keys::ALL.iter().filter(|key| !is_given(key)).copied().collect();
        let mut faults = Faults::default();
        match Self::read_parts(&root, given, &mut faults) {
            Some(scenario) if faults.is_empty() => {
                let (file_names, tables) = file.into_names();
                let name = path.file_stem().map_or(String::new(), |stem| text::clean(&stem.to_string_lossy()));
                Ok(Self { name, path: path.to_path_buf(), text: text.to_string(), file_names, tables, ..scenario })
            }
            // Parts that were not read, because others have faults, are at least compared with their forms.
            _ => Err(faults.with(reader::of_keys(&root, &keys, &kinds::list))),
        }
    }

    /// Reads all parts and collects their faults: a part is not read if one on which it depends has a fault. The fields that
    /// belong to the file as a whole are left empty.
    fn read_parts(root: &Section<'_>, given: Option<(Model, State)>, faults: &mut Faults) -> Option<Self> {
        faults.keep(root.check_names(keys::ALL));
        let title = faults.keep(string(root, "title"));
        let phenomenon = faults.keep(string(root, "phenomenon"));
        let source = faults.keep(string(root, "source"));
        let seed = faults.keep(root.required("seed").and_then(|field| field.integer(0, i64::MAX)));
        let start = faults.keep(root.required("start").and_then(|field| field.time()));
        let outputs = faults.keep(cycle::read_output(root));
        let influence_every_cycles = faults.keep(cycle::read_diagnostics(root));
        let regression = faults.keep(root.get(&keys::REGRESSION));

        let World { grid, model_field, mut model, initial, layout } = faults.keep(World::read(root, given))?;
        let forcing = faults.keep(forcing::read(root, "forcing", &grid.domain(&model)));
        model.forcing = forcing.flatten().unwrap_or_default();
        let domain = grid.domain(&model);
        let background_error = root.required("background_error").and_then(|field| covariances::read(&field, &domain));
        let background_error = faults.keep(background_error);
        let model_error = root.optional("model_error").map(|field| covariances::read(&field, &domain));
        let model_error = faults.keep(model_error.unwrap_or(Ok(Vec::new())));
        let networks = faults.keep(instruments::read(root, &domain));
        let truth = networks
            .as_ref()
            .and_then(|networks| faults.keep(truth::read(root, model_field.as_ref(), &domain, &layout, networks)));
        let true_step = match &truth {
            Some(Some(TruthSettings::Twin(twin))) => twin.model.time_step,
            _ => model.time_step,
        };
        let steps = [("model.time_step_s", model.time_step), ("truth.model.time_step_s", true_step)];
        let cycle = start.and_then(|start| faults.keep(cycle::read(root, start, &steps)))?;
        let forecast = faults.keep(forecast::read(root, cycle.window, cycle.count, cycle.score_from_cycle));
        let warnings =
            forecast.as_ref().and_then(|forecast| faults.keep(warnings::read(root, &domain, forecast.as_ref())));
        let stability = faults.keep(sensors::read_stability(root, cycle.count));
        let comparisons = start.zip(truth.as_ref()).and_then(|(start, truth)| {
            faults.keep(comparisons::read(root, start, cycle.window, cycle.count, truth.is_some()))
        });
        let (background_error, model_error) = (background_error?, model_error?);
        let networks = networks?;
        let correlated = correlated_network(&networks);
        let quality_control = faults.keep(quality::read(root, &background_error, &grid, &networks));
        let surroundings = Surroundings {
            domain,
            initial: Arc::clone(&initial),
            cycles: cycle.count,
            cycle: cycle.window,
            compares: comparisons.as_ref().is_some_and(|comparisons| !comparisons.is_empty()),
            freezing_key: stability.and_then(|stability| stability.freezing_key()),
            networks: networks.iter().filter(|it| it.assimilate).map(|network| network.name.clone()).collect(),
            correlated: correlated.map(|network| network.name.clone()),
            background_error: background_error.clone(),
            model_error: model_error.clone(),
            has_model_error: !model_error.is_empty(),
            error_length_m: covariances::shortest_length_m(&model_error)
                .or_else(|| covariances::shortest_length_m(&background_error)),
        };
        let methods = faults.keep(read_methods(root, &surroundings))?;
        let initialise = faults.keep(initialise::read(root, &methods, cycle.count, correlated));
        let sensors = faults.keep(sensors::read(root, &methods));
        let expected = faults.keep(expected::read(root, &methods, &model));
        let (truth, forecast, warnings) = (truth?, forecast?, warnings?);
        let has_passive = networks.iter().any(Network::has_passive);
        let can_have = |kind: &ScoreKind| {
            (kind.part != Part::Forecast || forecast.is_some())
                && (kind.name != BRIER || !warnings.is_empty())
                && kind.against.exists(truth.is_some(), has_passive)
        };
        let sweep = faults.keep(sweep::read(root, &model, can_have));
        Some(Self {
            name: String::new(),
            path: PathBuf::new(),
            text: String::new(),
            file_names: Vec::new(),
            tables: BTreeMap::new(),
            title: title?,
            phenomenon: phenomenon?,
            source: source?,
            seed: seed? as u64,
            start: start?,
            grid,
            model,
            initial,
            background_error,
            model_error,
            truth,
            cycle,
            forecast,
            warnings,
            quality_control: quality_control?,
            networks,
            comparisons: comparisons?,
            methods,
            initialise: initialise?,
            influence_every_cycles: influence_every_cycles?,
            sweep: sweep?,
            sensors: sensors?,
            stability: stability?,
            outputs: outputs?,
            regression: regression?,
            expected: expected?,
        })
    }
}

/// The tables that a model from code replaces.
const WORLD: [&str; 3] = ["grid", "model", "initial"];

/// A network that is assimilated, and whose errors methods should take as correlated, if there is one.
fn correlated_network(networks: &[Network]) -> Option<&Network> {
    let is_correlated = |network: &&Network| {
        network.assimilate && network.error_correlation.is_some_and(|correlation| correlation.assumed_length_m > 0.0)
    };
    networks.iter().find(is_correlated)
}

/// The plane, the model and its first background.
struct World<'a> {
    grid: GridSettings,
    /// `[model]`; `None` if it is given by code.
    model_field: Option<Field<'a>>,
    model: Model,
    initial: Arc<dyn InitialState>,
    /// That of its states.
    layout: Arc<Layout>,
}

impl<'a> World<'a> {
    fn read(root: &Section<'a>, given: Option<(Model, State)>) -> Read<Self> {
        if let Some((model, background)) = given {
            if let Some(field) = WORLD.into_iter().find_map(|key| root.optional(key)) {
                let message = format!("[{}] is given by code, with the model", field.title());
                return Err(field.misplaced(message, "leave it out"));
            }
            let grid = GridSettings { grid: background.layout().grid.clone(), projection: None };
            let layout = Arc::clone(background.layout());
            return Ok(Self { grid, model_field: None, model, initial: Arc::new(GivenState(background)), layout });
        }
        let grid = grid::read(root)?;
        let model_field = root.required("model")?;
        let model = models::read(&model_field, &grid.grid)?;
        let domain = grid.domain(&model);
        let initial = kinds::read(&root.required("initial")?, INITIAL, &domain)?.into();
        let layout = initial::layout(&domain);
        Ok(Self { grid, model_field: Some(model_field), model, initial, layout })
    }
}

/// The most methods of a scenario.
const MOST_METHODS: usize = 100;

/// Reads `[methods]`, in the order of the file.
fn read_methods(root: &Section<'_>, surroundings: &Surroundings) -> Read<IndexMap<String, Method>> {
    let field = root.required("methods")?;
    let mut names: Vec<String> = Vec::new();
    let methods = reader::read_all(field.any_section()?.fields().map(|(name, field)| {
        check_method_name(name, names.iter()).map_err(|(message, help)| field.misplaced(message, help))?;
        if names.len() == MOST_METHODS {
            return Err(field.misplaced(format!("there are more than {MOST_METHODS} methods"), "too many"));
        }
        names.push(name.to_string());
        Ok((name.to_string(), methods::read(&field, surroundings)?))
    }))?;
    if methods.is_empty() {
        return Err(field.misplaced("[methods] is empty".into(), "add a table such as [methods.fkf]"));
    }
    Ok(methods.into_iter().collect())
}

/// Refuses a name that a method cannot have beside these others.
///
/// # Errors
/// What is wrong, and what to do.
pub(crate) fn check_method_name<'a>(
    name: &str,
    others: impl Iterator<Item = &'a String>,
) -> Result<(), (String, &'static str)> {
    plain_name(name, "method")?;
    if name == TOLERANCE_KEY {
        return Err((format!("a method cannot be called {name}"), "[expected] has a key of that name"));
    }
    if ["truth", "observations"].iter().any(|file| name.eq_ignore_ascii_case(file)) {
        return Err((format!("a method cannot be called {name}"), "a file of every run has that name"));
    }
    distinct_name(name, others.map(String::as_str), "method")
}

fn string(root: &Section<'_>, key: &str) -> Read<String> {
    root.required(key)?.text()
}
