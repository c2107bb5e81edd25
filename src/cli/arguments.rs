//! The arguments that the program takes.

use super::advise_arguments::{ADVISE_EXAMPLES, AdviseArguments};
use super::members::{MEMBERS_EXAMPLES, MembersArguments};
use super::outputs::OutputArguments;
use super::sensors::SensorsCommand;
use super::threads::MOST_THREADS;
use super::winds::{WINDS_HELP, WindsArguments};
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
    let mpi = (!cfg!(feature = "mpi")).then_some("mpi");
    let features = match missing.chain(mpi).collect::<BTreeSet<_>>() {
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
    /// Open the recording of a run in the rerun viewer; it is made now if the run only left what it is made of
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
        /// Print all tables, and not only the verdicts and the worst biases
        #[arg(long, short)]
        all: bool,
        /// Print them as JSON, with all digits
        #[arg(long)]
        json: bool,
    },
    /// Rank possible observations by how much they would help to know a bias, a mean or a forecast
    #[command(after_help = ADVISE_EXAMPLES)]
    Advise(AdviseArguments),
    /// Write the members of an ensemble, or the common factors of a Fast Kalman Filter, at the end of a run to a netCDF file
    #[command(after_help = MEMBERS_EXAMPLES)]
    Members(MembersArguments),
    /// Find positions of a balloon, the wind, and the offsets of the sensors that track it
    #[command(after_help = WINDS_HELP)]
    Winds(WindsArguments),
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
    /// Write the scores to this file as JSON, with all digits and units
    #[arg(long, short, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace the file of an earlier computation
    #[arg(long, short = 'f', requires = "out")]
    pub overwrite: bool,
    /// Show no progress
    #[arg(long, short)]
    pub quiet: bool,
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
