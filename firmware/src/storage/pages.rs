//! Two sectors as two pages that survive a power cut while they are erased.
//!
//! An erase that is cut short leaves a sector in no state at all: any word may read as before, erased, or as anything
//! between. Whoever looked at such a sector afterwards could take what is left of it for items, and worse: for the only good
//! copy of items. So each sector begins with a head of [`HEAD`] bytes, which the pages do not show:
//!
//! ```text
//! seal │ seal │ begun │ done │ begun │ done │ …                       │ page
//!                └──── erases of the *other* sector, in their order
//! ```
//!
//! | step of an erase of sector X | where |
//! |---|---|
//! | 1. "begun" | head of the other sector |
//! | 2. both seals to zero: from now on nothing in X is believed | head of X |
//! | 3. the erase | X |
//! | 4. the seals | head of X |
//! | 5. "done" | head of the other sector |
//!
//! An erase that was begun and not done is begun again by [`Pages::recover`], before anything in the sector is looked at. A
//! word that was torn counts as written: the step after it had not begun yet, and each step may be done twice. It is written once more
//! before anybody relies on it, for a word that was torn need not read the same for ever. A sector is
//! sealed by either of its two seals, so that one bad word does not cost what it holds; and it is never erased but
//! on the word of the other one's head.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind};

use super::layout::{ERASED, FIRST_OF_ITEMS, Fits, SECTOR, WORD};

/// Bytes of a sector's head.
const HEAD: u32 = 512;

/// Bytes of a page.
pub(super) const PAGE: u32 = SECTOR - HEAD;

/// "ftc1": the head's format is in it.
const SEAL: u32 = u32::from_be_bytes(*b"ftc1");
const SEALS: [u32; 2] = [0, WORD];

/// Bytes of one erase in the journal.
const ENTRY: u32 = 2 * WORD;
const JOURNAL: u32 = 2 * WORD;

/// Erases of the other sector before this one is erased itself: one in normal life, one more for each power cut while items
/// move from one sector to the other.
const ENTRIES: u32 = (HEAD - JOURNAL) / ENTRY;

/// The page's own mark of an erase that has begun, or is done.
const MARK: u32 = 0;

/// One of the two sectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    First,
    Second,
}

impl Side {
    const BOTH: [Self; 2] = [Self::First, Self::Second];

    const fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
        }
    }

    const fn start(self) -> u32 {
        match self {
            Self::First => FIRST_OF_ITEMS * SECTOR,
            Self::Second => (FIRST_OF_ITEMS + 1) * SECTOR,
        }
    }

    const fn of_page(address: u32) -> Option<Self> {
        match address / PAGE {
            0 => Some(Self::First),
            1 => Some(Self::Second),
            _ => None,
        }
    }
}

/// Why a page cannot be read, written or erased.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PagesError {
    /// The flash reports an error.
    Flash,
    /// There is no such address.
    OutOfBounds,
    /// The sector was erased too often while the other one was not.
    JournalFull,
}

impl NorFlashError for PagesError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::Flash | Self::JournalFull => NorFlashErrorKind::Other,
        }
    }
}

/// Both pages, one after the other from address 0 on.
pub(super) struct Pages<'a, Flash> {
    flash: &'a mut Flash,
}

impl<'a, Flash: NorFlash> Pages<'a, Flash> {
    pub(super) const fn new(flash: &'a mut Flash) -> Self {
        let () = Fits::<Flash>::CHECK;
        Self { flash }
    }

    /// Ends what a power cut has interrupted, and makes pages of sectors that never were. To be called before anything is read.
    pub(super) fn recover(&mut self) -> Result<(), PagesError> {
        for side in Side::BOTH {
            if self.is_sealed(side.other())?
                && let Some(entry) = self.unfinished(side)?
            {
                return self.finish_erasing(side, entry);
            }
        }
        let sealed = (self.is_sealed(Side::First)?, self.is_sealed(Side::Second)?);
        if sealed == (false, false) {
            self.flash.erase(Side::First.start(), Side::First.start() + SECTOR).map_err(flash_error)?;
            self.seal(Side::First)?;
        }
        // The first sector is made first, and its journal then tells of the second.
        let second_was_made = sealed.1 || (sealed.0 && self.free_entry(Side::Second)? != Some(JOURNAL));
        if second_was_made { Ok(()) } else { self.erase_side(Side::Second) }
    }

    fn erase_side(&mut self, side: Side) -> Result<(), PagesError> {
        let entry = self.free_entry(side)?.ok_or(PagesError::JournalFull)?;
        self.write_word(side.other().start() + entry, MARK)?;
        self.finish_erasing(side, entry)
    }

    fn finish_erasing(&mut self, side: Side, entry: u32) -> Result<(), PagesError> {
        for seal in SEALS {
            self.write_word(side.start() + seal, MARK)?;
        }
        self.flash.erase(side.start(), side.start() + SECTOR).map_err(flash_error)?;
        self.seal(side)?;
        self.write_word(side.other().start() + entry + WORD, MARK)
    }

    fn seal(&mut self, side: Side) -> Result<(), PagesError> {
        for seal in SEALS {
            self.write_word(side.start() + seal, SEAL)?;
        }
        Ok(())
    }

    fn is_sealed(&mut self, side: Side) -> Result<bool, PagesError> {
        for seal in SEALS {
            if self.read_word(side.start() + seal)? == SEAL {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Where the journal tells of an erase of this side that has begun and is not done.
    fn unfinished(&mut self, side: Side) -> Result<Option<u32>, PagesError> {
        for entry in entries() {
            if !self.is_marked(side.other().start() + entry)? {
                return Ok(None);
            }
            if !self.is_marked(side.other().start() + entry + WORD)? {
                return Ok(Some(entry));
            }
        }
        Ok(None)
    }

    /// Whether this word of the journal was written; one that was torn is, from now on, for good.
    fn is_marked(&mut self, address: u32) -> Result<bool, PagesError> {
        let word = self.read_word(address)?;
        if word != ERASED && word != MARK {
            self.write_word(address, MARK)?;
        }
        Ok(word != ERASED)
    }

    /// Where the journal has room for an erase of this side.
    fn free_entry(&mut self, side: Side) -> Result<Option<u32>, PagesError> {
        for entry in entries() {
            if self.read_word(side.other().start() + entry)? == ERASED {
                return Ok(Some(entry));
            }
        }
        Ok(None)
    }

    fn read_word(&mut self, address: u32) -> Result<u32, PagesError> {
        let mut bytes = [0; WORD as usize];
        self.flash.read(address, &mut bytes).map_err(flash_error)?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn write_word(&mut self, address: u32, word: u32) -> Result<(), PagesError> {
        self.flash.write(address, &word.to_le_bytes()).map_err(flash_error)
    }
}

fn entries() -> impl Iterator<Item = u32> {
    (0..ENTRIES).map(|entry| JOURNAL + entry * ENTRY)
}

/// Where in the flash something on a page is, given its address there. It must not reach beyond the page's end.
fn place(address: u32, length: usize) -> Result<u32, PagesError> {
    let side = Side::of_page(address).ok_or(PagesError::OutOfBounds)?;
    let offset = address % PAGE;
    let fits = u32::try_from(length).is_ok_and(|length| length <= PAGE - offset);
    if fits { Ok(side.start() + HEAD + offset) } else { Err(PagesError::OutOfBounds) }
}

fn flash_error<Error>(_: Error) -> PagesError {
    PagesError::Flash
}

impl<Flash> ErrorType for Pages<'_, Flash> {
    type Error = PagesError;
}

/// Every future is ready at once: the flash under it blocks.
impl<Flash: NorFlash> embedded_storage_async::nor_flash::ReadNorFlash for Pages<'_, Flash> {
    const READ_SIZE: usize = Flash::READ_SIZE;

    async fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), PagesError> {
        let place = place(address, bytes.len())?;
        self.flash.read(place, bytes).map_err(flash_error)
    }

    fn capacity(&self) -> usize {
        2 * PAGE as usize
    }
}

impl<Flash: NorFlash> embedded_storage_async::nor_flash::NorFlash for Pages<'_, Flash> {
    const WRITE_SIZE: usize = Flash::WRITE_SIZE;
    const ERASE_SIZE: usize = PAGE as usize;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), PagesError> {
        for address in (from..to).step_by(PAGE as usize) {
            self.erase_side(Side::of_page(address).ok_or(PagesError::OutOfBounds)?)?;
        }
        Ok(())
    }

    async fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), PagesError> {
        let place = place(address, bytes.len())?;
        self.flash.write(place, bytes).map_err(flash_error)
    }
}
