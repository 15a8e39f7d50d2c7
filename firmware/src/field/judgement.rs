//! What a trial in the field means for the calibration that there is.
//!
//! | the trial | is |
//! |---|---|
//! | of a gage that has moved by more than [`LARGEST_DRIFT`] | refused: no drift does that |
//! | of gages and a bias that are where they were, within three standard deviations | a confirmation: nothing is changed |
//! | of biases that have moved | a new bias of those, beside the matrix that there was |
//! | of gages that have moved | a new calibration, in which all others answer as they did |
//!
//! A standard deviation is what the trial predicts, and [`MODEL_ERROR`] besides: a hand does more to a load than chance does. Measured
//! on sixteen simulated sensors turned by hand, against the truth: after 20 s the answer of some gage was off by up to 1.1 %, fifteen of these
//! standard deviations; after 40 s by 0.12 %, 3.8 of them; after 80 s by 0.05 %, 1.7; after 160 s by 0.03 %, 1.0. So a trial
//! has to last ([`super`]).
//!
//! So whatever is replaced, gage by gage, was worse determined than what replaces it: it is off by three standard deviations of the new
//! one at least, however well it was known once. And what no better is known about stays as it was.
//!
//! The bias has no limit of its own: it moves with temperature and time, the trial sees all of it, and how far it has moved is told.

use ftcal_shared::estimation::application::RealTimeCalibration;
use ftcal_shared::estimation::reorientation::{
    MAX_RANK, MODEL_ERROR, NoOrientation, Oriented, Rows, Unoriented, dual, orient,
};
use ftcal_shared::wire::{
    CalibrationOrigin, CalibrationUpload, Coverage, FieldComparison, FieldRefusal, Renewed, Solution,
};

use crate::storage::items::StoredCalibration;

/// The largest change of the answer of a gage, relative to it, that is a drift.
pub const LARGEST_DRIFT: f32 = 0.02;

/// Standard deviations that are no chance.
const MOVED: f32 = 3.0;

/// What comes of it.
#[derive(Clone, Debug, PartialEq)]
pub enum Judgement {
    /// The calibration stays.
    Confirmed(FieldComparison),
    /// This one replaces it.
    Renewed(StoredCalibration),
}

/// Holds a solved trial against the calibration in use.
///
/// # Errors
///
/// [`FieldRefusal`].
#[inline(never)]
pub fn judge<const GAGES: usize>(
    reference: &StoredCalibration,
    solution: &Solution,
    coverage: &Coverage,
) -> Result<Judgement, FieldRefusal> {
    let old = &reference.upload;
    let rank = old.dof.count();
    let bias_fits = [&old.bias_counts, &solution.bias_counts].iter().all(|bias| bias.len() == GAGES)
        && coverage.bias_deviation_counts.len() == GAGES;
    if rank != usize::from(solution.rank) || !bias_fits {
        return Err(FieldRefusal::UnusableNumbers);
    }
    let sizes = [
        old.matrix.len(),
        solution.shape_counts_per_load.len(),
        coverage.shape_deviation_counts_per_load.len(),
    ];
    if rank > MAX_RANK || sizes != [rank * GAGES; 3] {
        return Err(FieldRefusal::UnusableNumbers);
    }
    let matrix = rows::<GAGES>(&|element| old.matrix.get(element).copied());
    let known = dual(rank, &matrix).ok_or(FieldRefusal::UnusableNumbers)?;
    #[expect(
        clippy::cast_possible_truncation,
        reason = "single precision is enough for parts in ten thousand"
    )]
    let shape =
        rows::<GAGES>(&|element| solution.shape_counts_per_load.get(element).map(|&answer| answer as f32));
    let deviations = rows::<GAGES>(&|element| coverage.shape_deviation_counts_per_load.get(element).copied());
    let deviation = core::array::from_fn(|gage| column_length(&deviations, gage));
    let trial = Unoriented { rank, shape: &shape, deviation: &deviation };
    let oriented = orient(&trial, &known).map_err(|cause| match cause {
        NoOrientation::Degenerate => FieldRefusal::UnusableNumbers,
        NoOrientation::EitherHand => FieldRefusal::EitherHand,
    })?;

    let Oriented { drift, gage, .. } = oriented;
    if drift > LARGEST_DRIFT {
        return Err(FieldRefusal::Drifted { gage, drift, limit: LARGEST_DRIFT });
    }
    let shift = BiasShift::new(old, solution, coverage, &matrix, &oriented);
    if !shift.newton.is_finite() {
        return Err(FieldRefusal::UnusableNumbers);
    }
    let found = FieldComparison {
        reference: old.identity,
        relative_uncertainty: coverage.worst_relative_uncertainty,
        drift,
        gage,
        bias_shift_newton: shift.newton,
        load_newton: oriented.load_newton,
    };
    let has_moved = oriented.drift_deviations.map(|deviations| deviations > MOVED);
    let renewed = match (has_moved.contains(&true), shift.has_moved.contains(&true)) {
        (true, _) => Renewed::ShapeAndBias,
        (false, true) => Renewed::Bias,
        (false, false) => return Ok(Judgement::Confirmed(found)),
    };
    let mut upload = old.clone();
    let mut shape = known;
    for gage in (0..GAGES).filter(|&gage| has_moved[gage] || shift.has_moved[gage]) {
        upload.bias_counts[gage] = solution.bias_counts[gage];
        if has_moved[gage] {
            for (row, new) in shape.iter_mut().zip(&oriented.shape) {
                row[gage] = new[gage];
            }
        }
    }
    if renewed == Renewed::ShapeAndBias {
        let matrix = dual(rank, &shape).ok_or(FieldRefusal::UnusableNumbers)?;
        for (new, exact) in upload.matrix.iter_mut().zip(matrix.as_flattened()) {
            *new = *exact;
        }
    }
    upload.identity = upload.identity_of_numbers();
    RealTimeCalibration::<GAGES>::new(upload.dof, &upload.matrix, &upload.bias_counts)
        .map_err(|_| FieldRefusal::UnusableNumbers)?;
    let origin = CalibrationOrigin::Field(renewed, found);
    Ok(Judgement::Renewed(StoredCalibration { upload, origin }))
}

/// How far the codes with no load have moved.
struct BiasShift<const GAGES: usize> {
    newton: f32,
    /// Gage by gage.
    has_moved: [bool; GAGES],
}

impl<const GAGES: usize> BiasShift<GAGES> {
    fn new(
        old: &CalibrationUpload,
        solution: &Solution,
        coverage: &Coverage,
        matrix: &Rows<GAGES>,
        oriented: &Oriented<GAGES>,
    ) -> Self {
        let mut force = [[0.0]; MAX_RANK];
        let mut has_moved = [false; GAGES];
        let each = old.bias_counts.iter().zip(&solution.bias_counts).zip(&coverage.bias_deviation_counts);
        for (gage, ((old, new), deviation)) in each.enumerate().take(GAGES) {
            #[expect(clippy::cast_possible_truncation, reason = "a difference to seven digits")]
            let shift = (new - old) as f32;
            let of_model = MODEL_ERROR * oriented.load_newton * column_length(&oriented.shape, gage);
            has_moved[gage] = shift.abs() > MOVED * libm::sqrtf(deviation * deviation + of_model * of_model);
            for (component, row) in force.iter_mut().zip(matrix) {
                component[0] += row[gage] * shift;
            }
        }
        Self { newton: column_length(&force, 0), has_moved }
    }
}

fn column_length<const GAGES: usize>(rows: &Rows<GAGES>, gage: usize) -> f32 {
    libm::sqrtf(rows.iter().map(|row| row[gage] * row[gage]).sum())
}

/// Elements row by row into rows; there are none beyond the rank.
fn rows<const GAGES: usize>(element: &dyn Fn(usize) -> Option<f32>) -> Rows<GAGES> {
    let mut rows = [[0.0; GAGES]; MAX_RANK];
    for (number, place) in rows.as_flattened_mut().iter_mut().enumerate() {
        *place = element(number).unwrap_or_default();
    }
    rows
}

#[cfg(test)]
mod tests;
