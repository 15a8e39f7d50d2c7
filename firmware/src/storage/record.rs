//! How one item is kept: in a format whose number is kept with it, under a checksum of its own.
//!
//! ```text
//! format │ payload: the item in postcard │ CRC-32 over key, format and payload
//! ```
//!
//! The map that keeps the records has checksums, too; this one says that what was found is whole *and* is what was put there.

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// The longest record: a calibration of twelve gages and six axes takes 400 bytes.
pub(super) const LONGEST: usize = 440;

/// Bytes of the checksum.
const CHECKSUM: usize = 4;

const CHECK: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// Under which a record is kept. A number once used is never used for anything else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Key {
    /// Which calibration is current, in two copies.
    Roster = 1,
    RosterCopy = 2,
    /// The calibrations.
    CalibrationA = 3,
    CalibrationB = 4,
    CalibrationC = 5,
    /// Converter settings.
    Settings = 6,
    /// The name that the user gave.
    Name = 7,
    /// Boots and stores.
    Counters = 8,
    /// Limits and tare.
    Health = 9,
    /// Peaks of the load.
    Peaks = 10,
}

/// Keys that there are.
pub(super) const KEYS: usize = 10;

/// Why there is no item.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missing {
    /// It was never stored.
    Nothing,
    /// What is there is not what was stored.
    Corrupt,
    /// It was stored by other firmware, in a format that this one does not read.
    OtherFormat(u8),
}

/// Puts a record together in `room`; its length. `None` where the item is too long.
pub(super) fn encode(key: Key, format: u8, item: &impl Serialize, room: &mut [u8; LONGEST]) -> Option<usize> {
    let (head, rest) = room.split_first_mut()?;
    *head = format;
    let payload = rest.get_mut(..LONGEST - 1 - CHECKSUM)?;
    let length = postcard::to_slice(item, payload).ok()?.len();
    let (covered, free) = room.split_at_mut_checked(1 + length)?;
    free.get_mut(..CHECKSUM)?.copy_from_slice(&checksum(key, covered).to_le_bytes());
    Some(1 + length + CHECKSUM)
}

/// Takes a record apart.
pub(super) fn decode<Item: DeserializeOwned>(key: Key, format: u8, record: &[u8]) -> Result<Item, Missing> {
    let (covered, stored) = record.split_last_chunk::<CHECKSUM>().ok_or(Missing::Corrupt)?;
    if checksum(key, covered) != u32::from_le_bytes(*stored) {
        return Err(Missing::Corrupt);
    }
    let (&found, payload) = covered.split_first().ok_or(Missing::Corrupt)?;
    if found != format {
        return Err(Missing::OtherFormat(found));
    }
    match postcard::take_from_bytes(payload) {
        Ok((item, [])) => Ok(item),
        Ok(_) | Err(_) => Err(Missing::Corrupt),
    }
}

fn checksum(key: Key, covered: &[u8]) -> u32 {
    let mut digest = CHECK.digest();
    digest.update(&[key as u8]);
    digest.update(covered);
    digest.finalize()
}

#[cfg(test)]
mod tests {
    use super::{Key, LONGEST, Missing, decode, encode};

    #[test]
    fn a_record_is_found_whole_or_said_to_be_corrupt() {
        let mut room = [0; LONGEST];
        let length = encode(Key::Settings, 3, &(7_u32, 9_u8), &mut room).unwrap();
        let record = &room[..length];
        assert_eq!(decode(Key::Settings, 3, record), Ok((7_u32, 9_u8)));
        assert_eq!(decode::<(u32, u8)>(Key::Name, 3, record), Err(Missing::Corrupt));
        assert_eq!(decode::<(u32, u8)>(Key::Settings, 4, record), Err(Missing::OtherFormat(3)));
        for position in 0..length {
            let mut flipped = room;
            flipped[position] ^= 1;
            assert_eq!(decode::<(u32, u8)>(Key::Settings, 3, &flipped[..length]), Err(Missing::Corrupt));
            assert_eq!(decode::<(u32, u8)>(Key::Settings, 3, &room[..position]), Err(Missing::Corrupt));
        }
    }

    #[test]
    fn what_does_not_fit_is_not_kept() {
        assert_eq!(encode(Key::Name, 1, &[[0_u8; 20]; LONGEST / 20], &mut [0; LONGEST]), None);
    }
}
