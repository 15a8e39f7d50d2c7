//! A flash in memory, with the rules of the real one and a power supply that fails at will.

extern crate std;

use std::vec;
use std::vec::Vec;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

use super::layout::{CAPACITY, ERASED, SECTOR, WORD};

/// Instants within an erase at which the power may fail.
pub(super) const ERASE_STAGES: u32 = 12;

/// The flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct MockFlash {
    bytes: Vec<u8>,
    /// Words and stages of erases until the power fails; `None` for never.
    fuel: Option<u32>,
    random: u64,
    /// Words written and erases done since the start.
    pub(super) written: u32,
    pub(super) erased: u32,
}

impl MockFlash {
    /// As it comes from the factory.
    pub(super) fn new() -> Self {
        Self::filled_with(|_| ERASED)
    }

    /// With these words.
    pub(super) fn filled_with(word: impl FnMut(u32) -> u32) -> Self {
        let bytes = (0..CAPACITY / WORD).map(word).flat_map(u32::to_le_bytes).collect();
        Self { bytes, fuel: None, random: 1, written: 0, erased: 0 }
    }

    /// The same, whose power fails after so many words and stages of erases; each seed tears what is under way in a way of its own.
    pub(super) fn failing_after(&self, fuel: u32, seed: u64) -> Self {
        Self { fuel: Some(fuel), random: seed, ..self.clone() }
    }

    /// Whether the power has failed.
    pub(super) fn has_failed(&self) -> bool {
        self.fuel == Some(0)
    }

    /// Power again.
    pub(super) fn restored(self) -> Self {
        Self { fuel: None, ..self }
    }

    /// Wears one word out: it reads as anything.
    pub(super) fn corrupt(&mut self, address: u32, bits: u32) {
        let word = self.word(address as usize);
        self.set_word(address as usize, word ^ bits);
    }

    /// The words that hold something, by address.
    pub(super) fn written_addresses(&self) -> Vec<u32> {
        (0..CAPACITY)
            .step_by(WORD as usize)
            .filter(|&address| self.word(address as usize) != ERASED)
            .collect()
    }

    fn word(&self, address: usize) -> u32 {
        u32::from_le_bytes(*self.bytes[address..].first_chunk().expect("inside of the flash"))
    }

    fn set_word(&mut self, address: usize, word: u32) {
        self.bytes[address..address + WORD as usize].copy_from_slice(&word.to_le_bytes());
    }

    fn random(&mut self) -> u32 {
        // Xorshift.
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 32) as u32
    }

    /// Whether the power holds for one more step.
    fn step(&mut self) -> Result<bool, NorFlashErrorKind> {
        match &mut self.fuel {
            None => Ok(true),
            Some(0) => Err(NorFlashErrorKind::Other),
            Some(fuel) => {
                *fuel -= 1;
                Ok(*fuel > 0)
            }
        }
    }

    /// What an erase leaves that was cut short.
    fn half_erase(&mut self, range: core::ops::Range<usize>, stage: u32) {
        let length = range.len() / WORD as usize;
        for (number, address) in range.step_by(WORD as usize).enumerate() {
            let (random, word) = (self.random(), self.word(address));
            let left = match stage {
                // The first half, the last half, and all is erased.
                1 if number < length / 2 => ERASED,
                2 if number >= length / 2 => ERASED,
                3 => ERASED,
                // Bits rise at random, in few words or in many.
                4 if random.is_multiple_of(64) => word | random.rotate_left(9),
                5 => word | random,
                6 if !random.is_multiple_of(8) => ERASED,
                // All but the ends; nothing but the ends.
                7 if number > 256 && number < length - 256 => ERASED,
                8 if number <= 256 || number >= length - 256 => ERASED,
                // Anything at all.
                9 => random,
                10 if number > 1 => random,
                11 if number % 2 == 0 => ERASED,
                // Nothing shows.
                _ => word,
            };
            self.set_word(address, left);
        }
    }
}

impl ErrorType for MockFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for MockFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        if self.has_failed() {
            return Err(NorFlashErrorKind::Other);
        }
        bytes.copy_from_slice(&self.bytes[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        CAPACITY as usize
    }
}

impl NorFlash for MockFlash {
    const WRITE_SIZE: usize = WORD as usize;
    const ERASE_SIZE: usize = SECTOR as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        for sector in from / SECTOR..to / SECTOR {
            let first = (sector * SECTOR) as usize;
            let range = first..first + SECTOR as usize;
            for stage in 0..ERASE_STAGES {
                if !self.step()? {
                    self.half_erase(range, stage);
                    return Err(NorFlashErrorKind::Other);
                }
            }
            self.bytes[range].fill(0xFF);
            self.erased += 1;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        let (words, rest) = bytes.as_chunks::<{ WORD as usize }>();
        assert!(rest.is_empty());
        for (address, word) in (offset..).step_by(WORD as usize).zip(words) {
            let wanted = u32::from_le_bytes(*word);
            let held = self.step()?;
            let random = self.random();
            let word = self.word(address as usize);
            assert_eq!(wanted & !word, 0, "a bit cannot be set at {address:#x}: {word:#x} to {wanted:#x}");
            // A torn word has some of its bits.
            self.set_word(address as usize, word & if held { wanted } else { wanted | random });
            self.written += 1;
            if !held {
                return Err(NorFlashErrorKind::Other);
            }
        }
        Ok(())
    }
}

#[test]
fn the_mock_keeps_the_rules_of_a_flash() {
    let mut flash = MockFlash::new();
    flash.write(8, &[1, 2, 3, 4]).unwrap();
    let mut bytes = vec![0; 6];
    flash.read(7, &mut bytes).unwrap();
    assert_eq!(bytes, [0xFF, 1, 2, 3, 4, 0xFF]);
    flash.erase(0, SECTOR).unwrap();
    assert_eq!(flash.written_addresses(), []);
    assert!(flash.write(2, &[0; 4]).is_err());
    assert!(flash.erase(4, SECTOR).is_err());

    let mut failing = flash.failing_after(2, 7);
    assert!(failing.write(0, &[0; 12]).is_err());
    assert!(failing.has_failed());
    assert_eq!((failing.word(0), failing.word(8)), (0, ERASED));
    assert!(failing.read(0, &mut [0]).is_err());
}
