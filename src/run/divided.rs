//! What the ranks of a run can compute together, and what not.

use crate::kinds::methods::Method;
use crate::options::RunOptions;
use crate::scenario::Scenario;
use crate::text::listed;

/// A method of a run that ranks cannot compute together.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("several processes cannot compute it together, because of {reason}")]
pub struct Undivided {
    /// The methods, and why.
    reason: String,
}

/// Refuses methods that ranks do not divide: those of a scenario that the options choose, and those `added` by code.
///
/// # Errors
/// With the names of the methods.
pub fn check_divided<'a>(
    scenario: &Scenario,
    options: &RunOptions,
    added: impl IntoIterator<Item = &'a str>,
) -> Result<(), Undivided> {
    let chosen = |name: &str| options.methods.as_ref().is_none_or(|chosen| chosen.iter().any(|it| it == name));
    let undivided = |(name, method): (&String, &Method)| {
        let why = method.why_undivided().filter(|_| chosen(name))?;
        Some(format!("{name} ({why})"))
    };
    let of_scenario = scenario.methods.iter().filter_map(undivided);
    let of_code = added.into_iter().filter(|name| chosen(name)).map(|name| format!("{name} (made by code)"));
    let all: Vec<String> = of_scenario.chain(of_code).collect();
    if all.is_empty() { Ok(()) } else { Err(Undivided { reason: listed(all.iter().map(String::as_str)) }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn methods_that_are_not_divided_are_named() {
        let text = include_str!("../cli/template.toml").to_string();
        let scenario = Scenario::parse(Path::new("mine.toml"), &text).unwrap();
        let options = |methods: &[&str]| RunOptions {
            methods: Some(methods.iter().map(ToString::to_string).collect()),
            ..RunOptions::new("out")
        };
        assert_eq!(check_divided(&scenario, &options(&["free", "fkf"]), []), Ok(()));
        let error = check_divided(&scenario, &options(&["free", "own"]), ["own", "other"]).unwrap_err();
        let message = "several processes cannot compute it together, because of own (made by code)";
        assert_eq!(error.to_string(), message);
    }
}
