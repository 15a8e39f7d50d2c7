//! A trial's gate and sums as words, part by part, to be continued after a reset.
//!
//! The classes are sums of different samples, so each may be saved at an instant of its own: together they are sums of
//! a trial in which a few samples were left out.

use super::Bins;
use crate::estimation::gate::{self, Quietness};
use crate::estimation::moments;

/// One part of what is saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// What the gate has learnt.
    Gate,
    /// The sums of one class.
    Class(Quietness),
}

impl Part {
    /// All parts, in the order in which they are restored.
    pub const ALL: [Self; 4] = [
        Self::Gate,
        Self::Class(Quietness::Still),
        Self::Class(Quietness::Slow),
        Self::Class(Quietness::Fast),
    ];

    /// Words of this part of a trial over this many channels.
    pub const fn words(self, gages: usize) -> usize {
        match self {
            Self::Gate => gate::saved_words(gages),
            Self::Class(_) => moments::saved_words(gages),
        }
    }
}

impl<const GAGES: usize, const HIGHER: usize> Bins<GAGES, HIGHER> {
    /// Saves one part, in [`Part::words`] words; of how many samples it is the sum. Changes no sum.
    pub fn save(&mut self, part: Part, put: &mut impl FnMut(u32)) -> u64 {
        match part {
            Part::Gate => {
                self.gate.save(put);
                0
            }
            Part::Class(class) => self.classes.save(class, put),
        }
    }

    /// Restores all parts in the order of [`Part::ALL`]. `None`, and no sums, where they cannot be what was saved.
    pub fn restore(&mut self, take: &mut impl FnMut() -> Option<u32>) -> Option<()> {
        let restored = self.gate.restore(take).and_then(|()| self.classes.restore(take));
        if restored.is_none() {
            self.restart();
        }
        restored
    }

    /// Samples in the sums.
    pub const fn count(&self) -> u64 {
        self.classes.count()
    }
}

#[cfg(test)]
mod tests {
    use super::{Bins, Part};
    use crate::units::{AdcCode, MAX_RANK, Rank};

    const GAGES: usize = 3;
    type TestBins = Bins<GAGES, 25>;

    /// A load that is turned and rests in between, with some noise.
    fn codes(sample: i32) -> [AdcCode; GAGES] {
        let turn = f64::from(sample / 200 * 200 + (sample % 200).min(100)) / 90.0;
        let noise = f64::from(sample.wrapping_mul(7919) % 13 - 6);
        let shape = [(4e5, 0.0), (1e5, 3e5), (-2e5, 2e5)];
        #[expect(clippy::cast_possible_truncation, reason = "rounded to whole counts")]
        shape.map(|(x, y)| AdcCode::saturating((x * libm::cos(turn) + y * libm::sin(turn) + noise) as i64))
    }

    fn offer(bins: &mut TestBins, samples: core::ops::Range<i32>) {
        for sample in samples {
            bins.offer(&codes(sample)).unwrap();
        }
    }

    fn saved(bins: &mut TestBins) -> heapless::Vec<u32, 512> {
        let mut words = heapless::Vec::new();
        for part in Part::ALL {
            let before = words.len();
            bins.save(part, &mut |word| words.push(word).unwrap());
            assert_eq!(words.len() - before, part.words(GAGES));
        }
        words
    }

    fn restored(words: &[u32]) -> Option<TestBins> {
        let mut bins = TestBins::new();
        let mut words = words.iter().copied();
        bins.restore(&mut || words.next()).map(|()| bins)
    }

    #[test]
    fn saving_changes_nothing() {
        let (mut undisturbed, mut disturbed) = (TestBins::new(), TestBins::new());
        offer(&mut undisturbed, 0..3000);
        for begin in (0..3000).step_by(37) {
            offer(&mut disturbed, begin..(begin + 37).min(3000));
            saved(&mut disturbed);
        }
        undisturbed.finish();
        disturbed.finish();
        let solved = |bins: &TestBins| bins.solve(Rank::Planar).unwrap().solution.shape_counts_per_load;
        assert_eq!(solved(&undisturbed), solved(&disturbed));
    }

    #[test]
    fn a_trial_goes_on_where_it_was_saved() {
        let (mut whole, mut cut) = (TestBins::new(), TestBins::new());
        offer(&mut whole, 0..6000);
        offer(&mut cut, 0..3000);
        let mut resumed = restored(&saved(&mut cut)).unwrap();
        let missing = cut.count() - resumed.count();
        // At most what waits to be absorbed in each class: a batch and the one after it.
        assert!(missing <= 3 * 32, "{missing}");
        offer(&mut resumed, 3000..6000);
        whole.finish();
        resumed.finish();
        assert!(whole.count() - resumed.count() <= 3 * 32 + 28);
        let solved = |bins: &TestBins| bins.solve(Rank::Planar).unwrap().solution;
        let (whole, resumed) = (solved(&whole), solved(&resumed));
        // SᵀS knows no orientation. A few samples less change it by far less than it is uncertain.
        let gram = |shape: nalgebra::SMatrix<f64, MAX_RANK, GAGES>| shape.transpose() * shape;
        let expected = gram(whole.shape_counts_per_load);
        let difference = (gram(resumed.shape_counts_per_load) - expected).amax() / expected.amax();
        assert!(difference < 1e-3, "{difference}");
    }

    #[test]
    fn what_is_restored_is_saved_the_same_again() {
        let mut bins = TestBins::new();
        offer(&mut bins, 0..3000);
        let words = saved(&mut bins);
        assert_eq!(saved(&mut restored(&words).unwrap()), words);
    }

    #[test]
    fn what_cannot_have_been_saved_is_not_restored() {
        let mut bins = TestBins::new();
        assert!(restored(&saved(&mut bins)).is_none(), "no samples");
        offer(&mut bins, 0..3000);
        let words = saved(&mut bins);
        assert!(restored(&words[1..]).is_none());
        let pivot = Part::Gate.words(GAGES);
        for wrong in [u32::MAX / 2, words[pivot] ^ 1] {
            let mut changed = words.clone();
            changed[pivot] = wrong;
            assert!(restored(&changed).is_none());
        }
    }
}
