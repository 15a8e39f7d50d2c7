//! The status word, bit by bit: the one table of it.
//!
//! A bit is **live**: set as long as it is so, or, where the kind says *sample*, for the sample with which it
//! happened. The sensor keeps a second word of every bit that was live since that word was last cleared by
//! [`ClearLatched`](super::HealthRequest::ClearLatched), so that nothing brief is missed. Stream frames carry the sixteen lower bits of the live word.
//! What to do about each is on the host (`host/src/link/health_words.rs`).
//!
//! | bit | name | kind | set where |
//! |---|---|---|---|
//! | 0 | saturated | sample | a gage in use stands at an end of the converter's range; the sample is no wrench |
//! | 1 | open-input | sample | a gage in use repeats its code as no live input does: dead, open or shorted; the sample is no wrench |
//! | 2 | adc-fault | lasting | the converter is at fault, silent, or being started; there is no sample |
//! | 3 | conversions-lost | sample | conversions between the sample before and this one were not announced, or not read in time |
//! | 4 | reply-disturbed | sample | a reply of the converter, or a command to it, was damaged; that conversion is no sample |
//! | 5 | gages-contradict | sample | the gages contradict each other by more than noise can; the sample is no wrench |
//! | 6 | gage-suspect | lasting | in the mean of a quarter second the gages contradict each other: one has drifted, debonded or died |
//! | 7 | carry-on | lasting | wrenches are made without one gage, as asked: they are right, and noisier |
//! | 8 | overload | sample | a component, or all of them together, is beyond its limit; bits 16 to 22 say which |
//! | 9 | threshold | lasting | a component is beyond a threshold that the user set, less its hysteresis |
//! | 10 | uncalibrated | lasting | there is no calibration, so there are no wrenches |
//! | 11 | gain-changed | lasting | the gain is not the one that the calibration came at, so there are no wrenches |
//! | 12 | tare-active | lasting | a tare is subtracted from every wrench |
//! | 13 | trial-running | lasting | a trial takes samples in |
//! | 14 | self-test | lasting | faults are being played, so there are no wrenches |
//! | 15 | unwatched | lasting | the gages cannot be held against each other: none is redundant, or their noise is not known yet |
//! | 16 | overload-fx | sample | force along x is beyond its limit |
//! | 17 | overload-fy | sample | force along y is beyond its limit |
//! | 18 | overload-fz | sample | force along z is beyond its limit |
//! | 19 | overload-tx | sample | torque about x is beyond its limit |
//! | 20 | overload-ty | sample | torque about y is beyond its limit |
//! | 21 | overload-tz | sample | torque about z is beyond its limit |
//! | 22 | overload-combined | sample | all components together are beyond the combined limit |
//! | 23 | clock-fallback | lasting | the crystal did not start: times are off by up to a per cent |
//! | 24 | storage-problem | lasting | something stored could not be read or written |
//! | 25 | watchdog-reset | lasting | the last reset came from the watchdog |
//! | 26 | panic-reset | lasting | the last reset came after a failure of the firmware itself |
//!
//! Bits 27 to 31 are zero. The converter, an ADS131M08, does not report its supply or its reference, so no bit does; a reference
//! that is off shows in the self-test's test signals.

use serde::{Deserialize, Serialize};

use crate::units::Axis;

/// A bit of the status word; see the table above.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum StatusBit {
    /// A gage stands at an end of the converter's range.
    Saturated,
    /// A gage repeats its code.
    OpenInput,
    /// The converter is at fault.
    AdcFault,
    /// Conversions are missing before this sample.
    ConversionsLost,
    /// A transfer was damaged.
    ReplyDisturbed,
    /// The gages contradict each other in this sample.
    GagesContradict,
    /// The gages contradict each other in the mean.
    GageSuspect,
    /// One gage is left out.
    CarryOn,
    /// Some limit of the load is exceeded.
    Overload,
    /// Some threshold of the user's is exceeded.
    Threshold,
    /// There is no calibration.
    Uncalibrated,
    /// The calibration is for another gain.
    GainChanged,
    /// A tare is subtracted.
    TareActive,
    /// A trial is running.
    TrialRunning,
    /// Faults are being played.
    SelfTest,
    /// The gages are not held against each other.
    Unwatched,
    /// Force along x is beyond its limit.
    OverloadForceX,
    /// Force along y is beyond its limit.
    OverloadForceY,
    /// Force along z is beyond its limit.
    OverloadForceZ,
    /// Torque about x is beyond its limit.
    OverloadTorqueX,
    /// Torque about y is beyond its limit.
    OverloadTorqueY,
    /// Torque about z is beyond its limit.
    OverloadTorqueZ,
    /// All components together are beyond the combined limit.
    OverloadCombined,
    /// The crystal did not start.
    ClockFallback,
    /// Something stored could not be read or written.
    StorageProblem,
    /// The watchdog reset the sensor.
    WatchdogReset,
    /// The firmware failed and reset the sensor.
    PanicReset,
}

impl StatusBit {
    /// Every bit, from bit 0 on.
    pub const ALL: [Self; 27] = [
        Self::Saturated,
        Self::OpenInput,
        Self::AdcFault,
        Self::ConversionsLost,
        Self::ReplyDisturbed,
        Self::GagesContradict,
        Self::GageSuspect,
        Self::CarryOn,
        Self::Overload,
        Self::Threshold,
        Self::Uncalibrated,
        Self::GainChanged,
        Self::TareActive,
        Self::TrialRunning,
        Self::SelfTest,
        Self::Unwatched,
        Self::OverloadForceX,
        Self::OverloadForceY,
        Self::OverloadForceZ,
        Self::OverloadTorqueX,
        Self::OverloadTorqueY,
        Self::OverloadTorqueZ,
        Self::OverloadCombined,
        Self::ClockFallback,
        Self::StorageProblem,
        Self::WatchdogReset,
        Self::PanicReset,
    ];

    /// The name in the table.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Saturated => "saturated",
            Self::OpenInput => "open-input",
            Self::AdcFault => "adc-fault",
            Self::ConversionsLost => "conversions-lost",
            Self::ReplyDisturbed => "reply-disturbed",
            Self::GagesContradict => "gages-contradict",
            Self::GageSuspect => "gage-suspect",
            Self::CarryOn => "carry-on",
            Self::Overload => "overload",
            Self::Threshold => "threshold",
            Self::Uncalibrated => "uncalibrated",
            Self::GainChanged => "gain-changed",
            Self::TareActive => "tare-active",
            Self::TrialRunning => "trial-running",
            Self::SelfTest => "self-test",
            Self::Unwatched => "unwatched",
            Self::OverloadForceX => "overload-fx",
            Self::OverloadForceY => "overload-fy",
            Self::OverloadForceZ => "overload-fz",
            Self::OverloadTorqueX => "overload-tx",
            Self::OverloadTorqueY => "overload-ty",
            Self::OverloadTorqueZ => "overload-tz",
            Self::OverloadCombined => "overload-combined",
            Self::ClockFallback => "clock-fallback",
            Self::StorageProblem => "storage-problem",
            Self::WatchdogReset => "watchdog-reset",
            Self::PanicReset => "panic-reset",
        }
    }

    /// The bit that says that this component is beyond its limit.
    pub const fn overload(axis: Axis) -> Self {
        match axis {
            Axis::ForceX => Self::OverloadForceX,
            Axis::ForceY => Self::OverloadForceY,
            Axis::ForceZ => Self::OverloadForceZ,
            Axis::TorqueX => Self::OverloadTorqueX,
            Axis::TorqueY => Self::OverloadTorqueY,
            Axis::TorqueZ => Self::OverloadTorqueZ,
        }
    }

    /// The word in which this bit alone is set.
    pub const fn word(self) -> StatusWord {
        StatusWord(1 << self as u8)
    }
}

/// Bits of the table above.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(transparent)]
pub struct StatusWord(u32);

impl StatusWord {
    /// No bit set.
    pub const NONE: Self = Self(0);

    /// The word of these bits.
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// All bits.
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// The lower sixteen, which travel with every sample.
    pub const fn frame_bits(self) -> u16 {
        #[expect(clippy::cast_possible_truncation, reason = "the lower half is what is asked for")]
        {
            self.0 as u16
        }
    }

    /// Whether this bit is set.
    pub const fn contains(self, bit: StatusBit) -> bool {
        self.0 & bit.word().0 != 0
    }

    /// The bits of both.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// This word with one bit set where `set` says so, and as it was otherwise.
    #[must_use]
    pub const fn with(self, bit: StatusBit, set: bool) -> Self {
        Self(self.0 | (set as u32) << bit as u8)
    }

    /// This word without one bit.
    #[must_use]
    pub const fn without(self, bit: StatusBit) -> Self {
        Self(self.0 & !bit.word().0)
    }

    /// The bits that are set and have a meaning, from bit 0 on.
    pub fn set_bits(self) -> impl Iterator<Item = StatusBit> {
        StatusBit::ALL.into_iter().filter(move |&bit| self.contains(bit))
    }
}

#[cfg(test)]
mod tests {
    use super::{StatusBit, StatusWord};

    /// The table in this module's documentation, read as text: it is what people go by.
    #[test]
    fn the_table_is_what_the_code_says() {
        let rows = include_str!("health.rs").lines().filter_map(|line| line.strip_prefix("//! | "));
        let mut bits = StatusBit::ALL.into_iter();
        for row in rows.skip(1) {
            let mut columns = row.split(" | ");
            let bit = bits.next().unwrap();
            assert_eq!(columns.next().unwrap().parse(), Ok(bit as u8));
            assert_eq!(columns.next(), Some(bit.name()));
            assert!(matches!(columns.next(), Some("sample" | "lasting")));
            assert!(columns.next().is_some_and(|meaning| !meaning.is_empty()));
        }
        assert_eq!(bits.next(), None);
    }

    #[test]
    fn bits_are_where_they_stand_in_the_list() {
        for (position, bit) in (0_u32..).zip(StatusBit::ALL) {
            assert_eq!(bit.word().bits(), 1 << position);
            assert!(StatusWord::NONE.with(bit, true).contains(bit));
            assert!(!StatusWord::NONE.with(bit, false).contains(bit));
            assert_eq!(bit.word().without(bit), StatusWord::NONE);
            assert!(bit.word().set_bits().eq([bit]));
        }
        assert_eq!(StatusWord::from_bits(0x0012_3456).frame_bits(), 0x3456);
    }
}
