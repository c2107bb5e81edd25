//! The maps of the report.

use crate::calendar::utc;
use crate::event::RunInfo;
use crate::output::earth;
use crate::output::history::{Cycle, Fields, History, MethodMaps, ShownCorrelations};
use crate::output::netcdf::coordinates::safe_name;
use crate::output::structure::{ShownFactor, ShownStructure};
use crate::plot::colors::{GREYS, HUES, Scale, difference};
use crate::plot::map::{contour_levels, symmetric_steps};
use crate::plot::range::{quantile, round_up};
use crate::plot::{FieldMap, Mark, graticule};
use crate::tables::figure;
use isobar_obs::Report;

/// The most observations whose places are marked on a map.
const MOST_PLACES: usize = 3000;

/// A map, and the name of its file.
pub type Drawing = super::section::Drawing<FieldMap>;

/// The maps of one cycle.
pub struct MapsOfCycle {
    /// The cycle.
    pub cycle: usize,
    /// Its valid time.
    pub time: String,
    /// The truth, if there is one.
    pub truth: Option<Drawing>,
    /// For each method its name and maps.
    pub methods: Vec<(String, MethodDrawings)>,
}

/// The maps of a method.
pub struct MethodDrawings {
    /// The background with the observations.
    pub background: Drawing,
    /// The analysis.
    pub analysis: Drawing,
    /// Error of the analysis, if there is a truth.
    pub error: Option<Drawing>,
    /// Claimed spread of the analysis, if there is one.
    pub spread: Option<Drawing>,
}

/// The maps of a method's inner structure.
pub struct StructureMaps {
    /// The method.
    pub method: String,
    /// The blocks, as observations merged them.
    pub parts: Drawing,
    /// The leading common factors.
    pub factors: Vec<Drawing>,
}

/// The ranges that all maps of a variable share.
struct Ranges {
    state: [f32; 2],
    difference: f32,
    /// The steps of errors.
    error_steps: Vec<f32>,
    spread: f32,
}

/// Draws the maps of a run.
pub struct Maps<'a> {
    info: &'a RunInfo,
    history: &'a History,
    /// By variable.
    ranges: Vec<Ranges>,
    coast: Vec<Vec<[f64; 2]>>,
    graticule: Vec<graticule::Line>,
}

/// What is drawn of one method in one cycle: names for captions and files.
struct Subject<'a> {
    cycle: &'a Cycle,
    maps: &'a MethodMaps,
    method: &'a str,
    stem: String,
}

impl<'a> Maps<'a> {
    /// The maps of a complete run.
    pub fn new(info: &'a RunInfo, history: &'a History) -> Self {
        let ranges = (0..info.layout.variables.len()).map(|number| ranges(history, number));
        Self {
            info,
            history,
            ranges: ranges.collect(),
            coast: earth::coastlines(info),
            graticule: earth::graticule(info),
        }
    }

    /// The maps of the variable that is shown first, the latest cycle first.
    pub fn all(&self) -> Vec<MapsOfCycle> {
        let of_cycle = |cycle: &Cycle| {
            let (number, time, variable) = (cycle.number, utc(cycle.time), self.history.mapped);
            let name = self.info.layout.variables[variable].name;
            let methods = self.subjects(cycle).map(|it| (it.method.to_string(), self.of_method(&it)));
            let truth = cycle.truth.as_ref().map(|truth| Drawing {
                stem: format!("map_{number:04}_truth"),
                caption: format!("Truth of {name} at {time}."),
                plot: self.state(variable, format!("truth {name}"), truth),
            });
            MapsOfCycle { cycle: number, truth, methods: methods.collect(), time }
        };
        self.history.cycles.iter().rev().filter(|cycle| cycle.has_maps).map(of_cycle).collect()
    }

    /// Errors, or analyses without a truth, and spreads of every other variable in the last cycle, with the variable's name.
    pub fn other_variables(&self) -> Vec<(String, Vec<Drawing>)> {
        let others = self.info.layout.variables.iter().enumerate().filter(|(number, _)| *number != self.history.mapped);
        let drawings = |number: usize| {
            let pair = |it: Subject<'_>| {
                let first = self.error(&it, number).unwrap_or_else(|| self.analysis(&it, number));
                std::iter::once(first).chain(self.spread(&it, number))
            };
            self.last().flat_map(pair).collect()
        };
        others.map(|(number, variable)| (variable.name.to_string(), drawings(number))).collect()
    }

    /// Blocks and common factors in the last cycle.
    pub fn structures(&self) -> Vec<StructureMaps> {
        let of_method = |it: Subject<'_>| {
            let structure = it.maps.structure.as_ref()?;
            let factors = structure.factors.iter().zip(1..).map(|(factor, number)| self.factor(&it, factor, number));
            let (method, factors) = (it.method.to_string(), factors.collect());
            Some(StructureMaps { method, parts: self.parts(&it, structure), factors })
        };
        self.last().filter_map(of_method).collect()
    }

    /// The correlations with the error in the middle of the domain in the last cycle, for each variable with its name.
    pub fn correlations(&self) -> Vec<(String, Vec<Drawing>)> {
        let of_variable = |variable: usize| {
            let drawn = |it: Subject<'_>| Some(self.correlation(&it, it.maps.correlations.as_ref()?, variable));
            (self.variable(variable).0.to_string(), self.last().filter_map(drawn).collect())
        };
        (0..self.info.layout.variables.len()).map(of_variable).collect()
    }

    fn correlation(&self, it: &Subject<'_>, correlations: &ShownCorrelations, variable: usize) -> Drawing {
        let (grid, ShownCorrelations { of, fields, calibration }) = (&self.info.layout.grid, correlations);
        let (of_variable, cell) = (of / grid.cells(), of % grid.cells());
        let location = self.info.layout.variables[of_variable].location;
        let mark = mark(grid.x_m(location, cell % grid.nx), grid.y_m(location, cell / grid.nx));
        let (name, of_name) = (self.variable(variable).0, self.variable(of_variable).0);
        let title = format!("{}: correlation with {name}", it.method);
        let map = self.map(variable, title, fields[variable].clone(), Scale::Difference, [-1.0, 1.0]);
        let contours = contour_levels(map.range).into_iter().filter(|&level| level != 0.0);
        let mut caption = format!(
            "Correlation of the errors that {} claims for {of_name} at the dot and for {name} everywhere.",
            it.method
        );
        let most = calibration.iter().zip(&self.info.calibration.parameters);
        let most = most.filter(|it| it.0.abs() >= 0.05).max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
        if let (Some((value, parameter)), true) = (most, variable == of_variable) {
            caption += &format!(" Of the biases most with {}: {value:+.2}.", parameter.name);
        }
        Drawing {
            stem: format!("{}_correlation{}", it.stem, self.suffix(variable)),
            caption,
            // Around nothing at all a line at zero would be noise.
            plot: FieldMap { unit: "1".into(), contours: contours.collect(), marks: vec![mark], ..map },
        }
    }

    /// The methods in the last cycle that has maps.
    fn last(&self) -> impl Iterator<Item = Subject<'a>> {
        let cycle = self.history.cycles.iter().rfind(|cycle| cycle.has_maps);
        cycle.into_iter().flat_map(|cycle| self.subjects(cycle))
    }

    fn subjects(&self, cycle: &'a Cycle) -> impl Iterator<Item = Subject<'a>> + use<'a> {
        self.info.methods.iter().zip(&cycle.methods).enumerate().filter_map(move |(number, (method, own))| {
            // With its number, so that no two are the same.
            let stem = format!("map_{:04}_{:02}_{}", cycle.number, number + 1, safe_name(&method.name, "_-"));
            Some(Subject { cycle, maps: own.as_ref()?.maps.as_ref()?, method: &method.name, stem })
        })
    }

    fn of_method(&self, it: &Subject<'_>) -> MethodDrawings {
        let variable = self.history.mapped;
        let (name, unit) = self.variable(variable);
        let (method, limit) = (it.method, self.ranges[variable].difference);
        // Of the others they would be half of the page.
        let is_last = it.cycle.number == self.info.cycles;
        let mut background = self.state(variable, format!("{method}: background {name}"), &it.maps.background);
        let dots = dots(it.cycle, variable).filter_map(|(at, report)| Some((report, *it.maps.departures.get(at)?)));
        background.marks = dots
            .map(|(report, departure)| Mark {
                x_m: report.x_m,
                y_m: report.y_m,
                color: Some(difference(if is_last { departure } else { rounded(departure, limit) }, limit)),
                title: if is_last {
                    format!("{} {}: {departure:+.3} {unit}", report.network, report.platform)
                } else {
                    String::new()
                },
            })
            .collect();
        let caption = format!(
            "Background of {method}. Dots: {}, in the colour of their departure from it, dark blue for −{limit} {unit} or \
             less to dark red for +{limit} {unit} or more.",
            self.observations(it, variable)
        );
        let background = Drawing { stem: format!("{}_background", it.stem), caption, plot: background };
        let analysis = self.analysis(it, variable);
        let (error, spread) = (self.error(it, variable), self.spread(it, variable));
        MethodDrawings { background, analysis, error, spread }
    }

    fn analysis(&self, it: &Subject<'_>, variable: usize) -> Drawing {
        let (name, _) = self.variable(variable);
        Drawing {
            stem: format!("{}_analysis{}", it.stem, self.suffix(variable)),
            caption: format!("Analysis of {}.", it.method),
            plot: self.state(variable, format!("{}: analysis {name}", it.method), &it.maps.analysis),
        }
    }

    fn error(&self, it: &Subject<'_>, variable: usize) -> Option<Drawing> {
        let truth = it.cycle.truth.as_ref()?;
        let ((name, _), steps) = (self.variable(variable), &self.ranges[variable].error_steps);
        let error = errors(&it.maps.analysis[variable], &truth[variable]);
        let title = format!("{}: error of {name}, RMSE {}", it.method, figure(f64::from(root_mean_square(&error))));
        let limit = steps.last().copied().unwrap_or(1.0);
        let map = self.map(variable, title, error, Scale::Difference, [-limit, limit]);
        let (steps, marks) = (steps.clone(), self.marks(it, variable));
        let plot = FieldMap { steps, marks, contours: Vec::new(), ..map };
        let caption = format!("Analysis minus truth of {}. Dots: {}.", it.method, self.observations(it, variable));
        Some(Drawing { stem: format!("{}_error{}", it.stem, self.suffix(variable)), caption, plot })
    }

    fn spread(&self, it: &Subject<'_>, variable: usize) -> Option<Drawing> {
        let (name, _) = self.variable(variable);
        let (field, range) = (it.maps.spread.as_ref()?[variable].clone(), [0.0, self.ranges[variable].spread]);
        let title = format!("{}: claimed spread {name}", it.method);
        Some(Drawing {
            stem: format!("{}_spread{}", it.stem, self.suffix(variable)),
            caption: format!("Standard deviation that {} claims for its analysis.", it.method),
            plot: self.map(variable, title, field, Scale::Spread, range),
        })
    }

    fn parts(&self, it: &Subject<'_>, structure: &ShownStructure) -> Drawing {
        let field = structure.parts.iter().map(|&number| f32::from(number)).collect();
        let range = [0.0, (GREYS + HUES - 1) as f32];
        let map = self.map(self.history.mapped, format!("{}: blocks", it.method), field, Scale::Parts, range);
        let marks = self.marks(it, self.history.mapped);
        Drawing {
            stem: format!("{}_blocks", it.stem),
            caption: format!(
                "Blocks of {} that observations link have one colour, the largest part light blue; grey: not observed. {}.",
                it.method, structure.summary
            ),
            plot: FieldMap { unit: String::new(), contours: Vec::new(), marks, ..map },
        }
    }

    fn factor(&self, it: &Subject<'_>, factor: &ShownFactor, number: usize) -> Drawing {
        let variable = self.history.mapped;
        let (limit, field) = (round_up(Some(factor.largest[variable])), factor.fields[variable].clone());
        let title = format!("{}: common factor {number}, {}", it.method, self.variable(variable).0);
        Drawing {
            stem: format!("{}_factor_{number}", it.stem),
            caption: format!("One standard deviation of common factor {number} of {}: {}.", it.method, factor.summary),
            plot: self.map(variable, title, field, Scale::Difference, [-limit, limit]),
        }
    }

    fn variable(&self, number: usize) -> (&'a str, &'a str) {
        let variable = &self.info.layout.variables[number];
        (variable.name, variable.unit)
    }

    /// What tells the files of a variable from those of the one that is shown first.
    fn suffix(&self, variable: usize) -> String {
        if variable == self.history.mapped { String::new() } else { format!("_{}", self.variable(variable).0) }
    }

    /// Which observations have dots.
    fn observations(&self, it: &Subject<'_>, variable: usize) -> String {
        let name = self.variable(variable).0;
        match every(it.cycle, variable) {
            1 => format!("observations of {name}"),
            every => format!("one of {every} observations of {name}"),
        }
    }

    /// Dots where the variable was observed.
    fn marks(&self, it: &Subject<'_>, variable: usize) -> Vec<Mark> {
        dots(it.cycle, variable).map(|(_, it)| mark(it.x_m, it.y_m)).collect()
    }

    fn state(&self, variable: usize, title: String, fields: &Fields) -> FieldMap {
        self.map(variable, title, fields[variable].clone(), Scale::State, self.ranges[variable].state)
    }

    /// A map of a thinned field, in the unit of a variable.
    pub fn map(&self, variable: usize, title: String, field: Vec<f32>, scale: Scale, range: [f32; 2]) -> FieldMap {
        let grid = self.history.thinning.grid(&self.info.layout.grid);
        FieldMap {
            title,
            unit: self.variable(variable).1.to_string(),
            field,
            size: self.history.thinning.size(),
            extent_m: [grid.width_m(), grid.height_m()],
            scale,
            range,
            steps: Vec::new(),
            contours: contour_levels(range),
            coast: self.coast.clone(),
            graticule: self.graticule.clone(),
            marks: Vec::new(),
        }
    }

    /// A map without a field, for marks alone.
    pub fn empty(&self, title: String, unit: String, limit: f32) -> FieldMap {
        let map = self.map(self.history.mapped, title, Vec::new(), Scale::Difference, [-limit, limit]);
        FieldMap { unit, contours: Vec::new(), ..map }
    }
}

/// A difference to a tenth of a limit, and within it: dots of few colours are written together.
fn rounded(difference: f32, limit: f32) -> f32 {
    (10.0 * difference / limit).round().clamp(-10.0, 10.0) / 10.0 * limit
}

/// A small dark dot.
fn mark(x_m: f64, y_m: f64) -> Mark {
    Mark { x_m, y_m, color: None, title: String::new() }
}

fn errors(analysis: &[f32], truth: &[f32]) -> Vec<f32> {
    analysis.iter().zip(truth).map(|(value, truth)| value - truth).collect()
}

fn absolute(values: Vec<f32>) -> Vec<f32> {
    values.into_iter().map(f32::abs).collect()
}

fn root_mean_square(values: &[f32]) -> f32 {
    let squares: f64 = values.iter().map(|value| f64::from(*value).powi(2)).sum();
    (squares / values.len().max(1) as f64).sqrt() as f32
}

/// Errors have a colour from this share of the smallest error of a method on.
const LEAST_SHOWN: f32 = 0.4;

/// Steps that show the errors of all methods, however far apart they are.
fn error_steps(history: &History, variable: usize) -> Vec<f32> {
    let mut all: Vec<Vec<f32>> = Vec::new();
    for cycle in history.cycles.iter().filter(|cycle| cycle.has_maps) {
        let Some(truth) = &cycle.truth else { continue };
        let maps = cycle.methods.iter().flatten().filter_map(|own| own.maps.as_ref());
        all.extend(maps.map(|maps| errors(&maps.analysis[variable], &truth[variable])));
    }
    let least = all.iter().map(|own| root_mean_square(own)).filter(|rms| *rms > 0.0).reduce(f32::min);
    let most = all.into_iter().filter_map(|own| quantile(absolute(own), 0.98));
    symmetric_steps(LEAST_SHOWN * least.unwrap_or(1.0), most.reduce(f32::max).unwrap_or(1.0))
}

/// The observations of a variable, with their numbers.
fn observations(cycle: &Cycle, variable: usize) -> impl Iterator<Item = (usize, &Report)> {
    cycle.reports.iter().enumerate().filter(move |(_, report)| report.variable == variable)
}

/// The step from an observation of a variable that has a dot to the next one that has.
fn every(cycle: &Cycle, variable: usize) -> usize {
    observations(cycle, variable).count().div_ceil(MOST_PLACES).max(1)
}

/// The observations of a variable that have dots, with their numbers.
fn dots(cycle: &Cycle, variable: usize) -> impl Iterator<Item = (usize, &Report)> {
    observations(cycle, variable).step_by(every(cycle, variable))
}

fn ranges(history: &History, variable: usize) -> Ranges {
    let usual = |values: &dyn Fn(&Cycle, &MethodMaps) -> Vec<f32>| round_up(history.usual(0.98, values));
    Ranges {
        state: history.state_range(variable),
        error_steps: error_steps(history, variable),
        difference: usual(&|cycle, maps| match &cycle.truth {
            Some(truth) => absolute(errors(&maps.analysis[variable], &truth[variable])),
            None => dots(cycle, variable).filter_map(|(at, _)| Some(maps.departures.get(at)?.abs())).collect(),
        }),
        spread: usual(&|_, maps| maps.spread.as_ref().map_or_else(Vec::new, |it| it[variable].clone())),
    }
}
