//! The converter's register map (datasheet section 8.6): what each register holds after a reset, and which of its bits
//! a write can change.
//!
//! Sixty-four registers of 16 bits. Reserved bits and registers read as zero and ignore writes. The word length is
//! fixed at 24 bits (the two `WLENGTH` bits ignore writes), because that is the only length modelled.

use ftcal_shared::units::{DataRate, Gain};

use super::CHANNELS;
use super::checksum::Polynomial;
use super::input::{InputSelection, InputSettings};

/// How many registers the six address bits reach.
const REGISTERS: usize = 64;

/// Identity: read-only.
pub(super) const ID: u8 = 0x00;
/// Status: read-only, and put together by the model rather than stored.
pub(super) const STATUS: u8 = 0x01;
const MODE: u8 = 0x02;
const CLOCK: u8 = 0x03;
const GAIN1: u8 = 0x04;
const GAIN2: u8 = 0x05;
const CFG: u8 = 0x06;
const THRSHLD_MSB: u8 = 0x07;
const THRSHLD_LSB: u8 = 0x08;
const CH0_CFG: u8 = 0x09;
/// The last register of channel 7: five registers for each of eight channels.
const CH7_GCAL_LSB: u8 = CH0_CFG + 5 * 8 - 1;

const MODE_RX_CRC_EN: u16 = 1 << 12;
const MODE_CRC_TYPE: u16 = 1 << 11;
const MODE_RESET: u16 = 1 << 10;
const MODE_DRDY_FMT: u16 = 1;

/// The identity of an ADS131M08: eight channels. The low byte is unspecified; a driver must not depend on it.
pub(super) const ADS131M08_ID: u16 = 0x2803;

/// What the registers hold.
#[derive(Clone, Debug)]
pub(super) struct RegisterMap {
    words: [u16; REGISTERS],
}

impl RegisterMap {
    /// The registers after a reset of a part with this identity.
    pub(super) fn after_reset(identity: u16) -> Self {
        let mut words = [0; REGISTERS];
        for (address, word) in (0_u8..).zip(&mut words) {
            *word = if address == ID { identity } else { reset_value(address) };
        }
        Self { words }
    }

    /// The register at this address; zero beyond the map.
    pub(super) fn read(&self, address: u8) -> u16 {
        self.words.get(usize::from(address)).copied().unwrap_or(0)
    }

    /// Writes what can be written of a register; false where nothing there can be.
    pub(super) fn write(&mut self, address: u8, value: u16) -> bool {
        let mask = writable_bits(address);
        let Some(word) = self.words.get_mut(usize::from(address)) else { return false };
        let mut written = (*word & !mask) | (value & mask);
        if address == MODE {
            // The reset flag can be cleared by the host; only a reset sets it.
            written &= *word | !MODE_RESET;
        }
        *word = written;
        mask != 0
    }

    /// Replaces the identity.
    pub(super) fn set_identity(&mut self, identity: u16) {
        if let Some(word) = self.words.get_mut(usize::from(ID)) {
            *word = identity;
        }
    }

    /// Whether a command needs a correct checksum.
    pub(super) fn input_checksum_enabled(&self) -> bool {
        self.read(MODE) & MODE_RX_CRC_EN != 0
    }

    /// The checksum in use in both directions.
    pub(super) fn polynomial(&self) -> Polynomial {
        if self.read(MODE) & MODE_CRC_TYPE == 0 { Polynomial::Ccitt } else { Polynomial::Ansi }
    }

    /// Whether data ready is announced by a pulse rather than by a level.
    pub(super) fn data_ready_is_a_pulse(&self) -> bool {
        self.read(MODE) & MODE_DRDY_FMT != 0
    }

    /// The bits of the status word that repeat the mode: checksum type, reset flag, word length.
    pub(super) fn mode_in_status(&self) -> u16 {
        self.read(MODE) & 0x0F00
    }

    /// Which channels convert, channel 0 in the lowest bit.
    pub(super) fn enabled_channels(&self) -> u8 {
        let [enabled, _] = self.read(CLOCK).to_be_bytes();
        enabled
    }

    /// The data rate that the oversampling ratio gives with the nominal 8.192 MHz clock.
    pub(super) fn data_rate(&self) -> DataRate {
        match (self.read(CLOCK) >> 2) & 0b111 {
            0 => DataRate::Hz32000,
            1 => DataRate::Hz16000,
            2 => DataRate::Hz8000,
            3 => DataRate::Hz4000,
            4 => DataRate::Hz2000,
            5 => DataRate::Hz1000,
            6 => DataRate::Hz500,
            _ => DataRate::Hz250,
        }
    }

    /// How each channel treats its input.
    pub(super) fn inputs(&self) -> [InputSettings; CHANNELS] {
        let gains = (u32::from(self.read(GAIN2)) << 16) | u32::from(self.read(GAIN1));
        let mut first_register = CH0_CFG;
        let mut gain_field = gains;
        [(); CHANNELS].map(|()| {
            let settings = InputSettings {
                selection: match self.read(first_register) & 0b11 {
                    0 => InputSelection::Pins,
                    1 => InputSelection::Shorted,
                    2 => InputSelection::PositiveTestSignal,
                    _ => InputSelection::NegativeTestSignal,
                },
                gain: match gain_field & 0b111 {
                    0 => Gain::X1,
                    1 => Gain::X2,
                    2 => Gain::X4,
                    3 => Gain::X8,
                    4 => Gain::X16,
                    5 => Gain::X32,
                    6 => Gain::X64,
                    _ => Gain::X128,
                },
                offset_correction: signed_24_bits(self.joined(first_register + 1)),
                gain_correction: self.joined(first_register + 3),
            };
            first_register += 5;
            gain_field >>= 4;
            settings
        })
    }

    /// The 24-bit number in two neighbouring registers: 16 high bits, then 8 low bits at the top of the second.
    fn joined(&self, high: u8) -> u32 {
        (u32::from(self.read(high)) << 8) | u32::from(self.read(high + 1) >> 8)
    }
}

/// The value of the two's complement number in the lowest 24 bits.
fn signed_24_bits(word: u32) -> i32 {
    (word << 8).cast_signed() >> 8
}

/// What a register holds after a reset.
const fn reset_value(address: u8) -> u16 {
    match address {
        MODE => 0x0510,
        CLOCK => 0xFF0E,
        CFG => 0x0600,
        CH0_CFG..=CH7_GCAL_LSB if (address - CH0_CFG) % 5 == 3 => 0x8000,
        _ => 0,
    }
}

/// The bits of a register that a write can change.
const fn writable_bits(address: u8) -> u16 {
    match address {
        MODE => 0x3C1F,
        CLOCK => 0xFF1F,
        GAIN1 | GAIN2 => 0x7777,
        CFG => 0x1FFF,
        THRSHLD_MSB => 0xFFFF,
        THRSHLD_LSB => 0xFF0F,
        CH0_CFG..=CH7_GCAL_LSB => match (address - CH0_CFG) % 5 {
            0 => 0xFFC7,
            1 | 3 => 0xFFFF,
            _ => 0xFF00,
        },
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{DataRate, Gain};

    use super::{ADS131M08_ID, CH0_CFG, CLOCK, GAIN1, GAIN2, ID, MODE, RegisterMap, STATUS, writable_bits};

    #[test]
    fn exactly_the_writable_bits_change() {
        for address in 0..64 {
            for pattern in [0xFFFF, 0x0000, 0xA5A5] {
                let mut registers = RegisterMap::after_reset(ADS131M08_ID);
                let before = registers.read(address);
                assert_eq!(registers.write(address, pattern), writable_bits(address) != 0);
                let changed = (registers.read(address) ^ before) & !writable_bits(address);
                assert_eq!(changed, 0, "register {address:#04x}");
            }
        }
    }

    #[test]
    fn identity_status_and_gaps_cannot_be_written() {
        let mut registers = RegisterMap::after_reset(ADS131M08_ID);
        for address in [ID, STATUS, 0x31, 0x3E, 0x3F, 0x40, 0xFF] {
            assert!(!registers.write(address, 0xFFFF));
        }
        assert_eq!(registers.read(ID), ADS131M08_ID);
    }

    #[test]
    fn the_reset_flag_clears_and_cannot_be_set() {
        let mut registers = RegisterMap::after_reset(ADS131M08_ID);
        registers.write(MODE, 0x0110);
        assert_eq!(registers.mode_in_status(), 0x0100);
        registers.write(MODE, 0x0510);
        assert_eq!(registers.mode_in_status(), 0x0100);
    }

    #[test]
    fn oversampling_halves_the_rate_from_32_000() {
        let mut registers = RegisterMap::after_reset(ADS131M08_ID);
        assert_eq!(registers.data_rate(), DataRate::Hz4000, "1024-fold oversampling after a reset");
        for ratio in 0..8_u16 {
            registers.write(CLOCK, 0xFF02 | (ratio << 2));
            assert_eq!(registers.data_rate().hertz(), 4_096_000 / (128 << ratio));
        }
    }

    #[test]
    fn each_channel_has_its_own_gain_field() {
        for channel in 0..8_usize {
            let mut registers = RegisterMap::after_reset(ADS131M08_ID);
            let address = if channel < 4 { GAIN1 } else { GAIN2 };
            registers.write(address, 0b101 << (4 * (channel % 4)));
            let gains = registers.inputs().map(|input| input.gain);
            for (other, gain) in gains.into_iter().enumerate() {
                assert_eq!(gain, if other == channel { Gain::X32 } else { Gain::X1 });
            }
        }
    }

    #[test]
    fn corrections_join_two_registers() {
        let mut registers = RegisterMap::after_reset(ADS131M08_ID);
        let channel_3 = CH0_CFG + 5 * 3;
        registers.write(channel_3 + 1, 0xFFFF);
        registers.write(channel_3 + 2, 0xFE00);
        registers.write(channel_3 + 3, 0x4000);
        registers.write(channel_3 + 4, 0x0100);
        let inputs = registers.inputs();
        assert_eq!((inputs[3].offset_correction, inputs[3].gain_correction), (-2, 0x40_0001));
        assert_eq!((inputs[2].offset_correction, inputs[2].gain_correction), (0, 0x80_0000));
    }
}
