//! `ftcal logs`: what the firmware says of itself, in words.

use std::fs::File;
use std::io::Read;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use anyhow::anyhow;
use clap::Args;
use probe_rs::Permissions;
use probe_rs::probe::DebugProbeSelector;
use probe_rs::probe::list::Lister;
use probe_rs::rtt::Rtt;

use super::{Failure, Streams};
use crate::flash::{CHIP, open_probe};
use crate::logs::{Decoded, LogReader, LogStrings};
use crate::recording::shown;

/// Bytes taken at once.
const CHUNK: usize = 4096;

/// Between two looks for more.
const LOOK: Duration = Duration::from_millis(20);

/// Show the log of a sensor, or of an emulated one
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// The firmware image (ELF) that the sensor runs: it holds the words
    pub image: PathBuf,
    /// Read the log of an emulated sensor from the file that `ftcal sim --emulator IMAGE --logs FILE` writes, instead of from a
    /// debug probe
    #[arg(long, value_name = "FILE", conflicts_with = "probe")]
    pub from: Option<PathBuf>,
    /// The debug probe, as VID:PID or VID:PID:SERIAL; not needed where there is only one
    #[arg(long, value_name = "PROBE")]
    pub probe: Option<DebugProbeSelector>,
}

/// Puts the log into words: a file to its end, a probe until the process is ended.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let strings = LogStrings::read(&arguments.image).map_err(Failure::input)?;
    let mut reader = strings.reader();
    match &arguments.from {
        Some(file) => {
            let unreadable = |reason| anyhow!("{}: cannot be read: {reason}", shown(file));
            let mut log = File::open(file).map_err(unreadable)?;
            let mut bytes = [0; CHUNK];
            let mut decoded = Decoded::default();
            loop {
                let count = log.read(&mut bytes).map_err(unreadable)?;
                if count == 0 {
                    break;
                }
                let now = reader.take_in(bytes.get(..count).unwrap_or_default(), streams.data)?;
                decoded.messages += now.messages;
                decoded.damaged += now.damaged;
            }
            if decoded.damaged > 0 {
                writeln!(
                    streams.words,
                    "{} messages could not be read: they are damaged, or the sensor runs another image",
                    decoded.damaged
                )?;
            }
            Ok(())
        }
        None => follow(arguments, &mut reader, streams),
    }
}

/// Reads the log out of the running sensor's memory.
fn follow(arguments: &Arguments, reader: &mut LogReader, streams: &mut Streams) -> Result<(), Failure> {
    let probe = open_probe(&Lister::new(), arguments.probe.as_ref()).map_err(super::flash::explained)?;
    let unreachable = |error: probe_rs::Error| {
        anyhow!("the debug probe does not reach the {CHIP}: {error}. Check power, SWDIO, SWCLK and GND")
    };
    let mut session = probe.attach(CHIP, Permissions::default()).map_err(unreachable)?;
    let mut core = session.core(0).map_err(unreachable)?;
    let no_log = |error: probe_rs::rtt::Error| {
        anyhow!("the sensor keeps no log: {error}. Flash the image named above")
    };
    let mut rtt = Rtt::attach(&mut core).map_err(no_log)?;
    let mut bytes = [0; CHUNK];
    loop {
        let channel = rtt.up_channel(0).ok_or_else(|| anyhow!("the sensor's log has no channel"))?;
        let count = channel.read(&mut core, &mut bytes).map_err(no_log)?;
        reader.take_in(bytes.get(..count).unwrap_or_default(), streams.data)?;
        if count == 0 {
            streams.data.flush()?;
            thread::sleep(LOOK);
        }
    }
}
