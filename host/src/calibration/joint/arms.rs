//! Orientation by the arms alone, in closed form (design § 7).
//!
//! For two trials at arms a₁, a₂ the torque drops out of (a₁ − a₂)ᵀ(R₁S₁ − R₂S₂) = 0. The row spaces of S₁ and S₂ meet in
//! one line, so the left null vector of [S₁; −S₂] is the direction a₁ − a₂ in the frames of the two trials, n₁ and n₂, up
//! to a common sign. In the plane one such direction orients both trials, in space two directions (three arms that are not on
//! one line) orient three.
//!
//! What is left is discrete. Signs of the pairs: the angle between two directions of one trial must be that between the
//! arms, so all but one common sign follow. A mirror image of each trial in the plane of the arms (in the plane: in their
//! line) changes no such direction. That makes 16 answers in space and 8 in the plane, which all fit equally well; every
//! further trial then follows from the shape that the first ones give.

use nalgebra::{DMatrix, DVector};

use super::super::CalibrationRefusal;
use super::super::alignment::{Hand, Sight, best};
use super::super::fusion::{Stack, stack};
use super::super::singular::Singular;
use super::refinement::{Problem, State};
use ftcal_shared::units::Dof;

/// The trials that the arms orient, two in the plane and three in space: those that span most.
#[derive(Clone, Debug)]
pub struct Base {
    trials: Vec<usize>,
    /// Their arms, stacked.
    arms: Stack,
    /// The normal (r) of the arms' plane, or of their line in the plane.
    normal: DVector<f64>,
}

impl Base {
    /// Chooses the trials.
    ///
    /// # Errors
    ///
    /// Those of [`Stack::new`].
    pub fn choose(dof: Dof, arms_m: &[&DVector<f64>]) -> Result<Self, CalibrationRefusal> {
        let rank = dof.trial_rank();
        let mut widest: Option<(f64, Vec<usize>)> = None;
        for trials in subsets(arms_m.len(), rank) {
            let spans = Singular::of(&offsets(arms_m, &trials)).values;
            // The last value is zero: differences of r points span one dimension less.
            let span: f64 = spans.iter().take(rank - 1).product();
            if widest.as_ref().is_none_or(|(best, _)| span > *best) {
                widest = Some((span, trials));
            }
        }
        let trials = widest.map_or_else(|| (0..arms_m.len()).collect(), |(_, trials)| trials);
        let chosen: Vec<&DVector<f64>> = trials.iter().map(|&trial| arms_m[trial]).collect();
        let arms = Stack::new(dof, &chosen)?;
        let normal = Singular::of(&offsets(arms_m, &trials)).left.column(rank - 1).into_owned();
        Ok(Self { trials, arms, normal })
    }

    /// One start for every pattern of signs, up to a common one; the hands are arbitrary.
    pub fn starts(&self, problem: &Problem, arms: &Stack) -> Vec<State> {
        let pairs: Vec<Pair> = subsets(self.trials.len(), 2)
            .into_iter()
            .filter_map(|pair| match *pair.as_slice() {
                [first, second] => Some(Pair::of(problem, self.trials[first], self.trials[second])),
                _ => None,
            })
            .collect();
        let patterns = 1_usize << pairs.len().saturating_sub(1);
        (0..patterns)
            .map(|pattern| {
                let sign = |pair: usize| if pair > 0 && pattern >> (pair - 1) & 1 == 1 { -1.0 } else { 1.0 };
                let oriented = self.trials.iter().map(|&trial| {
                    let sights: Vec<Sight> = pairs
                        .iter()
                        .enumerate()
                        .filter_map(|(number, pair)| pair.sight(trial, sign(number)))
                        .collect();
                    best(problem.rank, &sights, Hand::Rotation).orientation
                });
                self.extended(problem, &oriented.collect::<Vec<_>>(), arms)
            })
            .collect()
    }

    /// The answers that fit as well as this one, itself among them.
    pub fn equivalents(&self, problem: &Problem, state: &State, arms: &Stack) -> Vec<State> {
        let rank = problem.rank;
        let mirror = DMatrix::identity(rank, rank) - &self.normal * self.normal.transpose() * 2.0;
        let mut all = Vec::new();
        for sign in [1.0, -1.0] {
            for pattern in 0..1_usize << self.trials.len() {
                let oriented = self.trials.iter().enumerate().map(|(number, &trial)| {
                    let orientation = &state.orientations[trial] * sign;
                    if pattern >> number & 1 == 1 { &mirror * orientation } else { orientation }
                });
                all.push(self.extended(problem, &oriented.collect::<Vec<_>>(), arms));
            }
        }
        all
    }

    /// The orientations of all trials from those of the base: each further trial is turned to what the base's shape
    /// would show it (orthogonal Procrustes).
    fn extended(&self, problem: &Problem, oriented: &[DMatrix<f64>], arms: &Stack) -> State {
        let shapes: Vec<DMatrix<f64>> = self
            .trials
            .iter()
            .zip(oriented)
            .map(|(&trial, orientation)| orientation * &problem.observations[trial].shape)
            .collect();
        let mut shape = &self.arms.inverse * stack(&shapes);
        for (mut row, (own, common)) in
            shape.row_iter_mut().zip(self.arms.lengths.iter().zip(&problem.lengths))
        {
            row *= common / own;
        }
        let orientations = problem.observations.iter().enumerate().map(|(trial, observation)| {
            let known = self.trials.iter().position(|&base| base == trial);
            known.and_then(|position| oriented.get(position).cloned()).unwrap_or_else(|| {
                let seen = problem.squashing(&observation.arm_m) * &shape;
                let Singular { left, right, .. } = Singular::of(&(seen * observation.shape.transpose()));
                left * right.transpose()
            })
        });
        problem.start(orientations.collect(), arms)
    }
}

/// The direction from one arm's end to another's, as the two trials see it.
struct Pair {
    trials: [usize; 2],
    seen: [DVector<f64>; 2],
    known: DVector<f64>,
}

impl Pair {
    fn of(problem: &Problem, first: usize, second: usize) -> Self {
        let rank = problem.rank;
        let [one, other] = [first, second].map(|trial| &problem.observations[trial]);
        let stacked = stack(&[one.shape.clone(), -&other.shape]);
        // As many columns as rows at least, so that the null vector is among those on the left.
        let columns = stacked.ncols().max(2 * rank);
        let left = Singular::of(&stacked.resize_horizontally(columns, 0.0)).left;
        let null = left.column(left.ncols() - 1).into_owned();
        let seen = [0, rank].map(|from| null.rows(from, rank).normalize());
        Self { trials: [first, second], seen, known: (&one.arm_m - &other.arm_m).normalize() }
    }

    fn sight(&self, trial: usize, sign: f64) -> Option<Sight> {
        let position = self.trials.iter().position(|&of_pair| of_pair == trial)?;
        Some(Sight { seen: self.seen[position].clone(), known: &self.known * sign, deviation_rad: 1.0 })
    }
}

/// The arms of these trials about their mean, as columns.
fn offsets(arms_m: &[&DVector<f64>], trials: &[usize]) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = trials.iter().map(|&trial| arms_m[trial].clone()).collect();
    let mean = columns.iter().sum::<DVector<f64>>() / columns.len().max(1) as f64;
    DMatrix::from_columns(&columns.iter().map(|column| column - &mean).collect::<Vec<_>>())
}

/// All ways to choose `size` of the first `count` numbers.
fn subsets(count: usize, size: usize) -> Vec<Vec<usize>> {
    let mut all = vec![Vec::new()];
    for _ in 0..size {
        all = all
            .into_iter()
            .flat_map(|subset: Vec<usize>| {
                let next = subset.last().map_or(0, |last| last + 1);
                (next..count).map(move |number| subset.iter().copied().chain([number]).collect())
            })
            .collect();
    }
    all
}
