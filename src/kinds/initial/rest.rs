//! `kind = "rest"`.

use super::state::{InitialState, MEAN_DEPTH_M, mean_depth_m, on_water};
use crate::kinds::{Domain, Kind};
use isobar_model::initial::rest;
use isobar_model::{ModelError, State};

pub(super) const KIND: Kind<dyn InitialState, Domain> =
    Kind::<dyn InitialState, Domain>::new("rest", "Still water", &[&[&MEAN_DEPTH_M]], |section, domain| {
        Ok(Box::new(Rest { mean_depth_m: mean_depth_m(section, domain)? }))
    })
    .only_if(|domain| domain.model.is_shallow_water());

#[derive(Debug)]
struct Rest {
    mean_depth_m: f64,
}

impl InitialState for Rest {
    fn build(&self, domain: &Domain, _: u64) -> Result<State, ModelError> {
        on_water(domain, |water| rest(water, self.mean_depth_m))
    }
}
