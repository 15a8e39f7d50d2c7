//! Driver for the Texas Instruments ADS131M08: eight channels of 24 bits, sampled at the same instant.
//!
//! Section numbers in this module are those of the datasheet, SBAS950B.
//!
//! # How the bus works
//!
//! SPI mode 1, most significant bit first. Every chip-select frame is [`FRAME_WORDS`] words of 24 bits, both ways at
//! once (8.5.1.7):
//!
//! | word | to the converter | from the converter |
//! |---|---|---|
//! | 0 | command | **response to the command of the frame before** |
//! | 1 … 8 | checksum (for a register write: contents, then checksum), then zeros | codes of channels 0 … 7 |
//! | 9 | zeros | checksum of words 0 … 8 |
//!
//! Commands, responses and checksums are 16 bits, at the left end of their word. **A response comes one frame late**,
//! so whatever needs one takes two frames: the command, then a NULL command to fetch the response. In continuous
//! reading every frame sends NULL, whose response is the status register; each frame then carries the status and the
//! codes of one conversion, and the lateness only means that the status tells of the NULL frame before. The driver
//! never leaves another command's response waiting: every public method ends with a NULL frame sent, unless it failed.
//!
//! # What is enforced
//!
//! - *Replies*: a frame whose checksum is wrong is not looked into. A dead line (all zeros, all ones) cannot pass, and
//!   is told apart as [`AdcFault::NotResponding`].
//! - *Commands*: every frame carries its checksum, from the very first, for the converter may still be checking
//!   them since before the processor's reset; checking is switched on with the first register written. The converter
//!   ignores a corrupted command and says so in the next status ([`AdcFault::CommandCorrupted`]) with one exception: a
//!   **register write is carried out even when its checksum is wrong** (8.3.12). Hence the next two.
//! - *Settings*: all are written, then the interface is locked against writes (8.5.1.10.5), then all are read back. The
//!   converter watches its register map from then on (8.3.13).
//! - *State*: in continuous reading the status must be that of a locked converter in the word format set, that was not
//!   reset, received its last command intact and has not seen its registers change; see [`Status`].
//!
//! - *Step*: now and then a frame of continuous reading asks who the converter is; the next frame must say so, in the place of
//!   the status. A converter that answers late, as one does that has lost step with its bus, is found by that alone: all else
//!   that it says was true one conversion ago ([`Ads131m08::read_codes`]).
//!
//! Nothing here loops on the converter's answer: each method sends a fixed number of frames.
//!
//! # The two-deep buffer
//!
//! The converter keeps the last two conversions. As long as each is read before the next arrives, a read returns the
//! newest. After a pause both places are full, and from then on every read would return the conversion *before* the
//! newest, and the data-ready line would not fall as expected (8.5.1.9.1). [`Ads131m08::discard_backlog`] reads
//! both and so restores the pattern; [`Ads131m08::start`] ends with it.
//!
//! [`AdcFault::NotResponding`]: ftcal_shared::fault::AdcFault::NotResponding
//! [`AdcFault::CommandCorrupted`]: ftcal_shared::fault::AdcFault::CommandCorrupted

mod checksum;
mod command;
mod driver;
mod registers;
mod reply;
mod settings;
mod status;

pub use driver::{Ads131m08, Conversion};
pub use settings::{AdcSettings, ChannelMask, Input};
pub use status::{Status, WordLength};

/// Channels of the converter.
pub const CHANNELS: usize = 8;

/// Words in a frame: command or response, one for each channel, checksum.
pub const FRAME_WORDS: usize = CHANNELS + 2;

/// One word on the bus, most significant byte first.
type Word = [u8; 3];

/// All that is sent, or all that is received, while chip-select is low.
type Frame = [Word; FRAME_WORDS];

/// Bytes in a frame.
pub const FRAME_BYTES: usize = 3 * FRAME_WORDS;

/// Puts the right checksum at the end of a frame from the converter whose words were changed, or made up.
pub fn seal(frame: &mut [u8; FRAME_BYTES]) {
    let (covered, sum) = frame.split_at_mut(FRAME_BYTES - 3);
    let (words, _) = covered.as_chunks::<3>();
    sum.copy_from_slice(&to_word(checksum::checksum(words)));
}

/// A 16-bit quantity as it stands in its word: at the left end, then zeros (8.5.1.8).
const fn to_word(value: u16) -> Word {
    let [high, low] = value.to_be_bytes();
    [high, low, 0]
}

/// The 16-bit quantity of a word.
const fn from_word(word: Word) -> u16 {
    let [high, low, _] = word;
    u16::from_be_bytes([high, low])
}
