//! The sensor's own clock and sample counter.

use serde::{Deserialize, Serialize};

/// Microseconds since the sensor started, by its own clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(transparent)]
pub struct DeviceTime(u64);

impl DeviceTime {
    /// The instant this many microseconds after the start.
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// Microseconds since the start.
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Seconds since the start.
    pub fn as_seconds(self) -> f64 {
        self.0 as f64 * 1e-6
    }
}

/// The running number of a conversion since the converter was started; a gap says that conversions were lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(transparent)]
pub struct SampleIndex(u32);

impl SampleIndex {
    /// The index of this value.
    pub const fn new(index: u32) -> Self {
        Self(index)
    }

    /// The value.
    pub const fn get(self) -> u32 {
        self.0
    }

    /// The index of the next conversion; wraps around after 2³² − 1.
    #[must_use]
    pub const fn next(self) -> Self {
        Self(self.0.wrapping_add(1))
    }

    /// How many conversions `self` is after `earlier`, across a wrap-around.
    pub const fn since(self, earlier: Self) -> u32 {
        self.0.wrapping_sub(earlier.0)
    }
}
