//! A trial: one load at one constant arm, turned at random, gated and summed up sample by sample and then solved (paper,
//! figure 2, design § 5).
//!
//! The sums are large, so a trial owns them through a handle (`Store`: a static reference on the board, a box in the
//! simulator). A [`SolveJob`] takes the handle out of the trial: the solution is computed with no hold on the sample
//! path, and the handle comes back by [`Trial::finish`].

use core::ops::DerefMut;

use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::coverage;
use ftcal_shared::estimation::gate::Verdict;
use ftcal_shared::estimation::shape::TrialSolution;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::{AdcCode, SampleIndex};
use ftcal_shared::wire::{
    Coverage, GageList, GageTarget, Rejection, Response, Solution, TrialPhase, TrialStatus,
};

/// The trial of the sensor.
#[derive(Debug)]
pub struct Trial<Store, const GAGES: usize, const HIGHER: usize> {
    /// Absent while a [`SolveJob`] has it.
    store: Option<Store>,
    phase: TrialPhase,
    rank: u8,
    /// Samples rejected because a channel stood at the end of its range.
    saturated: u32,
    /// Samples rejected because the converter repeats itself.
    repeated: u32,
    /// Samples that were taken in, but that the solution leaves out because the load moved too much.
    moving: u32,
    taken: u32,
    offered: u32,
    first: SampleIndex,
}

/// A trial's sums on their way to an answer.
#[derive(Debug)]
pub struct SolveJob<Store, const GAGES: usize, const HIGHER: usize> {
    store: Store,
    wanted: Wanted,
    rank: u8,
    taken: u32,
    saturated: u32,
    moving: u32,
}

/// What is to be computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wanted {
    Solution,
    Coverage,
}

impl<Store, const GAGES: usize, const HIGHER: usize> Trial<Store, GAGES, HIGHER>
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// No trial yet, with room for one.
    pub const fn new(store: Store) -> Self {
        Self {
            store: Some(store),
            phase: TrialPhase::None,
            rank: 0,
            saturated: 0,
            repeated: 0,
            moving: 0,
            taken: 0,
            offered: 0,
            first: SampleIndex::new(0),
        }
    }

    /// State of the trial.
    pub const fn status(&self) -> TrialStatus {
        TrialStatus {
            phase: self.phase,
            rank: self.rank,
            used: self.taken.saturating_sub(self.moving),
            saturated: self.saturated,
            first: self.first,
            offered: self.offered,
            repeated: self.repeated,
            moving: self.moving,
        }
    }

    /// Starts a trial; the sums of the one before are dropped.
    ///
    /// # Errors
    ///
    /// [`Rejection::TrialBusy`], [`Rejection::UnsupportedRank`].
    pub fn start(&mut self, rank: u8) -> Result<(), Rejection> {
        self.require_idle()?;
        if !(2..=3).contains(&rank) || usize::from(rank) > GAGES {
            return Err(Rejection::UnsupportedRank);
        }
        self.store.as_mut().ok_or(Rejection::TrialBusy)?.restart();
        self.rank = rank;
        self.saturated = 0;
        self.repeated = 0;
        self.moving = 0;
        self.taken = 0;
        self.offered = 0;
        self.phase = TrialPhase::Running;
        Ok(())
    }

    /// The converter's settings may change between trials only: one trial is in one unit of counts.
    ///
    /// # Errors
    ///
    /// [`Rejection::TrialBusy`].
    pub const fn require_idle(&self) -> Result<(), Rejection> {
        match self.phase {
            TrialPhase::Running | TrialPhase::Solving => Err(Rejection::TrialBusy),
            TrialPhase::None | TrialPhase::Stopped => Ok(()),
        }
    }

    /// Takes in one sample while the trial runs. A sample that is no measurement is counted, not used.
    pub fn offer(&mut self, index: SampleIndex, codes: &[AdcCode; GAGES]) {
        if self.phase != TrialPhase::Running {
            return;
        }
        let Some(bins) = self.store.as_mut() else { return };
        if self.offered == 0 {
            self.first = index;
        }
        self.offered = self.offered.saturating_add(1);
        let counter = match bins.offer(codes) {
            Ok(Verdict::Accepted) => &mut self.taken,
            Ok(Verdict::Saturated) => &mut self.saturated,
            Ok(Verdict::Repeated) => &mut self.repeated,
            // The sums are as full as they may get: what they hold stays good.
            Err(_) => {
                self.phase = TrialPhase::Stopped;
                return;
            }
        };
        *counter = counter.saturating_add(1);
    }

    /// Stops the trial; stopping a stopped trial changes nothing, so that the request may be repeated.
    ///
    /// # Errors
    ///
    /// [`Rejection::NoTrial`], [`Rejection::TrialBusy`] while it is being solved.
    pub const fn stop(&mut self) -> Result<TrialStatus, Rejection> {
        match self.phase {
            TrialPhase::None => Err(Rejection::NoTrial),
            TrialPhase::Solving => Err(Rejection::TrialBusy),
            TrialPhase::Running | TrialPhase::Stopped => {
                self.phase = TrialPhase::Stopped;
                Ok(self.status())
            }
        }
    }

    /// Hands the stopped trial out to be solved.
    ///
    /// # Errors
    ///
    /// [`Rejection::NoTrial`], [`Rejection::TrialBusy`] while it runs or is being solved.
    pub fn take_for_solving(&mut self) -> Result<SolveJob<Store, GAGES, HIGHER>, Rejection> {
        match self.phase {
            TrialPhase::None => Err(Rejection::NoTrial),
            TrialPhase::Running | TrialPhase::Solving => Err(Rejection::TrialBusy),
            TrialPhase::Stopped => {
                let store = self.store.take().ok_or(Rejection::TrialBusy)?;
                self.phase = TrialPhase::Solving;
                Ok(self.job(store, Wanted::Solution))
            }
        }
    }

    /// Hands the trial out, running or stopped, to be asked where it stands.
    ///
    /// # Errors
    ///
    /// [`Rejection::NoTrial`]; [`Rejection::TrialBusy`] while it is out already.
    pub fn take_for_coverage(&mut self) -> Result<SolveJob<Store, GAGES, HIGHER>, Rejection> {
        if self.phase == TrialPhase::None {
            return Err(Rejection::NoTrial);
        }
        let store = self.store.take().ok_or(Rejection::TrialBusy)?;
        Ok(self.job(store, Wanted::Coverage))
    }

    const fn job(&self, store: Store, wanted: Wanted) -> SolveJob<Store, GAGES, HIGHER> {
        SolveJob { store, wanted, rank: self.rank, taken: self.taken, saturated: self.saturated, moving: 0 }
    }

    /// Takes back what [`Trial::take_for_solving`] or [`Trial::take_for_coverage`] handed out: a trial that was to be
    /// solved may be solved again, one that was asked where it stands goes on as it was.
    pub fn finish(&mut self, job: SolveJob<Store, GAGES, HIGHER>) {
        self.store = Some(job.store);
        if job.wanted == Wanted::Solution {
            self.moving = job.moving;
            self.phase = TrialPhase::Stopped;
        }
    }
}

impl<Store, const GAGES: usize, const HIGHER: usize> SolveJob<Store, GAGES, HIGHER>
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// Computes what is wanted. Takes millions of instructions: not for the sample path.
    pub fn response(&mut self) -> Response {
        match self.wanted {
            Wanted::Solution => self.solve().map_or_else(Response::Refused, Response::Solution),
            Wanted::Coverage => self.coverage().map_or_else(Response::Refused, Response::Coverage),
        }
    }

    fn coverage(&mut self) -> Result<Coverage, Refusal> {
        self.store.settle();
        match self.rank {
            2 => self.store.coverage::<2>().map(|covered| coverage_on_the_wire(&covered)),
            _ => self.store.coverage::<3>().map(|covered| coverage_on_the_wire(&covered)),
        }
    }

    /// Solves the trial. Takes millions of instructions: not for the sample path.
    ///
    /// # Errors
    ///
    /// Every refusal of [`Bins::solve`]; [`Refusal::Saturated`] where saturation has left too few samples.
    pub fn solve(&mut self) -> Result<Solution, Refusal> {
        self.store.finish();
        let solution = match self.rank {
            2 => self.store.solve::<2>().and_then(|quiet| on_the_wire(&quiet.solution)),
            _ => self.store.solve::<3>().and_then(|quiet| on_the_wire(&quiet.solution)),
        };
        self.moving = solution.as_ref().map_or(0, |solution| self.taken.saturating_sub(solution.samples));
        match solution {
            Err(Refusal::TooFewSamples { .. }) if self.saturated > 0 => {
                Err(Refusal::Saturated { samples: u64::from(self.saturated) })
            }
            other => other,
        }
    }
}

fn on_the_wire<const GAGES: usize, const RANK: usize>(
    solved: &TrialSolution<GAGES, RANK>,
) -> Result<Solution, Refusal> {
    #[expect(clippy::cast_possible_truncation, reason = "at most 12 gages and rank 3")]
    let unsupported = Refusal::UnsupportedDimensions { gages: GAGES as u8, rank: RANK as u8 };
    let mut shape_counts_per_load = heapless::Vec::new();
    for row in 0..RANK {
        for gage in 0..GAGES {
            let element = solved.shape_counts_per_load[(row, gage)];
            shape_counts_per_load.push(element).map_err(|_| unsupported)?;
        }
    }
    Ok(Solution {
        #[expect(clippy::cast_possible_truncation, reason = "rank 2 or 3")]
        rank: RANK as u8,
        shape_counts_per_load,
        bias_counts: GageList::from_slice(solved.bias_counts.as_slice()).map_err(|_| unsupported)?,
        eigenvalues: GageList::from_slice(solved.eigenvalues.as_slice()).map_err(|_| unsupported)?,
        noise_counts: solved.noise_variance.map(libm::sqrt),
        samples: u32::try_from(solved.samples).unwrap_or(u32::MAX),
    })
}

#[expect(clippy::cast_possible_truncation, reason = "a report of seven digits")]
fn coverage_on_the_wire<const RANK: usize>(covered: &coverage::Coverage<RANK>) -> Coverage {
    let target = |target: &coverage::GageTarget| GageTarget {
        gage: target.gage,
        counts: target.counts as f32,
        position: target.position as f32,
    };
    Coverage {
        samples: u32::try_from(covered.samples).unwrap_or(u32::MAX),
        fraction: covered.fraction as f32,
        worst_relative_uncertainty: covered.worst_relative_uncertainty as f32,
        targets: covered.targets.iter().map(target).collect(),
    }
}
