//! `ftcal health`: how gages, load and sensor are, and measuring without a gage that is not well.

use std::io::{self, Write};

use clap::Args;
use ftcal_shared::units::Dof;
use ftcal_shared::wire::health::StatusWord;
use ftcal_shared::wire::{HealthReport, ParityReport};
use serde::Serialize;

use super::device::DeviceArgs;
use super::{Failure, Streams, print_json};
use crate::component::{symbol, unit};
use crate::link::health_words;
use crate::link::words::channel_list;

/// The arguments of `ftcal health`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    #[command(flatten)]
    device: DeviceArgs,
    /// Forget what was in the status word and is no more
    #[arg(long)]
    clear: bool,
    /// Measure without this gage from now on, counted from zero
    #[arg(long, value_name = "GAGE", conflicts_with = "with_all")]
    without: Option<u8>,
    /// Measure with all gages again
    #[arg(long)]
    with_all: bool,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Does what is asked and prints how the sensor is.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let mut client = arguments.device.connect()?;
    if arguments.with_all || arguments.without.is_some() {
        client.carry_on_without(arguments.without)?;
    }
    let report = if arguments.clear { client.clear_latched()? } else { client.health()? };
    let dof = client.read_calibration()?.map(|calibration| calibration.dof);
    if arguments.json {
        print_json(&Health::new(&report, dof), streams.data)?;
    } else {
        write_words(streams.data, &report, dof)?;
    }
    Ok(())
}

/// Two lines a bit that is set: what it says, and what to do.
///
/// # Errors
///
/// Those of the destination.
pub fn write_status(out: &mut dyn Write, word: StatusWord) -> io::Result<()> {
    if word == StatusWord::NONE {
        writeln!(out, "  nothing")?;
    }
    for bit in word.set_bits() {
        let (words, remedy) = health_words::status(bit);
        writeln!(out, "  {:18} {words}", bit.name())?;
        if let Some(remedy) = remedy {
            writeln!(out, "  {:18} → {remedy}", "")?;
        }
    }
    Ok(())
}

fn write_words(out: &mut dyn Write, report: &HealthReport, dof: Option<Dof>) -> io::Result<()> {
    writeln!(out, "now ({:#010x}):", report.live.bits())?;
    write_status(out, report.live)?;
    let past = StatusWord::from_bits(report.latched.bits() & !report.live.bits());
    writeln!(out, "since it was cleared, and not now ({:#010x}):", past.bits())?;
    write_status(out, past)?;
    for (what, mask) in [("saturated", report.saturated), ("repeating", report.repeating)] {
        if mask != 0 {
            writeln!(out, "{what}: {}", channel_list(mask))?;
        }
    }
    match &report.parity {
        None => writeln!(out, "gages: none is redundant, so they cannot be held against each other")?,
        Some(parity) => write_parity(out, parity)?,
    }
    if let Some(gage) = report.carrying_on_without {
        writeln!(out, "measuring without ch{gage}")?;
    }
    for (position, &axis) in dof.map_or([].as_slice(), Dof::axes).iter().enumerate() {
        let value = |peaks: &[f32]| peaks.get(position).copied().unwrap_or(0.0);
        writeln!(
            out,
            "peak {}: {} {unit} since the start, {} {unit} ever",
            symbol(axis),
            value(&report.peak_since_start),
            value(&report.peak_ever),
            unit = unit(axis)
        )?;
    }
    Ok(())
}

fn write_parity(out: &mut dyn Write, parity: &ParityReport) -> io::Result<()> {
    let ParityReport { redundant, disagreement_counts, allowed_counts, .. } = parity;
    match parity.noise_counts {
        None => writeln!(out, "gages: {redundant} redundant, their noise is being measured")?,
        Some(noise) => writeln!(
            out,
            "gages: {redundant} redundant, noise {noise:.1} counts, they contradict each other by \
             {disagreement_counts:.0} counts of {allowed_counts:.0} allowed"
        )?,
    }
    writeln!(out, "gages whose faults show: {}", channel_list(parity.watched))?;
    if *disagreement_counts > *allowed_counts {
        writeln!(out, "suspect: {}", suspects(parity))?;
    }
    Ok(())
}

/// Which gages may be the one that is off.
fn suspects(parity: &ParityReport) -> String {
    let off = format!("off by about {:.0} counts", parity.suspect_off_counts);
    match parity.suspects.count_ones() {
        0 => {
            "no single gage explains it: more than one is off, or the calibration is of another sensor".into()
        }
        1 => format!("{}, {off}", channel_list(parity.suspects)),
        _ => format!("one of {}, which cannot be told apart, {off}", channel_list(parity.suspects)),
    }
}

/// The same for scripts.
#[derive(Serialize)]
struct Health {
    live: Vec<&'static str>,
    latched: Vec<&'static str>,
    saturated: Vec<u32>,
    repeating: Vec<u32>,
    parity: Option<Parity>,
    carrying_on_without: Option<u8>,
    thresholds_exceeded: Vec<u32>,
    peak_since_start: Vec<f32>,
    peak_ever: Vec<f32>,
}

#[derive(Serialize)]
struct Parity {
    redundant: u8,
    watched: Vec<u32>,
    noise_counts: Option<f32>,
    disagreement_counts: f32,
    allowed_counts: f32,
    suspects: Vec<u32>,
    suspect_off_counts: f32,
}

/// The names of the bits that are set.
pub fn names(word: StatusWord) -> Vec<&'static str> {
    word.set_bits().map(ftcal_shared::wire::health::StatusBit::name).collect()
}

fn numbers(mask: u16) -> Vec<u32> {
    (0..u16::BITS).filter(|bit| mask & 1 << bit != 0).collect()
}

impl Health {
    fn new(report: &HealthReport, dof: Option<Dof>) -> Self {
        let components = dof.map_or(0, Dof::count);
        Self {
            live: names(report.live),
            latched: names(report.latched),
            saturated: numbers(report.saturated),
            repeating: numbers(report.repeating),
            parity: report.parity.as_ref().map(|parity| Parity {
                redundant: parity.redundant,
                watched: numbers(parity.watched),
                noise_counts: parity.noise_counts,
                disagreement_counts: parity.disagreement_counts,
                allowed_counts: parity.allowed_counts,
                suspects: numbers(parity.suspects),
                suspect_off_counts: parity.suspect_off_counts,
            }),
            carrying_on_without: report.carrying_on_without,
            thresholds_exceeded: numbers(report.thresholds.into()),
            peak_since_start: report.peak_since_start.iter().copied().take(components).collect(),
            peak_ever: report.peak_ever.iter().copied().take(components).collect(),
        }
    }
}
