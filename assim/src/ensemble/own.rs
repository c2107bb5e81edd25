//! Ensemble filters whose analysis is made outside of this crate.

use super::EnsembleSettings;
use super::cycle::EnsembleCycle;
use super::filter::{EnsembleAnalysis, EnsembleFilter, with_analysis};
use super::observed::ObservedEnsemble;
use super::transform::{self, Transform, WhitenedObservations, transform};
use crate::error::Error;
use crate::linalg::column;
use crate::problem::Problem;
use faer::{Mat, MatRef};
use isobar_model::Model;

/// An analysis in the space of the ensemble. [`EnsembleFilter::by`] makes it a method, with everything else that ensembles
/// need: the members' draw and forecast, biases by augmentation, inflation, relaxation and checkpoints.
pub trait EnsembleTransform: Clone + Send + 'static {
    /// The weights w and W of the analysis
    ///
    /// ```text
    /// x̄_a = x̄ + X' w/√(N−1),    X'_a = X' W
    /// ```
    ///
    /// from the members' perturbations Ỹ = R^-½ Y'/√(N−1), `[n, N]`, which are inflated, and the departures of their mean
    /// d̃ = R^-½ (y − ȳ), `[n, 1]`.
    ///
    /// # Errors
    /// Why there is no such analysis.
    fn weights(&self, perturbations: MatRef<'_, f64>, departures: MatRef<'_, f64>) -> Result<EnsembleWeights, Error>;
}

/// How the analysed members are made from those of the background.
#[derive(Clone, Debug)]
pub struct EnsembleWeights {
    /// w, `[N, 1]`.
    pub mean: Mat<f64>,
    /// W, `[N, N]`.
    pub perturbations: Mat<f64>,
}

/// The analysis of an [`EnsembleTransform`].
#[derive(Clone)]
pub struct By<T>(T);

impl<T: EnsembleTransform> EnsembleFilter<By<T>> {
    /// A filter with members about the background and this analysis.
    ///
    /// # Errors
    /// As [`Ensemble::draw`](super::Ensemble::draw).
    pub fn by(transform: T, problem: impl Into<Problem<dyn Model>>, settings: EnsembleSettings) -> Result<Self, Error> {
        with_analysis(problem.into(), settings, 1, By(transform))
    }
}

impl<T: EnsembleTransform> EnsembleAnalysis for By<T> {
    /// As much again for what is made outside.
    fn numbers(&self, _: &Problem<dyn Model>, members: f64, observations: f64, _: usize) -> f64 {
        2.0 * transform::numbers(members, observations)
    }

    fn update(&mut self, cycle: &mut EnsembleCycle, members: &ObservedEnsemble) -> Result<Option<f64>, Error> {
        let whitened = WhitenedObservations::new(members);
        let inflation = cycle.inflation(&whitened);
        // χ² is a property of the background, whatever the analysis.
        let chi2 = transform(&whitened, inflation).chi2;
        let perturbations = &whitened.perturbations * faer::Scale(inflation.sqrt());
        let departures = column(&whitened.departures);
        let EnsembleWeights { mean, perturbations: root } =
            self.0.weights(perturbations.as_ref(), departures.as_ref())?;
        let members = perturbations.ncols();
        if [mean.shape(), root.shape()] != [(members, 1), (members, members)] {
            let shapes = format!("{:?} and {:?}", mean.shape(), root.shape());
            let message = format!("weights of {members} members must be [{members}, 1] and [{members}, {members}]");
            return Err(Error::Setting(format!("{message}, not {shapes}")));
        }
        let scale = (inflation * (members - 1) as f64).sqrt();
        let mean = mean.col_as_slice(0).iter().map(|weight| weight / scale).collect();
        Ok(Some(cycle.transform(Transform { mean, root, inflation, chi2 })))
    }
}
