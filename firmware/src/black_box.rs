//! The black box: a failure of the firmware, kept in memory that a reset does not clear.
//!
//! What stands there after power came is chance, so that a record has a checksum: whatever does not match it is none.

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use ftcal_shared::wire::Failure;

/// Bytes of a record: the failure in postcard, padded with zeros, and its checksum.
pub const RECORD_BYTES: usize = 64;

const CHECKSUM_BYTES: usize = 4;

const CHECK: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// A record.
pub type Record = [u8; RECORD_BYTES];

/// The record of this failure.
pub fn seal(failure: &Failure) -> Record {
    let mut record = [0; RECORD_BYTES];
    let (contents, checksum) = record.split_at_mut(RECORD_BYTES - CHECKSUM_BYTES);
    // Every failure fits: the longest is a panic, a file name and a line.
    if postcard::to_slice(failure, contents).is_ok() {
        checksum.copy_from_slice(&CHECK.checksum(contents).to_le_bytes());
    }
    record
}

/// The failure of a record, if it is one.
pub fn open(record: &Record) -> Option<Failure> {
    let (contents, checksum) = record.split_last_chunk::<CHECKSUM_BYTES>()?;
    let matches = CHECK.checksum(contents) == u32::from_le_bytes(*checksum);
    let (failure, padding) = postcard::take_from_bytes(contents).ok()?;
    (matches && padding.iter().all(|&byte| byte == 0)).then_some(failure)
}

#[cfg(test)]
mod tests {
    use ftcal_shared::wire::{Failure, MAX_FILE_NAME};

    use super::{RECORD_BYTES, open, seal};

    fn failures() -> [Failure; 6] {
        [
            Failure::panic("firmware/src/trial.rs", 17),
            Failure::panic(&"long/".repeat(100), u32::MAX),
            Failure::panic(&"ü".repeat(100), 0),
            Failure::ProcessorFault { at: 0x0800_1234 },
            Failure::StackOverflow,
            Failure::UnservedInterrupt { number: -5 },
        ]
    }

    #[test]
    fn a_failure_survives_and_keeps_the_end_of_its_file_name() {
        for failure in failures() {
            assert_eq!(open(&seal(&failure)), Some(failure.clone()));
            if let Failure::Panic { file, .. } = failure {
                assert!(!file.is_empty() && file.len() <= MAX_FILE_NAME);
            }
        }
    }

    #[test]
    fn memory_that_is_chance_is_no_failure() {
        assert_eq!(open(&[0; RECORD_BYTES]), None);
        assert_eq!(open(&[0xff; RECORD_BYTES]), None);
        for failure in failures() {
            let record = seal(&failure);
            for bit in 0..8 * RECORD_BYTES {
                let mut flipped = record;
                flipped[bit / 8] ^= 1 << (bit % 8);
                assert_eq!(open(&flipped), None, "bit {bit} of {failure:?}");
            }
        }
    }
}
