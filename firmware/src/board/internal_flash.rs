//! The processor's own flash, from sector 8 on: words of 32 bits, sectors of 128 KiB (reference manual RM0090, section 3).
//!
//! | | takes | meanwhile |
//! |---|---|---|
//! | write a word | 16 µs, 100 µs at most | whoever executes from the flash stands still, interrupts included |
//! | erase a sector | 1 s, 2 s at most | the same |
//!
//! Words are written as a whole, which needs a supply of 2.7 V or more; the HAL's own driver, which writes bytes, would take four
//! times as long for a word, and leave more states between. The flash is locked but while it is being written to.
//!
//! What the cache of the flash holds of a sector is out of date after its erase, so it is emptied. A write updates it.

#![expect(unsafe_code, reason = "the flash is memory, and its registers take what their types do not say")]

use core::ptr;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use ftcal_firmware::storage::layout::{CAPACITY, SECTOR, WORD};
use stm32f4xx_hal::pac::FLASH;

/// Where sector 8 begins. The image ends before it: see `memory.x`.
const BASE: usize = 0x0808_0000;
const FIRST_SECTOR: u8 = 8;

/// Two words that unlock the flash, in this order.
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// Every error flag of the status register; a flag is cleared by writing one to it.
const ERRORS: u32 = 0xF2;

/// The sectors after the image.
pub(crate) struct Flash {
    registers: FLASH,
}

impl Flash {
    pub(super) const fn new(registers: FLASH) -> Self {
        Self { registers }
    }

    /// Does something while the flash is unlocked, and tells whether it went well.
    fn unlocked(&mut self, act: impl FnOnce(&FLASH)) -> Result<(), NorFlashErrorKind> {
        let registers = &self.registers;
        self.wait();
        for key in KEYS {
            // SAFETY: any word may be written; the wrong ones keep the flash locked until the next reset.
            registers.keyr().write(|w| unsafe { w.key().bits(key) });
        }
        // SAFETY: these flags are cleared by writing them.
        registers.sr().write(|w| unsafe { w.bits(ERRORS) });
        act(registers);
        self.wait();
        let failed = registers.sr().read().bits() & ERRORS != 0;
        registers.cr().modify(|_, w| w.pg().clear_bit().ser().clear_bit());
        registers.cr().modify(|_, w| w.lock().set_bit());
        if failed { Err(NorFlashErrorKind::Other) } else { Ok(()) }
    }

    fn wait(&self) {
        while self.registers.sr().read().bsy().bit_is_set() {}
    }

    fn empty_cache(&mut self) {
        let acr = self.registers.acr();
        let was_on = acr.read().dcen().bit();
        acr.modify(|_, w| w.dcen().clear_bit());
        acr.modify(|_, w| w.dcrst().set_bit());
        acr.modify(|_, w| w.dcrst().clear_bit());
        acr.modify(|_, w| w.dcen().bit(was_on));
    }
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        for (address, byte) in (BASE + offset as usize..).zip(bytes) {
            // SAFETY: the flash is there, up to its capacity, and reading it has no side effect.
            *byte = unsafe { ptr::read_volatile(ptr::with_exposed_provenance(address)) };
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
        for sector in (FIRST_SECTOR..).take(((to - from) / SECTOR) as usize) {
            #[expect(clippy::cast_possible_truncation, reason = "below four")]
            let sector = sector + (from / SECTOR) as u8;
            self.unlocked(|registers| {
                // SAFETY: the chip has this sector, and the image is not in it.
                registers
                    .cr()
                    .modify(|_, w| unsafe { w.psize().psize32().ser().set_bit().snb().bits(sector) });
                registers.cr().modify(|_, w| w.strt().set_bit());
            })?;
        }
        self.empty_cache();
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        let (words, _) = bytes.as_chunks::<{ WORD as usize }>();
        for (address, word) in (BASE + offset as usize..).step_by(WORD as usize).zip(words) {
            self.unlocked(|registers| {
                registers.cr().modify(|_, w| w.psize().psize32().pg().set_bit());
                // SAFETY: the address is one of the flash's, aligned, and not of the image.
                unsafe {
                    ptr::write_volatile(ptr::with_exposed_provenance_mut(address), u32::from_le_bytes(*word));
                }
            })?;
        }
        Ok(())
    }
}
