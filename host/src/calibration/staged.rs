//! The paper's own way from trials to a calibration (figure 2, eq. 14–20), kept for comparison with [`super::joint`].
//!
//! Each trial is oriented by its known loads, its handedness is proven, and the oriented shapes are stacked. The errors of
//! the known directions pass into the answer, magnified by the arms.

use ftcal_shared::units::Dof;
use nalgebra::DMatrix;

use super::fusion::Stack;
use super::matrix::matrix_of_shape;
use super::{
    BiasOrigin, Calibration, CalibrationRefusal, Handedness, Method, SolvedTrial, alignment, bias, cause,
    handedness, require_certain, require_gages, require_motion,
};

/// Calibrates trial by trial: aligns, proves, stacks.
///
/// # Errors
///
/// Every [`CalibrationRefusal`] but those of least squares.
pub fn calibrate(dof: Dof, gravity: f64, trials: &[SolvedTrial]) -> Result<Calibration, CalibrationRefusal> {
    require_gages(dof, trials)?;
    require_motion(trials)?;
    let mut alignments = Vec::with_capacity(trials.len());
    for (index, SolvedTrial { case, shape, .. }) in trials.iter().enumerate() {
        alignments.push(alignment::align(index, case, shape)?);
    }
    let arms = Stack::new(dof, &trials.iter().map(|trial| &trial.case.arm_m).collect::<Vec<_>>())?;
    let proven = handedness::prove(trials, &alignments, &arms, gravity)
        .map_err(|refusal| cause::named(refusal, trials))?;
    let bias_counts = bias::common_bias(trials)?;
    let shapes: Vec<DMatrix<f64>> = proven.oriented.iter().map(|trial| trial.shape.clone()).collect();
    let fused = arms.fuse(&shapes);
    let mut scaled = fused.shape.clone();
    for (mut row, &length) in scaled.row_iter_mut().zip(&arms.lengths) {
        row *= length;
    }
    require_certain(&scaled, proven.consistency.wrench_error)?;
    let matrix = matrix_of_shape(&fused.shape).map_err(|_| CalibrationRefusal::ShapeRankDeficient)?;
    let records =
        trials.iter().zip(&alignments).zip(proven.hands.iter().zip(&proven.evidence)).map(
            |((trial, alignment), (&hand, &evidence))| trial.record(alignment.residual_deg(hand), evidence),
        );
    Calibration {
        dof,
        method: Method::SfmPaper,
        gain: None,
        gravity,
        matrix,
        bias_counts,
        bias: BiasOrigin::Estimated,
        shape: fused.shape,
        handedness: Handedness::Proven,
        fusion_residual: fused.residual,
        uncertainty: None,
        trials: records.collect(),
        checks: Vec::new(),
        drift: None,
    }
    .finite()
}
