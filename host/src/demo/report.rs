//! The demonstration in numbers: against the truth, which only a simulation knows, and against loads never used.

use std::io::{self, Write};

use ftcal_shared::units::Dof;
use nalgebra::{DMatrix, DVector};

use super::reference::KNOWN_LOADS;
use super::trials::GRAVITY;
use super::validation::{MeasuredLoad, Orientation};
use crate::calibration::Calibration;
use crate::component::{is_force, symbol, unit};
use crate::simulator::scenario::Scenario;

/// What the sensor measures, in words.
pub const fn in_words(dof: Dof) -> &'static str {
    match dof {
        Dof::PlanarForce => "two forces in a plane",
        Dof::SpatialForce => "three forces",
        Dof::PlanarForceTorque => "two forces and the torque in a plane",
        Dof::SpatialForceTorque => "three forces and three torques",
    }
}

/// Writes the tables.
///
/// # Errors
///
/// Those of the destination.
pub fn write(
    scenario: &Scenario,
    shape_from_motion: &Calibration,
    least_squares: &Calibration,
    measured: &[MeasuredLoad],
    out: &mut dyn Write,
) -> io::Result<()> {
    against_truth(scenario, shape_from_motion, least_squares, out)?;
    magnitudes(measured, shape_from_motion.dof, out)?;
    errors(measured, shape_from_motion.dof, out)
}

fn against_truth(
    scenario: &Scenario,
    shape_from_motion: &Calibration,
    least_squares: &Calibration,
    out: &mut dyn Write,
) -> io::Result<()> {
    let full_load = full_load(scenario);
    let columns = [shape_from_motion, least_squares]
        .map(|calibration| AxisErrors::of(calibration, scenario, &full_load));
    writeln!(out, "Calibration matrix against the truth, per cent of the full load of each axis")?;
    writeln!(
        out,
        "                        shape from motion        least squares, {KNOWN_LOADS} known loads"
    )?;
    writeln!(out, "  axis  full load         gain   cross-talk        gain   cross-talk")?;
    for (row, &axis) in scenario.sensor.dof().axes().iter().enumerate() {
        writeln!(
            out,
            "  {}    {:7.3} {:<4}   {:+9.4}  {:9.4}     {:+9.4}  {:9.4}",
            symbol(axis),
            full_load[row],
            unit(axis),
            columns[0].gain_percent[row],
            columns[0].cross_talk_percent[row],
            columns[1].gain_percent[row],
            columns[1].cross_talk_percent[row],
        )?;
    }
    let [ours, theirs] = [shape_from_motion, least_squares].map(|calibration| {
        let error = &calibration.matrix * (&calibration.bias_counts - scenario.sensor.bias_counts());
        100.0 * error.component_div(&full_load).amax()
    });
    writeln!(out, "  bias, worst axis       {ours:9.4}                   {theirs:9.4}")
}

/// The load of one trial in every component: force from the mass, torque from mass and root mean square arm.
fn full_load(scenario: &Scenario) -> DVector<f64> {
    let trials = scenario.trials.len() as f64;
    let force = GRAVITY * scenario.trials.iter().map(|trial| trial.load.mass_kg).sum::<f64>() / trials;
    let squares: f64 = scenario.trials.iter().map(|trial| trial.load.arm_m.norm_squared()).sum();
    let torque = force * (squares / trials).sqrt();
    let axes = scenario.sensor.dof().axes();
    DVector::from_iterator(axes.len(), axes.iter().map(|&axis| if is_force(axis) { force } else { torque }))
}

/// C S̃ᵀ is the identity for a perfect calibration of a sensor with shape S̃; this is how far it is from that.
struct AxisErrors {
    gain_percent: Vec<f64>,
    /// The worst of the other axes at their full load.
    cross_talk_percent: Vec<f64>,
}

impl AxisErrors {
    fn of(calibration: &Calibration, scenario: &Scenario, full_load: &DVector<f64>) -> Self {
        let components = full_load.len();
        let error = &calibration.matrix * scenario.sensor.shape().transpose()
            - DMatrix::identity(components, components);
        let percent =
            |row: usize, column: usize| 100.0 * error[(row, column)] * full_load[column] / full_load[row];
        let cross_talk = |row: usize| {
            (0..components)
                .filter(|&column| column != row)
                .map(|column| percent(row, column).abs())
                .fold(0.0, f64::max)
        };
        Self {
            gain_percent: (0..components).map(|row| percent(row, row)).collect(),
            cross_talk_percent: (0..components).map(cross_talk).collect(),
        }
    }
}

fn magnitudes(measured: &[MeasuredLoad], dof: Dof, out: &mut dyn Write) -> io::Result<()> {
    writeln!(
        out,
        "\nForce magnitude of loads never used, over all orientations (as the paper's tables 1 and 2)"
    )?;
    writeln!(out, "               shape from motion                 least squares")?;
    writeln!(out, "  true N      mean N   error %    std N       mean N   error %    std N")?;
    for MeasuredLoad { load, orientations } in measured {
        let truth = load.mass_kg * GRAVITY;
        write!(out, "  {truth:7.4}")?;
        for estimate in ESTIMATES {
            let forces: Vec<f64> =
                orientations.iter().map(|orientation| force(estimate(orientation), dof).norm()).collect();
            let (mean, std) = mean_and_std(&forces);
            write!(out, "   {mean:8.4}  {:+8.4}  {std:7.4} ", 100.0 * (mean - truth) / truth)?;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn errors(measured: &[MeasuredLoad], dof: Dof, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "\nAverage error of one wrench (as the paper's table 3)")?;
    writeln!(out, "                        shape from motion   least squares")?;
    let all = || measured.iter().flat_map(|load| &load.orientations);
    let row = |name: &str, unit: &str, error: &dyn Fn(&Orientation, &DVector<f64>) -> f64| {
        let [ours, theirs] = ESTIMATES.map(|estimate| {
            let errors: Vec<f64> =
                all().map(|orientation| error(orientation, estimate(orientation))).collect();
            mean_and_std(&errors).0
        });
        format!("  {name:<18} {unit:<6}{ours:10.5}        {theirs:10.5}")
    };
    let magnitude = |orientation: &Orientation, estimate: &DVector<f64>| {
        (force(estimate, dof).norm() - force(&orientation.truth, dof).norm()).abs()
    };
    writeln!(out, "{}", row("force magnitude", "N", &magnitude))?;
    let angle =
        |orientation: &Orientation, estimate: &DVector<f64>| angle_milliradian(orientation, estimate, dof);
    writeln!(out, "{}", row("force direction", "mrad", &angle))?;
    if dof.has_torque() {
        let torque = |orientation: &Orientation, estimate: &DVector<f64>| {
            let forces = dof.trial_rank();
            (estimate - &orientation.truth).rows(forces, dof.count() - forces).norm()
        };
        writeln!(out, "{}", row("torque", "N m", &torque))?;
    }
    Ok(())
}

/// The two calibrations' wrenches of one orientation.
const ESTIMATES: [fn(&Orientation) -> &DVector<f64>; 2] =
    [|orientation| &orientation.shape_from_motion, |orientation| &orientation.least_squares];

/// The force of a wrench, newton.
pub fn force(wrench: &DVector<f64>, dof: Dof) -> DVector<f64> {
    wrench.rows(0, dof.trial_rank()).into_owned()
}

/// The angle between the measured and the true force, milliradian.
pub fn angle_milliradian(orientation: &Orientation, estimate: &DVector<f64>, dof: Dof) -> f64 {
    let (measured, truth) = (force(estimate, dof).normalize(), force(&orientation.truth, dof).normalize());
    // The chord keeps its precision where the cosine has lost it.
    1000.0 * 2.0 * ((measured - truth).norm() / 2.0).min(1.0).asin()
}

fn mean_and_std(values: &[f64]) -> (f64, f64) {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    (mean, variance.sqrt())
}
