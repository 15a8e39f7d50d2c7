//! Local gravity: how strongly a mass pulls, and how well that is known.
//!
//! Shape from motion turns a weight, so that an error of local gravity is one of every force and torque, in the same ratio.
//! It is common to all trials: no number of them averages it out.

/// Standard gravity, m/s².
pub const STANDARD_GRAVITY: f64 = 9.80665;

/// Gravity outside of this is a slip of the unit, m/s².
pub const POSSIBLE: std::ops::RangeInclusive<f64> = 1.0..=30.0;

/// Standard deviation of local gravity about the standard one, m/s²: from the equator to the poles it goes from 9.780 to
/// 9.832, which is 0.052/√12 if every place in between is as likely.
const ANYWHERE: f64 = 0.015;

/// A formula of latitude and height misses local gravity by about half of this (its anomalies); so does whoever looks it up.
const LOOKED_UP: f64 = 0.001;

/// No gravity is believed to be known better than this, m/s²: what a gravimeter in the field tells.
const BEST_ACCURACY: f64 = 1e-5;

/// Local gravity with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity {
    /// Its magnitude, m/s².
    pub magnitude: f64,
    /// The standard deviation of that, m/s².
    pub accuracy: f64,
}

impl Gravity {
    /// Where nobody says where on Earth.
    pub const ASSUMED: Self = Self { magnitude: STANDARD_GRAVITY, accuracy: ANYWHERE };

    /// Gravity that somebody states, and its accuracy if he states that, too.
    ///
    /// Of a number alone, half a unit of its last decimal is taken for the standard deviation: nobody who writes 9.81 means
    /// 9.8100. The standard's own number is nobody's local gravity.
    pub fn stated(magnitude: f64, accuracy: Option<f64>) -> Self {
        let accuracy = match accuracy {
            Some(accuracy) => accuracy.max(BEST_ACCURACY),
            None if magnitude == STANDARD_GRAVITY => ANYWHERE,
            None => half_unit_of_last_decimal(magnitude).clamp(LOOKED_UP, ANYWHERE),
        };
        Self { magnitude, accuracy }
    }

    /// The standard deviation, relative.
    pub fn relative_accuracy(self) -> f64 {
        self.accuracy / self.magnitude
    }
}

/// Gravity that is known beyond doubt, as that of a simulation is.
impl From<f64> for Gravity {
    fn from(magnitude: f64) -> Self {
        Self { magnitude, accuracy: 0.0 }
    }
}

/// Half a unit of the last decimal that a number needs.
fn half_unit_of_last_decimal(number: f64) -> f64 {
    let decimals = number.to_string().split_once('.').map_or(0, |(_, decimals)| decimals.len());
    0.5 * 10_f64.powi(-i32::try_from(decimals).unwrap_or(i32::MAX))
}

#[cfg(test)]
mod tests {
    use super::{Gravity, STANDARD_GRAVITY};

    #[test]
    fn what_is_written_with_fewer_decimals_is_known_less_well() {
        let accuracy = |magnitude| Gravity::stated(magnitude, None).accuracy;
        assert!((accuracy(9.81) - 0.005).abs() < 1e-12);
        assert_eq!(accuracy(9.8), Gravity::ASSUMED.accuracy, "no worse than any place on Earth");
        assert_eq!(accuracy(9.0), Gravity::ASSUMED.accuracy);
        assert_eq!(accuracy(9.812), accuracy(9.812_345), "no better than what can be looked up");
        assert!(accuracy(9.812) < accuracy(9.81));
    }

    #[test]
    fn the_standard_is_a_guess_unless_its_accuracy_is_stated() {
        assert_eq!(Gravity::stated(STANDARD_GRAVITY, None), Gravity::ASSUMED);
        assert!(Gravity::stated(STANDARD_GRAVITY, Some(1e-3)).accuracy < Gravity::ASSUMED.accuracy);
        assert!(Gravity::stated(9.81, Some(0.0)).accuracy > 0.0);
    }
}
