//! The gages held against each other, sample by sample and in the mean (design § 8).
//!
//! | statistic of the parity π | over | finds | within |
//! |---|---|---|---|
//! | ‖π‖² | one sample | what is far off: an open input, a jump | the sample |
//! | the same, running mean | 8 samples | more noise than there was | about 8 samples |
//! | mean of ππᵀ over block means π̄ | a quarter second | drift, a gage that has come off or died; says which | half a second |
//!
//! # What is allowed
//!
//! Each statistic is compared with t(noise) + [`TOLERANCE`]² + ([`MODEL_TOLERANCE`]·‖z − b‖)².
//!
//! *Noise* is measured here, from differences of successive parities, which neither the load nor a drift moves. It is therefore that of
//! this rate, this gain and this cable, which a calibration cannot know; but a sensor whose gage is noisy from the first second on
//! takes that for its noise. It is learned from [`LEARNING`] samples, anew where one of them makes up a fourth of it, then followed slowly, and not at all while the gages contradict
//! each other. What is kept is its trace over all redundant directions, σ²: the gages are not equally noisy, and a sum of squares has
//! its heaviest tail where all noise is in one direction, so limits from the χ² of one degree of freedom hold for every sensor.
//! Chance alone exceeds 36σ² once in 5·10⁸ samples, the running mean 6σ² (about that of 15 squares) in 10¹² and a window's 5σ²/n
//! (16 squares) in 10¹⁰ windows, which is a false alarm in a week of samples at 1000/s, and a sample lost by it, no more.
//!
//! *Tolerance* is what a gage's zero may wander with temperature: a thousandth of the converter's range.
//! *Model tolerance* is what a calibration, or a gage that is not quite linear, may be off by, as a share of the signal: four times the
//! thousandth that the host counts on.
//!
//! # Which gage
//!
//! A gage that is off alone moves π along its column of B ([`ParitySpace`]). What the window's moments have beside that column must then
//! be no more than is allowed. Every gage of which that is true is a **suspect**: one is named, several cannot be told apart (parallel
//! columns, or a fault too small), and none means that no single gage explains it. The column itself is known to
//! [`COLUMN_TOLERANCE`].
//!
//! # Cost
//!
//! Per sample p − m dot products and a few operations; at the end of a block the outer product and one gage of the verdict, so that no
//! sample bears much. One division a block.

use ftcal_shared::estimation::parity::{LEAST_SHARE, ParitySpace};
use ftcal_shared::units::DataRate;
use ftcal_shared::wire::ParityReport;
use libm::sqrtf;

/// What a gage's zero may wander by, counts: 2⁻¹⁰ of the range.
const TOLERANCE: f32 = 8192.0;

/// What shape and linearity may be off by, relative to the signal.
const MODEL_TOLERANCE: f32 = 4e-3;

/// How far a gage's direction in the parity space may be off, relative: what is unknown of the shape, over a share of a tenth.
const COLUMN_TOLERANCE: f32 = 0.02;

/// Noise in one sample, in the running mean and in a window, over σ².
const SAMPLE_LIMIT: f32 = 36.0;
const RUNNING_LIMIT: f32 = 6.0;
const WINDOW_LIMIT: f32 = 5.0;

/// Weight of one sample in the running mean.
const RUNNING_WEIGHT: f32 = 1.0 / 8.0;

/// Differences from which the noise is first learned.
const LEARNING: u32 = 128;

/// The largest part that one difference may have in what is learned first: of noise, one in a hundred million has as much, and a glitch of
/// more than eight standard deviations has more.
const LARGEST_PART: f32 = 0.25;

/// Weight of one difference, one a block, in the noise followed: about four seconds.
const NOISE_WEIGHT: f32 = 1.0 / 256.0;

/// The largest part of a difference that counts, over σ²: a glitch is not noise.
const LARGEST_DIFFERENCE: f32 = 16.0;

/// Variance of the rounding to whole counts.
const LEAST_VARIANCE: f32 = 1.0 / 12.0;

/// Blocks a second, and in a window.
const BLOCKS_PER_SECOND: u32 = 64;
const WINDOW: u32 = 16;

/// The fewest samples in a block.
const LEAST_BLOCK: u32 = 4;

/// The monitor of one calibration.
pub(super) struct ParityMonitor<const GAGES: usize> {
    space: ParitySpace<GAGES>,
    /// Samples in a block.
    block: u32,
    /// One over that.
    per_block: f32,
    noise: Noise,
    allowed: Allowed,
    /// π of the sample before, if there was one.
    last: [f32; GAGES],
    has_last: bool,
    running: f32,
    sum: [f32; GAGES],
    summed: u32,
    window: Window<GAGES>,
    verdict: Verdict<GAGES>,
}

/// What one sample says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Judged {
    /// The gages contradict each other by more than is allowed.
    pub(super) contradicts: bool,
    /// ‖π‖²/σ²; zero until σ² is known.
    pub(super) chi_square: f32,
}

/// σ², counts², and one over it once it is known.
struct Noise {
    variance: f32,
    per_variance: f32,
    learned: u32,
    /// The largest square of those that it is first learned from.
    largest: f32,
}

/// Limits before the signal's share, counts².
struct Allowed {
    sample: f32,
    running: f32,
}

/// Second moments of block means: the sum of π̄π̄ᵀ (q × q).
struct Window<const GAGES: usize> {
    moments: [[f32; GAGES]; GAGES],
    blocks: u32,
    /// The largest ‖z − b‖² at the end of a block, counts².
    signal: f32,
}

/// What the last window says, gage by gage as its blocks end.
struct Verdict<const GAGES: usize> {
    /// The mean moments under judgement.
    moments: [[f32; GAGES]; GAGES],
    total: f32,
    allowed: f32,
    /// The next gage to be judged; `GAGES` when all are.
    next: usize,
    /// The suspects so far.
    found: u16,
    /// The least that remains beside a gage's direction, and by how much that gage is off.
    best: (f32, f32),
    /// Of the last window that was judged to its end.
    suspects: u16,
    off_counts: f32,
}

impl Noise {
    const UNKNOWN: Self = Self { variance: 0.0, per_variance: 0.0, learned: 0, largest: 0.0 };
}

impl<const GAGES: usize> Window<GAGES> {
    const EMPTY: Self = Self { moments: [[0.0; GAGES]; GAGES], blocks: 0, signal: 0.0 };
}

impl<const GAGES: usize> Verdict<GAGES> {
    const NONE: Self = Self {
        moments: [[0.0; GAGES]; GAGES],
        total: 0.0,
        allowed: 0.0,
        next: GAGES,
        found: 0,
        best: (f32::INFINITY, 0.0),
        suspects: 0,
        off_counts: 0.0,
    };
}

impl<const GAGES: usize> ParityMonitor<GAGES> {
    /// Watches this space at this rate; `None` where nothing is redundant.
    pub(super) fn new(space: ParitySpace<GAGES>, rate: DataRate) -> Option<Self> {
        let block = (rate.hertz() / BLOCKS_PER_SECOND).max(LEAST_BLOCK);
        (space.redundant() > 0).then(|| Self {
            space,
            block,
            per_block: 1.0 / block as f32,
            noise: Noise::UNKNOWN,
            allowed: Allowed { sample: f32::INFINITY, running: f32::INFINITY },
            last: [0.0; GAGES],
            has_last: false,
            running: 0.0,
            sum: [0.0; GAGES],
            summed: 0,
            window: Window::EMPTY,
            verdict: Verdict::NONE,
        })
    }

    /// The space that is watched.
    pub(super) const fn space(&self) -> &ParitySpace<GAGES> {
        &self.space
    }

    /// The space, to be watched anew.
    pub(super) fn into_space(self) -> ParitySpace<GAGES> {
        self.space
    }

    /// Whether the noise is known, so that anything is judged.
    pub(super) const fn is_watching(&self) -> bool {
        self.noise.learned >= LEARNING
    }

    /// Whether the last window contradicts itself.
    pub(super) fn is_suspicious(&self) -> bool {
        self.verdict.total > self.verdict.allowed
    }

    /// Takes in one signal, and judges it.
    pub(super) fn judge(&mut self, signal: &[f32; GAGES]) -> Judged {
        let (mut squared, mut change, mut of_signal) = (0.0, 0.0, 0.0);
        let ((sums, _), (lasts, _)) = (self.sum.as_chunks_mut::<2>(), self.last.as_chunks_mut::<2>());
        let pairs = self.space.pairs().iter().zip(sums).zip(lasts);
        for ((pair, [sum_a, sum_b]), [last_a, last_b]) in pairs {
            let [a, b, of_all] = products(pair, signal);
            of_signal = of_all;
            squared += a * a + b * b;
            let (change_a, change_b) = (a - *last_a, b - *last_b);
            change += change_a * change_a + change_b * change_b;
            *sum_a += a;
            *sum_b += b;
            (*last_a, *last_b) = (a, b);
        }
        let of_model = MODEL_TOLERANCE * MODEL_TOLERANCE * of_signal;
        let allowed = self.allowed.sample + of_model;
        let is_beyond = squared > allowed;
        let counted = if is_beyond { allowed } else { squared };
        self.running += RUNNING_WEIGHT * (counted - self.running);
        let contradicts = is_beyond || self.running > self.allowed.running + of_model;
        if !contradicts && (self.summed == 1 || !self.is_watching()) {
            self.learn(change);
        }
        self.summed += 1;
        if self.summed == self.block {
            self.end_block(of_signal);
        }
        Judged { contradicts, chi_square: squared * self.noise.per_variance }
    }

    /// What is to be told.
    pub(super) fn report(&self) -> ParityReport {
        let redundant = self.space.redundant();
        #[expect(clippy::cast_possible_truncation, reason = "at most ten")]
        let count = redundant as u8;
        ParityReport {
            redundant: count,
            watched: self.space.watched(),
            noise_counts: self.is_watching().then(|| sqrtf(self.noise.variance / redundant as f32)),
            disagreement_counts: sqrtf(self.verdict.total),
            allowed_counts: sqrtf(self.verdict.allowed),
            suspects: self.verdict.suspects,
            suspect_off_counts: self.verdict.off_counts,
        }
    }

    /// Half the squared change from one parity to the next has the mean σ².
    #[inline(never)]
    fn learn(&mut self, squared: f32) {
        if !self.has_last {
            self.has_last = true;
            return;
        }
        let Noise { variance, per_variance, learned, largest } = &mut self.noise;
        if *learned < LEARNING {
            *learned += 1;
            *largest = largest.max(squared / 2.0);
            // Up to LEARNING divisions after a calibration came; from then on there are none.
            *variance += (squared / 2.0 - *variance) / *learned as f32;
            if *learned < LEARNING {
                return;
            }
            if *largest > LARGEST_PART * LEARNING as f32 * *variance {
                self.noise = Noise::UNKNOWN;
                return;
            }
            self.running = *variance;
        } else {
            let (counted, most) = (squared / 2.0, LARGEST_DIFFERENCE * *variance);
            *variance += NOISE_WEIGHT * (if counted < most { counted } else { most } - *variance);
        }
        // Codes are rounded: their noise is not less than that of rounding.
        *variance = variance.max(LEAST_VARIANCE);
        *per_variance = 1.0 / *variance;
        self.allowed.sample = SAMPLE_LIMIT * *variance + TOLERANCE * TOLERANCE;
        self.allowed.running = RUNNING_LIMIT * *variance + TOLERANCE * TOLERANCE;
    }

    #[inline(never)]
    fn end_block(&mut self, of_signal: f32) {
        let redundant = self.space.redundant();
        let watching = self.is_watching();
        let (sums, _) = self.sum.split_at_mut_checked(redundant).unwrap_or_default();
        for sum in &mut *sums {
            *sum *= self.per_block;
        }
        if watching {
            for (row, one) in self.window.moments.iter_mut().zip(&*sums) {
                for (moment, other) in row.iter_mut().zip(&*sums) {
                    *moment += one * other;
                }
            }
        }
        sums.fill(0.0);
        self.summed = 0;
        if !watching {
            return;
        }
        self.judge_next();
        if of_signal > self.window.signal {
            self.window.signal = of_signal;
        }
        self.window.blocks += 1;
        if self.window.blocks == WINDOW {
            self.end_window();
        }
    }

    fn end_window(&mut self) {
        const PER_WINDOW: f32 = 1.0 / WINDOW as f32;
        let redundant = self.space.redundant();
        let Window { moments: summed, blocks, signal } = &mut self.window;
        let Verdict { moments, total, allowed, next, found, best, suspects, off_counts } = &mut self.verdict;
        *total = 0.0;
        for (direction, (row, summed)) in moments.iter_mut().zip(summed).enumerate().take(redundant) {
            for (moment, sum) in row.iter_mut().zip(&mut *summed).take(redundant) {
                *moment = *sum * PER_WINDOW;
                *sum = 0.0;
            }
            *total += row[direction];
        }
        *allowed = WINDOW_LIMIT * self.noise.variance * self.per_block
            + TOLERANCE * TOLERANCE
            + MODEL_TOLERANCE * MODEL_TOLERANCE * *signal;
        (*blocks, *signal) = (0, 0.0);
        (*found, *best) = (0, (f32::INFINITY, 0.0));
        if *total > *allowed {
            *next = 0;
        } else {
            (*next, *suspects, *off_counts) = (GAGES, 0, 0.0);
        }
    }

    /// Judges one gage more, if one is left.
    fn judge_next(&mut self) {
        let gage = self.verdict.next;
        if gage >= GAGES {
            return;
        }
        let share = self.space.share(gage);
        if share >= LEAST_SHARE {
            let along = self.along(gage);
            let Verdict { total, allowed, found, best, .. } = &mut self.verdict;
            // Rather than to divide by the share, both sides are taken times it.
            let beside = *total * share - along;
            if beside <= (*allowed + COLUMN_TOLERANCE * COLUMN_TOLERANCE * *total) * share {
                *found |= 1 << gage;
                if beside < best.0 * share {
                    *best = (beside / share, sqrtf(along) / share);
                }
            }
        }
        self.verdict.next += 1;
        if self.verdict.next == GAGES {
            self.verdict.suspects = self.verdict.found;
            self.verdict.off_counts = if self.verdict.found == 0 { 0.0 } else { self.verdict.best.1 };
        }
    }

    /// b_kᵀMb_k of the moments M under judgement and the column b_k of B, counts².
    fn along(&self, gage: usize) -> f32 {
        let mut along = 0.0;
        for (moments, row) in self.verdict.moments.iter().zip(self.space.basis()) {
            let mut inner = 0.0;
            for (moment, other) in moments.iter().zip(self.space.basis()) {
                inner += moment * other[gage];
            }
            along += row[gage] * inner;
        }
        along
    }
}

/// The products of a signal with two rows, and with itself. Four gages at a time, written out: the compiler unrolls nothing where
/// it is to save room.
#[inline]
fn products<const GAGES: usize>([a, b]: &[[f32; GAGES]; 2], signal: &[f32; GAGES]) -> [f32; 3] {
    let ((a_fours, a_rest), (b_fours, b_rest)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let (fours, rest) = signal.as_chunks::<4>();
    let (mut with_a, mut with_b, mut with_itself) = (0.0, 0.0, 0.0);
    for ((a, b), four) in a_fours.iter().zip(b_fours).zip(fours) {
        let ([a0, a1, a2, a3], [b0, b1, b2, b3], [s0, s1, s2, s3]) = (a, b, four);
        with_a += a0 * s0;
        with_b += b0 * s0;
        with_itself += s0 * s0;
        with_a += a1 * s1;
        with_b += b1 * s1;
        with_itself += s1 * s1;
        with_a += a2 * s2;
        with_b += b2 * s2;
        with_itself += s2 * s2;
        with_a += a3 * s3;
        with_b += b3 * s3;
        with_itself += s3 * s3;
    }
    for ((a, b), s) in a_rest.iter().zip(b_rest).zip(rest) {
        with_a += a * s;
        with_b += b * s;
        with_itself += s * s;
    }
    [with_a, with_b, with_itself]
}
