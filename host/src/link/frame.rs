//! The samples that a sensor streams, as the host sees them.
//!
//! The sensor sends up to six numbers and the identity of the calibration that made them. Here they get their axes, so
//! that no number can be taken for another, and whatever is not a wrench (uncalibrated, saturated, converter at fault,
//! made by a calibration that the host does not know) is not a number at all: to read a wrench one has to say what to do
//! without one.

use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{Axis, DeviceTime, Dof, MAX_DOF, SampleIndex};
use ftcal_shared::wire::{CodesFrame, InvalidCause, Measurement, WrenchFrame};

/// What a sensor sends unasked.
#[derive(Clone, Debug, PartialEq)]
pub enum Frame {
    /// A raw sample.
    Codes(CodesFrame),
    /// A wrench, or why there is none.
    Wrench(WrenchSample),
}

/// A moment of a stream of wrenches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchSample {
    /// Number of the conversion.
    pub index: SampleIndex,
    /// When the conversion was read, by the sensor's clock.
    pub time: DeviceTime,
    /// The wrench, or why there is none.
    pub measured: Measured,
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

impl WrenchSample {
    /// Reads a frame off the wire with what is known of the sensor's calibration.
    pub(super) fn read(frame: &WrenchFrame, known: Option<KnownCalibration>) -> Self {
        let measured = match frame.measurement {
            Measurement::Invalid(cause) => Measured::Invalid(match cause {
                InvalidCause::Uncalibrated => NoWrench::Uncalibrated,
                InvalidCause::Saturated(channels) => NoWrench::Saturated(channels),
                InvalidCause::Adc(fault) => NoWrench::Adc(fault),
                InvalidCause::GainChanged => NoWrench::GainChanged,
                InvalidCause::OpenInput(gages) => NoWrench::OpenInput(gages),
                InvalidCause::GagesContradict => NoWrench::GagesContradict,
                InvalidCause::SelfTest => NoWrench::SelfTest,
            }),
            Measurement::Valid { wrench, calibration } => match known {
                Some(known) if known.identity == calibration => {
                    if wrench.iter().all(|component| component.is_finite()) {
                        Measured::Valid(Wrench { dof: known.dof, calibration, components: wrench })
                    } else {
                        Measured::Invalid(NoWrench::NonFinite)
                    }
                }
                _ => Measured::Invalid(NoWrench::UnknownCalibration(calibration)),
            },
        };
        Self { index: frame.index, time: frame.time, measured }
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{Axis, DeviceTime, Dof, SampleIndex};
    use ftcal_shared::wire::{InvalidCause, Measurement, WrenchFrame};

    use super::{KnownCalibration, Measured, NoWrench, WrenchSample};

    const KNOWN: KnownCalibration = KnownCalibration { identity: 7, dof: Dof::PlanarForceTorque };

    fn read(measurement: Measurement) -> Measured {
        let frame = WrenchFrame { index: SampleIndex::new(3), time: DeviceTime::from_micros(9), measurement };
        let sample = WrenchSample::read(&frame, Some(KNOWN));
        assert_eq!((sample.index, sample.time), (frame.index, frame.time));
        sample.measured
    }

    #[test]
    fn a_wrench_has_the_axes_of_its_calibration() {
        let wrench = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0];
        let Measured::Valid(wrench) = read(Measurement::Valid { wrench, calibration: 7 }) else {
            panic!("the calibration is known");
        };
        assert_eq!(wrench.components(), [1.0, 2.0, 3.0]);
        assert_eq!(wrench.component(Axis::ForceY), Some(2.0));
        assert_eq!(wrench.component(Axis::TorqueZ), Some(3.0));
        assert_eq!(wrench.component(Axis::ForceZ), None);
    }

    #[test]
    fn numbers_that_are_no_wrench_are_not_passed_on() {
        let wrench = [1.0, f32::NAN, 3.0, 0.0, 0.0, 0.0];
        assert_eq!(
            read(Measurement::Valid { wrench, calibration: 7 }),
            Measured::Invalid(NoWrench::NonFinite)
        );
        let other = Measurement::Valid { wrench: [0.0; 6], calibration: 8 };
        assert_eq!(read(other), Measured::Invalid(NoWrench::UnknownCalibration(8)));
        let saturated = Measurement::Invalid(InvalidCause::Saturated(0b101));
        assert_eq!(read(saturated), Measured::Invalid(NoWrench::Saturated(0b101)));
    }
}
