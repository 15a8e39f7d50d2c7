//! The beginnings of the two sectors for trials: which trial is in each, and which is the newest.

use embedded_storage::nor_flash::NorFlash;

use crate::storage::layout::{SECTOR, WORD};
use crate::storage::memory::StorageError;
use crate::storage::words::{WordReader, WordWriter, is_blank, read_word, write_word};

/// "ftc3": the format of heads and records is in it, and it is raised with them.
const SEAL: u32 = u32::from_be_bytes(*b"ftc3");
const HEAD: u32 = WORD;
/// Number, gages, checksum.
const HEAD_WORDS: u32 = 3;
/// Where records begin in a sector.
pub(super) const FIRST_RECORD: u32 = 64;

/// The trial that was begun last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Newest {
    /// There was none.
    None,
    /// There was one that had no checkpoints, or whose number cannot be read.
    Lost,
    /// This one.
    Trial { side: u32, number: u32, gages: usize },
}

/// What a sector begins with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Head {
    /// No trial.
    Blank,
    /// A trial that had no checkpoints, or whose number cannot be read.
    Dead,
    /// This trial.
    Trial { number: u32, gages: usize },
}

/// The newest trial of both sectors.
pub(super) fn newest<Flash: NorFlash>(flash: &mut Flash) -> Result<Newest, StorageError> {
    Ok(match [head(flash, 0)?, head(flash, 1)?] {
        [Head::Trial { number, gages }, Head::Blank | Head::Dead] => Newest::Trial { side: 0, number, gages },
        [Head::Trial { number, gages }, Head::Trial { number: other, .. }] if is_newer(number, other) => {
            Newest::Trial { side: 0, number, gages }
        }
        [_, Head::Trial { number, gages }] => Newest::Trial { side: 1, number, gages },
        [Head::Blank, Head::Blank] => Newest::None,
        [Head::Blank | Head::Dead, Head::Blank | Head::Dead] => Newest::Lost,
    })
}

/// Begins a new trial: its sector and its number; `None` where the sector would have to be erased first, and may not.
pub(super) fn begin<Flash: NorFlash>(
    flash: &mut Flash,
    gages: usize,
    may_erase: bool,
) -> Result<Option<(u32, u32)>, StorageError> {
    let (side, number) = match newest(flash)? {
        Newest::None | Newest::Lost => (0, 1),
        Newest::Trial { side, number, .. } => (1 - side, number.wrapping_add(1)),
    };
    if !prepare(flash, side, may_erase)? {
        return Ok(None);
    }
    let mut words = WordWriter::new(flash, side * SECTOR + HEAD);
    words.put(number);
    words.put(u32::try_from(gages).unwrap_or_default());
    words.finish()?;
    Ok(Some((side, number)))
}

/// Has the trials that there are resumed no more. Nothing is to be done about a flash that fails; it fails on the next start, too.
pub(super) fn bury<Flash: NorFlash>(flash: &mut Flash) {
    for side in 0..2 {
        if matches!(head(flash, side), Ok(Head::Trial { .. })) {
            for word in 0..HEAD_WORDS {
                let _ = write_word(flash, side * SECTOR + HEAD + word * WORD, 0);
            }
        }
    }
}

const fn is_newer(one: u32, other: u32) -> bool {
    one.wrapping_sub(other).cast_signed() > 0
}

fn head<Flash: NorFlash>(flash: &mut Flash, side: u32) -> Result<Head, StorageError> {
    let start = side * SECTOR;
    if read_word(flash, start)? != SEAL || is_blank(flash, start + HEAD, start + HEAD + HEAD_WORDS * WORD)? {
        return Ok(Head::Blank);
    }
    let mut words = WordReader::new(flash, start + HEAD);
    let (Some(number), Some(gages)) = (words.next_word(), words.next_word()) else {
        return Err(StorageError::Flash);
    };
    let expected = words.checksum();
    let is_whole = words.next_word() == Some(expected);
    Ok(if is_whole { Head::Trial { number, gages: gages as usize } } else { Head::Dead })
}

/// Makes sure that a sector is erased and sealed; whether it is.
fn prepare<Flash: NorFlash>(flash: &mut Flash, side: u32, may_erase: bool) -> Result<bool, StorageError> {
    let start = side * SECTOR;
    let is_sealed = read_word(flash, start)? == SEAL;
    if is_sealed && is_blank(flash, start + HEAD, start + HEAD + HEAD_WORDS * WORD)? {
        return Ok(true);
    }
    if may_erase {
        write_word(flash, start, 0)?;
        flash.erase(start, start + SECTOR).map_err(|_| StorageError::Flash)?;
        write_word(flash, start, SEAL)?;
    }
    Ok(may_erase)
}
