//! What the gate has learnt, as words, to be continued after a reset: the level of the noise, its covariance at rest, the resolution, and
//! how often the class has changed and the load has come to rest. Samples that wait to be classed are not among it, nor what was expected of them.

use super::Gate;
use crate::estimation::words::{put_wide, take_wide};

/// Words of what a gate over this many channels has learnt.
pub const fn saved_words(gages: usize) -> usize {
    9 + gages * (gages + 1)
}

impl<const GAGES: usize> Gate<GAGES> {
    /// Saves what was learnt, in [`saved_words`] words.
    pub fn save(&self, put: &mut impl FnMut(u32)) {
        put(self.step.cast_unsigned());
        put(self.noise.to_bits());
        put(self.usual_change.to_bits());
        put(self.moving);
        put(self.off_magnitude);
        put(self.classed);
        put(self.changes);
        put(self.rests);
        put(self.rest_noise.contrasts);
        for i in 0..GAGES {
            for j in i..GAGES {
                put_wide(put, self.rest_noise.products[i][j].cast_unsigned());
            }
        }
    }

    /// Restores what was saved; a sample that comes then meets a gate that has learnt, but seen nothing yet. `None` where it
    /// cannot be what was saved.
    pub fn restore(&mut self, take: &mut impl FnMut() -> Option<u32>) -> Option<()> {
        *self = Self::new();
        self.step = take()?.cast_signed();
        self.noise = f32::from_bits(take()?);
        self.usual_change = f32::from_bits(take()?);
        self.moving = take()?;
        self.off_magnitude = take()?;
        self.classed = take()?;
        self.changes = take()?;
        self.rests = take()?;
        self.rest_noise.contrasts = take()?;
        for i in 0..GAGES {
            for j in i..GAGES {
                self.rest_noise.products[i][j] = take_wide(take)?.cast_signed();
            }
        }
        Some(())
    }
}
