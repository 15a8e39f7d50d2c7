//! The divisors that make a baud rate of a clock, or the finding that none does.
//!
//! A USART samples each bit 16 times, or 8 times where the clock is too slow for that, and divides its clock by a whole number
//! of samples: the rate is clock/n with n ≥ 16, or n ≥ 8. What comes out may be off by as much as `LARGEST_ERROR_PER_MILLE`;
//! receiver and sender together may be off by 3.3 % (reference manual RM0090, table 143), and the other end's clock is good to a
//! fraction of a per cent.
//!
//! | clock | 921 600 baud | 1 Mbaud | 2 Mbaud |
//! |---|---|---|---|
//! | 42 MHz, as designed | n = 46, −0.9 % | n = 42, exact | n = 21, exact |
//! | 16 MHz, without the PLL | n = 17, +2.1 % | n = 16, exact | n = 8, exact |

/// The rate that every conversation begins at.
pub const DEFAULT_BAUD: u32 = 921_600;

/// The highest rate that is agreed on.
pub const HIGHEST_BAUD: u32 = 2_000_000;

/// How far a rate may be off.
const LARGEST_ERROR_PER_MILLE: u32 = 25;

/// How a USART makes a rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Divisor {
    /// Samples a bit: 8 instead of 16.
    pub eight_samples: bool,
    /// What the rate register takes: whole periods of 16 or 8 clocks, and a fraction below.
    pub register: u16,
}

/// The divisor for a rate. `None` where the clock cannot be divided to within the allowed error, or the rate is above
/// [`HIGHEST_BAUD`].
pub fn divisor(clock_hertz: u32, baud: u32) -> Option<Divisor> {
    if baud == 0 || baud > HIGHEST_BAUD {
        return None;
    }
    let clocks_per_bit = u16::try_from(clock_hertz.checked_add(baud / 2)? / baud).ok()?;
    let made = u64::from(clocks_per_bit) * u64::from(baud);
    let error = made.abs_diff(u64::from(clock_hertz));
    if error * 1000 > u64::from(LARGEST_ERROR_PER_MILLE) * made {
        return None;
    }
    match clocks_per_bit {
        0..8 => None,
        8..16 => {
            Some(Divisor { eight_samples: true, register: (clocks_per_bit & !7) << 1 | clocks_per_bit & 7 })
        }
        16.. => Some(Divisor { eight_samples: false, register: clocks_per_bit }),
    }
}

#[cfg(test)]
mod tests {
    use super::{DEFAULT_BAUD, Divisor, HIGHEST_BAUD, divisor};

    /// The rate as the reference manual defines it: clock / (8 · (2 − OVER8) · USARTDIV).
    fn rate(clock: u32, divisor: Divisor) -> f64 {
        let (samples, fractions) = if divisor.eight_samples { (8.0, 8.0) } else { (16.0, 16.0) };
        let (whole, fraction) = (divisor.register >> 4, divisor.register & 15);
        assert!(whole >= 1 && f64::from(fraction) < fractions, "{divisor:?}");
        f64::from(clock) / (samples * (f64::from(whole) + f64::from(fraction) / fractions))
    }

    #[test]
    fn a_rate_that_is_promised_is_met() {
        let mut promised = 0;
        for clock in [42_000_000, 16_000_000, 8_000_000, 30_000_000] {
            for baud in (9_600..=2_100_000).step_by(373).chain([DEFAULT_BAUD, 1_000_000, HIGHEST_BAUD]) {
                let Some(divisor) = divisor(clock, baud) else { continue };
                let error = rate(clock, divisor) / f64::from(baud) - 1.0;
                assert!(error.abs() <= 0.025, "{clock} Hz, {baud} baud: {error}");
                assert!(baud <= HIGHEST_BAUD);
                promised += 1;
            }
        }
        assert!(promised > 10_000);
    }

    #[test]
    fn the_rates_of_the_table_are_met_as_it_says() {
        for (clock, baud, error) in [
            (42_000_000, 921_600, -0.0093),
            (42_000_000, 1_000_000, 0.0),
            (42_000_000, 2_000_000, 0.0),
            (16_000_000, 921_600, 0.0212),
            (16_000_000, 1_000_000, 0.0),
            (16_000_000, 2_000_000, 0.0),
        ] {
            let divisor = divisor(clock, baud).expect("the table says so");
            assert!((rate(clock, divisor) / f64::from(baud) - 1.0 - error).abs() < 1e-4, "{divisor:?}");
        }
    }

    #[test]
    fn what_cannot_be_met_is_not_promised() {
        for (clock, baud) in [
            (42_000_000, 0),
            (42_000_000, 3_000_000),
            (8_000_000, 2_000_000),
            (16_000_000, 1_900_000),
            (42_000_000, 1),
            (u32::MAX, 2_000_000),
        ] {
            assert_eq!(divisor(clock, baud), None, "{clock} Hz, {baud} baud");
        }
    }
}
