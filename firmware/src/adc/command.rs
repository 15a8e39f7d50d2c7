//! What is sent to the converter (datasheet 8.5.1.10), and what it answers one frame later.

use super::checksum::checksum;
use super::registers::Register;
use super::{FRAME_WORDS, Frame, to_word};

/// A command. The converter's standby and wake-up commands are left out: the sensor always converts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Command {
    /// Do nothing; the response is the status register.
    Null,
    /// Set all registers to their reset values. Carried out only if the frame is whole.
    Reset,
    /// Take no commands but [`Command::Null`], [`Command::Unlock`] and [`Command::Read`].
    Lock,
    /// Take all commands again.
    Unlock,
    /// Read one register; the response is its contents.
    Read(Register),
    /// Write one register. Carried out even if the checksum is wrong.
    Write(Register, u16),
}

/// The frame of continuous reading, ready made.
pub(super) const NULL_FRAME: Frame = Command::Null.frame();

/// The same, asking who the converter is.
pub(super) const ASKING_FRAME: Frame = Command::Read(Register::Id).frame();

/// The response to a reset carried out by an ADS131M08; its lower byte is the upper byte of the ID register.
pub(super) const RESET_RESPONSE: u16 = 0xFF28;

impl Command {
    /// The command's own word.
    const fn word(self) -> u16 {
        match self {
            Self::Null => 0x0000,
            Self::Reset => 0x0011,
            Self::Lock => 0x0555,
            Self::Unlock => 0x0655,
            Self::Read(register) => 0b101 << 13 | one_register_at(register),
            Self::Write(register, _) => 0b011 << 13 | one_register_at(register),
        }
    }

    /// The frame that carries the command and its checksum.
    pub(super) const fn frame(self) -> Frame {
        let mut frame = [[0; 3]; FRAME_WORDS];
        frame[0] = to_word(self.word());
        if let Self::Write(_, contents) = self {
            frame[1] = to_word(contents);
            frame[2] = to_word(checksum(&[frame[0], frame[1]]));
        } else {
            frame[1] = to_word(checksum(&[frame[0]]));
        }
        frame
    }

    /// The response that says the command was carried out, or `None` where the response is data.
    pub(super) const fn acknowledgement(self) -> Option<u16> {
        match self {
            Self::Null | Self::Read(_) => None,
            Self::Reset => Some(RESET_RESPONSE),
            Self::Lock | Self::Unlock => Some(self.word()),
            Self::Write(register, _) => Some(0b010 << 13 | one_register_at(register)),
        }
    }
}

/// Address in bits 12 to 7; bits 6 to 0, the number of registers less one, are zero.
const fn one_register_at(register: Register) -> u16 {
    (register.address() as u16) << 7
}

#[cfg(test)]
mod tests {
    use super::{Command, NULL_FRAME};
    use crate::adc::registers::Register;

    /// The words of the datasheet's own examples and table 8-11.
    #[test]
    fn words_are_those_of_the_datasheet() {
        assert_eq!(Command::Reset.frame()[0], [0x00, 0x11, 0]);
        assert_eq!(Command::Lock.frame()[0], [0x05, 0x55, 0]);
        assert_eq!(Command::Unlock.frame()[0], [0x06, 0x55, 0]);
        assert_eq!(Command::Read(Register::Id).frame()[0], [0b1010_0000, 0, 0]);
        assert_eq!(Command::Read(Register::Mode).frame()[0], [0b1010_0001, 0, 0]);
        assert_eq!(Command::Read(Register::Clock).frame()[0], [0b1010_0001, 0b1000_0000, 0]);
        assert_eq!(Command::Write(Register::Clock, 0xFF0E).frame()[..2], [[0x61, 0x80, 0], [0xFF, 0x0E, 0]]);
    }

    #[test]
    fn a_write_is_acknowledged_by_its_address() {
        assert_eq!(Command::Write(Register::Clock, 0).acknowledgement(), Some(0b0100_0001_1000_0000));
    }

    /// A checksum register that starts at all ones and is fed three zero bytes holds CC9Ch.
    #[test]
    fn the_null_frame_carries_its_checksum_and_nothing_else() {
        assert_eq!(NULL_FRAME[..2], [[0, 0, 0], [0xCC, 0x9C, 0]]);
        assert!(NULL_FRAME[2..].iter().all(|word| *word == [0; 3]));
    }
}
