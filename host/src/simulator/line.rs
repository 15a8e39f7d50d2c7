//! The simulated board's serial line towards the host: a buffer, and a rate at which bytes leave it.

use std::collections::VecDeque;

use ftcal_firmware::baud::DEFAULT_BAUD;
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::ToHost;
use ftcal_shared::wire::frame::encode;

/// Bits on the line for each byte: a start bit, eight of data, a stop bit.
const BITS_PER_BYTE: u64 = 10;

/// The serial line towards the host: bytes leave the buffer at the line's speed.
pub(super) struct Line {
    baud: u32,
    /// The rate to change to when all that waits has left.
    next_baud: Option<u32>,
    waiting: VecDeque<u8>,
    carried: Vec<u8>,
    carried_until: DeviceTime,
    /// What the line could have carried beyond whole bytes, in bit times of a million microseconds.
    remainder: u64,
}

impl Line {
    /// An empty line at the usual rate.
    pub(super) const fn new() -> Self {
        Self {
            baud: DEFAULT_BAUD,
            next_baud: None,
            waiting: VecDeque::new(),
            carried: Vec::new(),
            carried_until: DeviceTime::from_micros(0),
            remainder: 0,
        }
    }

    /// Puts a message into the buffer.
    pub(super) fn send(&mut self, message: &ToHost) {
        // Every message of the protocol fits into a frame, which the golden bytes of the largest ones attest.
        if let Ok(bytes) = encode(message) {
            self.waiting.extend(bytes);
        }
    }

    /// Carries what it can until this time.
    pub(super) fn carry_until(&mut self, now: DeviceTime) {
        let micros = now.as_micros().saturating_sub(self.carried_until.as_micros());
        self.carried_until = now;
        // Microseconds times bits a second: a byte takes ten million of these.
        let per_byte = BITS_PER_BYTE * 1_000_000;
        let capacity = micros * u64::from(self.baud) + self.remainder;
        let bytes = usize::try_from(capacity / per_byte).unwrap_or(usize::MAX).min(self.waiting.len());
        self.remainder = if self.waiting.len() > bytes { capacity % per_byte } else { 0 };
        self.carried.extend(self.waiting.drain(..bytes));
        if self.waiting.is_empty() && self.carried.is_empty() {
            self.baud = self.next_baud.take().unwrap_or(self.baud);
        }
    }

    /// Bytes in the buffer.
    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Appends what the line has carried.
    pub(super) fn take_carried(&mut self, carried: &mut Vec<u8>) {
        carried.append(&mut self.carried);
    }

    /// The rate.
    pub(super) const fn baud(&self) -> u32 {
        self.baud
    }

    /// Changes the rate when the buffer is empty.
    pub(super) const fn change_rate(&mut self, baud: u32) {
        self.next_baud = Some(baud);
    }

    /// Whether the rate has yet to change.
    pub(super) const fn is_changing_rate(&self) -> bool {
        self.next_baud.is_some()
    }
}
