//! `ftcal record`: raw codes from the sensor to a recording.

use std::io::{IsTerminal, Write, stderr};
use std::path::PathBuf;

use clap::Args;
use ftcal_shared::units::{AdcCode, DataRate, Gain};
use ftcal_shared::wire::{Status, StreamKind};

use super::capture::{Amount, Place, capture};
use super::device::DeviceArgs;
use super::output::Output;
use super::{Failure, Streams};
use crate::gain;
use crate::link::client::Client;
use crate::link::frame::Frame;
use crate::link::transport::Transport;
use crate::recording::writer::RecordingWriter;

/// Seconds of the recording between two reports of progress.
const PROGRESS_S: f64 = 0.5;

/// The arguments of `ftcal record`.
#[derive(Args, Clone, Debug)]
#[command(group = clap::ArgGroup::new("amount").required(true).args(["seconds", "samples"]))]
pub struct Arguments {
    #[command(flatten)]
    device: DeviceArgs,
    #[command(flatten)]
    amount: Amount,
    /// Set the data rate first, samples per second: 250, 500, 1000, 2000, 4000, 8000, 16000 or 32000
    #[arg(long, value_name = "HZ", value_parser = data_rate)]
    rate: Option<DataRate>,
    /// Set the gain first: 1, 2, 4, 8, 16, 32, 64 or 128
    #[arg(long, value_parser = gain)]
    gain: Option<Gain>,
    /// Where to write the recording (CSV), completely or not at all; standard output if absent
    #[arg(short, long)]
    output: Option<PathBuf>,
}

/// Reads a data rate off the command line.
///
/// # Errors
///
/// What is expected, where the converter has no such rate.
pub fn data_rate(text: &str) -> Result<DataRate, String> {
    let rate = text.parse().ok().and_then(DataRate::from_hertz);
    rate.ok_or_else(|| {
        format!("expected one of {}", DataRate::ALL.map(|rate| rate.hertz().to_string()).join(", "))
    })
}

/// Reads a gain.
///
/// # Errors
///
/// What is expected, where the converter has no such gain.
pub fn gain(text: &str) -> Result<Gain, String> {
    gain::of_text(text).ok_or_else(|| format!("expected {}", gain::possible()))
}

/// Records.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let output = Output::open(arguments.output.as_deref(), streams.data)?;
    let mut client = arguments.device.connect()?;
    let status = match (arguments.rate, arguments.gain) {
        (None, None) => client.wait_for_converter()?,
        (rate, gain) => {
            let before = client.status()?;
            client.configure_adc(rate.unwrap_or(before.data_rate), gain.unwrap_or(before.gain))?
        }
    };
    let progress = stderr().is_terminal();
    record(&mut client, &status, arguments.amount, output, streams.words, progress)
}

/// Records from a sensor whose converter runs.
fn record<Line: Transport>(
    client: &mut Client<Line>,
    status: &Status,
    amount: Amount,
    output: Output,
    words: &mut dyn Write,
    progress: bool,
) -> Result<(), Failure> {
    let mut writer = RecordingWriter::new(output, usize::from(status.gages), Some(status.gain))?;
    writer.comment(&format!("{} samples/s", status.data_rate.hertz()))?;
    let mut saturated = 0_u64;
    let mut last_s = 0.0;
    let mut next_report_s = 0.0;
    let tally = capture(client, StreamKind::Codes, amount, |Place { time_s, .. }, frame| {
        let Frame::Codes(frame) = frame else { return Ok(()) };
        writer.sample(time_s, &frame.codes)?;
        saturated += u64::from(AdcCode::any_is_saturated(&frame.codes));
        last_s = time_s;
        if progress && time_s >= next_report_s {
            write!(words, "\r{time_s:.1} s")?;
            words.flush()?;
            next_report_s = time_s + PROGRESS_S;
        }
        Ok(())
    })?;
    writer.finish()?.finish()?;
    let start = if progress { "\r" } else { "" };
    writeln!(
        words,
        "{start}{} samples in {last_s:.3} s, {}, {}",
        tally.samples,
        tally.gaps_in_words(),
        match saturated {
            0 => "none saturated".to_owned(),
            _ => format!("{saturated} saturated (useless for calibration: use a smaller mass or gain)"),
        }
    )?;
    if client.broken_frames() > 0 {
        writeln!(words, "{} frames came broken: check the cable", client.broken_frames())?;
    }
    if client.dropped_samples() > 0 {
        writeln!(words, "{} samples were dropped: this machine was too slow", client.dropped_samples())?;
    }
    let dropped = client.status()?.dropped_samples.wrapping_sub(status.dropped_samples);
    if dropped > 0 {
        writeln!(words, "{dropped} samples did not fit on the line: use a lower data rate")?;
    }
    Ok(())
}
