//! As much of a converter as the driver asks for: registers that are read back, and replies that are ready when they are fetched.

use core::cell::RefCell;
use core::convert::Infallible;

use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use ftcal_firmware::adc::{CHANNELS, FRAME_BYTES, seal};
use ftcal_shared::units::AdcCode;

/// Bytes of one frame.
type Frame = [u8; FRAME_BYTES];

/// Locked, words of 24 bits, every channel's conversion is new.
const STATUS: u16 = 0x81FF;
const ID: u16 = 0x2800;
const RESET_RESPONSE: u16 = 0xFF28;
const RESET: u16 = 0x0011;

/// The converter, behind its bus.
pub(crate) struct Converter {
    registers: [u16; 64],
    /// What the last command is answered with.
    response: u16,
    sent: Frame,
    reply: Frame,
    /// The reply is there already: a transfer only fetches it.
    is_ready: bool,
}

impl Converter {
    pub(crate) const fn new() -> Self {
        let mut registers = [0; 64];
        registers[0] = ID;
        let blank = [0; FRAME_BYTES];
        Self { registers, response: STATUS, sent: blank, reply: blank, is_ready: false }
    }

    /// Converts: the next transfer fetches these codes, and costs no more than to copy them.
    pub(crate) fn convert(&mut self, codes: &[AdcCode; CHANNELS]) {
        self.carry_out();
        for (word, code) in self.reply.chunks_exact_mut(3).skip(1).zip(codes) {
            let [_, high, middle, low] = code.counts().to_be_bytes();
            word.copy_from_slice(&[high, middle, low]);
        }
        self.seal();
        self.is_ready = true;
    }

    /// Carries out the command that was sent last, and makes the reply that the next frame fetches.
    fn carry_out(&mut self) {
        let [high, low, _, written_high, written_low, ..] = self.sent;
        let command = u16::from_be_bytes([high, low]);
        let register = usize::from(command >> 7 & 0x3f);
        self.response = match command >> 13 {
            0b101 => self.registers[register],
            0b011 => {
                self.registers[register] = u16::from_be_bytes([written_high, written_low]);
                0b010 << 13 | command & 0x1fff
            }
            _ if command == RESET => RESET_RESPONSE,
            _ if command == 0 => STATUS,
            _ => command,
        };
        self.seal();
    }

    fn seal(&mut self) {
        let [high, low] = self.response.to_be_bytes();
        self.reply[..3].copy_from_slice(&[high, low, 0]);
        seal(&mut self.reply);
    }
}

/// The bus; the converter's owner keeps the other end.
pub(crate) struct Bus<'a>(pub(crate) &'a RefCell<Converter>);

impl ErrorType for Bus<'_> {
    type Error = Infallible;
}

impl SpiDevice for Bus<'_> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let mut converter = self.0.borrow_mut();
        for operation in operations {
            if let Operation::Transfer(read, write) = operation {
                if !core::mem::take(&mut converter.is_ready) {
                    converter.carry_out();
                }
                read.copy_from_slice(&converter.reply);
                converter.sent.copy_from_slice(write);
            }
        }
        Ok(())
    }
}
