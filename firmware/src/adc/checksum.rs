//! The checksum of both directions (datasheet 8.3.12): CCITT, x¹⁶ + x¹² + x⁵ + 1, starting from all ones, neither
//! reflected nor inverted, over whole words with their padding.
//!
//! Any burst of errors no longer than 16 bits is found, any two wrong bits of a frame, and any odd number of them.

use crc::{CRC_16_IBM_3740, Crc};

use super::Word;

/// With a table of 256 entries: one look-up for each of the 27 bytes of a frame.
static CCITT: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_3740);

/// The checksum of these words.
pub(super) const fn checksum(words: &[Word]) -> u16 {
    CCITT.checksum(words.as_flattened())
}

#[cfg(test)]
mod tests {
    use super::checksum;

    /// The definition, bit by bit.
    fn long_division(bytes: &[u8]) -> u16 {
        let mut remainder = 0xFFFF_u16;
        for byte in bytes {
            remainder ^= u16::from(*byte) << 8;
            for _ in 0..8 {
                let carry = remainder & 0x8000 != 0;
                remainder <<= 1;
                if carry {
                    remainder ^= 0x1021;
                }
            }
        }
        remainder
    }

    #[test]
    fn agrees_with_the_definition() {
        let mut words = [[0; 3]; 9];
        let mut state = 1_u32;
        for _ in 0..1000 {
            for byte in words.as_flattened_mut() {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *byte = state.to_be_bytes()[0];
            }
            assert_eq!(checksum(&words), long_division(words.as_flattened()));
        }
    }

    /// A frame of the four-channel ADS131M04 as its user saw it on the wire, status 8100h and all codes zero, checksum
    /// B42Dh (TI E2E forum, thread 1011774): padding is covered, the checksum's own word is not.
    #[test]
    fn agrees_with_a_frame_seen_on_the_wire() {
        let words = [[0x81, 0, 0], [0; 3], [0; 3], [0; 3], [0; 3]];
        assert_eq!(checksum(&words), 0xB42D);
    }
}
