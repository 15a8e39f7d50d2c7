//! `ftcal tare`: what is subtracted from every wrench.

use std::io::{self, Write};

use clap::{Args, Subcommand};
use ftcal_shared::units::Dof;
use ftcal_shared::wire::{TarePhase, TareReport};

use super::device::DeviceArgs;
use super::{Failure, Streams};
use crate::component::{symbol, unit};
use crate::link::health_words;
use crate::remedy::Explained;

/// The arguments of `ftcal tare`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    action: TareAction,
}

/// What to do with the tare.
#[derive(Clone, Debug, Subcommand)]
enum TareAction {
    /// Subtract from now on what the sensor measures now; hold it still
    Set {
        #[command(flatten)]
        device: DeviceArgs,
        /// Samples to average
        #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u16).range(1..))]
        samples: u16,
        /// Keep it when the sensor is switched off
        #[arg(long)]
        store: bool,
    },
    /// Subtract nothing any more
    Clear {
        #[command(flatten)]
        device: DeviceArgs,
        /// Not after the sensor was switched off, either
        #[arg(long)]
        store: bool,
    },
    /// Tell what is subtracted
    Show {
        #[command(flatten)]
        device: DeviceArgs,
    },
}

/// Does what is asked with the tare, and prints what is subtracted.
///
/// # Errors
///
/// [`Failure`]; a tare that is not taken is [`Failure::Refused`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let (mut client, report) = match &arguments.action {
        TareAction::Set { device, samples, store } => {
            let mut client = device.connect()?;
            let report = client.set_tare(*samples, *store)?;
            if *store && report.phase == TarePhase::Settled {
                client.store_settings()?;
            }
            (client, report)
        }
        TareAction::Clear { device, store } => {
            let mut client = device.connect()?;
            let report = client.clear_tare(*store)?;
            if *store {
                client.store_settings()?;
            }
            (client, report)
        }
        TareAction::Show { device } => {
            let mut client = device.connect()?;
            let report = client.tare()?;
            (client, report)
        }
    };
    let dof = client.read_calibration()?.map(|calibration| calibration.dof);
    write_tare(&report, dof, streams.data)?;
    match (&arguments.action, report.phase) {
        (TareAction::Set { .. }, TarePhase::Refused(refusal)) => {
            let (cause, detail, remedy) = health_words::tare_refusal(refusal);
            let detail = format!("the tare stays as it was: {detail}");
            Err(Failure::Refused(Explained { cause, detail, remedy }))
        }
        _ => Ok(()),
    }
}

fn write_tare(report: &TareReport, dof: Option<Dof>, out: &mut dyn Write) -> io::Result<()> {
    match (&report.wrench, dof) {
        (Some(wrench), Some(dof)) => {
            for (&axis, component) in dof.axes().iter().zip(wrench) {
                writeln!(out, "{} {component} {}", symbol(axis), unit(axis))?;
            }
            Ok(())
        }
        _ => writeln!(out, "none"),
    }
}
