//! What is kept: calibrations, settings, name and counters.

use ftcal_shared::units::{DataRate, Gain};
use ftcal_shared::wire::{CalibrationOrigin, CalibrationUpload, SensorName};
use serde::{Deserialize, Serialize};

use super::record::Key;
use crate::health::{KeptHealth, KeptPeaks};

/// Something that is kept under a key of its own. To keep something else, implement this for it, and give it a new key.
pub trait Item: Serialize + PartialEq + for<'bytes> Deserialize<'bytes> {
    /// Its key.
    #[doc(hidden)]
    const KEY: ItemKey;
    /// The number of its format; to be raised with every change of what it holds.
    const FORMAT: u8;
}

/// The key of an [`Item`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ItemKey(pub(super) Key);

/// A calibration with what it needs to be right.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredCalibration {
    /// The calibration as it was uploaded, or as the sensor has renewed it.
    pub upload: CalibrationUpload,
    /// Where it comes from.
    pub origin: CalibrationOrigin,
}

impl StoredCalibration {
    /// The number of its format.
    pub(super) const FORMAT: u8 = 3;
}

/// How the converter is to be set after a reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// Conversions a second.
    pub data_rate: DataRate,
    /// Gain.
    pub gain: Gain,
}

impl Item for Settings {
    const KEY: ItemKey = ItemKey(Key::Settings);
    const FORMAT: u8 = 1;
}

impl Item for KeptHealth {
    const KEY: ItemKey = ItemKey(Key::Health);
    const FORMAT: u8 = 2;
}

impl Item for KeptPeaks {
    const KEY: ItemKey = ItemKey(Key::Peaks);
    const FORMAT: u8 = 1;
}

/// The name that the user gave.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Name(pub SensorName);

impl Item for Name {
    const KEY: ItemKey = ItemKey(Key::Name);
    const FORMAT: u8 = 1;
}

/// What the sensor has been through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// How often it has started.
    pub boots: u32,
    /// How often a calibration was stored or brought back.
    pub stores: u32,
}

impl Item for Counters {
    const KEY: ItemKey = ItemKey(Key::Counters);
    const FORMAT: u8 = 1;
}

/// Which calibration is current, and which was before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Roster {
    /// Grows with every change; of two copies, the one with the larger number is right.
    pub(super) number: u32,
    pub(super) current: Option<Entry>,
    pub(super) previous: Option<Entry>,
}

impl Roster {
    pub(super) const FORMAT: u8 = 1;
}

/// A calibration by its place and its identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Entry {
    pub(super) slot: Slot,
    pub(super) identity: u32,
}

/// A place for a calibration. There is one more than there are calibrations to be kept, so that a new one never takes the
/// place of one that is still needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Slot {
    A,
    B,
    C,
}

impl Slot {
    pub(super) const ALL: [Self; 3] = [Self::A, Self::B, Self::C];

    pub(super) const fn key(self) -> Key {
        match self {
            Self::A => Key::CalibrationA,
            Self::B => Key::CalibrationB,
            Self::C => Key::CalibrationC,
        }
    }
}
