//! `ftcal trial`: a trial that the sensor itself sums up and solves.

use std::time::Duration;

use clap::{Args, Subcommand};
use ftcal_shared::wire::{Coverage, Solution, TrialStatus};
use serde::Serialize;

use super::device::DeviceArgs;
use super::{Failure, Streams, print_json, solve};
use crate::calibration::coverage::TrialCoverage;
use crate::calibration::samples::SampleCounts;
use crate::link::client::Client;
use crate::link::error::ClientError;
use crate::link::transport::Transport;
use crate::link::words;
use crate::remedy;

/// Between two lines that tell how far a watched trial is.
const WATCH_PERIOD: Duration = Duration::from_secs(1);

/// The arguments of `ftcal trial`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    action: TrialAction,
}

impl Arguments {
    /// Whether a refusal is to be printed as JSON.
    pub const fn json(&self) -> bool {
        matches!(
            self.action,
            TrialAction::Solve { json: true, .. } | TrialAction::Coverage { json: true, .. }
        )
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
        /// Tell every second how far it is and which way to turn the load, until it knows enough
        #[arg(long)]
        watch: bool,
        #[command(flatten)]
        asked: Asked,
    },
    /// Tell what the trial has seen, how certain it is, and which way to turn the load; it goes on
    Coverage {
        #[command(flatten)]
        device: DeviceArgs,
        /// Print JSON, refusals, too
        #[arg(long)]
        json: bool,
        #[command(flatten)]
        asked: Asked,
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

/// How certain the trial is to be.
#[derive(Args, Clone, Copy, Debug)]
struct Asked {
    /// Uncertainty asked for: the largest standard deviation of any gain or offset, percent of the load
    #[arg(long = "to-percent", value_name = "PERCENT", default_value_t = 0.1, value_parser = percent)]
    percent: f64,
}

fn percent(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(percent) if percent > 0.0 && percent <= 100.0 => Ok(percent),
        _ => Err("expected a percentage above 0".to_owned()),
    }
}

/// Does what is asked with the sensor's trial.
///
/// # Errors
///
/// [`Failure`]; a refused solution is [`Failure::Refused`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    match &arguments.action {
        TrialAction::Start { device, rank, watch, asked } => {
            let mut client = device.connect()?;
            // A trial without conversions would stay empty, and nobody would know why.
            client.wait_for_converter()?;
            client.start_trial(*rank)?;
            writeln!(
                streams.words,
                "Trial started. Turn the load through all directions, then `ftcal trial stop`."
            )?;
            if *watch {
                watch_trial(&mut client, *asked, streams)?;
            }
        }
        TrialAction::Coverage { device, json, asked } => {
            let coverage = TrialCoverage::from(&device.connect()?.coverage()?);
            if *json {
                let progress = coverage.progress(asked.percent / 100.0);
                print_json(&CoverageReport { coverage: (&coverage).into(), progress }, streams.data)?;
            } else {
                writeln!(streams.data, "{}", standing(&coverage, *asked))?;
            }
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
            let solution = client.solve_trial()?;
            // What the solution leaves out is known only now.
            let status = client.trial_status()?;
            let covered =
                client.coverage().map(|covered| (covered.samples == solution.samples).then_some(covered));
            if !matches!(covered, Ok(Some(_))) {
                let cause =
                    covered.as_ref().err().map_or("it is of other samples".to_owned(), ToString::to_string);
                writeln!(
                    streams.words,
                    "The solution is good, but how certain it is could not be told: {cause}."
                )?;
            }
            print_json(&Report::new(&solution, covered.ok().flatten().as_ref(), &status), streams.data)?;
        }
    }
    Ok(())
}

/// Tells how far a trial is until it knows enough. The trial goes on: it is the user who stops it.
fn watch_trial<Line: Transport>(
    client: &mut Client<Line>,
    asked: Asked,
    streams: &mut Streams,
) -> Result<(), Failure> {
    loop {
        client.wait(WATCH_PERIOD)?;
        match client.coverage() {
            Ok(coverage) => {
                let coverage = TrialCoverage::from(&coverage);
                writeln!(streams.words, "{}", standing(&coverage, asked))?;
                if coverage.progress(asked.percent / 100.0) >= 1.0 {
                    writeln!(streams.words, "That is enough: `ftcal trial stop`, then `ftcal trial solve`.")?;
                    return Ok(());
                }
            }
            // Too little to tell anything yet is how every trial begins.
            Err(ClientError::Refused(refusal)) => {
                let explained = remedy::estimation(&refusal);
                writeln!(streams.words, "  0 % done: {}. {}", explained.detail, explained.remedy)?;
            }
            Err(error) => return Err(error.into()),
        }
    }
}

/// One line: how far the trial is, and what to do next.
fn standing(coverage: &TrialCoverage, asked: Asked) -> String {
    format!(
        "{:3.0} % done: certain within {:.3} % of the load ({} % asked for), {:.0} % of all directions seen; {}",
        // Done means done: 99.7 is not.
        (100.0 * coverage.progress(asked.percent / 100.0)).floor(),
        100.0 * coverage.worst_relative_uncertainty,
        asked.percent,
        100.0 * coverage.fraction,
        coverage.weakest_direction()
    )
}

/// What a running trial has covered.
#[derive(Serialize)]
struct CoverageReport {
    coverage: solve::Coverage,
    progress: f64,
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
    uncertainty: Option<solve::Uncertainty>,
    coverage: Option<solve::Coverage>,
}

impl<'a> Report<'a> {
    fn new(solution: &'a Solution, covered: Option<&Coverage>, trial: &TrialStatus) -> Self {
        let gages = solution.bias_counts.len();
        Self {
            rank: solution.rank,
            gages,
            samples: SampleCounts::on_the_sensor(trial, solution),
            eigenvalues: &solution.eigenvalues,
            noise_counts: solution.noise_counts,
            bias_counts: &solution.bias_counts,
            shape_counts_per_load: solution.shape_counts_per_load.chunks(gages.max(1)).collect(),
            uncertainty: covered.map(solve::Uncertainty::from),
            coverage: covered.map(|covered| (&TrialCoverage::from(covered)).into()),
        }
    }
}
