//! What comes back from the converter: a frame is opened here or not at all.

use ftcal_shared::fault::AdcFault;

use super::checksum::checksum;
use super::{CHANNELS, Frame, Word, from_word};

/// A frame from the converter whose checksum is right. It stays where it was received: to move a frame about costs more than to
/// check it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Reply<'a> {
    /// Response to the command of the frame before.
    pub(super) response: u16,
    /// The codes of all channels, in the converter's byte order.
    pub(super) channels: &'a [Word; CHANNELS],
}

impl<'a> Reply<'a> {
    /// Checks the frame's checksum.
    ///
    /// A frame of equal bytes is told apart from a corrupted one, because the remedy differs: it is what the processor
    /// reads from a converter that is missing or without power, the line being pulled one way or the other.
    pub(super) fn open(frame: &'a Frame) -> Result<Self, AdcFault> {
        let [covered @ .., sum] = frame;
        if checksum(covered) == from_word(*sum) {
            let [response, channels @ ..] = covered;
            Ok(Self { response: from_word(*response), channels })
        } else if frame.iter().all(|word| *word == [0x00; 3]) || frame.iter().all(|word| *word == [0xFF; 3]) {
            Err(AdcFault::NotResponding)
        } else {
            Err(AdcFault::ReplyCorrupted)
        }
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::fault::AdcFault;

    use super::Reply;
    use crate::adc::checksum::checksum;
    use crate::adc::{FRAME_WORDS, Frame, to_word};

    fn whole() -> Frame {
        let mut frame = [[0x12, 0x34, 0x56]; FRAME_WORDS];
        frame[0] = to_word(0x85FF);
        frame[9] = to_word(checksum(&frame[..9]));
        frame
    }

    #[test]
    fn a_whole_frame_opens() {
        assert_eq!(Reply::open(&whole()), Ok(Reply { response: 0x85FF, channels: &[[0x12, 0x34, 0x56]; 8] }));
    }

    /// The last byte is padding behind the checksum: it carries nothing, so it is not looked at.
    #[test]
    fn any_wrong_bit_is_found() {
        for bit in 0..8 * 29 {
            let mut frame = whole();
            frame.as_flattened_mut()[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Reply::open(&frame), Err(AdcFault::ReplyCorrupted), "bit {bit}");
        }
    }

    #[test]
    fn a_dead_line_is_nobody() {
        for level in [0x00, 0xFF] {
            assert_eq!(Reply::open(&[[level; 3]; FRAME_WORDS]), Err(AdcFault::NotResponding));
        }
    }
}
