//! The samples that a sensor streams, as the host sees them.
//!
//! The sensor sends up to six numbers and the identity of the calibration that made them. Here they get their axes, so
//! that no number can be taken for another, and whatever is not a wrench (uncalibrated, saturated, converter at fault,
//! made by a calibration that the host does not know) is not a number at all: to read a wrench one has to say what to do
//! without one. Nobody gets at a wrench but by how old it may be ([`WrenchSample::within`]; an older one is none), or by saying
//! that its age does not matter ([`WrenchSample::at_any_age`]).

use std::time::Duration;

use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{Axis, DeviceTime, Dof, MAX_DOF, SampleIndex};
use ftcal_shared::wire::health::StatusWord;
use ftcal_shared::wire::{CodesFrame, InvalidCause, Run, WrenchFrame};

/// What a sensor sends unasked.
#[derive(Clone, Debug, PartialEq)]
pub enum Frame {
    /// A raw sample.
    Codes(CodesFrame),
    /// A wrench, or why there is none.
    Wrench(WrenchSample),
}

impl Frame {
    /// The sample's number, and what it grows by to the next.
    pub const fn place(&self) -> (SampleIndex, u8) {
        match self {
            Self::Codes(frame) => (frame.index, 1),
            Self::Wrench(sample) => (sample.index, sample.stride),
        }
    }

    /// When the sample was taken, by the sensor's clock.
    pub const fn time(&self) -> DeviceTime {
        match self {
            Self::Codes(frame) => frame.time,
            Self::Wrench(sample) => sample.time,
        }
    }
}

/// A moment of a stream of wrenches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchSample {
    /// Number of the conversion that completed it.
    pub index: SampleIndex,
    /// What the number grows by to the next sample; zero where there is no conversion, and the number is that of the next.
    pub stride: u8,
    /// When it was taken, by the sensor's clock.
    pub time: DeviceTime,
    /// When it was taken, by the clock of the line that it came over: before the sensor's filter delayed it, and before it waited for
    /// others of its frame. The line's own delay is not told from it.
    pub taken: Duration,
    /// The lower half of the sensor's status word.
    pub status: StatusWord,
    /// The largest χ² of the parity channels among the samples of its frame.
    pub parity: Option<f32>,
    /// The sensor's temperature, where it measures that.
    pub temperature_celsius: Option<f32>,
    measured: Measured,
}

/// A wrench, or why there is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Measured {
    /// A wrench.
    Valid(Wrench),
    /// No wrench.
    Invalid(NoWrench),
}

/// Why there is no wrench.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoWrench {
    /// The sensor has no calibration.
    Uncalibrated,
    /// These channels stood at an end of their range: bit k for gage k.
    Saturated(u16),
    /// The converter is at fault.
    Adc(AdcFault),
    /// The gain was changed since the calibration was uploaded.
    GainChanged,
    /// These gages repeat their code: bit k for gage k.
    OpenInput(u16),
    /// The gages contradict each other.
    GagesContradict,
    /// The sensor is testing itself.
    SelfTest,
    /// It was made with a calibration that the host knows nothing of, so that its axes are unknown.
    UnknownCalibration(u32),
    /// A component is not finite: the calibration's numbers are too large for these codes.
    NonFinite,
    /// The filter before the sensor's decimation has not seen enough samples yet.
    Settling,
    /// There is one, but it is older than it may be.
    Stale,
}

/// A wrench in the sensor frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench {
    dof: Dof,
    calibration: u32,
    components: [f32; MAX_DOF],
}

impl Wrench {
    /// Newton and newton metre, in the order of [`Dof::axes`].
    pub fn components(&self) -> &[f32] {
        self.components.split_at_checked(self.dof.count()).map_or(&[], |(felt, _)| felt)
    }

    /// One component, newton or newton metre; `None` where this sensor does not feel it.
    pub fn component(&self, axis: Axis) -> Option<f32> {
        self.dof.axes().iter().zip(self.components()).find(|(of, _)| **of == axis).map(|(_, value)| *value)
    }

    /// Which components there are.
    pub const fn dof(&self) -> Dof {
        self.dof
    }

    /// Identity of the calibration that made it.
    pub const fn calibration(&self) -> u32 {
        self.calibration
    }
}

/// The calibration that a sensor is known to use: what its wrenches can be read with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct KnownCalibration {
    pub(super) identity: u32,
    pub(super) dof: Dof,
}

impl From<InvalidCause> for NoWrench {
    fn from(cause: InvalidCause) -> Self {
        match cause {
            InvalidCause::Uncalibrated => Self::Uncalibrated,
            InvalidCause::Saturated(channels) => Self::Saturated(channels),
            InvalidCause::Adc(fault) => Self::Adc(fault),
            InvalidCause::GainChanged => Self::GainChanged,
            InvalidCause::NonFinite => Self::NonFinite,
            InvalidCause::OpenInput(gages) => Self::OpenInput(gages),
            InvalidCause::GagesContradict => Self::GagesContradict,
            InvalidCause::SelfTest => Self::SelfTest,
            InvalidCause::Settling => Self::Settling,
        }
    }
}

impl WrenchSample {
    /// The wrench, where at this time of the line's clock it is no older than this. In its age is what the sensor's filter delays it.
    pub fn within(&self, oldest: Duration, now: Duration) -> Measured {
        match self.measured {
            Measured::Valid(_) if now.saturating_sub(self.taken) > oldest => {
                Measured::Invalid(NoWrench::Stale)
            }
            measured => measured,
        }
    }

    /// The wrench, however old it is: for means and records, not for whoever acts on it.
    pub const fn at_any_age(&self) -> Measured {
        self.measured
    }

    /// Reads a frame that came at this time of the line's clock, with what is known of the sensor's calibration and of what its
    /// filter delays each sample; `None` where its bytes are no wrenches.
    pub(super) fn read(
        frame: &WrenchFrame,
        known: Option<KnownCalibration>,
        filter_delay: Duration,
        arrived: Duration,
    ) -> Option<Vec<Self>> {
        let measured = measured(&frame.run, known)?;
        let parity = match frame.run {
            Run::Valid { parity, .. } => parity,
            Run::Invalid { .. } => None,
        };
        // A frame with no sample says why there is none.
        let is_silence = matches!(frame.run, Run::Invalid { samples: 0, .. });
        let steps = measured.len().saturating_sub(1) as u64;
        let span = u64::from(frame.span_micros);
        let sample = |(measured, step): (Measured, u32)| {
            // The nearest microsecond to where evenly spaced samples stand.
            let into_run = (span * u64::from(step) + steps / 2).checked_div(steps).unwrap_or(0);
            let age = u64::from(frame.age_micros) + (span - into_run);
            Self {
                index: SampleIndex::new(frame.first.get().wrapping_add(step * u32::from(frame.stride))),
                stride: if is_silence { 0 } else { frame.stride },
                time: DeviceTime::from_micros(frame.time.as_micros().saturating_add(into_run)),
                taken: arrived.saturating_sub(Duration::from_micros(age) + filter_delay),
                status: StatusWord::from_bits(frame.status.into()),
                parity,
                temperature_celsius: frame
                    .temperature_centi_celsius
                    .map(|hundredths| f32::from(hundredths) / 100.0),
                measured,
            }
        };
        Some(measured.into_iter().zip(0..).map(sample).collect())
    }
}

/// What each sample of a run has measured.
fn measured(run: &Run, known: Option<KnownCalibration>) -> Option<Vec<Measured>> {
    let (calibration, wrenches) = match run {
        Run::Invalid { cause, samples } => {
            let none = Measured::Invalid(NoWrench::from(*cause));
            return Some(vec![none; usize::from(*samples).max(1)]);
        }
        Run::Valid { calibration, wrenches, .. } => (*calibration, wrenches),
    };
    let count = wrenches.count()?;
    Some(match known {
        Some(known) if known.identity == calibration && known.dof.count() == wrenches.axes() => {
            let wrench = |components| Wrench { dof: known.dof, calibration, components };
            wrenches.wrenches().map(|components| Measured::Valid(wrench(components))).collect()
        }
        _ => vec![Measured::Invalid(NoWrench::UnknownCalibration(calibration)); count],
    })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use ftcal_shared::units::{Axis, DeviceTime, Dof, MAX_DOF, SampleIndex};
    use ftcal_shared::wire::health::StatusWord;
    use ftcal_shared::wire::{InvalidCause, PackedWrenches, Run, WrenchFrame};

    use super::{KnownCalibration, Measured, NoWrench, WrenchSample};

    const KNOWN: KnownCalibration = KnownCalibration { identity: 7, dof: Dof::PlanarForceTorque };
    const FILTER_DELAY: Duration = Duration::from_micros(700);
    const ARRIVED: Duration = Duration::from_secs(2);

    fn read(run: Run) -> Vec<WrenchSample> {
        let frame = WrenchFrame {
            first: SampleIndex::new(u32::MAX),
            stride: 4,
            time: DeviceTime::from_micros(1000),
            span_micros: 250,
            age_micros: 90,
            status: 0b101,
            temperature_centi_celsius: Some(-250),
            run,
        };
        WrenchSample::read(&frame, Some(KNOWN), FILTER_DELAY, ARRIVED).expect("it is whole")
    }

    fn valid(calibration: u32, wrenches: &[[f32; MAX_DOF]]) -> Run {
        let wrenches = PackedWrenches::pack(3, wrenches).expect("they fit");
        Run::Valid { calibration, parity: Some(9.5), wrenches }
    }

    const WRENCH: [f32; MAX_DOF] = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0];

    #[test]
    fn a_wrench_has_the_axes_of_its_calibration() {
        let samples = read(valid(7, &[WRENCH]));
        let [WrenchSample { measured: Measured::Valid(wrench), .. }] = samples.as_slice() else {
            panic!("the calibration is known");
        };
        assert_eq!(wrench.components(), [1.0, 2.0, 3.0]);
        assert_eq!(wrench.component(Axis::ForceY), Some(2.0));
        assert_eq!(wrench.component(Axis::TorqueZ), Some(3.0));
        assert_eq!(wrench.component(Axis::ForceZ), None);
    }

    #[test]
    fn each_sample_has_its_place_and_what_its_frame_says() {
        let samples = read(valid(7, &[WRENCH; 5]));
        for (step, sample) in (0_u32..).zip(&samples) {
            assert_eq!(sample.index.since(SampleIndex::new(u32::MAX)), 4 * step);
            assert!(sample.time.as_micros().abs_diff(1000 + u64::from(625 * step) / 10) <= 1);
            let age = ARRIVED.saturating_sub(sample.taken).as_micros();
            assert_eq!(age + u128::from(sample.time.as_micros()), 700 + 90 + 1250);
            let status = StatusWord::from_bits(0b101);
            assert_eq!((sample.status, sample.parity, sample.stride), (status, Some(9.5), 4));
            assert_eq!(sample.temperature_celsius, Some(-2.5));
        }
        assert_eq!((samples.len(), samples[4].time.as_micros()), (5, 1250));
    }

    #[test]
    fn numbers_that_are_no_wrench_are_not_passed_on() {
        let all_are = |run, count, cause| {
            let samples = read(run);
            assert_eq!(samples.len(), count);
            samples.iter().all(|sample| sample.measured == Measured::Invalid(cause))
        };
        assert!(all_are(valid(8, &[WRENCH; 3]), 3, NoWrench::UnknownCalibration(8)));
        let two_axes = PackedWrenches::pack(2, &[WRENCH; 3]).expect("they fit");
        let other_axes = Run::Valid { calibration: 7, parity: None, wrenches: two_axes };
        assert!(all_are(other_axes, 3, NoWrench::UnknownCalibration(7)));
        let saturated = Run::Invalid { cause: InvalidCause::Saturated(0b101), samples: 2 };
        assert!(all_are(saturated, 2, NoWrench::Saturated(0b101)));
    }

    #[test]
    fn a_silence_is_one_moment_without_a_number_of_its_own() {
        let [silence] = read(Run::Invalid { cause: InvalidCause::Uncalibrated, samples: 0 })[..] else {
            panic!("one moment");
        };
        assert_eq!((silence.index, silence.stride), (SampleIndex::new(u32::MAX), 0));
    }

    #[test]
    fn a_wrench_that_is_too_old_is_none() {
        let samples = read(valid(7, &[WRENCH]));
        let (sample, oldest) = (samples[0], Duration::from_millis(3));
        let last = sample.taken + oldest;
        assert!(matches!(sample.within(oldest, last), Measured::Valid(_)));
        let just_after = last + Duration::from_nanos(1);
        assert_eq!(sample.within(oldest, just_after), Measured::Invalid(NoWrench::Stale));
        let saturated = read(Run::Invalid { cause: InvalidCause::Saturated(1), samples: 1 })[0];
        assert_eq!(saturated.within(oldest, just_after), Measured::Invalid(NoWrench::Saturated(1)));
    }
}
