//! Why an estimate is refused: one value a cause, with the numbers behind it.
//!
//! The words and the remedy a user sees are written once, on the host.

use serde::{Deserialize, Serialize};

/// A cause for not giving an answer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// Fewer samples than the unknowns need.
    TooFewSamples {
        /// Samples at hand.
        have: u64,
        /// Samples needed.
        need: u64,
    },
    /// The codes span fewer directions than the trial's proper rank: the r-th eigenvalue is lost in rounding.
    RankNotReached {
        /// Directions that were excited.
        have: u8,
        /// The proper rank r.
        need: u8,
    },
    /// The r-th eigenvalue does not stand clear of the (r+1)-th: signal and noise cannot be told apart.
    NoEigenvalueGap {
        /// The r-th eigenvalue over the (r+1)-th.
        ratio: f32,
        /// The least ratio that counts as a gap.
        need: f32,
    },
    /// The directions of the load leave part of the metric constraint (eq. 13) undetermined.
    MotionDoesNotSpan {
        /// The worst relative standard deviation among the constraint's principal values.
        relative_uncertainty: f32,
        /// The largest relative standard deviation that counts as determined.
        need: f32,
    },
    /// The constraint's quadratic form is not an ellipsoid's: the load's magnitude was not constant.
    MetricNotPositiveDefinite,
    /// A number is not finite.
    NonFinite,
    /// Every sample, or too many of them, stood at an end of the converter's range.
    Saturated {
        /// Samples rejected for saturation.
        samples: u64,
    },
    /// The next sample could overflow the exact sums.
    OverflowAhead {
        /// Samples summed so far.
        samples: u64,
    },
    /// Two accumulators about different pivots were to be merged.
    PivotsDiffer,
    /// The dimensions asked for are not supported.
    UnsupportedDimensions {
        /// Gages p.
        gages: u8,
        /// Rank r.
        rank: u8,
    },
    /// The load's magnitude was not constant: the recovered loads differ in length by more than noise explains.
    MagnitudeNotConstant {
        /// Standard deviation of the magnitude, relative.
        scatter: f32,
        /// The largest that is accepted.
        limit: f32,
    },
    /// The codes vary in a further direction that is neither noise nor part of a motion of this rank.
    RankExceeded {
        /// Standard deviation in that direction over that in the weakest direction of the motion.
        share: f32,
        /// The largest that is accepted.
        limit: f32,
    },
}
