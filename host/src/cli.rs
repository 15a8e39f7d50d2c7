//! The command line: which subcommands there are, and what becomes of their outcome.
//!
//! | exit code | meaning |
//! |---|---|
//! | 0 | done |
//! | 2 | wrong usage, or input that cannot be read; says where and what was expected |
//! | 3 | refused: the data do not determine the answer; says the cause and the remedy |
//!
//! A new subcommand is a file in [`crate::commands`], a variant of [`Command`] and a line in each of its two functions.

use std::io;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::commands::{Failure, Streams, apply, calibrate, eval, print_refusal, solve};

/// Input that cannot be used.
const UNUSABLE: u8 = 2;

/// An answer that is not given.
const REFUSED: u8 = 3;

/// Calibrates force/torque sensors by shape from motion
#[derive(Parser, Clone, Debug)]
#[command(name = "ftcal", version)]
pub struct Cli {
    /// What to do
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Subcommand, Clone, Debug)]
pub enum Command {
    /// Solve one trial.
    Solve(solve::Arguments),
    /// Calibrate from a session.
    Calibrate(calibrate::Arguments),
    /// Apply a calibration.
    Apply(apply::Arguments),
    /// Evaluate a calibration.
    Eval(eval::Arguments),
}

impl Command {
    /// Does what the command says.
    fn run(&self, streams: &mut Streams) -> Result<(), Failure> {
        match self {
            Self::Solve(arguments) => solve::run(arguments, streams),
            Self::Calibrate(arguments) => calibrate::run(arguments, streams),
            Self::Apply(arguments) => apply::run(arguments, streams),
            Self::Eval(arguments) => eval::run(arguments, streams),
        }
    }

    /// Whether a refusal is to be printed as JSON.
    const fn json(&self) -> bool {
        match self {
            Self::Solve(solve::Arguments { json, .. })
            | Self::Calibrate(calibrate::Arguments { json, .. })
            | Self::Eval(eval::Arguments { json, .. }) => *json,
            Self::Apply(_) => false,
        }
    }
}

/// Runs a command and turns its outcome into words and an exit code.
pub fn run(cli: &Cli, streams: &mut Streams) -> ExitCode {
    let outcome = cli.command.run(streams).and_then(|()| Ok(streams.data.flush()?));
    // Where words cannot be written either, the exit code is all that is left to say.
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        // Whoever read the data has read enough.
        Err(Failure::Output(error)) if error.kind() == io::ErrorKind::BrokenPipe => ExitCode::SUCCESS,
        Err(Failure::Refused(refusal)) if cli.command.json() => {
            let _ = print_refusal(&refusal, streams.data).and_then(|()| streams.data.flush());
            ExitCode::from(REFUSED)
        }
        Err(failure) => {
            let _ = writeln!(streams.words, "ftcal: {failure}");
            ExitCode::from(if matches!(failure, Failure::Refused(_)) { REFUSED } else { UNUSABLE })
        }
    }
}
