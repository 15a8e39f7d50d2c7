//! Work on the memory, for the background: a store takes milliseconds, and one or two seconds where a sector has to be erased, during
//! which the processor stands still.
//!
//! So a request that needs the memory becomes a [`StoreJob`], which somebody runs who keeps nobody waiting. None is made
//! while samples are streamed or a trial runs ([`ftcal_shared::wire::Rejection::Measuring`]), and while one is out,
//! neither can be started ([`ftcal_shared::wire::Rejection::Storing`]): whoever measures is never held up.

use embedded_storage::nor_flash::NorFlash;
use ftcal_shared::wire::{Rejection, SensorName};

use super::items::{Name, Settings, StoredCalibration};
use super::memory::{Kept, Memory, StorageError};

/// What is to be done.
#[derive(Clone, Debug, PartialEq)]
pub enum StoreJob {
    /// Make this calibration the current one.
    Calibration(StoredCalibration),
    /// Make the previous calibration, of this identity, the current one.
    RollBack(u32),
    /// Keep these settings.
    Settings(Settings),
    /// Keep this name.
    Name(SensorName),
}

/// What came of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Stored {
    /// All that is kept now; or why it is what was kept before.
    pub kept: Result<Kept, StorageError>,
    /// Whether what is kept is to be used from now on.
    pub is_rollback: bool,
}

impl StoreJob {
    /// Does it.
    pub fn run<Flash: NorFlash>(&self, memory: &mut Memory<Flash>) -> Stored {
        let done = match self {
            Self::Calibration(calibration) => memory.store_calibration(calibration),
            Self::RollBack(to) => memory.roll_back(*to),
            Self::Settings(settings) => memory.store(settings),
            Self::Name(name) => memory.store(&Name(name.clone())),
        };
        Stored { kept: done.and_then(|()| memory.read()), is_rollback: matches!(self, Self::RollBack(_)) }
    }
}

impl From<StorageError> for Rejection {
    fn from(error: StorageError) -> Self {
        match error {
            StorageError::NoSuchCalibration => Self::NoSuchCalibration,
            StorageError::Flash | StorageError::ReadBackDiffers | StorageError::NoRoom => Self::NotStored,
        }
    }
}
