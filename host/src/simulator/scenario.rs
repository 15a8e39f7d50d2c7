//! The four systems of the paper as simulated sensors, each with the trials that calibrate it.
//!
//! | scenario | paper | gages | trials |
//! |---|---|---|---|
//! | fingertip | figure 3: planar force on a cantilever | 4 around the beam | 111.4 g, no arm |
//! | force | "3-DOF Force Sensor" | 6 inclined struts | 1.5 kg, no arm |
//! | planar | eq. 14 to 18: planar force and torque | 4 spokes in a ring | 0.5 kg at two arms |
//! | wrist | eq. 19, 20: all six components | 8 on the four beams of a cross | 2 kg at three arms |
//!
//! From the seed come what distinguishes one built sensor from the next of its kind: every gage's sensitivity is off by
//! about 5 %, every entry of the shape carries cross-talk of about 3 % of its row, the bias is anywhere within ±5 % of
//! full scale, and each gage's noise is between 0.05 and 0.2 % of the signal. The gain is that of a designer who
//! wants the strongest calibration signal at 35 % of full scale.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, PI};

use ftcal_shared::units::Dof;
use nalgebra::{DMatrix, DVector, UnitVector3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::bench::{Load, STANDARD_GRAVITY};
use super::motion::Turning;
use super::sensor::{FULL_SCALE_COUNTS, SensorError, SoftwareSensor, Wrench};
use super::{Purpose, random_sequence};

/// The strongest gage's signal in any calibration trial, as a fraction of full scale.
const WORKING_RANGE: f64 = 0.35;
/// Standard deviation of a gage's sensitivity, relative.
const SENSITIVITY_SCATTER: f64 = 0.05;
/// Standard deviation of the cross-talk, relative to the root mean square of the shape's row.
const CROSS_TALK: f64 = 0.03;
/// Largest bias, as a fraction of full scale.
const LARGEST_BIAS: f64 = 0.05;
/// Range of a gage's noise, relative to the root-mean-square signal.
const NOISE: std::ops::Range<f64> = 0.0005..0.002;

/// Which of the four systems.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ScenarioKind {
    /// Two forces in the plane: 4 gages, one trial.
    Fingertip,
    /// Three forces: 6 gages, one trial.
    Force,
    /// Two forces and the torque in the plane: 4 gages, two moment arms.
    Planar,
    /// Three forces and three torques: 8 gages, three moment arms.
    Wrist,
}

impl ScenarioKind {
    /// Every scenario, simplest first.
    pub const ALL: [Self; 4] = [Self::Fingertip, Self::Force, Self::Planar, Self::Wrist];
}

/// One calibration trial: a load, how it is turned, and the known directions in which it is then held.
#[derive(Clone, Debug, PartialEq)]
pub struct ScenarioTrial {
    /// The load that hangs on the sensor.
    pub load: Load,
    /// In the plane, the sense in which the force turns in the sensor frame; in space none.
    pub turning: Option<Turning>,
    /// Directions of the force in the sensor frame for the known loads; three in space settle the handedness, one in
    /// the plane does so together with the sense of turning (design § 6).
    pub known_directions: Vec<UnitVector3<f64>>,
}

/// A sensor, its calibration, and the loads that are kept to judge it by.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// The sensor with its truth.
    pub sensor: SoftwareSensor,
    /// The trials of its calibration.
    pub trials: Vec<ScenarioTrial>,
    /// Loads never used in calibration.
    pub validation: Vec<Load>,
}

impl Scenario {
    /// The scenario of this kind, with a sensor from this seed.
    ///
    /// # Errors
    /// Never for the four kinds; a sensor checks its own sizes.
    pub fn new(kind: ScenarioKind, seed: u64) -> Result<Self, SensorError> {
        let mut random = random_sequence(seed, Purpose::Sensor);
        let (dof, ideal) = match kind {
            ScenarioKind::Fingertip => (Dof::PlanarForce, cantilever()),
            ScenarioKind::Force => (Dof::SpatialForce, struts()),
            ScenarioKind::Planar => (Dof::PlanarForceTorque, spokes(0.025)),
            ScenarioKind::Wrist => (Dof::SpatialForceTorque, cross(0.04)),
        };
        let trials: Vec<_> = calibration_loads(kind)
            .into_iter()
            .map(|load| {
                let (turning, known_directions) = if dof.trial_rank() == 2 {
                    (Some(Turning::Counterclockwise), vec![-Vector3::y_axis()])
                } else {
                    (None, vec![-Vector3::z_axis(), Vector3::x_axis(), Vector3::y_axis()])
                };
                ScenarioTrial { load, turning, known_directions }
            })
            .collect();
        let validation = validation_loads(kind);
        Ok(Self { sensor: build(dof, &ideal, &trials, &mut random)?, trials, validation })
    }
}

/// A load of this mass at this arm.
fn load(mass_kg: f64, x_m: f64, y_m: f64, z_m: f64) -> Load {
    Load { mass_kg, arm_m: Vector3::new(x_m, y_m, z_m) }
}

/// The loads of the calibration trials. The wrist's arms are not collinear and span 5 to 15 cm.
fn calibration_loads(kind: ScenarioKind) -> Vec<Load> {
    match kind {
        ScenarioKind::Fingertip => vec![load(0.1114, 0.0, 0.0, 0.0)],
        ScenarioKind::Force => vec![load(1.5, 0.0, 0.0, 0.0)],
        ScenarioKind::Planar => vec![load(0.5, 0.06, 0.01, 0.0), load(0.5, -0.03, 0.05, 0.0)],
        ScenarioKind::Wrist => {
            vec![load(2.0, 0.10, 0.02, 0.05), load(2.0, -0.06, 0.08, 0.06), load(2.0, -0.03, -0.07, 0.12)]
        }
    }
}

/// Other masses, and other arms where the sensor feels them.
fn validation_loads(kind: ScenarioKind) -> Vec<Load> {
    match kind {
        ScenarioKind::Fingertip => {
            [0.0604, 0.0783, 0.0952, 0.1228].map(|mass_kg| load(mass_kg, 0.0, 0.0, 0.0)).to_vec()
        }
        ScenarioKind::Force => [0.944, 2.0].map(|mass_kg| load(mass_kg, 0.0, 0.0, 0.0)).to_vec(),
        ScenarioKind::Planar => vec![load(0.3, 0.02, -0.05, 0.0), load(0.7, 0.04, 0.02, 0.0)],
        ScenarioKind::Wrist => vec![load(1.2, 0.04, -0.06, 0.09), load(2.5, 0.05, 0.05, 0.04)],
    }
}

/// Bending strain around a round beam: a gage at angle φ feels the force along φ.
fn cantilever() -> DMatrix<f64> {
    DMatrix::from_fn(2, 4, |axis, gage| {
        let angle = gage as f64 * FRAC_PI_2;
        if axis == 0 { angle.cos() } else { angle.sin() }
    })
}

/// Six struts, inclined by 40° to the mounting plane: each feels the force along itself.
fn struts() -> DMatrix<f64> {
    let (rise, run) = 40.0_f64.to_radians().sin_cos();
    DMatrix::from_fn(3, 6, |axis, gage| {
        let angle = gage as f64 * FRAC_PI_3;
        match axis {
            0 => run * angle.cos(),
            1 => run * angle.sin(),
            _ => rise,
        }
    })
}

/// Four spokes at this radius (metre), at right angles, from hub to rim: each feels the force across itself in the
/// plane. Rows: fx, fy, tz. The spokes' forces across themselves add up to the load: fx = −Σ t·sin, fy = Σ t·cos,
/// tz = Σ t·r.
fn spokes(radius_m: f64) -> DMatrix<f64> {
    DMatrix::from_fn(3, 4, |axis, spoke| {
        let angle = spoke as f64 * FRAC_PI_2 + PI / 8.0;
        match axis {
            0 => -0.5 * angle.sin(),
            1 => 0.5 * angle.cos(),
            _ => 0.25 / radius_m,
        }
    })
}

/// A Maltese cross: four beams with two gage bridges each, one for bending in the plane (as a spoke), one for bending
/// out of it. Rows: fx, fy, fz, tx, ty, tz. With a vertical force v at each beam's end, fz = Σ v and the torques are
/// tx = Σ v·r·sin, ty = −Σ v·r·cos.
fn cross(radius_m: f64) -> DMatrix<f64> {
    let in_plane = spokes(radius_m);
    let mut shape = DMatrix::zeros(6, 8);
    for beam in 0..4 {
        let angle = beam as f64 * FRAC_PI_2 + PI / 8.0;
        shape[(0, beam)] = in_plane[(0, beam)];
        shape[(1, beam)] = in_plane[(1, beam)];
        shape[(5, beam)] = in_plane[(2, beam)];
        shape[(2, 4 + beam)] = 0.25;
        shape[(3, 4 + beam)] = 0.5 * angle.sin() / radius_m;
        shape[(4, 4 + beam)] = -0.5 * angle.cos() / radius_m;
    }
    shape
}

/// A built sensor: the ideal shape with its tolerances, bias and noise, scaled to the converter's range.
fn build(
    dof: Dof,
    ideal: &DMatrix<f64>,
    trials: &[ScenarioTrial],
    random: &mut ChaCha8Rng,
) -> Result<SoftwareSensor, SensorError> {
    let normal = |random: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(random) };
    let gages = ideal.ncols();
    let mut shape = ideal.clone();
    for mut gage in shape.column_iter_mut() {
        gage *= 1.0 + SENSITIVITY_SCATTER * normal(random);
    }
    for mut row in shape.row_iter_mut() {
        let cross_talk = CROSS_TALK * row.norm() / (gages as f64).sqrt();
        for entry in row.iter_mut() {
            *entry += cross_talk * normal(random);
        }
    }
    let signals: Vec<f64> =
        trials.iter().flat_map(|trial| signal_amplitudes(dof, &shape, &trial.load)).collect();
    let strongest = signals.iter().copied().fold(0.0, f64::max);
    shape *= WORKING_RANGE * FULL_SCALE_COUNTS / strongest;
    let mean_square = signals.iter().map(|signal| signal * signal).sum::<f64>() / signals.len() as f64;
    let signal_counts = mean_square.sqrt() * WORKING_RANGE * FULL_SCALE_COUNTS / strongest;
    let bias =
        DVector::from_fn(gages, |_, _| FULL_SCALE_COUNTS * random.random_range(-LARGEST_BIAS..LARGEST_BIAS));
    let noise = DVector::from_fn(gages, |_, _| signal_counts * random.random_range(NOISE));
    SoftwareSensor::new(dof, shape, bias, noise)
}

/// The largest signal of each gage while this load turns through every direction, in the shape's unit of counts.
///
/// The signal is linear in the force's direction, so its amplitude is the norm of its values along the axes.
fn signal_amplitudes(dof: Dof, shape: &DMatrix<f64>, load: &Load) -> Vec<f64> {
    let mut squares = DVector::zeros(shape.ncols());
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()].into_iter().take(dof.trial_rank()) {
        let wrench = Wrench::of_force_at(axis * (load.mass_kg * STANDARD_GRAVITY), &load.arm_m);
        let signal = shape.tr_mul(&wrench.components(dof));
        squares += signal.component_mul(&signal);
    }
    squares.iter().map(|square: &f64| square.sqrt()).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, Matrix3};

    use super::{FULL_SCALE_COUNTS, LARGEST_BIAS, Scenario, ScenarioKind, WORKING_RANGE, signal_amplitudes};

    fn every_scenario(check: impl Fn(ScenarioKind, &Scenario)) {
        for kind in ScenarioKind::ALL {
            for seed in 0..20 {
                check(kind, &Scenario::new(kind, seed).expect("sizes fit"));
            }
        }
    }

    /// Singular values, torques counted at 5 cm so that the unit of length does not decide (design § 7).
    fn condition(shape: &DMatrix<f64>, forces: usize) -> f64 {
        let mut scaled = shape.clone();
        for mut torque in scaled.row_iter_mut().skip(forces) {
            torque *= 0.05;
        }
        let values = scaled.singular_values();
        values.max() / values.min()
    }

    #[test]
    fn every_shape_has_full_rank_and_is_well_conditioned() {
        every_scenario(|kind, scenario| {
            let forces = if scenario.sensor.dof().trial_rank() == 2 { 2 } else { 3 };
            let condition = condition(scenario.sensor.shape(), forces);
            assert!(condition < 8.0, "{kind:?}: {condition}");
        });
    }

    #[test]
    fn signals_use_a_tenth_to_four_tenths_of_the_range_and_never_clip() {
        every_scenario(|kind, scenario| {
            let sensor = &scenario.sensor;
            let amplitudes = |load| signal_amplitudes(sensor.dof(), sensor.shape(), load);
            let mut strongest = vec![0.0_f64; sensor.gages()];
            for trial in &scenario.trials {
                for (most, signal) in strongest.iter_mut().zip(amplitudes(&trial.load)) {
                    *most = most.max(signal / FULL_SCALE_COUNTS);
                }
            }
            assert!(strongest.iter().all(|&most| (0.1..0.4).contains(&most)), "{kind:?}: {strongest:?}");
            let most = strongest.iter().copied().fold(0.0, f64::max);
            assert!((most - WORKING_RANGE).abs() < 1e-12);
            for load in &scenario.validation {
                for (signal, bias) in amplitudes(load).into_iter().zip(sensor.bias_counts().iter()) {
                    assert!(signal + bias.abs() < 0.8 * FULL_SCALE_COUNTS, "{kind:?}");
                    assert!(bias.abs() <= LARGEST_BIAS * FULL_SCALE_COUNTS);
                }
            }
        });
    }

    #[test]
    fn arms_and_known_directions_determine_the_answer() {
        every_scenario(|kind, scenario| {
            for trial in &scenario.trials {
                let directions = &trial.known_directions;
                if let [a, b, c] = directions.as_slice() {
                    assert!(Matrix3::from_columns(&[**a, **b, **c]).determinant().abs() > 0.5, "{kind:?}");
                } else {
                    assert!(trial.turning.is_some() && directions.len() == 1, "{kind:?}");
                }
            }
            let arms: Vec<_> = scenario.trials.iter().map(|trial| trial.load.arm_m).collect();
            if let [a, b, c] = arms.as_slice() {
                assert!((b - a).cross(&(c - a)).norm() > 0.005, "not collinear, area in square metres");
                assert!(arms.iter().all(|arm| (0.05..0.15).contains(&arm.norm())));
            }
        });
    }

    #[test]
    fn a_seed_is_a_sensor() {
        for kind in ScenarioKind::ALL {
            assert_eq!(Scenario::new(kind, 7), Scenario::new(kind, 7));
            assert_ne!(Scenario::new(kind, 7), Scenario::new(kind, 8));
        }
    }
}
