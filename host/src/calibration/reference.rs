//! Field re-calibration with no known load: the stored shape says how the sensor frame lies (design § 8).
//!
//! Each new trial tells its shape up to a turn. The calibration in store predicts that shape at the trial's arm; the turn that
//! brings the one closest to the other ([`super::procrustes`]) orients it. What is left is how far the sensor has moved. The
//! trials' shapes, oriented so, correct the stored shape by the least change that explains them:
//!
//! ```text
//! S̃ = S̃₀ + [I Xᵀ]⁺ (stack − [I Xᵀ] S̃₀)
//! ```
//!
//! With arms that suffice for a calibration this is their fusion (eq. 18, 20), whatever S̃₀; with fewer it leaves as it was what
//! they do not see.
//!
//! **What cannot be told.** A drift that acts like a turn of the sensor frame is taken for one. A drift of random gains has such
//! a part, smaller than the part that shows by √(turns ÷ coefficients); so the answer is refused where the part that shows is
//! large (`LARGEST_DRIFT`), or where the other hand fits nearly as well.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::fusion::stack;
use super::known_load::squashing_matrix;
use super::matrix::matrix_of_shape;
use super::procrustes::onto;
use super::singular::Singular;
use super::{
    BiasOrigin, Calibration, CalibrationRefusal, Handedness, HandednessEvidence, Method, SolutionRecord,
    SolvedTrial, TrialRecord, common_bias,
};

/// The largest drift, relative, that is still told from a turn: the turn that hides in it is at most about half of it, which
/// is 3° here.
const LARGEST_DRIFT: f64 = 0.1;

/// How many times worse the other hand must fit.
const HAND_MARGIN: f64 = 3.0;

/// Combinations of rows that the arms see less than this, relative, they do not see.
const LEAST_SEEN: f64 = 1e-2;

/// How far the sensor has moved since its stored calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Change of each gage's response (p), percent of it.
    pub gage_percent: Vec<f64>,
    /// How far each component (m) would be off if the stored calibration were still used, percent of a load along it.
    pub axis_percent: Vec<f64>,
    /// How many of the m components the arms see; the others are as they were.
    pub components_seen: u64,
}

/// Calibrates from trials and a stored calibration, with no known load.
///
/// # Errors
///
/// [`CalibrationRefusal::ReferenceDiffers`] where the sensor is another, or has moved too far;
/// [`CalibrationRefusal::BiasesDisagree`], [`CalibrationRefusal::ShapeRankDeficient`], [`CalibrationRefusal::NonFinite`].
pub fn recalibrate(
    stored: &Calibration,
    gravity: f64,
    trials: &[SolvedTrial],
) -> Result<Calibration, CalibrationRefusal> {
    let rank = stored.dof.trial_rank();
    let mut oriented = Vec::with_capacity(trials.len());
    let mut records = Vec::with_capacity(trials.len());
    for (index, trial) in trials.iter().enumerate() {
        if trial.shape.gages() != stored.gages() {
            return Err(CalibrationRefusal::TooFewGages { gages: trial.shape.gages(), need: stored.gages() });
        }
        let shape = &trial.shape.shape_counts_per_load / (trial.case.mass_kg * gravity);
        let predicted = squashing_matrix(rank, &trial.case.arm_m) * &stored.shape;
        let found = onto(&shape, &predicted);
        let told_apart = found.residual <= LARGEST_DRIFT && found.other_hand >= HAND_MARGIN * found.residual;
        if !told_apart {
            return Err(CalibrationRefusal::ReferenceDiffers {
                trial: index,
                drift: found.residual,
                other_hand: found.other_hand,
                need: LARGEST_DRIFT,
            });
        }
        records.push(record(trial));
        oriented.push(found.turned);
    }

    let lengths = lengths(stored);
    let squashing = scaled_squashing(rank, trials, &lengths);
    let seen = Singular::of(&squashing);
    let components_seen = seen.rank(LEAST_SEEN);
    let before = scaled(&stored.shape, &lengths);
    let stacked = stack(&oriented);
    let after = &before + seen.pseudo_inverse(components_seen) * (&stacked - &squashing * &before);
    let misfit = (&stacked - &squashing * &after).norm() / stacked.norm();
    let shape = scaled(&after, &lengths.map(f64::recip));
    let matrix = matrix_of_shape(&shape).map_err(|_| CalibrationRefusal::ShapeRankDeficient)?;
    Calibration {
        dof: stored.dof,
        method: Method::Sfm,
        gravity,
        matrix,
        bias_counts: common_bias(trials)?,
        bias: BiasOrigin::Estimated,
        uncertainty: None,
        drift: Some(drift(stored, &before, &after, &lengths, components_seen)),
        shape,
        handedness: Handedness::Proven,
        fusion_residual: misfit,
        trials: records,
        checks: Vec::new(),
    }
    .finite()
}

fn record(trial: &SolvedTrial) -> TrialRecord {
    TrialRecord {
        solution: Some(SolutionRecord {
            samples: trial.shape.samples.clone(),
            eigenvalues: trial.shape.eigenvalues.iter().copied().collect(),
            noise_counts: trial.shape.noise_counts,
            bias_counts: trial.shape.bias_counts.iter().copied().collect(),
            alignment_residual_deg: 0.0,
            handedness: HandednessEvidence::Reference,
        }),
        ..trial.case.record()
    }
}

/// What brings a row of the stored shape to one unit: one for forces, the length in metre at which torques answer as forces do.
fn lengths(stored: &Calibration) -> DVector<f64> {
    let (rank, rows) = (stored.dof.trial_rank(), stored.dof.count());
    let mean =
        |from: usize, count: usize| stored.shape.rows(from, count).norm() / (count.max(1) as f64).sqrt();
    let length = if rows > rank { mean(0, rank) / mean(rank, rows - rank) } else { 1.0 };
    DVector::from_fn(rows, |row, _| if row < rank { 1.0 } else { length })
}

/// The rows of a shape, each times its length.
fn scaled(shape: &DMatrix<f64>, lengths: &DVector<f64>) -> DMatrix<f64> {
    let mut scaled = shape.clone();
    for (mut row, &length) in scaled.row_iter_mut().zip(lengths) {
        row *= length;
    }
    scaled
}

/// [I Xᵀ] of all trials, one above the other, its columns over the lengths.
fn scaled_squashing(rank: usize, trials: &[SolvedTrial], lengths: &DVector<f64>) -> DMatrix<f64> {
    let blocks: Vec<DMatrix<f64>> =
        trials.iter().map(|trial| squashing_matrix(rank, &trial.case.arm_m)).collect();
    let mut squashing = stack(&blocks);
    for (mut column, &length) in squashing.column_iter_mut().zip(lengths) {
        column /= length;
    }
    squashing
}

/// How far the shape has moved, both shapes with rows of one unit.
fn drift(
    stored: &Calibration,
    before: &DMatrix<f64>,
    after: &DMatrix<f64>,
    lengths: &DVector<f64>,
    components_seen: usize,
) -> Drift {
    let percent = |part: f64, whole: f64| 100.0 * part / whole;
    let gages = before.column_iter().zip(after.column_iter());
    // Readings of the stored matrix for a unit load along each component of the sensor as it is now.
    let inverse = scaled(&stored.matrix, &lengths.map(f64::recip));
    let error = inverse * after.transpose() - DMatrix::identity(before.nrows(), before.nrows());
    Drift {
        gage_percent: gages.map(|(before, after)| percent((after - before).norm(), before.norm())).collect(),
        axis_percent: error.column_iter().map(|column| percent(column.norm(), 1.0)).collect(),
        components_seen: components_seen as u64,
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;
    use nalgebra::DMatrix;

    use super::recalibrate;
    use crate::calibration::matrix::matrix_of_shape;
    use crate::calibration::synthetic::{Rests, Sensor};
    use crate::calibration::{BiasOrigin, Calibration, CalibrationRefusal, Handedness, Method, SolvedTrial};
    use crate::session_file::STANDARD_GRAVITY;

    const ARMS: [[f64; 3]; 3] = [[0.1, 0.0, 0.05], [0.0, 0.1, 0.05], [-0.05, -0.05, 0.12]];

    /// A calibration that is the truth.
    fn truth(sensor: &Sensor) -> Calibration {
        Calibration {
            dof: sensor.dof,
            method: Method::Sfm,
            gravity: STANDARD_GRAVITY,
            matrix: matrix_of_shape(&sensor.shape).expect("of full rank"),
            bias_counts: sensor.bias_counts.clone(),
            bias: BiasOrigin::Estimated,
            shape: sensor.shape.clone(),
            handedness: Handedness::Proven,
            fusion_residual: 0.0,
            uncertainty: None,
            trials: Vec::new(),
            checks: Vec::new(),
            drift: None,
        }
    }

    fn trials(sensor: &mut Sensor, arms: &[[f64; 3]]) -> Vec<SolvedTrial> {
        let none = Rests { directions: Vec::new(), accuracy_rad: 1e-3 };
        arms.iter().map(|arm| sensor.trial(2.0, arm, &none)).collect()
    }

    #[test]
    fn a_gage_that_changed_its_gain_is_found_with_no_known_load() {
        for seed in 0..5 {
            let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
            let stored = truth(&sensor);
            sensor.shape.column_mut(3).scale_mut(1.04);
            let trials = trials(&mut sensor, &ARMS);
            let found = recalibrate(&stored, STANDARD_GRAVITY, &trials).expect("a small drift");
            let drift = found.drift.expect("what the reference is for");
            assert_eq!(drift.components_seen, 6);
            let worst = (0..8).max_by(|&a, &b| drift.gage_percent[a].total_cmp(&drift.gage_percent[b]));
            assert_eq!(worst, Some(3), "{:?}", drift.gage_percent);
            // The turn that hides in the change takes some of it.
            assert!((drift.gage_percent[3] - 4.0).abs() < 2.0, "{:?}", drift.gage_percent);
        }
    }

    #[test]
    fn an_unchanged_sensor_has_not_moved_and_one_arm_leaves_the_rest_as_it_was() {
        for (arms, seen) in [(&ARMS[..], 6), (&ARMS[..1], 3)] {
            let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 7);
            let stored = truth(&sensor);
            let trials = trials(&mut sensor, arms);
            let found = recalibrate(&stored, STANDARD_GRAVITY, &trials).expect("no drift");
            let drift = found.drift.expect("what the reference is for");
            assert_eq!(drift.components_seen, seen);
            // Noise of 0.01 % of the load and 1500 samples: far below a tenth of a per cent.
            assert!(
                drift.gage_percent.iter().chain(&drift.axis_percent).all(|&percent| percent < 0.1),
                "{drift:?}"
            );
        }
    }

    #[test]
    fn another_sensor_is_refused() {
        let stored = truth(&Sensor::new(Dof::SpatialForceTorque, 8, 1));
        let mut other = Sensor::new(Dof::SpatialForceTorque, 8, 2);
        let refused = recalibrate(&stored, STANDARD_GRAVITY, &trials(&mut other, &ARMS));
        assert!(matches!(refused, Err(CalibrationRefusal::ReferenceDiffers { trial: 0, .. })), "{refused:?}");

        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 3);
        let stored = truth(&sensor);
        let change = DMatrix::from_fn(6, 8, |row, gage| if (row + gage) % 2 == 0 { 1.5 } else { 0.5 });
        sensor.shape.component_mul_assign(&change);
        let trials = trials(&mut sensor, &ARMS);
        assert!(recalibrate(&stored, STANDARD_GRAVITY, &trials).is_err());
    }
}
