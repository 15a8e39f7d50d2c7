//! The checksum of both directions (datasheet 8.3.12): CCITT, x¹⁶ + x¹² + x⁵ + 1, starting from all ones, neither
//! reflected nor inverted, over whole words with their padding.
//!
//! Any burst of errors no longer than 16 bits is found, any two wrong bits of a frame, and any odd number of them.

use crc::{CRC_16_XMODEM, Crc, NoTable};

use super::Word;

/// What the checksum starts from.
const START: u32 = 0xFFFF;

/// What each value of the last byte of four leaves in the checksum, of the third, of the second and of the first, so that the checksum so far
/// is taken to the bytes once in four of them: less than half the instructions, and four tables instead of one.
///
/// Like the checksum while it is made, they are in the byte order of the line: its first byte is the less significant one.
static LAST: [u16; 256] = left_by::<1>();
static THIRD: [u16; 256] = left_by::<2>();
static SECOND: [u16; 256] = left_by::<3>();
static FIRST: [u16; 256] = left_by::<4>();

/// What each byte leaves at the head of a message of this length whose other bytes are zero. The checksum is linear, so that what all bytes
/// of a message leave is the sum of what each leaves, modulo two.
const fn left_by<const LENGTH: usize>() -> [u16; 256] {
    // The same polynomial, starting from zero.
    let polynomial = Crc::<u16, NoTable>::new(&CRC_16_XMODEM);
    let mut left = [0; 256];
    let mut message = [0; LENGTH];
    let mut place = 0;
    while place < left.len() {
        left[place] = polynomial.checksum(&message).swap_bytes();
        message[0] = message[0].wrapping_add(1);
        place += 1;
    }
    left
}

/// The checksum of these words.
pub(super) const fn checksum(words: &[Word]) -> u16 {
    let (mut sum, mut left) = (START, words);
    while let [[a, b, c], [d, e, f], [g, h, i], [j, k, l], rest @ ..] = left {
        sum = after_four(sum, [*a, *b, *c, *d]);
        sum = after_four(sum, [*e, *f, *g, *h]);
        sum = after_four(sum, [*i, *j, *k, *l]);
        left = rest;
    }
    while let [[a, b, c], rest @ ..] = left {
        let [a, b] = met(sum, [*a, *b]);
        sum = (SECOND[a] ^ THIRD[b] ^ LAST[*c as usize]) as u32;
        left = rest;
    }
    let [first, second, ..] = sum.to_le_bytes();
    u16::from_be_bytes([first, second])
}

/// The checksum with four more bytes.
#[expect(clippy::inline_always, reason = "a few instructions: to call it would cost as much again")]
#[inline(always)]
const fn after_four(sum: u32, bytes: [u8; 4]) -> u32 {
    let [a, b, c, d] = bytes;
    let [a, b] = met(sum, [a, b]);
    (FIRST[a] ^ SECOND[b] ^ THIRD[c as usize] ^ LAST[d as usize]) as u32
}

/// The next two bytes, where what there is of the checksum stands before them.
#[expect(clippy::inline_always, reason = "a few instructions: to call it would cost as much again")]
#[inline(always)]
const fn met(sum: u32, bytes: [u8; 2]) -> [usize; 2] {
    let [first, second, ..] = (u16::from_le_bytes(bytes) as u32 ^ sum).to_le_bytes();
    [first as usize, second as usize]
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
        let mut words = [[0; 3]; 13];
        let mut state = 1_u32;
        for round in 0..1000 {
            for byte in words.as_flattened_mut() {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *byte = state.to_be_bytes()[0];
            }
            let words = &words[..round % 14];
            assert_eq!(checksum(words), long_division(words.as_flattened()), "{} words", words.len());
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
