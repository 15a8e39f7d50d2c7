//! Work on the memory, for the background: a store takes milliseconds, and one or two seconds where a sector has to be erased, during
//! which the processor stands still.
//!
//! So a request that needs the memory becomes a [`StoreJob`], which somebody runs who keeps nobody waiting ([`super::keeper`]). None is made
//! while samples are streamed or a trial runs ([`ftcal_shared::wire::Rejection::Measuring`]), and while one is out,
//! neither can be started ([`ftcal_shared::wire::Rejection::Storing`]): whoever measures is never held up.

use ftcal_shared::wire::{Rejection, SensorName};

use super::items::{Settings, StoredCalibration};
use super::memory::{Kept, StorageError};
use crate::health::{KeptHealth, KeptPeaks};

/// What is to be done.
#[derive(Clone, Debug, PartialEq)]
pub enum StoreJob {
    /// Make this calibration the current one.
    Calibration(StoredCalibration),
    /// Make this calibration the current one, and use it from then on.
    Renewal(StoredCalibration),
    /// Make the previous calibration, of this identity, the current one.
    RollBack(u32),
    /// Keep these settings, and with them limits and tare.
    Settings(Settings, KeptHealth),
    /// Keep this name.
    Name(SensorName),
    /// Keep the largest loads.
    Peaks(KeptPeaks),
    /// Make room for the checkpoints of a new trial.
    PrepareTrial {
        /// The trial's proper rank.
        rank: u8,
        /// The sensor's gages.
        gages: u8,
        /// Whether the processor may stand still for as long as an erase takes.
        may_erase: bool,
    },
}

/// What came of it.
#[derive(Clone, Debug, PartialEq)]
pub enum Stored {
    /// All that is kept now.
    Kept(Kept),
    /// All that is kept now, and is to be used from now on.
    Replaced(Kept),
    /// The trial of this rank may start. It has checkpoints if there was room for them.
    Prepared {
        /// The trial's proper rank.
        rank: u8,
    },
    /// It is not done: what is kept is what was kept before.
    Failed(StorageError),
}

impl From<StorageError> for Rejection {
    fn from(error: StorageError) -> Self {
        match error {
            StorageError::NoSuchCalibration => Self::NoSuchCalibration,
            StorageError::Flash | StorageError::ReadBackDiffers | StorageError::NoRoom => Self::NotStored,
        }
    }
}
