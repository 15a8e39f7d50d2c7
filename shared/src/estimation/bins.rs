//! The sums of one trial, by quietness, and how much of them to solve from (design § 5).
//!
//! A gate that is too tight costs as much as one that is too loose, and which it is shows only when the trial is over. So the
//! samples of each class of [`super::gate`] have sums of their own, all about one pivot. When the trial is solved, the sums are added up
//! from the quietest class on, and the answer is taken from as many classes as serve it best:
//!
//! * **The subspace** of the codes, and the noise, always come from every sample. Whatever the hand does to the load's
//!   magnitude, the codes stay in the span of the shape.
//! * **The metric** comes from the quietest 1, 2 or 3 classes, whichever have the least error ε² = w² + (⅜u)². There w is the
//!   uncertainty of the worst coefficient, predicted from coverage, noise and number of samples, so that a class too small to span the
//!   directions never wins. u is the variance of |m|² that the noise does not explain. Besides what it adds to w, which
//!   falls with the number of samples, it shifts the answer by an amount that does not: an acceleration a of the hand
//!   with no preferred direction gives u = ⟨(2m·a)²⟩ = 4⟨a²⟩/3 and lengthens ⟨|m|²⟩ by ⟨a²⟩, all gains by half of that, ⅜u.

mod classes;
mod saved;

pub use saved::Part;

use nalgebra::SMatrix;

use classes::Classes;

use super::basis::{Basis, basis};
use super::code_sums::CodeMean;
use super::coverage::{Coverage, coverage};
use super::expectation::Expectation;
use super::gate::{Episodes, Gate, Quietness, Verdict};
use super::metric::LARGEST_RELATIVE_UNCERTAINTY;
use super::projection::{MotionSums, project};
use super::reorientation::MODEL_ERROR;
use super::shape::{Disturbances, TrialSolution, fit, require_samples, solution, uncertainty};
use crate::refusal::Refusal;
use crate::units::{AdcCode, Rank};

/// Shift of the gains over the unexplained variance of |m|².
const SHIFT_OVER_UNEXPLAINED: f64 = 0.375;

/// The largest relative standard deviation of a principal value of the constraint with which a direction can be named: a
/// gain known within a half.
const ROUGHEST: f64 = 1.0;

/// Gate and sums of one trial over `GAGES` channels. For `HIGHER` see [`Moments`](super::moments::Moments).
#[derive(Clone, Debug)]
pub struct Bins<const GAGES: usize, const HIGHER: usize> {
    gate: Gate<GAGES>,
    classes: Classes<GAGES, HIGHER>,
}

/// A trial solved from its quiet samples.
#[derive(Clone, Debug)]
pub struct QuietSolution<const GAGES: usize> {
    /// The solution; its samples are those that the metric was taken from.
    pub solution: TrialSolution<GAGES>,
    /// The most restless class that took part.
    pub up_to: Quietness,
}

impl<const GAGES: usize, const HIGHER: usize> Default for Bins<GAGES, HIGHER> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const GAGES: usize, const HIGHER: usize> Bins<GAGES, HIGHER> {
    /// Empty sums.
    pub const fn new() -> Self {
        Self { gate: Gate::new(), classes: Classes::new() }
    }

    /// Empties gate and sums.
    pub fn restart(&mut self) {
        self.gate = Gate::new();
        self.classes.restart();
    }

    /// Takes in one sample.
    ///
    /// # Errors
    ///
    /// [`Refusal::OverflowAhead`] where the sums are full; what they hold stays good.
    pub fn offer(&mut self, codes: &[AdcCode; GAGES]) -> Result<Verdict, Refusal> {
        self.offer_knowing(codes, AdcCode::any_is_saturated(codes))
    }

    /// As [`Bins::offer`], where it is known already whether any of the codes is saturated.
    ///
    /// # Errors
    ///
    /// As [`Bins::offer`].
    pub fn offer_knowing(
        &mut self,
        codes: &[AdcCode; GAGES],
        is_saturated: bool,
    ) -> Result<Verdict, Refusal> {
        let Self { gate, classes } = self;
        let verdict = gate.offer(codes, is_saturated, &mut |quietness, codes| classes.push(quietness, codes));
        classes.full().map_or(Ok(verdict), Err)
    }

    /// Takes in one sample past the gate, as if the load stood still.
    ///
    /// # Errors
    ///
    /// [`Refusal::OverflowAhead`] where the sums are full; what they hold stays good.
    pub fn offer_ungated(&mut self, codes: &[AdcCode; GAGES]) -> Result<Verdict, Refusal> {
        if AdcCode::any_is_saturated(codes) {
            return Ok(Verdict::Saturated);
        }
        self.classes.push(Quietness::Still, codes);
        self.classes.full().map_or(Ok(Verdict::Accepted), Err)
    }

    /// Takes in what still waits in the gate. A sample that comes afterwards meets a gate that has seen nothing.
    pub fn finish(&mut self) {
        let Self { gate, classes } = self;
        gate.finish(&mut |quietness, codes| classes.push(quietness, codes));
        self.settle();
    }

    /// Brings every sample that has passed the gate into the long sums. To be called before the trial is solved; taking in
    /// more samples afterwards is fine.
    pub fn settle(&mut self) {
        self.classes.settle();
    }

    /// Solves the trial from what has been settled.
    ///
    /// # Errors
    ///
    /// Every refusal of [`super::shape::solve_trial`]: where no choice of classes has an answer, that of all samples together.
    pub fn solve(&self, rank: Rank) -> Result<QuietSolution<GAGES>, Refusal> {
        self.solve_accepting(rank, LARGEST_RELATIVE_UNCERTAINTY)
    }

    /// Where the trial stands by what has been settled, finished or not. From now on samples are compared with what that
    /// lets expect of them.
    ///
    /// # Errors
    ///
    /// Those of [`Bins::solve`]; but that the motion leaves the answer uncertain is no refusal here, as long as it says
    /// which way to turn.
    pub fn coverage(&mut self, rank: Rank) -> Result<Coverage<GAGES>, Refusal> {
        let so_far = self.solve_accepting(rank, ROUGHEST);
        let QuietSolution { solution, .. } = so_far.as_ref().map_err(|refusal| *refusal)?;
        self.gate.expect(Expectation::new(solution)?);
        coverage(solution)
    }

    /// Has every further sample compared with what a solution expects of it.
    pub fn expect(&mut self, expectation: Option<Expectation<GAGES>>) {
        self.gate.expect(expectation);
    }

    /// The variance of the channels' noise in the quietest tenth of the samples, counts², the mean over the channels; `None`
    /// where there were too few, or the gate was off.
    pub fn quietest_variance(&self) -> Option<f64> {
        self.gate.quietest_variance()
    }

    /// Samples so far whose load was of another magnitude than expected, however quiet they were.
    pub const fn off_magnitude(&self) -> u32 {
        self.gate.off_magnitude()
    }

    #[inline(never)]
    fn solve_accepting(&self, rank: Rank, accepted: f64) -> Result<QuietSolution<GAGES>, Refusal> {
        // By reference: moved out of its result, it would stand on the stack twice.
        let found = self.subspace(rank);
        let subspace = found.as_ref().map_err(|refusal| *refusal)?;
        let all = &self.mean()?;
        let mut cumulative = Cumulative::new();
        self.sum_up(subspace, &mut cumulative);
        let disturbances = |up_to| {
            let ungated = Disturbances { number: all.samples, least: 0.0 };
            self.gate.episodes().map_or(ungated, |episodes| disturbances(episodes, up_to))
        };
        let mut best: Option<(f64, usize)> = None;
        let mut refusal = Refusal::NonFinite;
        for (class, (sums, up_to)) in cumulative.iter().enumerate() {
            match expected_error(subspace, all, sums, disturbances(*up_to), accepted) {
                Err(cause) => refusal = cause,
                Ok(error) => {
                    if best.is_none_or(|(least, _)| error < least) {
                        best = Some((error, class));
                    }
                }
            }
        }
        let (sums, up_to) = best.and_then(|(_, class)| cumulative.get(class)).ok_or(refusal)?;
        // Once more: a solution is large, and the sensor has not the room to keep one while it makes the next.
        answer(subspace, all, sums, *up_to, disturbances(*up_to), accepted)
    }

    /// The subspace of all samples.
    #[inline(never)]
    fn subspace(&self, rank: Rank) -> Result<Basis<GAGES>, Refusal> {
        let (covariance, samples) = self.covariance()?;
        require_samples(samples, rank)?;
        basis(rank, &covariance, samples, &self.gate.noise())
    }

    /// The covariance of the codes of all samples, and how many there are.
    #[inline(never)]
    fn covariance(&self) -> Result<(SMatrix<f64, GAGES, GAGES>, u64), Refusal> {
        let all = self.classes.codes()?;
        Ok((all.covariance(), all.count()))
    }

    /// The mean of the codes of all samples.
    #[inline(never)]
    fn mean(&self) -> Result<CodeMean<GAGES>, Refusal> {
        Ok(self.classes.codes()?.mean())
    }

    /// The sums in the subspace, of the quietest class, of the two quietest, and so on; a class of no samples is left out.
    #[inline(never)]
    fn sum_up(&self, subspace: &Basis<GAGES>, cumulative: &mut Cumulative) {
        for (bin, up_to) in self.classes.iter().zip(Quietness::ALL) {
            if bin.count() > 0 {
                let mut sums = project(bin, &subspace.projection, subspace.rank);
                if let Some((quieter, _)) = cumulative.last() {
                    sums.add(quieter);
                }
                cumulative.extend([(sums, up_to)]);
            }
        }
    }
}

/// Every rest and every movement has a disturbance of its own. In a rest it is as large as what no linear shape explains, for all that
/// is known of it.
const fn disturbances(episodes: Episodes, up_to: Quietness) -> Disturbances {
    let of_model = MODEL_ERROR as f64;
    match up_to {
        Quietness::Still => Disturbances { number: episodes.rests, least: 4.0 * of_model * of_model },
        Quietness::Slow | Quietness::Fast => Disturbances { number: episodes.all, least: 0.0 },
    }
}

/// Sums of the motion, each with the most restless class in it.
type Cumulative = heapless::Vec<(MotionSums, Quietness), { Quietness::ALL.len() }>;

/// The error ε of the worst coefficient that is to be expected of the solution from these sums; see above.
#[inline(never)]
fn expected_error<const GAGES: usize>(
    subspace: &Basis<GAGES>,
    all: &CodeMean<GAGES>,
    quiet: &MotionSums,
    disturbances: Disturbances,
    accepted: f64,
) -> Result<f64, Refusal> {
    let fitted = fit(subspace, all, quiet, accepted);
    let found = fitted.as_ref().map_err(|refusal| *refusal)?;
    let predicted = uncertainty(subspace, found, disturbances, accepted);
    let uncertainty = predicted.as_ref().map_err(|refusal| *refusal)?;
    let (worst, shift) = (uncertainty.worst_relative(), SHIFT_OVER_UNEXPLAINED * found.unexplained);
    Ok(libm::sqrt(worst * worst + shift * shift))
}

/// The solution from these sums.
#[inline(never)]
fn answer<const GAGES: usize>(
    subspace: &Basis<GAGES>,
    all: &CodeMean<GAGES>,
    quiet: &MotionSums,
    up_to: Quietness,
    disturbances: Disturbances,
    accepted: f64,
) -> Result<QuietSolution<GAGES>, Refusal> {
    // By reference, as above; and written out once more, since a function that both share would have the solution on the stack twice.
    let fitted = fit(subspace, all, quiet, accepted);
    let found = fitted.as_ref().map_err(|refusal| *refusal)?;
    let predicted = uncertainty(subspace, found, disturbances, accepted);
    let uncertainty = predicted.as_ref().map_err(|refusal| *refusal)?;
    Ok(QuietSolution { solution: solution(subspace, found, uncertainty), up_to })
}
