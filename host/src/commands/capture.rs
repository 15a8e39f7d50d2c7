//! Taking samples from a sensor until there are enough: what `record` and `stream` have in common.

use std::time::Duration;

use anyhow::anyhow;
use clap::Args;
use ftcal_shared::units::{DeviceTime, SampleIndex};
use ftcal_shared::wire::StreamKind;

use super::Failure;
use crate::link::client::Client;
use crate::link::continuity::Continuity;
use crate::link::frame::Frame;
use crate::link::transport::Transport;

/// Silence of a stream after which something must be wrong: many periods of the slowest rate.
const SILENCE: Duration = Duration::from_secs(2);

/// How much to take.
#[derive(Args, Clone, Copy, Debug)]
pub struct Amount {
    /// Stop after this long, by the sensor's clock
    #[arg(long, value_name = "S", value_parser = positive_seconds, conflicts_with = "samples")]
    pub seconds: Option<f64>,
    /// Stop after this many samples
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub samples: Option<u64>,
}

fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("expected a positive number of seconds".to_owned()),
    }
}

/// Where a sample stands in the stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Number of the conversion that completed it.
    pub index: SampleIndex,
    /// Time since the first sample, seconds.
    pub time_s: f64,
    /// What the clock of the line says when the sample is looked at.
    pub now: Duration,
}

/// What came.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Samples taken.
    pub samples: u64,
    /// Stretches of samples that are missing between others.
    pub gaps: u64,
    /// Samples that are missing in them.
    pub missing: u64,
}

/// Streams from the sensor and gives each frame to `take` until the amount is reached, then ends the stream.
///
/// # Errors
///
/// [`Failure`] of the sensor or of `take`; the stream is ended then, too, as far as the line allows.
pub fn capture<Line: Transport>(
    client: &mut Client<Line>,
    kind: StreamKind,
    amount: Amount,
    mut take: impl FnMut(Place, &Frame) -> Result<(), Failure>,
) -> Result<Tally, Failure> {
    client.stream(kind)?;
    let outcome = take_all(client, amount, &mut take);
    // The first failure is the one to report.
    let ended = client.stream(StreamKind::Off);
    let tally = outcome?;
    ended?;
    Ok(tally)
}

fn take_all<Line: Transport>(
    client: &mut Client<Line>,
    amount: Amount,
    take: &mut impl FnMut(Place, &Frame) -> Result<(), Failure>,
) -> Result<Tally, Failure> {
    let mut tally = Tally::default();
    let mut first: Option<DeviceTime> = None;
    let mut continuity = Continuity::default();
    while amount.samples.is_none_or(|enough| tally.samples < enough) {
        let Some(frame) = client.next_frame(SILENCE)? else { return Err(why_silent(client)) };
        let ((index, stride), time) = (frame.place(), frame.time());
        let begin = *first.get_or_insert(time);
        let micros = time.as_micros().saturating_sub(begin.as_micros());
        // The division keeps times as short as they are: 0.003 and not 0.0029999999999999996.
        let time_s = micros as f64 / 1e6;
        if amount.seconds.is_some_and(|enough| time_s >= enough) {
            break;
        }
        let missing = continuity.missing_before(index, stride);
        tally.gaps += u64::from(missing > 0);
        tally.missing += u64::from(missing);
        take(Place { index, time_s, now: client.line().elapsed() }, &frame)?;
        tally.samples += 1;
    }
    Ok(tally)
}

/// Why no sample came: most likely a fault of the converter, which the sensor names.
fn why_silent<Line: Transport>(client: &mut Client<Line>) -> Failure {
    match client.wait_for_converter() {
        Err(error) => error.into(),
        Ok(status) if status.stream == StreamKind::Off => anyhow!(
            "the sensor has ended the stream, because it has heard nothing from this program for seconds\n\
             Have the output read faster, or written to a file."
        )
        .into(),
        Ok(_) => anyhow!(
            "the sensor answers, but no sample came for {} s\nTry again; lower the data rate if it happens again.",
            SILENCE.as_secs()
        )
        .into(),
    }
}

impl Tally {
    /// What is missing, in words.
    pub fn gaps_in_words(&self) -> String {
        match self.gaps {
            0 => "no gap".to_owned(),
            1 => format!("1 gap ({} samples missing)", self.missing),
            gaps => format!("{gaps} gaps ({} samples missing)", self.missing),
        }
    }
}
