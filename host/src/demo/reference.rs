//! The reference: least squares on 13 known loads (eq. 3), as the paper calibrates its wrist sensor for comparison.
//!
//! Masses, arms and directions vary from load to load, so that every component is excited; each load is applied with the
//! bench's [`super::Workmanship`] and averaged at rest, like the known loads of shape from motion.

use std::io::Write;

use nalgebra::{DVector, Unit, UnitVector3, Vector3};

use super::trials::{GRAVITY, arm_components, hold_and_record};
use super::{DemoError, Stage};
use crate::calibration::consistency::ARM_ACCURACY_M;
use crate::calibration::known_load::{KnownLoad, LoadCase, average};
use crate::calibration::{Calibration, CalibrationRefusal, least_squares};
use crate::simulator::bench::Load;
use crate::simulator::scenario::Scenario;

/// Known loads: as many as the paper applied to its six-axis sensor in 69 minutes.
pub const KNOWN_LOADS: usize = 13;

/// Masses as shares of the trials' mass; the paper used 12.09, 22.9 and 33.71 N.
const MASS_SHARES: [f64; 3] = [1.0, 0.68, 0.36];

/// Calibrates the sensor on the bench by least squares.
///
/// # Errors
///
/// [`DemoError`].
pub fn calibrate(
    stage: &mut Stage,
    scenario: &Scenario,
    progress: &mut dyn Write,
) -> Result<Calibration, DemoError> {
    writeln!(progress, "For comparison: least squares on {KNOWN_LOADS} known loads …")?;
    let dof = scenario.sensor.dof();
    let rank = dof.trial_rank();
    let mut cases = Vec::with_capacity(KNOWN_LOADS);
    for number in 0..KNOWN_LOADS {
        let load = known_load(scenario, number);
        let direction = direction(rank, number);
        let rest = hold_and_record(stage, load, direction)?;
        cases.push(LoadCase {
            name: format!("known load {}", number + 1),
            mass_kg: load.mass_kg,
            arm_m: arm_components(dof, &load),
            arm_accuracy_m: ARM_ACCURACY_M,
            mass_accuracy_kg: stage.workmanship.force_newton / GRAVITY,
            known_loads: vec![KnownLoad {
                direction: DVector::from_iterator(rank, direction.iter().copied().take(rank)),
                accuracy_rad: stage.workmanship.direction_rad,
                rest: average(&rest)
                    .ok_or(CalibrationRefusal::KnownLoadSaturated { trial: number, load: 0 })?,
            }],
        });
    }
    Ok(least_squares::calibrate(dof, GRAVITY, &cases, None)?)
}

/// Arms change with every load, masses with every round of the arms.
fn known_load(scenario: &Scenario, number: usize) -> Load {
    let arms = scenario.trials.len();
    let trial = scenario.trials[number % arms].load;
    Load { mass_kg: trial.mass_kg * MASS_SHARES[(number / arms) % MASS_SHARES.len()], ..trial }
}

/// In space the six faces of the fixture's cube and seven of its corners, in the plane every 360°/13.
fn direction(rank: usize, number: usize) -> UnitVector3<f64> {
    if rank == 2 {
        let angle = std::f64::consts::TAU * number as f64 / KNOWN_LOADS as f64;
        return Unit::new_normalize(Vector3::new(angle.cos(), angle.sin(), 0.0));
    }
    let sign = |bit: usize| if number >> bit & 1 == 0 { 1.0 } else { -1.0 };
    let vector = match number {
        0..=5 => Vector3::ith(number / 2, sign(0)),
        _ => Vector3::new(sign(0), sign(1), sign(2)),
    };
    Unit::new_normalize(vector)
}
