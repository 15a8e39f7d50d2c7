//! Words, commands and frames on the SPI bus (datasheet sections 8.5.1.7 to 8.5.1.10).
//!
//! One frame lasts as long as chip select is low. It is a sequence of 24-bit words, most significant byte first; a word
//! of 16 bits of content fills the two upper bytes and leaves the lowest zero.
//!
//! ```text
//! from the host:  command │ (register values of a write) │ checksum, if enabled │ zeros …
//! from the part:  response to the previous frame │ channel 0 … channel 7 │ checksum │ zeros …
//!            or:  acknowledgement │ register values │ checksum │ zeros …           after a read of several registers
//! ```
//!
//! A checksum covers every byte that precedes it in its own frame, padding included.

use ftcal_shared::units::AdcCode;

use super::CHANNELS;
use super::checksum::Polynomial;

/// Bytes in a word.
pub(super) const WORD_BYTES: usize = 3;

/// Words of a frame that carries conversion data: response, channels, checksum.
pub(super) const DATA_FRAME_WORDS: usize = CHANNELS + 2;

/// The command word of a reset; also the response to one that came in too short a frame.
pub(super) const RESET: u16 = 0x0011;
/// The command word that stops conversions, and its acknowledgement.
pub(super) const STANDBY: u16 = 0x0022;
/// The command word that starts conversions again, and its acknowledgement.
pub(super) const WAKEUP: u16 = 0x0033;
/// The command word that locks the interface, and its acknowledgement.
pub(super) const LOCK: u16 = 0x0555;
/// The command word that unlocks the interface, and its acknowledgement.
pub(super) const UNLOCK: u16 = 0x0655;

/// What the host asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Command {
    /// Nothing, or something that is no command: the part treats both alike.
    Null,
    /// Registers to their reset values.
    Reset,
    /// Conversions stop.
    Standby,
    /// Conversions go on.
    Wakeup,
    /// From here on only null, read and unlock are heard.
    Lock,
    /// Everything is heard again.
    Unlock,
    /// Read consecutive registers.
    Read(RegisterRange),
    /// Write consecutive registers with the words that follow.
    Write(RegisterRange),
}

/// Consecutive registers, as the command words of reads and writes name them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RegisterRange {
    /// Address of the first, 6 bits.
    pub(super) first: u8,
    /// How many after the first, 7 bits.
    pub(super) more: u8,
}

impl RegisterRange {
    /// The range in the lower 13 bits of a command word: `a aaaa annn nnnn`.
    const fn decode(word: u16) -> Self {
        let [high, low] = word.to_be_bytes();
        Self { first: ((high & 0x1F) << 1) | (low >> 7), more: low & 0x7F }
    }

    /// The lower 13 bits that [`RegisterRange::decode`] reads.
    fn encode(self) -> u16 {
        (u16::from(self.first) << 7) | u16::from(self.more)
    }

    /// How many registers the range names.
    pub(super) fn count(self) -> usize {
        usize::from(self.more) + 1
    }

    /// The addresses, those beyond the register map included.
    pub(super) fn addresses(self) -> impl Iterator<Item = u8> {
        self.first..=self.first + self.more
    }

    /// The acknowledgement of a read: `111a aaaa annn nnnn`.
    pub(super) fn read_acknowledgement(self) -> u16 {
        0xE000 | self.encode()
    }

    /// The acknowledgement of a write that changed this many registers: `010a aaaa ammm mmmm`; none for none.
    pub(super) fn write_acknowledgement(self, written: u8) -> Option<u16> {
        let more = written.checked_sub(1)?;
        Some(0x4000 | Self { more, ..self }.encode())
    }
}

impl Command {
    /// The command of a command word.
    pub(super) const fn decode(word: u16) -> Self {
        match word {
            RESET => Self::Reset,
            STANDBY => Self::Standby,
            WAKEUP => Self::Wakeup,
            LOCK => Self::Lock,
            UNLOCK => Self::Unlock,
            _ => match word >> 13 {
                0b101 => Self::Read(RegisterRange::decode(word)),
                0b011 => Self::Write(RegisterRange::decode(word)),
                _ => Self::Null,
            },
        }
    }

    /// Whether a locked interface hears it.
    pub(super) const fn passes_lock(self) -> bool {
        matches!(self, Self::Null | Self::Unlock | Self::Read(_))
    }

    /// The words that belong to the command itself: the checksum comes after them.
    fn words(self) -> usize {
        match self {
            Self::Write(range) => 1 + range.count(),
            _ => 1,
        }
    }

    /// Whether the frame that carries this command carries its correct checksum, too.
    pub(super) fn checksum_matches(self, from_host: &[u8], polynomial: Polynomial) -> bool {
        let Some((covered, rest)) = from_host.split_at_checked(self.words() * WORD_BYTES) else {
            return false;
        };
        contents(rest).next() == Some(polynomial.checksum(covered))
    }
}

/// The 16 bits of content of every complete word.
pub(super) fn contents(bytes: &[u8]) -> impl Iterator<Item = u16> {
    bytes.as_chunks::<WORD_BYTES>().0.iter().map(|&[high, low, _]| u16::from_be_bytes([high, low]))
}

/// A frame on its way to the host.
#[derive(Debug, Default)]
pub(super) struct Reply {
    bytes: Vec<u8>,
}

impl Reply {
    /// Appends a word of 16 bits of content.
    pub(super) fn push_word(&mut self, content: u16) {
        let [high, low] = content.to_be_bytes();
        self.bytes.extend([high, low, 0]);
    }

    /// Appends a conversion result.
    pub(super) fn push_code(&mut self, code: AdcCode) {
        self.bytes.extend(code.to_be_bytes());
    }

    /// Appends the checksum and shifts the frame out, as much of it as the host clocks, and zeros after its end.
    pub(super) fn shift_out(mut self, polynomial: Polynomial, to_host: &mut [u8]) {
        self.push_word(polynomial.checksum(&self.bytes));
        let bytes = self.bytes.into_iter().chain(std::iter::repeat(0));
        for (to, from) in to_host.iter_mut().zip(bytes) {
            *to = from;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Command, LOCK, RESET, RegisterRange, Reply, STANDBY, UNLOCK, WAKEUP, contents};
    use crate::simulator::ads131m08::checksum::Polynomial;

    #[test]
    fn every_word_decodes_and_only_the_listed_ones_act() {
        let mut plain = 0;
        for word in 0..=u16::MAX {
            match Command::decode(word) {
                Command::Null => {}
                Command::Read(range) => assert_eq!(range.read_acknowledgement(), word | 0xE000),
                Command::Write(range) => {
                    assert_eq!(range.write_acknowledgement(range.more + 1), Some(0x4000 | (word & 0x1FFF)));
                }
                _ => plain += 1,
            }
        }
        assert_eq!(plain, [RESET, STANDBY, WAKEUP, LOCK, UNLOCK].len());
    }

    #[test]
    fn the_largest_range_does_not_wrap() {
        let range = RegisterRange { first: 0x3F, more: 0x7F };
        assert_eq!(range.addresses().count(), 128);
    }

    #[test]
    fn the_checksum_follows_the_values_of_a_write() {
        let polynomial = Polynomial::Ccitt;
        for count in 1..=4_u16 {
            let mut frame = Reply::default();
            let word = 0x6000 | (0x04 << 7) | (count - 1);
            frame.push_word(word);
            for value in 0..count {
                frame.push_word(value);
            }
            let mut bytes = [0; 30];
            frame.shift_out(polynomial, &mut bytes);
            assert!(Command::decode(word).checksum_matches(&bytes, polynomial));
            assert!(!Command::decode(word).checksum_matches(&bytes, Polynomial::Ansi));
            let without_checksum = bytes.get(..3 + 3 * usize::from(count)).unwrap_or(&[]);
            assert!(!Command::decode(word).checksum_matches(without_checksum, polynomial));
        }
    }

    #[test]
    fn half_a_word_is_no_word() {
        assert_eq!(contents(&[0x05, 0x55]).next(), None);
        assert_eq!(contents(&[0x05, 0x55, 0, 0x06, 0x55]).collect::<Vec<_>>(), [0x0555]);
    }
}
