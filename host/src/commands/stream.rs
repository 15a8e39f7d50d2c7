//! `ftcal stream`: wrenches from the sensor, as they come.

mod notices;

use std::io::Write;
use std::time::Duration;

use anyhow::anyhow;
use clap::Args;
use ftcal_shared::units::{DataRate, Decimation, Dof};
use ftcal_shared::wire::{Output as SensorOutput, StreamKind};

use super::apply::column_name;
use super::capture::{Amount, capture};
use super::device::DeviceArgs;
use super::health::names;
use super::record::data_rate;
use super::{Failure, Streams};
use crate::link::client::{Client, filter_delay};
use crate::link::frame::{Frame, Measured, WrenchSample};
use crate::link::transport::Transport;
use crate::remedy::Explained;
use notices::Notices;

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
    /// Samples per second: the converter's rate divided by 2, 4, 8 … 128, with what would alias filtered out; every conversion where
    /// nothing is said
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
    let output = set_output_rate(&mut client, arguments.output_rate)?;
    tell_rate(output, streams.words)?;
    let oldest = match arguments.max_age_ms.map(Duration::from_millis) {
        Some(oldest) if oldest <= filter_delay(output) => {
            return Err(anyhow!(
                "no wrench is younger than --max-age-ms, because the filter alone takes longer\n\
                 Allow more, or use a higher --output-rate."
            )
            .into());
        }
        oldest => oldest.unwrap_or(Duration::MAX),
    };
    stream(&mut client, arguments.amount, oldest, streams)
}

/// Has the sensor stream at this rate, or every conversion: what the one before has asked for holds no longer.
fn set_output_rate<Line: Transport>(
    client: &mut Client<Line>,
    hertz: Option<u32>,
) -> Result<SensorOutput, Failure> {
    let Some(hertz) = hertz else { return Ok(client.set_output(Decimation::By1)?) };
    let converted = client.output()?.data_rate.hertz();
    let factor = converted.checked_div(hertz).filter(|factor| factor * hertz == converted);
    let Some(decimation) = factor.and_then(Decimation::from_factor) else {
        return Err(anyhow!(
            "{hertz} samples/s cannot be made of the converter's {converted}/s\n\
             Divide it by 1, 2, 4, 8, 16, 32, 64 or 128, or set another --rate."
        )
        .into());
    };
    Ok(client.set_output(decimation)?)
}

/// Says at which rate wrenches come, and how late.
fn tell_rate(output: SensorOutput, words: &mut dyn Write) -> std::io::Result<()> {
    let converted = output.data_rate.hertz();
    if output.decimation == Decimation::By1 {
        return writeln!(words, "{converted} samples/s: every conversion, which no filter delays");
    }
    let hertz = converted / u32::from(output.decimation.factor());
    let delay_ms = 1e3 * filter_delay(output).as_secs_f64();
    writeln!(
        words,
        "{hertz} samples/s of {converted} conversions/s; each sample bears the time that it is of, and comes {delay_ms} ms later"
    )
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
    let mut notices = Notices::default();
    let tally = capture(client, StreamKind::Wrench, amount, |place, frame| {
        let Frame::Wrench(sample) = frame else { return Ok(()) };
        let measured = sample.within(oldest, place.now);
        write_sample(dof, place.time_s, sample, &measured, streams.data)?;
        // A reader at the other end of a pipe wants to see them now.
        streams.data.flush()?;
        Ok(notices.tell(place.time_s, sample, &measured, streams.words)?)
    })?;
    writeln!(
        streams.words,
        "{} samples, {} of them no wrench, {}",
        tally.samples,
        notices.invalid_samples(),
        tally.gaps_in_words()
    )?;
    Ok(())
}

fn write_header(dof: Dof, out: &mut dyn Write) -> std::io::Result<()> {
    let names: Vec<&str> = dof.axes().iter().map(|&axis| column_name(axis)).collect();
    writeln!(out, "t_s,{},parity_chi2,status", names.join(","))
}

/// One line; the fields of the components are empty where there is no wrench.
fn write_sample(
    dof: Dof,
    time_s: f64,
    sample: &WrenchSample,
    measured: &Measured,
    out: &mut dyn Write,
) -> std::io::Result<()> {
    write!(out, "{time_s}")?;
    match measured {
        Measured::Valid(wrench) => {
            for component in wrench.components() {
                write!(out, ",{component}")?;
            }
        }
        Measured::Invalid(_) => write!(out, "{}", ",".repeat(dof.count()))?,
    }
    match sample.parity {
        Some(parity) => write!(out, ",{parity}")?,
        None => write!(out, ",")?,
    }
    writeln!(out, ",{}", names(sample.status).join("+"))
}
