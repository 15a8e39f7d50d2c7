//! What a trial in the field means for the calibration that there is.
//!
//! | the trial | is |
//! |---|---|
//! | of a gage that has moved by more than [`LARGEST_DRIFT`] | refused: no drift does that |
//! | of gages and a bias that are where they were, within [`MOVED`] standard deviations | a confirmation: nothing is changed |
//! | of a bias that has moved | a new bias, beside the matrix that there was |
//! | of gages that have moved | a new calibration |
//!
//! A standard deviation is what the trial predicts, and [`MODEL_ERROR`] besides: a hand does more to a load than chance does. Measured
//! on sixteen simulated sensors turned by hand, against the truth: after 20 s the answer of some gage was off by up to 1.1 %, fifteen of these
//! standard deviations; after 40 s by 0.12 %, 3.8 of them; after 80 s by 0.05 %, 1.7; after 160 s by 0.03 %, 1.0. So a trial
//! has to last ([`super`]).
//!
//! So whatever is replaced was worse determined than what replaces it: it is off by three standard deviations of the new one at
//! least, however well it was known once. And what no better is known about stays as it was.
//!
//! The bias has no limit of its own: it moves with temperature and time, the trial sees all of it, and how far it has moved is told.

use ftcal_shared::estimation::application::RealTimeCalibration;
use ftcal_shared::estimation::reorientation::{
    MAX_RANK, MODEL_ERROR, NoOrientation, Oriented, Rows, Unoriented, dual, orient,
};
use ftcal_shared::wire::{
    CalibrationOrigin, CalibrationUpload, Coverage, FieldComparison, FieldRefusal, GageList, Renewed,
    Solution,
};

use crate::storage::items::StoredCalibration;

/// The largest change of the answer of a gage, relative to it, that is a drift.
pub const LARGEST_DRIFT: f64 = 0.02;

/// Standard deviations that are no chance.
const MOVED: f64 = 3.0;

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
    let matrix = rows::<GAGES>(rank, old.matrix.iter().map(|&element| f64::from(element)))?;
    let known = dual(rank, &matrix).ok_or(FieldRefusal::UnusableNumbers)?;
    let shape = rows::<GAGES>(rank, solution.shape_counts_per_load.iter().copied())?;
    let deviations = coverage.shape_deviation_counts_per_load.iter();
    let deviations = rows::<GAGES>(rank, deviations.map(|&deviation| f64::from(deviation)))?;
    let deviation =
        core::array::from_fn(|gage| libm::sqrt(deviations.iter().map(|row| row[gage] * row[gage]).sum()));
    let trial = Unoriented { rank, shape: &shape, deviation: &deviation };
    let oriented = orient(&trial, &known).map_err(|cause| match cause {
        NoOrientation::Degenerate => FieldRefusal::UnusableNumbers,
        NoOrientation::EitherHand => FieldRefusal::EitherHand,
    })?;

    let (gage, drift) = largest(&oriented.drift);
    #[expect(clippy::cast_possible_truncation, reason = "a report of seven digits")]
    let (drift_told, limit) = (drift as f32, LARGEST_DRIFT as f32);
    let is_drift = drift <= LARGEST_DRIFT;
    if !is_drift {
        return Err(FieldRefusal::Drifted { gage, drift: drift_told, limit });
    }
    let shift = BiasShift::new(old, solution, coverage, &matrix, &oriented);
    if !shift.newton.is_finite() {
        return Err(FieldRefusal::UnusableNumbers);
    }
    #[expect(clippy::cast_possible_truncation, reason = "a report of seven digits")]
    let found = FieldComparison {
        reference: old.identity,
        relative_uncertainty: coverage.worst_relative_uncertainty,
        drift: drift_told,
        gage,
        bias_shift_newton: shift.newton as f32,
        load_newton: oriented.load_newton as f32,
    };
    let (_, in_deviations) = largest(&oriented.drift_deviations);
    let renewed = match (in_deviations > MOVED, shift.has_moved) {
        (true, _) => Renewed::ShapeAndBias,
        (false, true) => Renewed::Bias,
        (false, false) => return Ok(Judgement::Confirmed(found)),
    };
    let mut upload = CalibrationUpload { bias_counts: solution.bias_counts.clone(), ..old.clone() };
    if renewed == Renewed::ShapeAndBias {
        let matrix = dual(rank, &oriented.shape).ok_or(FieldRefusal::UnusableNumbers)?;
        #[expect(clippy::cast_possible_truncation, reason = "rounded to what the sample path holds")]
        for (new, exact) in upload.matrix.iter_mut().zip(matrix.iter().flatten()) {
            *new = *exact as f32;
        }
    }
    upload.identity = upload.identity_of_numbers();
    RealTimeCalibration::<GAGES>::new(upload.dof, &upload.matrix, &upload.bias_counts)
        .map_err(|_| FieldRefusal::UnusableNumbers)?;
    let origin = CalibrationOrigin::Field(renewed, found);
    Ok(Judgement::Renewed(StoredCalibration { upload, gain: reference.gain, origin }))
}

/// How far the codes with no load have moved.
struct BiasShift {
    newton: f64,
    has_moved: bool,
}

impl BiasShift {
    fn new<const GAGES: usize>(
        old: &CalibrationUpload,
        solution: &Solution,
        coverage: &Coverage,
        matrix: &Rows<GAGES>,
        oriented: &Oriented<GAGES>,
    ) -> Self {
        let mut force = [0.0; MAX_RANK];
        let mut has_moved = false;
        for gage in 0..GAGES {
            let at = |list: &GageList<f64>| list.get(gage).copied().unwrap_or_default();
            let shift = at(&solution.bias_counts) - at(&old.bias_counts);
            let deviation = f64::from(coverage.bias_deviation_counts.get(gage).copied().unwrap_or_default());
            let answer = oriented.shape.iter().map(|row| row[gage] * row[gage]).sum::<f64>();
            let of_model = MODEL_ERROR * oriented.load_newton * libm::sqrt(answer);
            has_moved |= shift.abs() > MOVED * libm::hypot(deviation, of_model);
            for (component, row) in force.iter_mut().zip(matrix) {
                *component += row[gage] * shift;
            }
        }
        Self { newton: libm::sqrt(force.iter().map(|component| component * component).sum()), has_moved }
    }
}

/// Row by row into rows.
fn rows<const GAGES: usize>(
    rank: usize,
    elements: impl ExactSizeIterator<Item = f64>,
) -> Result<Rows<GAGES>, FieldRefusal> {
    let mut rows = [[0.0; GAGES]; MAX_RANK];
    if rank > MAX_RANK || elements.len() != rank * GAGES {
        return Err(FieldRefusal::UnusableNumbers);
    }
    for (place, element) in rows.iter_mut().flatten().zip(elements) {
        *place = element;
    }
    Ok(rows)
}

/// The largest of them, and whose it is; not a number is larger than any.
fn largest<const GAGES: usize>(values: &[f64; GAGES]) -> (u8, f64) {
    let mut largest = (0, 0.0);
    for (gage, &value) in (0..).zip(values) {
        let is_smaller = value <= largest.1;
        if !is_smaller {
            largest = (gage, value);
        }
    }
    largest
}

#[cfg(test)]
mod tests;
