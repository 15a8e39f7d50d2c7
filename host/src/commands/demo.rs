//! `ftcal demo`: the whole job once, on a simulated board.

use std::path::PathBuf;

use clap::Args;

use super::{Failure, Streams};
use crate::demo::{self, DemoError, Options};
use crate::remedy;
use crate::simulator::scenario::ScenarioKind;

/// Calibrate a simulated sensor by shape from motion, from raw codes to newtons, and judge the result
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// Which of the paper's systems
    #[arg(long, value_enum, default_value = "wrist")]
    scenario: ScenarioKind,
    /// Seed of everything random: another number is another sensor on another bench
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder for the calibration file and the figures
    #[arg(short, long, value_name = "FOLDER", default_value = "ftcal-demo")]
    output: PathBuf,
    /// Keep the recordings, too, with a session file that `ftcal calibrate` takes
    #[arg(long)]
    keep_recordings: bool,
}

impl Default for Arguments {
    /// What `ftcal demo` does without further words.
    fn default() -> Self {
        Self {
            scenario: ScenarioKind::Wrist,
            seed: 1,
            output: PathBuf::from("ftcal-demo"),
            keep_recordings: false,
        }
    }
}

/// Runs the demonstration: tables are data, progress is words.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let options = Options {
        scenario: arguments.scenario,
        seed: arguments.seed,
        folder: arguments.output.clone(),
        keep_recordings: arguments.keep_recordings,
    };
    demo::run(&options, streams.data, streams.words).map_err(|error| match error {
        DemoError::Refused(refusal) => Failure::Refused(remedy::calibration(&refusal)),
        DemoError::Client(error) => error.into(),
        DemoError::Output(error) => Failure::Output(error),
        other => Failure::input(other),
    })
}
