//! The joint solution: orientations, true shape, arms and masses that fit all trials best (design § 7).
//!
//! Unknown are, for each trial, the rotation or mirror image R, the arm a and the mass; and, once, the true shape S̃ (m × p).
//! The sum of squares
//!
//! ```text
//! Σ ‖ W (μ Rᵀ[I Xᵀ] S̃ − S) ‖²  +  Σ ‖ (R m̂ₖ − uₖ)/σₖ ‖²  +  Σ ‖ (a − stated)/σₐ ‖²  +  Σ (ln μ / σ_μ)²
//! ```
//!
//! over the trials, with W of [`super::observation`] and μ the true mass over the stated one, is minimised by Gauss-Newton
//! steps, damped where a step fails (Levenberg, Marquardt). R moves by small turns in the sensor frame and so stays
//! orthogonal and keeps its hand. Torque rows of S̃ are multiplied by the characteristic arm length throughout.

use nalgebra::{DMatrix, DVector, Rotation2, Rotation3, Vector3};

use super::super::fusion::Stack;
use super::super::known_load::squashing_matrix;
use super::observation::Observation;

/// Steps after which a start that has not settled is left as it is: most are hopeless.
const MOST_STEPS: usize = 30;

/// How often the steps of a promising one begin anew: along a narrow valley they are short.
const MOST_ROUNDS: usize = 20;

/// A start is promising whose sum of squares is so many times the least, or that to be expected.
const PROMISING: f64 = 1e3;

/// A step that lowers the sum of squares by less than this, relative and absolute, is the last.
const LEAST_GAIN: f64 = 1e-7;

/// Damping to begin with, and beyond which no step helps, relative to the normal matrix.
const FIRST_DAMPING: f64 = 1e-6;
const LAST_DAMPING: f64 = 1e8;

/// Everything that is observed.
#[derive(Clone, Debug)]
pub struct Problem {
    /// The trials.
    pub observations: Vec<Observation>,
    /// What each row of S̃ is multiplied by (m): one for forces, the characteristic arm length for torques.
    pub lengths: DVector<f64>,
    /// The rank r of every trial.
    pub rank: usize,
}

/// One answer, good or bad.
#[derive(Clone, Debug)]
pub struct State {
    /// R (r × r) of each trial, from its own frame to the sensor frame.
    pub orientations: Vec<DMatrix<f64>>,
    /// How far each arm is from the stated one, in standard deviations.
    pub arm_shifts: Vec<DVector<f64>>,
    /// ln μ of each trial, in standard deviations.
    pub mass_shifts: Vec<f64>,
    /// S̃ (m × p) with scaled torque rows.
    pub shape: DMatrix<f64>,
}

/// The best answer near a start.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The answer.
    pub state: State,
    /// The sum of squares.
    pub misfit: f64,
    /// Whether no further step would lower it by anything that counts.
    pub settled: bool,
    /// The normal matrix there: for each trial turns, arm and mass, then S̃ column by column.
    pub normal: DMatrix<f64>,
}

/// Residuals of one trial and how they change.
struct Linearised {
    /// rp.
    residual: DVector<f64>,
    /// By the trial's own unknowns (rp × own).
    by_own: DMatrix<f64>,
    /// By S̃ (rp × mp).
    by_shape: DMatrix<f64>,
}

impl Problem {
    /// Components m of a wrench.
    pub fn components(&self) -> usize {
        self.lengths.len()
    }

    /// Gages p.
    pub fn gages(&self) -> usize {
        self.observations.first().map_or(0, |trial| trial.shape.ncols())
    }

    /// Turns that change an orientation: one in the plane, three in space.
    pub const fn turns(&self) -> usize {
        self.rank * (self.rank - 1) / 2
    }

    /// Unknowns that each trial brings along.
    pub fn own_unknowns(&self) -> usize {
        self.turns() + self.observations.first().map_or(0, |trial| trial.arm_m.len()) + 1
    }

    /// Observed numbers less unknowns: the sum of squares to be expected of the right answer.
    pub fn freedom(&self) -> usize {
        let loads: usize = self.observations.iter().map(|trial| trial.sights.len() * (self.rank - 1)).sum();
        let trials = self.observations.len();
        let observed = trials * self.rank * self.gages() + loads;
        observed.saturating_sub(self.components() * self.gages() + trials * self.turns())
    }

    /// The squashing matrix of a trial, for scaled torque rows.
    pub fn squashing(&self, arm_m: &DVector<f64>) -> DMatrix<f64> {
        let mut squashing = squashing_matrix(self.rank, arm_m);
        for (mut column, &length) in squashing.column_iter_mut().zip(&self.lengths) {
            column /= length;
        }
        squashing
    }

    /// The arm of a trial, as the answer has it.
    pub fn arm_m(&self, trial: usize, state: &State) -> DVector<f64> {
        let Observation { arm_m, arm_accuracy_m, .. } = &self.observations[trial];
        arm_m + &state.arm_shifts[trial] * *arm_accuracy_m
    }

    /// An answer with these orientations, arms and masses as stated, and the shape that fits them plainly.
    pub fn start(&self, orientations: Vec<DMatrix<f64>>, arms: &Stack) -> State {
        let oriented: Vec<DMatrix<f64>> = orientations
            .iter()
            .zip(&self.observations)
            .map(|(orientation, trial)| orientation * &trial.shape)
            .collect();
        let arm_shifts =
            self.observations.iter().map(|trial| DVector::zeros(trial.arm_m.len())).collect::<Vec<_>>();
        State {
            mass_shifts: vec![0.0; orientations.len()],
            arm_shifts,
            orientations,
            shape: &arms.inverse * super::super::fusion::stack(&oriented),
        }
    }

    /// μ of a trial: its true mass over the stated one.
    pub fn mass_ratio(&self, trial: usize, state: &State) -> f64 {
        (state.mass_shifts[trial] * self.observations[trial].mass_accuracy).exp()
    }

    /// μ Rᵀ (r × r) and [I Xᵀ] (r × m) of a trial.
    fn view(&self, trial: usize, state: &State) -> (DMatrix<f64>, DMatrix<f64>) {
        let mass = self.mass_ratio(trial, state);
        (state.orientations[trial].transpose() * mass, self.squashing(&self.arm_m(trial, state)))
    }

    /// The whitened misfit of a trial (rp).
    fn misfit_of(&self, trial: usize, state: &State) -> DVector<f64> {
        let (turn, squashing) = self.view(trial, state);
        let misfit = turn * squashing * &state.shape - &self.observations[trial].shape;
        &self.observations[trial].whitening * DVector::from_column_slice(misfit.as_slice())
    }

    /// The sum of squares, without the known loads.
    pub fn fusion_misfit(&self, state: &State) -> f64 {
        let trials = (0..self.observations.len()).map(|trial| {
            self.misfit_of(trial, state).norm_squared()
                + state.arm_shifts[trial].norm_squared()
                + state.mass_shifts[trial].powi(2)
        });
        trials.sum()
    }

    fn sum_of_squares(&self, state: &State) -> f64 {
        let loads = self.observations.iter().zip(&state.orientations).flat_map(|(trial, orientation)| {
            trial.sights.iter().map(move |sight| {
                ((orientation * &sight.seen - &sight.known) / sight.deviation_rad).norm_squared()
            })
        });
        self.fusion_misfit(state) + loads.sum::<f64>()
    }

    fn linearised(&self, trial: usize, state: &State) -> Linearised {
        let Observation { whitening, arm_accuracy_m, mass_accuracy, arm_m, .. } = &self.observations[trial];
        let (turn, squashing) = self.view(trial, state);
        let seen = &squashing * &state.shape;
        let whiten = |change: &DMatrix<f64>| whitening * DVector::from_column_slice(change.as_slice());
        let mut own = Vec::with_capacity(self.own_unknowns());
        for axis in 0..self.turns() {
            own.push(whiten(&(-(&turn * generator(self.rank, axis)) * &seen)));
        }
        for axis in 0..arm_m.len() {
            let mut shift = DVector::zeros(arm_m.len());
            shift[axis] = *arm_accuracy_m;
            let mut torque = self.squashing(&shift);
            torque.columns_mut(0, self.rank).fill(0.0);
            own.push(whiten(&(&turn * torque * &state.shape)));
        }
        own.push(whiten(&(&turn * &seen * *mass_accuracy)));
        let columns = &turn * &squashing;
        let mut by_shape = DMatrix::zeros(whitening.nrows(), self.components() * self.gages());
        for gage in 0..self.gages() {
            let block = whitening.columns(gage * self.rank, self.rank) * &columns;
            by_shape.columns_mut(gage * self.components(), self.components()).copy_from(&block);
        }
        Linearised { residual: self.misfit_of(trial, state), by_own: DMatrix::from_columns(&own), by_shape }
    }

    /// What a change of a trial's observed shape (rp, column by column) does to the gradient: by the trial's own unknowns
    /// (own × rp), and by S̃ (mp × rp).
    pub fn response(&self, trial: usize, state: &State) -> (DMatrix<f64>, DMatrix<f64>) {
        let Linearised { by_own, by_shape, .. } = self.linearised(trial, state);
        let whitening = &self.observations[trial].whitening;
        (by_own.transpose() * whitening, by_shape.transpose() * whitening)
    }

    /// Normal matrix and half the gradient of the sum of squares.
    fn normal_equations(&self, state: &State) -> (DMatrix<f64>, DVector<f64>) {
        let (own, shape) = (self.own_unknowns(), self.components() * self.gages());
        let trials = self.observations.len();
        let mut normal = DMatrix::zeros(trials * own + shape, trials * own + shape);
        let mut gradient = DVector::zeros(trials * own + shape);
        let last = trials * own;
        for (trial, observation) in self.observations.iter().enumerate() {
            let Linearised { residual, by_own, by_shape } = self.linearised(trial, state);
            let at = trial * own;
            let mixed = by_own.transpose() * &by_shape;
            normal.view_mut((at, last), (own, shape)).copy_from(&mixed);
            normal.view_mut((last, at), (shape, own)).copy_from(&mixed.transpose());
            let mut both = normal.view_mut((last, last), (shape, shape));
            both += by_shape.transpose() * &by_shape;
            let mut shape_gradient = gradient.rows_mut(last, shape);
            shape_gradient += by_shape.transpose() * &residual;

            let mut block = by_own.transpose() * &by_own;
            let mut slope = by_own.transpose() * &residual;
            let priors = state.arm_shifts[trial].iter().chain([&state.mass_shifts[trial]]);
            for (unknown, &shift) in (self.turns()..).zip(priors) {
                block[(unknown, unknown)] += 1.0;
                slope[unknown] += shift;
            }
            for sight in &observation.sights {
                let turned = &state.orientations[trial] * &sight.seen;
                let change = DMatrix::from_columns(
                    &(0..self.turns())
                        .map(|axis| generator(self.rank, axis) * &turned / sight.deviation_rad)
                        .collect::<Vec<_>>(),
                );
                let misfit = (turned - &sight.known) / sight.deviation_rad;
                let mut turns = block.view_mut((0, 0), (self.turns(), self.turns()));
                turns += change.transpose() * &change;
                let mut turns = slope.rows_mut(0, self.turns());
                turns += change.transpose() * misfit;
            }
            normal.view_mut((at, at), (own, own)).copy_from(&block);
            gradient.rows_mut(at, own).copy_from(&slope);
        }
        (normal, gradient)
    }

    /// The state after a step in all unknowns.
    fn stepped(&self, state: &State, step: &DVector<f64>) -> State {
        let (own, turns) = (self.own_unknowns(), self.turns());
        let mut next = state.clone();
        for trial in 0..self.observations.len() {
            let step = step.rows(trial * own, own);
            next.orientations[trial] =
                turn(self.rank, step.rows(0, turns).as_slice()) * &state.orientations[trial];
            next.arm_shifts[trial] += step.rows(turns, own - turns - 1);
            next.mass_shifts[trial] += step[own - 1];
        }
        let shape = &step.as_slice()[self.observations.len() * own..];
        next.shape += DMatrix::from_column_slice(self.components(), self.gages(), shape);
        next
    }
}

/// The best answer near a start.
pub fn refine(problem: &Problem, start: State) -> Fit {
    let mut state = start;
    let mut misfit = problem.sum_of_squares(&state);
    let (mut normal, mut gradient) = problem.normal_equations(&state);
    let mut damping = FIRST_DAMPING;
    let mut settled = false;
    for _ in 0..MOST_STEPS {
        let mut lower = None;
        while lower.is_none() && damping < LAST_DAMPING {
            let mut damped = normal.clone();
            for unknown in 0..damped.nrows() {
                damped[(unknown, unknown)] *= 1.0 + damping;
            }
            let trial = damped.cholesky().map(|factor| problem.stepped(&state, &-factor.solve(&gradient)));
            lower = trial
                .map(|next| (problem.sum_of_squares(&next), next))
                .filter(|(next_misfit, _)| *next_misfit <= misfit);
            damping = if lower.is_some() { (damping / 10.0).max(1e-12) } else { damping * 10.0 };
        }
        let Some((next_misfit, next)) = lower else {
            settled = true;
            break;
        };
        let gain = misfit - next_misfit;
        (state, misfit) = (next, next_misfit);
        (normal, gradient) = problem.normal_equations(&state);
        settled = gain <= LEAST_GAIN * (1.0 + misfit);
        if settled {
            break;
        }
    }
    Fit { state, misfit, settled, normal }
}

/// The best answers near several starts, the best of all first. A start that has not settled when it is left, and is promising, goes on:
/// else the best answer might be one that was left on its way.
pub fn refine_all(problem: &Problem, starts: impl IntoIterator<Item = State>) -> Vec<Fit> {
    let mut fits: Vec<Fit> = starts.into_iter().map(|start| refine(problem, start)).collect();
    let expected = problem.freedom() as f64;
    for _ in 0..MOST_ROUNDS {
        fits.sort_by(|a, b| a.misfit.total_cmp(&b.misfit));
        let Some(least) = fits.first().map(|fit| fit.misfit) else { break };
        let promising = PROMISING * least.max(expected);
        let mut all_settled = true;
        for fit in fits.iter_mut().filter(|fit| !fit.settled && fit.misfit <= promising) {
            *fit = refine(problem, fit.state.clone());
            all_settled = false;
        }
        if all_settled {
            break;
        }
    }
    fits
}

/// The change that a small turn about an axis makes.
fn generator(rank: usize, axis: usize) -> DMatrix<f64> {
    if rank == 2 {
        return DMatrix::from_row_slice(2, 2, &[0.0, -1.0, 1.0, 0.0]);
    }
    let cross = Vector3::ith(axis, 1.0).cross_matrix();
    DMatrix::from_column_slice(3, 3, cross.as_slice())
}

/// The rotation by these turns.
fn turn(rank: usize, turns: &[f64]) -> DMatrix<f64> {
    match *turns {
        [angle] => DMatrix::from_column_slice(2, 2, Rotation2::new(angle).matrix().as_slice()),
        [x, y, z] => {
            DMatrix::from_column_slice(3, 3, Rotation3::new(Vector3::new(x, y, z)).matrix().as_slice())
        }
        _ => DMatrix::identity(rank, rank),
    }
}
