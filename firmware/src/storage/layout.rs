//! Where what is kept lies in the flash.
//!
//! | sector of the STM32F405 | address | here | holds |
//! |---|---|---|---|
//! | 0–7 | 0x0800_0000 | – | the image |
//! | 8, 9 | 0x0808_0000 | 0 and 1 | checkpoints of trials, one trial a sector |
//! | 10, 11 | 0x080C_0000 | 2 and 3 | items: calibrations, settings, name, counters |
//!
//! Whoever hands the flash in maps offset 0 to sector 8.

use embedded_storage::nor_flash::NorFlash;

/// Bytes of a sector: what is erased at once.
pub const SECTOR: u32 = 128 * 1024;

/// Bytes of a word: what is written at once.
pub const WORD: u32 = 4;

/// Bytes of all four sectors.
pub const CAPACITY: u32 = 4 * SECTOR;

/// The first of the two sectors of items.
pub(super) const FIRST_OF_ITEMS: u32 = 2;

/// What a word reads after its sector was erased.
pub(super) const ERASED: u32 = u32::MAX;

/// Compiles only for a flash of these sectors and words.
pub(super) struct Fits<Flash>(core::marker::PhantomData<Flash>);

impl<Flash: NorFlash> Fits<Flash> {
    pub(super) const CHECK: () = assert!(
        Flash::ERASE_SIZE == SECTOR as usize
            && Flash::WRITE_SIZE == WORD as usize
            && Flash::READ_SIZE <= WORD as usize
    );
}
