//! A 32-bit hardware counter, extended to 64 bits without a lock.
//!
//! The counter's upper bit divides its range into two halves. Somebody calls [`follow`] at least once in each half and keeps
//! the number of halves completed; whoever wants the long count combines that number with the counter by [`extend`]. The
//! lowest bit of the number says which half it was kept in, so the two may be up to one half out of step: it does not matter
//! whether the counter entered the next half before or after the number was read.
//!
//! At one count a microsecond a half lasts 35 minutes.

const HALF: u32 = 1 << 31;

/// The number of completed halves, given what it was before and what the counter reads now.
#[must_use]
pub const fn follow(halves: u32, counter: u32) -> u32 {
    if counter / HALF == halves % 2 { halves } else { halves.wrapping_add(1) }
}

/// The long count. Exact as long as `halves` is at most one half behind `counter`.
#[must_use]
pub const fn extend(halves: u32, counter: u32) -> u64 {
    // In the half that `halves` was kept in, the upper bit cancels; in the one after, it counts one half more.
    let beyond = counter ^ ((halves % 2) * HALF);
    halves as u64 * HALF as u64 + beyond as u64
}

#[cfg(test)]
mod tests {
    use super::{HALF, extend, follow};

    /// The counter's own 32 bits of a long count.
    #[expect(clippy::cast_possible_truncation, reason = "this is what the hardware does")]
    const fn counter(count: u64) -> u32 {
        count as u32
    }

    #[test]
    fn the_long_count_is_exact_through_every_wrap() {
        let step = u64::from(HALF) / 7;
        let mut halves = 0;
        for count in (0..200).map(|index| index * step) {
            assert_eq!(extend(halves, counter(count)), count, "before following");
            halves = follow(halves, counter(count));
            assert_eq!(extend(halves, counter(count)), count, "after following");
        }
    }

    #[test]
    fn the_instants_around_a_half_are_exact_whoever_comes_first() {
        let half = u64::from(HALF);
        for boundary in 1..6 {
            for count in [boundary * half - 1, boundary * half, boundary * half + 1] {
                let behind = u32::try_from(boundary - 1).unwrap();
                assert_eq!(extend(behind, counter(count)), count);
                assert_eq!(extend(follow(behind, counter(count)), counter(count)), count);
            }
        }
    }

    #[test]
    fn following_often_changes_nothing() {
        let halves = follow(0, HALF + 5);
        assert_eq!(halves, 1);
        assert_eq!(follow(halves, HALF + 6), 1);
        assert_eq!(follow(follow(halves, 3), 4), 2);
    }
}
