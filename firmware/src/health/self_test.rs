//! The self-test: plays one fault after the other through the real path, and looks whether the sensor finds it.
//!
//! | played | by | found as |
//! |---|---|---|
//! | test signals, short circuit | the converter itself, in place of its pins | codes within [`TOLERANCE_COUNTS`] of what they must be |
//! | a command's checksum broken | the injector, on its way to the converter | what the converter then says |
//! | replies corrupted, dead, stale, late, of a reset | the injector, on their way back | the fault that the driver reports |
//! | data-ready silent | not attending to it | the converter counts as silent |
//! | a gage saturated, stuck, jumping | the injector, with a right checksum | the sample's status bits |
//!
//! Each begins with a sensor that has been well for [`WELL`] samples, and ends when it is found or after [`PATIENCE_MICROS`]; a converter
//! that counts as faulty from it is started anew. All of it takes about a second. Meanwhile no sample is a wrench, nothing of it is latched
//! in the status word, and peaks and tare are what they were. Counters of lost and corrupted conversions count what was played.

use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{AdcCode, DeviceTime};
use ftcal_shared::wire::health::{StatusBit, StatusWord};
use ftcal_shared::wire::{AdcState, Found, PlayedFault, SelfTestOutcome, SelfTestPhase, SelfTestReport};

use super::Injection;
use crate::adc::Input;
use crate::handover::RemoteConverter;

/// How far the code of a test signal or of a short circuit may be off: 1/128 of the range, which is 6 % of a test signal.
const TOLERANCE_COUNTS: i32 = 1 << 16;

/// Samples without fault before a fault is played.
const WELL: u8 = 16;

/// Samples of a test signal that are averaged.
const AVERAGED: u8 = 16;

/// How long a fault is played before it counts as not found.
const PATIENCE_MICROS: u64 = 100_000;

/// How long the sensor may take to become well.
const RECOVERY_MICROS: u64 = 2_000_000;

/// In this order.
const PLAYED: [PlayedFault; 13] = [
    PlayedFault::PositiveTestSignal,
    PlayedFault::NegativeTestSignal,
    PlayedFault::ShortedInputs,
    PlayedFault::CorruptedReply,
    PlayedFault::CorruptedCommand,
    PlayedFault::DeadLine,
    PlayedFault::StaleReply,
    PlayedFault::LateReply,
    PlayedFault::Reset,
    PlayedFault::SilentDataReady,
    PlayedFault::SaturatedGage,
    PlayedFault::StuckGage,
    PlayedFault::JumpingGage,
];

/// What there was to be seen: a sample with its status, or a fault instead.
pub(crate) enum Observed<'a, const GAGES: usize> {
    Sample(&'a [AdcCode; GAGES], StatusWord),
    Fault(AdcFault),
    /// A tick, and no fault.
    Nothing,
}

/// The self-test of a sensor with `GAGES` gages.
pub(crate) struct SelfTest<const GAGES: usize> {
    report: SelfTestReport,
    /// What is being played, or is next.
    played: Option<PlayedFault>,
    step: Step,
    since: DeviceTime,
    sums: [i32; GAGES],
    /// The gage that stands for all.
    gage: u8,
    /// The last fault seen.
    fault: Option<AdcFault>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Step {
    /// Until the sensor has been well for so many samples more.
    Recover(u8),
    /// Until the fault is found.
    Play,
    /// Until so many samples more of the test signal have come.
    Read(u8),
}

impl<const GAGES: usize> SelfTest<GAGES> {
    pub(crate) const fn new() -> Self {
        Self {
            report: SelfTestReport { phase: SelfTestPhase::None, outcomes: heapless::Vec::new() },
            played: None,
            step: Step::Recover(WELL),
            since: DeviceTime::from_micros(0),
            sums: [0; GAGES],
            gage: 0,
            fault: None,
        }
    }

    pub(crate) const fn report(&self) -> &SelfTestReport {
        &self.report
    }

    pub(crate) fn is_running(&self) -> bool {
        self.report.phase == SelfTestPhase::Running
    }

    /// Begins, with these gages in use, of which those of `watched` are held against each other.
    pub(crate) fn start(&mut self, now: DeviceTime, in_use: u16, watched: u16) {
        *self = Self::new();
        self.report.phase = SelfTestPhase::Running;
        self.played = PLAYED.first().copied();
        self.since = now;
        let candidates = if in_use & watched == 0 { in_use } else { in_use & watched };
        // At most twelve.
        self.gage = u8::try_from(candidates.trailing_zeros()).unwrap_or(0);
    }

    /// Takes in what there was to be seen, and goes on. True when that was the end of it.
    pub(crate) fn observe(
        &mut self,
        now: DeviceTime,
        observed: &Observed<'_, GAGES>,
        watched: u16,
        converter: &mut RemoteConverter,
    ) -> bool {
        let Some(played) = self.played.filter(|_| self.is_running()) else { return false };
        if let Observed::Fault(fault) = observed {
            self.fault = Some(*fault);
        }
        let elapsed = now.as_micros().saturating_sub(self.since.as_micros());
        match self.step {
            Step::Recover(left) => {
                let left = match observed {
                    Observed::Nothing => left,
                    Observed::Sample(_, word) if !is_ill(*word) => left.saturating_sub(1),
                    Observed::Sample(..) | Observed::Fault(_) => WELL,
                };
                self.step = Step::Recover(left);
                if left == 0 {
                    return self.play(now, played, watched, converter);
                } else if elapsed > RECOVERY_MICROS {
                    return self.give_up();
                }
            }
            Step::Play => {
                if is_found(played, observed) {
                    let micros = u32::try_from(elapsed).unwrap_or(u32::MAX);
                    return self.end(now, played, Found::After { micros }, converter);
                } else if elapsed > PATIENCE_MICROS {
                    return self.end(now, played, Found::Nothing, converter);
                }
            }
            Step::Read(left) => {
                if let Observed::Sample(codes, _) = observed {
                    for (sum, code) in self.sums.iter_mut().zip(*codes) {
                        *sum += code.counts();
                    }
                    self.step = Step::Read(left - 1);
                    if left == 1 {
                        let found = self.compare(played);
                        return self.end(now, played, found, converter);
                    }
                } else if elapsed > RECOVERY_MICROS {
                    let found = Found::NotWell(self.fault);
                    return self.end(now, played, found, converter);
                }
            }
        }
        false
    }

    fn play(
        &mut self,
        now: DeviceTime,
        played: PlayedFault,
        watched: u16,
        converter: &mut RemoteConverter,
    ) -> bool {
        self.since = now;
        self.fault = None;
        self.sums = [0; GAGES];
        if let Some(input) = input(played) {
            converter.connect(input);
            self.step = Step::Read(AVERAGED);
            return false;
        }
        if played == PlayedFault::JumpingGage && watched & 1 << self.gage == 0 {
            return self.end(now, played, Found::NotApplicable, converter);
        }
        converter.play(injection(played, self.gage));
        converter.ignore_data_ready(played == PlayedFault::SilentDataReady);
        self.step = Step::Play;
        false
    }

    /// Writes down what was found, and goes on to the next fault. True where there is none.
    fn end(
        &mut self,
        now: DeviceTime,
        played: PlayedFault,
        found: Found,
        converter: &mut RemoteConverter,
    ) -> bool {
        converter.play(None);
        converter.ignore_data_ready(false);
        if input(played).is_some() {
            converter.connect(Input::Pins);
        } else if matches!(converter.state(), AdcState::Faulty(_)) {
            converter.restart();
        }
        // There is room for all that are played.
        let _ = self.report.outcomes.push(SelfTestOutcome { played, found });
        self.step = Step::Recover(WELL);
        self.since = now;
        self.fault = None;
        self.played = PLAYED.get(self.report.outcomes.len()).copied();
        if self.played.is_none() {
            self.report.phase = SelfTestPhase::Done;
        }
        self.played.is_none()
    }

    /// A sensor that does not become well can have nothing played on it.
    fn give_up(&mut self) -> bool {
        for &played in PLAYED.iter().skip(self.report.outcomes.len()) {
            let _ = self.report.outcomes.push(SelfTestOutcome { played, found: Found::NotWell(self.fault) });
        }
        self.played = None;
        self.report.phase = SelfTestPhase::Done;
        true
    }

    /// The channel that is farthest off what the test signal demands.
    fn compare(&self, played: PlayedFault) -> Found {
        let expected = match played {
            PlayedFault::PositiveTestSignal => Input::TEST_SIGNAL_COUNTS,
            PlayedFault::NegativeTestSignal => -Input::TEST_SIGNAL_COUNTS,
            _ => 0,
        };
        let (mut channel, mut off_counts) = (0, 0_i32);
        for (at, sum) in (0_u8..).zip(&self.sums) {
            let off = sum / i32::from(AVERAGED) - expected;
            if off.abs() > off_counts.abs() {
                (channel, off_counts) = (at, off);
            }
        }
        if off_counts.abs() <= TOLERANCE_COUNTS {
            Found::Within { channel, off_counts }
        } else {
            Found::Beyond { channel, off_counts }
        }
    }
}

/// What the converter measures in place of its pins.
const fn input(played: PlayedFault) -> Option<Input> {
    match played {
        PlayedFault::PositiveTestSignal => Some(Input::PositiveTestSignal),
        PlayedFault::NegativeTestSignal => Some(Input::NegativeTestSignal),
        PlayedFault::ShortedInputs => Some(Input::Shorted),
        _ => None,
    }
}

/// What is done on the bus.
const fn injection(played: PlayedFault, channel: u8) -> Option<Injection> {
    match played {
        PlayedFault::CorruptedReply => Some(Injection::CorruptedReply),
        PlayedFault::CorruptedCommand => Some(Injection::CorruptedCommand),
        PlayedFault::DeadLine => Some(Injection::DeadLine),
        PlayedFault::StaleReply => Some(Injection::StaleReply),
        PlayedFault::LateReply => Some(Injection::LateReply),
        PlayedFault::Reset => Some(Injection::Reset),
        PlayedFault::SaturatedGage => Some(Injection::Saturated { channel }),
        PlayedFault::StuckGage => Some(Injection::Stuck { channel }),
        PlayedFault::JumpingGage => Some(Injection::Jumped { channel }),
        PlayedFault::PositiveTestSignal
        | PlayedFault::NegativeTestSignal
        | PlayedFault::ShortedInputs
        | PlayedFault::SilentDataReady => None,
    }
}

/// Whether this is what the fault must look like.
const fn is_found<const GAGES: usize>(played: PlayedFault, observed: &Observed<'_, GAGES>) -> bool {
    match observed {
        Observed::Nothing => false,
        Observed::Fault(fault) => match played {
            PlayedFault::CorruptedReply => matches!(fault, AdcFault::ReplyCorrupted),
            PlayedFault::CorruptedCommand => matches!(fault, AdcFault::CommandCorrupted),
            PlayedFault::DeadLine => matches!(fault, AdcFault::NotResponding),
            PlayedFault::StaleReply => matches!(fault, AdcFault::StaleConversion),
            PlayedFault::LateReply => {
                matches!(fault, AdcFault::StaleConversion | AdcFault::UnexpectedReply)
            }
            PlayedFault::Reset => matches!(fault, AdcFault::UnexpectedReset),
            PlayedFault::SilentDataReady => matches!(fault, AdcFault::DataReadyLost),
            _ => false,
        },
        Observed::Sample(_, word) => match played {
            PlayedFault::SaturatedGage => word.contains(StatusBit::Saturated),
            PlayedFault::StuckGage => word.contains(StatusBit::OpenInput),
            PlayedFault::JumpingGage => word.contains(StatusBit::GagesContradict),
            _ => false,
        },
    }
}

/// Whether a sample has something of a fault.
const fn is_ill(word: StatusWord) -> bool {
    word.contains(StatusBit::Saturated)
        || word.contains(StatusBit::OpenInput)
        || word.contains(StatusBit::GagesContradict)
}
