//! What a sensor tells of its health, in words, and what to do about it. The bits of the status word are explained in
//! [`ftcal_shared::wire::health`].

use ftcal_shared::wire::health::StatusBit;
use ftcal_shared::wire::{Found, PlayedFault, TareRefusal};

use super::remedy::OTHER_GAIN;
use super::words::adc_fault;

/// What a bit says, and what to do about it, if anything.
pub const fn status(bit: StatusBit) -> (&'static str, Option<&'static str>) {
    match bit {
        StatusBit::Saturated => (
            "a gage stands at the end of the converter's range",
            Some(
                "Take load off; where there is none, a gage or its wiring is broken: see which in `ftcal health`.",
            ),
        ),
        StatusBit::OpenInput => (
            "a gage repeats its code, as no live input does",
            Some("Check the wiring of the gage that `ftcal health` names."),
        ),
        StatusBit::AdcFault => (
            "the converter is at fault, silent, or being started",
            Some("`ftcal info` says what is wrong with it; the sensor tries again by itself."),
        ),
        StatusBit::ConversionsLost => (
            "conversions were lost",
            Some("Where it goes on: a lower data rate, or the data-ready line's wiring."),
        ),
        StatusBit::ReplyDisturbed => (
            "transfers from the converter were damaged",
            Some("Where it goes on: the SPI wiring, its length and its ground."),
        ),
        StatusBit::GagesContradict => (
            "the gages contradict each other by far",
            Some(
                "See in `ftcal health` which is the suspect; measure without it by `ftcal health --without GAGE`.",
            ),
        ),
        StatusBit::GageSuspect => (
            "the gages contradict each other in the mean: one has drifted, come off or died",
            Some(
                "See in `ftcal health` which is the suspect; measure without it by `ftcal health --without GAGE`.",
            ),
        ),
        StatusBit::CarryOn => {
            ("measuring without one gage", Some("With all of them again: `ftcal health --with-all`."))
        }
        StatusBit::Overload => ("the load is beyond its limits", Some("Take load off at once.")),
        StatusBit::Threshold => ("a component is beyond its threshold", None),
        StatusBit::Uncalibrated => ("there is no calibration", Some("Upload one with `ftcal upload`.")),
        StatusBit::GainChanged => {
            ("the gain is not the one that the calibration was made at", Some(OTHER_GAIN))
        }
        StatusBit::TareActive => ("a tare is subtracted", None),
        StatusBit::TrialRunning => ("a trial is running", None),
        StatusBit::SelfTest => ("a self-test is running", Some("Wait until it is over.")),
        StatusBit::Unwatched => (
            "the gages are not held against each other: none is redundant, or their noise is not known yet",
            None,
        ),
        StatusBit::OverloadForceX => ("fx is beyond its limit", None),
        StatusBit::OverloadForceY => ("fy is beyond its limit", None),
        StatusBit::OverloadForceZ => ("fz is beyond its limit", None),
        StatusBit::OverloadTorqueX => ("tx is beyond its limit", None),
        StatusBit::OverloadTorqueY => ("ty is beyond its limit", None),
        StatusBit::OverloadTorqueZ => ("tz is beyond its limit", None),
        StatusBit::OverloadCombined => ("all components together are beyond the combined limit", None),
        StatusBit::ClockFallback => (
            "the crystal did not start: times are off by up to a per cent",
            Some("Check the board's crystal."),
        ),
        StatusBit::StorageProblem => (
            "something stored could not be read or written",
            Some("Store it again; where that fails, the processor's flash is worn out."),
        ),
        StatusBit::WatchdogReset => (
            "the last reset came from the watchdog",
            Some("A defect of the firmware, or of its supply: please report it with `ftcal logs`."),
        ),
        StatusBit::PanicReset => (
            "the last reset came after a failure of the firmware",
            Some("A defect of the firmware: please report it with `ftcal logs`."),
        ),
    }
}

/// Why a tare was refused, and what to do.
pub const fn tare_refusal(refusal: TareRefusal) -> (&'static str, &'static str, &'static str) {
    match refusal {
        TareRefusal::NoWrench => (
            "tare-no-wrench",
            "a sample was no wrench, so there is no mean of all",
            "See `ftcal health` for what is wrong, and try again.",
        ),
        TareRefusal::Moving => (
            "tare-moving",
            "the load changed while its mean was taken",
            "Hold the sensor still, keep hands off the load, and try again.",
        ),
    }
}

/// A fault that the self-test plays.
pub const fn played(fault: PlayedFault) -> &'static str {
    match fault {
        PlayedFault::PositiveTestSignal => "positive test signal",
        PlayedFault::NegativeTestSignal => "negative test signal",
        PlayedFault::ShortedInputs => "shorted inputs",
        PlayedFault::CorruptedReply => "corrupted reply",
        PlayedFault::CorruptedCommand => "corrupted command",
        PlayedFault::DeadLine => "dead line",
        PlayedFault::StaleReply => "stale reply",
        PlayedFault::LateReply => "late reply",
        PlayedFault::Reset => "reset of the converter",
        PlayedFault::SilentDataReady => "silent data-ready",
        PlayedFault::SaturatedGage => "saturated gage",
        PlayedFault::StuckGage => "stuck gage",
        PlayedFault::JumpingGage => "jumping gage",
    }
}

/// What the self-test found.
pub fn found(found: Found) -> String {
    match found {
        Found::After { micros } => format!("found after {:.1} ms", f64::from(micros) / 1000.0),
        Found::Nothing => "NOT FOUND".into(),
        Found::Within { channel, off_counts } => {
            format!("right: channel {channel} is farthest off, by {off_counts} counts")
        }
        Found::Beyond { channel, off_counts } => {
            format!("WRONG: channel {channel} is off by {off_counts} counts")
        }
        Found::NotApplicable => "not played: there is no redundant gage to tell it by".into(),
        Found::NotWell(None) => "NOT PLAYED: the sensor was not well".into(),
        Found::NotWell(Some(fault)) => format!("NOT PLAYED: {}", adc_fault(fault)),
    }
}

/// Whether that is as it should be.
pub const fn is_passed(found: Found) -> bool {
    matches!(found, Found::After { .. } | Found::Within { .. } | Found::NotApplicable)
}

#[cfg(test)]
mod tests {
    use ftcal_shared::wire::health::StatusBit;

    use super::status;

    #[test]
    fn every_bit_has_its_own_words_and_remedies_are_sentences() {
        for bit in StatusBit::ALL {
            let (words, remedy) = status(bit);
            let same = StatusBit::ALL.into_iter().filter(|&other| status(other).0 == words).count();
            assert_eq!(same, 1, "{bit:?}");
            assert!(remedy.is_none_or(|remedy| remedy.ends_with('.')), "{bit:?}");
        }
    }
}
