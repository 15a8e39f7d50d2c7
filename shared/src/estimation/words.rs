//! Numbers as words of 32 bits: what the sums are kept as, in a memory that is written word by word.
//!
//! Whoever saves hands each word to a `put`, and whoever restores gets each from a `take`, which has none where there are no more.

/// Saves 64 bits.
#[expect(clippy::cast_possible_truncation, reason = "each word gets its half")]
pub(super) fn put_wide(put: &mut impl FnMut(u32), value: u64) {
    put(value as u32);
    put((value >> 32) as u32);
}

/// Restores 64 bits.
pub(super) fn take_wide(take: &mut impl FnMut() -> Option<u32>) -> Option<u64> {
    let (low, high) = (take()?, take()?);
    Some(u64::from(low) | (u64::from(high) << 32))
}

/// Words of a sum of products: 2³² products of 2⁴⁸ have 81 bits with their sign.
pub(super) const WORDS_OF_PRODUCTS: usize = 3;

/// Saves a sum of products.
#[expect(clippy::cast_possible_truncation, reason = "each word gets its part")]
pub(super) fn put_products(put: &mut impl FnMut(u32), sum: i128) {
    let bits = sum.cast_unsigned();
    for word in 0..WORDS_OF_PRODUCTS {
        put((bits >> (32 * word)) as u32);
    }
}

/// Restores a sum of products.
pub(super) fn take_products(take: &mut impl FnMut() -> Option<u32>) -> Option<i128> {
    let (low, middle, high) = (take()?, take()?, take()?.cast_signed());
    Some(i128::from(low) | (i128::from(middle) << 32) | (i128::from(high) << 64))
}

#[cfg(test)]
mod tests {
    use super::{put_products, put_wide, take_products, take_wide};

    #[test]
    fn numbers_come_back_as_they_were() {
        let largest = (1_i128 << 80) - 1;
        let mut words = heapless::Vec::<u32, 32>::new();
        let mut put = |word| words.push(word).unwrap();
        for sum in [0, 1, -1, largest, -largest] {
            put_products(&mut put, sum);
        }
        for value in [0, u64::MAX, 1 << 33] {
            put_wide(&mut put, value);
        }
        let mut words = words.into_iter();
        let mut take = || words.next();
        for sum in [0, 1, -1, largest, -largest] {
            assert_eq!(take_products(&mut take), Some(sum));
        }
        for value in [0, u64::MAX, 1 << 33] {
            assert_eq!(take_wide(&mut take), Some(value));
        }
        assert_eq!(take_wide(&mut take), None);
    }
}
