//! `ftcal selftest`: has the sensor play every fault on itself, and tells what it found.

use std::io::{self, Write};

use clap::Args;
use ftcal_shared::wire::SelfTestReport;

use super::device::DeviceArgs;
use super::{Failure, Streams};
use crate::link::health_words::{found, is_passed, played};
use crate::remedy::Explained;

/// The arguments of `ftcal selftest`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    #[command(flatten)]
    device: DeviceArgs,
}

/// Has the sensor test itself and prints a table.
///
/// # Errors
///
/// [`Failure`]; refused where something was not found.
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let report = arguments.device.connect()?.self_test()?;
    write_table(&report, streams.data)?;
    let failed = report.outcomes.iter().filter(|outcome| !is_passed(outcome.found)).count();
    if failed == 0 && !report.outcomes.is_empty() {
        return Ok(());
    }
    Err(Failure::Refused(Explained {
        cause: "self-test-failed",
        detail: format!("{failed} of {} faults were not found", report.outcomes.len()),
        remedy: "Do not measure with this sensor: look at `ftcal info` and `ftcal health`, mend what they name, and test again.",
    }))
}

fn write_table(report: &SelfTestReport, out: &mut dyn Write) -> io::Result<()> {
    for outcome in &report.outcomes {
        writeln!(out, "{:24} {}", played(outcome.played), found(outcome.found))?;
    }
    Ok(())
}
