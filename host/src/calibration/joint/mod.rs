//! Joint moment-arm fusion: one solution for all trials at once (design § 7).
//!
//! The paper orients each trial by its own known loads and then stacks the results (eq. 18, 20), so that the errors of the
//! known directions pass into the answer undiminished. But the arms orient the frame themselves, far better, since the shapes
//! of trials at different arms must fit together; known loads are only needed to pick one of a few discrete answers.
//!
//! | module | step |
//! |---|---|
//! | [`observation`] | what one trial contributes, and how certain each part of it is |
//! | [`arms`] | closed form: orientations from the arms, up to signs and mirror images |
//! | [`refinement`] | least squares over orientations, shape, arms and masses |
//! | [`decision`] | the one answer that the known loads leave, or a refusal |
//! | [`uncertainty`] | covariance of the result |
//!
//! Every answer that might be right is refined and judged: those that the arms allow (all their signs and mirror images)
//! and those that the known loads alone would give. Trials are taken at their word; where they disagree by more than that,
//! every coefficient is allowed the error of any linear model besides.

pub mod arms;
pub mod decision;
pub mod observation;
pub mod refinement;
pub mod uncertainty;

#[cfg(test)]
mod tests;

use ftcal_shared::units::Dof;
use nalgebra::{DMatrix, DVector};

use self::arms::Base;
use self::decision::{Candidate, decide, strain};
use self::observation::Observation;
use self::refinement::{Problem, State, refine, refine_all};
use super::alignment::{Alignment, MODEL_ERROR, orient};
use super::fusion::{Stack, stack};
use super::handedness::{self, MARGIN, MOST_UNDECIDED, PossibleHands, possible_hands};
use super::{CalibrationRefusal, HandednessEvidence, SolvedTrial};

/// The misfit over its degrees of freedom beyond which trials are no longer taken at their word.
pub const LARGEST_STRAIN: f64 = 2.0;

/// What the joint solution finds.
#[derive(Clone, Debug)]
pub struct Solved {
    /// What was observed.
    pub problem: Problem,
    /// The answer with its angles to the known loads.
    pub answer: Candidate,
    /// What settled each trial's hand.
    pub evidence: Vec<HandednessEvidence>,
    /// How many times larger than expected the misfit is, one at least.
    pub strain: f64,
}

impl Solved {
    /// S̃ (m × p), counts per newton and newton metre.
    pub fn shape(&self) -> DMatrix<f64> {
        let mut shape = self.answer.fit.state.shape.clone();
        for (mut row, &length) in shape.row_iter_mut().zip(&self.problem.lengths) {
            row /= length;
        }
        shape
    }

    /// Root mean square angle between the known directions of a trial and those found, degrees; zero of none.
    pub fn alignment_residual_deg(&self, trial: usize) -> f64 {
        let angles = self.answer.angles_rad.get(trial).map_or(&[][..], Vec::as_slice);
        let squares: f64 = angles.iter().map(|angle| angle * angle).sum();
        (squares / angles.len().max(1) as f64).sqrt().to_degrees()
    }

    /// The part of the trials' shapes that the answer does not explain, relative.
    pub fn residual(&self) -> f64 {
        residual(&self.problem, &self.answer.fit.state)
    }
}

/// Solves all trials jointly.
///
/// # Errors
///
/// Those of the arms, of [`decide`], of each trial's own known loads ([`possible_hands`]), and, for a force sensor, of
/// [`handedness::prove`].
pub fn solve(dof: Dof, gravity: f64, trials: &[SolvedTrial]) -> Result<Solved, CalibrationRefusal> {
    let arms_m: Vec<&DVector<f64>> = trials.iter().map(|trial| &trial.case.arm_m).collect();
    let arms = Stack::new(dof, &arms_m)?;
    let start = if dof.has_torque() { Start::Arms(Base::choose(dof, &arms_m)?) } else { Start::KnownLoads };
    let at_their_word = solve_with(dof, gravity, trials, &arms, &start, 0.0);
    let strained = match &at_their_word {
        Ok(solved) => solved.strain > LARGEST_STRAIN,
        Err(CalibrationRefusal::HandednessNotSettled { need, .. }) => *need > MARGIN * LARGEST_STRAIN,
        Err(refusal) => matches!(
            refusal,
            CalibrationRefusal::TrialsContradict { .. } | CalibrationRefusal::MassesContradict { .. }
        ),
    };
    if strained { solve_with(dof, gravity, trials, &arms, &start, MODEL_ERROR) } else { at_their_word }
}

/// What the answers are started from.
enum Start {
    /// The arms, and the known loads where they suffice.
    Arms(Base),
    /// The known loads alone: force sensors have no arms.
    KnownLoads,
}

fn solve_with(
    dof: Dof,
    gravity: f64,
    trials: &[SolvedTrial],
    arms: &Stack,
    start: &Start,
    model_error: f64,
) -> Result<Solved, CalibrationRefusal> {
    let observations = trials
        .iter()
        .enumerate()
        .map(|(index, trial)| Observation::new(index, trial, gravity, model_error))
        .collect::<Result<Vec<_>, _>>()?;
    let problem = Problem { observations, lengths: arms.lengths.clone(), rank: dof.trial_rank() };
    let (answer, evidence) = match start {
        Start::Arms(base) => {
            let own = own_evidence(&problem, trials)?;
            let mut candidates = by_arms(&problem, base, arms);
            candidates.extend(by_known_loads(&problem, &own, arms)?);
            let answer = decide(&problem, candidates)?;
            let evidence = own.iter().zip(trials).map(|((_, possible), trial)| {
                let turning =
                    trial.turned.map_or(HandednessEvidence::Fusion, |_| HandednessEvidence::Turning);
                possible.as_ref().and_then(|possible| possible.evidence).unwrap_or(turning)
            });
            (answer, evidence.collect())
        }
        Start::KnownLoads => {
            let alignments = trials
                .iter()
                .enumerate()
                .map(|(index, trial)| super::alignment::align(index, &trial.case, &trial.shape))
                .collect::<Result<Vec<_>, _>>()?;
            let proven = handedness::prove(trials, &alignments, arms, gravity)?;
            let orientations = alignments
                .iter()
                .zip(&proven.hands)
                .map(|(alignment, &hand)| alignment.candidate(hand).orientation.clone());
            let fit = refine(&problem, problem.start(orientations.collect(), arms));
            (decide(&problem, vec![Candidate::of(&problem, fit)])?, proven.evidence)
        }
    };
    Ok(Solved { strain: strain(&problem, answer.misfit), problem, answer, evidence })
}

/// What the known loads and the turning of each trial say by themselves, where they orient it at all.
type OwnEvidence = Vec<(Option<Alignment>, Option<PossibleHands>)>;

fn own_evidence(problem: &Problem, trials: &[SolvedTrial]) -> Result<OwnEvidence, CalibrationRefusal> {
    let each = problem.observations.iter().zip(trials).enumerate();
    each.map(|(index, (observation, trial))| {
        let alignment = orient(problem.rank, &observation.sights).ok();
        let possible =
            alignment.as_ref().map(|alignment| possible_hands(index, trial, alignment)).transpose()?;
        Ok((alignment, possible))
    })
    .collect()
}

/// The answers that the arms allow: the starts that fit without known loads, with all their equivalents.
fn by_arms(problem: &Problem, base: &Base, arms: &Stack) -> Vec<Candidate> {
    let mut blind = problem.clone();
    for observation in &mut blind.observations {
        observation.sights.clear();
    }
    let fits = refine_all(&blind, base.starts(problem, arms));
    let least = fits.first().map_or(0.0, |fit| fit.misfit);
    let allowed = least + MARGIN * strain(&blind, least);
    let equivalents = fits
        .iter()
        .filter(|fit| fit.misfit <= allowed)
        .flat_map(|fit| base.equivalents(problem, &fit.state, arms));
    refine_all(problem, equivalents).into_iter().map(|fit| Candidate::of(problem, fit)).collect()
}

/// The answers that the known loads give where they orient every trial: all combinations of the hands they leave.
fn by_known_loads(
    problem: &Problem,
    own: &OwnEvidence,
    arms: &Stack,
) -> Result<Vec<Candidate>, CalibrationRefusal> {
    let mut combinations: Vec<Vec<DMatrix<f64>>> = vec![Vec::new()];
    let mut undecided = Vec::new();
    for (trial, evidence) in own.iter().enumerate() {
        let (Some(alignment), Some(PossibleHands { hands, .. })) = evidence else { return Ok(Vec::new()) };
        if hands.len() > 1 {
            undecided.push(trial);
        }
        if undecided.len() > MOST_UNDECIDED {
            return Err(CalibrationRefusal::TooManyUndecided { trials: undecided });
        }
        combinations = combinations
            .iter()
            .flat_map(|orientations| {
                hands.iter().map(|&hand| {
                    let orientation = alignment.candidate(hand).orientation.clone();
                    orientations.iter().cloned().chain([orientation]).collect()
                })
            })
            .collect();
    }
    let starts = combinations.into_iter().map(|orientations| problem.start(orientations, arms));
    Ok(refine_all(problem, starts).into_iter().map(|fit| Candidate::of(problem, fit)).collect())
}

/// The part of the oriented trials that an answer does not explain, relative: ‖R S − μ[I Xᵀ]S̃‖ / ‖S‖.
fn residual(problem: &Problem, state: &State) -> f64 {
    let oriented: Vec<DMatrix<f64>> = (0..problem.observations.len())
        .map(|trial| {
            &state.orientations[trial] * &problem.observations[trial].shape / problem.mass_ratio(trial, state)
        })
        .collect();
    let explained: Vec<DMatrix<f64>> = (0..oriented.len())
        .map(|trial| problem.squashing(&problem.arm_m(trial, state)) * &state.shape)
        .collect();
    let (oriented, explained) = (stack(&oriented), stack(&explained));
    (&oriented - explained).norm() / oriented.norm()
}
