//! The maps of the report.

use super::history::{Fields, History, Snapshot};
use crate::event::RunInfo;
use crate::plot::colors::{Scale, difference};
use crate::plot::map::contour_levels;
use crate::plot::range::{around, quantile, round_up};
use crate::plot::{FieldMap, Mark};
use crate::sink::netcdf::coordinates::safe_name;
use crate::sink::scores::utc;

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
    /// The truth.
    pub truth: Drawing,
    /// For each method its name and maps.
    pub methods: Vec<(String, MethodMaps)>,
}

/// The maps of a method.
pub struct MethodMaps {
    /// Background and analysis.
    pub states: Vec<Drawing>,
    /// Error of the analysis.
    pub error: Drawing,
    /// Claimed spread of the analysis, if there is one.
    pub spread: Option<Drawing>,
}

/// The ranges that all maps of the run share.
struct Ranges {
    state: [f32; 2],
    difference: f32,
    spread: f32,
}

/// Draws the maps of a run.
pub struct Maps<'a> {
    info: &'a RunInfo,
    history: &'a History,
    ranges: Ranges,
}

impl<'a> Maps<'a> {
    /// The maps of a complete run.
    pub fn new(info: &'a RunInfo, history: &'a History) -> Self {
        Self { info, history, ranges: ranges(history, info.methods.len()) }
    }

    /// All maps, the latest first.
    pub fn all(&self) -> Vec<MapsOfCycle> {
        self.history.snapshots.iter().rev().map(|(&cycle, snapshot)| self.of_cycle(cycle, snapshot)).collect()
    }

    fn of_cycle(&self, cycle: usize, snapshot: &Snapshot) -> MapsOfCycle {
        let time = utc(snapshot.time);
        let (name, unit) = self.variable();
        let stem = |what: &str| format!("map_{cycle:04}_{what}");
        let truth =
            self.state(stem("truth"), format!("Truth of {name} at {time}."), format!("truth {name}"), &snapshot.truth);
        let methods =
            self.info.methods.iter().zip(&snapshot.methods).enumerate().filter_map(|(number, (method, fields))| {
                let fields = fields.as_ref()?;
                // With its number, so that no two are the same.
                let own = format!("{:02}_{}", number + 1, safe_name(&method.name, "_-"));
                let stem = |what: &str| stem(&format!("{own}_{what}"));
                Some((method.name.clone(), self.of_method(&method.name, (name, unit), snapshot, fields, &stem)))
            });
        MapsOfCycle { cycle, truth, methods: methods.collect(), time }
    }

    fn of_method(
        &self,
        method: &str,
        (name, unit): (&str, &str),
        snapshot: &Snapshot,
        fields: &Fields,
        stem: &dyn Fn(&str) -> String,
    ) -> MethodMaps {
        let limit = self.ranges.difference;
        let observations = match snapshot.every {
            1 => format!("observations of {name}"),
            every => format!("one of {every} observations of {name}"),
        };
        let mut background = self.state(
            stem("background"),
            format!("Background of {method}. Dots: {observations}, in the colour of their departure from it, dark blue for −{limit} {unit} or less to dark red for +{limit} {unit} or more."),
            format!("{method}: background {name}"),
            &fields.background,
        );
        let places = snapshot.places.iter().zip(&fields.departures);
        background.map.marks = places
            .map(|(&(_, x_m, y_m), &departure)| Mark { x_m, y_m, color: Some(difference(departure, limit)) })
            .collect();
        let states = vec![
            background,
            self.state(
                stem("analysis"),
                format!("Analysis of {method}."),
                format!("{method}: analysis {name}"),
                &fields.analysis,
            ),
        ];
        let error = fields.analysis.iter().zip(&snapshot.truth).map(|(value, truth)| value - truth).collect();
        let mut error = self.drawing(
            stem("error"),
            format!("Analysis minus truth of {method}. Dots: {observations}."),
            format!("{method}: analysis error {name}"),
            error,
            Scale::Difference,
            [-limit, limit],
        );
        error.map.marks = snapshot.places.iter().map(|&(_, x_m, y_m)| Mark { x_m, y_m, color: None }).collect();
        let spread = fields.spread.as_ref().map(|spread| {
            self.drawing(
                stem("spread"),
                format!("Standard deviation that {method} claims for its analysis."),
                format!("{method}: claimed spread {name}"),
                spread.clone(),
                Scale::Spread,
                [0.0, self.ranges.spread],
            )
        });
        MethodMaps { states, error, spread }
    }

    fn variable(&self) -> (&'a str, &'a str) {
        self.info.layout.variables.get(self.history.mapped).map_or(("", ""), |variable| (variable.name, variable.unit))
    }

    fn state(&self, stem: String, caption: String, title: String, field: &[f32]) -> Drawing {
        self.drawing(stem, caption, title, field.to_vec(), Scale::State, self.ranges.state)
    }

    fn drawing(
        &self,
        stem: String,
        caption: String,
        title: String,
        field: Vec<f32>,
        scale: Scale,
        range: [f32; 2],
    ) -> Drawing {
        let (_, unit) = self.variable();
        let grid = self.history.thinning.grid(&self.info.layout.grid);
        let map = FieldMap {
            title,
            unit: unit.to_string(),
            field,
            size: self.history.thinning.size(),
            extent_m: [grid.width_m(), grid.height_m()],
            scale,
            range,
            contours: contour_levels(range),
            marks: Vec::new(),
        };
        Drawing { stem, caption, map }
    }
}

fn ranges(history: &History, methods: usize) -> Ranges {
    let truths = history.snapshots.values().flat_map(|snapshot| &snapshot.truth).filter(|value| value.is_finite());
    let (low, high) = truths.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &it| (low.min(it), high.max(it)));
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
        difference: of_methods(&|snapshot, fields| {
            fields.analysis.iter().zip(&snapshot.truth).map(|(value, truth)| (value - truth).abs()).collect()
        }),
        spread: of_methods(&|_, fields| fields.spread.clone().unwrap_or_default()),
    }
}
