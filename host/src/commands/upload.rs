//! `ftcal upload`: gives the sensor its calibration.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use ftcal_shared::units::Gain;
use ftcal_shared::wire::CalibrationUpload;

use super::device::DeviceArgs;
use super::record::gain;
use super::{Failure, Streams};
use crate::calibration_file;
use crate::link::client::Client;
use crate::link::error::ClientError;
use crate::link::transport::Transport;
use crate::link::words;
use crate::recording::shown;

/// The arguments of `ftcal upload`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// Calibration file, as `ftcal calibrate` writes it
    calibration: PathBuf,
    /// Have the sensor keep it across resets, too; the one that it kept so far can be brought back with `ftcal rollback`
    #[arg(long)]
    store: bool,
    /// The gain that the calibration was made at: 1, 2, 4, … 128; needed where the file does not say it
    #[arg(long, value_name = "FACTOR", value_parser = gain)]
    gain: Option<Gain>,
    #[command(flatten)]
    device: DeviceArgs,
}

/// A calibration file that says another gain than the command line.
#[derive(Debug, thiserror::Error)]
#[error(
    "{calibration}: field `gain`: expected {} as `--gain` says, found {}; leave `--gain` away, the file knows better",
    .expected.factor(),
    .found.factor()
)]
pub struct GainsDiffer {
    calibration: String,
    expected: Gain,
    found: Gain,
}

/// Reads the file, checks it, and has the sensor use it, and keep it if so wanted.
///
/// # Errors
///
/// [`Failure`]; the sensor then keeps the calibration that it had, unless the failure says otherwise.
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let mut calibration = calibration_file::read(&arguments.calibration).map_err(Failure::input)?;
    match (arguments.gain, calibration.gain) {
        (Some(expected), Some(found)) if expected != found => {
            let calibration = shown(&arguments.calibration);
            return Err(Failure::input(GainsDiffer { calibration, expected, found }));
        }
        (stated, None) => calibration.gain = stated,
        (_, Some(_)) => {}
    }
    let upload = calibration.upload().with_context(|| shown(&arguments.calibration))?;
    let mut client = arguments.device.connect()?;
    client.upload_calibration(&upload)?;
    writeln!(
        streams.words,
        "The sensor uses calibration {:08x} ({} gages, {} components, gain {}), verified by reading it back.",
        upload.identity,
        upload.bias_counts.len(),
        upload.dof.count(),
        upload.gain.factor()
    )?;
    let set = set_gain(&mut client, &upload, streams)?;
    if !arguments.store {
        writeln!(streams.words, "It is lost with the next reset; to have it kept, upload it with --store.")?;
        return Ok(());
    }
    let kept = client.store_calibration()?;
    write!(streams.words, "It is kept across resets")?;
    match kept.previous {
        None => writeln!(streams.words, ".")?,
        Some(previous) => {
            writeln!(streams.words, "; `ftcal rollback` brings {previous:08x} back.")?;
        }
    }
    if set {
        writeln!(
            streams.words,
            "If the sensor keeps settings of another gain, it starts with that one: `ftcal settings --store` keeps this one."
        )?;
    }
    Ok(())
}

/// Sets the converter to the gain of the calibration in use, if it has another one, and says so. Whether it has been set. Where the
/// sensor does not let it, it measures no wrench, which is said instead.
///
/// # Errors
///
/// [`Failure`].
pub fn set_gain<Line: Transport>(
    client: &mut Client<Line>,
    in_use: &CalibrationUpload,
    streams: &mut Streams,
) -> Result<bool, Failure> {
    let status = client.status()?;
    let (before, gain) = (status.gain.factor(), in_use.gain.factor());
    if before == gain {
        return Ok(false);
    }
    match client.configure_adc(status.data_rate, in_use.gain) {
        Ok(_) => {
            writeln!(
                streams.words,
                "The converter was at gain {before}; it is set to gain {gain} now, at which the calibration was made."
            )?;
            Ok(true)
        }
        Err(ClientError::Rejected(rejection)) => {
            writeln!(
                streams.words,
                "CAUTION: no wrench is valid: the calibration was made at gain {gain}, and the converter stays at gain {before}, because \
                 {}. When that is over: `ftcal settings --gain {gain}`",
                words::rejection(rejection)
            )?;
            Ok(false)
        }
        Err(error) => Err(error.into()),
    }
}
