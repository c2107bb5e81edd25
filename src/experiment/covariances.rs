//! `[background_error]` and `[model_error]` as covariance operators.

use super::ExperimentError;
use crate::scenario::{CovarianceComponent, Dynamics, ModelSettings};
use faer::Mat;
use isobar_assim::Covariance;
use isobar_assim::covariance::{Balanced, BalancedParameters, LocalizedEnsemble, Sum, Univariate, White};
use isobar_model::Layout;
use std::sync::Arc;

/// The sum of the components; `None` if there are none.
pub(super) fn build(
    components: &[CovarianceComponent],
    model: &ModelSettings,
    layout: &Layout,
) -> Result<Option<Arc<dyn Covariance>>, ExperimentError> {
    let terms = components.iter().map(|component| term(component, model, layout)).collect::<Result<Vec<_>, _>>()?;
    Ok((!terms.is_empty()).then(|| Arc::new(Sum::new(layout.len(), terms)) as Arc<dyn Covariance>))
}

/// Zero covariance.
pub(super) fn none(layout: &Layout) -> Arc<dyn Covariance> {
    Arc::new(Sum::new(layout.len(), Vec::new()))
}

fn term(
    component: &CovarianceComponent,
    model: &ModelSettings,
    layout: &Layout,
) -> Result<Box<dyn Covariance>, ExperimentError> {
    let number = |name: &str| layout.variable(name).expect("the scenario's reader knows the model's variables");
    Ok(match component {
        &CovarianceComponent::Balanced { sigma_height_m, length_m } => {
            let (Dynamics::ShallowWater(settings) | Dynamics::LinearShallowWater { settings, .. }) = &model.dynamics
            else {
                unreachable!("the scenario's reader refuses balance without rotation")
            };
            let parameters = BalancedParameters {
                sigma_height_m,
                length_m,
                gravity_m_per_s2: settings.gravity_m_per_s2,
                coriolis_per_s: settings.coriolis_per_s,
                beta_per_m_per_s: settings.beta_per_m_per_s,
            };
            Box::new(Balanced::new(layout, &parameters).map_err(ExperimentError::Covariance)?)
        }
        CovarianceComponent::Univariate { variable, sigma, length_m } => {
            Box::new(Univariate::new(layout, number(variable), *sigma, *length_m))
        }
        CovarianceComponent::ByDistance { variable, correlation, sigma, length_m, uncorrelated_fraction } => {
            let function = (*correlation, *length_m);
            let covariance =
                Univariate::by_distance(layout, number(variable), *sigma, function, *uncorrelated_fraction);
            Box::new(covariance.map_err(ExperimentError::Covariance)?)
        }
        CovarianceComponent::Members { variable, members, localization_radius_m } => {
            let (cells, count) = (layout.grid.cells(), members.len());
            let own = number(variable) * cells..(number(variable) + 1) * cells;
            let mut perturbations = Mat::zeros(layout.len(), count);
            for (cell, index) in own.enumerate() {
                let mean = members.iter().map(|member| member[cell]).sum::<f64>() / count as f64;
                (0..count).for_each(|k| perturbations[(index, k)] = members[k][cell] - mean);
            }
            let radius_m = localization_radius_m.unwrap_or(f64::INFINITY);
            Box::new(LocalizedEnsemble::new(layout, &perturbations, radius_m))
        }
        CovarianceComponent::White { variable, sigma } => Box::new(White::new(layout, number(variable), *sigma)),
    })
}
