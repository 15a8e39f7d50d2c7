//! What the sensor keeps across a reset.

use serde::{Deserialize, Serialize};

/// The longest name of a sensor, bytes of UTF-8.
pub const LONGEST_NAME: usize = 32;

/// The name that a user gave to a sensor: its serial number, say. Empty before one was given.
pub type SensorName = heapless::String<LONGEST_NAME>;

/// What is asked of the memory. Each may be asked twice: the second time changes nothing more.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MemoryRequest {
    /// Keep the calibration in use; the one kept so far becomes the previous one. Answered by
    /// [`Response::Done`](super::Response::Done).
    StoreCalibration,
    /// Use and keep the previous calibration, and make the current one the previous. Answered by
    /// [`Response::Calibration`](super::Response::Calibration).
    RollBack {
        /// Identity of the calibration to be brought back. Nothing happens where it is the current one already.
        to: u32,
    },
    /// Keep data rate and gain as they are set now. Answered by [`Response::Done`](super::Response::Done).
    StoreSettings,
    /// Be called so from now on. Answered by [`Response::Done`](super::Response::Done).
    WriteName(SensorName),
}

/// The calibrations that the sensor keeps. The one in use may be another: one that was uploaded and not stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptCalibrations {
    /// The one that is used after a reset.
    pub current: KeptCalibration,
    /// Identity of the one before, which a rollback brings back.
    pub previous: Option<u32>,
}

/// What is used after a reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum KeptCalibration {
    /// The memory has not been read yet: it is, within a second of the start.
    #[default]
    Unread,
    /// Nothing: none was ever stored.
    Nothing,
    /// Nothing: what is in the memory is not what was stored.
    Corrupt,
    /// Nothing: it was stored in this format by other firmware.
    OtherFormat(u8),
    /// Nothing: it is for another number of gages, or unusable in another way.
    Unusable,
    /// Nothing: the memory cannot be read.
    Unreadable,
    /// The calibration of this identity.
    Calibration(u32),
}

/// Who the sensor is, and what it has been through.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// What the user calls it.
    pub name: SensorName,
    /// How often it has started.
    pub boots: u32,
    /// How often a calibration was stored or brought back.
    pub stores: u32,
}
