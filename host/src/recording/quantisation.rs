//! From the counts of a recording to 24-bit codes and back.
//!
//! A recording whose every value is an integer of 24 bits is its own codes: offset 0, one count a code, nothing rounded.
//!
//! Any other recording (decimals, averaged codes, volts, 32-bit integers) is quantised: `code = round((count − offset) /
//! counts_per_code)`, with each channel's mid-range as offset and the smallest power of two as `counts_per_code` for
//! which all channels stay within 24 bits and clear of the two ends. The rounding error, at most half of
//! `counts_per_code`, is below 2⁻²³ of the widest channel's span. Estimates scale back exactly, since they follow an
//! affine change of the codes: bias = offset + `counts_per_code` · bias of the codes, shape and noise times
//! `counts_per_code`, eigenvalues times its square.
//!
//! The two ends of the 24-bit range are the converter's overload indication, not measurements: in a recording that does
//! not leave the 24-bit range they stay the ends, whatever the quantisation, and take no part in choosing it.

use ftcal_shared::units::AdcCode;
use nalgebra::DVector;

/// The ends of the 24-bit range, in counts.
const LOWEST: f64 = -8_388_608.0;
const HIGHEST: f64 = 8_388_607.0;

/// The largest magnitude a quantised value may take: clear of both ends.
const LARGEST_CODE: f64 = HIGHEST - 1.0;

/// Exponent of the finest step: the fourth power of a finer one would come near the smallest numbers that f64 holds.
const FINEST_EXPONENT: f64 = -200.0;

/// How the codes and the counts of a recording belong together: count = offset + `counts_per_code` · code.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantisation {
    offset_counts: DVector<f64>,
    counts_per_code: f64,
    ends_mean_overload: bool,
}

impl Quantisation {
    /// Codes that are counts.
    pub fn exact(gages: usize) -> Self {
        Self { offset_counts: DVector::zeros(gages), counts_per_code: 1.0, ends_mean_overload: true }
    }

    /// The finest quantisation of these finite counts, given as rows of `gages` values.
    pub fn of(gages: usize, counts: &[f64]) -> Self {
        let within_24_bits = counts.iter().all(|count| (LOWEST..=HIGHEST).contains(count));
        if within_24_bits && counts.iter().all(|count| count.fract() == 0.0) {
            return Self::exact(gages);
        }
        let ranges: Vec<(f64, f64)> = (0..gages)
            .map(|gage| {
                let channel = counts.iter().skip(gage).step_by(gages).copied();
                range(channel.filter(|&count| !(within_24_bits && end(count).is_some())))
            })
            .collect();
        let half_span = ranges.iter().map(|(low, high)| (high - low) / 2.0).fold(0.0, f64::max);
        Self {
            offset_counts: DVector::from_iterator(
                gages,
                ranges.iter().map(|&(low, high)| f64::midpoint(low, high)),
            ),
            counts_per_code: finest_step(half_span),
            ends_mean_overload: within_24_bits,
        }
    }

    /// The codes nearest to these counts, given as rows of one value a gage.
    pub fn quantise(&self, counts: &[f64]) -> Vec<AdcCode> {
        let offsets = self.offset_counts.iter().cycle();
        counts.iter().zip(offsets).map(|(&count, &offset)| self.code(count, offset)).collect()
    }

    fn code(&self, count: f64, offset: f64) -> AdcCode {
        if let Some(end) = end(count).filter(|_| self.ends_mean_overload) {
            return end;
        }
        #[expect(clippy::cast_possible_truncation, reason = "`as` saturates, and so does the code")]
        let steps = ((count - offset) / self.counts_per_code).round() as i64;
        AdcCode::saturating(steps)
    }

    /// The counts of one sample's codes.
    pub fn counts(&self, codes: &[AdcCode]) -> DVector<f64> {
        let scaled = codes.iter().map(|code| f64::from(code.counts()) * self.counts_per_code);
        let counts = scaled.zip(self.offset_counts.iter()).map(|(count, offset)| count + offset);
        DVector::from_iterator(codes.len().min(self.offset_counts.len()), counts)
    }

    /// The counts of code zero, one a gage.
    pub const fn offset_counts(&self) -> &DVector<f64> {
        &self.offset_counts
    }

    /// The counts of one step of the codes: a power of two.
    pub const fn counts_per_code(&self) -> f64 {
        self.counts_per_code
    }

    /// Whether codes are counts.
    pub fn is_exact(&self) -> bool {
        *self == Self::exact(self.offset_counts.len())
    }
}

/// The end of the converter's range that this count is.
fn end(count: f64) -> Option<AdcCode> {
    if count <= LOWEST {
        Some(AdcCode::MIN)
    } else if count >= HIGHEST {
        Some(AdcCode::MAX)
    } else {
        None
    }
}

/// Least and greatest of these counts; of none, zero and zero.
fn range(counts: impl Iterator<Item = f64>) -> (f64, f64) {
    let widen = |(low, high): (f64, f64), count: f64| (low.min(count), high.max(count));
    let (low, high) = counts.fold((f64::INFINITY, f64::NEG_INFINITY), widen);
    if low <= high { (low, high) } else { (0.0, 0.0) }
}

/// The smallest power of two that keeps this half span within [`LARGEST_CODE`] steps.
fn finest_step(half_span: f64) -> f64 {
    if half_span <= 0.0 {
        return 1.0;
    }
    let step = (half_span / LARGEST_CODE).log2().ceil().max(FINEST_EXPONENT).exp2();
    // The logarithm may round down to a whole exponent.
    if half_span / step > LARGEST_CODE { step * 2.0 } else { step }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::AdcCode;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::{LARGEST_CODE, Quantisation};

    #[test]
    fn integers_of_24_bits_are_their_own_codes() {
        let counts = [-8_388_608.0, 8_388_607.0, 0.0, -1.0];
        let quantisation = Quantisation::of(2, &counts);
        assert!(quantisation.is_exact());
        let codes = quantisation.quantise(&counts);
        assert!(codes.iter().map(|code| f64::from(code.counts())).eq(counts));
    }

    #[test]
    fn decimals_come_back_within_half_a_step_and_the_step_is_the_finest() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for exponent in [-60, -20, 0, 12, 40] {
            let span = f64::from(exponent).exp2();
            let counts: Vec<f64> =
                (0..60).map(|i| span * (random.random::<f64>() + f64::from(i % 3))).collect();
            let quantisation = Quantisation::of(3, &counts);
            let step = quantisation.counts_per_code();
            assert!((step.log2() - step.log2().round()).abs() < f64::EPSILON, "a power of two");
            let codes = quantisation.quantise(&counts);
            assert!(codes.iter().all(|code| !code.is_saturated()));
            let largest = codes.iter().map(|code| f64::from(code.counts()).abs()).fold(0.0, f64::max);
            assert!(largest > LARGEST_CODE / 2.0 - 1.0, "half the step would not fit");
            for (codes, counts) in codes.chunks(3).zip(counts.chunks(3)) {
                for (back, count) in quantisation.counts(codes).iter().zip(counts) {
                    assert!((back - count).abs() <= 0.5 * step * (1.0 + 1e-6));
                }
            }
        }
    }

    #[test]
    fn the_ends_of_the_range_stay_the_ends_among_decimals() {
        let counts = [8_388_607.0, 0.25, -8_388_608.0, 1000.5];
        let quantisation = Quantisation::of(2, &counts);
        let codes = quantisation.quantise(&counts);
        assert_eq!([codes[0], codes[2]], [AdcCode::MAX, AdcCode::MIN]);
        assert!(quantisation.counts_per_code() < 1e-3, "the ends do not coarsen the step");
    }

    #[test]
    fn integers_beyond_24_bits_are_no_overload() {
        let counts = [8_388_607.0, 1e9, -1e9, -8_388_608.0];
        let codes = Quantisation::of(2, &counts).quantise(&counts);
        assert!(codes.iter().all(|code| !code.is_saturated()));
    }
}
