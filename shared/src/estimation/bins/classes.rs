//! The sums of a trial's samples, class by class, all about one pivot.

use crate::estimation::code_sums::{CodeSums, MAX_SAMPLES};
use crate::estimation::gate::Quietness;
use crate::estimation::moments::Moments;
use crate::refusal::Refusal;
use crate::units::AdcCode;

/// One accumulator for each [`Quietness`].
#[derive(Clone, Debug)]
pub(super) struct Classes<const GAGES: usize, const HIGHER: usize> {
    by_quietness: [Moments<GAGES, HIGHER>; Quietness::ALL.len()],
    /// Samples in all of them.
    count: u64,
    /// Why a sample could not be summed up.
    full: Option<Refusal>,
}

impl<const GAGES: usize, const HIGHER: usize> Classes<GAGES, HIGHER> {
    pub(super) const fn new() -> Self {
        Self {
            by_quietness: [const { Moments::new([AdcCode::ZERO; GAGES]) }; Quietness::ALL.len()],
            count: 0,
            full: None,
        }
    }

    pub(super) fn restart(&mut self) {
        self.count = 0;
        self.full = None;
        for bin in &mut self.by_quietness {
            bin.restart([AdcCode::ZERO; GAGES]);
        }
    }

    /// The accumulators, the quietest first.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Moments<GAGES, HIGHER>> {
        self.by_quietness.iter()
    }

    /// The sums over the codes of all samples.
    pub(super) fn codes(&self) -> Result<CodeSums<GAGES>, Refusal> {
        let mut all = CodeSums::new(*self.by_quietness[0].pivot());
        for bin in &self.by_quietness {
            all.add(bin.codes())?;
        }
        Ok(all)
    }

    /// Samples in all accumulators.
    pub(super) const fn count(&self) -> u64 {
        self.count
    }

    /// Where a sample found no room: why. What was summed up stays good.
    pub(super) const fn full(&self) -> Option<Refusal> {
        self.full
    }

    pub(super) fn push(&mut self, quietness: Quietness, codes: &[AdcCode; GAGES]) {
        if self.count >= MAX_SAMPLES {
            self.full = Some(Refusal::OverflowAhead { samples: self.count });
            return;
        }
        if self.count == 0 {
            // The first sample is the pivot, which takes the offset out of all sums. They are empty already.
            for bin in &mut self.by_quietness {
                bin.set_pivot(*codes);
            }
        }
        match self.by_quietness[quietness as usize].push(codes) {
            Ok(()) => self.count += 1,
            Err(refusal) => self.full = Some(refusal),
        }
    }

    /// Brings every sample into the long sums.
    pub(super) fn settle(&mut self) {
        for bin in &mut self.by_quietness {
            bin.settle();
        }
    }

    /// Saves the sums of one class as words; of how many samples they are.
    pub(super) fn save(&mut self, class: Quietness, put: &mut impl FnMut(u32)) -> u64 {
        self.by_quietness[class as usize].save(put)
    }

    /// Restores all that was saved. `None` where it cannot be what was saved; what is held then makes no sense.
    pub(super) fn restore(&mut self, take: &mut impl FnMut() -> Option<u32>) -> Option<()> {
        self.full = None;
        for bin in &mut self.by_quietness {
            bin.restore(take)?;
        }
        self.count = self.by_quietness.iter().map(Moments::count).sum();
        // The first sample of all was the pivot; a class that was saved before it came has none of its own.
        let pivot = *self.by_quietness.iter().find(|bin| bin.count() > 0)?.pivot();
        for bin in &mut self.by_quietness {
            if bin.count() == 0 {
                bin.restart(pivot);
            }
        }
        self.by_quietness.iter().all(|bin| *bin.pivot() == pivot).then_some(())
    }
}

#[cfg(test)]
mod tests {
    use super::Classes;
    use crate::estimation::code_sums::MAX_SAMPLES;
    use crate::estimation::gate::Quietness;
    use crate::refusal::Refusal;
    use crate::units::AdcCode;

    fn codes(counts: i64) -> [AdcCode; 2] {
        [counts, -2 * counts].map(AdcCode::saturating)
    }

    #[test]
    fn a_sample_too_many_is_refused_and_what_there_is_stays() {
        let mut classes = Classes::<2, 9>::new();
        classes.push(Quietness::Still, &codes(5));
        classes.push(Quietness::Fast, &codes(9));
        classes.count = MAX_SAMPLES;
        classes.push(Quietness::Still, &codes(7));
        assert_eq!(classes.full(), Some(Refusal::OverflowAhead { samples: MAX_SAMPLES }));
        assert_eq!(classes.count(), MAX_SAMPLES);
        classes.settle();
        let sums = classes.codes().unwrap();
        assert_eq!((sums.count(), sums.mean().counts.as_slice()), (2, &[7.0, -14.0][..]));

        classes.restart();
        assert_eq!((classes.count(), classes.full()), (0, None));
        classes.push(Quietness::Slow, &codes(3));
        assert_eq!((classes.count(), classes.full()), (1, None));
        assert!(classes.iter().all(|class| *class.pivot() == codes(3)));
    }
}
