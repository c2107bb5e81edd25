//! A method that estimates from its innovations how large the errors of observations and of its forecasts are.

use super::likelihood::ErrorFactors;
use crate::assimilator::{Adjustments, Assimilator, Views};
use crate::covariance::{Covariance, multiply};
use crate::error::Error;
use crate::estimate::{Analysis, Background};
use crate::estimated::{EstimatedParameter, EstimatesParameters};
use crate::memory::{read, write};
use crate::response::Responder;
use isobar_model::random::stream;
use isobar_model::vector::{dot, scale};
use isobar_model::{Duration, Layout};
use isobar_obs::{ObservationType, ObservationTypes, ObservationWindow, SparseRows};
use rand::RngExt;
use std::io::{Read, Write};
use std::sync::Arc;

/// Random signs by which traces are estimated in each cycle.
const PROBES: usize = 2;

/// A covariance of the state that a method is given, and multiplies by a factor.
#[derive(Clone)]
pub struct AdaptedCovariance {
    /// What it is: `model_error`, `background_error`.
    pub name: &'static str,
    /// The problem's.
    pub covariance: Arc<dyn Covariance>,
    /// What the method multiplies it by as it is.
    pub scale: f64,
}

/// Which factors are estimated.
#[derive(Clone)]
pub struct AdaptiveSettings {
    /// Whether the variance of the observations' errors has a factor for each type: each variable of each network.
    pub observation_error: bool,
    /// The covariance that has a factor: Q of a filter, B of a method with a static one.
    pub state_error: Option<AdaptedCovariance>,
    /// M: how many cycles are remembered.
    pub memory_cycles: usize,
}

/// Finds factors on R and on Q (or B) of any method by the likelihood of its innovations (Dee 1995, Mon. Wea. Rev. 123,
/// 1128–1145; Mitchell and Houtekamer 2000, Mon. Wea. Rev. 128, 416–433), cycle after cycle. With S = H P_f Hᵀ + R,
/// D_k the part of S that is proportional to the factor α_k, θ_k = ln α_k and w = S⁻¹ d,
///
/// ```text
/// −2 ln p(d) = ln det S + dᵀ S⁻¹ d,    ∂ ln p/∂θ_k = ½ (wᵀ D_k w − tr S⁻¹ D_k) = g_k,    I_kl = ½ tr S⁻¹ D_k S⁻¹ D_l
/// ```
///
/// where D_k is α_k R of one type of observations, or α H Q Hᵀ; what P_f keeps of earlier errors counts as given (Dee 1995,
/// section 3). The factors move by a Newton step for the likelihood of all cycles, older ones fading with the memory M
/// (Titterington 1984, J. R. Stat. Soc. B 46, 257–267), with the prior θ ~ N(0, 1), that is J_0 = I:
///
/// ```text
/// J ← (1 − 1/M) J + I,    θ ← θ + (J + J_0)⁻¹ (g − J_0 θ/M),    Cov(θ) = (J + J_0)⁻¹.
/// ```
///
/// For R alone the fixed point `wᵀ D_k w = tr S⁻¹ D_k` is that of Desroziers and Ivanov (2001, Q. J. R. Meteorol. Soc. 127,
/// 1433–1452; for the equality Chapnik et al. 2004, Q. J. 130, 2253–2275). The sum over observations of their departures
/// from analysis and background (Desroziers et al. 2005) is no condition of its own for Q: with one factor on all of R it
/// says the same as χ² = n.
///
/// *Without a look into the method.* R w are the departures from the analysis, so that no S is needed; S⁻¹ v = R⁻¹ (v −
/// H K v) by the method's own analysis of innovations v ([`Responder`]); the information in its average form
/// `½ wᵀ D_k S⁻¹ D_l w` (Gilmour, Thompson and Cullis 1995, Biometrics 51, 1440–1450), times n/χ² so that wrong factors do not
/// claim the wrong weight; traces by random signs (Hutchinson 1990). That takes 2 analyses of the method more than there are
/// factors, in each cycle.
///
/// The claimed σ is that of a true factor that changes within the memory; where it does not, the estimate is better by up to
/// √2. That Q acts through earlier cycles as well makes it better still. A factor that the innovations do not tell from its
/// prior, or from another factor, is named.
#[derive(Clone)]
pub struct Adaptive {
    method: Box<dyn Assimilator>,
    settings: AdaptiveSettings,
    layout: Arc<Layout>,
    factors: ErrorFactors,
}

impl Adaptive {
    /// A method of states with this layout, all of whose factors are 1 at the start.
    ///
    /// # Errors
    /// [`Error::Setting`] if nothing is to be adapted, for a memory of no cycle, and for a method that has no such covariance.
    pub fn new(
        mut method: Box<dyn Assimilator>,
        layout: Arc<Layout>,
        settings: AdaptiveSettings,
    ) -> Result<Self, Error> {
        if settings.memory_cycles == 0 || !(settings.observation_error || settings.state_error.is_some()) {
            return Err(Error::Setting("there is nothing to adapt, or no memory to adapt it from".into()));
        }
        let mut factors = ErrorFactors::default();
        if let Some(adapted) = &settings.state_error {
            if method.adjust().error_factor.is_none() {
                return Err(Error::Setting("the method has no error covariance that could be adapted".into()));
            }
            factors.number(adapted.name);
        }
        Ok(Self { method, settings, layout, factors })
    }

    /// The number of the factor on each type, if there are such.
    fn numbers(&mut self, types: &[ObservationType]) -> Vec<usize> {
        let name = |it: &ObservationType| format!("observation_error/{}", it.name(&self.layout));
        types.iter().map(|it| self.factors.number(&name(it))).collect()
    }

    /// Takes the innovations of a cycle into the factors. `before` is the method before it analysed `observed`, whose errors
    /// are those that were assumed. `departures` are those from background and analysis; `numbers[row]` is the factor of an
    /// observation, if it has one.
    fn adapt(
        &mut self,
        before: &dyn Assimilator,
        background: &Background,
        observed: &ObservationWindow,
        departures: [&[f64]; 2],
        numbers: Option<&[usize]>,
    ) -> Result<(), Error> {
        let Self { settings, factors, .. } = self;
        let n = observed.len();
        let variance: Vec<f64> = observed.sigma.iter().map(|sigma| sigma * sigma).collect();
        let state_error = settings.state_error.as_ref().map(|adapted| StateError {
            covariance: &*adapted.covariance,
            factor: adapted.scale * factors.value(0),
            rows: observed.operator.linearize(&background.estimate.state, &background.estimate.calibration).state,
        });
        let mut present: Vec<usize> = numbers.map(<[usize]>::to_vec).unwrap_or_default();
        present.extend(state_error.is_some().then_some(0));
        present.sort_unstable();
        present.dedup();
        // D_k v.
        let part = |k: usize, v: &[f64]| match (&state_error, numbers) {
            (Some(state_error), _) if k == 0 => state_error.multiply(v),
            (_, Some(numbers)) => (0..n).map(|i| if numbers[i] == k { variance[i] * v[i] } else { 0.0 }).collect(),
            _ => vec![0.0; n],
        };
        let responder = Responder::new(before, background, observed);
        let inverse = |v: &[f64]| -> Result<Vec<f64>, Error> {
            let fit = responder.to(v)?.fit;
            Ok((0..n).map(|i| (v[i] - fit[i]) / variance[i]).collect())
        };

        let w: Vec<f64> =
            departures[1].iter().zip(&variance).map(|(departure, variance)| departure / variance).collect();
        let parts: Vec<Vec<f64>> = present.iter().map(|&k| part(k, &w)).collect();
        let mut score: Vec<f64> = parts.iter().map(|part| 0.5 * dot(&w, part)).collect();
        let weight = n as f64 / dot(&w, departures[0]).max(f64::MIN_POSITIVE);
        let mut information = vec![vec![0.0; present.len()]; present.len()];
        for (column, part) in parts.iter().enumerate() {
            let solved = inverse(part)?;
            for (row, other) in parts.iter().enumerate() {
                // Half into either triangle: a gain that is found by iteration is symmetric only nearly.
                let value = 0.25 * weight * dot(other, &solved);
                information[row][column] += value;
                information[column][row] += value;
            }
        }
        let mut random = stream(observed.cycle as u64, "adaptive error factors");
        for _ in 0..PROBES {
            let signs: Vec<f64> = (0..n).map(|_| if random.random::<bool>() { 1.0 } else { -1.0 }).collect();
            let scaled: Vec<f64> = signs.iter().zip(&observed.sigma).map(|(sign, sigma)| sign * sigma).collect();
            let unscaled: Vec<f64> = signs.iter().zip(&observed.sigma).map(|(sign, sigma)| sign / sigma).collect();
            let solved = inverse(&scaled)?;
            for (score, &k) in score.iter_mut().zip(&present) {
                *score -= 0.5 * dot(&unscaled, &part(k, &solved)) / PROBES as f64;
            }
        }
        factors.update(settings.memory_cycles, &present, &score, &information);
        self.apply_state_factor();
        Ok(())
    }

    /// Gives the method its present factor.
    fn apply_state_factor(&mut self) {
        if let (Some(_), Some(factor)) = (&self.settings.state_error, self.method.adjust().error_factor) {
            *factor = self.factors.value(0);
        }
    }
}

/// α H Q Hᵀ.
struct StateError<'a> {
    covariance: &'a dyn Covariance,
    factor: f64,
    rows: SparseRows,
}

impl StateError<'_> {
    fn multiply(&self, v: &[f64]) -> Vec<f64> {
        let mut at_state = vec![0.0; self.covariance.len()];
        self.rows.transpose_multiply_add(v, &mut at_state);
        let mut result = vec![0.0; v.len()];
        self.rows.multiply_add(&multiply(self.covariance, &at_state), &mut result);
        scale(&mut result, self.factor);
        result
    }
}

impl Assimilator for Adaptive {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        self.method.forecast(window)
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let mut given = observed.clone();
        let ObservationTypes { types, of_observation } = observed.types();
        let numbers: Option<Vec<usize>> = self.settings.observation_error.then(|| {
            let numbers = self.numbers(&types);
            of_observation.iter().map(|&of_type| numbers[of_type]).collect()
        });
        if let Some(numbers) = &numbers {
            for (sigma, &number) in given.sigma.iter_mut().zip(numbers) {
                *sigma *= self.factors.value(number).sqrt();
            }
        }
        let before = (!observed.is_empty()).then(|| self.method.clone());
        let analysis = self.method.analyse(from, &given)?;
        if let Some(before) = before {
            let departures = [&*analysis.background_departures, &*analysis.analysis_departures];
            self.adapt(&*before, from, &given, departures, numbers.as_deref())?;
        }
        Ok(analysis)
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&self.factors, to)?;
        self.method.save(to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let factors: ErrorFactors = read(from)?;
        factors.require(self.settings.state_error.as_ref().map(|adapted| adapted.name))?;
        self.method.recall(from)?;
        self.factors = factors;
        self.apply_state_factor();
        Ok(())
    }

    fn can(&self) -> Views<'_> {
        Views { parameters: Some(self), ..self.method.can() }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        // The factor is this method's own.
        Adjustments { error_factor: None, ..self.method.adjust() }
    }
}

impl EstimatesParameters for Adaptive {
    fn estimated_parameters(&self) -> Vec<EstimatedParameter> {
        let mut parameters = self.method.can().parameters.map_or_else(Vec::new, |it| it.estimated_parameters());
        parameters.extend(self.factors.parameters());
        parameters
    }
}
