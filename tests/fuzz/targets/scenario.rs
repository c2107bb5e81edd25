//! A scenario file: a scenario, or an error that shows where it is wrong and nothing that a terminal would obey.
#![no_main]

use isobar::scenario::Scenario;
use libfuzzer_sys::fuzz_target;
use miette::{GraphicalReportHandler, GraphicalTheme};
use std::path::Path;

fuzz_target!(|text: &str| {
    match Scenario::parse(Path::new("no such directory/fuzzed.toml"), text) {
        Ok(scenario) => assert_eq!(scenario.text, text),
        Err(error) => {
            let handler = GraphicalReportHandler::new_themed(GraphicalTheme::none()).with_width(100);
            let mut shown = String::new();
            handler.render_report(&mut shown, &error).unwrap();
            assert!(shown.len() < 10_000, "{} bytes", shown.len());
            assert!(!shown.chars().any(|c| c.is_control() && c != '\n'), "{shown:?}");
        }
    }
});
