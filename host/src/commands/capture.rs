//! Taking samples from a sensor until there are enough: what `record` and `stream` have in common.

use std::time::Duration;

use clap::Args;
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::{Status, StreamKind};

use super::Failure;
use crate::link::client::Client;
use crate::link::error::ClientError;
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
/// Moments at which there is no conversion are given, too, and are no samples. Whoever waits for a number of samples waits no longer
/// than two seconds for the next.
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
    let before = client.status()?;
    client.stream(kind)?;
    let outcome = take_all(client, &before, amount, &mut take);
    // The first failure is the one to report.
    let ended = client.stream(StreamKind::Off);
    let tally = outcome?;
    ended?;
    Ok(tally)
}

fn take_all<Line: Transport>(
    client: &mut Client<Line>,
    before: &Status,
    amount: Amount,
    take: &mut impl FnMut(Place, &Frame) -> Result<(), Failure>,
) -> Result<Tally, Failure> {
    let mut tally = Tally::default();
    let mut first: Option<DeviceTime> = None;
    let mut latest = before.uptime;
    let mut last_sample = DeviceTime::default();
    while amount.samples.is_none_or(|enough| tally.samples < enough) {
        let Some(frame) = client.next_frame(SILENCE)? else {
            return Err(why_silent(client, before, latest)?.into());
        };
        let ((_, stride), time) = (frame.place(), frame.time());
        latest = latest.max(time);
        let begin = *first.get_or_insert(time);
        let micros = time.as_micros().saturating_sub(begin.as_micros());
        // The division keeps times as short as they are: 0.003 and not 0.0029999999999999996.
        let time_s = micros as f64 / 1e6;
        if amount.seconds.is_some_and(|enough| time_s >= enough) {
            break;
        }
        let missing_before = tally.missing;
        tally.missing = client.lost_samples();
        tally.gaps += u64::from(tally.missing > missing_before);
        take(Place { time_s, now: client.line().elapsed() }, &frame)?;
        if stride > 0 {
            tally.samples += 1;
            last_sample = time;
        } else if amount.samples.is_some() && is_over(last_sample.max(begin), time) {
            return Err(why_silent(client, before, latest)?.into());
        }
    }
    Ok(tally)
}

/// Whether there has been silence for too long.
fn is_over(begin: DeviceTime, now: DeviceTime) -> bool {
    Duration::from_micros(now.as_micros().saturating_sub(begin.as_micros())) >= SILENCE
}

/// Why no sample came, where the sensor said this before the stream, and its clock was so far since: most likely a fault of the
/// converter, which the sensor names.
///
/// # Errors
///
/// [`ClientError`] where it does not answer any more.
fn why_silent<Line: Transport>(
    client: &mut Client<Line>,
    before: &Status,
    latest: DeviceTime,
) -> Result<ClientError, ClientError> {
    let status = client.status()?;
    let has_ended = status.stream == StreamKind::Off;
    if has_ended && status.uptime >= latest && status.abandoned_streams != before.abandoned_streams {
        return Ok(ClientError::StreamAbandoned);
    }
    if has_ended {
        // Nobody else ends it but a reset.
        return Ok(ClientError::Restarted(client.diagnosis()?));
    }
    client.wait_for_converter()?;
    Ok(ClientError::NoSamples { seconds: SILENCE.as_secs() })
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use ftcal_shared::wire::StreamKind;

    use super::{Amount, capture};
    use crate::commands::Failure;
    use crate::link::client::Client;
    use crate::link::transport::{Transport, TransportError};
    use crate::simulator::board::SimulatedBoard;
    use crate::simulator::scenario::{Scenario, ScenarioKind};

    fn board() -> SimulatedBoard {
        let scenario = Scenario::new(ScenarioKind::Fingertip, 1).expect("sizes fit");
        SimulatedBoard::for_scenario(&scenario, 1).expect("sizes fit")
    }

    /// A board that is switched off and on again at some time.
    struct Restarting {
        board: SimulatedBoard,
        /// The line's time at which the board was switched on.
        on_since: Duration,
        restart_at: Duration,
    }

    impl Transport for Restarting {
        fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
            self.board.write(bytes)
        }

        fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<Duration, TransportError> {
            if self.on_since.is_zero() && self.elapsed() >= self.restart_at {
                self.on_since = self.elapsed();
                self.board = board();
            }
            self.board.read(received, deadline.saturating_sub(self.on_since))?;
            Ok(self.elapsed())
        }

        fn elapsed(&self) -> Duration {
            self.on_since + self.board.elapsed()
        }

        fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
            self.board.set_baud(baud)
        }
    }

    #[test]
    fn a_sensor_that_restarts_is_not_one_that_has_ended_the_stream() {
        for seconds in [1, 10] {
            let restart_at = Duration::from_secs(seconds);
            let line = Restarting { board: board(), on_since: Duration::ZERO, restart_at };
            let mut client = Client::connect(line).expect("answers");
            let amount = Amount { seconds: None, samples: Some(1_000_000) };
            let outcome = capture(&mut client, StreamKind::Codes, amount, |_, _| Ok(()));
            let Err(Failure::Refused(explained)) = outcome else { panic!("{outcome:?}") };
            assert_eq!(explained.cause, "sensor-restarted");
        }
    }
}
