//! `ftcal stream`: wrenches from the sensor, as they come.

use std::io::Write;
use std::time::Duration;

use anyhow::anyhow;
use clap::Args;
use ftcal_shared::units::{DataRate, Decimation, Dof};
use ftcal_shared::wire::StreamKind;

use super::apply::column_name;
use super::capture::{Amount, Place, capture};
use super::device::DeviceArgs;
use super::record::data_rate;
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
    /// Set the converter's rate first, conversions per second: 250, 500, 1000, 2000, 4000, 8000, 16000 or 32000
    #[arg(long, value_name = "HZ", value_parser = data_rate)]
    rate: Option<DataRate>,
    /// Set the rate of the stream first, samples per second: the converter's rate, or it divided by 2, 4, 8 … 128, with what
    /// would alias filtered out
    #[arg(long, value_name = "HZ")]
    output_rate: Option<u32>,
    /// Print no wrench that is older than this when it is printed, milliseconds: since it was taken, with what the filter of
    /// --output-rate delays it, what it waits for in the sensor and in this machine; the line's own delay is not in it
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
    if let Some(rate) = arguments.rate {
        let gain = client.status()?.gain;
        client.configure_adc(rate, gain)?;
    }
    if let Some(hertz) = arguments.output_rate {
        set_output_rate(&mut client, hertz, streams.words)?;
    }
    let oldest = arguments.max_age_ms.map_or(Duration::MAX, Duration::from_millis);
    stream(&mut client, arguments.amount, oldest, streams)
}

/// Has the sensor stream at this rate, and says what that means.
fn set_output_rate<Line: Transport>(
    client: &mut Client<Line>,
    hertz: u32,
    words: &mut dyn Write,
) -> Result<(), Failure> {
    let converted = client.output()?.data_rate.hertz();
    let factor = converted.checked_div(hertz).filter(|factor| factor * hertz == converted);
    let Some(decimation) = factor.and_then(Decimation::from_factor) else {
        return Err(anyhow!(
            "{hertz} samples/s cannot be made of the converter's {converted}/s\n\
             Divide it by 1, 2, 4, 8, 16, 32, 64 or 128, or set another --rate."
        )
        .into());
    };
    let output = client.set_output(decimation)?;
    let delay_ms = 1e3 * f64::from(output.group_delay_conversions) / f64::from(converted);
    writeln!(
        words,
        "{hertz} samples/s of {converted} conversions/s; each sample bears the time that it is of, and comes {delay_ms} ms later"
    )?;
    Ok(())
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
