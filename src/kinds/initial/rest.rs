//! `kind = "rest"`.

use super::state::{InitialState, MEAN_DEPTH_M, mean_depth_m, on_water};
use crate::kinds::{Domain, Kind};
use crate::reader::{AnyKey, Read, Section};
use isobar_model::initial::rest;
use isobar_model::{ModelError, State};

pub(super) struct RestKind;

impl Kind<dyn InitialState, Domain> for RestKind {
    fn name(&self) -> &'static str {
        "rest"
    }

    fn about(&self) -> &'static str {
        "Still water"
    }

    fn keys(&self) -> Vec<&'static dyn AnyKey> {
        vec![&MEAN_DEPTH_M]
    }

    fn fits(&self, domain: &Domain) -> bool {
        domain.model.is_shallow_water()
    }

    fn read(&self, section: &Section<'_>, domain: &Domain) -> Read<Box<dyn InitialState>> {
        Ok(Box::new(Rest { mean_depth_m: mean_depth_m(section, domain)? }))
    }
}

#[derive(Debug)]
struct Rest {
    mean_depth_m: f64,
}

impl InitialState for Rest {
    fn build(&self, domain: &Domain, _: u64) -> Result<State, ModelError> {
        on_water(domain, |water| rest(water, self.mean_depth_m))
    }
}
