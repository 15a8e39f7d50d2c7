//! The calibration at work: raw codes to wrench in real time (eq. 1, with bias).
//!
//! `wrench = C (z − b)` in single precision. A code has 24 bits and so has a single-precision number, so that subtracting
//! a bias with a fraction would lose that fraction. The bias is split instead: its whole part is subtracted from the
//! codes in integers, exactly, and its fraction is folded into a constant offset of the wrench.

use super::parity::{GageNeeded, ParitySpace};
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
        prepared.offset = offset(&prepared.matrix, &fraction);
        Ok(prepared)
    }

    /// The calibration without one gage, given the parity space of this one and the bias that it was prepared from; and the
    /// parity space that is left.
    ///
    /// # Errors
    ///
    /// [`GageNeeded`].
    pub fn without(
        &self,
        gage: usize,
        space: &ParitySpace<GAGES>,
        bias_counts: &[f64],
    ) -> Result<(Self, ParitySpace<GAGES>), GageNeeded> {
        let mut reduced = self.clone();
        let (rows, _) = reduced.matrix.split_at_mut_checked(self.dof.count()).ok_or(GageNeeded)?;
        let space = space.without(gage, rows)?;
        let mut fraction = [0.0; GAGES];
        for ((fraction, whole), bias) in fraction.iter_mut().zip(&self.pivot).zip(bias_counts) {
            *fraction = bias - f64::from(*whole);
        }
        reduced.offset = offset(&reduced.matrix, &fraction);
        Ok((reduced, space))
    }

    /// The degrees of freedom of the wrench.
    pub const fn dof(&self) -> Dof {
        self.dof
    }

    /// C (m × p), newton and newton metre per count, a row a component.
    pub fn matrix(&self) -> &[[f32; GAGES]] {
        self.matrix.split_at_checked(self.dof.count()).map_or(&[], |(rows, _)| rows)
    }

    /// What the gages read beyond their bias, counts. The fraction of the bias is not in it.
    pub fn signal(&self, codes: &[AdcCode; GAGES]) -> [f32; GAGES] {
        // At most 25 bits; the conversion rounds by 2⁻²⁵ of the value.
        core::array::from_fn(|gage| (codes[gage].counts() - self.pivot[gage]) as f32)
    }

    /// The wrench of a signal, in the sensor frame: newton and newton metre in the order of [`Dof::axes`]; elements beyond the
    /// sensor's degrees of freedom are zero.
    pub fn wrench(&self, signal: &[f32; GAGES]) -> [f32; MAX_DOF] {
        let mut wrench = self.offset;
        // Rows beyond the degrees of freedom are zero: to leave them out would cost more than to take them along.
        for (component, row) in wrench.iter_mut().zip(&self.matrix) {
            for gage in 0..GAGES {
                *component += row[gage] * signal[gage];
            }
        }
        wrench
    }

    /// The wrench of one sample.
    pub fn apply(&self, codes: &[AdcCode; GAGES]) -> [f32; MAX_DOF] {
        self.wrench(&self.signal(codes))
    }
}

/// −C·(fraction of the bias).
fn offset<const GAGES: usize>(matrix: &[[f32; GAGES]; MAX_DOF], fraction: &[f64; GAGES]) -> [f32; MAX_DOF] {
    let mut offset = [0.0; MAX_DOF];
    for (offset, row) in offset.iter_mut().zip(matrix) {
        let exact: f64 = row.iter().zip(fraction).map(|(c, part)| f64::from(*c) * part).sum();
        #[expect(clippy::cast_possible_truncation, reason = "rounded to the precision of the wrench")]
        {
            *offset = -exact as f32;
        }
    }
    offset
}
