//! The words of every refusal: cause, detail and remedy, written once.
//!
//! The cause is a fixed identifier that scripts may rely on; the detail says what was found, with numbers and units; the
//! remedy says what to do next.

use ftcal_shared::refusal::Refusal;
use serde::Serialize;

use crate::calibration::CalibrationRefusal;

/// A refusal in words.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Explained {
    /// Identifier of the cause.
    pub cause: &'static str,
    /// What was found.
    pub detail: String,
    /// What to do next.
    pub remedy: &'static str,
}

impl Explained {
    fn new(cause: &'static str, detail: impl Into<String>, remedy: &'static str) -> Self {
        Self { cause, detail: detail.into(), remedy }
    }
}

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

/// Explains why there is no calibration. Trials and known loads are numbered from one, as a reader counts.
#[expect(clippy::too_many_lines, reason = "a table, best read as one")]
pub fn calibration(refusal: &CalibrationRefusal) -> Explained {
    match refusal {
        CalibrationRefusal::Trial { trial, refusal } => {
            let Explained { cause, detail, remedy } = estimation(refusal);
            Explained::new(cause, format!("trial {}: {detail}", trial + 1), remedy)
        }
        CalibrationRefusal::NoKnownLoad { trial } => Explained::new(
            "no-known-load",
            format!("trial {} has no known load, so nothing says how it is oriented", trial + 1),
            "Add a [[trial.known_load]]: for a force/torque sensor one rough direction a trial (`accuracy_deg = 30`); for \
             a force sensor one in the plane, three in different directions in space.",
        ),
        CalibrationRefusal::KnownLoadsDoNotOrient { trial, loads, uncertainty_deg } => Explained::new(
            "known-loads-do-not-orient",
            if uncertainty_deg.is_finite() {
                format!(
                    "trial {}: {loads} known load(s) fix its orientation only within {uncertainty_deg:.1}°",
                    trial + 1
                )
            } else {
                format!("trial {}: {loads} known load(s) leave a turn about their direction free", trial + 1)
            },
            "Add a known load in a direction well away from the others, or know the directions better.",
        ),
        CalibrationRefusal::KnownLoadsContradict { trial, load, angle_deg } => Explained::new(
            "known-loads-contradict",
            format!(
                "trial {}: the directions of its known loads do not fit the recovered ones; known load {} is off by \
                 {angle_deg:.1}°",
                trial + 1,
                load + 1
            ),
            "Check the directions (of the force acting on the sensor, in the sensor frame), which rest belongs to which, \
             and that `accuracy_deg` is not too small.",
        ),
        CalibrationRefusal::KnownLoadMagnitude { trial, load, magnitude } => Explained::new(
            "known-load-magnitude",
            format!(
                "trial {}, known load {}: its magnitude is {magnitude:.3} times that of the load in the trial",
                trial + 1,
                load + 1
            ),
            "Record the known load with the same mass at the same arm as the trial.",
        ),
        CalibrationRefusal::KnownLoadNotAtRest { trial, load, drift_deg } => Explained::new(
            "known-load-not-at-rest",
            format!(
                "trial {}, known load {}: the load turned by {drift_deg:.2}° from the first half of the rest to the second",
                trial + 1,
                load + 1
            ),
            "Choose a part of the recording in which the sensor rests.",
        ),
        CalibrationRefusal::KnownLoadSaturated { trial, load } => Explained::new(
            "known-load-saturated",
            format!("trial {}, known load {}: every sample is saturated", trial + 1, load + 1),
            "Use a smaller mass or a lower gain.",
        ),
        CalibrationRefusal::TooFewKnownLoads { have, need } => Explained::new(
            "too-few-known-loads",
            format!("{have} known load(s), least squares needs {need}"),
            "Add known loads, or calibrate by shape from motion (`--method sfm`).",
        ),
        CalibrationRefusal::KnownLoadsDoNotSpan { have, need } => Explained::new(
            "known-loads-do-not-span",
            format!("the known loads span {have} of {need} components of force and torque"),
            "Add known loads in other directions and, for torques, at other arms.",
        ),
        CalibrationRefusal::KnownLoadsNotLinear { residual, need } => Explained::new(
            "known-loads-not-linear",
            format!(
                "the best matrix leaves {:.0} % of the known loads unexplained (at most {:.0} % is accepted)",
                100.0 * residual,
                100.0 * need
            ),
            "Check masses, arms and directions; add known loads until the bias can be estimated, too.",
        ),
        CalibrationRefusal::TurningUnclear { trial, swept } => Explained::new(
            "turning-unclear",
            format!(
                "trial {}: the load turned {:.0}° one way and {:.0}° the other, and {:.1} % of its steps are jumps",
                trial + 1,
                swept.counterclockwise_rad.max(swept.clockwise_rad).to_degrees(),
                swept.counterclockwise_rad.min(swept.clockwise_rad).to_degrees(),
                100.0 * swept.jumps
            ),
            "Turn the load one way, at least half a turn and without jumps; or leave out `turning` and add a second \
             known load in another direction.",
        ),
        CalibrationRefusal::TurningContradicts { trial } => Explained::new(
            "turning-contradicts",
            format!(
                "trial {}: the known loads demand the opposite of the `turning` that the session states",
                trial + 1
            ),
            "Check `turning` (the sense of the force in the sensor frame, not of the sensor) and the directions of the \
             known loads.",
        ),
        CalibrationRefusal::HandednessNotSettled { trials, margin, need } => Explained::new(
            "handedness-not-settled",
            format!(
                "{}: a mirror image fits as well: it is worse by {margin:.1}, and by {need:.0} it would be ruled out",
                numbered(trials)
            ),
            "Add a known load to each of these trials, for a force/torque sensor one whose direction is far from the plane \
             of the arms (in the plane: from their line) and from its normal, however roughly known; for a force sensor \
             a third one out of the plane of the other two; for a planar sensor one in another direction, or `turning`.",
        ),
        CalibrationRefusal::TooManyUndecided { trials } => Explained::new(
            "too-many-undecided",
            format!("{}: each may be a mirror image, too many to try all combinations", numbered(trials)),
            "Add a known load to most of these trials: for a planar sensor one in another direction, or `turning`; for a \
             spatial sensor a third one out of the plane of the other two.",
        ),
        CalibrationRefusal::TrialsContradict { residual, ratio } => Explained::new(
            "trials-contradict",
            format!(
                "the trials do not fit together: the fusion residual is {:.2} %, {ratio:.1} times what the accuracies \
                 allow",
                100.0 * residual
            ),
            "Check every trial's mass, arm (from the origin of the sensor frame to the point the load pulls at, metre) \
             and directions, and that `accuracy_deg` is not too small.",
        ),
        CalibrationRefusal::MassesContradict { trial, ratio } => Explained::new(
            "masses-contradict",
            format!(
                "the masses contradict each other: trial {} turned {ratio:.4} times its `mass_kg`, if the others are \
                 right",
                trial + 1
            ),
            "Weigh again all that hung on the sensor in each trial, the fixture too, and correct `mass_kg`; state \
             `mass_accuracy_kg` if the scale is rough.",
        ),
        CalibrationRefusal::BiasesDisagree { trial, counts, signal_counts } => Explained::new(
            "biases-disagree",
            format!(
                "trial {}: its bias is {counts:.0} counts from the mean of all trials, with a signal of \
                 {signal_counts:.0} counts",
                trial + 1
            ),
            "Check that all trials are of one sensor at one gain, that what hangs on it turned with the load, and that \
             its temperature has settled.",
        ),
        CalibrationRefusal::TooFewArms { have, need } => Explained::new(
            "too-few-arms",
            format!("{have} trial(s), the torques need {need} at different arms"),
            "Add a trial with the mass at another arm: two for a planar sensor, three not on one line for a spatial one.",
        ),
        CalibrationRefusal::ArmsEqual { arms, spread_m } => Explained::new(
            "arms-equal",
            format!("the {arms} arms differ by no more than {:.2} mm", 1e3 * spread_m),
            "Add a trial with the mass at another arm, as far away as the fixture allows.",
        ),
        CalibrationRefusal::ArmsCollinear { arms } => Explained::new(
            "arms-collinear",
            format!("the ends of the {arms} arms lie on one line: the torque about it is never seen"),
            "Add a trial with the mass at an arm off that line.",
        ),
        CalibrationRefusal::FusionUncertain { wrench_error, need } => Explained::new(
            "fusion-uncertain",
            format!(
                "directions, arms and masses fix the answer only within {:.0} % (at most {:.0} % is accepted)",
                100.0 * wrench_error,
                100.0 * need
            ),
            "Put the arms farther apart, or know the directions of the known loads better.",
        ),
        CalibrationRefusal::TooFewGages { gages, need } => Explained::new(
            "too-few-gages",
            format!("{gages} gages cannot tell {need} components apart"),
            "Check `dof`, and that every gage was recorded.",
        ),
        CalibrationRefusal::ShapeRankDeficient => Explained::new(
            "shape-rank-deficient",
            "the gages hardly respond to some combination of forces and torques",
            "Check `dof`, the wiring of every gage, and that the arms differ in all directions.",
        ),
        CalibrationRefusal::NotLinear { trial, redundant_counts, rest_counts, signal_counts } => {
            Explained::new(
                "not-linear",
                format!(
                    "trial {}: the gages move by {redundant_counts:.1} counts in a direction that no load should move them in \
                 ({:.2} % of the signal, {:.0} times the noise at rest): the sensor is not linear at this load",
                    trial + 1,
                    100.0 * redundant_counts / signal_counts,
                    redundant_counts / rest_counts
                ),
                "Use a smaller mass, and check that nothing touches the sensor or comes loose as it turns; to calibrate all the \
             same, add `--allow-nonlinear`.",
            )
        }
        CalibrationRefusal::ReferenceDiffers { trial, drift, other_hand, need } => Explained::new(
            "reference-differs",
            format!(
                "trial {}: turned any way, it differs from the stored calibration by {:.1} % (its mirror image by \
                 {:.1} %); up to {:.0} % can be told from a turn",
                trial + 1,
                100.0 * drift,
                100.0 * other_hand,
                100.0 * need
            ),
            "Check that it is the same sensor at the same gain, and the trial's mass and arm; otherwise calibrate anew, with \
             known loads.",
        ),
        CalibrationRefusal::NonFinite => estimation(&Refusal::NonFinite),
    }
}

/// Explains why a calibration fails its field check.
pub fn verification_failed(mean_n: f64, expected_n: f64, deviation_n: f64) -> Explained {
    Explained::new(
        "verification-failed",
        format!(
            "the sensor measures {mean_n:.4} N where {expected_n:.4} N hang on it: {:.1} times the predicted standard \
             deviation",
            (mean_n - expected_n).abs() / deviation_n
        ),
        "Check the mass (all that hangs on the sensor) and that it hung at rest; if they are right, calibrate anew.",
    )
}

/// Explains which gage fails the field check.
pub fn gage_suspect(gage: usize, deviations: f64) -> Explained {
    Explained::new(
        "gage-suspect",
        format!(
            "the gages contradict each other; ch{gage} is farthest off, by {deviations:.1} standard deviations"
        ),
        "Check the wiring of that gage; if it is sound, or the temperature has changed, calibrate anew.",
    )
}

/// "trial 1", "trials 1, 2, 3": counted from one.
fn numbered(trials: &[usize]) -> String {
    let numbers: Vec<String> = trials.iter().map(|trial| (trial + 1).to_string()).collect();
    format!("trial{} {}", if trials.len() == 1 { "" } else { "s" }, numbers.join(", "))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use ftcal_shared::refusal::Refusal;

    use super::{Explained, calibration, estimation, gage_suspect, verification_failed};
    use crate::calibration::CalibrationRefusal;
    use crate::calibration::turning::Swept;

    fn estimation_refusals() -> Vec<Refusal> {
        vec![
            Refusal::TooFewSamples { have: 3, need: 18 },
            Refusal::RankNotReached { have: 2, need: 3 },
            Refusal::RankNotReached { have: 1, need: 3 },
            Refusal::NoEigenvalueGap { ratio: 1.5, need: 10.0 },
            Refusal::MotionDoesNotSpan { relative_uncertainty: 0.3, need: 0.1 },
            Refusal::MetricNotPositiveDefinite,
            Refusal::NonFinite,
            Refusal::Saturated { samples: 100 },
            Refusal::OverflowAhead { samples: 1 << 32 },
            Refusal::PivotsDiffer,
            Refusal::UnsupportedDimensions { gages: 2, rank: 3 },
        ]
    }

    fn calibration_refusals() -> Vec<CalibrationRefusal> {
        let trial = 0;
        vec![
            CalibrationRefusal::NoKnownLoad { trial },
            CalibrationRefusal::KnownLoadsDoNotOrient { trial, loads: 1, uncertainty_deg: f64::INFINITY },
            CalibrationRefusal::KnownLoadsContradict { trial, load: 1, angle_deg: 20.0 },
            CalibrationRefusal::KnownLoadMagnitude { trial, load: 1, magnitude: 1.3 },
            CalibrationRefusal::KnownLoadNotAtRest { trial, load: 1, drift_deg: 3.0 },
            CalibrationRefusal::KnownLoadSaturated { trial, load: 1 },
            CalibrationRefusal::TurningUnclear { trial, swept: Swept::default() },
            CalibrationRefusal::TurningContradicts { trial },
            CalibrationRefusal::HandednessNotSettled { trials: vec![0, 2], margin: 0.0, need: 25.0 },
            CalibrationRefusal::TooManyUndecided { trials: vec![0, 1] },
            CalibrationRefusal::TrialsContradict { residual: 0.2, ratio: 30.0 },
            CalibrationRefusal::MassesContradict { trial, ratio: 1.1 },
            CalibrationRefusal::TooFewArms { have: 2, need: 3 },
            CalibrationRefusal::ArmsEqual { arms: 3, spread_m: 1e-4 },
            CalibrationRefusal::ArmsCollinear { arms: 3 },
            CalibrationRefusal::FusionUncertain { wrench_error: 0.5, need: 0.25 },
            CalibrationRefusal::BiasesDisagree { trial, counts: 1e4, signal_counts: 1e5 },
            CalibrationRefusal::TooFewGages { gages: 4, need: 6 },
            CalibrationRefusal::ShapeRankDeficient,
            CalibrationRefusal::TooFewKnownLoads { have: 5, need: 6 },
            CalibrationRefusal::KnownLoadsDoNotSpan { have: 5, need: 6 },
            CalibrationRefusal::KnownLoadsNotLinear { residual: 0.5, need: 0.2 },
            CalibrationRefusal::NotLinear {
                trial,
                redundant_counts: 100.0,
                rest_counts: 1.0,
                signal_counts: 1e4,
            },
            CalibrationRefusal::ReferenceDiffers { trial, drift: 0.4, other_hand: 1.5, need: 0.1 },
        ]
    }

    #[test]
    fn every_cause_has_an_identifier_of_its_own_and_every_remedy_is_a_sentence() {
        let explained: Vec<Explained> = estimation_refusals()
            .iter()
            .map(estimation)
            .chain(calibration_refusals().iter().map(calibration))
            .chain([verification_failed(9.0, 10.0, 0.1), gage_suspect(3, 20.0)])
            .collect();
        let causes: BTreeSet<&str> = explained.iter().map(|explained| explained.cause).collect();
        assert_eq!(causes.len(), explained.len());
        for Explained { cause, detail, remedy } in &explained {
            assert!(
                cause.chars().all(|character| character.is_ascii_lowercase() || character == '-'),
                "{cause}"
            );
            assert!(remedy.ends_with('.') && remedy.starts_with(char::is_uppercase), "{remedy}");
            assert!(!detail.is_empty() && !detail.contains("NaN") && !detail.contains("  "), "{detail}");
        }
    }

    #[test]
    fn a_refused_trial_is_named_and_keeps_its_cause() {
        for refusal in estimation_refusals() {
            let explained = calibration(&CalibrationRefusal::Trial { trial: 2, refusal });
            assert_eq!(explained.cause, estimation(&refusal).cause);
            assert!(explained.detail.starts_with("trial 3: "));
        }
    }
}
