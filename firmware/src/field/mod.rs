//! Calibration in the field, with a button and a light and no host.
//!
//! # What it is for
//!
//! Somebody hangs any mass on the sensor, holds the button down until the light answers, and turns the load through all directions.
//! The sensor runs a trial of its own, turns what comes of it into the frame of the calibration that it has, and keeps it if that
//! is no longer right; see [`judgement`].
//!
//! ```text
//!          long press          room made              at its end, or a press                  moved
//!   idle ─────────────► preparing ─────► running ─────────────────────────────► solving ─────────────► storing ─► idle
//!    ▲  (a result is shown                 │ every two seconds:                    │ not moved, or refused
//!    │   until the next press)             ▼ how far by now?                       ▼
//!    └───────────────────────────────────────────────────────────────────────────────
//! ```
//!
//! A press while the trial runs, short or long, stops it: what there is by then is judged if it has three quarters of its way behind it, and
//! refused otherwise. In the other states presses mean nothing.
//!
//! # How long the way is
//!
//! The trial is at its end when it predicts to know every gain and offset within 0.05 % of the load, when the load has been through half of
//! all directions, and after a minute and a half. Any one of them is not enough: what is predicted is what chance does, but a hand
//! leans on the load for seconds on end, so that it takes a number of rests for that to average out; see [`judgement`].
//!
//! # What it cannot do
//!
//! * Sensors that measure torque: a load at one arm tells nothing of the torques, and nobody says where it hangs.
//! * A first calibration: nothing would orient it.
//! * Tell by how much all gages together have changed, because nobody says what hangs there; see
//!   [`reorientation`](ftcal_shared::estimation::reorientation).
//!
//! # Who has precedence
//!
//! A host, always. While its trial runs, or a self-test, or a store, the button is refused. When it stops a trial that the button has
//! started, or starts one of its own, or uploads a calibration, the one in the field is given up, and says so. It may stream all the
//! while: the new calibration waits until it has stopped, because nothing is stored (nor does a wrench change its meaning) under
//! whoever measures. A host's request to start a trial while one runs is rejected, as ever
//! ([`TrialBusy`](ftcal_shared::wire::Rejection::TrialBusy)).
//!
//! # A reset
//!
//! The trial goes on from its last checkpoint, as any does, and its checkpoint says that it was started with the button.
//!
//! # Who does what
//!
//! [`Sensor::attend_panel`](crate::sensor::Sensor::attend_panel) looks at the button and says what the light is to be, every few
//! milliseconds and in a few instructions. What takes time is a [`FieldTask`]: it is handed out by
//! [`Sensor::field_task`](crate::sensor::Sensor::field_task), run by whoever has nothing else to do, with no hold on the sample path, and
//! what came of it goes back by [`Sensor::finish_field`](crate::sensor::Sensor::finish_field).

pub mod button;
pub mod judgement;
pub mod light;

use core::ops::DerefMut;

use embedded_storage::nor_flash::NorFlash;
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::coverage::progress;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::{Coverage, FieldOutcome, FieldPhase, FieldRefusal};

use crate::storage::items::StoredCalibration;
use crate::storage::job::{StoreJob, Stored};
use crate::storage::keeper::Keeper;
use crate::trial::SolveJob;
use button::Button;
use judgement::{Judgement, judge};
use light::Light;

/// What the trial is to know every gain and offset within, relative to the load.
const SUFFICIENT_UNCERTAINTY: f64 = 5e-4;

/// The share of all directions that the load is to go through.
const SUFFICIENT_FRACTION: f32 = 0.5;

/// How long it is to turn.
pub(crate) const SUFFICIENT_MICROS: u64 = 90_000_000;

/// Quarters of its way that a trial has at its end, and those with which it is judged.
pub(crate) const WHOLE: u8 = 4;
const ENOUGH: u8 = 3;

/// Something of a calibration in the field that takes time.
pub enum FieldTask<Store, const GAGES: usize, const HIGHER: usize> {
    /// To be stored, or made room for.
    Store(StoreJob),
    /// How far is the trial by now?
    Look(SolveJob<Store, GAGES, HIGHER>),
    /// What does the trial, with so many quarters of its way behind it, mean for this calibration?
    Judge(SolveJob<Store, GAGES, HIGHER>, StoredCalibration, u8),
}

/// What came of it.
pub enum FieldDone<Store, const GAGES: usize, const HIGHER: usize> {
    /// Of [`FieldTask::Store`].
    Stored(Stored),
    /// Of [`FieldTask::Look`]: how many quarters of its way the trial has behind it, but for the time.
    Looked(SolveJob<Store, GAGES, HIGHER>, u8),
    /// Of [`FieldTask::Judge`].
    Judged(SolveJob<Store, GAGES, HIGHER>, Result<Judgement, FieldRefusal>),
}

impl<Store, const GAGES: usize, const HIGHER: usize> FieldTask<Store, GAGES, HIGHER>
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// Does it. Takes up to some seconds: not for the sample path.
    pub fn run<Flash: NorFlash>(self, keeper: &mut Keeper<Flash>) -> FieldDone<Store, GAGES, HIGHER> {
        match self {
            Self::Store(job) => FieldDone::Stored(keeper.run(&job)),
            Self::Look(mut job) => {
                let quarters = look(&mut job);
                FieldDone::Looked(job, quarters)
            }
            Self::Judge(mut job, reference, quarters) => {
                let judged = solve_and_judge(&mut job, &reference, quarters);
                FieldDone::Judged(job, judged)
            }
        }
    }
}

/// How many quarters of its way a trial has behind it; too little to tell is nothing yet. A function of its own, as the next: the sensor's
/// stack is small.
#[inline(never)]
fn look<Store, const GAGES: usize, const HIGHER: usize>(job: &mut SolveJob<Store, GAGES, HIGHER>) -> u8
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    job.coverage().map_or(0, |coverage| quarters(&coverage))
}

/// Solves the trial, and judges the calibration by it.
#[inline(never)]
fn solve_and_judge<Store, const GAGES: usize, const HIGHER: usize>(
    job: &mut SolveJob<Store, GAGES, HIGHER>,
    reference: &StoredCalibration,
    quarters: u8,
) -> Result<Judgement, FieldRefusal>
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    let refused = |refusal: &Refusal| FieldRefusal::Trial(*refusal);
    let solved = job.solve();
    let solution = solved.as_ref().map_err(refused)?;
    let covered = job.coverage();
    let coverage = covered.as_ref().map_err(refused)?;
    if quarters < ENOUGH {
        return Err(FieldRefusal::Unfinished { quarters, need: ENOUGH });
    }
    judge::<GAGES>(reference, solution, coverage)
}

/// How many quarters of its way a trial has behind it, by what it knows and by where the load has been.
fn quarters(coverage: &Coverage) -> u8 {
    let known = progress(coverage.worst_relative_uncertainty.into(), SUFFICIENT_UNCERTAINTY);
    let been = (coverage.fraction / SUFFICIENT_FRACTION).min(1.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to 4")]
    {
        (f32::from(WHOLE) * been.min(known as f32)) as u8
    }
}

/// Where a calibration in the field stands.
pub struct Field {
    pub(crate) button: Button,
    pub(crate) step: Step,
    last: Option<FieldOutcome>,
    /// The light shows what the last one has ended with.
    is_shown: bool,
}

/// What is going on. `reference` is the identity of the calibration that a trial is to be oriented to.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Step {
    Idle,
    Preparing { reference: u32 },
    Running { reference: u32, since: DeviceTime, next_look: DeviceTime, quarters: u8 },
    Solving { reference: u32, quarters: u8 },
    Storing(StoredCalibration),
}

impl Field {
    pub(crate) const fn new() -> Self {
        Self { button: Button::new(), step: Step::Idle, last: None, is_shown: false }
    }

    /// It has come to its end.
    pub(crate) fn end(&mut self, outcome: FieldOutcome) {
        self.step = Step::Idle;
        self.last = Some(outcome);
        self.is_shown = true;
    }

    /// The host has taken the trial over.
    pub(crate) fn give_up(&mut self) {
        if matches!(self.step, Step::Running { .. } | Step::Solving { .. }) {
            self.end(FieldOutcome::Refused(FieldRefusal::TakenOver));
        }
    }

    /// Somebody has seen what the light shows.
    pub(crate) const fn acknowledge(&mut self) {
        self.is_shown = false;
    }

    /// Whether the light is to be on.
    pub(crate) const fn is_lit(&self, now: DeviceTime) -> bool {
        let is_answering = matches!(self.step, Step::Idle) && self.button.is_down();
        is_answering || self.light().is_on(now)
    }

    const fn light(&self) -> Light {
        match (&self.step, &self.last) {
            (Step::Running { quarters, .. }, _) => Light::Running { quarters: *quarters },
            (Step::Preparing { .. } | Step::Solving { .. } | Step::Storing(_), _) => Light::Working,
            (Step::Idle, Some(outcome)) if self.is_shown => match outcome {
                FieldOutcome::Renewed(..) => Light::Renewed,
                FieldOutcome::Confirmed(_) => Light::Confirmed,
                FieldOutcome::Refused(_) => Light::Refused,
            },
            (Step::Idle, _) => Light::Off,
        }
    }

    pub(crate) const fn phase(&self) -> FieldPhase {
        match self.step {
            Step::Idle => FieldPhase::Idle,
            Step::Preparing { .. } => FieldPhase::Preparing,
            Step::Running { quarters, .. } => FieldPhase::Running { quarters },
            Step::Solving { .. } => FieldPhase::Solving,
            Step::Storing(_) => FieldPhase::Storing,
        }
    }

    pub(crate) const fn last(&self) -> Option<FieldOutcome> {
        self.last
    }
}
