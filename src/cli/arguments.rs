//! The arguments that the program takes.

use super::outputs::OutputArguments;
use super::sensors::SensorsCommand;
use super::threads::MOST_THREADS;
use crate::batch::seeds::FEWEST_SEEDS;
use crate::output::recorded::recording::VIEWER_VERSION;
use crate::output::{OUTPUTS, Open};
use crate::text::listed;
use clap::{Args, Parser, Subcommand};
use clap_complete::Shell;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::LazyLock;

/// A 2-D data-assimilation testbed with Lange's Fast Kalman Filter.
#[derive(Debug, Parser)]
#[command(version, long_version = VERSION.as_str(), about, after_help = EXAMPLES)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

/// What `--version` says: the version, what this build can do, and the viewer for which it writes.
static VERSION: LazyLock<String> = LazyLock::new(|| {
    let missing = OUTPUTS.iter().filter_map(|output| match output.open {
        Open::Available(_) | Open::ByRun => None,
        Open::NeedsFeature(feature) => Some(feature),
    });
    let features = match missing.collect::<BTreeSet<_>>() {
        missing if missing.is_empty() => "all".to_string(),
        missing => format!("all but {}", listed(missing)),
    };
    format!("{}\nfeatures: {features}\nrerun viewer: {VIEWER_VERSION}", crate::VERSION)
});

const EXAMPLES: &str = "Examples:
  isobar list                                    what there is to run
  isobar run quickstart                          run scenarios/quickstart.toml, or isobar's scenario of that name
  isobar run quickstart --methods free,fkf       only two of its methods
  isobar init mine.toml && isobar check mine.toml
  isobar resume out/quickstart                   continue a run that was interrupted
  isobar view out/quickstart                     look at a run in the rerun viewer
  isobar sweep mine.toml                         all settings of its [sweep], and which are the best
  isobar exact fkf_linear                        the errors of infinitely many seeds, where all is linear
  isobar diagnose out/quickstart                 are claims, covariances and biases what they should be?
  isobar advise quickstart --from out/quickstart --method fkf --mean h    what is worth observing next
  isobar compare out/quickstart other/quickstart which one is better, and is that chance?
  isobar regress                                 have the scores of any scenario moved?";

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run scenarios, print their scores and write their files
    #[command(after_help = RUN_EXAMPLES)]
    Run(RunArguments),
    /// Continue runs that were interrupted
    #[command(after_help = RESUME_EXAMPLES)]
    Resume(ResumeArguments),
    /// Say whether scenario files are valid, without running them
    Check(CheckArguments),
    /// List the scenarios in ./scenarios and in isobar, or what they may choose from
    #[command(after_help = LIST_EXAMPLES)]
    List(ListArguments),
    /// Write a scenario to start from: a commented template, or another scenario with the files that it names
    #[command(after_help = INIT_EXAMPLES)]
    Init(InitArguments),
    /// Say what a key of a scenario means: unit, range, default
    #[command(after_help = EXPLAIN_EXAMPLES)]
    Explain {
        /// The key, with the tables and kinds that lead to it [default: all at the top of a scenario]
        key: Option<String>,
    },
    /// Print what makes a shell complete the arguments of isobar
    #[command(after_help = COMPLETIONS_HELP)]
    Completions {
        /// The shell
        shell: Shell,
    },
    /// Print a JSON schema of scenario files, for editors
    #[command(after_help = SCHEMA_HELP)]
    Schema,
    /// Run scenarios and compare their scores with the accepted ones in [expected]
    Regress(RegressArguments),
    /// Open the recording of a run in the rerun viewer
    View {
        /// The run's directory
        #[arg(value_name = "OUT")]
        run: PathBuf,
    },
    /// Run a scenario with all settings of its [sweep], and say which are the best
    #[command(after_help = SWEEP_EXAMPLES)]
    Sweep(SweepArguments),
    /// Compute the exact errors of linear methods in a linear scenario, without a single random number
    Exact(ExactArguments),
    /// Print what runs show beyond errors: claimed distributions, departures, worth of observations, biases
    Diagnose {
        /// Directories of runs
        #[arg(required = true, value_name = "OUT")]
        runs: Vec<PathBuf>,
        /// Print them as JSON, with all digits
        #[arg(long)]
        json: bool,
    },
    /// Rank what could be observed next by what it would tell of a bias, a mean or a forecast
    #[command(after_help = ADVISE_EXAMPLES)]
    Advise(AdviseArguments),
    /// Keep what is known of sensors from run to run: calibrations, test points, recalibrations
    Sensors {
        #[command(subcommand)]
        command: SensorsCommand,
    },
    /// Make one page of the scores of several runs, with their differences and whether these are significant
    Compare(CompareArguments),
}

const INIT_EXAMPLES: &str = "Examples:
  isobar init mine.toml                          a small scenario with a comment on every section
  isobar init --from quickstart mine.toml        the quickstart, and stations/europe.csv beside it";

#[derive(Args, Debug)]
pub struct InitArguments {
    /// The new file
    #[arg(default_value = "scenario.toml", value_name = "FILE")]
    pub path: PathBuf,
    /// Copy this scenario instead of the template, and the files that it names to the same places beside the copy
    #[arg(long, value_name = "SCENARIO")]
    pub from: Option<OsString>,
}

const EXPLAIN_EXAMPLES: &str = "Examples:
  isobar explain                                 the tables of a scenario
  isobar explain grid.dx_km                      a key
  isobar explain methods.letkf                   a kind of method, with its keys
  isobar explain networks.radiosonde.bias        a key of a kind of instrument, with the keys in it";

const COMPLETIONS_HELP: &str = "Examples:
  isobar completions bash > ~/.local/share/bash-completion/completions/isobar
  isobar completions fish > ~/.config/fish/completions/isobar.fish
  isobar completions zsh > ~/.zfunc/_isobar      where fpath in ~/.zshrc has ~/.zfunc";

const SCHEMA_HELP: &str = "Examples:
  isobar schema > isobar.schema.json

Editors with taplo, such as VS Code with Even Better TOML, complete and check the keys of a scenario that begins with
  #:schema ./isobar.schema.json";

const LIST_EXAMPLES: &str = "Examples:
  isobar list                                    the scenarios in ./scenarios and in isobar
  isobar list --methods                          the kinds of methods
  isobar list --methods letkf                    the keys of one of them, with units, ranges and defaults";

#[derive(Args, Debug)]
pub struct ListArguments {
    #[command(flatten)]
    pub of: ListedKinds,
    /// Print the list as JSON
    #[arg(long)]
    pub json: bool,
}

/// The kinds that are listed instead of scenarios.
#[derive(Args, Debug)]
#[group(multiple = false)]
pub struct ListedKinds {
    /// List the kinds of methods, or the keys of one
    #[arg(long, value_name = "KIND")]
    pub methods: Option<Option<String>>,
    /// List the kinds of models, or the keys of one
    #[arg(long, value_name = "KIND")]
    pub models: Option<Option<String>>,
    /// List the kinds of initial states, or the keys of one
    #[arg(long, value_name = "KIND")]
    pub initial: Option<Option<String>>,
    /// List the kinds of instruments, or the keys of one
    #[arg(long, value_name = "KIND")]
    pub instruments: Option<Option<String>>,
    /// List the kinds of covariances, or the keys of one
    #[arg(long, value_name = "KIND")]
    pub covariances: Option<Option<String>>,
}

const RUN_EXAMPLES: &str = "Examples:
  isobar run quickstart
  isobar run quickstart --cycles 10 --no-netcdf --no-rerun
  isobar run mine.toml --seed 7 --out results --overwrite
  isobar run today.toml --from out/yesterday     go on where a run ended
  isobar run fkf_linear --seeds 10 --against kf  mean scores over ten seeds, and whether the differences are chance";

#[derive(Args, Debug)]
pub struct RunArguments {
    /// Scenario files, or names of scenarios in ./scenarios or in isobar
    #[arg(required = true, value_name = "SCENARIO")]
    pub scenarios: Vec<OsString>,
    /// Directory for the results, one subdirectory for each scenario
    #[arg(long, short, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    /// Run only these methods of the scenario
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    pub methods: Option<Vec<String>>,
    /// Run this number of cycles instead of the scenario's
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub cycles: Option<u64>,
    /// Use this seed instead of the scenario's
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Go on from the state in which the run in this directory ended, as one run would; the scenario starts where that ended
    #[arg(long, value_name = "OUT", conflicts_with = "seeds")]
    pub from: Option<PathBuf>,
    /// Number of threads [default: RAYON_NUM_THREADS, or one for each core]; results do not depend on it
    #[arg(long, short = 'j', value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MOST_THREADS))]
    pub threads: Option<u64>,
    /// Replace the files of an earlier run; what no run wrote is never deleted
    #[arg(long, short = 'f')]
    pub overwrite: bool,
    /// Database of sensors, in the place of the scenario's; it may be anywhere, a scenario's only below its own directory
    #[arg(long, value_name = "FILE")]
    pub sensors: Option<PathBuf>,
    /// Show no progress
    #[arg(long, short)]
    pub quiet: bool,
    /// Print the scores as JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub outputs: OutputArguments,
    /// Run this number of seeds, from the scenario's or --seed on, and report mean scores and differences over them
    #[arg(long, value_name = "N", conflicts_with = "live", value_parser = clap::value_parser!(u64).range(FEWEST_SEEDS..=10_000))]
    pub seeds: Option<u64>,
    /// The method with which --seeds compares the others [default: the scenario's first]
    #[arg(long, value_name = "NAME", requires = "seeds")]
    pub against: Option<String>,
    /// With --seeds: write all files of every seed, and not only its scores
    #[arg(long, requires = "seeds")]
    pub all_files: bool,
    /// Write a checkpoint every M minutes; 0: not for the time alone
    #[arg(long, value_name = "M", default_value_t = 5.0, value_parser = minutes)]
    pub checkpoint_minutes: f64,
    /// Write a checkpoint every N cycles, whatever it costs
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub checkpoint_cycles: Option<u64>,
}

/// A number of minutes.
fn minutes(text: &str) -> Result<f64, String> {
    let wanted = "a number from 0 to 100000";
    text.parse().ok().filter(|minutes| (0.0..=1e5).contains(minutes)).ok_or_else(|| format!("it must be {wanted}"))
}

const RESUME_EXAMPLES: &str = "Examples:
  isobar resume out/quickstart                   what `isobar run quickstart` would have done
  isobar resume out/jet out/vortices --threads 4";

#[derive(Args, Debug)]
pub struct ResumeArguments {
    /// Directories of the runs, as they would be called when complete
    #[arg(required = true, value_name = "OUT")]
    pub runs: Vec<PathBuf>,
    /// Number of threads [default: RAYON_NUM_THREADS, or one for each core]; results do not depend on it
    #[arg(long, short = 'j', value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MOST_THREADS))]
    pub threads: Option<u64>,
    /// Show no progress
    #[arg(long, short)]
    pub quiet: bool,
    /// Show the run in a running rerun viewer while it computes
    #[arg(long)]
    pub live: bool,
    /// Database of sensors, if the run was begun with --sensors
    #[arg(long, value_name = "FILE")]
    pub sensors: Option<PathBuf>,
}

const SWEEP_EXAMPLES: &str = "In the scenario:
  [sweep]
  seeds = 3                                      # of each setting; 1 if it is not given
  score = \"rmse_analysis.h\"                    # by which the best setting is chosen; that of the first variable
  [sweep.vary]
  \"methods.var.covariance_scale\" = [0.05, 0.1, 0.2]
  \"methods.letkf.localization_radius_km\" = { from = 300, to = 3000, count = 5, spacing = \"logarithmic\" }";

#[derive(Args, Debug)]
pub struct SweepArguments {
    /// Scenario file, or name of a scenario in ./scenarios or in isobar
    #[arg(value_name = "SCENARIO")]
    pub scenario: OsString,
    /// Directory for the results, which go to a subdirectory SCENARIO-sweep
    #[arg(long, short, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    #[command(flatten)]
    pub part: PartArguments,
    /// Replace the files of an earlier sweep
    #[arg(long, short = 'f')]
    pub overwrite: bool,
    /// Show no progress
    #[arg(long, short)]
    pub quiet: bool,
}

#[derive(Args, Debug)]
pub struct ExactArguments {
    /// Scenario file, or name of a scenario in ./scenarios or in isobar
    #[arg(value_name = "SCENARIO")]
    pub scenario: OsString,
    #[command(flatten)]
    pub part: PartArguments,
}

const ADVISE_EXAMPLES: &str = "Examples:
  isobar advise quickstart --from out/quickstart --method fkf --bias sondes/h/France
  isobar advise quickstart --from out/quickstart --method kf --mean h --at 3000:5000,2000:3500 --lead-hours 24
  isobar advise mine.toml --from out/mine --method kf --mean u --grid 100x100 --sigma h=12,u=2,v=2 --json";

#[derive(Args, Debug)]
pub struct AdviseArguments {
    /// The run's scenario file, or its name; or one that goes on from the run
    #[arg(value_name = "SCENARIO")]
    pub scenario: OsString,
    /// Directory of the run, with its final state
    #[arg(long, value_name = "OUT")]
    pub from: PathBuf,
    /// The method whose covariance is asked
    #[arg(long, value_name = "NAME")]
    pub method: String,
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
    /// Standard deviations of a new radiosonde's errors [default: the least with which a station reports]
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

/// A time after an analysis \[h\].
fn hours(text: &str) -> Result<f64, String> {
    let wanted = "it must be a number from 0 to 100000";
    text.parse().ok().filter(|hours| (0.0..=1e5).contains(hours)).ok_or_else(|| wanted.into())
}

/// A standard deviation, which may be 0.
fn error(text: &str) -> Result<f64, String> {
    let wanted = "it must be a number from 0 to 1e9";
    text.parse().ok().filter(|sigma| (0.0..=1e9).contains(sigma)).ok_or_else(|| wanted.into())
}

/// Two numbers with an x between them.
fn places(text: &str) -> Result<[usize; 2], String> {
    let number = |part: &str| part.trim().parse().ok().filter(|count| (1..=10_000).contains(count));
    let numbers = text.split_once('x').and_then(|(x, y)| Some([number(x)?, number(y)?]));
    numbers.ok_or_else(|| "it must be two whole numbers from 1 to 10000, as in 20x15".into())
}

/// A variable and a standard deviation.
fn sigma(text: &str) -> Result<(String, f64), String> {
    let sigma = |text: &str| text.trim().parse().ok().filter(|sigma| (1e-9..=1e9).contains(sigma));
    let both = text.split_once('=').and_then(|(name, value)| Some((name.trim().to_string(), sigma(value)?)));
    both.ok_or_else(|| "it must be a variable and a number from 1e-9 to 1e9, as in h=12".into())
}

/// Which part of a scenario is run, and on how many threads.
#[derive(Args, Debug)]
pub struct PartArguments {
    /// Only these methods of the scenario
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    pub methods: Option<Vec<String>>,
    /// This number of cycles instead of the scenario's
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub cycles: Option<u64>,
    /// Number of threads [default: RAYON_NUM_THREADS, or one for each core]; results do not depend on it
    #[arg(long, short = 'j', value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MOST_THREADS))]
    pub threads: Option<u64>,
}

#[derive(Args, Debug)]
pub struct CompareArguments {
    /// Directories of runs; the others are compared with the first
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// The page
    #[arg(long, short, value_name = "FILE", default_value = "comparison.html")]
    pub out: PathBuf,
    /// Replace the page of an earlier comparison
    #[arg(long, short = 'f')]
    pub overwrite: bool,
    /// Print the differences as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Args, Debug)]
pub struct CheckArguments {
    /// Scenario files, or names of scenarios in ./scenarios or in isobar
    #[arg(required = true, value_name = "SCENARIO")]
    pub scenarios: Vec<OsString>,
    /// Database of sensors that `isobar run --sensors` is to be given
    #[arg(long, value_name = "FILE")]
    pub sensors: Option<PathBuf>,
    /// Print what was found as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Args, Debug)]
pub struct RegressArguments {
    /// Scenario files, or names of scenarios [default: all of ./scenarios, or, where there is no such directory, all of isobar's]
    #[arg(value_name = "SCENARIO")]
    pub scenarios: Vec<OsString>,
    /// Write the new scores into the scenario files
    #[arg(long)]
    pub accept: bool,
    /// Number of threads [default: RAYON_NUM_THREADS, or one for each core]; results do not depend on it
    #[arg(long, short = 'j', value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MOST_THREADS))]
    pub threads: Option<u64>,
    /// Show no progress
    #[arg(long, short)]
    pub quiet: bool,
}
