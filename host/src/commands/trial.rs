//! `ftcal trial`: a trial that the sensor itself sums up and solves.

use clap::{Args, Subcommand};
use ftcal_shared::wire::{Solution, TrialStatus};
use serde::Serialize;

use super::device::DeviceArgs;
use super::{Failure, Streams, print_json};
use crate::calibration::trial::SampleCounts;
use crate::link::words;

/// The arguments of `ftcal trial`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    action: TrialAction,
}

impl Arguments {
    /// Whether a refusal is to be printed as JSON.
    pub const fn json(&self) -> bool {
        matches!(self.action, TrialAction::Solve { json: true, .. })
    }
}

/// What to do with the trial.
#[derive(Clone, Debug, Subcommand)]
enum TrialAction {
    /// Start a trial: from now on, turn the load through all directions
    Start {
        #[command(flatten)]
        device: DeviceArgs,
        /// Proper rank of the trial: 2 for a planar sensor, 3 for a spatial one
        #[arg(long, value_parser = clap::value_parser!(u8).range(2..=3))]
        rank: u8,
    },
    /// Stop the trial and keep its sums
    Stop {
        #[command(flatten)]
        device: DeviceArgs,
    },
    /// Tell how far the trial is
    Status {
        #[command(flatten)]
        device: DeviceArgs,
    },
    /// Solve the stopped trial on the sensor and print shape and bias as one JSON object
    Solve {
        #[command(flatten)]
        device: DeviceArgs,
        /// Print refusals as JSON, too
        #[arg(long)]
        json: bool,
    },
}

/// Does what is asked with the sensor's trial.
///
/// # Errors
///
/// [`Failure`]; a refused solution is [`Failure::Refused`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    match &arguments.action {
        TrialAction::Start { device, rank } => {
            let mut client = device.connect()?;
            // A trial without conversions would stay empty, and nobody would know why.
            client.wait_for_converter()?;
            client.start_trial(*rank)?;
            writeln!(
                streams.words,
                "Trial started. Turn the load through all directions, then `ftcal trial stop`."
            )?;
        }
        TrialAction::Stop { device } => {
            let status = device.connect()?.stop_trial()?;
            writeln!(streams.data, "{}", words::trial_status(&status))?;
        }
        TrialAction::Status { device } => {
            let status = device.connect()?.trial_status()?;
            writeln!(streams.data, "{}", words::trial_status(&status))?;
        }
        TrialAction::Solve { device, .. } => {
            let mut client = device.connect()?;
            let status = client.trial_status()?;
            let solution = client.solve_trial()?;
            print_json(&Report::new(&solution, &status), streams.data)?;
        }
    }
    Ok(())
}

/// The solution, with the field names of `ftcal solve`; the samples themselves stayed on the sensor, so that it tells no
/// magnitudes.
#[derive(Serialize)]
struct Report<'a> {
    rank: u8,
    gages: usize,
    samples: SampleCounts,
    eigenvalues: &'a [f64],
    noise_counts: Option<f64>,
    bias_counts: &'a [f64],
    shape_counts_per_load: Vec<&'a [f64]>,
}

impl<'a> Report<'a> {
    fn new(solution: &'a Solution, trial: &TrialStatus) -> Self {
        let gages = solution.bias_counts.len();
        Self {
            rank: solution.rank,
            gages,
            samples: SampleCounts::on_the_sensor(trial, solution),
            eigenvalues: &solution.eigenvalues,
            noise_counts: solution.noise_counts,
            bias_counts: &solution.bias_counts,
            shape_counts_per_load: solution.shape_counts_per_load.chunks(gages.max(1)).collect(),
        }
    }
}
