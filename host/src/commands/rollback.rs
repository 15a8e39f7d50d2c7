//! `ftcal rollback`: has the sensor use the calibration before the one that it keeps.

use clap::Args;

use super::device::DeviceArgs;
use super::upload::set_gain;
use super::{Failure, Streams};

/// The arguments of `ftcal rollback`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    #[command(flatten)]
    device: DeviceArgs,
}

/// Brings the previous calibration back, and sets the converter to its gain. The one that is current becomes the previous one, so this can be undone the same way.
///
/// # Errors
///
/// [`Failure`]; the sensor then keeps and uses what it did.
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let mut client = arguments.device.connect()?;
    let upload = client.roll_back()?;
    writeln!(
        streams.words,
        "The sensor uses and keeps calibration {:08x} ({} gages, {} components, gain {}) again.",
        upload.identity,
        upload.bias_counts.len(),
        upload.dof.count(),
        upload.gain.factor()
    )?;
    set_gain(&mut client, &upload, streams)?;
    Ok(())
}
