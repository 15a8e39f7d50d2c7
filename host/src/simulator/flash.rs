//! The flash of a simulated board: in memory, or in a file that outlives the board.
//!
//! It keeps the rules of the real one: what is written is words, of which bits can only be cleared; what is erased is whole
//! sectors. A file gets each word by itself, and an erase in pieces that come in no order, so that whoever is killed in the
//! middle leaves what a real chip would leave. The same goes for [`SimulatedFlash::cut_power`], which lets a word be torn: it has
//! some of its bits.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use ftcal_firmware::storage::layout::{CAPACITY, SECTOR, WORD};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use thiserror::Error;

use super::{Purpose, random_sequence};

/// Bytes that are erased at once.
const PIECE: usize = 4096;

/// What an erased byte reads.
const ERASED: u8 = 0xFF;

/// Why a file is no flash.
#[derive(Debug, Error)]
pub enum FlashFileError {
    /// It cannot be opened, read or made.
    #[error("the flash's file cannot be used")]
    Unusable(#[from] io::Error),
    /// It has another size.
    #[error("the flash's file has {found} bytes instead of {CAPACITY}: it is something else")]
    WrongSize {
        /// Bytes of the file.
        found: u64,
    },
}

/// A flash; clones are the same one.
#[derive(Clone, Debug)]
pub struct SimulatedFlash {
    content: Arc<Mutex<Content>>,
    powered: Arc<AtomicBool>,
    pace: FlashPace,
}

/// How long writing and erasing take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FlashPace {
    /// No time.
    #[default]
    AtOnce,
    /// Long enough for something to happen meanwhile: a tenth of a millisecond a word, some twenty milliseconds a sector.
    Slow,
}

#[derive(Debug)]
struct Content {
    bytes: Vec<u8>,
    file: Option<File>,
    random: ChaCha8Rng,
}

impl Default for SimulatedFlash {
    fn default() -> Self {
        Self::new(vec![ERASED; CAPACITY as usize], None)
    }
}

impl SimulatedFlash {
    fn new(bytes: Vec<u8>, file: Option<File>) -> Self {
        let content = Content { bytes, file, random: random_sequence(1, Purpose::Faults) };
        Self {
            content: Arc::new(Mutex::new(content)),
            powered: Arc::new(AtomicBool::new(true)),
            pace: FlashPace::AtOnce,
        }
    }

    /// The flash in this file, which is made, erased all over, where there is none.
    ///
    /// # Errors
    ///
    /// [`FlashFileError`].
    pub fn in_file(path: &Path) -> Result<Self, FlashFileError> {
        let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        let mut bytes = vec![ERASED; CAPACITY as usize];
        match file.metadata()?.len() {
            0 => file.write_all(&bytes)?,
            found if found == u64::from(CAPACITY) => file.read_exact(&mut bytes)?,
            found => return Err(FlashFileError::WrongSize { found }),
        }
        Ok(Self::new(bytes, Some(file)))
    }

    /// The same flash at another pace.
    #[must_use]
    pub fn at_pace(self, pace: FlashPace) -> Self {
        Self { pace, ..self }
    }

    /// Cuts the power: what is under way stays half done.
    pub fn cut_power(&self) {
        self.powered.store(false, Ordering::Relaxed);
    }

    fn content(&self) -> MutexGuard<'_, Content> {
        self.content.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the power is on.
    pub(super) fn is_powered(&self) -> bool {
        self.powered.load(Ordering::Relaxed)
    }

    fn let_pass(&self, micros: u64) {
        if self.pace == FlashPace::Slow {
            thread::sleep(Duration::from_micros(micros));
        }
    }
}

impl Content {
    /// Has these bytes from now on, in the file, too.
    fn set(&mut self, offset: usize, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let place = self.bytes.get_mut(offset..offset + bytes.len()).ok_or(NorFlashErrorKind::OutOfBounds)?;
        place.copy_from_slice(bytes);
        let Some(file) = &mut self.file else { return Ok(()) };
        let written = file.seek(SeekFrom::Start(offset as u64)).and_then(|_| file.write_all(bytes));
        written.map_err(|_| NorFlashErrorKind::Other)
    }

    /// A word at `offset` with the zeros of `word`, or of a torn one with some of them.
    fn write_word(
        &mut self,
        offset: usize,
        word: [u8; WORD as usize],
        torn: bool,
    ) -> Result<(), NorFlashErrorKind> {
        let survivors: [u8; WORD as usize] = if torn { self.random.random() } else { [0; WORD as usize] };
        let mut written = word;
        for (index, byte) in written.iter_mut().enumerate() {
            let before = self.bytes.get(offset + index).copied().ok_or(NorFlashErrorKind::OutOfBounds)?;
            *byte = before & (*byte | survivors[index]);
        }
        self.set(offset, &written)
    }
}

impl ErrorType for SimulatedFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for SimulatedFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        if !self.is_powered() {
            return Err(NorFlashErrorKind::Other);
        }
        let content = self.content();
        let held = content.bytes.get(offset as usize..).and_then(|held| held.get(..bytes.len()));
        bytes.copy_from_slice(held.ok_or(NorFlashErrorKind::OutOfBounds)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        CAPACITY as usize
    }
}

impl NorFlash for SimulatedFlash {
    const WRITE_SIZE: usize = WORD as usize;
    const ERASE_SIZE: usize = SECTOR as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        let mut pieces: Vec<usize> = (from as usize..to as usize).step_by(PIECE).collect();
        while !pieces.is_empty() {
            if !self.is_powered() {
                return Err(NorFlashErrorKind::Other);
            }
            let mut content = self.content();
            let next = content.random.random_range(..pieces.len());
            content.set(pieces.swap_remove(next), &[ERASED; PIECE])?;
            drop(content);
            self.let_pass(500);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        let (words, _) = bytes.as_chunks::<{ WORD as usize }>();
        for (offset, word) in (offset as usize..).step_by(WORD as usize).zip(words) {
            let powered = self.is_powered();
            self.content().write_word(offset, *word, !powered)?;
            if !powered {
                return Err(NorFlashErrorKind::Other);
            }
            self.let_pass(50);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};
    use ftcal_firmware::storage::layout::{CAPACITY, SECTOR};

    use super::{FlashFileError, SimulatedFlash};

    fn read(flash: &mut SimulatedFlash, offset: u32) -> [u8; 4] {
        let mut word = [0; 4];
        flash.read(offset, &mut word).expect("inside");
        word
    }

    #[test]
    fn bits_are_cleared_by_writing_and_set_by_erasing_a_sector() {
        let mut flash = SimulatedFlash::default();
        flash.write(SECTOR, &[0xF0; 4]).expect("inside");
        flash.write(SECTOR, &[0x3C; 4]).expect("inside");
        assert_eq!(read(&mut flash, SECTOR), [0x30; 4]);
        flash.erase(0, SECTOR).expect("a sector");
        assert_eq!(read(&mut flash, SECTOR), [0x30; 4]);
        flash.erase(SECTOR, 2 * SECTOR).expect("a sector");
        assert_eq!(read(&mut flash, SECTOR), [0xFF; 4]);
        assert!(flash.erase(1, SECTOR).is_err() && flash.write(2, &[0; 4]).is_err());
        assert!(flash.write(CAPACITY, &[0; 4]).is_err());
    }

    #[test]
    fn a_file_holds_what_was_written_and_nothing_that_came_after_the_power_was_cut() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("flash");
        let mut flash = SimulatedFlash::in_file(&path).expect("made");
        flash.write(0, &[1, 2, 3, 4]).expect("inside");
        flash.cut_power();
        assert!(flash.write(4, &[0; 8]).is_err());
        assert!(flash.erase(0, SECTOR).is_err());
        let mut flash = SimulatedFlash::in_file(&path).expect("there");
        assert_eq!(read(&mut flash, 0), [1, 2, 3, 4]);
        assert_eq!(read(&mut flash, 8), [0xFF; 4]);
        std::fs::write(&path, "something else").expect("a folder of our own");
        assert!(matches!(SimulatedFlash::in_file(&path), Err(FlashFileError::WrongSize { found: 14 })));
    }
}
