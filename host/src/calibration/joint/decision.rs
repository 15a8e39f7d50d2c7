//! Which of the answers that fit is the right one: proven, or refused (design § 6, § 7).
//!
//! The arms leave discrete answers that fit equally well; known loads tell them apart, however rough:
//!
//! * a direction that is known well weighs in with the square of its angle over its accuracy, and an answer must be better
//!   than every other by [`MARGIN`], five standard deviations, and by as much more as it fits worse than it should;
//! * a direction known only roughly ("about upwards") has no such tails. It is taken at its word: nobody who says where a
//!   load pulls is wrong by more than 33°, or by more than he says. An answer in which he would be, is out.
//!
//! An answer is given only if a single one is left.

use nalgebra::DMatrix;

use super::super::CalibrationRefusal;
use super::super::alignment::{Hand, angle};
use super::super::handedness::{CONTRADICTION, MARGIN};
use super::refinement::{Fit, Problem, State, refine};

/// A direction is known roughly where five standard deviations are more than this, radian (33°).
const LARGEST_SLIP_RAD: f64 = 0.58;

/// What a rough accuracy is taken for: a limit, with a little for its own rounding and for the trial's noise.
const SLIP: f64 = 1.1;

/// How many standard deviations an accurate direction may be off.
const TAIL: f64 = 5.0;

/// Orientations closer than this are one and the same answer, radian.
const SAME_ORIENTATION: f64 = 0.05;

/// How far a mass may be off when it is asked which one contradicts the others, relative.
const ANY_MASS: f64 = 1.0;

/// An answer with what the known loads say to it.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The answer.
    pub fit: Fit,
    /// The angles between the known loads and those of the answer, for each trial, radian.
    pub angles_rad: Vec<Vec<f64>>,
    /// The misfit, angles of known loads included.
    pub misfit: f64,
}

impl Candidate {
    /// Judges an answer by the known loads.
    pub fn of(problem: &Problem, fit: Fit) -> Self {
        let angles_rad: Vec<Vec<f64>> = problem
            .observations
            .iter()
            .zip(&fit.state.orientations)
            .map(|(trial, orientation)| {
                trial.sights.iter().map(|sight| angle(&(orientation * &sight.seen), &sight.known)).collect()
            })
            .collect();
        let loads: f64 = problem
            .observations
            .iter()
            .zip(&angles_rad)
            .flat_map(|(trial, angles)| trial.sights.iter().zip(angles))
            .map(|(sight, angle)| (angle / sight.deviation_rad).powi(2))
            .sum();
        Self { misfit: problem.fusion_misfit(&fit.state) + loads, angles_rad, fit }
    }

    /// The hand of one trial.
    pub fn hand(&self, trial: usize) -> Hand {
        let determinant = self.fit.state.orientations.get(trial).map_or(1.0, DMatrix::determinant);
        if determinant < 0.0 { Hand::MirrorImage } else { Hand::Rotation }
    }

    /// The known load that is farther off than anybody can be wrong, with trial and angle.
    fn impossible_load(&self, problem: &Problem) -> Option<(usize, usize, f64)> {
        let loads = problem.observations.iter().zip(&self.angles_rad).enumerate();
        let mut all = loads.flat_map(|(trial, (observation, angles))| {
            let loads = observation.sights.iter().zip(angles).enumerate();
            loads.map(move |(load, (sight, &angle))| (trial, load, sight.deviation_rad, angle))
        });
        all.find(|&(_, _, deviation, angle)| {
            TAIL * deviation > LARGEST_SLIP_RAD && angle > LARGEST_SLIP_RAD.max(SLIP * deviation)
        })
        .map(|(trial, load, _, angle)| (trial, load, angle))
    }

    /// A trial that would have turned the other way round than the session says.
    fn turned_wrongly(&self, problem: &Problem) -> Option<usize> {
        let demanded = problem.observations.iter().map(|observation| observation.hand);
        demanded
            .enumerate()
            .find(|&(trial, hand)| hand.is_some_and(|hand| hand != self.hand(trial)))
            .map(|(trial, _)| trial)
    }

    /// Trials that another answer takes for mirror images of these; if it mirrors none, those that it turns otherwise.
    fn differing(&self, other: &State) -> Vec<usize> {
        let mirrored: Vec<usize> =
            self.apart(other, |one, other| one.determinant() * other.determinant() < 0.0);
        if mirrored.is_empty() { self.turned_otherwise(other) } else { mirrored }
    }

    fn turned_otherwise(&self, other: &State) -> Vec<usize> {
        // ‖R − Q‖ is √2 times twice the sine of half the angle between two rotations.
        self.apart(other, |one, other| (one - other).norm() > std::f64::consts::SQRT_2 * SAME_ORIENTATION)
    }

    fn apart(&self, other: &State, differ: impl Fn(&DMatrix<f64>, &DMatrix<f64>) -> bool) -> Vec<usize> {
        let both = self.fit.state.orientations.iter().zip(&other.orientations).enumerate();
        both.filter(|&(_, (one, other))| differ(one, other)).map(|(trial, _)| trial).collect()
    }
}

/// How many times larger the misfit is than its degrees of freedom, one at least.
pub fn strain(problem: &Problem, misfit: f64) -> f64 {
    match problem.freedom() {
        0 => 1.0,
        freedom => (misfit / freedom as f64).max(1.0),
    }
}

/// The one answer that the evidence leaves.
///
/// # Errors
///
/// [`CalibrationRefusal::NoKnownLoad`], [`CalibrationRefusal::TurningContradicts`],
/// [`CalibrationRefusal::KnownLoadsContradict`], [`CalibrationRefusal::MassesContradict`],
/// [`CalibrationRefusal::TrialsContradict`], [`CalibrationRefusal::HandednessNotSettled`].
pub fn decide(problem: &Problem, mut candidates: Vec<Candidate>) -> Result<Candidate, CalibrationRefusal> {
    if problem.observations.iter().all(|trial| trial.sights.is_empty()) {
        return Err(CalibrationRefusal::NoKnownLoad { trial: 0 });
    }
    candidates.retain(|candidate| candidate.misfit.is_finite());
    candidates.sort_by(|a, b| a.misfit.total_cmp(&b.misfit));
    let Some(closest) = candidates.first().cloned() else { return Err(CalibrationRefusal::NonFinite) };
    let possible: Vec<Candidate> = candidates
        .into_iter()
        .filter(|candidate| {
            candidate.impossible_load(problem).is_none() && candidate.turned_wrongly(problem).is_none()
        })
        .collect();
    let best = possible.first().unwrap_or(&closest);
    require_consistent(problem, best)?;
    if possible.is_empty() {
        if let Some(trial) = best.turned_wrongly(problem) {
            return Err(CalibrationRefusal::TurningContradicts { trial });
        }
        let (trial, load, angle) = best.impossible_load(problem).unwrap_or_default();
        return Err(CalibrationRefusal::KnownLoadsContradict { trial, load, angle_deg: angle.to_degrees() });
    }

    let need = MARGIN * strain(problem, best.misfit);
    let mut unsettled: Vec<usize> = Vec::new();
    let mut margin = f64::INFINITY;
    for other in &possible {
        let differing = best.differing(&other.fit.state);
        let by = other.misfit - best.misfit;
        let ruled_out = by >= need;
        if !differing.is_empty() && !ruled_out {
            margin = margin.min(by);
            unsettled.extend(differing);
        }
    }
    unsettled.sort_unstable();
    unsettled.dedup();
    if unsettled.is_empty() {
        Ok(best.clone())
    } else {
        Err(CalibrationRefusal::HandednessNotSettled { trials: unsettled, margin, need })
    }
}

/// Refuses an answer that fits worse than the accuracies allow, and names the mass where that is the cause.
fn require_consistent(problem: &Problem, best: &Candidate) -> Result<(), CalibrationRefusal> {
    let freedom = problem.freedom();
    let contradicts = |misfit: f64| misfit > CONTRADICTION * freedom as f64;
    if freedom == 0 || !contradicts(best.misfit) {
        return Ok(());
    }
    let mut any_mass = problem.clone();
    for trial in &mut any_mass.observations {
        trial.mass_accuracy = ANY_MASS;
    }
    let mut start = best.fit.state.clone();
    start.mass_shifts.fill(0.0);
    let freed = Candidate::of(&any_mass, refine(&any_mass, start));
    let mut masses = freed.fit.state.mass_shifts.clone();
    masses.sort_by(f64::total_cmp);
    let middle = masses.get(masses.len() / 2).zip(masses.get((masses.len().max(1) - 1) / 2));
    let usual = middle.map_or(0.0, |(&upper, &lower)| f64::midpoint(upper, lower));
    let off = |shift: f64| (shift - usual).abs();
    let shifts = freed.fit.state.mass_shifts.iter().copied().enumerate();
    match shifts.max_by(|&(_, a), &(_, b)| off(a).total_cmp(&off(b))) {
        Some((trial, shift)) if !contradicts(freed.misfit) => {
            Err(CalibrationRefusal::MassesContradict { trial, ratio: (shift - usual).exp() })
        }
        _ => Err(CalibrationRefusal::TrialsContradict {
            residual: super::residual(problem, &best.fit.state),
            ratio: strain(problem, best.misfit).sqrt(),
        }),
    }
}
