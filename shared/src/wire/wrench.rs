//! Wrenches on the line: runs of consecutive samples in one frame.
//!
//! A frame says once what its samples have in common: where they stand in the sequence, when they were taken, by which
//! calibration they were made or why they are no wrenches, how old they are and how the sensor is. Framing, status, time and
//! integrity together cost at most 60 bytes, so that a full frame of six axes is at most 17 % longer than its numbers, and 8000
//! samples/s take 168 kB/s of the 200 kB/s that 2 Mbaud carry.
//!
//! # Numbers in blocks
//!
//! Each axis has one exponent e a frame, the least for which every |x| < 2ᵉ, and each number a mantissa of 24 bits with sign:
//! x ≈ mantissa · 2ᵉ⁻²³. The error is at most half a unit, 2ᵉ⁻²⁴. As 2ᵉ⁻¹ is at most the axis' largest value in the frame,
//! **no number is off by more than 2⁻²³ of that value**, as fine
//! as the converter's codes.
//!
//! Not every number of single precision can be sent: infinities, what is no number, and anything from 2¹²⁷ on
//! ([`PackedWrenches::can_hold`]). The sensor declares such samples invalid.
//!
//! # What there is no number for
//!
//! A sample that is no wrench is never part of a run of wrenches. Runs of such samples carry the cause and no numbers at all, so
//! there is nothing to be mistaken for a wrench; what did not fit on the line is a gap in the sequence.

use serde::{Deserialize, Serialize};

use super::report::InvalidCause;
use crate::units::{DeviceTime, MAX_DOF, SampleIndex};

/// The most samples in one frame: 2.5 ms of 8000 samples/s.
pub const MAX_RUN: usize = 20;

/// Bytes of one number.
const MANTISSA: usize = 3;

/// The largest mantissa. Its negative counterpart −2²³ is never sent.
const LARGEST_MANTISSA: u32 = (1 << 23) - 1;

/// The least exponent: below it, numbers of single precision are whole multiples of the unit already.
const LEAST_EXPONENT: i8 = -126;

/// The bit of a single-precision number's sign.
const SIGN: u32 = 1 << (u32::BITS - 1);

/// Bits of a single-precision number below its exponent.
const FRACTION_BITS: u32 = f32::MANTISSA_DIGITS - 1;

/// The first number that does not fit, 2¹²⁷, as single precision without its sign.
const TOO_LARGE: u32 = 254 << FRACTION_BITS;

/// A run of consecutive samples: all wrenches made with one calibration, or all none for one cause.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WrenchFrame {
    /// Number of the first sample: that of the conversion that completed it.
    pub first: SampleIndex,
    /// What the number grows by from one sample to the next.
    pub stride: u8,
    /// When the first sample was taken.
    pub time: DeviceTime,
    /// Time from the first sample to the last; the others are evenly spaced between them, give or take half a period.
    pub span_micros: u32,
    /// How old the last sample is: from the announcement of its conversion to this frame's way onto the line.
    pub age_micros: u32,
    /// The low 16 bits of the sensor's status word; a bit is set that was set at any sample of the run.
    pub status: u16,
    /// The sensor's temperature, hundredths of a degree Celsius; `None` where the board does not measure it.
    pub temperature_centi_celsius: Option<i16>,
    /// The samples.
    pub run: Run,
}

/// The samples of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Run {
    /// Wrenches.
    Valid {
        /// Identity of the calibration that they were made with.
        calibration: u32,
        /// The largest χ² of the parity channels among them; `None` where there are no parity channels.
        parity: Option<f32>,
        /// Newton and newton metre in the sensor frame, in the order of the calibration's axes.
        wrenches: PackedWrenches,
    },
    /// No wrenches.
    Invalid {
        /// Why not.
        cause: InvalidCause,
        /// How many samples; zero where there are no conversions to number, and the sensor only says why.
        samples: u8,
    },
}

/// Wrenches as one exponent an axis and mantissas.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PackedWrenches {
    /// e of each axis (m).
    exponents: heapless::Vec<i8, MAX_DOF>,
    /// Sample by sample, axis by axis, little-endian in two's complement.
    mantissas: heapless::Vec<u8, { MAX_RUN * MAX_DOF * MANTISSA }>,
}

impl PackedWrenches {
    /// Whether this wrench can be sent.
    pub fn can_hold(wrench: &[f32; MAX_DOF]) -> bool {
        // What is too large reaches the sign's bit. Written out: the compiler unrolls nothing where it is to save room.
        let [a, b, c, d, e, f] = wrench;
        let beyond = |component: &f32| component.abs().to_bits() + (SIGN - TOO_LARGE);
        (beyond(a) | beyond(b) | beyond(c) | beyond(d) | beyond(e) | beyond(f)) & SIGN == 0
    }

    /// Packs the first `axes` components of each wrench. `None` where there are more than [`MAX_RUN`] wrenches, more than
    /// [`MAX_DOF`] axes, or a component that [`PackedWrenches::can_hold`] excludes.
    pub fn pack(axes: usize, wrenches: &[[f32; MAX_DOF]]) -> Option<Self> {
        let mut packed = Self::default();
        for axis in 0..axes {
            let sizes =
                wrenches.iter().map(|wrench| wrench.get(axis).map_or(TOO_LARGE, |x| x.abs().to_bits()));
            packed.exponents.push(exponent(sizes.max().unwrap_or(0))?).ok()?;
        }
        for wrench in wrenches {
            for (component, exponent) in wrench.iter().zip(&packed.exponents) {
                let [low, middle, high, _] = mantissa(*component, *exponent).to_le_bytes();
                packed.mantissas.extend_from_slice(&[low, middle, high]).ok()?;
            }
        }
        Some(packed)
    }

    /// The number of axes m.
    pub fn axes(&self) -> usize {
        self.exponents.len()
    }

    /// The number of wrenches, or `None` where the bytes are not a whole number of wrenches, which no sensor sends.
    pub fn count(&self) -> Option<usize> {
        let bytes = self.axes() * MANTISSA;
        let whole = bytes > 0 && self.mantissas.len().is_multiple_of(bytes);
        whole.then(|| self.mantissas.len() / bytes)
    }

    /// The wrenches, components beyond the axes zero.
    pub fn wrenches(&self) -> impl Iterator<Item = [f32; MAX_DOF]> {
        self.mantissas.chunks_exact((self.axes() * MANTISSA).max(1)).map(|bytes| {
            let mut wrench = [0.0; MAX_DOF];
            let mantissas = bytes.chunks_exact(MANTISSA);
            for ((component, mantissa), exponent) in wrench.iter_mut().zip(mantissas).zip(&self.exponents) {
                *component = number(mantissa, *exponent);
            }
            wrench
        })
    }
}

/// The least e with |x| < 2ᵉ, for |x| given as the bits of a single-precision number; `None` where that is 2¹²⁷ or more.
fn exponent(size: u32) -> Option<i8> {
    if size >= TOO_LARGE {
        return None;
    }
    // The biased exponent is that of a number from 1 on, below 2.
    let biased = size >> FRACTION_BITS;
    i8::try_from(biased.cast_signed() + i32::from(LEAST_EXPONENT)).ok()
}

/// x · 2²³⁻ᵉ, rounded to the nearest.
fn mantissa(x: f32, exponent: i8) -> i32 {
    let size = x.abs().to_bits();
    let biased = size >> FRACTION_BITS;
    let fraction = size & ((1 << FRACTION_BITS) - 1);
    // Subnormal numbers have no leading one, and the exponent of the least normal ones.
    let significand = if biased == 0 { fraction } else { fraction | (1 << FRACTION_BITS) };
    let own = biased.max(1).cast_signed() + i32::from(LEAST_EXPONENT);
    // Units of the significand are 2^(own − 24), those of the mantissa 2^(e − 23).
    let shift = (i32::from(exponent) + 1 - own).cast_unsigned();
    let rounded = match shift {
        0 => significand,
        1..=24 => (significand + (1 << (shift - 1))) >> shift,
        _ => 0,
    };
    let size = rounded.min(LARGEST_MANTISSA).cast_signed();
    if x.is_sign_negative() { -size } else { size }
}

/// mantissa · 2ᵉ⁻²³, exactly.
fn number(mantissa: &[u8], exponent: i8) -> f32 {
    let &[low, middle, high] = mantissa else { return f32::NAN };
    let mantissa = i32::from_le_bytes([0, low, middle, high]) >> 8;
    let biased = i64::from(exponent) - i64::from(FRACTION_BITS) + i64::from(f64::MAX_EXP - 1);
    let unit = f64::from_bits(biased.cast_unsigned() << (f64::MANTISSA_DIGITS - 1));
    #[expect(clippy::cast_possible_truncation, reason = "23 bits from 2⁻¹⁴⁹ up: single precision holds them")]
    {
        (f64::from(mantissa) * unit) as f32
    }
}

#[cfg(test)]
mod tests;
