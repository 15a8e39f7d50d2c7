//! Field re-calibration with no known load: the stored shape says how the sensor frame lies (design § 8).
//!
//! Each new trial tells its shape up to a turn. The calibration in store predicts that shape at the trial's arm; the turn that
//! brings the one closest to the other ([`super::procrustes`]) orients it. What is left is how far the sensor has moved. The
//! trials' shapes, oriented so, correct the stored shape by the least change that explains them:
//!
//! ```text
//! S̃ = S̃₀ + [I Xᵀ]⁺ (stack − [I Xᵀ] S̃₀)
//! ```
//!
//! With arms that suffice for a calibration this is their fusion (eq. 18, 20), whatever S̃₀, and the start of the joint solution
//! ([`super::joint`]), in which the stored calibration takes the place of known loads: each trial sees the axes of the sensor frame
//! as the stored shape shows them. With fewer arms the stored shape is left as it was where they do not see.
//!
//! **What cannot be told.** A drift that acts like a turn of the sensor frame is taken for one. A drift of random gains has such
//! a part, smaller than the part that shows by √(turns ÷ coefficients); so the answer is refused where the part that shows is
//! large (`LARGEST_DRIFT`), or where the other hand fits nearly as well.
//!
//! **Known loads** that the session has all the same orient nothing here. They are compared with the answer, which is refused where
//! they contradict it.

#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, DVector};

use super::accuracy::wrench_deviation;
use super::alignment::{MODEL_ERROR, Sight, angle, sights};
use super::bias::{bias_covariance, common_bias};
use super::drift::{ShapeDeviation, drift};
use super::fusion::stack;
use super::handedness::MARGIN;
use super::joint::decision::{Candidate, decide, strain};
use super::joint::observation::Observation;
use super::joint::refinement::{Problem, State, refine};
use super::joint::uncertainty::Uncertainty;
use super::joint::{LARGEST_STRAIN, Solved};
use super::known_load::{mean_square_load, squashing_matrix};
use super::matrix::matrix_of_shape;
use super::procrustes::{Turned, onto};
use super::singular::Singular;
use super::wrench_uncertainty::WrenchUncertainty;
use super::{
    BiasOrigin, Calibration, CalibrationRefusal, Handedness, HandednessEvidence, Method, SolvedTrial,
    TrialRecord, of_joint_solution, require_motion,
};
use crate::gravity::Gravity;

/// The largest drift, relative, that is still told from a turn: the turn that hides in it is at most about half of it, which
/// is 3° here.
const LARGEST_DRIFT: f64 = 0.1;

/// How many times worse the other hand must fit.
const HAND_MARGIN: f64 = 3.0;

/// Combinations of rows that the arms see less than this, relative, they do not see.
const LEAST_SEEN: f64 = 1e-2;

/// Calibrates from trials and a stored calibration, with no known load.
///
/// # Errors
///
/// [`CalibrationRefusal::ReferenceDiffers`] where the sensor is another, or has moved too far;
/// [`CalibrationRefusal::KnownLoadsContradict`] and those of [`sights`] where the session has known loads; those of [`decide`],
/// [`CalibrationRefusal::BiasesDisagree`], [`CalibrationRefusal::FusionUncertain`],
/// [`CalibrationRefusal::ShapeRankDeficient`], [`CalibrationRefusal::NonFinite`].
pub fn recalibrate(
    stored: &Calibration,
    gravity: impl Into<Gravity>,
    trials: &[SolvedTrial],
) -> Result<Calibration, CalibrationRefusal> {
    require_motion(trials)?;
    let gravity = gravity.into();
    let mut oriented = Vec::with_capacity(trials.len());
    let mut records = Vec::with_capacity(trials.len());
    for (index, trial) in trials.iter().enumerate() {
        let orientation = orient(stored, gravity.magnitude, index, trial)?;
        records.push(record(index, trial, &orientation)?);
        oriented.push(orientation);
    }

    let rank = stored.dof.trial_rank();
    let lengths = lengths(stored);
    let squashing = scaled_squashing(rank, trials, &lengths);
    let seen = Singular::of(&squashing);
    let components_seen = seen.rank(LEAST_SEEN);
    let before = scaled(&stored.shape, &lengths);
    let stacked = stack(&oriented.iter().map(|oriented| oriented.found.turned.clone()).collect::<Vec<_>>());
    let after = &before + seen.pseudo_inverse(components_seen) * (&stacked - &squashing * &before);
    let misfit = (&stacked - &squashing * &after).norm() / stacked.norm();

    let (calibration, deviation) = if components_seen == stored.dof.count() {
        let start = State {
            orientations: oriented.iter().map(|oriented| oriented.found.orientation.clone()).collect(),
            arm_shifts: trials.iter().map(|trial| DVector::zeros(trial.case.arm_m.len())).collect(),
            mass_shifts: vec![0.0; trials.len()],
            shape: after,
        };
        let solved = jointly(gravity, trials, &oriented, &start, &lengths)?;
        let (calibration, propagated) = of_joint_solution(stored.dof, gravity, trials, &solved)?;
        let rough = ShapeDeviation::all(stored, trial_deviation(trials));
        (calibration, propagated.map_or(rough, |propagated| propagated.shape))
    } else {
        let calibration =
            least_change(stored, gravity, trials, &oriented, &scaled(&after, &lengths.map(f64::recip)))?;
        (
            Calibration { fusion_residual: misfit, ..calibration },
            ShapeDeviation::all(stored, trial_deviation(trials)),
        )
    };
    let after = scaled(&calibration.shape, &lengths);
    let drift = drift(stored, (&before, &after), &lengths, &deviation, components_seen);
    // At another gain, the response would have been another.
    Calibration { gain: stored.gain, trials: records, drift: Some(drift), ..calibration }.finite()
}

/// A trial turned onto what the stored calibration predicts of it.
struct Oriented {
    found: Turned,
    /// Standard deviation of the turn, radian: what the stored calibration promises of directions, and what hides in the drift.
    deviation_rad: f64,
}

fn orient(
    stored: &Calibration,
    gravity: f64,
    index: usize,
    trial: &SolvedTrial,
) -> Result<Oriented, CalibrationRefusal> {
    let rank = stored.dof.trial_rank();
    let shape = &trial.shape.shape_counts_per_load / (trial.case.mass_kg * gravity);
    if shape.ncols() != stored.gages() {
        return Err(CalibrationRefusal::GagesDiffer {
            trial: index,
            gages: shape.ncols(),
            stored: stored.gages(),
        });
    }
    let predicted = squashing_matrix(rank, &trial.case.arm_m) * &stored.shape;
    let found = onto(&shape, &predicted);
    let told_apart = found.residual <= LARGEST_DRIFT && found.other_hand >= HAND_MARGIN * found.residual;
    if !told_apart {
        return Err(CalibrationRefusal::ReferenceDiffers {
            trial: index,
            drift: found.residual,
            other_hand: found.other_hand,
            scale: shape.norm() / predicted.norm(),
            need: LARGEST_DRIFT,
        });
    }
    let turns = rank * (rank - 1) / 2;
    let others = (rank * stored.gages()).saturating_sub(turns).max(1);
    let hidden = found.residual * (turns as f64 / others as f64).sqrt();
    let promised = wrench_deviation(stored).unwrap_or(0.0).hypot(MODEL_ERROR);
    let own = trial.shape.covariance.gain_deviation();
    Ok(Oriented { deviation_rad: hidden.hypot(promised).hypot(own), found })
}

/// What the file keeps of a trial; its known loads are compared with the orientation found.
fn record(index: usize, trial: &SolvedTrial, oriented: &Oriented) -> Result<TrialRecord, CalibrationRefusal> {
    let mut squares = 0.0;
    let sights = sights(index, &trial.case, &trial.shape)?;
    for (load, sight) in sights.iter().enumerate() {
        let off = angle(&(&oriented.found.orientation * &sight.seen), &sight.known);
        // MARGIN is the square of five standard deviations.
        if off > MARGIN.sqrt() * sight.deviation_rad.hypot(oriented.deviation_rad) {
            let angle_deg = off.to_degrees();
            return Err(CalibrationRefusal::KnownLoadsContradict { trial: index, load, angle_deg });
        }
        squares += off * off;
    }
    let residual_deg = (squares / sights.len().max(1) as f64).sqrt().to_degrees();
    Ok(trial.record(residual_deg, HandednessEvidence::Reference))
}

/// The joint solution of trials whose arms suffice, started from their orientation by the stored calibration.
fn jointly(
    gravity: Gravity,
    trials: &[SolvedTrial],
    oriented: &[Oriented],
    start: &State,
    lengths: &DVector<f64>,
) -> Result<Solved, CalibrationRefusal> {
    let with = |model_error: f64| {
        let each = trials.iter().zip(oriented).enumerate();
        let observations = each
            .map(|(index, (trial, oriented))| {
                let observation = Observation::new(index, trial, gravity.magnitude, model_error)?;
                Ok(Observation { sights: axes(oriented), hand: None, ..observation })
            })
            .collect::<Result<Vec<_>, CalibrationRefusal>>()?;
        let problem = Problem { rank: oriented_rank(oriented), lengths: lengths.clone(), observations };
        let answer = decide(&problem, vec![Candidate::of(&problem, refine(&problem, start.clone()))])?;
        let evidence = vec![HandednessEvidence::Reference; trials.len()];
        Ok(Solved { strain: strain(&problem, answer.misfit), problem, answer, evidence })
    };
    // Trials that do not fit at their word may fit as any linear model does.
    match with(0.0) {
        Ok(solved) if solved.strain <= LARGEST_STRAIN => Ok(solved),
        _ => with(MODEL_ERROR),
    }
}

/// The axes of the sensor frame as the trial sees them.
fn axes(oriented: &Oriented) -> Vec<Sight> {
    let orientation = &oriented.found.orientation;
    let rank = orientation.nrows();
    let axis = |axis: usize| DVector::from_fn(rank, |row, _| if row == axis { 1.0 } else { 0.0 });
    let sights = (0..rank).map(|k| Sight {
        seen: orientation.transpose() * axis(k),
        known: axis(k),
        deviation_rad: oriented.deviation_rad,
    });
    sights.collect()
}

fn oriented_rank(oriented: &[Oriented]) -> usize {
    oriented.first().map_or(0, |oriented| oriented.found.orientation.nrows())
}

/// A drift acts on a wrench in several components at once, and half as much of it again hides in the turn.
const HIDDEN: f64 = 2.0;

/// The calibration of a shape of which the arms have seen a part. To what the stored one promised are added the trials' own gains and
/// masses, which is too much for either part, and as much drift as the part seen shows: what is not seen may have moved
/// by as much.
fn least_change(
    stored: &Calibration,
    gravity: Gravity,
    trials: &[SolvedTrial],
    oriented: &[Oriented],
    shape: &DMatrix<f64>,
) -> Result<Calibration, CalibrationRefusal> {
    let drift = oriented.iter().map(|oriented| oriented.found.residual).fold(0.0, f64::max);
    let matrix = matrix_of_shape(shape).map_err(|_| CalibrationRefusal::ShapeRankDeficient)?;
    let lengths = lengths(stored);
    let newtons: Vec<f64> = trials.iter().map(|trial| trial.case.mass_kg * gravity.magnitude).collect();
    let changed = Changed::new(gravity, trials, drift);
    let uncertainty = stored.uncertainty.as_ref().map(|uncertainty| {
        let full_n = root_mean_square(newtons.iter().copied());
        let before_n = super::accuracy::full_load_n(stored).unwrap_or(full_n);
        let typical_n = full_n / (stored.dof.trial_rank() as f64).sqrt();
        let moved_n = changed.scale.hypot(changed.gain).hypot(HIDDEN * drift) * typical_n;
        let wrench = uncertainty.wrench.as_ref().map(|wrench| {
            let bias = bias_covariance(trials, gravity.magnitude).bias;
            let unloaded = (&matrix * bias * matrix.transpose()).diagonal().map(f64::sqrt);
            changed.wrench(wrench, &lengths, unloaded)
        });
        Uncertainty {
            matrix: DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |row, gage| {
                let added = changed.scale.hypot(changed.gain) * matrix[(row, gage)];
                uncertainty.matrix[(row, gage)].hypot(added).hypot(drift * matrix.row(row).norm())
            }),
            per_axis_full_load: match &wrench {
                Some(wrench) => {
                    let arms = trials.iter().map(|trial| trial.case.arm_m.clone());
                    let (rank, components) = (stored.dof.trial_rank(), stored.dof.count());
                    let loads = mean_square_load(rank, components, arms.zip(newtons.iter().copied()));
                    wrench.mean_variance(&loads).map(f64::sqrt)
                }
                None => uncertainty.per_axis_full_load.zip_map(&lengths, |deviation, length| {
                    (deviation * full_n / before_n).hypot(moved_n * length)
                }),
            },
            wrench,
            gravity_accuracy: Some(gravity.accuracy.max(uncertainty.gravity_accuracy.unwrap_or(0.0))),
        }
    });
    Calibration {
        dof: stored.dof,
        method: Method::Sfm,
        gain: None,
        gravity: gravity.magnitude,
        matrix,
        bias_counts: common_bias(trials)?,
        bias: BiasOrigin::Estimated,
        shape: shape.clone(),
        handedness: Handedness::Proven,
        fusion_residual: 0.0,
        uncertainty,
        trials: Vec::new(),
        checks: Vec::new(),
        drift: None,
    }
    .finite()
}

/// By how much more than the stored calibration says a wrench may be wrong, as shares of the load.
struct Changed {
    /// All components in one ratio: the masses, and gravity.
    scale: f64,
    /// Any gain or cross-talk of the trials.
    gain: f64,
    /// The whole shape.
    drift: f64,
    rank: f64,
}

impl Changed {
    fn new(gravity: Gravity, trials: &[SolvedTrial], drift: f64) -> Self {
        let largest = |of: &dyn Fn(&SolvedTrial) -> f64| trials.iter().map(of).fold(0.0, f64::max);
        Self {
            scale: largest(&|trial| trial.case.mass_accuracy_kg / trial.case.mass_kg)
                .hypot(gravity.relative_accuracy()),
            gain: largest(&|trial| trial.shape.covariance.gain_deviation()),
            drift,
            rank: trials.first().map_or(1.0, |trial| trial.shape.rank() as f64),
        }
    }

    /// What a calibration says of its wrenches after that, with a bias of its own, of which the stored shape knows nothing.
    /// A gain off by g displaces a component by g|w|, wherever w points; a shape that has moved by d of its whole, of which
    /// each of r rows has its share, by d|w|/√r.
    fn wrench(
        &self,
        before: &WrenchUncertainty,
        lengths: &DVector<f64>,
        unloaded: DVector<f64>,
    ) -> WrenchUncertainty {
        let any = self.gain.powi(2) + (HIDDEN * self.drift).powi(2) / self.rank;
        let by_load = before.by_load.iter().zip(lengths).enumerate().map(|(row, (before, own))| {
            let mut after =
                before + DMatrix::from_diagonal(&lengths.map(|length| any * (own / length).powi(2)));
            after[(row, row)] += self.scale.powi(2);
            after
        });
        let with_bias = vec![DVector::zeros(lengths.len()); lengths.len()];
        WrenchUncertainty { by_load: by_load.collect(), with_bias, unloaded }
    }
}

fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}

/// Relative standard deviation of the least certain trial: of its gains and of its mass.
fn trial_deviation(trials: &[SolvedTrial]) -> f64 {
    let of = |trial: &SolvedTrial| {
        trial.shape.covariance.gain_deviation().hypot(trial.case.mass_accuracy_kg / trial.case.mass_kg)
    };
    trials.iter().map(of).fold(0.0, f64::max)
}

impl ShapeDeviation {
    /// The same for every gage and component of a sensor.
    fn all(sensor: &Calibration, deviation: f64) -> Self {
        Self {
            gages: DVector::from_element(sensor.gages(), deviation),
            components: DVector::from_element(sensor.dof.count(), deviation),
        }
    }
}

/// What brings a row of the stored shape to one unit: one for forces, the length in metre at which torques answer as forces do.
fn lengths(stored: &Calibration) -> DVector<f64> {
    let (rank, rows) = (stored.dof.trial_rank(), stored.dof.count());
    let mean =
        |from: usize, count: usize| stored.shape.rows(from, count).norm() / (count.max(1) as f64).sqrt();
    let length = if rows > rank { mean(0, rank) / mean(rank, rows - rank) } else { 1.0 };
    DVector::from_fn(rows, |row, _| if row < rank { 1.0 } else { length })
}

/// The rows of a shape, each times its length.
fn scaled(shape: &DMatrix<f64>, lengths: &DVector<f64>) -> DMatrix<f64> {
    let mut scaled = shape.clone();
    for (mut row, &length) in scaled.row_iter_mut().zip(lengths) {
        row *= length;
    }
    scaled
}

/// [I Xᵀ] of all trials, one above the other, its columns over the lengths.
fn scaled_squashing(rank: usize, trials: &[SolvedTrial], lengths: &DVector<f64>) -> DMatrix<f64> {
    let blocks: Vec<DMatrix<f64>> =
        trials.iter().map(|trial| squashing_matrix(rank, &trial.case.arm_m)).collect();
    let mut squashing = stack(&blocks);
    for (mut column, &length) in squashing.column_iter_mut().zip(lengths) {
        column /= length;
    }
    squashing
}
