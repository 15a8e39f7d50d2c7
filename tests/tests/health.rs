//! Health, from the gage to the frame: every fault that the simulator knows is flagged in time, and no frame that is called valid
//! carries its effect; the gages name the one among them that is off; the sensor measures on without it.
//!
//! The firmware's own sensor runs on the simulated bench, sample by sample in virtual time, so that each frame is compared with the truth
//! of that very instant.

use embedded_hal::delay::DelayNs;
use ftcal::simulator::bench::{Bench, Load};
use ftcal::simulator::bus::SharedBench;
use ftcal::simulator::fault::{Fault, Rail};
use ftcal::simulator::operator::turn;
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use ftcal::simulator::sensor::{SoftwareSensor, Wrench};
use ftcal_firmware::sensor::{LinkCounters, Reaction, Sensor, StreamFrame};
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::units::{DataRate, Dof, Gain};
use ftcal_shared::wire::health::{StatusBit, StatusWord};
use ftcal_shared::wire::{
    AdcState, CalibrationUpload, ClockSource, Found, GageList, HealthReport, HealthRequest, HealthResponse,
    InvalidCause, Measurement, PlayedFault, Rejection, Request, Response, SelfTestPhase, StreamKind,
    TarePhase,
};
use nalgebra::{DMatrix, DVector, UnitVector3, Vector3};

/// Between two ticks, as on the board.
const TICK_MICROS: u64 = 2_000;

/// What the firmware allows beyond noise: see `firmware/src/health/parity_monitor.rs`.
const TOLERANCE: f64 = 8192.0;
const MODEL_TOLERANCE: f64 = 4e-3;

/// A sensor with the truth under it.
struct Rig<const GAGES: usize, const HIGHER: usize> {
    bench: SharedBench,
    sensor: Sensor<SharedBench, Box<Bins<GAGES, HIGHER>>, GAGES, HIGHER>,
    next_tick: u64,
    truth: SoftwareSensor,
    matrix: DMatrix<f64>,
}

/// What one conversion period brought.
struct Step {
    /// Everything that was streamed, and the wrench at that moment.
    measurements: Vec<Measurement>,
    truth: DVector<f64>,
    word: StatusWord,
}

struct Wait<'a>(&'a SharedBench);

impl DelayNs for Wait<'_> {
    fn delay_ns(&mut self, nanoseconds: u32) {
        self.0.with(|bench| {
            let end = bench.now().as_micros() + u64::from(nanoseconds).div_ceil(1000);
            while bench.now().as_micros() < end {
                bench.next_conversion();
            }
        });
    }
}

impl<const GAGES: usize, const HIGHER: usize> Rig<GAGES, HIGHER> {
    /// A sensor that knows its own truth as calibration, streams wrenches at this rate, and has learned its noise with this load
    /// turning on it.
    fn new(truth: &SoftwareSensor, load: Load, seed: u64, rate: DataRate) -> Self {
        let bench = SharedBench::new(Bench::new(truth.clone(), seed));
        bench.with(|bench| {
            bench.hang(load);
            turn(bench);
        });
        let shape = truth.shape();
        let matrix = (shape * shape.transpose()).try_inverse().expect("of full rank") * shape;
        let sensor = Sensor::new(bench.clone(), Box::new(Bins::new()), ClockSource::Simulated);
        let mut rig = Self { bench, sensor, next_tick: 0, truth: truth.clone(), matrix };
        rig.ask(Request::ConfigureAdc(rate, Gain::X128));
        rig.ask(Request::Stream(StreamKind::Wrench));
        rig.run(0.05);
        rig.ask(Request::UploadCalibration(rig.upload()));
        rig.run(0.7);
        assert_eq!(rig.sensor.status_word(), StatusWord::NONE, "well");
        rig.health(HealthRequest::ClearLatched);
        rig
    }

    fn of(scenario: &Scenario, seed: u64, rate: DataRate) -> Self {
        Self::new(&scenario.sensor, scenario.trials[0].load, seed, rate)
    }

    fn upload(&self) -> CalibrationUpload {
        #[expect(clippy::cast_possible_truncation, reason = "this is the form in which it travels")]
        let matrix = self.matrix.transpose().iter().map(|&element| element as f32).collect();
        let bias_counts = GageList::from_slice(self.truth.bias_counts().as_slice()).expect("at most twelve");
        let mut upload = CalibrationUpload { dof: self.truth.dof(), bias_counts, matrix, identity: 0 };
        upload.identity = upload.identity_of_numbers();
        upload
    }

    fn ask(&mut self, request: Request) -> Response {
        let now = self.bench.with(|bench| bench.now());
        match self.sensor.answer(request, now, LinkCounters::default()) {
            Reaction::Respond(response) => response,
            Reaction::Solve(_) => panic!("nothing is solved here"),
        }
    }

    fn health(&mut self, request: HealthRequest) -> HealthReport {
        match self.ask(Request::Health(request)) {
            Response::Health(HealthResponse::Report(report)) => report,
            other => panic!("{other:?}"),
        }
    }

    fn now_micros(&self) -> u64 {
        self.bench.with(|bench| bench.now().as_micros())
    }

    /// Lives through one conversion period.
    fn step(&mut self) -> Step {
        let mut frames = Vec::new();
        if self.now_micros() >= self.next_tick {
            let now = self.bench.with(|bench| bench.now());
            self.next_tick = now.as_micros() + TICK_MICROS;
            frames.extend(self.sensor.tick(now, &mut Wait(&self.bench)));
        }
        let announced = self.bench.with(Bench::next_conversion);
        let (now, wrench) = self.bench.with(|bench| (bench.now(), bench.true_wrench()));
        if announced {
            frames.extend(self.sensor.on_data_ready(now, now));
        }
        let measurements = frames
            .into_iter()
            .map(|frame| match frame {
                StreamFrame::Wrench(frame) => frame.measurement,
                StreamFrame::Codes(_) => panic!("wrenches were asked for"),
            })
            .collect();
        Step { measurements, truth: wrench.components(self.truth.dof()), word: self.sensor.status_word() }
    }

    fn run(&mut self, seconds: f64) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few seconds")]
        let end = self.now_micros() + (seconds * 1e6) as u64;
        while self.now_micros() < end {
            self.step();
        }
    }

    /// Standard deviation of each component from the gages' noise.
    fn noise(&self) -> DVector<f64> {
        let variances = self.truth.noise_counts().map(|noise| noise * noise);
        DVector::from_fn(self.matrix.nrows(), |row, _| {
            self.matrix.row(row).iter().zip(variances.iter()).map(|(c, v)| c * c * v).sum::<f64>().sqrt()
        })
    }

    /// I − SᵀC.
    fn projector(&self) -> DMatrix<f64> {
        DMatrix::identity(GAGES, GAGES) - self.truth.shape().transpose() * &self.matrix
    }

    /// By how much gage k may be off at most in a sample that is called valid: what is allowed of its parity, and six standard
    /// deviations of the noise in it.
    fn largest_hidden(&self, gage: usize, truth: &DVector<f64>) -> f64 {
        let projector = self.projector();
        let noise: f64 = (0..GAGES).map(|k| projector[(k, k)] * self.truth.noise_counts()[k].powi(2)).sum();
        // A gage that is off counts in the signal, too.
        let signal = self.truth.shape().tr_mul(truth).norm() * 1.5;
        let allowed = 36.0 * 1.3 * noise + TOLERANCE.powi(2) + (MODEL_TOLERANCE * signal).powi(2);
        (allowed.sqrt() + 6.0 * noise.sqrt()) / projector[(gage, gage)].sqrt()
    }

    fn assert_near(&self, wrench: &[f32], truth: &DVector<f64>, allowed: &DVector<f64>, what: &str) {
        for (axis, allowed) in allowed.iter().enumerate() {
            let error = f64::from(wrench[axis]) - truth[axis];
            assert!(error.abs() < *allowed, "{what}: component {axis} is off by {error} of {allowed}");
        }
    }
}

fn scenario(kind: ScenarioKind, seed: u64) -> Scenario {
    Scenario::new(kind, seed).expect("sizes fit")
}

/// The faults of the converter and of its wiring, and the bits one of which must tell of each.
fn converter_faults(gage: usize) -> Vec<(Fault, &'static [StatusBit])> {
    vec![
        (Fault::StuckChannel { channel: gage }, &[StatusBit::OpenInput]),
        (Fault::OpenChannel { channel: gage }, &[StatusBit::GagesContradict]),
        (Fault::SaturatedChannel { channel: gage, rail: Rail::High }, &[StatusBit::Saturated]),
        (Fault::SaturatedChannel { channel: gage, rail: Rail::Low }, &[StatusBit::Saturated]),
        (Fault::NoisyChannel { channel: gage, noise_counts: 200_000.0 }, &[StatusBit::GagesContradict]),
        (Fault::BusBitErrors { probability: 0.01 }, &[StatusBit::ReplyDisturbed, StatusBit::AdcFault]),
        (Fault::DataReadyLost { probability: 1.0 }, &[StatusBit::AdcFault]),
        (Fault::DataReadyLost { probability: 0.5 }, &[StatusBit::ConversionsLost, StatusBit::AdcFault]),
        (Fault::LateReply, &[StatusBit::ReplyDisturbed]),
        (Fault::WrongIdentity { id: 0x2400 }, &[StatusBit::AdcFault]),
        (Fault::ConverterMissing, &[StatusBit::AdcFault]),
    ]
}

/// How long a fault acts.
const ACTING_MICROS: u64 = 300_000;

/// Within this it is flagged.
const FLAGGED_MICROS: u64 = 10_000;

fn check_faults<const GAGES: usize, const HIGHER: usize>(kind: ScenarioKind, seed: u64, rate: DataRate) {
    let scenario = scenario(kind, seed);
    for gage in 0..GAGES {
        // Of those that concern no gage once is enough.
        for (fault, bits) in converter_faults(gage).into_iter().take(if gage == 0 { 11 } else { 5 }) {
            let mut rig = Rig::<GAGES, HIGHER>::of(&scenario, seed, rate);
            rig.bench.with(|bench| bench.inject(fault));
            let begin = rig.now_micros();
            let what = format!("{kind:?} {fault:?} at {} /s", rate.hertz());
            let noise = rig.noise() * 6.0;
            let mut flagged = None;
            let mut before = Vec::new();
            while rig.now_micros() < begin + ACTING_MICROS {
                let step = rig.step();
                let elapsed = rig.now_micros() - begin;
                if flagged.is_none() && bits.iter().any(|&bit| step.word.contains(bit)) {
                    flagged = Some(elapsed);
                }
                let off = match fault {
                    // At most three conversions old.
                    Fault::StuckChannel { channel } => {
                        let counts = |truth: &DVector<f64>| rig.truth.shape().column(channel).dot(truth);
                        let now = counts(&step.truth);
                        let change = before.iter().rev().take(3).map(|then| (counts(then) - now).abs());
                        change.fold(0.0, f64::max) + 12.0 * rig.truth.noise_counts()[channel]
                    }
                    Fault::OpenChannel { channel } | Fault::NoisyChannel { channel, .. } => {
                        rig.largest_hidden(channel, &step.truth)
                    }
                    _ => 0.0,
                };
                let allowed = &noise + rig.matrix.column(gage).abs() * off;
                for measurement in step.measurements {
                    if let Measurement::Valid { wrench, .. } = measurement {
                        rig.assert_near(&wrench, &step.truth, &allowed, &what);
                    }
                }
                before.push(step.truth);
            }
            let flagged = flagged.unwrap_or_else(|| panic!("{what}: not flagged"));
            assert!(flagged <= FLAGGED_MICROS, "{what}: flagged after {flagged} µs");
        }
    }
}

#[test]
fn every_fault_of_the_converter_is_flagged_within_ten_milliseconds_and_reaches_no_valid_frame() {
    check_faults::<4, { higher_moment_count(4) }>(ScenarioKind::Fingertip, 1, DataRate::Hz1000);
    check_faults::<6, { higher_moment_count(6) }>(ScenarioKind::Force, 2, DataRate::Hz1000);
    check_faults::<4, { higher_moment_count(4) }>(ScenarioKind::Planar, 3, DataRate::Hz1000);
    check_faults::<8, { higher_moment_count(8) }>(ScenarioKind::Wrist, 4, DataRate::Hz1000);
    check_faults::<8, { higher_moment_count(8) }>(ScenarioKind::Wrist, 5, DataRate::Hz4000);
}

/// Whether two gages are off in the same direction of the parity space, or nearly: within 2°.
fn are_alike(projector: &DMatrix<f64>, one: usize, other: usize) -> bool {
    let cosine = projector[(one, other)] / (projector[(one, one)] * projector[(other, other)]).sqrt();
    cosine.abs() > 2.0_f64.to_radians().cos()
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
                assert!(are_alike(&projector, gage, other), "{fault:?}: {parity:?}");
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
        let noise = DVector::from_fn(rig.matrix.nrows(), |row, _| {
            let without = DVector::from_fn(GAGES, |other, _| {
                rig.matrix[(row, other)] - rig.matrix[(row, gage)] * projector[(gage, other)] / share
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
                rig.assert_near(&wrench, &step.truth, &(&noise * 6.0), "carrying on");
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
        assert_eq!(rig.sensor.status_word(), StatusWord::NONE);
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
    let sensor_alone = Sensor::new(bench.clone(), Box::new(Bins::new()), ClockSource::Simulated);
    let matrix = sensor.shape().clone().try_inverse().expect("of full rank").transpose();
    let mut rig = Rig::<3, { higher_moment_count(3) }> {
        bench,
        sensor: sensor_alone,
        next_tick: 0,
        truth: sensor,
        matrix,
    };
    let carry_on = |rig: &mut Rig<3, { higher_moment_count(3) }>, gage| {
        rig.ask(Request::Health(HealthRequest::CarryOn(Some(gage))))
    };
    assert_eq!(carry_on(&mut rig, 0), Response::Rejected(Rejection::Uncalibrated));
    let upload = rig.upload();
    rig.ask(Request::UploadCalibration(upload));
    assert_eq!(carry_on(&mut rig, 0), Response::Rejected(Rejection::GageNeeded));
    assert_eq!(carry_on(&mut rig, 3), Response::Rejected(Rejection::NoSuchGage));
    rig.run(1.0);
    assert_eq!(rig.sensor.status_word(), StatusBit::Unwatched.word());
    assert_eq!(rig.health(HealthRequest::Read).parity, None);
}

fn self_test<const GAGES: usize, const HIGHER: usize>(
    rig: &mut Rig<GAGES, HIGHER>,
) -> Vec<(PlayedFault, Found)> {
    let mut response = rig.ask(Request::Health(HealthRequest::StartSelfTest));
    for _ in 0..60_000 {
        let Response::Health(HealthResponse::SelfTest(report)) = response else { panic!("{response:?}") };
        if report.phase == SelfTestPhase::Done {
            return report.outcomes.iter().map(|outcome| (outcome.played, outcome.found)).collect();
        }
        let step = rig.step();
        assert!(step.measurements.iter().all(|it| matches!(it, Measurement::Invalid(_))));
        response = rig.ask(Request::Health(HealthRequest::ReadSelfTest));
    }
    panic!("a self-test ends");
}

#[test]
fn a_self_test_finds_every_fault_and_leaves_the_sensor_as_it_was() {
    let scenario = scenario(ScenarioKind::Wrist, 31);
    let mut rig = Rig::<8, { higher_moment_count(8) }>::of(&scenario, 31, DataRate::Hz1000);
    rig.run(0.1);
    let before = rig.health(HealthRequest::Read);
    let begin = rig.now_micros();
    let outcomes = self_test(&mut rig);
    assert!(rig.now_micros() - begin < 3_000_000, "a few seconds");
    assert_eq!(outcomes.len(), 13);
    for (played, found) in outcomes {
        match found {
            Found::After { micros } => {
                assert!(u64::from(micros) <= FLAGGED_MICROS, "{played:?}: {micros} µs")
            }
            Found::Within { off_counts, .. } => {
                assert_eq!(off_counts, 0, "{played:?}: the model's are exact")
            }
            _ => panic!("{played:?}: {found:?}"),
        }
    }
    let after = rig.health(HealthRequest::Read);
    let with_self_test = before.latched.with(StatusBit::SelfTest, true).with(StatusBit::AdcFault, true);
    assert_eq!(after.latched.bits() & !with_self_test.bits(), 0, "{:?}", after.latched);
    assert_eq!((after.peak_since_start, after.carrying_on_without), (before.peak_since_start, None));
    rig.run(0.5);
    assert_eq!(rig.sensor.status_word(), StatusWord::NONE);
    let step = rig.step();
    let allowed = rig.noise() * 6.0;
    for measurement in step.measurements {
        let Measurement::Valid { wrench, .. } = measurement else { panic!("{measurement:?}") };
        rig.assert_near(&wrench, &step.truth, &allowed, "after the self-test");
    }
}

#[test]
fn a_self_test_of_a_broken_sensor_says_so() {
    let scenario = scenario(ScenarioKind::Fingertip, 32);
    let mut rig = Rig::<4, { higher_moment_count(4) }>::of(&scenario, 32, DataRate::Hz1000);
    rig.bench.with(|bench| bench.inject(Fault::ConverterMissing));
    rig.run(0.2);
    let outcomes = self_test(&mut rig);
    assert!(outcomes.iter().all(|(_, found)| matches!(found, Found::NotWell(Some(_)))), "{outcomes:?}");
}

#[test]
fn trials_and_self_tests_keep_out_of_each_other_s_way() {
    let scenario = scenario(ScenarioKind::Fingertip, 33);
    let mut rig = Rig::<4, { higher_moment_count(4) }>::of(&scenario, 33, DataRate::Hz1000);
    rig.ask(Request::StartTrial { rank: 2 });
    assert!(rig.step().word.contains(StatusBit::TrialRunning));
    let start = Request::Health(HealthRequest::StartSelfTest);
    assert_eq!(rig.ask(start.clone()), Response::Rejected(Rejection::TrialBusy));
    rig.ask(Request::StopTrial);
    rig.ask(start.clone());
    let running = Response::Rejected(Rejection::SelfTestRunning);
    assert_eq!(rig.ask(start), running);
    assert_eq!(rig.ask(Request::StartTrial { rank: 2 }), running);
    assert_eq!(rig.ask(Request::ConfigureAdc(DataRate::Hz250, Gain::X1)), running);
    let upload = rig.upload();
    assert_eq!(rig.ask(Request::UploadCalibration(upload)), running);
}

fn tare<const GAGES: usize, const HIGHER: usize>(
    rig: &mut Rig<GAGES, HIGHER>,
    request: HealthRequest,
) -> (TarePhase, Option<[f32; 6]>) {
    match rig.ask(Request::Health(request)) {
        Response::Health(HealthResponse::Tare(report)) => (report.phase, report.wrench),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_tare_is_subtracted_flagged_and_gone_with_the_calibration() {
    let scenario = scenario(ScenarioKind::Wrist, 41);
    let mut rig = Rig::<8, { higher_moment_count(8) }>::of(&scenario, 41, DataRate::Hz1000);
    let set = HealthRequest::SetTare { samples: 400, store: false };
    tare(&mut rig, set);
    rig.run(0.5);
    let (phase, wrench) = tare(&mut rig, HealthRequest::ReadTare);
    assert!(matches!(phase, TarePhase::Refused(_)) && wrench.is_none(), "the load is turning: {phase:?}");

    rig.bench.with(|bench| bench.hold(-Vector3::z_axis()));
    rig.run(0.1);
    tare(&mut rig, set);
    rig.run(0.5);
    let (phase, wrench) = tare(&mut rig, HealthRequest::ReadTare);
    assert_eq!(phase, TarePhase::Settled);
    let at_rest = rig.step().truth;
    rig.assert_near(&wrench.expect("it rests"), &at_rest, &(rig.noise() * (6.0 / 20.0)), "the tare");
    rig.bench.with(|bench| bench.hold(Vector3::x_axis()));
    let step = rig.step();
    assert!(step.word.contains(StatusBit::TareActive));
    let allowed = rig.noise() * 7.0;
    for measurement in step.measurements {
        let Measurement::Valid { wrench, .. } = measurement else { panic!("{measurement:?}") };
        rig.assert_near(&wrench, &(&step.truth - &at_rest), &allowed, "tared");
    }
    assert_eq!(rig.sensor.kept_health().tare, None, "kept only when asked");

    let upload = rig.upload();
    rig.ask(Request::UploadCalibration(upload.clone()));
    assert!(rig.step().word.contains(StatusBit::TareActive), "the same calibration once more");
    let mut other = upload;
    other.bias_counts[0] += 1.0;
    other.identity = other.identity_of_numbers();
    rig.ask(Request::UploadCalibration(other));
    assert!(!rig.step().word.contains(StatusBit::TareActive));
    assert_eq!(tare(&mut rig, HealthRequest::ReadTare), (TarePhase::Settled, None));
}

#[test]
fn what_is_kept_is_taken_up_again() {
    let scenario = scenario(ScenarioKind::Fingertip, 42);
    let mut rig = Rig::<4, { higher_moment_count(4) }>::of(&scenario, 42, DataRate::Hz1000);
    rig.bench.with(|bench| bench.hold(Vector3::x_axis()));
    tare(&mut rig, HealthRequest::SetTare { samples: 50, store: true });
    rig.run(0.2);
    let kept = rig.sensor.kept_health();
    assert!(kept.tare.is_some() && kept.peak_ever[0] > 0.0);
    let mut later = Rig::<4, { higher_moment_count(4) }>::of(&scenario, 43, DataRate::Hz1000);
    later.sensor.restore_health(kept);
    assert!(later.step().word.contains(StatusBit::TareActive));
    let report = later.health(HealthRequest::Read);
    assert!(report.peak_ever.iter().zip(&kept.peak_ever).all(|(now, before)| now >= before));
    tare(&mut later, HealthRequest::ClearTare { store: true });
    assert_eq!(later.sensor.kept_health().tare, None);
}

/// While it is at fault, the converter's state and the status word agree.
#[test]
fn a_silent_converter_is_told_at_every_tick_until_it_is_heard() {
    let scenario = scenario(ScenarioKind::Force, 51);
    let mut rig = Rig::<6, { higher_moment_count(6) }>::of(&scenario, 51, DataRate::Hz1000);
    rig.bench.with(|bench| bench.inject(Fault::DataReadyLost { probability: 1.0 }));
    rig.run(0.02);
    for _ in 0..20 {
        let step = rig.step();
        assert!(step.word.contains(StatusBit::AdcFault));
        assert!(step.measurements.iter().all(|it| matches!(it, Measurement::Invalid(InvalidCause::Adc(_)))));
    }
    let Response::Status(status) = rig.ask(Request::Status) else { panic!("a status") };
    assert!(matches!(status.adc, AdcState::Faulty(_)));
    rig.bench.with(Bench::clear_faults);
    rig.run(0.7);
    assert_eq!(rig.sensor.status_word(), StatusWord::NONE);
}
