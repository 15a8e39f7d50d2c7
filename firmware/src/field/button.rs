//! The button: what somebody means by it, out of whether its contact is closed.
//!
//! A contact bounces for some milliseconds, and picks up noise: what does not last `BOUNCE_MICROS` is nothing. A press is
//! **long** as soon as it has lasted [`LONG_MICROS`], and **short** when it ends before that. Nothing is told of a button that was
//! pressed already when the sensor started, until it was released: one that is stuck, or whose wire has a short circuit, starts
//! nothing.

use ftcal_shared::units::DeviceTime;

/// How long a contact must be as it is to count.
const BOUNCE_MICROS: u64 = 20_000;

/// How long a long press lasts.
pub const LONG_MICROS: u64 = 2_000_000;

/// What somebody has done with the button.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Press {
    /// Pressed and released.
    Short,
    /// Held down.
    Long,
}

/// The button.
#[derive(Clone, Copy, Debug)]
pub struct Button {
    is_closed: bool,
    /// Since when the contact is so.
    since: DeviceTime,
    held: Held,
}

#[derive(Clone, Copy, Debug)]
enum Held {
    Released,
    Since(DeviceTime),
    /// Since before the sensor started, or for so long that it was told already.
    Told,
}

impl Default for Button {
    fn default() -> Self {
        Self::new()
    }
}

impl Button {
    /// A button that was not looked at yet.
    pub const fn new() -> Self {
        Self { is_closed: true, since: DeviceTime::from_micros(0), held: Held::Told }
    }

    /// Whether it is being pressed, and nothing was told of that yet.
    pub const fn is_down(&self) -> bool {
        matches!(self.held, Held::Since(_))
    }

    /// Looks at the contact, which is to be done every few milliseconds; what has been done with the button.
    pub fn look(&mut self, now: DeviceTime, is_closed: bool) -> Option<Press> {
        if self.is_closed != is_closed {
            (self.is_closed, self.since) = (is_closed, now);
        }
        if micros_since(now, self.since) < BOUNCE_MICROS {
            return None;
        }
        match self.held {
            Held::Told if !is_closed => self.held = Held::Released,
            Held::Released if is_closed => self.held = Held::Since(self.since),
            Held::Since(_) if !is_closed => {
                self.held = Held::Released;
                return Some(Press::Short);
            }
            Held::Since(begin) if micros_since(now, begin) >= LONG_MICROS => {
                self.held = Held::Told;
                return Some(Press::Long);
            }
            Held::Released | Held::Since(_) | Held::Told => {}
        }
        None
    }
}

const fn micros_since(now: DeviceTime, earlier: DeviceTime) -> u64 {
    now.as_micros().saturating_sub(earlier.as_micros())
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec;
    use std::vec::Vec;

    use ftcal_shared::units::DeviceTime;

    use super::{BOUNCE_MICROS, Button, LONG_MICROS, Press};

    /// Between two looks.
    const TICK: u64 = 2_000;

    /// What is told of a contact that is closed and open, in turn, for so many microseconds each.
    fn told(from: bool, stretches: &[u64]) -> Vec<Press> {
        let (mut button, mut now, mut is_closed) = (Button::new(), 0, from);
        let mut told = Vec::new();
        for stretch in stretches {
            for _ in 0..stretch.div_ceil(TICK) {
                now += TICK;
                told.extend(button.look(DeviceTime::from_micros(now), is_closed));
            }
            is_closed = !is_closed;
        }
        told
    }

    #[test]
    fn a_press_is_short_when_it_ends_and_long_as_soon_as_it_has_lasted() {
        let second = 1_000_000;
        assert_eq!(told(false, &[second, second, second]), [Press::Short]);
        assert_eq!(told(false, &[second, LONG_MICROS - TICK]), []);
        assert_eq!(told(false, &[second, LONG_MICROS + TICK]), [Press::Long]);
        assert_eq!(told(false, &[second, 100 * LONG_MICROS, second]), [Press::Long]);
        assert_eq!(
            told(false, &[second, 3 * second, second, second / 2, second]),
            [Press::Long, Press::Short]
        );
    }

    #[test]
    fn what_is_pressed_since_the_start_is_told_once_it_was_released() {
        let second = 1_000_000;
        assert_eq!(told(true, &[100 * second]), []);
        assert_eq!(told(true, &[10 * second, second]), []);
        assert_eq!(told(true, &[10 * second, second, 3 * second]), [Press::Long]);
    }

    #[test]
    fn a_contact_may_bounce() {
        let bounce = BOUNCE_MICROS / 2;
        // Before and after a press; and in the middle of a long one.
        let bouncing = vec![bounce; 6];
        let mut stretches = vec![1_000_000];
        stretches.extend(&bouncing);
        stretches.push(500_000);
        stretches.extend(&bouncing);
        stretches.push(1_000_000);
        assert_eq!(told(false, &stretches), [Press::Short]);
        assert_eq!(told(false, &[1_000_000, 1_200_000, bounce, 1_200_000]), [Press::Long]);
        assert_eq!(told(false, &[1_000_000, bounce, 1_000_000]), []);
    }
}
