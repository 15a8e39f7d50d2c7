//! The firmware's images in the emulator, driven by the host library over a pseudo-terminal.
//!
//! All are run: the emulated one, whose converter is the simulator's, and those of real boards, which find nothing on their bus.
//! `tests/run` builds them and sees to the emulator. One board at a time: two would be too slow for a small machine.
#![cfg(unix)]

use std::fs;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use ftcal::link::client::Client;
use ftcal::link::frame::{Frame, Measured};
use ftcal::link::serial::SerialTransport;
use ftcal::logs::LogStrings;
use ftcal::simulator::bench::Bench;
use ftcal::simulator::bus::SharedBench;
use ftcal::simulator::emulator::Emulator;
use ftcal::simulator::fault::Fault;
use ftcal::simulator::flash::SimulatedFlash;
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use ftcal::simulator::tunnel::{Pace, TunnelledConverter};
use ftcal_firmware::baud::DEFAULT_BAUD;
use ftcal_firmware::tunnel::ANSWER_MICROS;
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{AdcCode, DataRate, DeviceTime, Gain, Rank};
use ftcal_shared::wire::{AdcState, ClockSource, CodesFrame, StreamKind, TrialPhase};
use nalgebra::{SMatrix, UnitVector3, Vector3};

use ftcal_tests::image::{self, LARGEST_RAM};
use ftcal_tests::patience::connect;
use ftcal_tests::truth::{true_calibration, true_matrix};

/// Gages of the image.
const GAGES: usize = 8;

/// Samples of the trial: 20 seconds of turning.
const TRIAL_SAMPLES: usize = 5000;
const TRIAL_RATE: DataRate = DataRate::Hz250;

/// How long the next sample may take on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);

/// How long the board is given to find out what is wrong with its converter, or that nothing is any more.
const DIAGNOSIS: Duration = Duration::from_secs(30);

static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner)
}

fn bench_of(scenario: &Scenario) -> SharedBench {
    SharedBench::new(Bench::new(scenario.sensor.clone(), 1))
}

fn wrist() -> Scenario {
    Scenario::new(ScenarioKind::Wrist, 1).unwrap()
}

fn emulate(converter: impl TunnelledConverter + Send + 'static) -> Emulator {
    Emulator::start(&image::path("ftcal-emulated.elf"), converter, Pace::AsHandled).unwrap()
}

/// Waits until the board says this of its converter. It must answer all the while.
fn wait_for(client: &mut Client<SerialTransport>, expected: AdcState) {
    let mut waited = Duration::ZERO;
    let step = Duration::from_millis(100);
    while client.status().unwrap().adc != expected {
        assert!(waited < DIAGNOSIS, "{:?} instead of {expected:?}", client.status().unwrap().adc);
        client.wait(step).unwrap();
        waited += step;
    }
}

fn next_codes(client: &mut Client<SerialTransport>) -> CodesFrame {
    match client.next_frame(PATIENCE).unwrap() {
        Some(Frame::Codes(frame)) => frame,
        other => panic!("{other:?} instead of codes; {:?}", client.status()),
    }
}

/// SᵀS: what is known of a shape whose orientation is not.
fn unoriented<const RANK: usize>(shape: &SMatrix<f64, RANK, GAGES>) -> SMatrix<f64, GAGES, GAGES> {
    shape.transpose() * shape
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn a_trial_is_run_and_solved_and_wrenches_are_measured() {
    let _alone = alone();
    let scenario = wrist();
    let bench = bench_of(&scenario);
    let emulator = emulate(bench.clone());
    let mut client = connect(&emulator);

    wait_for(&mut client, AdcState::Running);
    // A greeting that meets the board while it starts is broken.
    let (broken_at_start, repeated_at_start) = (client.status().unwrap().broken_frames, client.repetitions());
    let status = client.configure_adc(TRIAL_RATE, Gain::X128).unwrap();
    assert_eq!(usize::from(status.gages), GAGES);
    // The emulator models no crystal: the bounded wait for it, and the fall-back, have worked.
    assert_eq!(status.clock, ClockSource::InternalFallback);

    bench.with(|bench| {
        bench.hang(scenario.trials[0].load);
        bench.turn();
    });
    client.stream(StreamKind::Codes).unwrap();
    client.start_trial(3).unwrap();
    let mut streamed: Vec<_> = (0..TRIAL_SAMPLES).map(|_| next_codes(&mut client)).collect();
    let trial = client.stop_trial().unwrap();
    assert_eq!((trial.phase, trial.saturated), (TrialPhase::Stopped, 0));

    // The same codes, summed up and solved here: every sample that was streamed since the first was offered to the trial.
    // (The numbers may have gaps: on a busy machine, a transfer can take too long for the board.)
    let offered = usize::try_from(trial.offered).unwrap();
    streamed.retain(|frame| frame.index >= trial.first);
    while streamed.len() < offered {
        streamed.push(next_codes(&mut client));
    }
    client.stream(StreamKind::Off).unwrap();
    assert_eq!(client.status().unwrap().dropped_samples, 0);
    assert_eq!(streamed[0].index, trial.first);
    let taken = &streamed[..offered];
    let codes = |frame: &CodesFrame| -> [AdcCode; GAGES] { frame.codes.as_slice().try_into().unwrap() };
    let mut bins = Box::new(Bins::<GAGES, { higher_moment_count(GAGES) }>::new());
    for frame in taken {
        bins.offer(&codes(frame)).unwrap();
    }
    bins.finish();
    let expected = bins.solve(Rank::Spatial).unwrap().solution;

    let solution = client.solve_trial().unwrap();
    assert_eq!(u64::from(solution.samples), expected.samples);
    let solved = client.trial_status().unwrap();
    assert_eq!((solved.used, solved.used + solved.moving), (solution.samples, trial.used));
    let shape = SMatrix::<f64, 3, GAGES>::from_row_slice(&solution.shape_counts_per_load);
    // The same sums and the same steps: they differ by the rounding of square roots and the like, which the
    // solution's condition amplifies.
    let expected_gram = unoriented(&expected.shape_counts_per_load);
    assert!((unoriented(&shape) - expected_gram).amax() <= 1e-9 * expected_gram.amax());
    for (bias, expected) in solution.bias_counts.iter().zip(&expected.bias_counts) {
        assert!((bias - expected).abs() <= 1e-9 * expected_gram.amax().sqrt());
    }

    // A load in another place, measured with the sensor's true calibration.
    let upload = true_calibration(&scenario.sensor);
    client.upload_calibration(&upload).unwrap();
    bench.with(|bench| {
        bench.hang(scenario.validation[0]);
        bench.hold(UnitVector3::new_normalize(Vector3::new(1.0, 2.0, -3.0)));
    });
    client.stream(StreamKind::Wrench).unwrap();
    let truth = bench.with(|bench| bench.true_wrench()).components(scenario.sensor.dof());
    let matrix = true_matrix(&scenario.sensor);
    let noise = scenario.sensor.noise_counts();
    // What was converted before the load hung there is on its way, at most the queue's length.
    for _ in 0..100 {
        client.next_frame(PATIENCE).unwrap();
    }
    for _ in 0..100 {
        let Some(Frame::Wrench(sample)) = client.next_frame(PATIENCE).unwrap() else { panic!("no wrench") };
        let Measured::Valid(wrench) = sample.at_any_age() else { panic!("{:?}", sample.at_any_age()) };
        assert_eq!(wrench.calibration(), upload.identity);
        for (row, component) in wrench.components().iter().enumerate() {
            let deviation = matrix.row(row).transpose().component_mul(noise).norm();
            // 600 comparisons with six standard deviations: one in a million fails.
            assert!((f64::from(*component) - truth[row]).abs() <= 6.0 * deviation, "component {row}");
        }
    }
    let status = client.status().unwrap();
    assert_eq!((status.dropped_samples, client.broken_frames()), (0, 0));
    // None is lost but by a machine that stands still for longer than the board's queue lasts, and then the question is asked again.
    let broken = u64::from(status.broken_frames - broken_at_start);
    let repeated = client.repetitions() - repeated_at_start;
    assert!(broken <= repeated, "{broken} requests came broken, and {repeated} were repeated");

    // For tests/speed: after a trial, its solution and a stream, with every interrupt on top of each.
    let diagnosis = client.diagnosis().unwrap();
    println!("stack_used {}", diagnosis.stack_used_bytes);
    assert!(diagnosis.stack_used_bytes < diagnosis.stack_bytes);
    let variables = image::sizes(&image::path("ftcal-emulated.elf")).ram;
    assert!(
        variables + u64::from(diagnosis.stack_used_bytes) <= LARGEST_RAM,
        "{variables} bytes, {diagnosis:?}"
    );
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn the_log_says_what_the_image_is_and_what_becomes_of_its_converter() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let (image, log) = (image::path("ftcal-emulated.elf"), folder.path().join("log"));
    let flash = SimulatedFlash::default();
    let emulator =
        Emulator::start_with(&image, bench_of(&wrist()), flash, Pace::AsHandled, Some(&log)).unwrap();
    wait_for(&mut connect(&emulator), AdcState::Running);
    drop(emulator);

    let (strings, mut words) = (LogStrings::read(&image).unwrap(), Vec::new());
    let decoded = strings.reader().take_in(&fs::read(&log).unwrap(), &mut words).unwrap();
    let words = String::from_utf8(words).unwrap();
    assert_eq!(decoded.damaged, 0, "{words}");
    let first = words.lines().next().unwrap();
    assert!(
        first.contains(concat!("ftcal ", env!("CARGO_PKG_VERSION"))) && first.contains("InternalFallback"),
        "{words}"
    );
    assert!(words.lines().any(|line| line.contains("converter: Running")), "{words}");
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn a_converter_that_is_missing_is_reported_and_found_again() {
    let _alone = alone();
    let bench = bench_of(&wrist());
    bench.with(|bench| bench.inject(Fault::ConverterMissing));
    let emulator = emulate(bench.clone());
    let mut client = connect(&emulator);
    wait_for(&mut client, AdcState::Faulty(AdcFault::NotResponding));
    bench.with(Bench::clear_faults);
    wait_for(&mut client, AdcState::Running);
    bench.with(|bench| bench.inject(Fault::DataReadyLost { probability: 1.0 }));
    wait_for(&mut client, AdcState::Faulty(AdcFault::DataReadyLost));
}

/// A host end that answers too late, always.
struct Late;

impl TunnelledConverter for Late {
    fn exchange(&mut self, _from_board: &[u8], _to_board: &mut [u8]) {
        thread::sleep(Duration::from_micros(2 * ANSWER_MICROS));
    }

    fn next_conversion(&mut self) -> bool {
        true
    }

    fn now(&self) -> DeviceTime {
        DeviceTime::default()
    }
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn a_tunnel_that_does_not_answer_is_a_bus_fault() {
    let _alone = alone();
    let emulator = emulate(Late);
    let mut client = connect(&emulator);
    wait_for(&mut client, AdcState::Faulty(AdcFault::Bus));
    client.hello().unwrap();
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn the_image_of_the_feather_starts_and_says_that_its_bus_is_empty() {
    starts_and_says_that_its_bus_is_empty("ftcal-feather-stm32f405.elf");
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn the_image_of_the_olimex_board_starts_and_says_that_its_bus_is_empty() {
    starts_and_says_that_its_bus_is_empty("ftcal-olimex-stm32-h405.elf");
}

fn starts_and_says_that_its_bus_is_empty(name: &str) {
    let _alone = alone();
    let converter = bench_of(&wrist());
    let emulator = Emulator::start(&image::path(name), converter, Pace::AsHandled).unwrap();
    let mut client = connect(&emulator);
    wait_for(&mut client, AdcState::Faulty(AdcFault::NotResponding));
    assert_eq!(client.status().unwrap().conversions, 0);
    // The emulated line carries all rates; what counts is that the board changes to them, and goes on.
    for baud in [2_000_000, 1_000_000, DEFAULT_BAUD] {
        client.change_rate(baud).unwrap();
        client.status().unwrap();
    }
    assert!(client.change_rate(3_000_000).is_err());
    client.status().unwrap();
}
