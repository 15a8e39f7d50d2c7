//! The flash behind the tunnel: the emulator ignores writes to its own, and would forget them. For the protocol see
//! [`ftcal_firmware::tunnel`].

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use ftcal_firmware::storage::layout::{CAPACITY, SECTOR, WORD};
use ftcal_firmware::tunnel::{FLASH_CHUNK, FlashAction, FlashBytes};
use stm32f4xx_hal::pac::FLASH;

use super::carrier::ask_flash;

/// The flash at the other end.
pub(crate) struct Flash {
    number: u8,
}

impl Flash {
    /// (The registers are those of the flash that the emulator does not have.)
    pub(super) const fn new(_registers: FLASH) -> Self {
        Self { number: 0 }
    }

    fn ask(&mut self, action: FlashAction) -> Result<FlashBytes, NorFlashErrorKind> {
        self.number = self.number.wrapping_add(1);
        ask_flash(self.number, action).map_err(|_| NorFlashErrorKind::Other)
    }
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        for (offset, chunk) in (offset..).step_by(FLASH_CHUNK).zip(bytes.chunks_mut(FLASH_CHUNK)) {
            let length = u8::try_from(chunk.len()).map_err(|_| NorFlashErrorKind::Other)?;
            let read = self.ask(FlashAction::Read { offset, length })?;
            if read.len() != chunk.len() {
                return Err(NorFlashErrorKind::Other);
            }
            chunk.copy_from_slice(&read);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        CAPACITY as usize
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = WORD as usize;
    const ERASE_SIZE: usize = SECTOR as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        for offset in (from..to).step_by(SECTOR as usize) {
            self.ask(FlashAction::Erase { offset })?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        for (offset, chunk) in (offset..).step_by(FLASH_CHUNK).zip(bytes.chunks(FLASH_CHUNK)) {
            let bytes = FlashBytes::from_slice(chunk).map_err(|_| NorFlashErrorKind::Other)?;
            self.ask(FlashAction::Write { offset, bytes })?;
        }
        Ok(())
    }
}
