extern crate std;

use std::vec::Vec;

use ftcal_shared::units::{Decimation, DeviceTime, SampleIndex};
use ftcal_shared::wire::InvalidCause;

use super::{Decimator, LEAKAGE, OVERLAP, PASS_BAND, RIPPLE, group_delay};
use crate::stream::{Measurement, WrenchMoment};

/// 16 000 conversions/s.
const PERIOD_NANOS: u32 = 62_500;
const PERIOD: f64 = 1e-9 * PERIOD_NANOS as f64;

/// The conversion of this number; its wrench has this force.
fn input(index: u32, force: [f64; 2]) -> WrenchMoment {
    let micros = u64::from(index) * u64::from(PERIOD_NANOS) / 1000;
    #[expect(clippy::cast_possible_truncation, reason = "single precision is what the decimator takes")]
    let wrench = [force[0] as f32, force[1] as f32, 0.0, 0.0, 0.0, 0.0];
    WrenchMoment {
        index: SampleIndex::new(index),
        stride: 1,
        time: DeviceTime::from_micros(micros),
        announced: DeviceTime::from_micros(micros),
        period_nanos: PERIOD_NANOS,
        status: 0,
        parity: None,
        basis: 0,
        measurement: Measurement::Valid { wrench, axes: 2, calibration: 7 },
    }
}

fn force(output: &WrenchMoment) -> Option<[f64; 2]> {
    match output.measurement {
        Measurement::Valid { wrench: [x, y, ..], axes: 2, calibration: 7 } => Some([x.into(), y.into()]),
        Measurement::Valid { .. } => panic!("{output:?}"),
        Measurement::Invalid(_) => None,
    }
}

fn below(decimation: Decimation) -> u32 {
    u32::from(decimation.factor())
}

/// Inputs that an output is made of.
fn needed(decimation: Decimation) -> u32 {
    u32::from(OVERLAP) * below(decimation) - 1
}

/// What is left of a force that turns at this frequency, in cycles an output period: the largest difference of the valid
/// outputs from the force at the time that they bear, and their largest amplitude.
fn response(decimation: Decimation, frequency: f64) -> (f64, f64) {
    let turn = core::f64::consts::TAU * frequency / f64::from(decimation.factor());
    let at = |conversions: f64| [libm::cos(turn * conversions), libm::sin(turn * conversions)];
    let mut decimator = Decimator::new(decimation);
    let (mut difference, mut amplitude) = (0.0_f64, 0.0_f64);
    for index in 0..2 * needed(decimation) + 8 * below(decimation) {
        let Some(output) = decimator.push(&input(index, at(index.into()))) else { continue };
        let Some([x, y]) = force(&output) else { continue };
        let [x_then, y_then] = at(f64::from(index) - f64::from(group_delay(decimation)));
        difference = difference.max(libm::hypot(x - x_then, y - y_then));
        amplitude = amplitude.max(libm::hypot(x, y));
        // The time is rounded to microseconds, once here and once as the input's.
        let seconds = f64::from(index) * PERIOD - f64::from(group_delay(decimation)) * PERIOD;
        assert!((output.time.as_seconds() - seconds).abs() < 2e-6);
    }
    (difference, amplitude)
}

/// Rounding of the sums and of the numbers fed in.
fn rounding(decimation: Decimation) -> f64 {
    f64::from(needed(decimation) + 2) / f64::from(1 << 24)
}

#[test]
fn what_passes_is_delayed_by_exactly_the_group_delay_and_hardly_changed() {
    for decimation in &Decimation::ALL[1..] {
        for step in 0..=20 {
            let (difference, amplitude) = response(*decimation, PASS_BAND * f64::from(step) / 20.0);
            assert!(difference <= RIPPLE + rounding(*decimation), "{decimation:?}, {step}: {difference:e}");
            assert!(amplitude > 0.9, "something comes out");
        }
    }
}

#[test]
fn what_would_fold_into_the_pass_band_does_not_come_out() {
    for decimation in &Decimation::ALL[1..] {
        let (lowest, highest) = (1.0 - PASS_BAND, f64::from(decimation.factor()) / 2.0);
        for step in 0..=50 {
            let frequency = lowest + (highest - lowest) * f64::from(step) / 50.0;
            let (_, amplitude) = response(*decimation, frequency);
            assert!(
                amplitude <= LEAKAGE + rounding(*decimation),
                "{decimation:?}, {frequency}: {amplitude:e}"
            );
        }
    }
}

#[test]
fn a_steady_load_passes_unaltered() {
    for decimation in Decimation::ALL {
        let mut decimator = Decimator::new(decimation);
        for index in 0..2 * needed(decimation) {
            let Some(output) = decimator.push(&input(index, [9.81, -1e-3])) else { continue };
            let Some([x, y]) = force(&output) else { continue };
            assert!((x - 9.81).abs() <= 9.81 * rounding(decimation), "{x}");
            assert!((y + 1e-3).abs() <= 1e-3 * rounding(decimation), "{y}");
        }
    }
}

/// Which outputs are valid, by their number, when `disturb` changes or takes away inputs.
fn validity(
    decimation: Decimation,
    disturb: impl Fn(WrenchMoment) -> Option<WrenchMoment>,
) -> Vec<(u32, Result<(), InvalidCause>)> {
    let mut decimator = Decimator::new(decimation);
    let inputs = (0..4 * needed(decimation)).filter_map(|index| disturb(input(index, [1.0, 2.0])));
    let outputs = inputs.filter_map(|input| decimator.push(&input));
    let outcome = |output: WrenchMoment| {
        assert_eq!(u32::from(output.stride), below(decimation));
        let validity = match output.measurement {
            Measurement::Valid { .. } => Ok(()),
            Measurement::Invalid(cause) => Err(cause),
        };
        (output.index.get(), validity)
    };
    outputs.map(outcome).collect()
}

#[test]
fn an_output_is_valid_where_all_that_it_is_made_of_is() {
    for decimation in [Decimation::By2, Decimation::By8, Decimation::By128] {
        let needed = needed(decimation);
        for bad in [2 * needed, 2 * needed + 1, 2 * needed + below(decimation) / 2] {
            let saturated = InvalidCause::Saturated(4);
            let invalid = validity(decimation, |input| {
                let measurement = Measurement::Invalid(saturated);
                Some(if input.index.get() == bad { WrenchMoment { measurement, ..input } } else { input })
            });
            let missing = validity(decimation, |input| (input.index.get() != bad).then_some(input));
            // Outputs stand where they always stand.
            let on_grid = (0..4 * needed).filter(|index| (index + 1) % below(decimation) == 0);
            assert!(invalid.iter().map(|(index, _)| *index).eq(on_grid.clone()));
            assert!(missing.iter().map(|(index, _)| *index).eq(on_grid.filter(|index| *index != bad)));
            for (outputs, cause) in [(invalid, saturated), (missing, InvalidCause::Settling)] {
                for (index, validity) in outputs {
                    let expected = if index + 1 < needed {
                        Err(InvalidCause::Settling)
                    } else if (bad..bad + needed).contains(&index) {
                        Err(cause)
                    } else {
                        Ok(())
                    };
                    assert_eq!(validity, expected, "{decimation:?}: {index}, {bad} is bad");
                }
            }
        }
    }
}

#[test]
fn wrenches_of_two_calibrations_or_tares_are_not_mixed() {
    let decimation = Decimation::By4;
    let needed = needed(decimation);
    let changed = 2 * needed;
    for (calibration, basis) in [(8, 0), (7, 1)] {
        let mut decimator = Decimator::new(decimation);
        for index in 0..4 * needed {
            let mut sample = input(index, [1.0, 0.0]);
            if index >= changed {
                let wrench = [3.0, 0.0, 0.0, 0.0, 0.0, 0.0];
                sample.measurement = Measurement::Valid { wrench, axes: 2, calibration };
                sample.basis = basis;
            }
            let Some(output) = decimator.push(&sample) else { continue };
            if let Measurement::Valid { wrench, calibration: of, .. } = output.measurement {
                let (steady, expected) = if index < changed { (1.0, 7) } else { (3.0, calibration) };
                assert!((wrench[0] - steady).abs() < 1e-4 && of == expected, "{output:?}");
                assert!(index < changed || index + 1 >= changed + needed);
            }
        }
    }
}

#[test]
fn an_output_tells_what_was_true_at_any_of_its_inputs_since_the_one_before() {
    let mut decimator = Decimator::new(Decimation::By4);
    let mut told = Vec::new();
    for index in 0..12 {
        let (status, parity) = if index == 5 { (0b10, Some(7.0)) } else { (0b100, Some(1.0)) };
        let sample = WrenchMoment { status, parity, ..input(index, [0.0; 2]) };
        told.extend(decimator.push(&sample).map(|output| (output.status, output.parity)));
    }
    assert_eq!(told, [(0b100, Some(1.0)), (0b110, Some(7.0)), (0b100, Some(1.0))]);
}
