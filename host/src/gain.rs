//! The gain of the converter as files and the command line spell it: its factor, a whole number.

use ftcal_shared::units::Gain;

/// The gains that there are, for the words of an error.
pub fn possible() -> String {
    format!("one of {}", Gain::ALL.map(|gain| gain.factor().to_string()).join(", "))
}

/// The gain of this factor, or `None` where the converter has no such gain.
pub fn of_factor(factor: i64) -> Option<Gain> {
    u8::try_from(factor).ok().and_then(Gain::from_factor)
}

/// The gain that is spelled like this, or `None` where that is no gain of the converter.
pub fn of_text(text: &str) -> Option<Gain> {
    text.parse().ok().and_then(of_factor)
}
