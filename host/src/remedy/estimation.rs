//! Why the estimator gives no answer, in words.

use ftcal_shared::refusal::Refusal;

use super::Explained;

/// Explains why the estimator gives no answer.
pub fn estimation(refusal: &Refusal) -> Explained {
    match *refusal {
        Refusal::TooFewSamples { have, need } => Explained::new(
            "too-few-samples",
            format!("{have} usable samples, at least {need} are needed"),
            "Record longer, turning the load through all directions.",
        ),
        Refusal::RankNotReached { have: 2, need: 3 } => Explained::new(
            "planar-motion",
            "the codes vary in two independent directions: the load was turned in one plane, or the sensor is planar",
            "Turn the load out of the plane, too: through every direction of space; for a planar sensor ask for rank 2.",
        ),
        Refusal::RankNotReached { have, need } => Explained::new(
            "rank-not-reached",
            format!("the codes vary in {have} independent directions, {need} are needed"),
            "Turn the load through more directions; if you did, ask for the rank that this sensor's motion has.",
        ),
        Refusal::NoEigenvalueGap { ratio, need } => Explained::new(
            "no-eigenvalue-gap",
            format!(
                "the weakest direction of the signal has {ratio:.1} times the variance of the noise, {need:.1} times \
                 are needed"
            ),
            "Use a larger mass or turn the load through all directions; check that the rank is the sensor's, and that no channel \
             jumps, sticks or clips.",
        ),
        Refusal::MotionDoesNotSpan { relative_uncertainty, need } => Explained::new(
            "motion-does-not-span",
            if relative_uncertainty < 2.0 {
                format!(
                    "the motion fixes the sensor's gains only within {:.1} % (at most {:.1} % is accepted)",
                    50.0 * relative_uncertainty,
                    50.0 * need
                )
            } else {
                "the motion leaves some of the sensor's gains entirely open".to_owned()
            },
            "Record again and turn the load all the way round, through every direction, also the opposite ones.",
        ),
        Refusal::MetricNotPositiveDefinite => Explained::new(
            "metric-not-positive-definite",
            "the codes lie on no ellipsoid, so no load of constant magnitude made them",
            "Let one constant mass hang freely and turn slowly; check that the rank is the sensor's.",
        ),
        Refusal::MagnitudeNotConstant { scatter, limit } => Explained::new(
            "magnitude-not-constant",
            format!(
                "the recovered load's magnitude varies by {:.0} % beyond noise (at most {:.0} % is accepted)",
                100.0 * scatter,
                100.0 * limit
            ),
            "Let one constant mass hang from the first sample to the last, and turn it slowly; record again.",
        ),
        Refusal::RankExceeded { share, limit } => Explained::new(
            "rank-exceeded",
            format!(
                "beyond the rank asked for, the codes vary in a further direction by {:.1} % of the weakest signal (at \
                 most {:.1} % is accepted)",
                100.0 * share,
                100.0 * limit
            ),
            "Ask for the rank of the load's motion; if you did, look for a channel that clips, jumps or is not linear.",
        ),
        Refusal::NonFinite => Explained::new(
            "non-finite",
            "a number left the range of floating point",
            "Check the recording for values that no converter delivers.",
        ),
        Refusal::Saturated { samples } => Explained::new(
            "saturated",
            format!(
                "{samples} samples stand at an end of the converter's range, and too few others are left"
            ),
            "Use a smaller mass or a lower gain.",
        ),
        Refusal::OverflowAhead { samples } => Explained::new(
            "overflow-ahead",
            format!("{samples} samples are as many as the exact sums hold"),
            "Record a shorter trial.",
        ),
        Refusal::PivotsDiffer => Explained::new(
            "pivots-differ",
            "two parts of a trial were summed about different pivots",
            "Start the trial anew.",
        ),
        Refusal::UnsupportedDimensions { gages, rank } => Explained::new(
            "unsupported-dimensions",
            format!("a trial of rank {rank} with {gages} gages is not possible"),
            "Ask for rank 2 (planar) or 3 (spatial), with at least as many gages as the rank and at most twelve.",
        ),
    }
}
