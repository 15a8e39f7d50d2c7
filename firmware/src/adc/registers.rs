//! The registers the driver uses (datasheet 8.6), and what it writes into them.
//!
//! All others keep their value after reset: no global chop, no current detection, no DC block, phase offsets zero,
//! offset correction 0, gain correction 1, and, unless asked for otherwise, inputs connected to the pins.

use ftcal_shared::units::{DataRate, Gain};

use super::CHANNELS;
use super::settings::{AdcSettings, Input};

/// A register, by its address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Register {
    /// Which device this is (8.6.1).
    Id = 0x00,
    /// Checksums, word format, data-ready line (8.6.3).
    Mode = 0x02,
    /// Channels, clock source, oversampling ratio, power mode (8.6.4).
    Clock = 0x03,
    /// Gains of channels 0 to 3 (8.6.5).
    Gain1 = 0x04,
    /// Gains of channels 4 to 7 (8.6.6).
    Gain2 = 0x05,
    /// What channel 0 converts (8.6.10), and so on.
    Channel0 = 0x09,
    Channel1 = 0x0E,
    Channel2 = 0x13,
    Channel3 = 0x18,
    Channel4 = 0x1D,
    Channel5 = 0x22,
    Channel6 = 0x27,
    Channel7 = 0x2C,
    /// The converter's own checksum of its registers 02h to 30h (8.3.13).
    MapChecksum = 0x3E,
}

impl Register {
    /// Six bits.
    pub(super) const fn address(self) -> u8 {
        self as u8
    }
}

/// The upper byte of [`Register::Id`]: 0010b, then the number of channels. The lower byte is unspecified.
pub(super) const ID_HIGH_BYTE: u8 = 0x28;

/// Watch the register map.
const MODE_REGISTER_MAP_CHECKSUM: u16 = 1 << 13;
/// Check the checksum of commands.
const MODE_COMMAND_CHECKSUM: u16 = 1 << 12;
/// Words of 24 bits.
const MODE_WORD_LENGTH_24: u16 = 0b01 << 8;
/// Give up a frame that takes longer than 2¹⁵ clock cycles (4 ms).
const MODE_TIMEOUT: u16 = 1 << 4;

/// CCITT checksum (bit 11 clear), reset flag cleared (bit 10), data-ready line low once the most lagging channel is
/// ready and driven high otherwise (bits 3 to 0).
const MODE: u16 = MODE_REGISTER_MAP_CHECKSUM | MODE_COMMAND_CHECKSUM | MODE_WORD_LENGTH_24 | MODE_TIMEOUT;

/// The mode in which the converter takes its full clock of 8.192 MHz.
const CLOCK_HIGH_RESOLUTION: u16 = 0b10;

/// The registers that hold the settings, in the order in which they are to be written: the checks come first.
pub(super) fn contents(settings: AdcSettings) -> [(Register, u16); 4] {
    let gains = gain_code(settings.gain) * 0x1111;
    [
        (Register::Mode, MODE),
        (Register::Clock, clock(settings)),
        (Register::Gain1, gains),
        (Register::Gain2, gains),
    ]
}

/// The registers that say what each channel converts.
pub(super) const CHANNEL_REGISTERS: [Register; CHANNELS] = [
    Register::Channel0,
    Register::Channel1,
    Register::Channel2,
    Register::Channel3,
    Register::Channel4,
    Register::Channel5,
    Register::Channel6,
    Register::Channel7,
];

/// What all of them hold: no phase delay, and the input. `None` where that is what they hold after a reset.
pub(super) const fn channel_contents(settings: AdcSettings) -> Option<u16> {
    match settings.input {
        Input::Pins => None,
        Input::Shorted => Some(0b01),
        Input::PositiveTestSignal => Some(0b10),
        Input::NegativeTestSignal => Some(0b11),
    }
}

/// Crystal oscillator on (bit 7 clear), internal reference (bit 6 clear).
fn clock(settings: AdcSettings) -> u16 {
    u16::from(settings.channels.bits()) << 8
        | oversampling_code(settings.data_rate) << 2
        | CLOCK_HIGH_RESOLUTION
}

/// Oversampling ratio 128 × 2^code, so that the modulator's 4.096 MHz become the data rate.
const fn oversampling_code(data_rate: DataRate) -> u16 {
    match data_rate {
        DataRate::Hz32000 => 0,
        DataRate::Hz16000 => 1,
        DataRate::Hz8000 => 2,
        DataRate::Hz4000 => 3,
        DataRate::Hz2000 => 4,
        DataRate::Hz1000 => 5,
        DataRate::Hz500 => 6,
        DataRate::Hz250 => 7,
    }
}

/// Gain 2^code, three bits in each of a register's four nibbles.
const fn gain_code(gain: Gain) -> u16 {
    match gain {
        Gain::X1 => 0,
        Gain::X2 => 1,
        Gain::X4 => 2,
        Gain::X8 => 3,
        Gain::X16 => 4,
        Gain::X32 => 5,
        Gain::X64 => 6,
        Gain::X128 => 7,
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{DataRate, Gain};

    use super::{CHANNEL_REGISTERS, Register, contents, gain_code, oversampling_code};
    use crate::adc::settings::{AdcSettings, ChannelMask};

    #[test]
    fn the_oversampling_ratio_gives_the_data_rate() {
        for rate in DataRate::ALL {
            assert_eq!(4_096_000 / (128_u32 << oversampling_code(rate)), rate.hertz());
        }
    }

    #[test]
    fn the_gain_is_a_power_of_its_code() {
        for gain in Gain::ALL {
            assert_eq!(1_u16 << gain_code(gain), u16::from(gain.factor()));
        }
    }

    /// What the converter does after reset, all channels at 4000 samples/s and gain 1, written by the driver must be
    /// the registers' reset values but for the two checks switched on and the reset flag cleared.
    #[test]
    fn settings_after_reset_are_the_reset_values() {
        let settings = AdcSettings { data_rate: DataRate::Hz4000, gain: Gain::X1, ..AdcSettings::default() };
        assert_eq!(
            contents(settings),
            [
                (Register::Mode, 0x0510 ^ 0x2000 ^ 0x1000 ^ 0x0400),
                (Register::Clock, 0xFF0E),
                (Register::Gain1, 0x0000),
                (Register::Gain2, 0x0000),
            ]
        );
    }

    #[test]
    fn each_channel_has_its_own_enable_bit_and_gain_nibble() {
        for channel in 0..8 {
            let settings = AdcSettings { channels: ChannelMask::new(1 << channel), ..AdcSettings::default() };
            let [_, (_, clock), (_, gain1), (_, gain2)] = contents(settings);
            assert_eq!(clock >> 8, 1 << channel);
            let nibble = if channel < 4 { gain1 >> (4 * channel) } else { gain2 >> (4 * (channel - 4)) };
            assert_eq!(nibble & 0xF, gain_code(settings.gain));
        }
    }

    /// Five registers for each channel, from 09h on.
    #[test]
    fn channels_have_their_registers_in_order() {
        for (channel, register) in (0_u8..).zip(CHANNEL_REGISTERS) {
            assert_eq!(register.address(), 0x09 + 5 * channel);
        }
    }
}
