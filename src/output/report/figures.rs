//! The curves of the report.

use super::section::Drawing;
use crate::calendar::utc;
use crate::event::{MethodInfo, RunInfo};
use crate::output::history::{Cycle, History, MethodCycle, ParameterHistory};
use crate::output::netcdf::coordinates::safe_name;
use crate::output::reliability::{Reliability, normal_density};
use crate::plot::colors::of_method_on_paper;
use crate::plot::range::quantile;
use crate::plot::{Curve, CurvePlot, Dash, unit};
use crate::scores::{Better, Line, MethodScores, Part, Score, ScoreKind, Summary};
use isobar_obs::ObservationType;
use std::collections::BTreeSet;

/// The most bias parameters that have a figure.
const MOST_PARAMETERS: usize = 48;

/// Draws the curves of a run.
pub struct Figures<'a> {
    /// The run.
    pub info: &'a RunInfo,
    /// What happened in it.
    pub history: &'a History,
}

impl Figures<'_> {
    /// RMSE and spread of each variable.
    pub fn errors(&self) -> Vec<Drawing<CurvePlot>> {
        let per_variable = |variable: &isobar_model::Variable| {
            let name = variable.name;
            let mut curves = Vec::new();
            for (method, info) in self.info.methods.iter().enumerate() {
                for (kind, line) in self.info.drawn(true).filter(|(kind, _)| kind.part != Part::Background) {
                    let points = self.scores(method, &kind.key(name));
                    let curve = Curve::new(&info.name, of_method_on_paper(method), points);
                    curves.push(match line {
                        Line::Solid => curve,
                        Line::Dashed => curve.unnamed(Dash::Dashed),
                        Line::Dotted => curve.unnamed(Dash::Dotted),
                    });
                }
            }
            let is_smoothed = self.info.methods.iter().any(|method| method.smoother_lag_cycles.is_some());
            let smoothed = if is_smoothed { ", error once smoothed (dotted)" } else { "" };
            let has_passive = self.info.networks.iter().any(|network| network.has_passive);
            let passive = if has_passive { ", of passive ones (dotted)" } else { "" };
            let (stem, title, shown) = if self.info.has_truth {
                ("rmse", "RMSE", format!("error (solid), claimed spread (broken){smoothed}"))
            } else {
                let shown = format!("departure of the observations (solid){passive}, claimed spread (broken)");
                ("departure", "departure", shown)
            };
            let caption = format!("Analysis of {}: root-mean-square {shown}.", variable.long_name);
            self.over_time(
                format!("{stem}_{name}"),
                caption,
                format!("{title} and spread of {name}"),
                variable.unit,
                curves,
                None,
            )
        };
        self.info.layout.variables.iter().map(per_variable).collect()
    }

    /// The bias estimates with their bands, and the truth where it is known.
    pub fn biases(&self) -> Vec<Drawing<CurvePlot>> {
        let parameters = self.info.calibration.parameters.iter().enumerate().take(MOST_PARAMETERS);
        let drawing = |(number, parameter): (usize, &isobar_obs::Parameter)| {
            let mut curves = Vec::new();
            for (method, info) in self.info.methods.iter().enumerate() {
                let points = self.series(method, |own| own.bias(number));
                if points.iter().all(|point| point[1] == 0.0) {
                    continue;
                }
                let mut curve = Curve::new(&info.name, of_method_on_paper(method), points);
                let sigmas = self.series(method, |own| own.bias_spread(number));
                if sigmas.len() == curve.points.len() {
                    let band =
                        |(point, sigma): (&[f64; 2], &[f64; 2])| [point[1] - 2.0 * sigma[1], point[1] + 2.0 * sigma[1]];
                    curve.band = Some(curve.points.iter().zip(&sigmas).map(band).collect());
                }
                curves.push(curve);
            }
            let truth = |cycle: &Cycle| Some([self.day(cycle), cycle.true_bias(number)?]);
            let cycles = self.history.cycles.iter().filter(|cycle| cycle.number > self.info.done);
            let points: Vec<[f64; 2]> = cycles.filter_map(truth).collect();
            let and_truth = if points.is_empty() { "" } else { ", and the truth (broken)" };
            if !points.is_empty() {
                curves.push(Curve::reference("truth", points));
            }
            let stem = format!("bias_{:02}_{}", number + 1, safe_name(&parameter.name, "_"));
            let caption = format!("Bias {}: estimates with ±2σ{and_truth}.", parameter.name);
            let mut drawing = self.over_time(stem, caption, parameter.name.clone(), &parameter.unit, curves, None);
            drawing.plot.from_zero = false;
            drawing
        };
        parameters.map(drawing).collect()
    }

    /// What methods estimate beside state and biases, where the data determine it, with bands.
    pub fn parameters(&self) -> Vec<Drawing<CurvePlot>> {
        let drawing = |(number, (name, methods)): (usize, (&String, &Vec<Option<ParameterHistory>>))| {
            let curve = |(method, own): (usize, &Option<ParameterHistory>)| {
                let determined = &own.as_ref().filter(|own| !own.determined.is_empty())?.determined;
                let day = |time: isobar_model::Time| (time - self.info.begin()).days();
                let points = determined.iter().map(|&(time, value, _)| [day(time), value]).collect();
                let band = determined.iter().map(|&(_, value, sigma)| [value - 2.0 * sigma, value + 2.0 * sigma]);
                let curve = Curve::new(&self.info.methods[method].name, of_method_on_paper(method), points);
                Some(curve.with_band(band.collect()))
            };
            let curves: Vec<Curve> = methods.iter().enumerate().filter_map(curve).collect();
            let udunits = methods.iter().flatten().next()?.last.unit.as_str();
            let stem = format!("parameter_{:02}_{}", number + 1, safe_name(name, "_"));
            let caption = format!("{name}: estimates with ±2σ, where the data determine it.");
            let mut drawing = self.over_time(stem, caption, name.clone(), udunits, curves, None);
            drawing.plot.from_zero = false;
            (!drawing.plot.curves.is_empty()).then_some(drawing)
        };
        self.history.parameters.iter().take(MOST_PARAMETERS).enumerate().filter_map(drawing).collect()
    }

    /// For methods with a spread: normalised errors, and errors against spreads.
    pub fn reliability(&self) -> Vec<Drawing<CurvePlot>> {
        let mut drawings = Vec::new();
        for (number, variable) in self.info.layout.variables.iter().enumerate() {
            let with_spread = || {
                let all = (0..self.info.methods.len()).map(|method| (method, self.history.reliability(method, number)));
                all.filter(|(_, reliability)| !reliability.is_empty())
            };
            if with_spread().next().is_none() {
                continue;
            }
            let curves_of = |pick: fn(&Reliability) -> Vec<[f64; 2]>| -> Vec<Curve> {
                let curve = |(method, reliability): (usize, &Reliability)| {
                    Curve::new(&self.info.methods[method].name, of_method_on_paper(method), pick(reliability))
                };
                with_spread().map(curve).collect()
            };
            let mut curves = curves_of(Reliability::density);
            curves.push(Curve::reference("N(0, 1)", normal_density()));
            drawings.push(Drawing {
                stem: format!("normalised_error_{}", variable.name),
                caption: format!(
                    "Analysis errors of {} divided by the claimed spread: the normal distribution if the spread is right, \
                     wider if it is too small.",
                    variable.long_name
                ),
                plot: CurvePlot::new(
                    format!("normalised error of {}", variable.name),
                    "(analysis − truth) / spread [1]".into(),
                    "density [1]".into(),
                    curves,
                ),
            });
            let mut curves = curves_of(Reliability::curve);
            let ends = curves.iter().flat_map(|curve| &curve.points).map(|point| point[0]);
            let (low, high) = ends.fold((f64::INFINITY, 0.0_f64), |(low, high), x| (low.min(x), high.max(x)));
            curves.push(Curve::reference("right", vec![[low, low], [high, high]]));
            let points = curves_of(Reliability::curve).into_iter().map(|curve| curve.unnamed(Dash::Points));
            curves.extend(points);
            drawings.push(Drawing {
                stem: format!("spread_error_{}", variable.name),
                caption: format!(
                    "Root-mean-square analysis error of {} at grid points with about the same claimed spread: on the \
                     broken line if the spread is right.",
                    variable.long_name
                ),
                plot: CurvePlot::new(
                    format!("error against spread of {}", variable.name),
                    format!("claimed spread [{}]", unit(variable.unit)),
                    format!("RMSE [{}]", unit(variable.unit)),
                    curves,
                ),
            });
        }
        drawings
    }

    /// The histograms of the truth's place in the claimed distributions.
    pub fn histograms(&self, summary: &Summary) -> Vec<Drawing<CurvePlot>> {
        let drawing = |variable: &isobar_model::Variable| {
            let curve = |(method, (name, scores)): (usize, (&String, &MethodScores))| {
                let own = scores.diagnostics.as_ref()?.state.get(variable.name)?.probability_histogram.as_ref()?;
                let bins = own.len() as f64;
                let point = |(bin, share): (usize, &f64)| [(bin as f64 + 0.5) / bins, share * bins];
                let points = own.iter().enumerate().map(point).collect();
                Some(Curve::new(name, of_method_on_paper(method), points))
            };
            let curves: Vec<Curve> = summary.methods.iter().enumerate().filter_map(curve).collect();
            let mut plot = CurvePlot::new(
                format!("place of the true {} in the claim", variable.name),
                "Φ((truth − analysis) / spread) [1]".into(),
                "density [1]".into(),
                curves,
            );
            plot.reference = Some(1.0);
            let stem = format!("probability_{}", variable.name);
            let caption = format!(
                "Rank histogram of {}: the probability that the claimed normal distribution gives to values below the \
                 truth. Flat if the claim is right, a U if the spread is too small, a hill if it is too large.",
                variable.long_name
            );
            (!plot.curves.is_empty()).then_some(Drawing { stem, caption, plot })
        };
        self.info.layout.variables.iter().filter_map(drawing).collect()
    }

    /// The scores of methods as a whole over time, and mean departures of each network and variable.
    pub fn innovations(&self) -> Vec<Drawing<CurvePlot>> {
        let mut drawings: Vec<Drawing<CurvePlot>> =
            self.info.drawn(false).filter_map(|(kind, _)| self.single(kind)).collect();
        let methods = || self.history.cycles.iter().flat_map(|cycle| cycle.methods.iter().flatten());
        let kinds: BTreeSet<ObservationType> = methods().flat_map(|own| own.departures.keys().cloned()).collect();
        for kind in kinds {
            let Some(variable) = self.info.layout.variables.get(kind.variable) else { continue };
            let mut curves = Vec::new();
            for (method, info) in self.info.methods.iter().enumerate() {
                let points = self.series(method, |own| own.departures.get(&kind).map(|means| means[0]));
                curves.push(Curve::new(&info.name, of_method_on_paper(method), points));
            }
            let (network, name) = (&kind.network, variable.name);
            let caption = format!(
                "Mean departure of the observations from the background, with the method's bias estimate taken off: \
                 {name} of {network}. Around zero if nothing is left to be explained."
            );
            let stem = format!("departure_{}_{name}", safe_name(network, "_"));
            let title = format!("mean departure, {name} of {network}");
            let mut drawing = self.over_time(stem, caption, title, variable.unit, curves, Some(0.0));
            drawing.plot.from_zero = false;
            drawings.push(drawing);
        }
        drawings
    }

    /// A score of methods as a whole; `None` if no method has it.
    fn single(&self, kind: &'static ScoreKind) -> Option<Drawing<CurvePlot>> {
        let curve = |(method, info): (usize, &MethodInfo)| {
            let points = self.scores(method, kind.name);
            (!points.is_empty()).then(|| Curve::new(&info.name, of_method_on_paper(method), points))
        };
        let curves: Vec<Curve> = self.info.methods.iter().enumerate().filter_map(curve).collect();
        let score = Score { kind, variable: ("", "") };
        let reference = (kind.better == Better::One).then_some(1.0);
        (!curves.is_empty()).then(|| {
            let (stem, caption) = (kind.name.to_string(), kind.about.to_string());
            let mut drawing = self.over_time(stem, caption, score.subject(), "1", curves, reference);
            drawing.plot.y_label = score.subject();
            drawing
        })
    }

    fn over_time(
        &self,
        stem: String,
        caption: String,
        title: String,
        udunits: &str,
        curves: Vec<Curve>,
        reference: Option<f64>,
    ) -> Drawing<CurvePlot> {
        let label = format!("days since {}", utc(self.info.begin()));
        let mut plot = CurvePlot::new(title, label, format!("[{}]", unit(udunits)), curves);
        plot.reference = reference;
        let day = |cycle: f64| cycle * self.info.window.days();
        let (first, last) = (self.info.scored_from() - self.info.done, self.info.count());
        plot.counts = (first > 1).then(|| [day(first as f64 - 0.5), day(last as f64)]);
        plot.highest = highest(&plot.curves);
        Drawing { stem, caption, plot }
    }

    /// A method's figure in every cycle that has one.
    fn series(&self, method: usize, pick: impl Fn(&MethodCycle) -> Option<f64>) -> Vec<[f64; 2]> {
        let at = |(cycle, own): (&Cycle, &MethodCycle)| Some([self.day(cycle), pick(own)?]);
        self.history.of_method(method).filter_map(at).collect()
    }

    /// A method's score in every cycle that has it.
    fn scores(&self, method: usize, key: &str) -> Vec<[f64; 2]> {
        self.history.scores(method, key, 0).map(|(cycle, value)| [self.day(cycle), value]).collect()
    }

    fn day(&self, cycle: &Cycle) -> f64 {
        (cycle.time - self.info.begin()).days()
    }
}

/// A limit for y that a single method gone astray cannot push up at will: four times what nine of ten points need.
fn highest(curves: &[Curve]) -> Option<f64> {
    let values = curves.iter().flat_map(|curve| &curve.points).map(|point| point[1] as f32).collect();
    let usual = quantile(values, 0.9)?;
    (usual > 0.0).then(|| 4.0 * f64::from(usual))
}
