//! Biases by scan position on the page.

use super::section::Drawing;
use crate::event::RunInfo;
use crate::output::history::History;
use crate::output::netcdf::coordinates::safe_name;
use crate::output::scans::ScanBiases;
use crate::plot::colors::of_method_on_paper;
use crate::plot::{Curve, CurvePlot, unit};

/// The last estimates for every scanning instrument: of each method with ±2σ, and the truth where it is known.
pub fn drawings(info: &RunInfo, history: &History) -> Vec<Drawing<CurvePlot>> {
    let mut drawings = Vec::new();
    for (kind, biases) in &history.scans {
        let Some(variable) = info.layout.variables.get(kind.variable) else { continue };
        let names: Vec<&str> = info.methods.iter().map(|method| method.name.as_str()).collect();
        let mut curves = estimates(biases, &names);
        if curves.is_empty() {
            continue;
        }
        let knows_truth = info.has_truth && !info.is_recorded(&kind.network);
        if knows_truth {
            let points = biases.positions.iter().zip(&biases.truth).map(|(&s, &bias)| [s, bias]).collect();
            curves.push(Curve::reference("truth", points));
        }
        let (network, name, cycle) = (&kind.network, variable.name, biases.cycle);
        let and_truth = if knows_truth { ", and the truth (broken)" } else { "" };
        let mut plot = CurvePlot::new(
            format!("bias of {name} of {network} by scan position"),
            "scan position, from left to right of the track [1]".into(),
            format!("[{}]", unit(variable.unit)),
            curves,
        );
        plot.from_zero = false;
        drawings.push(Drawing {
            stem: format!("scan_{}_{name}", safe_name(network, "_")),
            caption: format!(
                "Bias of {} of {network} by scan position, all its terms together, after the analysis of cycle {cycle}: \
                 estimates with ±2σ{and_truth}.",
                variable.long_name
            ),
            plot,
        });
    }
    drawings
}

/// The biases that each method has found, with bands of ±2σ.
fn estimates(biases: &ScanBiases, names: &[&str]) -> Vec<Curve> {
    let curve = |(method, found): (usize, &Option<Vec<[f64; 2]>>)| {
        let (points, band) = biases
            .positions
            .iter()
            .zip(found.as_ref()?)
            .map(|(&s, &[bias, sigma])| ([s, bias], [bias - 2.0 * sigma, bias + 2.0 * sigma]))
            .unzip();
        Some(Curve::new(names[method], of_method_on_paper(method), points).with_band(band))
    };
    biases.methods.iter().enumerate().filter_map(curve).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_are_two_claimed_sigmas_on_either_side() {
        let biases = ScanBiases {
            cycle: 3,
            positions: vec![-1.0, 1.0],
            truth: vec![5.0, 6.0],
            methods: vec![None, Some(vec![[4.0, 0.5], [7.0, 0.25]])],
            footprints: Vec::new(),
        };
        let curves = estimates(&biases, &["blind", "kf"]);
        let expected = Curve::new("kf", of_method_on_paper(1), vec![[-1.0, 4.0], [1.0, 7.0]]);
        assert_eq!(curves, [expected.with_band(vec![[3.0, 5.0], [6.5, 7.5]])]);
    }
}
