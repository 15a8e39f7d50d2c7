//! `ftcal name`: gives the sensor a name, which it keeps.

use anyhow::anyhow;
use clap::Args;
use ftcal_shared::wire::{LONGEST_NAME, SensorName};

use super::device::DeviceArgs;
use super::{Failure, Streams};

/// The arguments of `ftcal name`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// What to call the sensor, at most 32 bytes: its serial number, or where it is mounted
    name: String,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Gives the sensor its name.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let name = SensorName::try_from(arguments.name.as_str())
        .map_err(|_| anyhow!("the name is too long: a sensor remembers {LONGEST_NAME} bytes"))?;
    arguments.device.connect()?.write_name(name)?;
    writeln!(streams.words, "The sensor is called \"{}\" from now on.", arguments.name)?;
    Ok(())
}
