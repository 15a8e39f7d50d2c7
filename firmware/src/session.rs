//! The conversation with the host: bytes in, messages out; and the greeting, which needs nothing else of the sensor.

use ftcal_shared::wire::frame::Decoder;
use ftcal_shared::wire::{Hello, PRODUCT, PROTOCOL_VERSION, ToDevice};

/// The receiving end of the link.
#[derive(Debug, Default)]
pub struct Session {
    decoder: Decoder,
    broken_frames: u32,
}

impl Session {
    /// A session that has received nothing.
    pub const fn new() -> Self {
        Self { decoder: Decoder::new(), broken_frames: 0 }
    }

    /// Takes one byte from the host. A greeting is to be answered with [`hello`], at once and whatever state the sensor is
    /// in; a request with a response of the same number. A broken frame is counted and otherwise ignored: the host repeats what is not
    /// answered.
    pub fn on_byte(&mut self, byte: u8) -> Option<ToDevice> {
        let message = self.decoder.push(byte)?.ok();
        if message.is_none() {
            self.broken_frames = self.broken_frames.wrapping_add(1);
        }
        message
    }

    /// Frames from the host that were broken.
    pub const fn broken_frames(&self) -> u32 {
        self.broken_frames
    }
}

/// The greeting of this firmware.
pub const fn hello() -> Hello {
    Hello {
        product: PRODUCT,
        protocol_version: PROTOCOL_VERSION,
        firmware_version: [
            version_part(env!("CARGO_PKG_VERSION_MAJOR")),
            version_part(env!("CARGO_PKG_VERSION_MINOR")),
            version_part(env!("CARGO_PKG_VERSION_PATCH")),
        ],
    }
}

/// Reads a decimal number at compile time.
const fn version_part(text: &str) -> u8 {
    let digits = text.as_bytes();
    let mut value = 0;
    let mut position = 0;
    while position < digits.len() {
        value = value * 10 + (digits[position] - b'0');
        position += 1;
    }
    value
}
