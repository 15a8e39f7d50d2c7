//! The calibration at work: raw codes to wrench in real time (eq. 1, with bias).
//!
//! `wrench = C (z − b)` in single precision. A code has 24 bits and so has a single-precision number, so that subtracting
//! a bias with a fraction would lose that fraction. The bias is split instead: its whole part is subtracted from the
//! codes in integers, exactly, and its fraction is folded into a constant offset of the wrench.

use crate::units::{AdcCode, Dof, MAX_DOF};

/// A calibration in the form that the sample path applies: no allocation, no branch on data, no division.
#[derive(Clone, Debug, PartialEq)]
pub struct RealTimeCalibration<const GAGES: usize> {
    dof: Dof,
    /// C (m × p), newton and newton metre per count; rows beyond the sensor's degrees of freedom are zero and unread.
    matrix: [[f32; GAGES]; MAX_DOF],
    /// The whole part of the bias, counts.
    pivot: [i32; GAGES],
    /// −C·(fraction of the bias), newton and newton metre.
    offset: [f32; MAX_DOF],
}

/// Why a calibration cannot be applied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum UnusableCalibration {
    /// The matrix has not one row for each degree of freedom and one column for each gage.
    WrongDimensions,
    /// An element of the matrix or of the bias is not finite.
    NonFinite,
    /// A bias lies outside of the converter's range.
    BiasOutOfRange,
}

impl<const GAGES: usize> RealTimeCalibration<GAGES> {
    /// Prepares a calibration matrix (row-major, m × p, newton and newton metre per count) and bias (p, counts).
    ///
    /// # Errors
    ///
    /// See [`UnusableCalibration`].
    pub fn new(dof: Dof, matrix: &[f32], bias_counts: &[f64]) -> Result<Self, UnusableCalibration> {
        if matrix.len() != dof.count() * GAGES || bias_counts.len() != GAGES {
            return Err(UnusableCalibration::WrongDimensions);
        }
        if !matrix.iter().all(|element| element.is_finite()) || !bias_counts.iter().all(|b| b.is_finite()) {
            return Err(UnusableCalibration::NonFinite);
        }
        let range = f64::from(AdcCode::MIN.counts())..=f64::from(AdcCode::MAX.counts());
        if !bias_counts.iter().all(|bias| range.contains(bias)) {
            return Err(UnusableCalibration::BiasOutOfRange);
        }
        let mut prepared =
            Self { dof, matrix: [[0.0; GAGES]; MAX_DOF], pivot: [0; GAGES], offset: [0.0; MAX_DOF] };
        for (row, elements) in prepared.matrix.iter_mut().zip(matrix.chunks_exact(GAGES)) {
            row.copy_from_slice(elements);
        }
        let mut fraction = [0.0_f64; GAGES];
        for gage in 0..GAGES {
            #[expect(clippy::cast_possible_truncation, reason = "inside of the converter's range, see above")]
            let whole = bias_counts[gage] as i32;
            prepared.pivot[gage] = whole;
            fraction[gage] = bias_counts[gage] - f64::from(whole);
        }
        for (offset, row) in prepared.offset.iter_mut().zip(&prepared.matrix) {
            let exact: f64 = row.iter().zip(&fraction).map(|(c, part)| f64::from(*c) * part).sum();
            #[expect(clippy::cast_possible_truncation, reason = "rounded to the precision of the wrench")]
            {
                *offset = -exact as f32;
            }
        }
        Ok(prepared)
    }

    /// The degrees of freedom of the wrench.
    pub const fn dof(&self) -> Dof {
        self.dof
    }

    /// The wrench of one sample, in the sensor frame: newton and newton metre in the order of [`Dof::axes`]; elements
    /// beyond the sensor's degrees of freedom are zero.
    pub fn apply(&self, codes: &[AdcCode; GAGES]) -> [f32; MAX_DOF] {
        // At most 25 bits; the conversion rounds by 2⁻²⁵ of the value.
        let difference: [f32; GAGES] =
            core::array::from_fn(|gage| (codes[gage].counts() - self.pivot[gage]) as f32);
        let mut wrench = self.offset;
        // Rows beyond the degrees of freedom are zero: to leave them out would cost more than to take them along.
        for (component, row) in wrench.iter_mut().zip(&self.matrix) {
            for gage in 0..GAGES {
                *component += row[gage] * difference[gage];
            }
        }
        wrench
    }
}
