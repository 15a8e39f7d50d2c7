//! `ftcal info`: who the sensor is and how it is.

use std::io::{self, Write};

use clap::Args;
use ftcal_shared::units::Gain;
use ftcal_shared::wire::{
    AdcState, CalibrationOrigin, Diagnosis, FieldReport, HealthReport, Hello, Identity, KeptCalibration,
    Status,
};
use serde::Serialize;

use super::device::DeviceArgs;
use super::health::{names, write_status};
use super::{Failure, Streams, print_json};
use crate::link::{field_words, words};

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
    let identity = client.identity()?;
    let gain = client.read_calibration()?.map(|in_use| in_use.gain);
    let (health, diagnosis, field) = (client.health()?, client.diagnosis()?, client.field()?);
    if arguments.json {
        print_json(&Info::new(&hello, &status, gain, &identity, &health, &diagnosis, &field), streams.data)?;
    } else {
        write_words(streams.data, &hello, &status, gain, &identity)?;
        write_field(streams.data, &field)?;
        write_diagnosis(streams.data, &diagnosis)?;
        writeln!(streams.data, "status       {:#010x}; `ftcal health` says more", health.live.bits())?;
        write_status(streams.data, health.live)?;
    }
    Ok(())
}

/// `gain` is that of the calibration in use.
fn write_words(
    out: &mut dyn Write,
    hello: &Hello,
    status: &Status,
    gain: Option<Gain>,
    identity: &Identity,
) -> io::Result<()> {
    let made_at = gain.map_or_else(String::new, |gain| format!(", made at gain {}", gain.factor()));
    let calibration = match status.calibration {
        Some(in_use) if status.kept.current == KeptCalibration::Calibration(in_use) => {
            format!("{in_use:08x}{made_at}, kept across resets")
        }
        Some(in_use) => format!("{in_use:08x}{made_at}, lost with the next reset"),
        None => "none; upload one with `ftcal upload`".to_owned(),
    };
    let kept = words::kept_calibration(status.kept.current);
    let previous = match status.kept.previous {
        Some(previous) => format!("; before that {previous:08x}, which `ftcal rollback` brings back"),
        None => String::new(),
    };
    let name = if identity.name.is_empty() { "none; give it one with `ftcal name`" } else { &identity.name };
    let version = words::version(hello.firmware_version);
    writeln!(out, "name         {name}")?;
    writeln!(out, "firmware     {version}, protocol version {}", hello.protocol_version)?;
    writeln!(out, "uptime       {:.1} s", status.uptime.as_seconds())?;
    writeln!(out, "starts       {}", identity.boots)?;
    writeln!(out, "clock        {}", words::clock_source(status.clock))?;
    writeln!(out, "gages        {}", status.gages)?;
    writeln!(out, "converter    {}", words::adc_state(status.adc))?;
    writeln!(out, "settings     {} samples/s, gain {}", status.data_rate.hertz(), status.gain.factor())?;
    writeln!(
        out,
        "conversions  {} read, {} lost, {} corrupted; {} overran those before, {} attended to late",
        status.conversions,
        status.lost_conversions,
        status.corrupted_conversions,
        status.overrun_conversions,
        status.late_samples
    )?;
    writeln!(out, "calibration  {calibration}")?;
    writeln!(out, "memory       {kept}{previous}; stored {} times", identity.stores)?;
    writeln!(out, "trial        {}", words::trial_status(&status.trial))?;
    writeln!(
        out,
        "link         {} samples did not fit on the line, {} broken frames came from the host, {} streams were abandoned",
        status.dropped_samples, status.broken_frames, status.abandoned_streams
    )
}

fn write_field(out: &mut dyn Write, field: &FieldReport) -> io::Result<()> {
    if let Some(CalibrationOrigin::Field(renewed, found)) = &field.origin {
        writeln!(out, "origin       {}", field_words::renewed(*renewed, found))?;
    }
    let phase = field_words::phase(field.phase);
    match &field.last {
        None => writeln!(out, "button       {phase}"),
        Some(outcome) => writeln!(out, "button       {phase}; last time {}", field_words::outcome(outcome)),
    }
}

fn write_diagnosis(out: &mut dyn Write, diagnosis: &Diagnosis) -> io::Result<()> {
    writeln!(out, "last reset   {}", words::reset_cause(diagnosis.reset))?;
    if let Some(failure) = &diagnosis.failure {
        writeln!(out, "after        {}", words::failure(failure))?;
    }
    if diagnosis.stack_bytes > 0 {
        writeln!(
            out,
            "stack        {} of {} bytes used at most",
            diagnosis.stack_used_bytes, diagnosis.stack_bytes
        )?;
    }
    Ok(())
}

/// The same for scripts.
#[derive(Serialize)]
struct Info {
    name: String,
    boots: u32,
    firmware: String,
    protocol_version: u16,
    uptime_s: f64,
    clock: String,
    gages: u8,
    converter: Converter,
    conversions: Conversions,
    calibration: Option<String>,
    /// The gain that the calibration in use was made at.
    calibration_gain: Option<u8>,
    memory: Memory,
    trial: Trial,
    link: Link,
    status: Vec<&'static str>,
    field: Field,
    last_reset: &'static str,
    failure: Option<String>,
    stack: Stack,
}

/// Calibration in the field.
#[derive(Serialize)]
struct Field {
    phase: &'static str,
    /// What the last one ended with: "renewed", "confirmed", or why it was refused.
    last: Option<&'static str>,
    /// Whether the calibration in use was renewed in the field.
    renewed: bool,
}

#[derive(Serialize)]
struct Stack {
    used_bytes: u32,
    bytes: u32,
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
    overrun: u32,
    late: u32,
}

#[derive(Serialize)]
struct Memory {
    /// `null` where there is none, for the reason in `problem`.
    calibration: Option<String>,
    problem: Option<String>,
    previous: Option<String>,
    stores: u32,
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
    resumption: &'static str,
    checkpointed: u32,
}

#[derive(Serialize)]
struct Link {
    dropped_samples: u32,
    broken_frames: u32,
    abandoned_streams: u32,
}

impl Info {
    fn new(
        hello: &Hello,
        status: &Status,
        gain: Option<Gain>,
        identity: &Identity,
        health: &HealthReport,
        diagnosis: &Diagnosis,
        field: &FieldReport,
    ) -> Self {
        let hexadecimal = |identity: u32| format!("{identity:08x}");
        let (kept, problem) = match status.kept.current {
            KeptCalibration::Calibration(identity) => (Some(hexadecimal(identity)), None),
            other => (None, Some(words::kept_calibration(other))),
        };
        let (state, fault) = match status.adc {
            AdcState::Starting => ("starting", None),
            AdcState::Running => ("running", None),
            AdcState::Faulty(fault) => ("faulty", Some(words::adc_fault(fault))),
        };
        Self {
            name: identity.name.as_str().to_owned(),
            boots: identity.boots,
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
                overrun: status.overrun_conversions,
                late: status.late_samples,
            },
            calibration: status.calibration.map(hexadecimal),
            calibration_gain: gain.map(Gain::factor),
            memory: Memory {
                calibration: kept,
                problem,
                previous: status.kept.previous.map(hexadecimal),
                stores: identity.stores,
            },
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
                resumption: words::resumption(status.trial.resumption),
                checkpointed: status.trial.checkpointed,
            },
            link: Link {
                dropped_samples: status.dropped_samples,
                broken_frames: status.broken_frames,
                abandoned_streams: status.abandoned_streams,
            },
            status: names(health.live),
            field: Field {
                phase: field_words::phase_name(field.phase),
                last: field.last.as_ref().map(field_words::outcome_name),
                renewed: matches!(field.origin, Some(CalibrationOrigin::Field(..))),
            },
            last_reset: words::reset_cause(diagnosis.reset),
            failure: diagnosis.failure.as_ref().map(words::failure),
            stack: Stack { used_bytes: diagnosis.stack_used_bytes, bytes: diagnosis.stack_bytes },
        }
    }
}
