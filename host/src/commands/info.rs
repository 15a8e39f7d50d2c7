//! `ftcal info`: who the sensor is and how it is.

use std::io::{self, Write};

use clap::Args;
use ftcal_shared::wire::{AdcState, HealthReport, Hello, Status};
use serde::Serialize;

use super::device::DeviceArgs;
use super::health::{names, write_status};
use super::{Failure, Streams, print_json};
use crate::link::words;

/// The arguments of `ftcal info`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    #[command(flatten)]
    device: DeviceArgs,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Asks the sensor and prints what it says.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let mut client = arguments.device.connect()?;
    let hello = client.hello()?;
    let status = client.status()?;
    let health = client.health()?;
    if arguments.json {
        print_json(&Info::new(&hello, &status, &health), streams.data)?;
    } else {
        write_words(streams.data, &hello, &status)?;
        writeln!(streams.data, "status       {:#010x}; `ftcal health` says more", health.live.bits())?;
        write_status(streams.data, health.live)?;
    }
    Ok(())
}

fn write_words(out: &mut dyn Write, hello: &Hello, status: &Status) -> io::Result<()> {
    let calibration = match status.calibration {
        Some(identity) => format!("{identity:08x}"),
        None => "none; upload one with `ftcal upload`".to_owned(),
    };
    let version = words::version(hello.firmware_version);
    writeln!(out, "firmware     {version}, protocol version {}", hello.protocol_version)?;
    writeln!(out, "uptime       {:.1} s", status.uptime.as_seconds())?;
    writeln!(out, "clock        {}", words::clock_source(status.clock))?;
    writeln!(out, "gages        {}", status.gages)?;
    writeln!(out, "converter    {}", words::adc_state(status.adc))?;
    writeln!(out, "settings     {} samples/s, gain {}", status.data_rate.hertz(), status.gain.factor())?;
    writeln!(
        out,
        "conversions  {} read, {} lost, {} corrupted",
        status.conversions, status.lost_conversions, status.corrupted_conversions
    )?;
    writeln!(out, "calibration  {calibration}")?;
    writeln!(out, "trial        {}", words::trial_status(&status.trial))?;
    writeln!(
        out,
        "link         {} samples did not fit on the line, {} broken frames came from the host",
        status.dropped_frames, status.broken_frames
    )
}

/// The same for scripts.
#[derive(Serialize)]
struct Info {
    firmware: String,
    protocol_version: u16,
    uptime_s: f64,
    clock: String,
    gages: u8,
    converter: Converter,
    conversions: Conversions,
    calibration: Option<String>,
    trial: Trial,
    link: Link,
    status: Vec<&'static str>,
}

#[derive(Serialize)]
struct Converter {
    state: &'static str,
    fault: Option<String>,
    data_rate_hz: u32,
    gain: u8,
}

#[derive(Serialize)]
struct Conversions {
    read: u32,
    lost: u32,
    corrupted: u32,
}

#[derive(Serialize)]
struct Trial {
    phase: &'static str,
    rank: u8,
    used: u32,
    saturated: u32,
    repeated: u32,
    moving: u32,
    contradictory: u32,
    off_magnitude: u32,
    unattended: u32,
}

#[derive(Serialize)]
struct Link {
    dropped_frames: u32,
    broken_frames: u32,
}

impl Info {
    fn new(hello: &Hello, status: &Status, health: &HealthReport) -> Self {
        let (state, fault) = match status.adc {
            AdcState::Starting => ("starting", None),
            AdcState::Running => ("running", None),
            AdcState::Faulty(fault) => ("faulty", Some(words::adc_fault(fault))),
        };
        Self {
            firmware: words::version(hello.firmware_version),
            protocol_version: hello.protocol_version,
            uptime_s: status.uptime.as_seconds(),
            clock: words::clock_source(status.clock).to_owned(),
            gages: status.gages,
            converter: Converter {
                state,
                fault,
                data_rate_hz: status.data_rate.hertz(),
                gain: status.gain.factor(),
            },
            conversions: Conversions {
                read: status.conversions,
                lost: status.lost_conversions,
                corrupted: status.corrupted_conversions,
            },
            calibration: status.calibration.map(|identity| format!("{identity:08x}")),
            trial: Trial {
                phase: words::trial_phase(status.trial.phase),
                rank: status.trial.rank,
                used: status.trial.used,
                saturated: status.trial.saturated,
                repeated: status.trial.repeated,
                moving: status.trial.moving,
                contradictory: status.trial.contradictory,
                off_magnitude: status.trial.off_magnitude,
                unattended: status.trial.unattended,
            },
            link: Link { dropped_frames: status.dropped_frames, broken_frames: status.broken_frames },
            status: names(health.live),
        }
    }
}
