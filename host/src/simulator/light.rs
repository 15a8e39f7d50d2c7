//! What the board's light shows, told from when it is on, as somebody does who looks at it.
//!
//! A pattern repeats, and nobody knows where it begins. So the sixteen slots up to now are compared with each pattern, begun at
//! any slot. Where slots begin is where the light went on or off last. While one pattern goes over into another, the slots look
//! like a third for a while: flashes go out of sight at one end as others come at the other. So a pattern counts when it has been
//! seen for a whole round, and is told a round later than it could be.

use std::collections::VecDeque;
use std::time::Duration;

use ftcal_firmware::field::light::{Light, SLOT_MICROS, SLOTS};

/// How long a pattern must be seen.
const CERTAIN_MICROS: u64 = SLOT_MICROS * SLOTS as u64;

/// Somebody who looks at the light.
#[derive(Clone, Debug)]
pub struct LightWatch {
    /// When the light went on or off, microseconds, as far back as a pattern goes; before the first it was the other way.
    changes: VecDeque<u64>,
    is_lit: bool,
    /// What the slots look like, and since when.
    seen: Option<(Light, u64)>,
    shown: Light,
}

impl Default for LightWatch {
    /// Has seen a dark light so far.
    fn default() -> Self {
        Self { changes: VecDeque::new(), is_lit: false, seen: None, shown: Light::Off }
    }
}

impl LightWatch {
    /// What the light shows, as far as was told by [`LightWatch::look`].
    pub const fn shown(&self) -> Light {
        self.shown
    }

    /// Looks at the light: to be called every few milliseconds, with the time of a clock that does not go backwards. What it shows,
    /// where that is new.
    pub fn look(&mut self, now: Duration, is_lit: bool) -> Option<Light> {
        let now = u64::try_from(now.as_micros()).unwrap_or(u64::MAX);
        if is_lit != self.is_lit {
            self.is_lit = is_lit;
            self.changes.push_back(now);
        }
        // One more slot than a pattern has: where they begin is known to a part of one.
        let horizon = now.saturating_sub(SLOT_MICROS * u64::from(SLOTS + 1));
        while self.changes.front().is_some_and(|&change| change < horizon) {
            self.changes.pop_front();
        }
        let slots = self.slots(now);
        let is = |light: &Light| (0..SLOTS).any(|later| light.pattern().rotate_left(later) == slots);
        let seen = Light::ALL.into_iter().find(is);
        self.seen = match (seen, self.seen) {
            (Some(light), Some((before, since))) if light == before => Some((light, since)),
            (seen, _) => seen.map(|light| (light, now)),
        };
        let (light, since) = self.seen?;
        if light == self.shown || now - since < CERTAIN_MICROS {
            return None;
        }
        self.shown = light;
        Some(light)
    }

    /// Whether the light was on in the middle of each of the last slots, in their order.
    fn slots(&self, now: u64) -> u16 {
        let begin = self.changes.back().copied().unwrap_or(now);
        // How long ago the last middle of a slot was.
        let behind = (now - begin + SLOT_MICROS / 2) % SLOT_MICROS;
        (0..SLOTS).rev().fold(0, |slots, ago| {
            // Before the clock began it was dark.
            let at = now.checked_sub(behind + SLOT_MICROS * u64::from(ago));
            slots >> 1 | u16::from(at.is_some_and(|at| self.was_lit(at))) << (SLOTS - 1)
        })
    }

    fn was_lit(&self, at: u64) -> bool {
        let changes_since = self.changes.iter().rev().take_while(|&&change| change > at).count();
        self.is_lit ^ (changes_since % 2 == 1)
    }
}

/// What the light shows, in words: how it looks, and what that says.
pub const fn in_words(light: Light) -> &'static str {
    match light {
        Light::Off => "off (nothing is going on)",
        Light::Working => "slowly on and off (at work, or waiting until a computer has stopped streaming)",
        Light::Running { quarters: 0 } => {
            "one flash, again and again (turn the load, everywhere it has not been)"
        }
        Light::Running { quarters: 1 } => "two flashes (a quarter of the way)",
        Light::Running { quarters: 2 } => "three flashes (half of the way)",
        Light::Running { .. } => "four flashes (three quarters of the way: a press stops it with an answer)",
        Light::Renewed => "on (the sensor had moved: the new calibration is in use and kept)",
        Light::Confirmed => {
            "on, with two short gaps (the sensor has not moved: it keeps the calibration that it has)"
        }
        Light::Refused => "flickering (refused: `ftcal info` says why, and what to do)",
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use ftcal_firmware::field::light::Light;
    use ftcal_shared::units::DeviceTime;

    use super::{LightWatch, in_words};

    /// How often the light is looked at.
    const STEP: Duration = Duration::from_millis(11);

    /// What is told of a light that shows these one after the other, each for some time, which begin anywhere in their pattern.
    fn told(shown: &[Light], each: Duration, begin: Duration) -> Vec<Light> {
        let mut watch = LightWatch::default();
        let (mut told, mut now) = (Vec::new(), Duration::ZERO);
        for &light in shown {
            let end = now + each;
            while now < end {
                let micros = u64::try_from((now + begin).as_micros()).expect("small");
                told.extend(watch.look(now, light.is_on(DeviceTime::from_micros(micros))));
                now += STEP;
            }
            assert_eq!(watch.shown(), light);
        }
        told
    }

    #[test]
    fn every_change_is_told_and_nothing_else() {
        for begin in (0..2100).step_by(300) {
            for length in (5000..6500).step_by(520) {
                for first in Light::ALL {
                    for second in Light::ALL.into_iter().filter(|&second| second != first) {
                        let (each, begin) = (Duration::from_millis(length), Duration::from_millis(begin));
                        let expected: Vec<Light> =
                            [first, second].into_iter().skip_while(|&light| light == Light::Off).collect();
                        assert_eq!(told(&[first, second], each, begin), expected);
                    }
                }
            }
        }
    }

    /// It is on as long as the button is pressed.
    #[test]
    fn a_press_is_no_pattern() {
        let mut watch = LightWatch::default();
        for millis in 0..10_000 {
            let now = Duration::from_millis(millis);
            assert_eq!(watch.look(now, (3000..5000).contains(&millis)), None, "{now:?}");
        }
    }

    #[test]
    fn the_words_are_those_of_the_readme() {
        let readme = include_str!("../../../README.md");
        assert!(readme.contains("| two, three, four flashes |"));
        for light in Light::ALL.into_iter().filter(|&light| light != Light::Off) {
            let (looks, _) = in_words(light).split_once(" (").expect("how it looks, and what that says");
            let is_there = match looks.strip_suffix(" flashes") {
                Some(number) => "two, three, four".contains(number),
                None => readme.contains(&format!("| {looks} |")),
            };
            assert!(is_there, "{looks}");
        }
    }
}
