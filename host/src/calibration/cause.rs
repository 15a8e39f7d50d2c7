//! Why a trial's hand is not settled, where that can be told: all its known loads look the same in a mirror that nobody can tell
//! from the world (design § 6, § 7).
//!
//! That mirror is the plane of all arms: the trials still fit together when all are mirrored in it, and a load in it, or along its
//! normal, stays where it is (the latter up to its sign, which mirroring the trial once more gives back).

use nalgebra::{DMatrix, DVector};

use super::singular::Singular;
use super::{CalibrationRefusal, SolvedTrial};

/// How far from the plane of the arms, and from its normal, a direction must be to tell the sides apart, radian (10°).
const LEAST_ANGLE: f64 = 0.175;

/// Arms whose distances from a plane are below this share of their distances from each other lie in it.
const FLAT: f64 = 0.05;

/// The refusal with a cause of its own where every known load of the trials that may be mirrored lies in the plane of the arms or
/// along its normal; any other as it is.
pub fn named(refusal: CalibrationRefusal, trials: &[SolvedTrial]) -> CalibrationRefusal {
    let CalibrationRefusal::HandednessNotSettled { trials: unsettled, .. } = &refusal else { return refusal };
    let Some(normal) = normal_of_arms(trials) else { return refusal };
    let loads = |trial: &usize| trials.get(*trial).map_or(&[][..], |trial| &trial.case.known_loads);
    if unsettled.iter().any(|trial| loads(trial).is_empty()) {
        return refusal;
    }
    let tells = |direction: &DVector<f64>| {
        let angle = direction.dot(&normal).abs().clamp(0.0, 1.0).asin();
        (LEAST_ANGLE..std::f64::consts::FRAC_PI_2 - LEAST_ANGLE).contains(&angle)
    };
    if unsettled.iter().flat_map(loads).any(|load| tells(&load.direction)) {
        return refusal;
    }
    CalibrationRefusal::LoadsInPlaneOfArms { trials: unsettled.clone() }
}

/// The normal of the plane (in the plane: of the line) in which all arms end; `None` where they end in none, or there are no arms.
fn normal_of_arms(trials: &[SolvedTrial]) -> Option<DVector<f64>> {
    let arms: Vec<&DVector<f64>> = trials.iter().map(|trial| &trial.case.arm_m).collect();
    let rank = arms.first().map_or(0, |arm| arm.len());
    if rank < 2 || arms.len() < rank {
        return None;
    }
    let mean = arms.iter().copied().sum::<DVector<f64>>() / arms.len() as f64;
    let offsets = DMatrix::from_fn(rank, arms.len(), |axis, arm| arms[arm][axis] - mean[axis]);
    let Singular { left, values, .. } = Singular::of(&offsets);
    (values[rank - 1] <= FLAT * values[0]).then(|| left.column(rank - 1).into_owned())
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;

    use crate::calibration::synthetic::{Rests, Sensor, flat, spatial};
    use crate::calibration::{CalibrationRefusal, SolvedTrial, calibrate};
    use crate::session_file::STANDARD_GRAVITY;

    #[test]
    fn loads_that_the_mirror_of_the_arms_leaves_are_named_as_the_cause() {
        let arms = [[0.1, 0.0, 0.05], [0.0, 0.1, 0.05], [-0.05, -0.05, 0.05]];
        let inside = vec![spatial(1.0, 0.0, 0.0), spatial(0.2, 1.0, 0.0)];
        let slanting = vec![spatial(1.0, 0.0, 1.0), spatial(0.2, 1.0, 0.0)];
        for (directions, settled) in
            [(inside, false), (vec![spatial(0.0, 0.0, 1.0)], false), (slanting, true)]
        {
            let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 5);
            let rests = Rests { directions, accuracy_rad: 1e-3 };
            let trials: Vec<SolvedTrial> = arms.iter().map(|arm| sensor.trial(2.0, arm, &rests)).collect();
            match calibrate(sensor.dof, STANDARD_GRAVITY, &trials) {
                Ok(_) => assert!(settled),
                Err(CalibrationRefusal::LoadsInPlaneOfArms { .. }) => assert!(!settled),
                Err(other) => panic!("{other:?}"),
            }
        }
    }

    #[test]
    fn a_sensor_without_arms_keeps_its_cause() {
        let mut sensor = Sensor::new(Dof::PlanarForce, 4, 5);
        let trial = sensor.trial(1.0, &[], &Rests { directions: vec![flat(0.3)], accuracy_rad: 1e-3 });
        let refused = calibrate(sensor.dof, STANDARD_GRAVITY, &[trial]);
        assert!(matches!(refused, Err(CalibrationRefusal::HandednessNotSettled { .. })), "{refused:?}");
    }
}
