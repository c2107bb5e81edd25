//! Scenario files that are broken at random, and scores that are accepted.

use isobar::scenario::{Expected, Scenario, accept, with_expected};
use isobar::scores::{MethodScores, Summary};
use miette::{GraphicalReportHandler, GraphicalTheme};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::path::Path;

const VALID: &str = include_str!("common/valid.toml");

/// The text after a few random faults.
fn broken(random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = VALID.as_bytes().to_vec();
    let below = |random: &mut ChaCha8Rng, n: usize| (random.next_u64() % n.max(1) as u64) as usize;
    for _ in 0..1 + below(random, 3) {
        let place = below(random, bytes.len());
        match below(random, 6) {
            0 if !bytes.is_empty() => bytes[place] ^= 1 << below(random, 8),
            1 => bytes.truncate(place),
            2 => {
                let text = String::from_utf8_lossy(&bytes).into_owned();
                let mut lines: Vec<&str> = text.lines().collect();
                if !lines.is_empty() {
                    lines.remove(below(random, lines.len()));
                }
                bytes = lines.join("\n").into_bytes();
            }
            3 => {
                let strange =
                    ["\u{1b}[2J", "é", "\u{202e}", "[", "{", "\"\"\"", "\r", "-9223372036854775809", "1e999", "🜁"];
                let insert = strange[below(random, strange.len())].as_bytes();
                bytes.splice(place..place, insert.iter().copied());
            }
            4 => {
                let end = (place + below(random, 40)).min(bytes.len());
                let piece = bytes[place..end].to_vec();
                bytes.splice(place..place, piece);
            }
            _ => {
                let end = (place + below(random, 10)).min(bytes.len());
                bytes.drain(place..end);
            }
        }
    }
    bytes
}

#[test]
fn no_mutation_of_a_scenario_panics_or_escapes() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("mutant.toml");
    let handler = GraphicalReportHandler::new_themed(GraphicalTheme::unicode_nocolor()).with_width(100);
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let (mut valid, mut invalid) = (0, 0);
    for _ in 0..2000 {
        let bytes = broken(&mut random);
        fs::write(&path, &bytes).unwrap();
        match Scenario::load(&path) {
            Ok(scenario) => {
                assert_eq!(scenario.text.as_bytes(), bytes);
                valid += 1;
            }
            Err(error) => {
                let mut shown = String::new();
                handler.render_report(&mut shown, &error).unwrap();
                assert!(shown.contains("mutant.toml:"), "no place in {shown}");
                assert!(!shown.chars().any(|c| c.is_control() && c != '\n'), "{shown:?}");
                invalid += 1;
            }
        }
    }
    assert!(valid > 20 && invalid > 1000, "{valid} valid, {invalid} invalid");
}

fn summary(h: f64) -> Summary {
    let values = [("rmse_analysis.h", h), ("rmse_background.h", 2.0 * h), ("innovation_chi2", 1.0 / 3.0)];
    let values = values.map(|(score, value)| (score.to_string(), value)).into();
    let scores = MethodScores { values, ..MethodScores::default() };
    Summary {
        scenario: "valid".into(),
        seed: 1,
        cycles: 10,
        scored_from_cycle: 2,
        version: "0".into(),
        observations: Default::default(),
        methods: [("free".to_string(), scores.clone()), ("fkf".to_string(), scores)].into(),
        ranks: None,
    }
}

#[test]
fn accepting_scores_changes_nothing_else_in_the_file() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("valid.toml");
    for text in [VALID.to_string(), VALID.replace('\n', "\r\n"), VALID.trim_end().to_string()] {
        fs::write(&path, &text).unwrap();
        let scenario = Scenario::load(&path).unwrap();
        accept(&scenario, &Expected::from_summary(&summary(3.21), 0.05)).unwrap();
        let first = fs::read_to_string(&path).unwrap();
        assert!(first.starts_with(&text), "{first}");
        let accepted = Scenario::load(&path).unwrap();
        assert_eq!(accepted.expected.methods["fkf"]["rmse_analysis.h"], 3.21);
        assert_eq!(accepted.expected.methods["free"]["innovation_chi2"], 0.33333);
        assert_eq!(accepted.expected.relative_tolerance, 0.05);

        // Again, with other scores and back: the file is the same to the byte.
        accept(&accepted, &Expected::from_summary(&summary(4.0), 0.05)).unwrap();
        assert_ne!(fs::read_to_string(&path).unwrap(), first);
        accept(&Scenario::load(&path).unwrap(), &Expected::from_summary(&summary(3.21), 0.05)).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), first);
    }
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1, "a temporary file was left");
}

#[test]
fn scores_are_not_accepted_into_a_file_that_changed_or_hides_them() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("valid.toml");
    fs::write(&path, VALID).unwrap();
    let scenario = Scenario::load(&path).unwrap();
    fs::write(&path, format!("# new\n{VALID}")).unwrap();
    let error = accept(&scenario, &Expected::from_summary(&summary(1.0), 0.05)).unwrap_err();
    assert!(error.to_string().contains("has changed"), "{error}");

    let inline = format!("expected = {{ free = {{ bias_rmse = 1 }} }}\n{VALID}");
    let scenario = Scenario::parse(Path::new("inline.toml"), &inline).unwrap();
    assert!(with_expected(&scenario, &Expected::from_summary(&summary(1.0), 0.05)).is_err());
}
