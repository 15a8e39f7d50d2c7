//! What can be set about the converter.

use ftcal_shared::units::{DataRate, Gain};

use super::CHANNELS;

/// A set of channels: bit n stands for channel n.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub struct ChannelMask(u8);

impl ChannelMask {
    /// All eight channels.
    pub const ALL: Self = Self(0xFF);

    /// The channels whose bit is set.
    pub const fn new(bits: u8) -> Self {
        Self(bits)
    }

    /// The first so many channels.
    pub const fn first(count: usize) -> Self {
        assert!(count >= 1 && count <= CHANNELS, "the converter has eight channels");
        Self(u8::MAX >> (CHANNELS - count))
    }

    /// One bit for each channel in the set.
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// Whether every channel of `others` is in this set.
    pub const fn contains(self, others: Self) -> bool {
        self.0 & others.0 == others.0
    }
}

impl Default for ChannelMask {
    fn default() -> Self {
        Self::ALL
    }
}

/// How the converter is to work, the same for all channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub struct AdcSettings {
    /// Conversions a second.
    pub data_rate: DataRate,
    /// Amplification at the input.
    pub gain: Gain,
    /// The channels that convert; the others read as zero.
    pub channels: ChannelMask,
    /// What they convert.
    pub input: Input,
}

/// What a channel's amplifier is connected to (8.3.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub enum Input {
    /// The channel's own pins.
    #[default]
    Pins,
    /// A short circuit inside of the converter: code zero, but for offset and noise.
    Shorted,
    /// A voltage of 2/15 of the reference over the gain: [`Input::TEST_SIGNAL_COUNTS`] at any gain.
    PositiveTestSignal,
    /// The same with the opposite sign.
    NegativeTestSignal,
}

impl Input {
    /// The code of the positive test signal: 2/15 of 2²³.
    pub const TEST_SIGNAL_COUNTS: i32 = (2 << 23) / 15;
}
