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
    /// The columns of C (m × p), newton and newton metre per count; rows beyond the sensor's degrees of freedom are zero.
    columns: [[f32; MAX_DOF]; GAGES],
    /// The whole part of the bias, counts: 24 bits, which single precision holds exactly.
    pivot: [f32; GAGES],
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
            Self { dof, columns: [[0.0; MAX_DOF]; GAGES], pivot: [0.0; GAGES], offset: [0.0; MAX_DOF] };
        prepared.set_rows(matrix.as_chunks().0);
        let mut fraction = [0.0_f64; GAGES];
        for gage in 0..GAGES {
            #[expect(clippy::cast_possible_truncation, reason = "inside of the converter's range, see above")]
            let whole = bias_counts[gage] as i32;
            prepared.pivot[gage] = whole as f32;
            fraction[gage] = bias_counts[gage] - f64::from(whole);
        }
        prepared.offset = offset(&prepared.columns, &fraction);
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
        let mut rows = self.matrix();
        let space = space.without(gage, &mut rows)?;
        reduced.set_rows(&rows);
        let mut fraction = [0.0; GAGES];
        for ((fraction, whole), bias) in fraction.iter_mut().zip(&self.pivot).zip(bias_counts) {
            *fraction = bias - f64::from(*whole);
        }
        reduced.offset = offset(&reduced.columns, &fraction);
        Ok((reduced, space))
    }

    /// The degrees of freedom of the wrench.
    pub const fn dof(&self) -> Dof {
        self.dof
    }

    /// C (m × p), newton and newton metre per count, a row a component.
    pub fn matrix(&self) -> heapless::Vec<[f32; GAGES], MAX_DOF> {
        (0..self.dof.count()).map(|row| self.columns.map(|column| column[row])).collect()
    }

    fn set_rows(&mut self, rows: &[[f32; GAGES]]) {
        for (row, elements) in rows.iter().enumerate().take(MAX_DOF) {
            for (column, element) in self.columns.iter_mut().zip(elements) {
                column[row] = *element;
            }
        }
    }

    /// Writes down what the gages read beyond their bias, counts. The fraction of the bias is not in it.
    #[inline]
    pub fn read_signal(&self, codes: &[AdcCode; GAGES], signal: &mut [f32; GAGES]) {
        // Of two numbers of 24 bits: exact, or rounded by 2⁻²⁵ of its value.
        let difference = |code: &AdcCode, pivot: &f32| code.counts() as f32 - pivot;
        let (fours, rest) = signal.as_chunks_mut::<4>();
        let ((code_fours, code_rest), (pivot_fours, pivot_rest)) =
            (codes.as_chunks::<4>(), self.pivot.as_chunks::<4>());
        // Four at a time: see `monomials`.
        for ((four, [a, b, c, d]), [e, f, g, h]) in fours.iter_mut().zip(code_fours).zip(pivot_fours) {
            *four = [difference(a, e), difference(b, f), difference(c, g), difference(d, h)];
        }
        for ((element, code), pivot) in rest.iter_mut().zip(code_rest).zip(pivot_rest) {
            *element = difference(code, pivot);
        }
    }

    /// The wrench of a signal, in the sensor frame: newton and newton metre in the order of [`Dof::axes`]; elements beyond the
    /// sensor's degrees of freedom are zero.
    pub fn wrench(&self, signal: &[f32; GAGES]) -> [f32; MAX_DOF] {
        // Component by component, and not as a loop: see `monomials`. Rows beyond the degrees of freedom are zero: to leave
        // them out would cost more than to take them along.
        let [mut a, mut b, mut c, mut d, mut e, mut f] = self.offset;
        let mut add = |[of_a, of_b, of_c, of_d, of_e, of_f]: &[f32; MAX_DOF], signal: f32| {
            a += of_a * signal;
            b += of_b * signal;
            c += of_c * signal;
            d += of_d * signal;
            e += of_e * signal;
            f += of_f * signal;
        };
        let ((pairs, odd), (signal_pairs, odd_signal)) = (self.columns.as_chunks(), signal.as_chunks());
        for ([first, second], [first_signal, second_signal]) in pairs.iter().zip(signal_pairs) {
            add(first, *first_signal);
            add(second, *second_signal);
        }
        for (column, signal) in odd.iter().zip(odd_signal) {
            add(column, *signal);
        }
        [a, b, c, d, e, f]
    }

    /// The wrench of one sample.
    pub fn apply(&self, codes: &[AdcCode; GAGES]) -> [f32; MAX_DOF] {
        let mut signal = [0.0; GAGES];
        self.read_signal(codes, &mut signal);
        self.wrench(&signal)
    }
}

/// −C·(fraction of the bias).
fn offset<const GAGES: usize>(columns: &[[f32; MAX_DOF]; GAGES], fraction: &[f64; GAGES]) -> [f32; MAX_DOF] {
    core::array::from_fn(|row| {
        let exact: f64 =
            columns.iter().zip(fraction).map(|(column, part)| f64::from(column[row]) * part).sum();
        #[expect(clippy::cast_possible_truncation, reason = "rounded to the precision of the wrench")]
        {
            -exact as f32
        }
    })
}
