//! The sums as words, to be continued after a reset.
//!
//! What is saved is a valid accumulator of all samples but the last few, which wait to be absorbed: saving changes no sum, so
//! that a trial that was saved ends as one that was not. Sums of degree 3 and 4 are rounded to single precision, 6·10⁻⁸ of each,
//! once for each reset.

use super::{Moments, higher_moment_count};
use crate::estimation::monomials::Compensated;
use crate::estimation::words::{WORDS_OF_PRODUCTS, put_products, put_wide, take_products, take_wide};
use crate::units::AdcCode;

/// Words of the sums over this many channels: pivot, count, sum, Gram matrix, and the sums of degree 3 and 4.
pub const fn saved_words(gages: usize) -> usize {
    gages + 2 + 2 * gages + WORDS_OF_PRODUCTS * gages * (gages + 1) / 2 + higher_moment_count(gages)
}

impl<const GAGES: usize, const HIGHER: usize> Moments<GAGES, HIGHER> {
    /// Saves the sums, in [`saved_words`] words; of how many samples they are.
    pub fn save(&mut self, put: &mut impl FnMut(u32)) -> u64 {
        let samples = self.codes.count - self.finish_absorption();
        for code in &self.codes.pivot {
            put(code.counts().cast_unsigned());
        }
        put_wide(put, samples);
        for sum in self.codes.sum {
            put_wide(put, sum.cast_unsigned());
        }
        for i in 0..GAGES {
            for j in i..GAGES {
                put_products(put, self.codes.gram[i][j] + i128::from(self.block.gram[i][j]));
            }
        }
        for sum in &self.higher {
            put(sum.rounded().to_bits());
        }
        samples
    }

    /// Restores what was saved. `None` where it cannot be what was saved; the sums are then of no use.
    pub fn restore(&mut self, take: &mut impl FnMut() -> Option<u32>) -> Option<()> {
        let mut pivot = [AdcCode::ZERO; GAGES];
        for code in &mut pivot {
            *code = AdcCode::new(take()?.cast_signed())?;
        }
        self.restart(pivot);
        self.codes.count = take_wide(take)?;
        for sum in &mut self.codes.sum {
            *sum = take_wide(take)?.cast_signed();
        }
        for i in 0..GAGES {
            for j in i..GAGES {
                self.codes.gram[i][j] = take_products(take)?;
            }
        }
        for sum in &mut self.higher {
            *sum = Compensated::of(f32::from_bits(take()?));
        }
        Some(())
    }
}
