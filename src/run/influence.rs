//! What each type of observations does in an analysis.

use crate::outcome::{Influence, TypeInfluence};
use isobar_assim::response::Responder;
use isobar_assim::{Assimilator, Background, Error};
use isobar_model::random::stream;
use isobar_obs::{ObservationTypes, ObservationWindow};
use rand::RngExt;

/// Asks a method that has just forecast `background`. `innovations` are y − h(background).
///
/// tr(H K) is estimated as Σ δ_i (H K δ)_i / σ_i² with a random sign times σ_i for each δ_i (Hutchinson 1990; Desroziers
/// and Ivanov 2001, Q. J. R. Meteorol. Soc. 127, eq. 13): unbiased, and for each type as well as for all. The analyses
/// are as many as there are types, and one.
pub(super) fn ask(
    method: &dyn Assimilator,
    background: &Background,
    observed: &ObservationWindow,
    innovations: &[f64],
) -> Result<Influence, Error> {
    let ObservationTypes { types, of_observation } = observed.types();
    let of_type = |observation_type| TypeInfluence { observation_type, increment: Vec::new(), signal: 0.0 };
    let mut types: Vec<TypeInfluence> = types.into_iter().map(of_type).collect();
    let responder = Responder::new(method, background, observed);
    for (number, own) in types.iter_mut().enumerate() {
        let of_type = |(d, kind): (&f64, &usize)| if *kind == number { *d } else { 0.0 };
        own.increment = responder.to(&innovations.iter().zip(&of_observation).map(of_type).collect::<Vec<_>>())?.state;
    }
    let mut random = stream(observed.cycle as u64, "signal");
    let signs: Vec<f64> = of_observation.iter().map(|_| if random.random::<bool>() { 1.0 } else { -1.0 }).collect();
    let probe: Vec<f64> = signs.iter().zip(&observed.sigma).map(|(sign, sigma)| sign * sigma).collect();
    let fit = responder.to(&probe)?.fit;
    for (((kind, fit), sign), sigma) in of_observation.iter().zip(fit).zip(&signs).zip(&observed.sigma) {
        types[*kind].signal += sign * fit / sigma;
    }
    Ok(Influence { types })
}
