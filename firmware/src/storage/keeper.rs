//! All that is kept, in one hand: whoever works in the background has it, and nobody else.

use core::ops::DerefMut;

use embedded_storage::nor_flash::NorFlash;
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::KeptCalibration;

use super::checkpoint::{Checkpoints, TrialAccess};
use super::items::{Name, Settings};
use super::job::{StoreJob, Stored};
use super::memory::{Kept, Memory, StorageError};
use crate::trial::Trial;

/// How often the memory is read at the start before it counts as unreadable.
const ATTEMPTS: u32 = 3;

/// Memory and checkpoints, in one flash.
#[derive(Debug)]
pub struct Keeper<Flash> {
    memory: Memory<Flash>,
    checkpoints: Checkpoints,
}

/// What was found after a reset.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// What was kept; or why nothing can be.
    pub kept: Result<Kept, StorageError>,
    /// How the converter is to be set for the trial that goes on, if one does.
    pub trial: Option<Settings>,
}

impl<Flash: NorFlash> Keeper<Flash> {
    /// A keeper of this flash.
    pub const fn new(flash: Flash) -> Self {
        Self { memory: Memory::new(flash), checkpoints: Checkpoints::new() }
    }

    /// Reads what was kept, and goes on with a trial that a reset has interrupted. To be called once, at the start.
    #[inline(never)]
    pub fn start<Store, Access, const GAGES: usize, const HIGHER: usize>(
        &mut self,
        access: &mut Access,
    ) -> Found
    where
        Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
        Access: TrialAccess<Store, GAGES, HIGHER>,
    {
        let kept = persistently(|| self.memory.start());
        let trial =
            persistently(|| self.checkpoints.resume(self.memory.flash(), access)).unwrap_or_else(|_| {
                // Nobody knows whether there was a trial. If there was, it is lost.
                access.with(Trial::note_loss);
                None
            });
        Found { kept, trial }
    }

    /// Makes a checkpoint of the trial if one is due. To be called again and again.
    #[inline(never)]
    pub fn attend<Store, Access, const GAGES: usize, const HIGHER: usize>(
        &mut self,
        now: DeviceTime,
        access: &mut Access,
    ) where
        Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
        Access: TrialAccess<Store, GAGES, HIGHER>,
    {
        self.checkpoints.attend(self.memory.flash(), now, access);
    }

    /// Does a job.
    #[inline(never)]
    pub fn run(&mut self, job: &StoreJob) -> Stored {
        let memory = &mut self.memory;
        let done = match job {
            StoreJob::Calibration(calibration) | StoreJob::Renewal(calibration) => {
                memory.store_calibration(calibration)
            }
            StoreJob::RollBack(to) => memory.roll_back(*to),
            StoreJob::Settings(settings, health) => {
                memory.store(settings).and_then(|()| memory.store(health))
            }
            StoreJob::Name(name) => memory.store(&Name(name.clone())),
            StoreJob::Peaks(peaks) => memory.store(peaks),
            StoreJob::PrepareTrial { rank, gages, may_erase } => {
                // A trial without checkpoints is a trial all the same.
                self.checkpoints.begin(memory.flash(), usize::from(*gages), *may_erase);
                return Stored::Prepared { rank: *rank };
            }
        };
        let kept = match done.and_then(|()| memory.read()) {
            Ok(kept) => kept,
            // A failure after the one word that makes a calibration the current one undoes nothing.
            Err(error) => match memory.read() {
                Ok(kept) if is_current(&kept, job) => kept,
                Ok(_) | Err(_) => return Stored::Failed(error),
            },
        };
        match job {
            StoreJob::RollBack(_) | StoreJob::Renewal(_) => Stored::Replaced(kept),
            _ => Stored::Kept(kept),
        }
    }
}

/// Whether the calibration that the job is about is the current one.
fn is_current(kept: &Kept, job: &StoreJob) -> bool {
    let wanted = match job {
        StoreJob::Calibration(calibration) | StoreJob::Renewal(calibration) => calibration.upload.identity,
        StoreJob::RollBack(to) => *to,
        StoreJob::Settings(..) | StoreJob::Name(_) | StoreJob::Peaks(_) | StoreJob::PrepareTrial { .. } => {
            return false;
        }
    };
    kept.calibrations.current == KeptCalibration::Calibration(wanted)
}

/// Does it again where it fails: what is not read at the start is as good as lost until the next.
fn persistently<Value>(mut read: impl FnMut() -> Result<Value, StorageError>) -> Result<Value, StorageError> {
    let mut outcome = read();
    for _ in 1..ATTEMPTS {
        if outcome.is_ok() {
            break;
        }
        outcome = read();
    }
    outcome
}
