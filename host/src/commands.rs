//! The subcommands, one file each: arguments, and a `run` that prints data and words to the two streams it is given.
//!
//! Data goes to the first stream and words to the second, so that every command can be tested without a process, and
//! its output piped.

pub mod apply;
pub mod calibrate;
pub mod capture;
pub mod demo;
pub mod device;
pub mod eval;
pub mod flash;
pub mod health;
pub mod info;
pub mod limits;
pub mod logs;
pub mod name;
pub mod output;
pub mod ports;
pub mod record;
pub mod rollback;
pub mod selftest;
pub mod settings;
#[cfg(unix)]
pub mod sim;
pub mod solve;
pub mod stream;
pub mod tare;
pub mod trial;
pub mod upload;
pub mod verify;

#[cfg(all(unix, test))]
mod device_tests;
#[cfg(test)]
mod gain_tests;
#[cfg(all(unix, test))]
mod health_tests;
#[cfg(test)]
mod offline_tests;

use std::io::{self, Write};

use serde::Serialize;

use crate::remedy::Explained;

/// Where a command prints to.
pub struct Streams<'a> {
    /// Data: standard output.
    pub data: &'a mut dyn Write,
    /// Words: standard error.
    pub words: &'a mut dyn Write,
}

/// Why a command did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Its input cannot be used: exit code 2.
    #[error("{0:#}")]
    Input(anyhow::Error),
    /// It refuses to give an answer: exit code 3.
    #[error("refused ({}): {}\n{}", .0.cause, .0.detail, .0.remedy)]
    Refused(Explained),
    /// Its output goes nowhere.
    #[error("the output cannot be written: {0}")]
    Output(#[from] io::Error),
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self::Input(error)
    }
}

impl Failure {
    /// An error of the input.
    pub fn input(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Input(error.into())
    }
}

/// Prints one JSON value and a new line.
///
/// # Errors
///
/// Those of the destination.
pub fn print_json(value: &impl Serialize, out: &mut dyn Write) -> io::Result<()> {
    serde_json::to_writer(&mut *out, value).map_err(io::Error::from)?;
    writeln!(out)
}

/// What a refusal prints as JSON.
#[derive(Serialize)]
struct RefusedReport<'a> {
    refused: &'a Explained,
}

/// Prints {"refused": {"cause", "detail", "remedy"}}.
///
/// # Errors
///
/// Those of the destination.
pub fn print_refusal(refusal: &Explained, out: &mut dyn Write) -> io::Result<()> {
    print_json(&RefusedReport { refused: refusal }, out)
}
