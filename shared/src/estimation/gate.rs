//! The gate before the sums: which samples are measurements at all, and how quiet the load was at each (design § 5).
//!
//! A sample is **rejected** where it is no measurement: a channel stands at an end of its range, or the converter repeats
//! itself. Every other sample is **classed** by quietness, not judged: how much a moving sample is worth is known only when the
//! trial is solved ([`super::bins`]).
//!
//! # Quietness
//!
//! Samples are taken in blocks of four, and a block is classed by the three blocks to each side of it, so that it comes
//! out `REACH` blocks late. With white noise of variance σ² in each of p channels, sums s of four samples give
//!
//! | measure of block k | from noise alone | answers to |
//! |---|---|---|
//! | change: ‖sₖ − sₖ₋₁‖² + ‖sₖ₊₁ − sₖ‖² | 16σ²p | swinging, tremor, fast turning |
//! | travel: ‖sₖ₊ᵣ − sₖ₋ᵣ‖², r = `REACH` | 8σ²p | slow turning |
//! | unrest: ‖sⱼ₊₁ − sⱼ‖² over all j from k − r to k + r − 1 | 48σ²p | swinging that change and travel miss by chance |
//! | curvature: the squared second differences inside of blocks k−1, k, k+1 | 36σ²p | noise, hardly turning |
//!
//! The noise is the curvature that a tenth of all blocks stays below: at rest where the load rested at all. A block is **still**
//! where change and travel together are no more than 2.2 times that, and unrest no more than twice as much. (While a hand swings
//! the load, change and travel are small now and then by chance; six steps in a row are not. For the same reason the first and the
//! last three blocks, which lack neighbours to be classed by, are never still. A dozen samples of a swinging load among the
//! resting ones is enough to make the answer ten times worse.) Of all others, the calmer half by change is **slow** and the rest
//! **fast**: where a load never rests, its quieter half is at hand. Both levels are tracked as the samples come, in single
//! precision, and depend on nothing but the codes: sensor and host class alike, to the last bit.
//!
//! # Repetition
//!
//! A converter that hangs repeats its last codes. A coarse one repeats itself rightly: so a repetition is suspicious only where
//! the noise stands above the resolution, which is the smallest change of any code seen so far. With σ ≥ 2 steps a channel
//! repeats itself once in seven samples, and all of two or more channels five times running in 10⁻⁸ of cases.
//!
//! # Expectation
//!
//! A trial that has been solved once knows what codes to expect ([`super::expectation`]). A block whose codes answer to no load
//! at this arm is rejected, and forgotten; one that does, but to a load of another magnitude, is classed fast, however quiet
//! it was: the shape's subspace may be taken from it, the metric not.
//!
//! # Limits
//!
//! All is counted in samples. At rates so high that the load moves by less than the noise in 28 samples, everything is still,
//! and a trial is what it would be with no gate.

mod saved;

pub use saved::saved_words;

use super::expectation::{Expectation, Meets};
use super::rest_noise::{ChannelNoise, QUANTISATION_VARIANCE, RestNoise};
use crate::units::AdcCode;

/// Samples in a block.
pub const BLOCK: usize = 4;

/// The same, as samples are counted.
#[expect(clippy::cast_possible_truncation, reason = "four")]
const BLOCK_SAMPLES: u32 = BLOCK as u32;

/// Variance of the rounding to steps of the codes, in steps².
#[expect(clippy::cast_possible_truncation, reason = "a level needs three digits")]
const ROUNDING: f32 = QUANTISATION_VARIANCE as f32;

/// Blocks to each side of a block by which it is classed.
const REACH: u32 = 3;

/// Blocks kept: those of a class, in a number that a division by is none.
const WINDOW: usize = (2 * REACH as usize + 1).next_power_of_two();

/// Identical samples in a row, after the first, that are still taken.
const ALLOWED_REPEATS: u32 = 4;

/// Curvature of noise alone, for each channel, in units of its variance: three blocks of two second differences of 6σ².
const CURVATURE_OF_NOISE: f32 = 36.0;

/// The curvature that a tenth of all blocks stays below, over its mean: about 0.6 for 3 to 8 channels.
const LOW_TENTH: f32 = 0.6;

/// Change and travel of a still block over the noise level, 0.6·36σ²p: their mean is 24σ²p, and 48σ²p leaves room for chance.
/// Tighter loses rests, looser takes in the ends of turns; over 60 simulated hands the error is least between 1.8 and 2.2.
const STILL: f32 = 2.2;

/// Blocks after which the level of the noise has settled.
const LEAST_BLOCKS: u32 = 100;

/// Steps of the level that a tenth of all blocks stays below: ln 0.9 = −9·ln 1.0117.
const NOISE_DOWN: f32 = 0.9;
const NOISE_UP: f32 = 1.0117;

/// The least relative step of the level that halves the moving blocks. It begins at one and falls with their number.
const LEAST_STEP: f32 = 0.05;

/// Noise of two steps of the codes, variance in steps²: above it no converter repeats itself.
const UNREPEATABLE: f32 = 4.0;

/// Changes of class from one movement to the next: slow, fast, slow, and still where there is a rest.
const CHANGES_OF_MOVEMENT: u64 = 4;

/// How often the load has rested and moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Episodes {
    /// Rests.
    pub rests: u64,
    /// Rests, and movements between them; where it hardly ever rests, movements as its speed tells them apart. One at least.
    pub all: u64,
}

/// How quiet the load was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quietness {
    /// Nothing moved but by noise.
    Still,
    /// The calmer half of what moved.
    Slow,
    /// The other half.
    Fast,
}

impl Quietness {
    /// All classes, quietest first.
    pub const ALL: [Self; 3] = [Self::Still, Self::Slow, Self::Fast];
}

/// What became of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is a measurement, and will be classed.
    Accepted,
    /// A channel stood at an end of its range.
    Saturated,
    /// The converter repeats itself.
    Repeated,
    /// The codes answer to no load at this arm: of this sample and of the last three that were accepted, which make up a block.
    Contradictory,
}

/// The gate of one trial, over `GAGES` channels.
#[derive(Clone, Debug)]
pub struct Gate<const GAGES: usize> {
    /// The block and the place in it of the sample before, where there is one.
    last: Option<(usize, usize)>,
    /// Identical samples in a row, after the first.
    repeats: u32,
    /// The smallest change of any code from one sample to the next, counts; zero until there is one.
    step: i32,
    /// The last blocks, by number modulo `WINDOW`; the one after the last complete one is being filled.
    blocks: [Block<GAGES>; WINDOW],
    complete: u32,
    filled: usize,
    /// A block that is to be classed with the next sample, which is the first of a block of its own and has little to do.
    due: Option<u32>,
    handing_out: HandingOut,
    /// The curvature that a tenth of all blocks stays below, counts²; zero until there is one.
    noise: f32,
    /// The change that half of the moving blocks stay below, counts²; zero until there is one.
    usual_change: f32,
    /// Moving blocks so far.
    moving: u32,
    /// Class of the last block that was classed.
    latest: Quietness,
    /// What the blocks at rest tell of the noise.
    rest_noise: RestNoise<GAGES>,
    expectation: Option<Expectation<GAGES>>,
    /// Samples that were classed fast for the magnitude of their load alone.
    off_magnitude: u32,
    /// Blocks that were classed, and how often the class has changed.
    classed: u32,
    changes: u32,
    /// How often the load has come to rest.
    rests: u32,
}

/// A classed block on its way out, one sample with each that comes in: what takes them has much to do.
#[derive(Clone, Copy, Debug)]
struct HandingOut {
    place: usize,
    next: usize,
    quietness: Quietness,
}

impl HandingOut {
    const DONE: Self = Self { place: 0, next: BLOCK, quietness: Quietness::Fast };
}

#[derive(Clone, Copy, Debug)]
struct Block<const GAGES: usize> {
    codes: [[AdcCode; GAGES]; BLOCK],
    /// Whether their load is of another magnitude than expected.
    off_magnitude: bool,
    sum: [i32; GAGES],
    curvature: f32,
    /// ‖s − s'‖² from the block before, counts².
    step: f32,
}

impl<const GAGES: usize> Block<GAGES> {
    const EMPTY: Self = Self {
        codes: [[AdcCode::ZERO; GAGES]; BLOCK],
        off_magnitude: false,
        sum: [0; GAGES],
        curvature: 0.0,
        step: 0.0,
    };

    /// Sums up the full block, and gives the smallest change of a code from its first sample to the second or from the third
    /// to the last: `None` where there was none.
    fn complete(&mut self) -> Option<i32> {
        let [a, b, c, d] = &self.codes;
        let mut curvature = 0.0;
        // Less one, so that no change at all is the largest.
        let mut least = u32::MAX;
        for gage in 0..GAGES {
            let (a, b, c, d) = (a[gage].counts(), b[gage].counts(), c[gage].counts(), d[gage].counts());
            self.sum[gage] = (a + b) + (c + d);
            let (first, middle, last) = (b - a, c - b, d - c);
            let (early, late) = ((middle - first) as f32, (last - middle) as f32);
            curvature += early * early + late * late;
            least = least.min(first.unsigned_abs().wrapping_sub(1)).min(last.unsigned_abs().wrapping_sub(1));
        }
        self.curvature = curvature;
        i32::try_from(least).ok().map(|less_one| less_one + 1)
    }

    /// ‖s − s'‖², counts².
    fn distance(&self, other: &Self) -> f32 {
        let mut total = 0.0;
        for gage in 0..GAGES {
            let difference = (self.sum[gage] - other.sum[gage]) as f32;
            total += difference * difference;
        }
        total
    }
}

impl<const GAGES: usize> Default for Gate<GAGES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const GAGES: usize> Gate<GAGES> {
    /// A gate that has seen nothing.
    pub const fn new() -> Self {
        Self {
            last: None,
            repeats: 0,
            step: 0,
            blocks: [Block::EMPTY; WINDOW],
            complete: 0,
            filled: 0,
            due: None,
            handing_out: HandingOut::DONE,
            noise: 0.0,
            usual_change: 0.0,
            moving: 0,
            latest: Quietness::Fast,
            rest_noise: RestNoise::new(),
            expectation: None,
            off_magnitude: 0,
            classed: 0,
            changes: 0,
            rests: 0,
        }
    }

    /// Into how many rests and movements the samples so far fall; `None` where the gate has classed none.
    pub fn episodes(&self) -> Option<Episodes> {
        let (rests, changes) = (u64::from(self.rests), u64::from(self.changes));
        let all = (2 * rests).max(changes / CHANGES_OF_MOVEMENT).max(1);
        (self.classed > 0).then_some(Episodes { rests, all })
    }

    /// Has every further sample compared with this.
    pub fn expect(&mut self, expectation: Option<Expectation<GAGES>>) {
        self.expectation = expectation;
    }

    /// Samples so far that were classed fast for the magnitude of their load alone.
    pub const fn off_magnitude(&self) -> u32 {
        self.off_magnitude
    }

    /// The variance of the channels' noise in the quietest tenth of the blocks, counts², the mean over the channels: of a load that
    /// moves smoothly, too, since it is taken from second differences. `None` before there are enough blocks to tell.
    pub fn quietest_variance(&self) -> Option<f64> {
        let level = LOW_TENTH * CURVATURE_OF_NOISE * GAGES as f32;
        (self.classed >= LEAST_BLOCKS).then(|| f64::from(self.noise / level))
    }

    /// What the rests so far tell of the noise of the channels.
    pub fn noise(&self) -> ChannelNoise<GAGES> {
        self.rest_noise.channels(self.step)
    }

    /// Takes in one sample; `take` gets at most one earlier sample, in the order in which they came, and its class. Whether
    /// [any code is saturated](AdcCode::any_is_saturated) is asked of whoever offers them, who on the sensor knows it already.
    pub fn offer(
        &mut self,
        codes: &[AdcCode; GAGES],
        is_saturated: bool,
        take: &mut impl FnMut(Quietness, &[AdcCode; GAGES]),
    ) -> Verdict {
        if let Some(number) = self.due.take() {
            self.release(number, number + REACH);
        }
        self.hand_out_next(take);
        if is_saturated {
            return Verdict::Saturated;
        }
        if self.repeats(codes) && self.is_suspicious() {
            return Verdict::Repeated;
        }
        let place = self.complete as usize % WINDOW;
        self.last = Some((place, self.filled));
        let block = &mut self.blocks[place];
        block.codes[self.filled] = *codes;
        self.filled += 1;
        if self.filled < BLOCK {
            return Verdict::Accepted;
        }
        self.filled = 0;
        if let Some(least_change) = block.complete().filter(|&least| self.step == 0 || least < self.step) {
            self.step = least_change;
        }
        let meets = self.expectation.as_ref().map_or(Meets::Both, |expected| expected.judge(&block.sum));
        if meets == Meets::Neither {
            return Verdict::Contradictory;
        }
        block.off_magnitude = meets != Meets::Both;
        let newest = self.complete;
        self.block_mut(newest).step = self.block(newest).distance(self.block(newest.saturating_sub(1)));
        self.complete = self.complete.wrapping_add(1);
        self.due = newest.checked_sub(REACH);
        Verdict::Accepted
    }

    /// Hands out the samples that still wait, classed by what there is. What was learnt of the noise stays.
    pub fn finish(&mut self, take: &mut impl FnMut(Quietness, &[AdcCode; GAGES])) {
        self.hand_out_rest(take);
        if let Some(newest) = self.complete.checked_sub(1) {
            let first = self.due.take().unwrap_or((newest + 1).saturating_sub(REACH));
            for number in first..=newest {
                self.release(number, newest);
                self.hand_out_rest(take);
            }
        }
        // Too few for a block: they go with the block before.
        let last = self.complete as usize % WINDOW;
        for codes in self.blocks[last].codes.iter().take(self.filled) {
            take(self.latest, codes);
        }
        (self.complete, self.filled) = (0, 0);
        (self.last, self.repeats) = (None, 0);
    }

    /// Whether this is the sample before, once more; keeps count.
    fn repeats(&mut self, codes: &[AdcCode; GAGES]) -> bool {
        let same = self.last.is_some_and(|(place, number)| self.blocks[place].codes[number] == *codes);
        self.repeats = if same { self.repeats.saturating_add(1) } else { 0 };
        same
    }

    /// Whether so many repetitions in a row are more than the noise allows.
    fn is_suspicious(&self) -> bool {
        self.repeats > ALLOWED_REPEATS && self.noise > 0.0 && self.noise >= self.noise_level(UNREPEATABLE)
    }

    /// The noise level that noise of this variance gives, in steps of the codes.
    fn noise_level(&self, variance: f32) -> f32 {
        let step = self.step as f32;
        LOW_TENTH * CURVATURE_OF_NOISE * GAGES as f32 * variance * step * step
    }

    /// Classes block `number`, whose samples go out next.
    fn release(&mut self, number: u32, newest: u32) {
        let class = self.class(number, newest);
        self.classed = self.classed.saturating_add(1);
        if class != self.latest {
            self.changes = self.changes.saturating_add(1);
            self.rests = self.rests.saturating_add(u32::from(class == Quietness::Still));
        }
        self.latest = class;
        let place = number as usize % WINDOW;
        let block = &self.blocks[place];
        if class == Quietness::Still {
            self.rest_noise.take(&block.codes);
        }
        let mut quietness = class;
        if block.off_magnitude && class != Quietness::Fast {
            self.off_magnitude = self.off_magnitude.saturating_add(BLOCK_SAMPLES);
            quietness = Quietness::Fast;
        }
        self.handing_out = HandingOut { place, next: 0, quietness };
    }

    fn hand_out_next(&mut self, take: &mut impl FnMut(Quietness, &[AdcCode; GAGES])) {
        let HandingOut { place, next, quietness } = &mut self.handing_out;
        if let Some(codes) = self.blocks[*place].codes.get(*next) {
            *next += 1;
            take(*quietness, codes);
        }
    }

    fn hand_out_rest(&mut self, take: &mut impl FnMut(Quietness, &[AdcCode; GAGES])) {
        while self.handing_out.next < BLOCK {
            self.hand_out_next(take);
        }
    }

    fn block(&self, number: u32) -> &Block<GAGES> {
        &self.blocks[number as usize % WINDOW]
    }

    fn block_mut(&mut self, number: u32) -> &mut Block<GAGES> {
        &mut self.blocks[number as usize % WINDOW]
    }

    fn class(&mut self, number: u32, newest: u32) -> Quietness {
        let (first, last) = (number.saturating_sub(REACH), (number + REACH).min(newest));
        let (mut change, mut unrest) = (0.0, 0.0);
        for j in first + 1..=last {
            let step = self.block(j).step;
            unrest += step;
            if j == number || j == number + 1 {
                change += step;
            }
        }
        let travel = self.block(last).distance(self.block(first));
        let curvature = [number.saturating_sub(1), number, (number + 1).min(newest)]
            .map(|number| self.block(number).curvature);
        self.follow_noise(curvature.iter().sum());
        let noise = self.noise.max(self.noise_level(ROUNDING));
        let seen_whole = last - first == 2 * REACH;
        if seen_whole && change + travel <= STILL * noise && unrest <= 2.0 * STILL * noise {
            Quietness::Still
        } else if self.is_calmer_half(change) {
            Quietness::Slow
        } else {
            Quietness::Fast
        }
    }

    fn follow_noise(&mut self, curvature: f32) {
        if self.noise <= 0.0 {
            // Of a converter that hangs from the first sample on, nothing is learnt.
            self.noise = curvature;
            return;
        }
        self.noise *= if curvature < self.noise { NOISE_DOWN } else { NOISE_UP };
        self.noise = self.noise.max(self.noise_level(ROUNDING));
    }

    fn is_calmer_half(&mut self, change: f32) -> bool {
        if self.moving == 0 {
            self.usual_change = change;
        }
        self.moving = self.moving.saturating_add(1);
        let step = (1.0 / (1.0 + self.moving as f32)).max(LEAST_STEP);
        let calmer = change <= self.usual_change;
        self.usual_change *= if calmer { 1.0 - step / 2.0 } else { 1.0 + step / 2.0 };
        calmer
    }
}

#[cfg(test)]
mod tests {
    use super::{BLOCK, Gate};
    use crate::units::AdcCode;

    #[test]
    fn repetitions_are_counted_across_blocks_and_saturated_samples_and_end_with_the_trial() {
        let codes = |counts: i64| [AdcCode::saturating(counts), AdcCode::saturating(-counts)];
        let mut gate = Gate::<2>::new();
        let mut repeats_after = |codes: [AdcCode; 2], is_saturated: bool| {
            gate.offer(&codes, is_saturated, &mut |_, _| {});
            gate.repeats
        };
        for sample in 0..3 * BLOCK {
            assert_eq!(repeats_after(codes(100), false) as usize, sample);
        }
        assert_eq!(repeats_after(codes(101), false), 0);
        assert_eq!(repeats_after([AdcCode::MAX, AdcCode::ZERO], true), 0);
        assert_eq!(repeats_after(codes(101), false), 1);
        assert_eq!(repeats_after(codes(100), false), 0);
        gate.finish(&mut |_, _| {});
        gate.offer(&codes(100), false, &mut |_, _| {});
        assert_eq!(gate.repeats, 0);
    }
}
