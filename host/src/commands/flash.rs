//! `ftcal flash`: writes the firmware image to the sensor through a debug probe.

use std::io::{IsTerminal, stderr};
use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use probe_rs::probe::DebugProbeSelector;
use probe_rs::probe::list::Lister;

use super::{Failure, Streams};
use crate::flash::image::{FirmwareImage, ImageError};
use crate::flash::{CHIP, FlashError, FlashMode, FlashStep, StepProgress, flash, open_probe};

/// The arguments of `ftcal flash`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// The firmware image (ELF)
    image: PathBuf,
    /// The debug probe, as VID:PID or VID:PID:SERIAL; not needed where there is only one
    #[arg(long, value_name = "PROBE")]
    probe: Option<DebugProbeSelector>,
    /// Check the image, attach to the chip and plan, but write nothing
    #[arg(long)]
    dry_run: bool,
}

/// Checks the image, finds the probe, and writes.
///
/// # Errors
///
/// [`Failure::Input`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let image = FirmwareImage::read(&arguments.image).map_err(|error| explained(error.into()))?;
    writeln!(streams.words, "{} bytes in {} segments for {CHIP}", image.len_bytes(), image.segments().len())?;
    let probe = open_probe(&Lister::new(), arguments.probe.as_ref()).map_err(explained)?;
    let mode = if arguments.dry_run { FlashMode::DryRun } else { FlashMode::Write };
    let progress = stderr().is_terminal();
    let words = &mut *streams.words;
    flash(probe, &image, mode, |step| {
        if progress {
            // What cannot be shown is no reason to leave the flash half written.
            let _ = write!(words, "\r{}", in_words(step)).and_then(|()| words.flush());
        }
    })
    .map_err(explained)?;
    let start = if progress { "\r" } else { "" };
    match mode {
        FlashMode::Write => writeln!(streams.words, "{start}Written, verified and started.   ")?,
        FlashMode::DryRun => writeln!(streams.words, "{start}Nothing was written.             ")?,
    }
    Ok(())
}

fn in_words(progress: StepProgress) -> String {
    let doing = match progress.step {
        FlashStep::Erase => "erasing",
        FlashStep::Program => "programming",
        FlashStep::Verify => "verifying",
    };
    let percent = (100 * progress.done_bytes).checked_div(progress.total_bytes).unwrap_or(0);
    format!("{doing:<12} {percent:3} %")
}

/// What to do about an error, next to what it is.
pub(super) fn explained(error: FlashError) -> Failure {
    let remedy = match &error {
        FlashError::Image(ImageError::Unreadable { .. }) => "Check the path.",
        FlashError::Image(_) => {
            "Build the image with `cargo build -p ftcal-firmware --target thumbv7em-none-eabihf --profile firmware --features \
             BOARD`; firmware/README.md names the boards."
        }
        FlashError::NoProbe { .. } => {
            "Connect a debug probe (ST-Link, CMSIS-DAP, J-Link) to this machine and to the board; on Linux, install the \
             udev rules of probe-rs (https://probe.rs/docs/getting-started/probe-setup)."
        }
        FlashError::SeveralProbes { .. } => "Name the one that is connected to the board with --probe.",
        FlashError::Open(_) => {
            "Close other programs that use the probe; on Linux, install the udev rules of probe-rs \
             (https://probe.rs/docs/getting-started/probe-setup)."
        }
        FlashError::Attach(_) => {
            "Check that the board is powered and that the probe's SWDIO, SWCLK and GND reach it."
        }
        FlashError::Write(_) | FlashError::Verify => {
            "The flash may hold neither the old image nor the new one: check the board's supply and flash again."
        }
        FlashError::Restart(_) => "Switch the board off and on again.",
    };
    // The alternate form of an error names what lies behind it, too.
    anyhow!("{:#}\n{remedy}", anyhow::Error::new(error)).into()
}
