//! A sensor that runs for long: nothing drifts, and of every conversion it is known what became of it.
//!
//! `tests/soak` runs it for a simulated day in process, and for ten minutes in the emulator; `tests/run` for some minutes and some seconds.
//! `tests/soak` has both begin with counters, and in the emulator with a clock, that are about to begin at zero again; of `tests/run`, the
//! run in process does.
#![cfg(unix)]

use std::env;
use std::time::{Duration, Instant};

use ftcal::link::client::Client;
use ftcal::link::frame::{Frame, Measured, NoWrench, WrenchSample};
use ftcal::link::transport::Transport;
use ftcal::simulator::bench::Bench;
use ftcal::simulator::board::SimulatedBoard;
use ftcal::simulator::bus::SharedBench;
use ftcal::simulator::emulator::Emulator;
use ftcal::simulator::fault::Fault;
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use ftcal::simulator::tunnel::Pace;
use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{DataRate, Gain, SampleIndex};
use ftcal_shared::wire::{Status, StreamKind};
use nalgebra::{DMatrix, DVector, UnitVector3, Vector3};

use ftcal_tests::image;
use ftcal_tests::patience::connect;
use ftcal_tests::truth::{true_calibration, true_matrix};

/// Asks for all of it.
const ALL_WANTED: &str = "FTCAL_SOAK";

const RATE: DataRate = DataRate::Hz250;
const PERIOD_MICROS: u64 = 4_000;

/// How long the next sample may take on a busy machine.
const PATIENCE: Duration = Duration::from_secs(10);

/// Standard deviations that a component may be off: a day has 130 million of them, and chance takes one in 4·10¹¹ beyond this.
const SAMPLE_DEVIATIONS: f64 = 7.0;
/// The same of the mean of one part: there are some hundred of them.
const MEAN_DEVIATIONS: f64 = 5.0;

/// What has come of the stream since the start.
#[derive(Default)]
struct Account {
    first: Option<SampleIndex>,
    last: SampleIndex,
    samples: u64,
    /// Of these, no wrenches because their reply was corrupted.
    corrupted: u64,
    /// Moments at which the converter counted as silent: no samples.
    silences: u64,
    last_micros: u64,
}

impl Account {
    /// Takes in one sample, which must come after the one before; its wrench if it has one.
    fn take(&mut self, sample: &WrenchSample) -> Option<Vec<f64>> {
        let micros = sample.time.as_micros();
        assert!(micros >= self.last_micros, "time went back from {} to {micros}", self.last_micros);
        if sample.stride == 0 {
            self.silences += 1;
            return None;
        }
        if self.first.is_some() {
            let ahead = sample.index.since(self.last);
            assert!((1..1000).contains(&ahead), "{:?} after {:?}", sample.index, self.last);
            let periods = u64::from(ahead);
            assert!((micros - self.last_micros).abs_diff(periods * PERIOD_MICROS) < PERIOD_MICROS);
        }
        self.first.get_or_insert(sample.index);
        (self.last, self.last_micros) = (sample.index, micros);
        self.samples += 1;
        match sample.at_any_age() {
            Measured::Valid(wrench) => Some(wrench.components().iter().copied().map(f64::from).collect()),
            // The emulator's bus gives up where its machine stands still for long.
            Measured::Invalid(NoWrench::Adc(
                AdcFault::ReplyCorrupted | AdcFault::CommandCorrupted | AdcFault::Bus,
            )) => {
                self.corrupted += 1;
                None
            }
            Measured::Invalid(other) => panic!("{other:?} at {:?}", sample.index),
        }
    }

    /// How far the numbers have gone since the first sample, which may be around their end and more.
    fn advanced(&self) -> u64 {
        u64::from(self.last.since(self.first.unwrap())) + 1
    }

    /// Of every conversion since the first it is known what became of it.
    fn check<Line: Transport>(&self, client: &Client<Line>, before: &Status, after: &Status) {
        assert_eq!(self.advanced(), self.samples + client.lost_samples());
        let lost = u64::from(after.lost_conversions.wrapping_sub(before.lost_conversions));
        // The last of them may be known to the sensor alone.
        assert!(
            (0..=2).contains(&(lost.wrapping_sub(client.lost_samples()))),
            "{lost} {}",
            client.lost_samples()
        );
        let corrupted = u64::from(after.corrupted_conversions.wrapping_sub(before.corrupted_conversions));
        assert!(
            (0..=2).contains(&(corrupted.wrapping_sub(self.corrupted))),
            "{corrupted} {}",
            self.corrupted
        );
        let unseen = (after.dropped_samples, after.broken_frames, client.broken_frames());
        assert_eq!((unseen, after.overrun_conversions), ((0, 0, 0), before.overrun_conversions));
    }
}

/// The next sample of the stream.
fn next<Line: Transport>(client: &mut Client<Line>) -> WrenchSample {
    match client.next_frame(PATIENCE).unwrap() {
        Some(Frame::Wrench(sample)) => sample,
        other => panic!("{other:?}; {:?}", client.status()),
    }
}

#[test]
fn a_day_on_the_bench() {
    let (parts, seconds) = if env::var_os(ALL_WANTED).is_some() { (24_u32, 3600_u32) } else { (4, 150) };
    let scenario = Scenario::new(ScenarioKind::Wrist, 1).unwrap();
    let board = SimulatedBoard::about_to_wrap(scenario.sensor.clone(), 1).unwrap();
    let bench = board.bench();
    let mut client = Client::connect(board).unwrap();
    client.configure_adc(RATE, Gain::X128).unwrap();
    bench.with(|bench| {
        bench.hang(scenario.trials[0].load);
        bench.hold(UnitVector3::new_normalize(Vector3::new(1.0, 2.0, -3.0)));
    });
    client.upload_calibration(&true_calibration(&scenario.sensor)).unwrap();
    client.wait(Duration::from_secs(1)).unwrap();
    client.stream(StreamKind::Wrench).unwrap();
    let truth = bench.with(|bench| bench.true_wrench()).components(scenario.sensor.dof());
    let noise = scenario.sensor.noise_counts();
    let matrix = true_matrix(&scenario.sensor);
    let deviations: Vec<f64> =
        matrix.row_iter().map(|row| row.transpose().component_mul(noise).norm()).collect();
    let before = client.status().unwrap();
    assert!(before.conversions > u32::MAX / 2, "is about to wrap");
    bench.with(|bench| {
        bench.inject(Fault::DataReadyLost { probability: 1e-4 });
        bench.inject(Fault::BusBitErrors { probability: 1e-7 });
    });
    let mut account = Account::default();
    for part in 0..parts {
        let (mut sum, mut wrenches) = (DVector::zeros(truth.len()), 0.0);
        for _ in 0..seconds * RATE.hertz() {
            let Some(wrench) = account.take(&next(&mut client)) else { continue };
            for (axis, component) in wrench.iter().enumerate() {
                let off = (component - truth[axis]).abs();
                assert!(off <= SAMPLE_DEVIATIONS * deviations[axis], "component {axis}: {off}");
            }
            sum += DVector::from_vec(wrench);
            wrenches += 1.0;
        }
        let mean = sum / wrenches;
        for (axis, deviation) in deviations.iter().enumerate() {
            let off = (mean[axis] - truth[axis]).abs();
            // What single precision makes of counts of some millions.
            let rounding = 1e-6 * truth.amax();
            assert!(
                off <= MEAN_DEVIATIONS * deviation / f64::sqrt(wrenches) + rounding,
                "part {part}: {off}"
            );
        }
        let after = client.status().unwrap();
        account.check(&client, &before, &after);
    }
    assert!(account.corrupted > 0 && client.lost_samples() > 0, "faults were played");
    println!(
        "{} conversions in {} s of simulated time: {} lost, {} corrupted, {} silences, each accounted for",
        account.advanced(),
        u64::from(parts) * u64::from(seconds),
        client.lost_samples(),
        account.corrupted,
        account.silences
    );
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn ten_minutes_in_the_emulator() {
    let is_whole = env::var_os(ALL_WANTED).is_some();
    let (name, lasting) = if is_whole {
        ("ftcal-soak.elf", Duration::from_mins(10))
    } else {
        ("ftcal-emulated.elf", Duration::from_secs(15))
    };
    let scenario = Scenario::new(ScenarioKind::Wrist, 1).unwrap();
    let bench = SharedBench::new(Bench::new(scenario.sensor.clone(), 1));
    bench.with(|bench| {
        bench.hang(scenario.trials[0].load);
        bench.turn();
    });
    let emulator = Emulator::start(&image::path(name), bench.clone(), Pace::RealTime).unwrap();
    let mut client = connect(&emulator);
    client.configure_adc(RATE, Gain::X128).unwrap();
    client.upload_calibration(&true_calibration(&scenario.sensor)).unwrap();
    client.start_trial(3).unwrap();
    client.stream(StreamKind::Wrench).unwrap();
    let before = client.status().unwrap();
    let (begin, mut account, mut uptime) = (Instant::now(), Account::default(), before.uptime);
    while begin.elapsed() < lasting {
        for _ in 0..RATE.hertz() {
            account.take(&next(&mut client));
        }
        let status = client.status().unwrap();
        assert!(status.uptime > uptime, "the sensor was reset");
        uptime = status.uptime;
    }
    let after = client.status().unwrap();
    account.check(&client, &before, &after);
    client.stream(StreamKind::Off).unwrap();
    let diagnosis = client.diagnosis().unwrap();
    assert_eq!(diagnosis.failure, None);
    assert!(diagnosis.stack_used_bytes < diagnosis.stack_bytes);

    let trial = client.stop_trial().unwrap();
    assert_eq!((trial.saturated, trial.repeated, trial.contradictory), (0, 0, 0));
    println!("{} conversions, each accounted for; trial of {} samples", account.advanced(), trial.used);
    if !is_whole {
        println!("a quarter of a minute has not seen enough for an answer: the trial is not solved");
        return;
    }
    let solution = client.solve_trial().unwrap();
    let shape = DMatrix::from_row_slice(3, scenario.sensor.gages(), &solution.shape_counts_per_load);
    // What the gages say of the load along each axis is the shape of the trial, up to its orientation.
    let axes = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
    let along = axes.map(|axis| {
        bench.with(|bench| {
            bench.hold(axis);
            scenario.sensor.shape().transpose() * bench.true_wrench().components(scenario.sensor.dof())
        })
    });
    let truth = DMatrix::from_columns(&along).transpose();
    let (found, expected) = (shape.transpose() * &shape, truth.transpose() * &truth);
    let off = (&found - &expected).amax() / expected.amax();
    println!("off by {off:.1e} of the shape's products");
    assert!(off < 0.005, "{off}");
}
