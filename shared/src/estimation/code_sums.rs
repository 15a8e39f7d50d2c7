//! The exact part of a trial's sums: count, sum and Gram matrix of the codes, about an integer pivot (design § 2).
//!
//! The noise stands 10⁻⁶ … 10⁻⁸ below the signal's variance, and the redundant eigenvalues that measure it must survive. A
//! difference of two 24-bit codes has 25 bits, so all is kept in integers and rounded once, when it is read.

use nalgebra::{SMatrix, SVector};

use crate::refusal::Refusal;
use crate::units::AdcCode;

/// The most samples that are summed up: 36 hours at 32 000 samples/s.
///
/// At n samples the exact covariance needs n·ΣΔ² ≤ n²·2⁴⁸; at 2³² samples this is 2¹¹², inside an `i128`.
pub const MAX_SAMPLES: u64 = 1 << 32;

/// Count, sum and Gram matrix of codes over `GAGES` channels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CodeSums<const GAGES: usize> {
    pub(super) pivot: [AdcCode; GAGES],
    pub(super) count: u64,
    /// Σ Δ, counts.
    pub(super) sum: [i64; GAGES],
    /// Σ Δᵢ Δⱼ for i ≤ j, counts²; the lower triangle stays zero.
    pub(super) gram: [[i128; GAGES]; GAGES],
}

/// The mean of codes.
#[derive(Clone, Debug, PartialEq)]
pub struct CodeMean<const GAGES: usize> {
    /// The number of samples.
    pub samples: u64,
    /// As a difference from the pivot, counts.
    pub from_pivot: SVector<f64, GAGES>,
    /// As codes, counts.
    pub counts: SVector<f64, GAGES>,
}

impl<const GAGES: usize> CodeSums<GAGES> {
    /// Of no samples, about `pivot`.
    pub const fn new(pivot: [AdcCode; GAGES]) -> Self {
        Self { pivot, count: 0, sum: [0; GAGES], gram: [[0; GAGES]; GAGES] }
    }

    /// The number of samples.
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Adds sums about the same pivot.
    ///
    /// # Errors
    ///
    /// [`Refusal::PivotsDiffer`], or [`Refusal::OverflowAhead`] where both together exceed [`MAX_SAMPLES`]; `self` is
    /// then left as it was.
    pub fn add(&mut self, other: &Self) -> Result<(), Refusal> {
        if self.pivot != other.pivot {
            return Err(Refusal::PivotsDiffer);
        }
        if self.count + other.count > MAX_SAMPLES {
            return Err(Refusal::OverflowAhead { samples: self.count + other.count });
        }
        self.count += other.count;
        for i in 0..GAGES {
            self.sum[i] += other.sum[i];
            for j in i..GAGES {
                self.gram[i][j] += other.gram[i][j];
            }
        }
        Ok(())
    }

    /// The mean of the codes.
    pub fn mean(&self) -> CodeMean<GAGES> {
        let from_pivot = SVector::from_fn(|i, _| self.sum[i] as f64 / self.divisor());
        let counts = SVector::from_fn(|i, _| f64::from(self.pivot[i].counts())) + from_pivot;
        CodeMean { samples: self.count, from_pivot, counts }
    }

    /// The covariance of the codes (divisor n), counts².
    ///
    /// Computed as (n·ΣΔᵢΔⱼ − ΣΔᵢ·ΣΔⱼ)/n² with an exact numerator, so that it is rounded once.
    #[inline(never)]
    pub fn covariance(&self) -> SMatrix<f64, GAGES, GAGES> {
        let samples = self.divisor();
        SMatrix::from_fn(|row, column| {
            let (i, j) = if row <= column { (row, column) } else { (column, row) };
            let numerator =
                i128::from(self.count) * self.gram[i][j] - i128::from(self.sum[i]) * i128::from(self.sum[j]);
            numerator as f64 / (samples * samples)
        })
    }

    /// Σ ΔᵢΔⱼ, counts².
    pub(super) const fn product_sum(&self, i: usize, j: usize) -> f64 {
        let (low, high) = if i <= j { (i, j) } else { (j, i) };
        self.gram[low][high] as f64
    }

    /// The number of samples as a divisor; 1 where there are none, so that the readings of no samples are zero rather than
    /// undefined.
    pub(super) fn divisor(&self) -> f64 {
        self.count.max(1) as f64
    }
}
