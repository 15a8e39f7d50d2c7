//! Words in a row, in the flash: written and read in small pieces, with a checksum behind them.

use crc::{CRC_32_ISO_HDLC, Crc, Digest, Table};
use embedded_storage::nor_flash::NorFlash;

use super::layout::{ERASED, WORD};
use super::memory::StorageError;

/// Bytes that go to the flash, or come from it, at once.
const PIECE: usize = 64;

static CHECK: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// Writes words in a row.
pub(super) struct WordWriter<'flash, Flash> {
    flash: &'flash mut Flash,
    address: u32,
    piece: heapless::Vec<u8, PIECE>,
    digest: Digest<'static, u32, Table<1>>,
    failed: bool,
}

impl<'flash, Flash: NorFlash> WordWriter<'flash, Flash> {
    pub(super) fn new(flash: &'flash mut Flash, address: u32) -> Self {
        Self { flash, address, piece: heapless::Vec::new(), digest: CHECK.digest(), failed: false }
    }

    /// Writes the next word; whether that went well, [`WordWriter::finish`] tells.
    pub(super) fn put(&mut self, word: u32) {
        let bytes = word.to_le_bytes();
        self.digest.update(&bytes);
        self.put_bytes(&bytes);
    }

    /// Writes the checksum of all words.
    pub(super) fn finish(mut self) -> Result<(), StorageError> {
        let checksum = self.digest.clone().finalize();
        self.put_bytes(&checksum.to_le_bytes());
        self.flush();
        if self.failed { Err(StorageError::Flash) } else { Ok(()) }
    }

    fn put_bytes(&mut self, bytes: &[u8]) {
        self.failed |= self.piece.extend_from_slice(bytes).is_err();
        if self.piece.is_full() {
            self.flush();
        }
    }

    fn flush(&mut self) {
        if !self.failed && !self.piece.is_empty() {
            self.failed = self.flash.write(self.address, &self.piece).is_err();
        }
        self.address += u32::try_from(self.piece.len()).unwrap_or_default();
        self.piece.clear();
    }
}

/// Reads words in a row.
pub(super) struct WordReader<'flash, Flash> {
    flash: &'flash mut Flash,
    address: u32,
    piece: [u8; PIECE],
    /// What of the piece was given out.
    taken: usize,
    digest: Digest<'static, u32, Table<1>>,
}

impl<'flash, Flash: NorFlash> WordReader<'flash, Flash> {
    pub(super) fn new(flash: &'flash mut Flash, address: u32) -> Self {
        Self { flash, address, piece: [0; PIECE], taken: PIECE, digest: CHECK.digest() }
    }

    /// The next word; `None` where the flash fails, or ends.
    pub(super) fn next_word(&mut self) -> Option<u32> {
        if self.taken == PIECE {
            let left = self.flash.capacity().checked_sub(self.address as usize)?;
            self.flash.read(self.address, self.piece.get_mut(..PIECE.min(left))?).ok()?;
            self.address += u32::try_from(PIECE).ok()?;
            self.taken = 0;
        }
        let bytes = self.piece.get(self.taken..)?.first_chunk::<{ WORD as usize }>()?;
        self.taken += WORD as usize;
        self.digest.update(bytes);
        Some(u32::from_le_bytes(*bytes))
    }

    /// The checksum of the words so far.
    pub(super) fn checksum(&self) -> u32 {
        self.digest.clone().finalize()
    }
}

/// Reads one word.
pub(super) fn read_word<Flash: NorFlash>(flash: &mut Flash, address: u32) -> Result<u32, StorageError> {
    let mut bytes = [0; WORD as usize];
    flash.read(address, &mut bytes).map_err(|_| StorageError::Flash)?;
    Ok(u32::from_le_bytes(bytes))
}

/// Writes one word.
pub(super) fn write_word<Flash: NorFlash>(
    flash: &mut Flash,
    address: u32,
    word: u32,
) -> Result<(), StorageError> {
    flash.write(address, &word.to_le_bytes()).map_err(|_| StorageError::Flash)
}

/// Whether all words from one address to another are erased.
pub(super) fn is_blank<Flash: NorFlash>(flash: &mut Flash, from: u32, to: u32) -> Result<bool, StorageError> {
    for address in (from..to).step_by(WORD as usize) {
        if read_word(flash, address)? != ERASED {
            return Ok(false);
        }
    }
    Ok(true)
}
