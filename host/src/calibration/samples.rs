//! What becomes of the samples of a recording: the sensor's own gate ([`ftcal_shared::estimation::gate`]) tells which are
//! measurements and how quiet the load was, and why the others are left out.

use std::collections::BTreeMap;

use ftcal_shared::estimation::expectation::Expectation;
use ftcal_shared::estimation::gate::{BLOCK, Gate, Quietness, Verdict};
use ftcal_shared::units::AdcCode;
use ftcal_shared::wire::{Solution, TrialStatus};
use serde::{Deserialize, Serialize};

use crate::recording::Recording;

/// Why a sample takes no part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rejection {
    /// A channel stood at an end of the converter's range.
    Saturated,
    /// The load moved too much.
    Moving,
    /// The converter repeated itself.
    Repeated,
    /// The codes answer to no load at this arm.
    Parity,
    /// The load was of another magnitude.
    Magnitude,
    /// It came while the sensor worked on its sums.
    Unattended,
    /// Neither noise nor the load explains it: a glitch, a bump.
    Outlier,
}

impl Rejection {
    /// What was wrong with the samples.
    pub const fn in_words(self) -> &'static str {
        match self {
            Self::Saturated => "saturated",
            Self::Moving => "moving too much",
            Self::Repeated => "repeated by the converter",
            Self::Parity => "with gages that contradict each other",
            Self::Magnitude => "with a load of another magnitude",
            Self::Unattended => "missed while the sensor worked on its sums",
            Self::Outlier => "that neither noise nor the load explains",
        }
    }
}

/// How many samples took part.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SampleCounts {
    /// Samples recorded.
    pub total: u64,
    /// Samples used.
    pub used: u64,
    /// Samples not used, by cause.
    pub rejected: BTreeMap<Rejection, u64>,
}

impl SampleCounts {
    /// The counts of so many samples, of which some were rejected for these causes.
    pub fn new(total: u64, rejected: &[(Rejection, u64)]) -> Self {
        let used = total.saturating_sub(rejected.iter().map(|(_, count)| count).sum());
        Self { total, used, rejected: rejected.iter().copied().filter(|(_, count)| *count > 0).collect() }
    }

    /// The counts of a trial that the sensor has solved.
    pub fn on_the_sensor(trial: &TrialStatus, solution: &Solution) -> Self {
        let total = u64::from(trial.offered);
        let [saturated, repeated, contradictory, magnitude, unattended] =
            [trial.saturated, trial.repeated, trial.contradictory, trial.off_magnitude, trial.unattended]
                .map(u64::from);
        let others = saturated + repeated + contradictory + magnitude + unattended;
        Self::new(
            total,
            &[
                (Rejection::Saturated, saturated),
                (Rejection::Moving, total.saturating_sub(others + u64::from(solution.samples))),
                (Rejection::Repeated, repeated),
                (Rejection::Parity, contradictory),
                (Rejection::Magnitude, magnitude),
                (Rejection::Unattended, unattended),
            ],
        )
    }
}

/// What becomes of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It is no measurement.
    Rejected(Rejection),
    /// It is one, and the load was as quiet as this.
    Measured(Quietness),
}

/// How many samples are rejected for this cause.
pub fn rejected(outcomes: &[Outcome], cause: Rejection) -> u64 {
    outcomes.iter().filter(|&&outcome| outcome == Outcome::Rejected(cause)).count() as u64
}

/// What becomes of the samples of a recording of so many gages, compared with this expectation if there is one.
pub fn gated<const GAGES: usize>(
    recording: &Recording,
    expectation: Option<&Expectation<GAGES>>,
) -> Vec<Outcome> {
    let mut gate = Gate::<GAGES>::new();
    gate.expect(expectation.cloned());
    // The gate classes what it accepts some samples later, in order.
    let mut classes = Vec::with_capacity(recording.len());
    let mut note = |class, _: &[AdcCode; GAGES]| classes.push(class);
    let mut verdicts = Vec::with_capacity(recording.len());
    for codes in recording.samples().filter_map(|(_, codes)| <&[AdcCode; GAGES]>::try_from(codes).ok()) {
        let verdict = gate.offer(codes, AdcCode::any_is_saturated(codes), &mut note);
        verdicts.push(verdict);
        if verdict == Verdict::Contradictory {
            // Its block goes with it.
            let earlier = verdicts.iter_mut().rev().filter(|verdict| **verdict == Verdict::Accepted);
            earlier.take(BLOCK - 1).for_each(|verdict| *verdict = Verdict::Contradictory);
        }
    }
    gate.finish(&mut note);
    let mut classes = classes.into_iter();
    let outcome = |verdict| match verdict {
        Verdict::Saturated => Outcome::Rejected(Rejection::Saturated),
        Verdict::Repeated => Outcome::Rejected(Rejection::Repeated),
        Verdict::Contradictory => Outcome::Rejected(Rejection::Parity),
        Verdict::Accepted => Outcome::Measured(classes.next().unwrap_or(Quietness::Fast)),
    };
    verdicts.into_iter().map(outcome).collect()
}

/// The same past the gate: every sample that is not saturated counts as one of a load at rest.
pub fn ungated(recording: &Recording) -> Vec<Outcome> {
    let outcome = |codes| {
        if AdcCode::any_is_saturated(codes) {
            Outcome::Rejected(Rejection::Saturated)
        } else {
            Outcome::Measured(Quietness::Still)
        }
    };
    recording.samples().map(|(_, codes)| outcome(codes)).collect()
}
