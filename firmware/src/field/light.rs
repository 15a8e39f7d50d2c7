//! The light: what it shows, and when it is on for that.
//!
//! Each pattern has sixteen slots of about an eighth of a second, and begins anew every 2.1 s:
//!
//! | pattern | the light | meaning |
//! |---|---|---|
//! | `................` | off | nothing is going on |
//! | `########........` | slowly on and off | at work: getting ready, computing, or about to store |
//! | `#...............` | one flash | the trial runs: turn the load |
//! | `#.#.............` | two flashes | …a quarter of the way |
//! | `#.#.#...........` | three flashes | …half of the way |
//! | `#.#.#.#.........` | four flashes | …three quarters of the way: a press gets an answer now; at its end it stops by itself |
//! | `################` | on | the sensor has moved: a new calibration is in use, and kept |
//! | `#####.#.########` | on, with two gaps | the sensor has not moved: it keeps the calibration that it has |
//! | `#.#.#.#.#.#.#.#.` | flickers without a pause | refused: it keeps the calibration that it has; `ftcal info` says why |
//!
//! While nothing is going on, it is on as well as long as the button is pressed, until the press is a long one.

use ftcal_shared::units::DeviceTime;

/// A slot is 2¹⁷ µs, so that its number takes a shift and no division.
const SLOT_BITS: u32 = 17;

/// How long a slot is.
pub const SLOT_MICROS: u64 = 1 << SLOT_BITS;

/// How many slots a pattern has.
pub const SLOTS: u32 = u16::BITS;

/// What the light shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Nothing is going on.
    Off,
    /// At work, no need for anybody to do anything.
    Working,
    /// The trial runs, and has so many quarters of its way behind it.
    Running {
        /// 0 to 3.
        quarters: u8,
    },
    /// A new calibration is kept.
    Renewed,
    /// The calibration that there was is good.
    Confirmed,
    /// There is no new calibration.
    Refused,
}

impl Light {
    /// Everything that it shows.
    pub const ALL: [Self; 9] = [
        Self::Off,
        Self::Working,
        Self::Running { quarters: 0 },
        Self::Running { quarters: 1 },
        Self::Running { quarters: 2 },
        Self::Running { quarters: 3 },
        Self::Renewed,
        Self::Confirmed,
        Self::Refused,
    ];

    /// Whether the light is on at this time.
    pub const fn is_on(self, now: DeviceTime) -> bool {
        self.pattern() >> ((now.as_micros() >> SLOT_BITS) % SLOTS as u64) & 1 != 0
    }

    /// The slots in which it is on: bit k for slot k.
    pub const fn pattern(self) -> u16 {
        match self {
            Self::Off => 0,
            Self::Working => 0x00FF,
            Self::Running { quarters: 0 } => 0b1,
            Self::Running { quarters: 1 } => 0b101,
            Self::Running { quarters: 2 } => 0b1_0101,
            Self::Running { quarters: _ } => 0b101_0101,
            Self::Renewed => 0xFFFF,
            Self::Confirmed => 0xFF5F,
            Self::Refused => 0x5555,
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use ftcal_shared::units::DeviceTime;

    use super::{Light, SLOT_BITS};

    /// Slot by slot, from some time on.
    fn seen(light: Light, from_micros: u64) -> u16 {
        (0..16).fold(0, |seen, slot| {
            let now = DeviceTime::from_micros(from_micros + (slot << SLOT_BITS));
            seen | u16::from(light.is_on(now)) << slot
        })
    }

    /// The table in this module's documentation, read as text: it is what people go by.
    #[test]
    fn the_table_is_what_the_light_shows() {
        let rows = include_str!("light.rs").lines().filter_map(|line| line.strip_prefix("//! | `"));
        let patterns: Vec<u16> = rows
            .map(|row| {
                let slots = row.bytes().take(16).enumerate();
                slots.fold(0, |pattern, (slot, mark)| pattern | u16::from(mark == b'#') << slot)
            })
            .collect();
        assert_eq!(patterns, Light::ALL.map(|light| seen(light, 0)));
    }

    /// Nobody knows where a pattern begins.
    #[test]
    fn no_pattern_is_another_one_begun_later() {
        for (position, &one) in Light::ALL.iter().enumerate() {
            for &other in &Light::ALL[position + 1..] {
                for later in 0..16 {
                    assert_ne!(seen(one, 0).rotate_left(later), seen(other, 0), "{one:?} {other:?}");
                }
            }
        }
    }

    /// It goes on evenly at any time, however late.
    #[test]
    fn a_pattern_repeats() {
        for light in Light::ALL {
            for from in [0, 1, u64::from(u32::MAX), 1 << 60] {
                let from = from >> (SLOT_BITS + 4) << (SLOT_BITS + 4);
                assert_eq!(seen(light, from), seen(light, 0));
            }
        }
    }
}
