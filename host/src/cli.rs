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

#[cfg(unix)]
use crate::commands::sim;
use crate::commands::{
    Failure, Streams, apply, calibrate, demo, eval, flash, health, info, limits, logs, name, ports,
    print_refusal, record, rollback, selftest, settings, solve, stream, tare, trial, upload, verify,
};

/// Input that cannot be used.
const UNUSABLE: u8 = 2;

/// An answer that is not given.
const REFUSED: u8 = 3;

/// Calibrates force/torque sensors by shape from motion
#[derive(Parser, Clone, Debug)]
#[command(name = "ftcal", version)]
#[command(after_help = "Without a command, the demonstration runs: `ftcal demo`.")]
pub struct Cli {
    /// What to do
    #[command(subcommand)]
    command: Option<Command>,
}

/// The subcommands.
#[derive(Subcommand, Clone, Debug)]
pub enum Command {
    /// Run the demonstration.
    Demo(demo::Arguments),
    /// Solve one trial.
    Solve(solve::Arguments),
    /// Calibrate from a session.
    Calibrate(calibrate::Arguments),
    /// Apply a calibration.
    Apply(apply::Arguments),
    /// Evaluate a calibration.
    Eval(eval::Arguments),
    /// Check a calibration in the field.
    Verify(verify::Arguments),
    /// List the serial ports.
    Ports(ports::Arguments),
    /// Tell who the sensor is and how it is.
    Info(info::Arguments),
    /// Tell how gages and load are, and measure without a gage that is not well.
    Health(health::Arguments),
    /// Set and tell what load is too much, and which loads to tell of.
    Limits(limits::Arguments),
    /// Set, clear and tell what is subtracted from every wrench.
    Tare(tare::Arguments),
    /// Have the sensor play every fault on itself, and tell what it found.
    Selftest(selftest::Arguments),
    /// Record the raw codes of every gage.
    Record(record::Arguments),
    /// Run a trial on the sensor itself.
    Trial(trial::Arguments),
    /// Upload a calibration to the sensor and read it back.
    Upload(upload::Arguments),
    /// Have the sensor use the calibration before the one that it keeps.
    Rollback(rollback::Arguments),
    /// Set the sensor's converter, for now or for good.
    Settings(settings::Arguments),
    /// Give the sensor a name, which it keeps.
    Name(name::Arguments),
    /// Stream forces and torques as the sensor measures them.
    Stream(stream::Arguments),
    /// Serve a simulated sensor on a pseudo-terminal.
    ///
    /// Prints the port's path on standard output, for the --port of the other commands. Type `help` while it runs to
    /// see what can be done at the bench: hang another load, hold still, break a gage.
    #[cfg(unix)]
    Sim(sim::Arguments),
    /// Write the firmware to the sensor through a debug probe.
    Flash(flash::Arguments),
    /// Put the sensor's log into words.
    Logs(logs::Arguments),
}

impl Command {
    /// Does what the command says.
    fn run(&self, streams: &mut Streams) -> Result<(), Failure> {
        match self {
            Self::Demo(arguments) => demo::run(arguments, streams),
            Self::Solve(arguments) => solve::run(arguments, streams),
            Self::Calibrate(arguments) => calibrate::run(arguments, streams),
            Self::Apply(arguments) => apply::run(arguments, streams),
            Self::Eval(arguments) => eval::run(arguments, streams),
            Self::Verify(arguments) => verify::run(arguments, streams),
            Self::Ports(arguments) => ports::run(arguments, streams),
            Self::Info(arguments) => info::run(arguments, streams),
            Self::Health(arguments) => health::run(arguments, streams),
            Self::Limits(arguments) => limits::run(arguments, streams),
            Self::Tare(arguments) => tare::run(arguments, streams),
            Self::Selftest(arguments) => selftest::run(arguments, streams),
            Self::Record(arguments) => record::run(arguments, streams),
            Self::Trial(arguments) => trial::run(arguments, streams),
            Self::Upload(arguments) => upload::run(arguments, streams),
            Self::Rollback(arguments) => rollback::run(arguments, streams),
            Self::Settings(arguments) => settings::run(arguments, streams),
            Self::Name(arguments) => name::run(arguments, streams),
            Self::Stream(arguments) => stream::run(arguments, streams),
            #[cfg(unix)]
            Self::Sim(arguments) => sim::run(arguments, streams),
            Self::Flash(arguments) => flash::run(arguments, streams),
            Self::Logs(arguments) => logs::run(arguments, streams),
        }
    }

    /// Whether a refusal is to be printed as JSON.
    const fn json(&self) -> bool {
        match self {
            Self::Solve(solve::Arguments { json, .. })
            | Self::Calibrate(calibrate::Arguments { json, .. })
            | Self::Eval(eval::Arguments { json, .. })
            | Self::Verify(verify::Arguments { json, .. })
            | Self::Health(health::Arguments { json, .. })
            | Self::Info(info::Arguments { json, .. }) => *json,
            Self::Trial(arguments) => arguments.json(),
            _ => false,
        }
    }
}

/// Runs a command and turns its outcome into words and an exit code.
pub fn run(cli: &Cli, streams: &mut Streams) -> ExitCode {
    let demonstration = Command::Demo(demo::Arguments::default());
    let command = cli.command.as_ref().unwrap_or(&demonstration);
    let outcome = command.run(streams).and_then(|()| Ok(streams.data.flush()?));
    // Where words cannot be written either, the exit code is all that is left to say.
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        // Whoever read the data has read enough.
        Err(Failure::Output(error)) if error.kind() == io::ErrorKind::BrokenPipe => ExitCode::SUCCESS,
        Err(Failure::Refused(refusal)) if command.json() => {
            let _ = print_refusal(&refusal, streams.data).and_then(|()| streams.data.flush());
            ExitCode::from(REFUSED)
        }
        Err(failure) => {
            let _ = writeln!(streams.words, "ftcal: {failure}");
            ExitCode::from(if matches!(failure, Failure::Refused(_)) { REFUSED } else { UNUSABLE })
        }
    }
}
