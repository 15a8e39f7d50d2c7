//! `ftcal settings`: sets the sensor's converter, for now or for good.

use clap::Args;
use ftcal_shared::units::{DataRate, Gain};

use super::device::DeviceArgs;
use super::record::{data_rate, gain};
use super::{Failure, Streams};

/// The arguments of `ftcal settings`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// Samples per second: 250, 500, 1000, 2000, 4000, 8000, 16000 or 32000; as it is where nothing is said
    #[arg(long, value_name = "HZ", value_parser = data_rate)]
    rate: Option<DataRate>,
    /// Gain: 1, 2, 4, … 128; as it is where nothing is said
    #[arg(long, value_name = "FACTOR", value_parser = gain)]
    gain: Option<Gain>,
    /// Have the sensor keep both across resets
    #[arg(long)]
    store: bool,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Sets what is to be set, and says how the converter is set then.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let mut client = arguments.device.connect()?;
    let mut status = client.status()?;
    if arguments.rate.is_some() || arguments.gain.is_some() {
        let rate = arguments.rate.unwrap_or(status.data_rate);
        status = client.configure_adc(rate, arguments.gain.unwrap_or(status.gain))?;
    }
    if arguments.store {
        client.store_settings()?;
    }
    let until = if arguments.store { ", also after a reset" } else { "" };
    writeln!(
        streams.words,
        "The sensor takes {} samples/s at gain {}{until}.",
        status.data_rate.hertz(),
        status.gain.factor()
    )?;
    Ok(())
}
