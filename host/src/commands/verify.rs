//! `ftcal verify`: does a calibrated sensor still measure a known mass within what its calibration promises?

use std::io::{self, Write};
use std::path::PathBuf;

use clap::Args;
use ftcal_shared::refusal::Refusal;

use super::{Failure, Streams, apply, print_json};
use crate::calibration::verification::{KnownMass, Verification, verify};
use crate::remedy::{self, Explained};

/// Check a calibration in the field with any known mass: passes, or fails with exit code 3
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// The calibration file (JSON)
    pub calibration: PathBuf,
    /// A recording of the mass hanging at rest, in one or several directions, at any arm (CSV)
    pub recording: PathBuf,
    /// The mass that hangs on the sensor, kilogram
    #[arg(long, value_name = "M", value_parser = super::eval::positive)]
    pub mass_kg: f64,
    /// Standard deviation of that mass, kilogram; 0.1 % of it if absent
    #[arg(long, value_name = "M", value_parser = super::eval::positive)]
    pub mass_accuracy_kg: Option<f64>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Verifies and says what was found; a failed verification is told and then refused.
///
/// # Errors
///
/// [`Failure`]; [`Failure::Refused`] where the check fails.
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let (calibration, recording) = apply::read(&arguments.calibration, &arguments.recording)?;
    let mass = KnownMass { mass_kg: arguments.mass_kg, accuracy_kg: arguments.mass_accuracy_kg };
    let found = verify(&calibration, &recording, mass).ok_or_else(|| {
        let refusal = Refusal::Saturated { samples: recording.len() as u64 };
        Failure::Refused(remedy::estimation(&refusal))
    })?;
    if let Some(failed) = failure(&found) {
        summarise(&found, streams.words)?;
        return Err(Failure::Refused(failed));
    }
    if arguments.json {
        print_json(&found, streams.data)?;
    } else {
        summarise(&found, streams.data)?;
        writeln!(streams.data, "passed")?;
    }
    Ok(())
}

/// Why the check fails; `None` where it passes.
fn failure(found: &Verification) -> Option<Explained> {
    // A broken gage makes the magnitude wrong, too: it is the cause to name first.
    if let Some(parity) = found.parity.as_ref().filter(|parity| !parity.passed) {
        return Some(remedy::gage_suspect(parity.worst_gage, parity.worst_standardised));
    }
    (!found.magnitude_passed)
        .then(|| remedy::verification_failed(found.mean_n, found.expected_n, found.predicted_deviation_n))
}

fn summarise(found: &Verification, out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "force {:.4} N, expected {:.4} N, difference {:+.4} N with a predicted standard deviation of {:.4} N",
        found.mean_n, found.expected_n, found.difference_n, found.predicted_deviation_n
    )?;
    match &found.parity {
        Some(parity) => writeln!(
            out,
            "gages: chi-square {:.2} per degree of freedom; ch{} is farthest off, by {:.1} standard deviations",
            parity.chi_square_per_freedom, parity.worst_gage, parity.worst_standardised
        ),
        None => writeln!(out, "gages: no more than components, so that nothing tells whether one is off"),
    }
}
