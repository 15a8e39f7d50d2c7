//! Framing: checksum, byte stuffing, and finding one's place again.

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// The longest payload: a calibration upload of twelve gages and six axes takes 400 bytes.
pub const MAX_PAYLOAD: usize = 512;

/// Bytes of the checksum.
const CHECKSUM: usize = 4;

/// The longest frame on the line: payload and checksum, one byte of stuffing per 254 and one more, and the final zero.
pub const MAX_FRAME: usize = MAX_PAYLOAD + CHECKSUM + (MAX_PAYLOAD + CHECKSUM) / 254 + 2;

/// The byte that ends a frame and occurs nowhere else.
pub const END_OF_FRAME: u8 = 0;

/// CRC-32/ISO-HDLC: any burst up to 32 bits and any three flipped bits in a frame of this length are found, anything
/// else passes with a probability of 2⁻³².
pub(super) const CHECK: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// Why bytes do not make a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FrameError {
    /// More bytes than any frame has, without an end.
    TooLong,
    /// The byte stuffing is broken.
    Stuffing,
    /// Too short to hold a checksum.
    TooShort,
    /// The checksum is wrong.
    Checksum,
    /// The checksum is right, but the payload is no message of this protocol version.
    Message,
}

/// A frame on its way out.
pub type FrameBytes = heapless::Vec<u8, MAX_FRAME>;

/// Frames one message.
///
/// # Errors
///
/// [`FrameError::TooLong`] where the message exceeds [`MAX_PAYLOAD`].
#[inline(never)]
pub fn encode<Message: Serialize>(message: &Message) -> Result<FrameBytes, FrameError> {
    let mut plain = [0_u8; MAX_PAYLOAD + CHECKSUM];
    let (room, _) = plain.split_at_mut(MAX_PAYLOAD);
    let payload = postcard::to_slice(message, room).map_err(|_| FrameError::TooLong)?.len();
    let checksum = CHECK.checksum(&plain[..payload]).to_le_bytes();
    plain[payload..payload + CHECKSUM].copy_from_slice(&checksum);

    let mut frame = FrameBytes::new();
    frame.resize_default(MAX_FRAME).map_err(|_| FrameError::TooLong)?;
    let stuffed =
        cobs::try_encode(&plain[..payload + CHECKSUM], &mut frame).map_err(|_| FrameError::TooLong)?;
    frame.truncate(stuffed);
    frame.push(END_OF_FRAME).map_err(|_| FrameError::TooLong)?;
    Ok(frame)
}

/// Puts bytes together into frames, and frames into messages; after garbage it starts afresh at the next end of frame.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    bytes: heapless::Vec<u8, MAX_FRAME>,
    /// A frame that grew too long is skipped to its end.
    skipping: bool,
}

impl Decoder {
    /// A decoder at the start of a frame.
    pub const fn new() -> Self {
        Self { bytes: heapless::Vec::new(), skipping: false }
    }

    /// Takes one byte. Answers `None` inside of a frame, and at its end the message or what is wrong with it.
    /// An empty frame (a lone end of frame, sent to flush a line) is nothing.
    pub fn push<Message: DeserializeOwned>(&mut self, byte: u8) -> Option<Result<Message, FrameError>> {
        if byte != END_OF_FRAME {
            if !self.skipping && self.bytes.push(byte).is_err() {
                self.skipping = true;
            }
            return None;
        }
        let result = if self.skipping {
            Some(Err(FrameError::TooLong))
        } else if self.bytes.is_empty() {
            None
        } else {
            Some(decode(&mut self.bytes))
        };
        self.bytes.clear();
        self.skipping = false;
        result
    }
}

/// Decodes one frame in place, without its final zero.
fn decode<Message: DeserializeOwned>(stuffed: &mut [u8]) -> Result<Message, FrameError> {
    let length = cobs::decode_in_place(stuffed).map_err(|_| FrameError::Stuffing)?;
    let plain = stuffed.get(..length).ok_or(FrameError::Stuffing)?;
    let (payload, checksum) = plain.split_last_chunk::<CHECKSUM>().ok_or(FrameError::TooShort)?;
    if CHECK.checksum(payload) != u32::from_le_bytes(*checksum) {
        return Err(FrameError::Checksum);
    }
    match postcard::take_from_bytes(payload) {
        Ok((message, [])) => Ok(message),
        Ok(_) | Err(_) => Err(FrameError::Message),
    }
}
