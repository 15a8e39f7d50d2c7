//! One raw conversion result.

use serde::{Deserialize, Serialize};

/// The raw conversion result of one gage channel: a signed 24-bit integer, in counts.
///
/// The two ends of the range double as the converter's overload indication: a converter whose input leaves its range
/// holds the end of the range, so a code there says "at least this much" and is never a measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(transparent)]
pub struct AdcCode(i32);

impl AdcCode {
    /// The most negative code, −2²³.
    pub const MIN: Self = Self(-(1 << 23));
    /// The most positive code, 2²³ − 1.
    pub const MAX: Self = Self((1 << 23) - 1);
    /// The code of zero input.
    pub const ZERO: Self = Self(0);

    /// The code of this value, or `None` where it does not fit into 24 bits.
    pub const fn new(counts: i32) -> Option<Self> {
        if counts < Self::MIN.0 || counts > Self::MAX.0 { None } else { Some(Self(counts)) }
    }

    /// The nearest code to this value: what a converter returns for an input beyond its range.
    pub const fn saturating(counts: i64) -> Self {
        if counts < Self::MIN.0 as i64 {
            Self::MIN
        } else if counts > Self::MAX.0 as i64 {
            Self::MAX
        } else {
            #[expect(clippy::cast_possible_truncation, reason = "bounded by the two branches above")]
            Self(counts as i32)
        }
    }

    /// The code in the converter's own byte order: 24 bits, two's complement, most significant byte first.
    pub const fn from_be_bytes(bytes: [u8; 3]) -> Self {
        Self(i32::from_be_bytes([bytes[0], bytes[1], bytes[2], 0]) >> 8)
    }

    /// Four codes that follow each other in that order: three words of the processor's instead of twelve bytes.
    pub const fn four_from_be_bytes(bytes: &[[u8; 3]; 4]) -> [Self; 4] {
        let [[a, b, c], [d, e, f], [g, h, i], [j, k, l]] = *bytes;
        let first = u32::from_be_bytes([a, b, c, d]);
        let middle = u32::from_be_bytes([e, f, g, h]);
        let last = u32::from_be_bytes([i, j, k, l]);
        [
            Self::from_high_bits(first),
            Self::from_high_bits(first << 24 | middle >> 8),
            Self::from_high_bits(middle << 16 | last >> 16),
            Self::from_high_bits(last << 8),
        ]
    }

    /// The code that the upper 24 bits are.
    const fn from_high_bits(bits: u32) -> Self {
        Self(bits.cast_signed() >> 8)
    }

    /// The converter's own byte order, as read by [`AdcCode::from_be_bytes`].
    pub const fn to_be_bytes(self) -> [u8; 3] {
        let [_, high, middle, low] = self.0.to_be_bytes();
        [high, middle, low]
    }

    /// The value in counts.
    pub const fn counts(self) -> i32 {
        self.0
    }

    /// Whether the converter stood at an end of its range.
    pub const fn is_saturated(self) -> bool {
        self.successor_of_magnitude() & !Self::MAX.0 != 0
    }

    /// Whether any of these is.
    #[inline]
    pub fn any_is_saturated(codes: &[Self]) -> bool {
        let (fours, rest) = codes.as_chunks::<4>();
        let mut all = 0;
        // Written out: the compiler unrolls nothing where it is to save room.
        for [a, b, c, d] in fours {
            all |= a.successor_of_magnitude()
                | b.successor_of_magnitude()
                | c.successor_of_magnitude()
                | d.successor_of_magnitude();
        }
        for code in rest {
            all |= code.successor_of_magnitude();
        }
        all & !Self::MAX.0 != 0
    }

    /// One more than the code or its complement, whichever is not negative: beyond the bits of [`AdcCode::MAX`] for either end of the range,
    /// since the complement of the least code is the largest, and for whatever else a line may bring.
    const fn successor_of_magnitude(self) -> i32 {
        (self.0 ^ (self.0 >> (i32::BITS - 1))).wrapping_add(1)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::AdcCode;

    #[test]
    fn four_codes_in_a_row_are_those_of_their_bytes() {
        let words = [[0x80, 0x01, 0xfe], [0x7f, 0xff, 0x80], [0x00, 0x9a, 0x05], [0xff, 0x10, 0xc3]];
        for turn in 0..4 {
            let mut turned = words;
            turned.rotate_left(turn);
            assert_eq!(AdcCode::four_from_be_bytes(&turned), turned.map(AdcCode::from_be_bytes));
        }
        assert_eq!(
            AdcCode::four_from_be_bytes(&words).map(AdcCode::counts),
            [-8_388_098, 8_388_480, 39_429, -61_245]
        );
    }

    #[test]
    fn of_any_number_of_codes_one_that_is_saturated_is_found() {
        let within = [AdcCode(AdcCode::MIN.0 + 1), AdcCode(-1), AdcCode::ZERO, AdcCode(AdcCode::MAX.0 - 1)];
        for count in 0..=12 {
            let codes: Vec<AdcCode> = within.into_iter().cycle().take(count).collect();
            assert!(!AdcCode::any_is_saturated(&codes));
            for place in 0..count {
                for end in [AdcCode::MIN, AdcCode::MAX, AdcCode(i32::MIN), AdcCode(i32::MAX)] {
                    let mut codes = codes.clone();
                    codes[place] = end;
                    assert!(AdcCode::any_is_saturated(&codes), "{end:?} at {place} of {count}");
                    assert!(end.is_saturated());
                }
            }
        }
    }
}
