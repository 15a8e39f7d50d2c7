//! What is missing between the samples of a stream, told by their numbers.
//!
//! A sensor numbers its conversions, and each sample says what its number is and what the next one's will be. What comes later
//! than that says how many samples were lost: conversions that failed, samples that did not fit on the line, frames that were
//! broken on their way. Numbers wrap around. One that is behind the expected one by less than half of all numbers is that of
//! a sensor that has been reset: what it lost, nobody knows.

use ftcal_shared::units::SampleIndex;

/// Follows the numbers of a stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Continuity {
    expected: Option<SampleIndex>,
}

impl Continuity {
    /// Takes note of the next sample, whose number is `stride` before that of the sample after it; answers how many
    /// samples are missing before it. A stride of zero says that this is no sample.
    pub(super) fn missing_before(&mut self, index: SampleIndex, stride: u8) -> u32 {
        let stride = u32::from(stride);
        if stride == 0 {
            return 0;
        }
        let ahead = self.expected.map_or(0, |expected| index.since(expected));
        self.expected = Some(SampleIndex::new(index.get().wrapping_add(stride)));
        if ahead > u32::MAX / 2 { 0 } else { ahead / stride }
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::SampleIndex;

    use super::Continuity;

    #[test]
    fn what_is_missing_is_counted_across_the_end_of_the_numbers() {
        let mut continuity = Continuity::default();
        let mut missing = |index| continuity.missing_before(SampleIndex::new(index), 4);
        assert_eq!(missing(u32::MAX - 7), 0);
        assert_eq!(missing(u32::MAX - 3), 0);
        assert_eq!(missing(8), 2);
        assert_eq!(missing(12), 0);
    }

    #[test]
    fn neither_a_silence_nor_a_reset_is_a_loss() {
        let mut continuity = Continuity::default();
        assert_eq!(continuity.missing_before(SampleIndex::new(1_000_000), 1), 0);
        assert_eq!(continuity.missing_before(SampleIndex::new(1_000_500), 0), 0);
        assert_eq!(continuity.missing_before(SampleIndex::new(1_000_001), 1), 0);
        assert_eq!(continuity.missing_before(SampleIndex::new(0), 1), 0);
        assert_eq!(continuity.missing_before(SampleIndex::new(2), 1), 1);
    }
}
