//! The status register (datasheet 8.6.2), which heads every frame of continuous reading.

use ftcal_shared::fault::AdcFault;

use super::registers::Register;
use super::settings::ChannelMask;

const LOCK: u16 = 1 << 15;
const RESYNCHRONIZED: u16 = 1 << 14;
const REGISTER_MAP: u16 = 1 << 13;
const COMMAND_CHECKSUM: u16 = 1 << 12;
const CHECKSUM_ANSI: u16 = 1 << 11;
const RESET: u16 = 1 << 10;
const WORD_LENGTH: u16 = 0b11 << 8;

/// What the converter says of itself.
///
/// The flags for a corrupted command, a changed register map and a resynchronization are cleared by being read, so each
/// status tells what happened since the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub struct Status(u16);

/// The converter's word format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub enum WordLength {
    /// 16 bits, codes truncated.
    Bits16,
    /// 24 bits: the one this driver sets.
    Bits24,
    /// 32 bits, codes at the left end.
    Bits32ZeroPadded,
    /// 32 bits, codes at the right end with their sign extended.
    Bits32SignExtended,
}

impl Status {
    /// The status of this register value.
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// The register's value.
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// Register writes and resets are refused.
    pub const fn is_locked(self) -> bool {
        self.0 & LOCK != 0
    }

    /// The converter restarted its filters because of its SYNC/RESET pin: the next three conversions are unsettled.
    pub const fn was_resynchronized(self) -> bool {
        self.0 & RESYNCHRONIZED != 0
    }

    /// The checksum of the converter's registers changed.
    pub const fn register_map_changed(self) -> bool {
        self.0 & REGISTER_MAP != 0
    }

    /// A command came with a wrong checksum.
    pub const fn command_was_corrupted(self) -> bool {
        self.0 & COMMAND_CHECKSUM != 0
    }

    /// The converter was reset since its mode register was written.
    pub const fn was_reset(self) -> bool {
        self.0 & RESET != 0
    }

    /// The word format in force.
    pub const fn word_length(self) -> WordLength {
        match (self.0 & WORD_LENGTH) >> 8 {
            0b00 => WordLength::Bits16,
            0b01 => WordLength::Bits24,
            0b10 => WordLength::Bits32ZeroPadded,
            _ => WordLength::Bits32SignExtended,
        }
    }

    /// The channels whose code in this frame was not read before.
    pub const fn data_ready(self) -> ChannelMask {
        let [_, flags] = self.0.to_be_bytes();
        ChannelMask::new(flags)
    }

    /// What is wrong with a converter that answers a NULL command with this in continuous reading.
    ///
    /// A reset comes first: it explains all the others. A resynchronization counts as one: it comes from the same pin, which is wired so
    /// that neither should ever happen, and the conversions after it are not fit for use. A change of the register map is reported as a mismatch of the
    /// register that holds the map's checksum, for nobody knows which of the map's registers it was.
    pub(super) const fn fault(self) -> Option<AdcFault> {
        if self.was_reset() || self.was_resynchronized() {
            Some(AdcFault::UnexpectedReset)
        } else if !self.has_format_set() {
            Some(AdcFault::UnexpectedReply)
        } else if self.command_was_corrupted() {
            Some(AdcFault::CommandCorrupted)
        } else if self.register_map_changed() {
            Some(AdcFault::RegisterMismatch { address: Register::MapChecksum.address() })
        } else if !self.is_locked() {
            Some(AdcFault::UnexpectedReply)
        } else {
            None
        }
    }

    /// Whether a response that should have been another is a status in its place, saying that the command was ignored.
    pub(super) const fn refuses_corrupted_command(response: u16) -> bool {
        let status = Self(response);
        status.has_format_set() && status.command_was_corrupted()
    }

    /// Words of 24 bits and the CCITT checksum, which no reset or setting of ours changes.
    const fn has_format_set(self) -> bool {
        matches!(self.word_length(), WordLength::Bits24) && self.0 & CHECKSUM_ANSI == 0
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::fault::AdcFault;

    use super::{Status, WordLength};
    use crate::adc::settings::ChannelMask;

    const HEALTHY: u16 = 0x8100;

    #[test]
    fn each_bit_means_what_the_datasheet_says() {
        for bit in 0..16 {
            for status in [Status::from_bits(1 << bit), Status::from_bits(!(1 << bit))] {
                let is_set = status.bits() & 1 << bit != 0;
                match bit {
                    15 => assert_eq!(status.is_locked(), is_set),
                    14 => assert_eq!(status.was_resynchronized(), is_set),
                    13 => assert_eq!(status.register_map_changed(), is_set),
                    12 => assert_eq!(status.command_was_corrupted(), is_set),
                    10 => assert_eq!(status.was_reset(), is_set),
                    _ => {}
                }
            }
        }
        for channel in 0..8 {
            assert_eq!(Status::from_bits(1 << channel).data_ready(), ChannelMask::new(1 << channel));
        }
        let lengths = [
            WordLength::Bits16,
            WordLength::Bits24,
            WordLength::Bits32ZeroPadded,
            WordLength::Bits32SignExtended,
        ];
        for (code, length) in (0_u16..).zip(lengths) {
            assert_eq!(Status::from_bits(code << 8).word_length(), length);
        }
    }

    #[test]
    fn data_ready_is_no_fault() {
        for flags in 0..=0xFF {
            assert_eq!(Status::from_bits(HEALTHY | flags).fault(), None);
        }
    }

    #[test]
    fn every_other_deviation_has_its_cause() {
        let faults = [
            (1 << 15, AdcFault::UnexpectedReply),
            (1 << 14, AdcFault::UnexpectedReset),
            (1 << 13, AdcFault::RegisterMismatch { address: 0x3E }),
            (1 << 12, AdcFault::CommandCorrupted),
            (1 << 11, AdcFault::UnexpectedReply),
            (1 << 10, AdcFault::UnexpectedReset),
            (1 << 9, AdcFault::UnexpectedReply),
            (1 << 8, AdcFault::UnexpectedReply),
        ];
        for (bit, fault) in faults {
            assert_eq!(Status::from_bits(HEALTHY ^ bit).fault(), Some(fault));
        }
    }

    /// The first response after a reset that nobody asked for is the one to a reset command, not a status.
    #[test]
    fn the_response_to_a_reset_reads_as_a_reset() {
        assert_eq!(Status::from_bits(0xFF28).fault(), Some(AdcFault::UnexpectedReset));
    }
}
