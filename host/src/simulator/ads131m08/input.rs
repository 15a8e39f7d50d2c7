//! From the voltage at a channel's pins to its code (datasheet sections 8.3.2, 8.3.3, 8.3.9 and 8.3.11).
//!
//! The input selection picks the pins, a short circuit or a test signal; the amplifier multiplies by its gain; full
//! scale is ± the reference of 1.2 V after the amplifier, at 2²³ codes; the result clips at the ends of 24 bits; then
//! the offset correction is subtracted and the gain correction (2²³ is one) multiplies. Only a floating-point rounding
//! to the nearest code happens on the way: an input of a whole number of codes comes out as that number.

use ftcal_shared::units::{AdcCode, Gain};

/// The internal reference: full scale after the amplifier, volt.
pub const REFERENCE_VOLTS: f64 = 1.2;

/// Codes from zero to full scale.
const FULL_SCALE_CODES: f64 = 8_388_608.0;

/// What the amplifier sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum InputSelection {
    /// The channel's own pins.
    Pins,
    /// A short circuit: zero.
    Shorted,
    /// 2/15 of the reference, divided by the gain.
    PositiveTestSignal,
    /// The same with the opposite sign.
    NegativeTestSignal,
}

/// How one channel treats its input.
#[derive(Clone, Copy, Debug)]
pub(super) struct InputSettings {
    /// What the amplifier sees.
    pub(super) selection: InputSelection,
    /// The amplifier's gain.
    pub(super) gain: Gain,
    /// Subtracted from the code.
    pub(super) offset_correction: i32,
    /// Multiplies the code; 2²³ is one.
    pub(super) gain_correction: u32,
}

impl InputSettings {
    /// The code of this voltage between the channel's pins.
    pub(super) fn convert(&self, pin_volts: f64) -> AdcCode {
        let amplified = match self.selection {
            InputSelection::Pins => pin_volts * f64::from(self.gain.factor()),
            InputSelection::Shorted => 0.0,
            InputSelection::PositiveTestSignal => REFERENCE_VOLTS * 2.0 / 15.0,
            InputSelection::NegativeTestSignal => -REFERENCE_VOLTS * 2.0 / 15.0,
        };
        let raw = nearest_code(amplified * (FULL_SCALE_CODES / REFERENCE_VOLTS));
        let corrected =
            (i64::from(raw.counts()) - i64::from(self.offset_correction)) * i64::from(self.gain_correction);
        AdcCode::saturating(corrected >> 23)
    }
}

/// The code nearest to this many counts; not a number reads as zero.
fn nearest_code(counts: f64) -> AdcCode {
    #[expect(clippy::cast_possible_truncation, reason = "the cast saturates, and so does the code")]
    AdcCode::saturating(counts.round() as i64)
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{AdcCode, Gain};

    use super::{FULL_SCALE_CODES, InputSelection, InputSettings, REFERENCE_VOLTS};

    fn pins(gain: Gain) -> InputSettings {
        InputSettings {
            selection: InputSelection::Pins,
            gain,
            offset_correction: 0,
            gain_correction: 1 << 23,
        }
    }

    #[test]
    fn whole_codes_come_back_at_every_gain() {
        for gain in Gain::ALL {
            for code in [-8_388_608, -1_234_567, -1, 0, 1, 77, 8_388_607] {
                let volts = f64::from(code) * REFERENCE_VOLTS / FULL_SCALE_CODES / f64::from(gain.factor());
                assert_eq!(pins(gain).convert(volts).counts(), code);
            }
        }
    }

    #[test]
    fn beyond_full_scale_the_code_clips_at_24_bits() {
        for gain in Gain::ALL {
            let full_scale = REFERENCE_VOLTS / f64::from(gain.factor());
            for excess in [1.0, 1.001, 10.0, f64::INFINITY] {
                assert_eq!(pins(gain).convert(full_scale * excess), AdcCode::MAX);
                assert_eq!(pins(gain).convert(-full_scale * excess), AdcCode::MIN);
            }
        }
    }

    #[test]
    fn the_offset_is_subtracted_before_the_gain_multiplies() {
        let settings = InputSettings { offset_correction: 1000, gain_correction: 3 << 22, ..pins(Gain::X1) };
        let volts = 5000.0 * REFERENCE_VOLTS / FULL_SCALE_CODES;
        assert_eq!(settings.convert(volts).counts(), 6000, "(5000 − 1000) · 1.5");
    }

    #[test]
    fn the_other_inputs_do_not_see_the_pins() {
        let with = |selection| InputSettings { selection, ..pins(Gain::X128) }.convert(0.005).counts();
        assert_eq!(with(InputSelection::Shorted), 0);
        assert_eq!(with(InputSelection::PositiveTestSignal), -with(InputSelection::NegativeTestSignal));
        assert!(with(InputSelection::PositiveTestSignal) > 0);
    }
}
