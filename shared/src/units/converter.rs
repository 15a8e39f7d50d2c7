//! The converter's settings that travel over the wire.

use serde::{Deserialize, Serialize};

/// How many conversions a second the converter delivers on every channel, with its nominal 8.192 MHz clock.
///
/// The number is the modulator rate of 4.096 MHz divided by the oversampling ratio (128 … 16 384).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum DataRate {
    /// 250 samples/s, oversampling ratio 16 384.
    Hz250,
    /// 500 samples/s, oversampling ratio 8192.
    Hz500,
    /// 1000 samples/s, oversampling ratio 4096: the rate after power-up of the board.
    #[default]
    Hz1000,
    /// 2000 samples/s, oversampling ratio 2048.
    Hz2000,
    /// 4000 samples/s, oversampling ratio 1024.
    Hz4000,
    /// 8000 samples/s, oversampling ratio 512.
    Hz8000,
    /// 16 000 samples/s, oversampling ratio 256.
    Hz16000,
    /// 32 000 samples/s, oversampling ratio 128.
    Hz32000,
}

impl DataRate {
    /// Every rate, slowest first.
    pub const ALL: [Self; 8] = [
        Self::Hz250,
        Self::Hz500,
        Self::Hz1000,
        Self::Hz2000,
        Self::Hz4000,
        Self::Hz8000,
        Self::Hz16000,
        Self::Hz32000,
    ];

    /// The rate in samples per second.
    pub const fn hertz(self) -> u32 {
        match self {
            Self::Hz250 => 250,
            Self::Hz500 => 500,
            Self::Hz1000 => 1000,
            Self::Hz2000 => 2000,
            Self::Hz4000 => 4000,
            Self::Hz8000 => 8000,
            Self::Hz16000 => 16_000,
            Self::Hz32000 => 32_000,
        }
    }

    /// The rate of this many samples per second, or `None` where the converter has no such rate.
    pub fn from_hertz(hertz: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|rate| rate.hertz() == hertz)
    }
}

/// The gain of the converter's input amplifier, the same on every channel.
///
/// Full scale at the input is ±1.2 V divided by the gain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Gain {
    /// Full scale ±1.2 V.
    X1,
    /// Full scale ±600 mV.
    X2,
    /// Full scale ±300 mV.
    X4,
    /// Full scale ±150 mV.
    X8,
    /// Full scale ±75 mV.
    X16,
    /// Full scale ±37.5 mV.
    X32,
    /// Full scale ±18.75 mV.
    X64,
    /// Full scale ±9.375 mV, about ±2.8 mV/V of a 3.3 V bridge: the gain after power-up of the board.
    #[default]
    X128,
}

impl Gain {
    /// Every gain, smallest first.
    pub const ALL: [Self; 8] =
        [Self::X1, Self::X2, Self::X4, Self::X8, Self::X16, Self::X32, Self::X64, Self::X128];

    /// The amplification.
    pub const fn factor(self) -> u8 {
        match self {
            Self::X1 => 1,
            Self::X2 => 2,
            Self::X4 => 4,
            Self::X8 => 8,
            Self::X16 => 16,
            Self::X32 => 32,
            Self::X64 => 64,
            Self::X128 => 128,
        }
    }

    /// The gain of this amplification, or `None` where the converter has no such gain.
    pub fn from_factor(factor: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|gain| gain.factor() == factor)
    }
}
