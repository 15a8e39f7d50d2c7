//! `ftcal apply`: a recording to forces and torques.

use std::io::{self, Write};
use std::path::PathBuf;

use clap::Args;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::{AdcCode, Axis, Gain};

use super::output::Output;
use super::{Failure, Streams};
use crate::calibration::Calibration;
use crate::calibration::wrench_uncertainty::WrenchUncertainty;
use crate::calibration_file;
use crate::recording::{Recording, shown};
use crate::remedy;

/// Turn a recording into forces and torques
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// The calibration file (JSON)
    pub calibration: PathBuf,
    /// The recording (CSV)
    pub recording: PathBuf,
    /// Where to write the wrenches (CSV); standard output if absent
    #[arg(short, long)]
    pub output: Option<PathBuf>,
    /// Add to each wrench how certain the calibration is of it, one standard deviation a component. The noise of a sample
    /// is not in it: that is what the wrenches of a load at rest scatter by
    #[arg(long)]
    pub uncertainty: bool,
}

/// A calibration that does not say how certain it is.
#[derive(Debug, thiserror::Error)]
#[error(
    "{calibration}: field `uncertainty.wrench`: expected how the uncertainty follows the wrench, found nothing; \
     calibrate again from the session, with `--method sfm`, or leave `--uncertainty` away"
)]
pub struct UncertaintyUnknown {
    calibration: String,
}

/// A calibration and a recording that do not belong together.
#[derive(Debug, thiserror::Error)]
#[error(
    "{recording}: expected a recording of {expected} gages as the calibration is of, found {found} gages"
)]
pub struct GagesDiffer {
    recording: String,
    expected: usize,
    found: usize,
}

/// A recording whose counts are of another size than those of the calibration.
#[derive(Debug, thiserror::Error)]
#[error(
    "{recording}: expected a recording at gain {} as the calibration was made at, found one at gain {}; record it again with \
     `ftcal record --gain {0}`, or calibrate at gain {1}",
    .expected.factor(),
    .found.factor()
)]
pub struct GainsDiffer {
    recording: String,
    expected: Gain,
    found: Gain,
}

/// Reads a calibration and a recording that belong together: of as many gages, and at one gain as far as both say it.
///
/// # Errors
///
/// [`Failure::Input`].
pub fn read(
    calibration: &std::path::Path,
    recording: &std::path::Path,
) -> Result<(Calibration, Recording), Failure> {
    let read_calibration = calibration_file::read(calibration).map_err(Failure::input)?;
    let read_recording = Recording::read(recording).map_err(Failure::input)?;
    let (expected, found) = (read_calibration.gages(), read_recording.gages());
    if expected != found {
        return Err(Failure::input(GagesDiffer { recording: shown(recording), expected, found }));
    }
    match (read_calibration.gain, read_recording.gain()) {
        (Some(expected), Some(found)) if expected != found => {
            Err(Failure::input(GainsDiffer { recording: shown(recording), expected, found }))
        }
        _ => Ok((read_calibration, read_recording)),
    }
}

/// Applies a calibration to a recording.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let (calibration, recording) = read(&arguments.calibration, &arguments.recording)?;
    let overflow = |(_, codes): (f64, &[AdcCode])| {
        !calibration.wrench(&recording.counts(codes)).iter().all(|component| component.is_finite())
    };
    if recording.unsaturated().any(overflow) {
        return Err(Failure::Refused(remedy::estimation(&Refusal::NonFinite)));
    }
    let uncertainty = if arguments.uncertainty {
        let unknown = || UncertaintyUnknown { calibration: shown(&arguments.calibration) };
        Some(wrench_uncertainty(&calibration).ok_or_else(unknown).map_err(Failure::input)?)
    } else {
        None
    };
    let mut output = Output::open(arguments.output.as_deref(), streams.data)?;
    let saturated = write_wrenches(&calibration, uncertainty, &recording, &mut output)?;
    output.finish()?;
    if saturated > 0 {
        writeln!(
            streams.words,
            "{saturated} of {} samples are saturated: their fields are left empty",
            recording.len()
        )?;
    }
    Ok(())
}

fn wrench_uncertainty(calibration: &Calibration) -> Option<&WrenchUncertainty> {
    calibration.uncertainty.as_ref()?.wrench.as_ref()
}

/// Writes one line a sample and says how many samples were saturated. Those are no measurements: their fields are empty. With an
/// `uncertainty`, the standard deviations follow the components.
///
/// # Errors
///
/// Those of the destination.
pub fn write_wrenches(
    calibration: &Calibration,
    uncertainty: Option<&WrenchUncertainty>,
    recording: &Recording,
    mut out: impl Write,
) -> io::Result<usize> {
    let axes = calibration.dof.axes();
    let names: Vec<&str> = axes.iter().map(|&axis| column_name(axis)).collect();
    write!(out, "t_s,{}", names.join(","))?;
    if uncertainty.is_some() {
        let deviations: Vec<String> = names.iter().map(|name| format!("deviation_{name}")).collect();
        write!(out, ",{}", deviations.join(","))?;
    }
    writeln!(out)?;
    let fields = if uncertainty.is_some() { 2 * axes.len() } else { axes.len() };
    let mut saturated = 0;
    for (time_s, codes) in recording.samples() {
        write!(out, "{time_s}")?;
        if AdcCode::any_is_saturated(codes) {
            saturated += 1;
            write!(out, "{}", ",".repeat(fields))?;
        } else {
            let wrench = calibration.wrench(&recording.counts(codes));
            let deviations = uncertainty.map(|uncertainty| uncertainty.of(&wrench));
            for number in wrench.iter().chain(deviations.iter().flatten()) {
                write!(out, ",{number}")?;
            }
        }
        writeln!(out)?;
    }
    Ok(saturated)
}

/// The name of a component's column, with its unit.
pub const fn column_name(axis: Axis) -> &'static str {
    match axis {
        Axis::ForceX => "fx_n",
        Axis::ForceY => "fy_n",
        Axis::ForceZ => "fz_n",
        Axis::TorqueX => "tx_nm",
        Axis::TorqueY => "ty_nm",
        Axis::TorqueZ => "tz_nm",
    }
}
