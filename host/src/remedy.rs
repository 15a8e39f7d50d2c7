//! The words of every refusal: cause, detail and remedy, written once.
//!
//! The cause is a fixed identifier that scripts may rely on; the detail says what was found, with numbers and units; the
//! remedy says what to do next.

mod estimation;
mod field;

#[cfg(test)]
mod tests;

use ftcal_shared::refusal::Refusal;
use serde::Serialize;

use crate::calibration::CalibrationRefusal;

pub use self::estimation::estimation;
pub use self::field::{gage_suspect, verification_failed};

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
            if *uncertainty_deg < 180.0 {
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
        CalibrationRefusal::LoadsInPlaneOfArms { trials } => Explained::new(
            "coplanar-loads-and-arms",
            format!(
                "{}: a mirror image fits as well, because every known load lies in the plane of the arms or along its normal",
                numbered(trials)
            ),
            "Add to each of these trials a known load whose direction is about halfway between that plane and its normal (in the \
             plane: between the line of the arms and its normal), however roughly known (`accuracy_deg = 30`).",
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
        CalibrationRefusal::ReferenceDiffers { trial, drift, other_hand, scale, need } => Explained::new(
            "reference-differs",
            format!(
                "trial {}: turned any way, it differs from the stored calibration by {:.1} % (its mirror image by \
                 {:.1} %); up to {:.0} % can be told from a turn; its response is {scale:.3} times the stored one",
                trial + 1,
                100.0 * drift,
                100.0 * other_hand,
                100.0 * need
            ),
            "Check that it is the same sensor, and the trial's mass and arm; a response of 2, 4 or 8 times the stored one, or a half, is \
             another gain of the converter; otherwise calibrate anew, with known loads.",
        ),
        CalibrationRefusal::GagesDiffer { trial, gages, stored } => Explained::new(
            "gages-differ",
            format!("trial {}: its recording has {gages} gages, the stored calibration {stored}", trial + 1),
            "Give the stored calibration of this very sensor, and record every one of its gages.",
        ),
        CalibrationRefusal::NonFinite => estimation(&Refusal::NonFinite),
    }
}

/// "trial 1", "trials 1, 2, 3": counted from one.
fn numbered(trials: &[usize]) -> String {
    let numbers: Vec<String> = trials.iter().map(|trial| (trial + 1).to_string()).collect();
    format!("trial{} {}", if trials.len() == 1 { "" } else { "s" }, numbers.join(", "))
}
