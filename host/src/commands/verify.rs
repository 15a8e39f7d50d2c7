//! `ftcal verify`: does a calibrated sensor still measure a known mass within what its calibration promises?

use std::io::{self, Write};
use std::path::PathBuf;

use clap::Args;
use ftcal_shared::refusal::Refusal;

use super::{Failure, Streams, apply, print_json};
use crate::calibration::samples::Rejection;
use crate::calibration::verification::{KnownMass, LARGEST_DIFFERENCE, Verification, verify};
use crate::gravity::{Gravity, POSSIBLE};
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
    /// Local gravity here, m/s², if the sensor was calibrated elsewhere; that of the calibration if absent
    #[arg(long, value_name = "G", value_parser = gravity)]
    pub gravity: Option<f64>,
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
    let mass = KnownMass {
        mass_kg: arguments.mass_kg,
        accuracy_kg: arguments.mass_accuracy_kg,
        elsewhere: arguments.gravity.map(|gravity| Gravity::stated(gravity, None)),
    };
    let found = verify(&calibration, &recording, mass).ok_or_else(|| {
        let refusal = Refusal::Saturated { samples: recording.len() as u64 };
        Failure::Refused(remedy::estimation(&refusal))
    })?;
    let failed = failure(&found);
    // What was found is told either way; as JSON, a refusal is all that a failure prints.
    match &failed {
        None if arguments.json => print_json(&found, streams.data)?,
        None => summarise(&found, streams.data)?,
        Some(_) if arguments.json => {}
        Some(_) => summarise(&found, streams.words)?,
    }
    failed.map_or(Ok(()), |failed| Err(Failure::Refused(failed)))
}

/// Why the check fails; `None` where it passes.
fn failure(found: &Verification) -> Option<Explained> {
    // A broken gage makes the magnitude wrong, too: it is the cause to name first.
    if let Some(parity) = found.parity.as_ref().filter(|parity| !parity.passed) {
        return Some(remedy::gage_suspect(parity.worst_gage, parity.worst_standardised));
    }
    let failed =
        |measured_n| remedy::verification_failed(measured_n, found.expected_n, found.predicted_deviation_n);
    if !found.magnitude_passed {
        return Some(failed(found.mean_n));
    }
    (!found.worst_passed).then(|| failed(found.worst_n))
}

fn summarise(found: &Verification, out: &mut dyn Write) -> io::Result<()> {
    let Verification { mean_n, expected_n, difference_n, predicted_deviation_n, samples, .. } = found;
    let percent = |newton: f64| 100.0 * newton / expected_n;
    writeln!(
        out,
        "measured   {mean_n:.4} N where {expected_n:.4} N hang: {difference_n:+.4} N ({:+.3} %)",
        percent(*difference_n)
    )?;
    writeln!(
        out,
        "expected   within {:.4} N ({:.3} %), {LARGEST_DIFFERENCE:.0} standard deviations: one is {:.4} N of the \
         calibration{} and {:.4} N of the mass",
        LARGEST_DIFFERENCE * predicted_deviation_n,
        percent(LARGEST_DIFFERENCE * predicted_deviation_n),
        found.calibration_deviation_n,
        if found.calibration_states_it { "" } else { " (which states none: by its records)" },
        found.mass_deviation_n
    )?;
    writeln!(
        out,
        "farthest   {:.4} N ({:+.3} %) in one direction",
        found.worst_n,
        percent(found.worst_n - expected_n)
    )?;
    match &found.parity {
        Some(parity) => writeln!(
            out,
            "gages      {}: ch{} is farthest off, by {:.1} standard deviations (chi-square {:.2} per degree of freedom)",
            if parity.passed { "agree" } else { "contradict each other" },
            parity.worst_gage,
            parity.worst_standardised,
            parity.chi_square_per_freedom
        )?,
        None => writeln!(out, "gages      cannot be judged: there are no more of them than components")?,
    }
    let at_rest = if samples.rejected.contains_key(&Rejection::Moving) { ", those at rest" } else { "" };
    writeln!(out, "samples    {} of {} used{at_rest}", samples.used, samples.total)?;
    let verdict = if failure(found).is_none() { "passed" } else { "failed" };
    writeln!(out, "{verdict}")
}

/// Reads a gravity that there is.
fn gravity(text: &str) -> Result<f64, String> {
    let expected = || format!("expected gravity from {} to {} m/s²", POSSIBLE.start(), POSSIBLE.end());
    text.parse::<f64>().ok().filter(|gravity| POSSIBLE.contains(gravity)).ok_or_else(expected)
}
