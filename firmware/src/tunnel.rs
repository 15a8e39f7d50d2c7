//! The tunnel: a converter's SPI bus and data-ready line, a flash, a button and a light, carried over a serial line.
//!
//! The emulator has no converter, so the emulated image takes its bus through a second serial line to a converter model
//! on the host. What travels are whole chip-select frames, one question and one answer each, and the data-ready signal:
//!
//! | from | message | meaning |
//! |---|---|---|
//! | board | [`FromBoard::Transfer`] | while chip-select is low, these bytes go to the converter |
//! | converter | [`FromConverter::Transferred`] | these came back; `number` is that of the question |
//! | converter | [`FromConverter::DataReady`] | the data-ready line fell, at this time of the converter's clock |
//! | board | [`FromBoard::Handled`] | the board has caught up: what it makes of the last data-ready is on the host link's queue |
//! | board | [`FromBoard::Flash`] | read, write or erase the flash, which the emulator has only for the image |
//! | host | [`FromConverter::Flash`] | what was read; or that it is written or erased |
//! | host | [`FromConverter::Button`] | the button was pressed, or released |
//! | board | [`FromBoard::Light`] | the light went on, or off |
//!
//! Each message is framed as on the host link (`wire::frame`: postcard, CRC-32, byte stuffing), so a disturbed line loses
//! messages but never alters one.
//!
//! # What may be lost
//!
//! - A question or its answer: the board waits [`ANSWER_MICROS`] and reports a bus error. An answer that comes later than that
//!   bears another number than the next question, and is dropped.
//! - A question to the flash or its answer: the board asks again, [`FLASH_ATTEMPTS`] times. Writing or erasing twice does no harm.
//! - A data-ready or the word that it was handled: the converter goes on by itself after [`UNHANDLED_MICROS`].
//! - Button and light: the other end has them as they were until they change again.
//!
//! # Pace
//!
//! The host end converts no faster than the converter's data rate, and goes on to the next conversion only once the last
//! announcement was handled or [`UNHANDLED_MICROS`] have passed. A slow machine therefore slows the converter's clock instead of
//! losing conversions; the time in [`FromConverter::DataReady`] is that clock, and it is the sample's time.

use embedded_hal::spi::Operation;
use ftcal_shared::units::DeviceTime;
use serde::{Deserialize, Serialize};

/// The most bytes in one chip-select frame; the converter's own frames have 30.
pub const MAX_TRANSFER: usize = 64;

/// How long the board waits for the answer to a transfer: milliseconds on a machine that has nothing else to do.
pub const ANSWER_MICROS: u64 = 400_000;

/// How often the board asks the flash one question before that counts as an error of the flash: half a minute, for the flash of a board
/// answers always, and a machine that stands still for a while is no reason to find a memory unreadable. (What is read at the start is
/// asked for three times over: without anybody at the other end, that takes minutes.)
pub const FLASH_ATTEMPTS: u32 = 75;

/// The most bytes of the flash in one message.
pub const FLASH_CHUNK: usize = 240;

/// How long the converter waits for its announcement to be handled, before it goes on without.
pub const UNHANDLED_MICROS: u64 = 500_000;

/// The bytes of one chip-select frame, in one direction.
pub type TransferBytes = heapless::Vec<u8, MAX_TRANSFER>;

/// One chip-select frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transfer {
    /// Running number, by which an answer finds its question.
    pub number: u8,
    /// What goes to the converter, or what came back from it: as many bytes in either direction.
    pub bytes: TransferBytes,
}

/// Bytes of the flash.
pub type FlashBytes = heapless::Vec<u8, FLASH_CHUNK>;

/// What is to be done with the flash.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FlashAction {
    /// Tell these bytes, at most [`FLASH_CHUNK`].
    Read {
        /// Where they begin.
        offset: u32,
        /// How many they are.
        length: u8,
    },
    /// Write these words.
    Write {
        /// Where they begin.
        offset: u32,
        /// The words.
        bytes: FlashBytes,
    },
    /// Erase the sector that begins here.
    Erase {
        /// Where it begins.
        offset: u32,
    },
}

/// What the board asks of the flash.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FlashQuestion {
    /// Running number, by which an answer finds its question.
    pub number: u8,
    /// What is to be done.
    pub action: FlashAction,
}

/// What the flash answers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FlashAnswer {
    /// That of the question.
    pub number: u8,
    /// What was read, nothing where it was to be written or erased; `None` where that is not possible.
    pub bytes: Option<FlashBytes>,
}

/// What the board's end sends.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FromBoard {
    /// What goes to the converter.
    Transfer(Transfer),
    /// The last announcement was handled: the converter may go on.
    Handled,
    /// What is asked of the flash.
    Flash(FlashQuestion),
    /// The light is like this from now on; dark at the start.
    Light {
        /// Whether it is on.
        is_lit: bool,
    },
}

/// What the converter's end sends.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FromConverter {
    /// The answer to the transfer of the same number.
    Transferred(Transfer),
    /// A conversion is complete.
    DataReady(DeviceTime),
    /// The answer to the question of the same number.
    Flash(FlashAnswer),
    /// The button is like this from now on; released at the start.
    Button {
        /// Whether it is pressed.
        is_pressed: bool,
    },
}

/// What an SPI transaction sends, all its operations in a row; zeros during reads. `None` where it exceeds [`MAX_TRANSFER`].
pub fn gather(operations: &[Operation<'_, u8>]) -> Option<TransferBytes> {
    let mut bytes = TransferBytes::new();
    for operation in operations {
        let end = bytes.len() + clocked_bytes(operation);
        match operation {
            Operation::Write(sent) | Operation::Transfer(_, sent) => bytes.extend_from_slice(sent).ok()?,
            Operation::TransferInPlace(sent) => bytes.extend_from_slice(sent).ok()?,
            Operation::Read(_) | Operation::DelayNs(_) => {}
        }
        bytes.resize(end, 0).ok()?;
    }
    Some(bytes)
}

/// Hands what came back to the operations that it belongs to.
pub fn scatter(received: &[u8], operations: &mut [Operation<'_, u8>]) {
    let mut rest = received;
    for operation in operations {
        let (now, later) = rest.split_at_checked(clocked_bytes(operation)).unwrap_or((rest, &[]));
        if let Operation::Read(bytes) | Operation::Transfer(bytes, _) | Operation::TransferInPlace(bytes) =
            operation
        {
            for (byte, &value) in bytes.iter_mut().zip(now) {
                *byte = value;
            }
        }
        rest = later;
    }
}

fn clocked_bytes(operation: &Operation<'_, u8>) -> usize {
    match operation {
        Operation::Read(bytes) | Operation::TransferInPlace(bytes) => bytes.len(),
        Operation::Write(bytes) => bytes.len(),
        Operation::Transfer(received, sent) => received.len().max(sent.len()),
        Operation::DelayNs(_) => 0,
    }
}

#[cfg(test)]
mod tests {
    use embedded_hal::spi::Operation;
    use ftcal_shared::units::DeviceTime;
    use ftcal_shared::wire::frame::{Decoder, encode};

    use serde::Serialize;
    use serde::de::DeserializeOwned;

    use super::{
        FLASH_CHUNK, FlashAction, FlashAnswer, FlashBytes, FlashQuestion, FromBoard, FromConverter,
        MAX_TRANSFER, Transfer, TransferBytes, gather, scatter,
    };

    #[test]
    fn every_message_arrives_as_it_was_sent() {
        let transfer = Transfer { number: 255, bytes: TransferBytes::from_array([0; MAX_TRANSFER]) };
        let from_converter = [
            FromConverter::Transferred(transfer.clone()),
            FromConverter::Transferred(Transfer { number: 0, bytes: TransferBytes::new() }),
            FromConverter::DataReady(DeviceTime::from_micros(u64::MAX)),
            FromConverter::Button { is_pressed: true },
        ];
        for message in from_converter {
            assert_eq!(carried(&message), message);
        }
        let bytes = FlashBytes::from_array([0; FLASH_CHUNK]);
        let answer = FlashAnswer { number: 1, bytes: Some(bytes.clone()) };
        assert_eq!(carried(&FromConverter::Flash(answer.clone())), FromConverter::Flash(answer));
        let action = FlashAction::Write { offset: u32::MAX, bytes };
        let question = FromBoard::Flash(FlashQuestion { number: 2, action });
        let light = FromBoard::Light { is_lit: true };
        for message in [FromBoard::Transfer(transfer), FromBoard::Handled, question, light] {
            assert_eq!(carried(&message), message);
        }
    }

    /// What arrives of a message.
    fn carried<Message: Serialize + DeserializeOwned>(message: &Message) -> Message {
        let frame = encode(message).unwrap();
        let mut decoder = Decoder::new();
        frame.iter().find_map(|&byte| decoder.push(byte)).unwrap().unwrap()
    }

    #[test]
    fn operations_are_sent_in_a_row_with_zeros_during_reads() {
        let (mut read, mut long, mut in_place) = ([0xEE; 2], [0xEE; 3], [5, 6]);
        let mut operations = [
            Operation::Write(&[1, 2]),
            Operation::Read(&mut read),
            Operation::DelayNs(1000),
            Operation::Transfer(&mut long, &[4]),
            Operation::TransferInPlace(&mut in_place),
        ];
        assert_eq!(gather(&operations).unwrap(), [1, 2, 0, 0, 4, 0, 0, 5, 6]);
        scatter(&[10, 11, 12, 13, 14, 15, 16, 17, 18], &mut operations);
        assert_eq!((read, long, in_place), ([12, 13], [14, 15, 16], [17, 18]));
    }

    #[test]
    fn a_longer_transaction_than_the_tunnel_carries_is_refused() {
        let mut bytes = [0; MAX_TRANSFER + 1];
        assert_eq!(gather(&[Operation::Read(&mut bytes)]), None);
        assert_eq!(gather(&[Operation::Write(&[0; MAX_TRANSFER]), Operation::Write(&[0])]), None);
    }
}
