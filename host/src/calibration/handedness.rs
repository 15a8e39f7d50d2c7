//! Rotation or mirror image: proves each trial's handedness, or refuses (design § 6).
//!
//! The constraint |m| = 1 does not change when a trial is mirrored. In the plane one known load, and in space two, fit a
//! rotation and a mirror image equally well. Three kinds of evidence tell them apart:
//!
//! 1. more known loads: the misfit of the wrong hand grows ([`super::alignment`]);
//! 2. in the plane, the sense in which the load turned ([`super::turning`]);
//! 3. other trials: mirrored shapes do not fit together ([`super::consistency`]), unless arms and loads share a plane,
//!    where the all-mirrored answer fits perfectly and is wrong.
//!
//! Every combination of the hands still possible is measured by the sum of all its misfits. An answer is given only if
//! it is the only one: the runner-up must be worse by `MARGIN`, five standard deviations, and by as much more as the
//! best itself fits worse than it should.

use nalgebra::DMatrix;

use super::CalibrationRefusal;
use super::alignment::{Alignment, Hand};
use super::consistency::{Consistency, OrientedTrial, consistency};
use super::fusion::Stack;
use super::{HandednessEvidence, SolvedTrial};

/// By how much the misfit of every other combination must exceed that of the answer.
pub const MARGIN: f64 = 25.0;

/// How many times its degrees of freedom a misfit may be before the evidence contradicts itself.
pub const CONTRADICTION: f64 = 16.0;

/// Undecided trials beyond this are not searched: 2⁸ combinations.
pub const MOST_UNDECIDED: usize = 8;

/// The hand of every trial, proven.
#[derive(Clone, Debug)]
pub struct Proven {
    /// The hand of each trial.
    pub hands: Vec<Hand>,
    /// What settled it.
    pub evidence: Vec<HandednessEvidence>,
    /// The trials in that orientation.
    pub oriented: Vec<OrientedTrial>,
    /// How well they agree.
    pub consistency: Consistency,
}

/// Proves the handedness of all trials.
///
/// # Errors
///
/// [`CalibrationRefusal::KnownLoadsContradict`], [`CalibrationRefusal::TurningContradicts`],
/// [`CalibrationRefusal::TurningUnclear`], [`CalibrationRefusal::TooManyUndecided`],
/// [`CalibrationRefusal::TrialsContradict`], [`CalibrationRefusal::HandednessNotSettled`].
pub fn prove(
    trials: &[SolvedTrial],
    alignments: &[Alignment],
    arms: &Stack,
    gravity: f64,
) -> Result<Proven, CalibrationRefusal> {
    let mut possible = Vec::with_capacity(trials.len());
    for (trial, (solved, alignment)) in trials.iter().zip(alignments).enumerate() {
        possible.push(possible_hands(trial, solved, alignment)?);
    }
    let undecided: Vec<usize> = (0..trials.len()).filter(|&trial| possible[trial].hands.len() > 1).collect();
    if undecided.len() > MOST_UNDECIDED {
        return Err(CalibrationRefusal::TooManyUndecided { trials: undecided });
    }

    let mut ranking: Vec<Combination> = combinations(&possible)
        .into_iter()
        .map(|hands| Combination::of(hands, trials, alignments, arms, gravity))
        .collect();
    ranking.sort_by(|a, b| a.misfit().total_cmp(&b.misfit()));
    let mut ranking = ranking.into_iter();
    let Some(best) = ranking.next() else {
        return Err(CalibrationRefusal::HandednessNotSettled {
            trials: undecided,
            margin: 0.0,
            need: MARGIN,
        });
    };

    let freedom =
        best.consistency.freedom + alignments.iter().map(|alignment| alignment.freedom).sum::<usize>();
    let strain = if freedom == 0 { 1.0 } else { (best.misfit() / freedom as f64).max(1.0) };
    if let Some(runner_up) = ranking.next() {
        let (margin, need) = (runner_up.misfit() - best.misfit(), MARGIN * strain);
        let ruled_out = margin >= need;
        if !ruled_out {
            let differing =
                undecided.iter().copied().filter(|&trial| best.hands[trial] != runner_up.hands[trial]);
            return Err(CalibrationRefusal::HandednessNotSettled {
                trials: differing.collect(),
                margin,
                need,
            });
        }
    }
    let Consistency { misfit, freedom, .. } = best.consistency;
    let agree = misfit <= CONTRADICTION * freedom as f64;
    if freedom > 0 && !agree {
        return Err(CalibrationRefusal::TrialsContradict {
            residual: arms.fuse(&best.shapes()).residual,
            ratio: (misfit / freedom as f64).sqrt(),
        });
    }
    let evidence =
        possible.iter().map(|possible| possible.evidence.unwrap_or(HandednessEvidence::Fusion)).collect();
    Ok(Proven { hands: best.hands, evidence, oriented: best.oriented, consistency: best.consistency })
}

/// The hands that one trial's own evidence leaves.
pub struct PossibleHands {
    /// One or both.
    pub hands: Vec<Hand>,
    /// What left only one; `None` where both are possible.
    pub evidence: Option<HandednessEvidence>,
}

/// The hands that the known loads of a trial (numbered from zero) and its sense of turning leave.
///
/// # Errors
///
/// [`CalibrationRefusal::KnownLoadsContradict`], [`CalibrationRefusal::TurningContradicts`],
/// [`CalibrationRefusal::TurningUnclear`].
pub fn possible_hands(
    trial: usize,
    solved: &SolvedTrial,
    alignment: &Alignment,
) -> Result<PossibleHands, CalibrationRefusal> {
    let [rotation, mirror_image] = &alignment.candidates;
    let (better, worse) = if rotation.misfit <= mirror_image.misfit {
        (rotation, mirror_image)
    } else {
        (mirror_image, rotation)
    };
    let allowed = CONTRADICTION * alignment.freedom as f64;
    if alignment.freedom > 0 && better.misfit > allowed {
        let worst = better.angles_rad.iter().copied().enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b));
        let (load, angle_rad) = worst.unwrap_or_default();
        return Err(CalibrationRefusal::KnownLoadsContradict {
            trial,
            load,
            angle_deg: angle_rad.to_degrees(),
        });
    }
    let strain = (better.misfit / alignment.freedom.max(1) as f64).max(1.0);
    let by_loads = worse.misfit - better.misfit >= MARGIN * strain;
    let by_turning = solved.turned.as_ref().map(|turned| super::turning::hand(trial, turned)).transpose()?;
    match by_turning {
        Some(hand) if by_loads && hand != better.hand => {
            Err(CalibrationRefusal::TurningContradicts { trial })
        }
        Some(hand) if !by_loads => {
            Ok(PossibleHands { hands: vec![hand], evidence: Some(HandednessEvidence::Turning) })
        }
        _ if by_loads => {
            Ok(PossibleHands { hands: vec![better.hand], evidence: Some(HandednessEvidence::KnownLoads) })
        }
        _ => Ok(PossibleHands { hands: vec![Hand::Rotation, Hand::MirrorImage], evidence: None }),
    }
}

/// Every way to pick one hand for each trial.
fn combinations(possible: &[PossibleHands]) -> Vec<Vec<Hand>> {
    possible.iter().fold(vec![Vec::new()], |combinations, PossibleHands { hands, .. }| {
        let extended = combinations.iter().flat_map(|combination| {
            hands.iter().map(move |&hand| combination.iter().copied().chain([hand]).collect())
        });
        extended.collect()
    })
}

/// One combination of hands, and how well it fits.
struct Combination {
    hands: Vec<Hand>,
    oriented: Vec<OrientedTrial>,
    consistency: Consistency,
    alignment_misfit: f64,
}

impl Combination {
    fn of(
        hands: Vec<Hand>,
        trials: &[SolvedTrial],
        alignments: &[Alignment],
        arms: &Stack,
        gravity: f64,
    ) -> Self {
        let oriented: Vec<OrientedTrial> = trials
            .iter()
            .zip(alignments)
            .zip(&hands)
            .map(|((solved, alignment), &hand)| OrientedTrial {
                shape: oriented_shape(solved, &alignment.candidate(hand).orientation, gravity),
                arm_m: solved.case.arm_m.clone(),
                covariance: alignment.covariance.clone(),
                gain_uncertainty: solved.shape.covariance.gain_deviation(),
                arm_accuracy_m: solved.case.arm_accuracy_m,
                mass_accuracy: solved.case.mass_accuracy_kg / solved.case.mass_kg,
            })
            .collect();
        let alignment_misfit =
            alignments.iter().zip(&hands).map(|(alignment, &hand)| alignment.candidate(hand).misfit).sum();
        Self { consistency: consistency(&oriented, arms), hands, oriented, alignment_misfit }
    }

    fn misfit(&self) -> f64 {
        self.consistency.misfit + self.alignment_misfit
    }

    fn shapes(&self) -> Vec<DMatrix<f64>> {
        self.oriented.iter().map(|trial| trial.shape.clone()).collect()
    }
}

/// R Ŝ / F: the trial's shape in the sensor frame, counts per newton.
fn oriented_shape(solved: &SolvedTrial, orientation: &DMatrix<f64>, gravity: f64) -> DMatrix<f64> {
    orientation * &solved.shape.shape_counts_per_load / (solved.case.mass_kg * gravity)
}
