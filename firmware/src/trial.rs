//! A trial: one load at one constant arm, turned at random, gated and summed up sample by sample and then solved (paper,
//! figure 2, design § 5).
//!
//! The sums are large, so a trial owns them through a handle (`Store`: a static reference on the board, a box in the
//! simulator). A [`SolveJob`] takes the handle out of the trial: the solution is computed with no hold on the sample
//! path, and the handle comes back by [`Trial::finish`]. So does whoever saves the sums ([`Trial::lend`]); the few samples that come
//! meanwhile wait.

use core::ops::DerefMut;

use ftcal_shared::estimation::bins::{Bins, QuietSolution};
use ftcal_shared::estimation::coverage;
use ftcal_shared::estimation::gate::{BLOCK, Quietness, Verdict};
use ftcal_shared::estimation::shape::TrialSolution;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::{AdcCode, Rank, SampleIndex};
use ftcal_shared::wire::{
    Coverage, GageList, GageTarget, Rejection, Response, Resumption, Solution, TrialPhase, TrialStatus,
};

use crate::storage::items::Settings;

/// Samples of a block that come before its last one.
#[expect(clippy::cast_possible_truncation, reason = "three")]
const EARLIER_IN_BLOCK: u32 = BLOCK as u32 - 1;

/// Samples that wait while the sums are lent. They are lent for less than a millisecond: at 8000 samples a second, none is lost.
const WAITING: usize = 8;

/// The trial of the sensor.
#[derive(Debug)]
pub struct Trial<Store, const GAGES: usize, const HIGHER: usize> {
    /// Absent while a [`SolveJob`] has it, or whoever saves it.
    store: Option<Store>,
    lent: bool,
    waiting: heapless::Deque<[AdcCode; GAGES], WAITING>,
    standing: Standing,
    left_out: LeftOut,
    resumption: Resumption,
    /// Samples that would survive a reset.
    checkpointed: u32,
}

/// Where a trial stands: what is to be known of it besides its sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Standing {
    /// What it is doing.
    pub phase: TrialPhase,
    /// The proper rank asked for.
    pub rank: u8,
    /// How the converter is set: counts are counts at this gain.
    pub settings: Settings,
    /// The first sample that was offered.
    pub first: SampleIndex,
    /// What became of the samples.
    pub counts: Counts,
    /// Somebody has started it with the sensor's button: no host asks for its answer.
    pub by_button: bool,
}

/// What became of the samples that were offered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// All of them.
    pub offered: u32,
    /// Those in the sums.
    pub taken: u32,
    /// Rejected: a channel stood at the end of its range.
    pub saturated: u32,
    /// Rejected: the converter repeats itself.
    pub repeated: u32,
    /// Rejected: the codes answer to no load at this arm.
    pub contradictory: u32,
    /// Lost while the sums were being worked on.
    pub unattended: u32,
}

/// How many of the samples taken the solution leaves out.
#[derive(Clone, Copy, Debug, Default)]
struct LeftOut {
    moving: u32,
    off_magnitude: u32,
}

/// A trial's sums on their way to an answer.
#[derive(Debug)]
pub struct SolveJob<Store, const GAGES: usize, const HIGHER: usize> {
    store: Store,
    wanted: Wanted,
    rank: u8,
    counts: Counts,
    left_out: LeftOut,
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
    pub fn new(store: Store) -> Self {
        Self {
            store: Some(store),
            lent: false,
            waiting: heapless::Deque::new(),
            standing: Standing {
                phase: TrialPhase::None,
                rank: 0,
                settings: Settings::default(),
                first: SampleIndex::default(),
                counts: Counts::default(),
                by_button: false,
            },
            left_out: LeftOut::default(),
            resumption: Resumption::None,
            checkpointed: 0,
        }
    }

    /// State of the trial.
    pub const fn status(&self) -> TrialStatus {
        let LeftOut { moving, off_magnitude } = self.left_out;
        let Standing { phase, rank, first, counts, .. } = self.standing;
        let Counts { offered, taken, saturated, repeated, contradictory, unattended } = counts;
        TrialStatus {
            phase,
            rank,
            used: taken.saturating_sub(moving.saturating_add(off_magnitude)),
            saturated,
            first,
            offered,
            repeated,
            moving,
            contradictory,
            off_magnitude,
            unattended,
            resumption: self.resumption,
            checkpointed: self.checkpointed,
        }
    }

    /// Whether a trial of this rank may be started.
    ///
    /// # Errors
    ///
    /// [`Rejection::TrialBusy`], [`Rejection::UnsupportedRank`].
    pub fn may_start(&self, rank: u8) -> Result<(), Rejection> {
        self.require_idle()?;
        match Rank::new(rank.into()) {
            Some(rank) if rank.count() <= GAGES => Ok(()),
            _ => Err(Rejection::UnsupportedRank),
        }
    }

    /// Starts a trial with the converter set so; the sums of the one before are dropped.
    ///
    /// # Errors
    ///
    /// [`Rejection::TrialBusy`], [`Rejection::UnsupportedRank`].
    pub fn start(&mut self, rank: u8, settings: Settings) -> Result<(), Rejection> {
        self.may_start(rank)?;
        self.store.as_mut().ok_or(Rejection::TrialBusy)?.restart();
        let (first, counts) = (SampleIndex::default(), Counts::default());
        self.standing =
            Standing { phase: TrialPhase::Running, rank, settings, first, counts, by_button: false };
        self.left_out = LeftOut::default();
        self.resumption = Resumption::None;
        self.checkpointed = 0;
        Ok(())
    }

    /// Notes that the trial was started with the sensor's button.
    pub const fn note_button(&mut self) {
        self.standing.by_button = true;
    }

    /// Where the trial stands.
    pub const fn standing(&self) -> Standing {
        self.standing
    }

    /// Lends the sums, to be saved or restored. To be given back by [`Trial::take_back`] within a millisecond.
    pub const fn lend(&mut self) -> Option<Store> {
        let store = self.store.take();
        self.lent = store.is_some();
        store
    }

    /// Takes back what was lent; or gives it out again with a sample that came meanwhile, which is to be offered to it and
    /// then told by [`Trial::count`]. Where they do not get fewer, those that wait are given up.
    pub fn take_back(&mut self, store: Store, has_patience: bool) -> Option<(Store, [AdcCode; GAGES])> {
        if has_patience && let Some(codes) = self.waiting.pop_front() {
            return Some((store, codes));
        }
        while self.waiting.pop_front().is_some() {
            self.standing.counts.unattended = self.standing.counts.unattended.saturating_add(1);
        }
        self.store = Some(store);
        self.lent = false;
        None
    }

    /// Notes that so many samples would survive a reset now.
    pub fn note_checkpoint(&mut self, samples: u64) {
        self.checkpointed = u32::try_from(samples).unwrap_or(u32::MAX);
    }

    /// Goes on with a trial whose sums were restored, of so many samples.
    pub fn resume(&mut self, standing: Standing, samples: u64) {
        self.standing = standing;
        let Counts { offered, taken, .. } = &mut self.standing.counts;
        *taken = u32::try_from(samples).unwrap_or(u32::MAX);
        // The counts were kept before the sums, and samples came meanwhile.
        *offered = (*offered).max(*taken);
        self.resumption = Resumption::Resumed;
        self.note_checkpoint(samples);
    }

    /// Notes that there was a trial before the reset, and that it cannot be resumed.
    pub const fn note_loss(&mut self) {
        self.resumption = Resumption::Lost;
    }

    /// The converter's settings may change between trials only: one trial is in one unit of counts.
    ///
    /// # Errors
    ///
    /// [`Rejection::TrialBusy`].
    pub const fn require_idle(&self) -> Result<(), Rejection> {
        match self.standing.phase {
            TrialPhase::Running | TrialPhase::Solving => Err(Rejection::TrialBusy),
            TrialPhase::None | TrialPhase::Stopped => Ok(()),
        }
    }

    /// Takes in one sample while the trial runs, and whether any of its codes is saturated. A sample that is no measurement is counted,
    /// not used.
    pub fn offer(&mut self, index: SampleIndex, codes: &[AdcCode; GAGES], is_saturated: bool) {
        if self.standing.phase != TrialPhase::Running {
            return;
        }
        if self.standing.counts.offered == 0 {
            self.standing.first = index;
        }
        let counts = &mut self.standing.counts;
        counts.offered = counts.offered.saturating_add(1);
        match &mut self.store {
            Some(bins) => {
                let outcome = bins.offer_knowing(codes, is_saturated);
                self.count(outcome);
            }
            None if self.lent && self.waiting.push_back(*codes).is_ok() => {}
            None => counts.unattended = counts.unattended.saturating_add(1),
        }
    }

    /// Counts a sample by what became of it.
    pub fn count(&mut self, outcome: Result<Verdict, Refusal>) {
        let counts = &mut self.standing.counts;
        let counter = match outcome {
            Ok(Verdict::Accepted) => &mut counts.taken,
            Ok(Verdict::Saturated) => &mut counts.saturated,
            Ok(Verdict::Repeated) => &mut counts.repeated,
            Ok(Verdict::Contradictory) => {
                // Its block goes with it.
                counts.taken = counts.taken.saturating_sub(EARLIER_IN_BLOCK);
                counts.contradictory = counts.contradictory.saturating_add(EARLIER_IN_BLOCK);
                &mut counts.contradictory
            }
            // The sums are as full as they may get: what they hold stays good.
            Err(_) => {
                self.standing.phase = TrialPhase::Stopped;
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
        match self.standing.phase {
            TrialPhase::None => Err(Rejection::NoTrial),
            TrialPhase::Solving => Err(Rejection::TrialBusy),
            TrialPhase::Running | TrialPhase::Stopped => {
                self.standing.phase = TrialPhase::Stopped;
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
        match self.standing.phase {
            TrialPhase::None => Err(Rejection::NoTrial),
            TrialPhase::Running | TrialPhase::Solving => Err(Rejection::TrialBusy),
            TrialPhase::Stopped => {
                let store = self.store.take().ok_or(Rejection::TrialBusy)?;
                self.standing.phase = TrialPhase::Solving;
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
        if self.standing.phase == TrialPhase::None {
            return Err(Rejection::NoTrial);
        }
        let store = self.store.take().ok_or(Rejection::TrialBusy)?;
        Ok(self.job(store, Wanted::Coverage))
    }

    const fn job(&self, store: Store, wanted: Wanted) -> SolveJob<Store, GAGES, HIGHER> {
        SolveJob {
            store,
            wanted,
            rank: self.standing.rank,
            counts: self.standing.counts,
            left_out: self.left_out,
        }
    }

    /// Takes back what [`Trial::take_for_solving`] or [`Trial::take_for_coverage`] handed out: a trial that was to be
    /// solved may be solved again, one that was asked where it stands goes on as it was.
    pub fn finish(&mut self, job: SolveJob<Store, GAGES, HIGHER>) {
        self.store = Some(job.store);
        if job.wanted == Wanted::Solution {
            self.left_out = job.left_out;
            self.standing.phase = TrialPhase::Stopped;
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

    /// Tells what the trial has covered and how certain its solution is.
    ///
    /// # Errors
    ///
    /// Those of [`Bins::coverage`].
    pub fn coverage(&mut self) -> Result<Coverage, Refusal> {
        let rank = self.rank()?;
        self.store.settle();
        self.store.coverage(rank).map(|covered| coverage_on_the_wire(&covered, rank))
    }

    /// Solves the trial. Takes millions of instructions: not for the sample path.
    ///
    /// # Errors
    ///
    /// Every refusal of [`Bins::solve`]; [`Refusal::Saturated`] where saturation has left too few samples.
    pub fn solve(&mut self) -> Result<Solution, Refusal> {
        self.store.finish();
        let mut solved = self.solve_finished();
        if let Err(Refusal::TooFewSamples { .. }) = solved
            && self.counts.saturated > 0
        {
            solved = Err(Refusal::Saturated { samples: u64::from(self.counts.saturated) });
        }
        solved
    }

    fn solve_finished(&mut self) -> Result<Solution, Refusal> {
        self.left_out = LeftOut::default();
        let solved = self.store.solve(self.rank()?);
        let QuietSolution { solution, up_to } = solved.as_ref().map_err(|refusal| *refusal)?;
        let left_out = self.counts.taken.saturating_sub(u32::try_from(solution.samples).unwrap_or(u32::MAX));
        let off_magnitude = if *up_to < Quietness::Fast { self.store.off_magnitude() } else { 0 };
        self.left_out = LeftOut { moving: left_out.saturating_sub(off_magnitude), off_magnitude };
        on_the_wire(solution)
    }

    fn rank(&self) -> Result<Rank, Refusal> {
        Rank::new(self.rank.into()).ok_or(unsupported::<GAGES>(self.rank))
    }
}

#[expect(clippy::cast_possible_truncation, reason = "at most 12 gages")]
const fn unsupported<const GAGES: usize>(rank: u8) -> Refusal {
    Refusal::UnsupportedDimensions { gages: GAGES as u8, rank }
}

fn on_the_wire<const GAGES: usize>(solved: &TrialSolution<GAGES>) -> Result<Solution, Refusal> {
    #[expect(clippy::cast_possible_truncation, reason = "2 or 3")]
    let rank = solved.rank.count() as u8;
    let unsupported = unsupported::<GAGES>(rank);
    let mut shape_counts_per_load = heapless::Vec::new();
    for row in solved.rank.axes() {
        for gage in 0..GAGES {
            let element = solved.shape_counts_per_load[(row, gage)];
            shape_counts_per_load.push(element).map_err(|_| unsupported)?;
        }
    }
    Ok(Solution {
        rank,
        shape_counts_per_load,
        bias_counts: GageList::from_slice(solved.bias_counts.as_slice()).map_err(|_| unsupported)?,
        eigenvalues: GageList::from_slice(solved.eigenvalues.as_slice()).map_err(|_| unsupported)?,
        noise_counts: solved.noise_variance.map(libm::sqrt),
        samples: u32::try_from(solved.samples).unwrap_or(u32::MAX),
    })
}

#[expect(clippy::cast_possible_truncation, reason = "a report of seven digits")]
fn coverage_on_the_wire<const GAGES: usize>(covered: &coverage::Coverage<GAGES>, rank: Rank) -> Coverage {
    let deviations = &covered.shape_deviation_counts_per_load;
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
        bias_deviation_counts: covered.bias_deviation_counts.iter().map(|&counts| counts as f32).collect(),
        shape_deviation_counts_per_load: rank
            .axes()
            .flat_map(|row| (0..GAGES).map(move |gage| deviations[(row, gage)] as f32))
            .collect(),
    }
}
