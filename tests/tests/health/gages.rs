//! The gages name the one among them that is off, and the sensor measures on without it.

use ftcal::simulator::bench::{Bench, Load};
use ftcal::simulator::bus::SharedBench;
use ftcal::simulator::fault::{Fault, Rail};
use ftcal::simulator::scenario::ScenarioKind;
use ftcal::simulator::sensor::{SoftwareSensor, Wrench};
use ftcal_firmware::acquisition::Sample;
use ftcal_firmware::health::Health;
use ftcal_firmware::polled::PolledSensor;
use ftcal_firmware::stream::Measurement;
use ftcal_shared::estimation::application::RealTimeCalibration;
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::estimation::parity::ParitySpace;
use ftcal_shared::units::{AdcCode, DataRate, Dof};
use ftcal_shared::wire::health::{StatusBit, StatusWord};
use ftcal_shared::wire::{ClockSource, HealthRequest, InvalidCause, Rejection, Request, Response};
use nalgebra::{DMatrix, DVector, UnitVector3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::rig::{Rig, assert_near, scenario};

/// The sine of the angle between the directions in which two gages are off in the parity space.
fn sine_between(projector: &DMatrix<f64>, one: usize, other: usize) -> f64 {
    let cosine = projector[(one, other)] / (projector[(one, one)] * projector[(other, other)]).sqrt();
    (1.0 - cosine * cosine).max(0.0).sqrt()
}

/// The axis along which the load makes this gage read most.
fn most_felt(truth: &SoftwareSensor, load: &Load, gage: usize) -> UnitVector3<f64> {
    let felt = |direction: &UnitVector3<f64>| {
        let wrench = Wrench::of_force_at(direction.into_inner(), &load.arm_m).components(truth.dof());
        truth.shape().column(gage).dot(&wrench).abs()
    };
    let axes = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
    let axes = axes.into_iter().take(truth.dof().trial_rank());
    axes.max_by(|one, other| felt(one).total_cmp(&felt(other))).expect("there are axes")
}

fn check_naming<const GAGES: usize, const HIGHER: usize>(truth: &SoftwareSensor, load: Load, seed: u64) {
    for gage in 0..GAGES {
        for fault in [
            Fault::DriftingChannel { channel: gage, counts_per_second: 1e6 },
            Fault::DriftingChannel { channel: gage, counts_per_second: -1e6 },
            Fault::DebondedChannel { channel: gage, kept: 0.5 },
            Fault::DebondedChannel { channel: gage, kept: 0.0 },
            Fault::DeadChannel { channel: gage },
        ] {
            let mut rig = Rig::<GAGES, HIGHER>::new(truth, load, seed, DataRate::Hz1000);
            let projector = rig.projector();
            assert!(projector[(gage, gage)] > 0.01, "visible at all");
            if !matches!(fault, Fault::DriftingChannel { .. }) {
                // What a gage no longer feels shows under a load that it would feel.
                rig.bench.with(|bench| bench.hold(most_felt(truth, &load, gage)));
                rig.run(0.1);
            }
            rig.bench.with(|bench| bench.inject(fault));
            rig.run(1.0);
            let report = rig.health(HealthRequest::Read);
            let parity = report.parity.expect("there are redundant gages");
            assert!(report.live.contains(StatusBit::GageSuspect), "{fault:?}: {parity:?}");
            assert!(parity.suspects & 1 << gage != 0, "{fault:?}: {parity:?}");
            for other in (0..GAGES).filter(|other| parity.suspects & 1 << other != 0) {
                // What the fault leaves beside the other gage's direction is no more than is allowed, or than the direction is off by.
                let beside = f64::from(parity.disagreement_counts) * sine_between(&projector, gage, other);
                let allowed =
                    f64::from(parity.allowed_counts).hypot(0.02 * f64::from(parity.disagreement_counts));
                assert!(beside < 1.2 * allowed, "{fault:?}: {parity:?}");
            }
            if let Fault::DriftingChannel { counts_per_second, .. } = fault {
                // The last complete window lay between half a second and a second after the onset.
                let share = f64::from(parity.suspect_off_counts) / counts_per_second.abs();
                assert!((0.3..1.0).contains(&share), "{fault:?}: {parity:?}");
            }
        }
    }
}

/// A sensor of random shape: no two gages are alike.
fn random_sensor(dof: Dof, gages: usize, seed: u64) -> SoftwareSensor {
    let mut state = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
    let mut number = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    // Two million counts at 20 N, 1 N m.
    let shape = DMatrix::from_fn(dof.count(), gages, |axis, _| {
        number() * if dof.has_torque() && axis >= dof.trial_rank() { 2e6 } else { 1e5 }
    });
    let bias = DVector::from_fn(gages, |_, _| 1e6 * number());
    let noise = DVector::from_fn(gages, |_, _| 800.0 + 400.0 * number());
    SoftwareSensor::new(dof, shape, bias, noise).expect("sizes fit")
}

#[test]
fn the_gage_that_drifts_comes_off_or_dies_is_named_within_a_second() {
    let of = |kind, seed| {
        let scenario = scenario(kind, seed);
        (scenario.sensor.clone(), scenario.trials[0].load)
    };
    let (sensor, load) = of(ScenarioKind::Fingertip, 11);
    check_naming::<4, { higher_moment_count(4) }>(&sensor, load, 11);
    let (sensor, load) = of(ScenarioKind::Force, 12);
    check_naming::<6, { higher_moment_count(6) }>(&sensor, load, 12);
    let (sensor, load) = of(ScenarioKind::Planar, 13);
    check_naming::<4, { higher_moment_count(4) }>(&sensor, load, 13);
    let (sensor, load) = of(ScenarioKind::Wrist, 14);
    check_naming::<8, { higher_moment_count(8) }>(&sensor, load, 14);
    let load = Load { mass_kg: 2.0, arm_m: Vector3::new(0.05, 0.02, 0.03) };
    check_naming::<8, { higher_moment_count(8) }>(&random_sensor(Dof::SpatialForceTorque, 8, 1), load, 15);
    check_naming::<8, { higher_moment_count(8) }>(&random_sensor(Dof::SpatialForce, 8, 2), load, 16);
    check_naming::<5, { higher_moment_count(5) }>(&random_sensor(Dof::PlanarForce, 5, 3), load, 17);
}

fn check_carry_on<const GAGES: usize, const HIGHER: usize>(kind: ScenarioKind, seed: u64) {
    let scenario = scenario(kind, seed);
    for gage in 0..GAGES {
        let mut rig = Rig::<GAGES, HIGHER>::of(&scenario, seed, DataRate::Hz1000);
        rig.bench.with(|bench| bench.inject(Fault::SaturatedChannel { channel: gage, rail: Rail::High }));
        let invalid = rig.step().measurements;
        assert!(invalid.contains(&Measurement::Invalid(InvalidCause::Saturated(1 << gage))));

        let report = rig.health(HealthRequest::CarryOn(u8::try_from(gage).ok()));
        assert_eq!(report.carrying_on_without, u8::try_from(gage).ok());
        let projector = rig.projector();
        let share = projector[(gage, gage)];
        let matrix = rig.matrix();
        let noise = DVector::from_fn(matrix.nrows(), |row, _| {
            let without = DVector::from_fn(GAGES, |other, _| {
                matrix[(row, other)] - matrix[(row, gage)] * projector[(gage, other)] / share
            });
            let noises = rig.truth.noise_counts();
            without.iter().zip(noises.iter()).map(|(c, noise)| (c * noise).powi(2)).sum::<f64>().sqrt()
        });
        let (mut squares, mut samples) = (DVector::zeros(noise.len()), 0);
        let end = rig.now_micros() + 1_000_000;
        while rig.now_micros() < end {
            let step = rig.step();
            assert!(step.word.contains(StatusBit::CarryOn));
            for measurement in step.measurements {
                let Measurement::Valid { wrench, .. } = measurement else { panic!("{measurement:?}") };
                assert_near(&wrench, &step.truth, &(&noise * 6.0), "carrying on");
                for axis in 0..noise.len() {
                    let error: f64 = (f64::from(wrench[axis]) - step.truth[axis]) / noise[axis];
                    squares[axis] += error * error;
                }
                samples += 1;
            }
        }
        // Five standard deviations of the mean square.
        let samples = f64::from(samples);
        assert!(squares.iter().all(|sum: &f64| (sum / samples - 1.0).abs() < 5.0 * (2.0 / samples).sqrt()));

        rig.bench.with(Bench::clear_faults);
        assert_eq!(rig.health(HealthRequest::CarryOn(None)).carrying_on_without, None);
        rig.run(0.3);
        assert_eq!(rig.polled.sensor.status_word(), StatusWord::NONE);
    }
}

#[test]
fn without_a_gage_it_measures_right_within_the_noise_that_is_left() {
    check_carry_on::<4, { higher_moment_count(4) }>(ScenarioKind::Fingertip, 21);
    check_carry_on::<6, { higher_moment_count(6) }>(ScenarioKind::Force, 22);
    check_carry_on::<4, { higher_moment_count(4) }>(ScenarioKind::Planar, 23);
    check_carry_on::<8, { higher_moment_count(8) }>(ScenarioKind::Wrist, 24);
}

#[test]
fn a_gage_that_is_needed_cannot_be_left_out() {
    let sensor = random_sensor(Dof::SpatialForce, 3, 4);
    let bench = SharedBench::new(Bench::new(sensor.clone(), 1));
    let polled = PolledSensor::new(bench.clone(), Box::new(Bins::new()), ClockSource::Simulated);
    let mut rig = Rig::<3, { higher_moment_count(3) }> { bench, polled, next_tick: 0, truth: sensor };
    let carry_on = |rig: &mut Rig<3, { higher_moment_count(3) }>, gage| {
        rig.ask(Request::Health(HealthRequest::CarryOn(Some(gage))))
    };
    assert_eq!(carry_on(&mut rig, 0), Response::Rejected(Rejection::Uncalibrated));
    let upload = rig.upload();
    rig.ask(Request::UploadCalibration(upload));
    assert_eq!(carry_on(&mut rig, 0), Response::Rejected(Rejection::GageNeeded));
    assert_eq!(carry_on(&mut rig, 3), Response::Rejected(Rejection::NoSuchGage));
    rig.run(1.0);
    assert_eq!(rig.polled.sensor.status_word(), StatusBit::Unwatched.word());
    assert_eq!(rig.health(HealthRequest::Read).parity, None);
}

/// Nothing that comes while the noise is learned makes the monitor blind: a glitch is not learned, and a jump after it is found.
#[test]
fn a_glitch_is_not_learned_as_noise() {
    let scenario = scenario(ScenarioKind::Wrist, 62);
    let mut rig = Rig::<8, { higher_moment_count(8) }>::of(&scenario, 62, DataRate::Hz1000);
    // A drift as fast as this is a jump.
    let jump = |counts: f64| Fault::DriftingChannel { channel: 3, counts_per_second: 1000.0 * counts };
    rig.ask(Request::Health(HealthRequest::CarryOn(None)));
    rig.run(0.06);
    assert!(rig.polled.sensor.status_word().contains(StatusBit::Unwatched), "is learning");
    rig.bench.with(|bench| bench.inject(jump(1e6)));
    rig.step();
    rig.bench.with(Bench::clear_faults);
    rig.run(0.4);
    assert_eq!(rig.polled.sensor.status_word(), StatusWord::NONE, "is watching, and finds nothing");
    rig.bench.with(|bench| bench.inject(jump(2e5)));
    for measurement in rig.step().measurements {
        assert_eq!(measurement, Measurement::Invalid(InvalidCause::GagesContradict));
    }
}

/// An hour at 1000 samples a second. By the limits' own figures (see the monitor) a sample is lost by chance in 5·10⁸, and
/// a gage is suspected in 10¹⁰ windows: in an hour 0.007 and 10⁻⁶ times.
#[test]
fn in_an_hour_of_noise_no_sample_is_lost_and_no_gage_suspected() {
    const HOUR: u32 = 3_600_000;
    let scenario = scenario(ScenarioKind::Wrist, 61);
    let rig = Rig::<8, { higher_moment_count(8) }>::of(&scenario, 61, DataRate::Hz1000);
    let upload = rig.upload();
    let calibration = RealTimeCalibration::<8>::new(upload.dof, &upload.matrix, &upload.bias_counts);
    let calibration = calibration.expect("sound numbers");
    let mut health = Health::<8>::new();
    health.watch(ParitySpace::new(&calibration.matrix()), None, DataRate::Hz1000);
    let mut random = ChaCha8Rng::seed_from_u64(61);
    let (mut suspected, mut lost, mut chi_square) = (0_u32, 0_u32, 0.0);
    let sensor = &scenario.sensor;
    let shape = sensor.shape();
    for sample in 0..HOUR {
        // A load that sways within a third of the range.
        let phase = f64::from(sample) * 1e-3;
        let sway = [phase.sin(), (1.3 * phase).cos(), (0.7 * phase).sin()];
        let codes = core::array::from_fn(|gage| {
            let felt = 10.0 * (0..3).map(|axis| shape[(axis, gage)] * sway[axis]).sum::<f64>();
            let draw: f64 = StandardNormal.sample(&mut random);
            let counts = sensor.bias_counts()[gage] + felt + sensor.noise_counts()[gage] * draw;
            #[expect(clippy::cast_possible_truncation, reason = "this is the rounding")]
            AdcCode::saturating(counts.round() as i64)
        });
        let sample = Sample { codes, repeating: 0, after_gap: false };
        lost += u32::from(health.measure(Ok(&calibration), 0, &sample).is_err());
        suspected += u32::from(health.live().contains(StatusBit::GageSuspect));
        chi_square += f64::from(health.chi_square().unwrap_or(1.0));
    }
    assert_eq!((lost, suspected), (0, 0));
    // One in the mean, within what the noise is known to: a four-second average of squares, and its clipping.
    assert!((chi_square / f64::from(HOUR) - 1.0).abs() < 0.05, "{}", chi_square / f64::from(HOUR));
}
