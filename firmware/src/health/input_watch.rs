//! Inputs that repeat themselves: a gage that is dead, open or shorted, as far as its own codes show it.
//!
//! An input with a bridge on it is never still: the converter itself has a noise of 10 counts at least, at any of its rates and gains
//! (datasheet, table 7-1), so that a channel repeats its code in one conversion of 35 at most, and [`ALLOWED`] times running and once
//! more in one of 10⁶. At the gain and rate after power-up (about 80 counts) it is one in 10¹⁰. A channel that does so all the
//! same repeats what no gage says.
//!
//! The samples before that, up to [`ALLOWED`] of them, are that many conversions old in this channel at most: a wrench made of
//! them is what it was a few conversions before.
//!
//! An open input that wanders is for the other gages to find ([`super::parity_monitor`]); one that stands at the end of the range is
//! saturated.

use ftcal_shared::units::AdcCode;

/// Identical codes after the first that are still taken.
const ALLOWED: u8 = 3;

/// What repeats itself in a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Repetition {
    /// Gages that have done so for longer than they should: bit k for gage k.
    pub(crate) lasting: u16,
    /// All gages that are within their range repeat the sample before, if only this once. (One at the end of it has nothing else to say.)
    pub(crate) of_all: bool,
}

/// What each gage read last, and for how long.
pub(crate) struct InputWatch<const GAGES: usize> {
    last: [AdcCode; GAGES],
    /// Identical codes after the first.
    runs: [u8; GAGES],
    /// Whether any run is more than zero.
    running: bool,
}

impl<const GAGES: usize> InputWatch<GAGES> {
    pub(crate) const fn new() -> Self {
        Self { last: [AdcCode::ZERO; GAGES], runs: [0; GAGES], running: false }
    }

    /// Forgets what was read, as after a pause.
    pub(crate) const fn restart(&mut self) {
        self.runs = [0; GAGES];
        self.running = false;
    }

    /// Takes in one sample, and says what repeats itself.
    pub(crate) fn push(&mut self, codes: &[AdcCode; GAGES]) -> Repetition {
        let ((codes_by_four, codes_rest), (last_by_four, last_rest)) =
            (codes.as_chunks::<4>(), self.last.as_chunks::<4>());
        let mut any = self.running;
        // Written out: the compiler unrolls nothing where it is to save room.
        for ([a, b, c, d], [e, f, g, h]) in codes_by_four.iter().zip(last_by_four) {
            any = any || a == e || b == f || c == g || d == h;
        }
        for (code, last) in codes_rest.iter().zip(last_rest) {
            any = any || code == last;
        }
        let repetition = if any { self.count(codes) } else { Repetition { lasting: 0, of_all: false } };
        self.last = *codes;
        repetition
    }

    /// Rarely needed, so not in the way of what is.
    #[cold]
    fn count(&mut self, codes: &[AdcCode; GAGES]) -> Repetition {
        let (mut lasting, mut same, mut within_range) = (0, 0_usize, 0_usize);
        self.running = false;
        for (gage, run) in self.runs.iter_mut().enumerate() {
            let repeats = codes[gage] == self.last[gage];
            *run = if repeats { run.saturating_add(1) } else { 0 };
            let is_within_range = !codes[gage].is_saturated();
            within_range += usize::from(is_within_range);
            same += usize::from(repeats && is_within_range);
            self.running |= repeats;
            lasting |= u16::from(*run > ALLOWED) << gage;
        }
        Repetition { lasting, of_all: same > 0 && same == within_range }
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::AdcCode;

    use super::{ALLOWED, InputWatch};

    fn code(counts: i64) -> AdcCode {
        AdcCode::saturating(counts)
    }

    #[test]
    fn a_gage_repeats_itself_after_so_many_codes_and_until_another_comes() {
        let mut watch = InputWatch::<3>::new();
        for sample in 0..20 {
            let repetition = watch.push(&[code(sample + 1), code(77), code(-sample - 1)]);
            assert!(!repetition.of_all);
            assert_eq!(
                repetition.lasting,
                if sample > i64::from(ALLOWED) { 0b010 } else { 0 },
                "sample {sample}"
            );
        }
        assert_eq!(watch.push(&[code(1), code(78), code(1)]).lasting, 0);
        for _ in 0..300 {
            watch.push(&[code(5), code(79), code(5)]);
        }
        assert!(watch.push(&[code(5), code(79), code(5)]).of_all);
        let repetition = watch.push(&[code(5), code(80), code(5)]);
        assert_eq!((repetition.lasting, repetition.of_all), (0b101, false));
    }

    #[test]
    fn gages_at_the_end_of_their_range_say_nothing_of_the_others() {
        let mut watch = InputWatch::<2>::new();
        for _ in 0..10 {
            assert!(!watch.push(&[AdcCode::MAX, AdcCode::MIN]).of_all);
        }
        assert!(!watch.push(&[AdcCode::MAX, code(5)]).of_all);
        assert!(watch.push(&[AdcCode::MAX, code(5)]).of_all);
    }

    #[test]
    fn after_a_restart_the_count_begins_anew() {
        let mut watch = InputWatch::<1>::new();
        for _ in 0..10 {
            watch.push(&[code(9)]);
        }
        watch.restart();
        for _ in 0..ALLOWED {
            assert_eq!(watch.push(&[code(9)]).lasting, 0);
        }
        assert_eq!(watch.push(&[code(9)]).lasting, 1);
    }
}
