//! `ftcal stream`: wrenches from the sensor, as they come.

use std::io::Write;
use std::time::Duration;

use clap::Args;
use ftcal_shared::units::Dof;
use ftcal_shared::wire::StreamKind;

use super::apply::column_name;
use super::capture::{Amount, Place, capture};
use super::device::DeviceArgs;
use super::{Failure, Streams};
use crate::link::client::Client;
use crate::link::frame::{Frame, Measured, NoWrench};
use crate::link::transport::Transport;
use crate::link::words;
use crate::remedy::Explained;

/// The arguments of `ftcal stream`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    #[command(flatten)]
    device: DeviceArgs,
    #[command(flatten)]
    amount: Amount,
    /// Print no wrench that is older than this when it is printed, milliseconds, by the clock of this machine; the line's own
    /// delay is not in it
    #[arg(long, value_name = "MS")]
    max_age_ms: Option<u64>,
}

/// Streams until the amount is reached, or for ever.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let mut client = arguments.device.connect()?;
    let oldest = arguments.max_age_ms.map_or(Duration::MAX, Duration::from_millis);
    stream(&mut client, arguments.amount, oldest, streams)
}

/// Streams from a sensor.
fn stream<Line: Transport>(
    client: &mut Client<Line>,
    amount: Amount,
    oldest: Duration,
    streams: &mut Streams,
) -> Result<(), Failure> {
    let Some(calibration) = client.read_calibration()? else {
        return Err(Failure::Refused(Explained {
            cause: "uncalibrated",
            detail: "the sensor has no calibration, so its codes are no forces".to_owned(),
            remedy: "Upload one with `ftcal upload`, or record the raw codes with `ftcal record`.",
        }));
    };
    let dof = calibration.dof;
    write_header(dof, streams.data)?;
    let mut state = State::default();
    let tally = capture(client, StreamKind::Wrench, amount, |place, frame| {
        let Frame::Wrench(sample) = frame else { return Ok(()) };
        let measured = sample.within(oldest, place.now);
        write_sample(dof, place, &measured, streams.data)?;
        // A reader at the other end of a pipe wants to see them now.
        streams.data.flush()?;
        Ok(state.tell(place, &measured, streams.words)?)
    })?;
    writeln!(
        streams.words,
        "{} samples, {} of them no wrench, {}",
        tally.samples,
        state.invalid,
        tally.gaps_in_words()
    )?;
    Ok(())
}

fn write_header(dof: Dof, out: &mut dyn Write) -> std::io::Result<()> {
    let names: Vec<&str> = dof.axes().iter().map(|&axis| column_name(axis)).collect();
    writeln!(out, "t_s,{}", names.join(","))
}

/// One line; its fields are empty where there is no wrench.
fn write_sample(dof: Dof, place: Place, measured: &Measured, out: &mut dyn Write) -> std::io::Result<()> {
    write!(out, "{}", place.time_s)?;
    match measured {
        Measured::Valid(wrench) => {
            for component in wrench.components() {
                write!(out, ",{component}")?;
            }
        }
        Measured::Invalid(_) => write!(out, "{}", ",".repeat(dof.count()))?,
    }
    writeln!(out)
}

/// What was told last, so that a lasting trouble is told once.
#[derive(Default)]
struct State {
    trouble: Option<NoWrench>,
    invalid: u64,
}

impl State {
    fn tell(&mut self, place: Place, measured: &Measured, words: &mut dyn Write) -> std::io::Result<()> {
        let trouble = match measured {
            Measured::Valid(_) => None,
            Measured::Invalid(cause) => {
                self.invalid += 1;
                Some(*cause)
            }
        };
        if trouble != self.trouble {
            match trouble {
                Some(cause) => writeln!(words, "{} s: no wrench: {}", place.time_s, words::no_wrench(cause))?,
                None => writeln!(words, "{} s: wrenches again", place.time_s)?,
            }
        }
        self.trouble = trouble;
        Ok(())
    }
}
