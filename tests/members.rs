//! `isobar members`: what a method carries of its covariance, at the end of a run.

use crate::common::{CARRIED_TRACER, isobar, one_line, text};
use netcdf_reader::NcFile;
use std::fs;
use std::path::Path;

const METHODS: &str = r#"
[methods.free]
kind = "free"
[methods.etkf]
kind = "etkf"
members = 12
[methods.fkf]
kind = "fkf"
blocks = "cell"
factors = 20                     # beside that of the bias
"#;

/// A variable of a file, in the order of the file.
fn read(path: &Path, name: &str) -> Vec<f64> {
    NcFile::open(path).unwrap().read_variable::<f64>(name).unwrap().iter().copied().collect()
}

#[test]
fn members_and_factors_are_those_of_the_last_analysis() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::write(here.join("s.toml"), [CARRIED_TRACER, METHODS].concat()).unwrap();
    let run = isobar(here, &["run", "s.toml", "--quiet", "--no-report", "--no-rerun"]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let members = |method: &str| isobar(here, &["members", "s.toml", "--from", "out/s", "--method", method]);
    let last = |method: &str, name: &str, length: usize| -> Vec<f64> {
        let all = read(&here.join(format!("out/s/{method}.nc")), name);
        all[all.len() - length..].to_vec()
    };
    for (method, file, columns) in [("etkf", "etkf_members.nc", 12), ("fkf", "fkf_factors.nc", 21)] {
        let output = members(method);
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert!(text(&output.stdout).contains(file));
        for (name, of_run) in [("tracer", "tracer_analysis"), ("calibration", "calibration_analysis")] {
            let values = read(&here.join(file), name);
            let length = values.len() / columns;
            let [estimate, spread] =
                [of_run.to_string(), format!("{of_run}_spread")].map(|it| last(method, &it, length));
            for place in 0..length {
                let own = || values.iter().skip(place).step_by(length);
                let squares = |about: f64| own().map(|value| (value - about).powi(2)).sum::<f64>();
                if method == "etkf" {
                    let mean = own().sum::<f64>() / columns as f64;
                    assert!((mean - estimate[place]).abs() < 1e-10, "{name} {place}: {mean} {}", estimate[place]);
                    let sigma = (squares(mean) / (columns - 1) as f64).sqrt();
                    assert!((sigma / spread[place] - 1.0).abs() < 1e-10, "{name} {place}: {sigma} {}", spread[place]);
                } else {
                    // The rest of the variance is that of the blocks; all parameters are shared.
                    let share = squares(0.0) / spread[place].powi(2);
                    assert!(if name == "tracer" { share < 1.0 } else { (share - 1.0).abs() < 1e-9 }, "{name} {share}");
                    assert!(share > 0.3, "{name} {place}: {share}");
                }
            }
        }
        let times = read(&here.join(format!("out/s/{method}.nc")), "time");
        assert_eq!(read(&here.join(file), "time"), times[times.len() - 1..]);
    }
    let refused = |output: std::process::Output| {
        assert_eq!(output.status.code(), Some(1));
        one_line(&text(&output.stderr))
    };
    assert!(refused(members("fkf")).contains("fkf_factors.nc exists"));
    assert!(refused(members("free")).contains("neither an ensemble nor common factors"));
    assert!(refused(members("none")).contains("none"));
}
