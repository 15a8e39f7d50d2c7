//! `ftcal calibrate`: a session file to a calibration file.

use std::io::{self, Write};
use std::path::PathBuf;

use clap::Args;
use ftcal_shared::units::Dof;

use super::output::Output;
use super::{Failure, Streams};
use crate::calibration::accuracy::share_of_gravity;
use crate::calibration::drift::{Drift, Moved};
use crate::calibration::evidence::{self, Approach, CalibrationFailure};
use crate::calibration::linearity::{CheckRecord, CheckVerdict, Linearity};
use crate::calibration::refinement::Refining;
use crate::calibration::trial::Gating;
use crate::calibration::{BiasOrigin, Calibration, Method};
use crate::calibration_file;
use crate::component::{symbol, unit};
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
    /// Take each trial as the sensor itself would solve it
    #[arg(long)]
    pub no_refine: bool,
    /// Print the calibration, or the refusal, as JSON
    #[arg(long)]
    pub json: bool,
}

/// The share of the forces' variance from which on local gravity is named as its cause.
const MOST: f64 = 0.5;

/// Gravity differs from that of a stored calibration if it does by more than this, relative.
const SAME_GRAVITY: f64 = 1e-6;

/// A stored calibration and a session that are not of one sensor.
#[derive(Debug, thiserror::Error)]
#[error("{reference}: field `dof`: expected `{expected}` as in the session, found `{found}`")]
pub struct DofDiffers {
    reference: String,
    expected: &'static str,
    found: &'static str,
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
        refining: if arguments.no_refine { Refining::Off } else { Refining::On },
    };
    let mut gravity_before = None;
    let outcome = match &arguments.reference {
        None => evidence::calibrate(&session, arguments.method, approach),
        Some(path) => {
            let stored = calibration_file::read(path).map_err(Failure::input)?;
            if stored.dof != session.dof {
                return Err(Failure::input(DofDiffers {
                    reference: shown(path),
                    expected: dof_name(session.dof),
                    found: dof_name(stored.dof),
                }));
            }
            gravity_before = Some(stored.gravity);
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
    if let Some(before) = gravity_before {
        compare_gravity(before, calibration.gravity, streams.words)?;
    }
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
    match calibration.gain {
        Some(gain) => writeln!(out, "the counts are of gain {}", gain.factor())?,
        None => writeln!(
            out,
            "the gain is unknown: no recording says it; state `gain` in the session, or `ftcal upload` will ask for it"
        )?,
    }
    writeln!(out, "handedness proven; fusion residual {:.3} %", 100.0 * calibration.fusion_residual)?;
    if let Some(uncertainty) = &calibration.uncertainty {
        let axes = calibration.dof.axes().iter().zip(&uncertainty.per_axis_full_load);
        let each = axes.map(|(axis, deviation)| format!("{} {deviation:.2e} {}", symbol(*axis), unit(*axis)));
        let each = each.collect::<Vec<_>>().join(", ");
        writeln!(out, "uncertainty at full load (one standard deviation): {each}")?;
        if let Some(accuracy) = uncertainty.gravity_accuracy.filter(|_| share_of_gravity(calibration) > MOST)
        {
            writeln!(
                out,
                "most of that is local gravity, taken as {} ± {accuracy} m/s²: state `gravity` in the session, and \
                 `gravity_accuracy` if you know it",
                calibration.gravity
            )?;
        }
    }
    for trial in &calibration.trials {
        let plural = if trial.known_loads == 1 { "" } else { "s" };
        write!(out, "{}: {} kg, {} known load{plural}", trial.recording, trial.mass_kg, trial.known_loads)?;
        if let Some(solution) = &trial.solution {
            write!(out, ", {} of {} samples used", solution.samples.used, solution.samples.total)?;
            if trial.known_loads > 0 {
                write!(out, ", directions off by {:.3}°", solution.alignment_residual_deg)?;
            }
        }
        writeln!(out)?;
    }
    for check in &calibration.checks {
        summarise_check(check, out)?;
    }
    if let Some(drift) = &calibration.drift {
        summarise_drift(calibration, drift, out)?;
    }
    Ok(())
}

/// How a trial fits that is compared and not fitted: how far the sensor is from linear between its load and the others.
fn summarise_check(check: &CheckRecord, out: &mut dyn Write) -> io::Result<()> {
    let explained = |uncertainty: Option<f64>| match uncertainty {
        Some(uncertainty) => format!(" (± {:.3} %)", 100.0 * uncertainty),
        None => String::new(),
    };
    let verdict = match check.verdict {
        Some(CheckVerdict::WithinUncertainty) => ": within what the uncertainty explains",
        Some(CheckVerdict::BeyondUncertainty) => {
            ": beyond what the uncertainty explains; the sensor is not linear from the other loads to this one, or mass or \
             arm are not what the session says"
        }
        None => "",
    };
    writeln!(
        out,
        "check {}: {} kg, response off by {:+.3} %{}, its shape by {:.3} %{}{verdict}",
        check.recording,
        check.mass_kg,
        100.0 * (check.scale - 1.0),
        explained(check.scale_uncertainty),
        100.0 * check.residual,
        explained(check.residual_uncertainty),
    )
}

fn summarise_drift(calibration: &Calibration, drift: &Drift, out: &mut dyn Write) -> io::Result<()> {
    if calibration.trials.iter().any(|trial| trial.known_loads > 0) {
        writeln!(
            out,
            "the stored calibration orients the trials: their known loads are compared with it, not used"
        )?;
    }
    writeln!(
        out,
        "moved since the stored calibration ({} of {} components seen; behind ± what noise, masses and arms would show of an unmoved one):",
        drift.components_seen,
        calibration.dof.count()
    )?;
    let line = |out: &mut dyn Write, name: &str, moved: Moved| {
        let Moved { percent, uncertainty_percent } = moved;
        let verdict = if moved.is_real() { "  moved" } else { "" };
        writeln!(out, "{name:<8} {percent:8.3} % ± {uncertainty_percent:.3} %{verdict}")
    };
    for (gage, moved) in drift.gages().enumerate() {
        line(out, &format!("ch{gage}"), moved)?;
    }
    for (axis, moved) in calibration.dof.axes().iter().zip(drift.axes()) {
        line(out, symbol(*axis), moved)?;
    }
    if !drift.gages().chain(drift.axes()).any(Moved::is_real) {
        writeln!(out, "nothing that the arms see has moved by more than three times its uncertainty")?;
    }
    Ok(())
}

/// Says what another gravity than that of the stored calibration does to the drift.
fn compare_gravity(before: f64, now: f64, out: &mut dyn Write) -> io::Result<()> {
    let change = now / before - 1.0;
    if change.abs() <= SAME_GRAVITY {
        return Ok(());
    }
    writeln!(
        out,
        "gravity is {now} m/s² in the session and {before} m/s² in the stored calibration: if both are of one place, \
         {:.3} % of every change is that",
        100.0 * change.abs()
    )
}

/// The name of a sensor as a session spells it.
const fn dof_name(dof: Dof) -> &'static str {
    match dof {
        Dof::PlanarForce => "planar-force",
        Dof::SpatialForce => "spatial-force",
        Dof::PlanarForceTorque => "planar-force-torque",
        Dof::SpatialForceTorque => "spatial-force-torque",
    }
}
