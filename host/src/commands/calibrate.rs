//! `ftcal calibrate`: a session file to a calibration file.

use std::io::{self, Write};
use std::path::PathBuf;

use clap::Args;
use ftcal_shared::units::Dof;

use super::output::Output;
use super::{Failure, Streams};
use crate::calibration::evidence::{self, Approach, CalibrationFailure};
use crate::calibration::linearity::Linearity;
use crate::calibration::reference::Drift;
use crate::calibration::trial::Gating;
use crate::calibration::{BiasOrigin, Calibration, Method};
use crate::calibration_file;
use crate::recording::shown;
use crate::remedy;
use crate::session_file::Session;

/// Calibrate a sensor from a session: recordings, masses, arms and known loads
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// The session file (TOML)
    pub session: PathBuf,
    /// Where to write the calibration
    #[arg(short, long, default_value = "calibration.json")]
    pub output: PathBuf,
    /// Shape from motion, all trials jointly or staged as in the paper; or least squares on the known loads alone
    #[arg(long, value_enum, default_value = "sfm")]
    pub method: Method,
    /// Leave out samples during which the load moved too much, where that serves the answer, and those of a converter that
    /// repeats itself
    #[arg(long, value_enum, default_value = "on")]
    pub gate: Gating,
    /// The calibration that the sensor has: orients the new one with no known load, and tells how far the sensor has moved
    #[arg(long, value_name = "OLD", conflicts_with = "method")]
    pub reference: Option<PathBuf>,
    /// Calibrate a sensor that is not linear as if it were
    #[arg(long)]
    pub allow_nonlinear: bool,
    /// Print the calibration, or the refusal, as JSON
    #[arg(long)]
    pub json: bool,
}

/// A stored calibration and a session that are not of one sensor.
#[derive(Debug, thiserror::Error)]
#[error("{reference}: field `dof`: expected {expected:?} as in the session, found {found:?}")]
pub struct DofDiffers {
    reference: String,
    expected: Dof,
    found: Dof,
}

/// Calibrates and writes the calibration file.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let session = Session::read(&arguments.session).map_err(Failure::input)?;
    let approach = Approach {
        gating: arguments.gate,
        linearity: if arguments.allow_nonlinear { Linearity::Assumed } else { Linearity::Required },
    };
    let outcome = match &arguments.reference {
        None => evidence::calibrate(&session, arguments.method, approach),
        Some(path) => {
            let stored = calibration_file::read(path).map_err(Failure::input)?;
            if stored.dof != session.dof {
                return Err(Failure::input(DofDiffers {
                    reference: shown(path),
                    expected: session.dof,
                    found: stored.dof,
                }));
            }
            evidence::recalibrate(&session, &stored, approach)
        }
    };
    let calibration = outcome.map_err(|failure| match failure {
        CalibrationFailure::Input(error) => Failure::input(error),
        CalibrationFailure::Refused(refusal) => Failure::Refused(remedy::calibration(&refusal)),
    })?;
    let mut file = Output::open(Some(&arguments.output), streams.data)?;
    calibration_file::write(&calibration, &mut file)?;
    file.finish()?;
    if arguments.json {
        calibration_file::write(&calibration, &mut *streams.data)?;
    }
    summarise(&calibration, streams.words)?;
    writeln!(streams.words, "written to {}", shown(&arguments.output))?;
    Ok(())
}

/// Writes a summary that a person can read.
///
/// # Errors
///
/// Those of the destination.
pub fn summarise(calibration: &Calibration, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "calibration matrix (newton, newton metre per count)")?;
    for (axis, row) in calibration.dof.axes().iter().zip(calibration.matrix.row_iter()) {
        write!(out, "{:<8}", super::apply::column_name(*axis))?;
        for element in row.iter() {
            write!(out, " {element:12.5e}")?;
        }
        writeln!(out)?;
    }
    write!(out, "{:<8}", "bias")?;
    for counts in calibration.bias_counts.iter() {
        write!(out, " {counts:12.1}")?;
    }
    writeln!(out, " counts")?;
    match calibration.bias {
        BiasOrigin::Estimated => {}
        BiasOrigin::OfMotion => {
            writeln!(out, "the bias is that of the trials' motion: the known loads do not determine it")?;
        }
        BiasOrigin::TakenAsZero => writeln!(
            out,
            "CAUTION: the bias is taken as zero, since neither the known loads nor any motion determine it; add the \
             opposite of one known load"
        )?,
    }
    writeln!(out, "handedness proven; fusion residual {:.3} %", 100.0 * calibration.fusion_residual)?;
    if let Some(uncertainty) = &calibration.uncertainty {
        write!(out, "uncertainty at full load (one standard deviation):")?;
        for (axis, deviation) in calibration.dof.axes().iter().zip(&uncertainty.per_axis_full_load) {
            write!(out, " {} {deviation:.2e}", super::apply::column_name(*axis))?;
        }
        writeln!(out)?;
    }
    for trial in &calibration.trials {
        write!(out, "{}: {} kg, {} known loads", trial.recording, trial.mass_kg, trial.known_loads)?;
        if let Some(solution) = &trial.solution {
            write!(
                out,
                ", {} of {} samples used, directions off by {:.3}°",
                solution.samples.used, solution.samples.total, solution.alignment_residual_deg
            )?;
        }
        writeln!(out)?;
    }
    for check in &calibration.checks {
        writeln!(
            out,
            "check {}: {} kg, response off by {:+.3} %, shape off by {:.3} %",
            check.recording,
            check.mass_kg,
            100.0 * (check.scale - 1.0),
            100.0 * check.residual
        )?;
    }
    if let Some(drift) = &calibration.drift {
        summarise_drift(calibration, drift, out)?;
    }
    Ok(())
}

fn summarise_drift(calibration: &Calibration, drift: &Drift, out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "moved since the stored calibration ({} of {} components seen):",
        drift.components_seen,
        calibration.dof.count()
    )?;
    for (gage, percent) in drift.gage_percent.iter().enumerate() {
        writeln!(out, "ch{gage:<6} {percent:8.3} %")?;
    }
    for (axis, percent) in calibration.dof.axes().iter().zip(&drift.axis_percent) {
        writeln!(out, "{:<8} {percent:8.3} %", super::apply::column_name(*axis))?;
    }
    Ok(())
}
