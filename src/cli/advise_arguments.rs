//! The arguments of `isobar advise`.

use super::final_state::FinalStateArguments;
use super::threads::MOST_THREADS;
use clap::Args;
use std::ops::RangeInclusive;
use std::str::FromStr;

pub const ADVISE_EXAMPLES: &str = "Examples:
  isobar advise quickstart --from out/quickstart --method fkf --bias sondes/h/France
  isobar advise quickstart --from out/quickstart --method kf --mean h --at 3000:5000,2000:3500 --lead-hours 24
  isobar advise mine.toml --from out/mine --method fkf --mean u --grid 100x100 --sigma h=12,u=2,v=2 --json";

#[derive(Args, Debug)]
pub struct AdviseArguments {
    #[command(flatten)]
    pub end: FinalStateArguments,
    #[command(flatten)]
    pub of: AskedArguments,
    /// Where the mean is: anywhere, a station NETWORK/NAME, a place X,Y or a box X:X,Y:Y in km
    #[arg(long, value_name = "PLACE", default_value = "anywhere", conflicts_with = "bias")]
    pub at: String,
    /// How long after the next analysis it is to be known, in whole cycles
    #[arg(long, value_name = "H", default_value_t = 0.0, value_parser = hours)]
    pub lead_hours: f64,
    /// Numbers of places in x and y at which a new radiosonde is tried
    #[arg(long, value_name = "NXxNY", default_value = "20x15", value_parser = places)]
    pub grid: [usize; 2],
    /// Standard deviations of a new radiosonde's errors [default: the smallest of the stations that report]
    #[arg(long, value_name = "VARIABLE=SIGMA,…", value_delimiter = ',', value_parser = sigma)]
    pub sigma: Vec<(String, f64)>,
    /// Standard deviation of test points and comparisons, in the sensors' unit
    #[arg(long, value_name = "SIGMA", default_value_t = 0.0, value_parser = error)]
    pub comparison_sigma: f64,
    /// Number of candidates of each kind in the tables
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub top: u64,
    /// Number of threads [default: RAYON_NUM_THREADS, or one for each core]; results do not depend on it
    #[arg(long, short = 'j', value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MOST_THREADS))]
    pub threads: Option<u64>,
    /// Print all candidates as JSON
    #[arg(long)]
    pub json: bool,
}

/// What is to be known better.
#[derive(Args, Debug)]
#[group(required = true, multiple = false)]
pub struct AskedArguments {
    /// The bias of this name, as in the tables of a run
    #[arg(long, value_name = "NAME")]
    pub bias: Option<String>,
    /// The mean of this variable, or its value at a place
    #[arg(long, value_name = "VARIABLE")]
    pub mean: Option<String>,
}

/// A number within these bounds.
fn number<T: FromStr + PartialOrd>(text: &str, bounds: RangeInclusive<T>) -> Option<T> {
    text.parse().ok().filter(|number| bounds.contains(number))
}

/// A time after an analysis \[h\].
fn hours(text: &str) -> Result<f64, String> {
    number(text, 0.0..=1e5).ok_or_else(|| "it must be a number from 0 to 100000".into())
}

/// A standard deviation, which may be 0.
fn error(text: &str) -> Result<f64, String> {
    number(text, 0.0..=1e9).ok_or_else(|| "it must be a number from 0 to 1e9".into())
}

/// Two numbers with an x between them.
fn places(text: &str) -> Result<[usize; 2], String> {
    let count = |part: &str| number(part.trim(), 1..=10_000);
    let numbers = text.split_once('x').and_then(|(x, y)| Some([count(x)?, count(y)?]));
    numbers.ok_or_else(|| "it must be two whole numbers from 1 to 10000, as in 20x15".into())
}

/// A variable and a standard deviation.
fn sigma(text: &str) -> Result<(String, f64), String> {
    let sigma = |text: &str| number(text.trim(), 1e-9..=1e9);
    let both = text.split_once('=').and_then(|(name, value)| Some((name.trim().to_string(), sigma(value)?)));
    both.ok_or_else(|| "it must be a variable and a number from 1e-9 to 1e9, as in h=12".into())
}
