//! What the sensor does about a calibration in the field; see [`crate::field`].

use core::ops::DerefMut;

use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::units::{DeviceTime, Dof};
use ftcal_shared::wire::{
    AdcState, CalibrationOrigin, FieldOutcome, FieldRefusal, FieldReport, KeptCalibration, Rejection,
    Response, StreamKind, TrialPhase,
};

use super::Sensor;
use crate::field::button::Press;
use crate::field::judgement::Judgement;
use crate::field::{FieldDone, FieldTask, SUFFICIENT_MICROS, Step, WHOLE};
use crate::storage::items::StoredCalibration;
use crate::storage::job::{StoreJob, Stored};

/// Between two looks at how far the trial is. A look takes some hundredths of a second, in which samples are lost to it.
const LOOK_MICROS: u64 = 2_000_000;

/// A trial that somebody has forgotten comes to its end.
const LONGEST_TRIAL_MICROS: u64 = 20 * 60 * 1_000_000;

impl<Store, const GAGES: usize, const HIGHER: usize> Sensor<Store, GAGES, HIGHER>
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// Looks at the button, and says whether the light is to be on: to be called every few milliseconds. Takes a few instructions.
    pub fn attend_panel(&mut self, now: DeviceTime, is_pressed: bool) -> bool {
        match (self.field.button.look(now, is_pressed), &self.field.step) {
            (None, Step::Idle) => self.go_on_after_reset(now),
            (Some(Press::Short), Step::Idle) => self.field.acknowledge(),
            (Some(Press::Long), Step::Idle) => match self.field_reference() {
                Ok((reference, _)) => self.field.step = Step::Preparing { reference },
                Err(refusal) => self.refuse_field(refusal),
            },
            (Some(_), &Step::Running { reference, quarters, .. }) => {
                self.end_field_trial(reference, quarters);
            }
            (_, Step::Preparing { .. } | Step::Running { .. } | Step::Solving { .. } | Step::Storing(_)) => {}
        }
        self.field.is_lit(now)
    }

    /// What is to be done now in the background, if anything.
    #[inline(never)]
    pub fn field_task(&mut self, now: DeviceTime) -> Option<FieldTask<Store, GAGES, HIGHER>> {
        match self.field.step {
            Step::Idle => None,
            Step::Preparing { reference } => match self.prepare_field_trial(reference) {
                Ok(job) => Some(FieldTask::Store(job)),
                Err(refusal) => {
                    self.refuse_field(refusal);
                    None
                }
            },
            Step::Running { reference, since, next_look, quarters } => {
                let standing = self.trial.standing();
                let is_over =
                    standing.phase != TrialPhase::Running || now >= after(since, LONGEST_TRIAL_MICROS);
                if is_over {
                    self.end_field_trial(reference, quarters);
                }
                if is_over || now < next_look {
                    return None;
                }
                self.trial.take_for_coverage().ok().map(FieldTask::Look)
            }
            Step::Solving { reference, quarters } => self.judge_field_trial(reference, quarters),
            Step::Storing(_) => self.store_field_calibration(),
        }
    }

    /// Takes up what came of a task.
    #[inline(never)]
    pub fn finish_field(&mut self, done: FieldDone<Store, GAGES, HIGHER>, now: DeviceTime) {
        match done {
            FieldDone::Stored(stored) => self.field_stored(stored, now),
            FieldDone::Looked(job, seen) => {
                self.trial.finish(job);
                // Somebody may have stopped it meanwhile.
                if let Step::Running { reference, since, next_look, quarters } = &mut self.field.step {
                    let lasted = now.as_micros().saturating_sub(since.as_micros());
                    #[expect(clippy::cast_possible_truncation, reason = "4 at most")]
                    let by_time = (u64::from(WHOLE) * lasted / SUFFICIENT_MICROS).min(u64::from(WHOLE)) as u8;
                    *next_look = after(now, LOOK_MICROS);
                    *quarters = seen.min(by_time);
                    if *quarters == WHOLE {
                        let (reference, quarters) = (*reference, *quarters);
                        self.end_field_trial(reference, quarters);
                    }
                }
            }
            FieldDone::Judged(job, judged) => {
                self.trial.finish(job);
                match judged {
                    Ok(Judgement::Renewed(calibration)) => self.field.step = Step::Storing(calibration),
                    Ok(Judgement::Confirmed(found)) => self.field.end(FieldOutcome::Confirmed(found)),
                    Err(refusal) => self.refuse_field(refusal),
                }
            }
        }
    }

    pub(super) fn field_report(&self) -> FieldReport {
        FieldReport {
            phase: self.field.phase(),
            last: self.field.last(),
            origin: self.calibration.as_ref().map(|loaded| loaded.origin),
        }
    }

    /// The calibration that a trial could be oriented to now, by its identity, and what it measures.
    fn field_reference(&self) -> Result<(u32, Dof), FieldRefusal> {
        let loaded = self.calibration.as_ref().ok_or(FieldRefusal::Uncalibrated)?;
        let upload = &loaded.upload;
        if upload.dof.has_torque() {
            return Err(FieldRefusal::MeasuresTorque);
        }
        if self.kept.current != KeptCalibration::Calibration(upload.identity) {
            return Err(FieldRefusal::CalibrationNotKept);
        }
        if upload.gain != self.converter.settings().gain {
            return Err(FieldRefusal::GainChanged);
        }
        if self.converter.state() != AdcState::Running {
            return Err(FieldRefusal::Converter);
        }
        Ok((upload.identity, upload.dof))
    }

    fn prepare_field_trial(&mut self, reference: u32) -> Result<StoreJob, FieldRefusal> {
        let (in_use, dof) = self.field_reference()?;
        if in_use != reference {
            return Err(FieldRefusal::CalibrationChanged);
        }
        #[expect(clippy::cast_possible_truncation, reason = "2 or 3")]
        self.prepare_trial(dof.trial_rank() as u8).map_err(FieldRefusal::Busy)
    }

    /// What has been started with the button before a reset is gone on with.
    fn go_on_after_reset(&mut self, now: DeviceTime) {
        let standing = self.trial.standing();
        if standing.by_button
            && standing.phase == TrialPhase::Running
            && let Some(loaded) = &self.calibration
        {
            self.field.step = running(loaded.upload.identity, now);
        }
    }

    fn end_field_trial(&mut self, reference: u32, quarters: u8) {
        // It may have ended by itself.
        let _ = self.trial.stop();
        self.field.step = Step::Solving { reference, quarters };
    }

    fn judge_field_trial(&mut self, reference: u32, quarters: u8) -> Option<FieldTask<Store, GAGES, HIGHER>> {
        let loaded = self.calibration.as_ref().filter(|loaded| loaded.upload.identity == reference);
        let settings = self.trial.standing().settings;
        let refusal = match loaded {
            _ if !self.trial.standing().by_button => FieldRefusal::TakenOver,
            None => FieldRefusal::CalibrationChanged,
            Some(loaded) if loaded.upload.gain != settings.gain => FieldRefusal::GainChanged,
            Some(loaded) => {
                let reference = loaded.to_be_stored();
                // Where a host has the sums to look at them, they come back.
                return self
                    .trial
                    .take_for_solving()
                    .ok()
                    .map(|job| FieldTask::Judge(job, reference, quarters));
            }
        };
        self.refuse_field(refusal);
        None
    }

    /// Has the new calibration stored, as soon as nobody measures; unless the one that it was oriented to is no longer in use.
    fn store_field_calibration(&mut self) -> Option<FieldTask<Store, GAGES, HIGHER>> {
        let Step::Storing(calibration) = &self.field.step else { return None };
        let is_in_use = |identity: u32| {
            self.calibration.as_ref().is_some_and(|loaded| loaded.upload.identity == identity)
        };
        if !reference_of(calibration).is_some_and(is_in_use) {
            self.refuse_field(FieldRefusal::CalibrationChanged);
            return None;
        }
        let is_quiet = self.stream == StreamKind::Off && !self.storing && self.require_peace().is_ok();
        if !is_quiet {
            return None;
        }
        self.storing = true;
        Some(FieldTask::Store(StoreJob::Renewal(calibration.clone())))
    }

    /// Takes up what the memory says: there is room for the trial, or the new calibration is kept.
    fn field_stored(&mut self, stored: Stored, now: DeviceTime) {
        let served = match self.finish_storing(stored) {
            Response::Rejected(rejection) => Err(rejection),
            _ => Ok(()),
        };
        match (&self.field.step, served) {
            (&Step::Preparing { reference }, Ok(())) => {
                self.trial.note_button();
                self.field.step = running(reference, now);
            }
            (Step::Preparing { .. }, Err(rejection)) => self.refuse_field(FieldRefusal::Busy(rejection)),
            (Step::Storing(StoredCalibration { origin, .. }), Ok(())) => {
                if let &CalibrationOrigin::Field(renewed, found) = origin {
                    self.field.end(FieldOutcome::Renewed(renewed, found));
                }
            }
            (Step::Storing(_), Err(Rejection::NotStored)) => self.refuse_field(FieldRefusal::NotStored),
            (Step::Storing(_), Err(_)) => self.refuse_field(FieldRefusal::UnusableNumbers),
            (Step::Idle | Step::Running { .. } | Step::Solving { .. }, _) => {}
        }
    }

    fn refuse_field(&mut self, refusal: FieldRefusal) {
        self.field.end(FieldOutcome::Refused(refusal));
    }
}

/// The identity of the calibration that this one was oriented to.
const fn reference_of(calibration: &StoredCalibration) -> Option<u32> {
    match calibration.origin {
        CalibrationOrigin::Uploaded => None,
        CalibrationOrigin::Field(_, found) => Some(found.reference),
    }
}

const fn running(reference: u32, now: DeviceTime) -> Step {
    Step::Running { reference, since: now, next_look: after(now, LOOK_MICROS), quarters: 0 }
}

const fn after(time: DeviceTime, micros: u64) -> DeviceTime {
    DeviceTime::from_micros(time.as_micros().saturating_add(micros))
}
