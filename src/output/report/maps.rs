//! The maps of the report.

use super::history::{Fields, History, ShownCorrelations, Snapshot};
use crate::calendar::utc;
use crate::event::RunInfo;
use crate::output::netcdf::coordinates::safe_name;
use crate::output::structure::{ShownFactor, ShownStructure};
use crate::plot::colors::{GREYS, HUES, Scale, difference};
use crate::plot::map::contour_levels;
use crate::plot::range::{around, quantile, round_up};
use crate::plot::{FieldMap, Mark};

/// A map, and the name of its file.
pub struct Drawing {
    /// The file's stem.
    pub stem: String,
    /// What it shows, in words.
    pub caption: String,
    /// The map.
    pub map: FieldMap,
}

/// The maps of one cycle.
pub struct MapsOfCycle {
    /// The cycle.
    pub cycle: usize,
    /// Its valid time.
    pub time: String,
    /// The truth, if there is one.
    pub truth: Option<Drawing>,
    /// For each method its name and maps.
    pub methods: Vec<(String, MethodMaps)>,
}

/// The maps of a method.
pub struct MethodMaps {
    /// Background and analysis.
    pub states: Vec<Drawing>,
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
    spread: f32,
}

/// Draws the maps of a run.
pub struct Maps<'a> {
    info: &'a RunInfo,
    history: &'a History,
    /// By variable.
    ranges: Vec<Ranges>,
}

/// What is drawn of one method in one cycle: names for captions and files.
struct Subject<'a> {
    snapshot: &'a Snapshot,
    fields: &'a Fields,
    method: &'a str,
    stem: String,
}

impl<'a> Maps<'a> {
    /// The maps of a complete run.
    pub fn new(info: &'a RunInfo, history: &'a History) -> Self {
        let ranges = (0..info.layout.variables.len()).map(|number| ranges(history, number, info.methods.len()));
        Self { info, history, ranges: ranges.collect() }
    }

    /// The maps of the variable that is shown first, the latest cycle first.
    pub fn all(&self) -> Vec<MapsOfCycle> {
        let of_cycle = |(&cycle, snapshot): (&usize, &Snapshot)| {
            let (time, variable) = (utc(snapshot.time), self.history.mapped);
            let name = self.info.layout.variables[variable].name;
            let methods = self.subjects(cycle, snapshot).map(|it| (it.method.to_string(), self.of_method(&it)));
            let truth = snapshot.truth.as_ref().map(|truth| Drawing {
                stem: format!("map_{cycle:04}_truth"),
                caption: format!("Truth of {name} at {time}."),
                map: self.state(variable, format!("truth {name}"), truth),
            });
            MapsOfCycle { cycle, truth, methods: methods.collect(), time }
        };
        self.history.snapshots.iter().rev().map(of_cycle).collect()
    }

    /// Errors, or analyses without a truth, and spreads of every other variable in the last cycle, with the variable's name.
    pub fn other_variables(&self) -> Vec<(String, Vec<Drawing>)> {
        let Some((&cycle, snapshot)) = self.history.snapshots.last_key_value() else { return Vec::new() };
        let others = self.info.layout.variables.iter().enumerate().filter(|(number, _)| *number != self.history.mapped);
        let drawings = |number: usize| {
            let pair = |it: Subject<'_>| {
                let first = self.error(&it, number).unwrap_or_else(|| self.analysis(&it, number));
                std::iter::once(first).chain(self.spread(&it, number))
            };
            self.subjects(cycle, snapshot).flat_map(pair).collect()
        };
        others.map(|(number, variable)| (variable.name.to_string(), drawings(number))).collect()
    }

    /// Blocks and common factors in the last cycle.
    pub fn structures(&self) -> Vec<StructureMaps> {
        let Some((&cycle, snapshot)) = self.history.snapshots.last_key_value() else { return Vec::new() };
        let of_method = |it: Subject<'_>| {
            let structure = it.fields.structure.as_ref()?;
            let factors = structure.factors.iter().zip(1..).map(|(factor, number)| self.factor(&it, factor, number));
            let (method, factors) = (it.method.to_string(), factors.collect());
            Some(StructureMaps { method, parts: self.parts(&it, structure), factors })
        };
        self.subjects(cycle, snapshot).filter_map(of_method).collect()
    }

    /// The correlations with the error in the middle of the domain in the last cycle, for each variable with its name.
    pub fn correlations(&self) -> Vec<(String, Vec<Drawing>)> {
        let Some((&cycle, snapshot)) = self.history.snapshots.last_key_value() else { return Vec::new() };
        let of_variable = |variable: usize| {
            let drawn = |it: Subject<'_>| Some(self.correlation(&it, it.fields.correlations.as_ref()?, variable));
            (self.variable(variable).0.to_string(), self.subjects(cycle, snapshot).filter_map(drawn).collect())
        };
        (0..self.info.layout.variables.len()).map(of_variable).collect()
    }

    fn correlation(&self, it: &Subject<'_>, correlations: &ShownCorrelations, variable: usize) -> Drawing {
        let (grid, ShownCorrelations { of, fields, calibration }) = (&self.info.layout.grid, correlations);
        let (of_variable, cell) = (of / grid.cells(), of % grid.cells());
        let location = self.info.layout.variables[of_variable].location;
        let mark =
            Mark { x_m: grid.x_m(location, cell % grid.nx), y_m: grid.y_m(location, cell / grid.nx), color: None };
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
            map: FieldMap { unit: "1".into(), contours: contours.collect(), marks: vec![mark], ..map },
        }
    }

    fn subjects<'b>(&'b self, cycle: usize, snapshot: &'b Snapshot) -> impl Iterator<Item = Subject<'b>> + 'b {
        self.info.methods.iter().zip(&snapshot.methods).enumerate().filter_map(move |(number, (method, fields))| {
            // With its number, so that no two are the same.
            let stem = format!("map_{cycle:04}_{:02}_{}", number + 1, safe_name(&method.name, "_-"));
            Some(Subject { snapshot, fields: fields.as_ref()?, method: &method.name, stem })
        })
    }

    fn of_method(&self, it: &Subject<'_>) -> MethodMaps {
        let variable = self.history.mapped;
        let (name, unit) = self.variable(variable);
        let (method, limit) = (it.method, self.ranges[variable].difference);
        let mut background = self.state(variable, format!("{method}: background {name}"), &it.fields.background);
        let places =
            it.snapshot.places.iter().zip(&it.fields.departures).filter(|(place, _)| place.variable == variable);
        background.marks = places
            .map(|(place, &departure)| Mark {
                x_m: place.x_m,
                y_m: place.y_m,
                color: Some(difference(departure, limit)),
            })
            .collect();
        let caption = format!(
            "Background of {method}. Dots: {}, in the colour of their departure from it, dark blue for −{limit} {unit} or \
             less to dark red for +{limit} {unit} or more.",
            self.observations(it, variable)
        );
        let background = Drawing { stem: format!("{}_background", it.stem), caption, map: background };
        let analysis = self.analysis(it, variable);
        let (error, spread) = (self.error(it, variable), self.spread(it, variable));
        MethodMaps { states: vec![background, analysis], error, spread }
    }

    fn analysis(&self, it: &Subject<'_>, variable: usize) -> Drawing {
        let (name, _) = self.variable(variable);
        Drawing {
            stem: format!("{}_analysis{}", it.stem, self.suffix(variable)),
            caption: format!("Analysis of {}.", it.method),
            map: self.state(variable, format!("{}: analysis {name}", it.method), &it.fields.analysis),
        }
    }

    fn error(&self, it: &Subject<'_>, variable: usize) -> Option<Drawing> {
        let truth = it.snapshot.truth.as_ref()?;
        let ((name, _), limit) = (self.variable(variable), self.ranges[variable].difference);
        let pairs = it.fields.analysis[variable].iter().zip(&truth[variable]);
        let error = pairs.map(|(value, truth)| value - truth).collect();
        let title = format!("{}: analysis error {name}", it.method);
        let mut map = self.map(variable, title, error, Scale::Difference, [-limit, limit]);
        map.marks = self.marks(it, variable);
        let caption = format!("Analysis minus truth of {}. Dots: {}.", it.method, self.observations(it, variable));
        Some(Drawing { stem: format!("{}_error{}", it.stem, self.suffix(variable)), caption, map })
    }

    fn spread(&self, it: &Subject<'_>, variable: usize) -> Option<Drawing> {
        let (name, _) = self.variable(variable);
        let (field, range) = (it.fields.spread.as_ref()?[variable].clone(), [0.0, self.ranges[variable].spread]);
        let title = format!("{}: claimed spread {name}", it.method);
        Some(Drawing {
            stem: format!("{}_spread{}", it.stem, self.suffix(variable)),
            caption: format!("Standard deviation that {} claims for its analysis.", it.method),
            map: self.map(variable, title, field, Scale::Spread, range),
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
            map: FieldMap { unit: String::new(), contours: Vec::new(), marks, ..map },
        }
    }

    fn factor(&self, it: &Subject<'_>, factor: &ShownFactor, number: usize) -> Drawing {
        let variable = self.history.mapped;
        let (limit, field) = (round_up(Some(factor.largest[variable])), factor.fields[variable].clone());
        let title = format!("{}: common factor {number}, {}", it.method, self.variable(variable).0);
        Drawing {
            stem: format!("{}_factor_{number}", it.stem),
            caption: format!("One standard deviation of common factor {number} of {}: {}.", it.method, factor.summary),
            map: self.map(variable, title, field, Scale::Difference, [-limit, limit]),
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
        match it.snapshot.every.get(variable) {
            Some(every) if *every > 1 => format!("one of {every} observations of {name}"),
            _ => format!("observations of {name}"),
        }
    }

    /// Dots where the variable was observed.
    fn marks(&self, it: &Subject<'_>, variable: usize) -> Vec<Mark> {
        let places = it.snapshot.places.iter().filter(|place| place.variable == variable);
        places.map(|place| Mark { x_m: place.x_m, y_m: place.y_m, color: None }).collect()
    }

    fn state(&self, variable: usize, title: String, fields: &[Vec<f32>]) -> FieldMap {
        self.map(variable, title, fields[variable].clone(), Scale::State, self.ranges[variable].state)
    }

    fn map(&self, variable: usize, title: String, field: Vec<f32>, scale: Scale, range: [f32; 2]) -> FieldMap {
        let grid = self.history.thinning.grid(&self.info.layout.grid);
        FieldMap {
            title,
            unit: self.variable(variable).1.to_string(),
            field,
            size: self.history.thinning.size(),
            extent_m: [grid.width_m(), grid.height_m()],
            scale,
            range,
            contours: contour_levels(range),
            marks: Vec::new(),
        }
    }
}

fn ranges(history: &History, variable: usize, methods: usize) -> Ranges {
    // Without a truth the colours are those of the analyses.
    let analyses = |it: &'_ Snapshot| -> Vec<f32> {
        it.methods.iter().flatten().flat_map(|fields| fields.analysis[variable].iter().copied()).collect()
    };
    let shown = history.snapshots.values().flat_map(|it| match &it.truth {
        Some(truth) => truth[variable].clone(),
        None => analyses(it),
    });
    let shown = shown.filter(|value| value.is_finite());
    let (low, high) = shown.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), it| (low.min(it), high.max(it)));
    // The median over the methods: one that goes astray must not make the maps of all others pale.
    let of_methods = |pick: &dyn Fn(&Snapshot, &Fields) -> Vec<f32>| {
        let quantiles = (0..methods).filter_map(|method| {
            let fields = history.snapshots.values().filter_map(|it| Some(pick(it, it.methods.get(method)?.as_ref()?)));
            quantile(fields.flatten().collect(), 0.98)
        });
        round_up(quantile(quantiles.collect(), 0.5))
    };
    Ranges {
        state: if low <= high { around(low, high) } else { [0.0, 1.0] },
        difference: of_methods(&|snapshot, fields| match &snapshot.truth {
            Some(truth) => {
                let pairs = fields.analysis[variable].iter().zip(&truth[variable]);
                pairs.map(|(value, truth)| (value - truth).abs()).collect()
            }
            None => {
                let departures = snapshot.places.iter().zip(&fields.departures);
                departures.filter(|(place, _)| place.variable == variable).map(|(_, d)| d.abs()).collect()
            }
        }),
        spread: of_methods(&|_, fields| fields.spread.as_ref().map_or_else(Vec::new, |it| it[variable].clone())),
    }
}
