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

use super::basis::basis;
use super::gate::{Gate, Quietness, Verdict};
use super::moments::Moments;
use super::shape::{TrialSolution, require_samples, solve_within};
use crate::refusal::Refusal;
use crate::units::AdcCode;

/// Shift of the gains over the unexplained variance of |m|².
const SHIFT_OVER_UNEXPLAINED: f64 = 0.375;

/// Gate and sums of one trial over `GAGES` channels. For `HIGHER` see [`Moments`].
#[derive(Clone, Debug)]
pub struct Bins<const GAGES: usize, const HIGHER: usize> {
    gate: Gate<GAGES>,
    /// One for each [`Quietness`]. Once finished, each holds the quieter ones, too.
    by_quietness: [Moments<GAGES, HIGHER>; Quietness::ALL.len()],
    finished: bool,
    /// Why a sample could not be summed up.
    full: Option<Refusal>,
}

/// A trial solved from its quiet samples.
#[derive(Clone, Debug)]
pub struct QuietSolution<const GAGES: usize, const RANK: usize> {
    /// The solution; its samples are those that the metric was taken from.
    pub solution: TrialSolution<GAGES, RANK>,
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
        Self {
            gate: Gate::new(),
            by_quietness: [const { Moments::new([AdcCode::ZERO; GAGES]) }; Quietness::ALL.len()],
            finished: false,
            full: None,
        }
    }

    /// Empties gate and sums.
    pub fn restart(&mut self) {
        self.gate = Gate::new();
        self.finished = false;
        self.full = None;
        for bin in &mut self.by_quietness {
            bin.restart([AdcCode::ZERO; GAGES]);
        }
    }

    /// Takes in one sample. To be called before [`Bins::finish`].
    ///
    /// # Errors
    ///
    /// [`Refusal::OverflowAhead`] where the sums are full; what they hold stays good.
    pub fn offer(&mut self, codes: &[AdcCode; GAGES]) -> Result<Verdict, Refusal> {
        let Self { gate, by_quietness, full, .. } = self;
        let verdict = gate.offer(codes, &mut |quietness, codes| push(by_quietness, full, quietness, codes));
        full.map_or(Ok(verdict), Err)
    }

    /// Takes in one sample past the gate, as if the load stood still.
    ///
    /// # Errors
    ///
    /// [`Refusal::OverflowAhead`] where the sums are full; what they hold stays good.
    pub fn offer_ungated(&mut self, codes: &[AdcCode; GAGES]) -> Result<Verdict, Refusal> {
        if codes.iter().any(|code| code.is_saturated()) {
            return Ok(Verdict::Saturated);
        }
        push(&mut self.by_quietness, &mut self.full, Quietness::Still, codes);
        self.full.map_or(Ok(Verdict::Accepted), Err)
    }

    /// Takes in what still waits in the gate, and adds the classes up. Nothing comes after that but [`Bins::restart`].
    ///
    /// # Errors
    ///
    /// [`Refusal::OverflowAhead`] where the sums are full; what they hold stays good.
    pub fn finish(&mut self) -> Result<(), Refusal> {
        if self.finished {
            return Ok(());
        }
        let Self { gate, by_quietness, full, finished } = self;
        gate.finish(&mut |quietness, codes| push(by_quietness, full, quietness, codes));
        *finished = true;
        let [still, slow, fast] = by_quietness;
        still.settle();
        slow.absorb(still)?;
        fast.absorb(slow)
    }

    /// Solves the finished trial.
    ///
    /// # Errors
    ///
    /// Every refusal of [`super::shape::solve_trial`]: where no choice of classes has an answer, that of all samples together.
    pub fn solve<const RANK: usize>(&self) -> Result<QuietSolution<GAGES, RANK>, Refusal> {
        let [.., all] = &self.by_quietness;
        require_samples::<RANK>(all.count())?;
        let subspace = basis::<GAGES, RANK>(&all.covariance(), all.count())?;
        let mut best: Option<(f64, QuietSolution<GAGES, RANK>)> = None;
        let mut refusal = Refusal::NonFinite;
        let mut quieter = 0;
        for (bin, up_to) in self.by_quietness.iter().zip(Quietness::ALL) {
            if bin.count() == quieter {
                continue;
            }
            quieter = bin.count();
            match solve_within(&subspace, all, bin) {
                Err(cause) => refusal = cause,
                Ok(solution) => {
                    let shift = SHIFT_OVER_UNEXPLAINED * solution.unexplained;
                    let error = libm::hypot(solution.uncertainty.worst_relative(), shift);
                    if best.as_ref().is_none_or(|(least, _)| error < *least) {
                        best = Some((error, QuietSolution { solution, up_to }));
                    }
                }
            }
        }
        best.map(|(_, quiet)| quiet).ok_or(refusal)
    }
}

fn push<const GAGES: usize, const HIGHER: usize>(
    bins: &mut [Moments<GAGES, HIGHER>],
    full: &mut Option<Refusal>,
    quietness: Quietness,
    codes: &[AdcCode; GAGES],
) {
    if bins.iter().all(|bin| bin.count() == 0) {
        // The first sample is the pivot, which takes the offset out of all sums.
        for bin in bins.iter_mut() {
            bin.restart(*codes);
        }
    }
    if let Err(refusal) = bins[quietness as usize].push(codes) {
        *full = Some(refusal);
    }
}
