//! Calibration in the field with a button, a light and no host, on the simulated board: the firmware's own application on the simulated
//! converter, in virtual time.
//!
//! A sensor that was calibrated exactly is exchanged, under the same memory, for one that has drifted.

use std::time::Duration;

use ftcal::link::client::Client;
use ftcal::link::error::ClientError;
use ftcal::link::frame::{Frame, Measured};
use ftcal::link::transport::Transport;
use ftcal::simulator::bench::Load;
use ftcal::simulator::board::SimulatedBoard;
use ftcal::simulator::bus::SharedBench;
use ftcal::simulator::flash::SimulatedFlash;
use ftcal::simulator::operator::turn;
use ftcal::simulator::panel::SharedPanel;
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use ftcal::simulator::sensor::SoftwareSensor;
use ftcal_shared::estimation::reorientation::MODEL_ERROR;
use ftcal_shared::units::{DataRate, Gain};
use ftcal_shared::wire::{
    CalibrationOrigin, CalibrationUpload, FieldOutcome, FieldPhase, FieldRefusal, GageList, KeptCalibration,
    Rejection, Renewed, StreamKind, TrialPhase,
};
use nalgebra::{DMatrix, UnitVector3, Vector3};

const SEED: u64 = 5;
/// The sensors and hands of those tests in which it matters.
const SEEDS: std::ops::Range<u64> = 1..6;

/// A pattern of the light has sixteen slots of this length; see `firmware/src/field/light.rs`.
const SLOT_MICROS: u128 = 1 << 17;

/// How long a trial may take, and how long what comes after it.
const PATIENCE: Duration = Duration::from_mins(10);

/// What the answer of a gage may be off by, relative to it, that is no drift: three standard deviations of what the trial has to
/// predict before it ends by itself, and of what no linear shape explains.
const OFF: f64 = 3.0 * (5e-4 + MODEL_ERROR);

/// The light in one round: how often it goes on, and in how many slots it is on.
type Seen = (usize, usize);
const DARK: Seen = (0, 0);
const WORKING: Seen = (1, 8);
const RENEWED: Seen = (0, 16);
const CONFIRMED: Seen = (2, 14);
const REFUSED: Seen = (8, 8);

/// A board with somebody before it.
struct Bench {
    client: Client<SimulatedBoard>,
    panel: SharedPanel,
    bench: SharedBench,
}

fn upload(sensor: &SoftwareSensor) -> CalibrationUpload {
    let shape = sensor.shape();
    let matrix = (shape * shape.transpose()).try_inverse().expect("of full rank") * shape;
    #[expect(clippy::cast_possible_truncation, reason = "this is the form in which it travels")]
    let matrix = matrix.transpose().iter().map(|&element| element as f32).collect();
    let bias_counts = GageList::from_slice(sensor.bias_counts().as_slice()).expect("at most twelve");
    let mut upload = CalibrationUpload { dof: sensor.dof(), bias_counts, matrix, identity: 0 };
    upload.identity = upload.identity_of_numbers();
    upload
}

/// A sensor whose gage answers so many times as much, and whose bias has moved by this many counts.
fn drifted(sensor: &SoftwareSensor, gage: usize, gain: f64, bias_counts: f64) -> SoftwareSensor {
    let (mut shape, mut bias) = (sensor.shape().clone(), sensor.bias_counts().clone());
    shape.column_mut(gage).scale_mut(gain);
    bias[gage] += bias_counts;
    SoftwareSensor::new(sensor.dof(), shape, bias, sensor.noise_counts().clone()).expect("sizes fit")
}

impl Bench {
    fn new(sensor: &SoftwareSensor, flash: SimulatedFlash, load: Load, seed: u64) -> Self {
        let board = SimulatedBoard::with_flash(sensor.clone(), seed, flash).expect("sizes fit");
        let (panel, bench) = (board.panel(), board.bench());
        bench.with(|bench| {
            bench.hang(load);
            turn(bench);
        });
        let mut client = Client::connect(board).expect("answers");
        client.wait_for_converter().expect("the converter starts");
        let mut bench = Self { client, panel, bench };
        // The button is to be seen released first.
        bench.wait(Duration::from_millis(100));
        bench
    }

    /// A sensor that knows its truth, exchanged for another one.
    fn exchanged(scenario: &Scenario, other: &SoftwareSensor, seed: u64) -> Self {
        let (flash, load) = (SimulatedFlash::default(), scenario.trials[0].load);
        let mut before = Self::new(&scenario.sensor, flash.clone(), load, seed);
        before.client.upload_calibration(&upload(&scenario.sensor)).expect("answers");
        before.client.store_calibration().expect("stores");
        Self::new(other, flash, load, seed)
    }

    fn wait(&mut self, time: Duration) {
        self.client.wait(time).expect("the line is sound");
    }

    fn press(&mut self, time: Duration) {
        self.panel.press(true);
        self.wait(time);
        self.panel.press(false);
        self.wait(Duration::from_millis(100));
    }

    fn hold_down(&mut self) {
        self.press(Duration::from_millis(2500));
    }

    fn tap(&mut self) {
        self.press(Duration::from_millis(300));
    }

    /// The light over one round.
    fn light(&mut self) -> Seen {
        // In the middle of each slot.
        let seen: Vec<bool> = (0..16)
            .map(|_| {
                let into_slot = (self.client.line().elapsed().as_micros() + SLOT_MICROS / 2) % SLOT_MICROS;
                let rest = u64::try_from(SLOT_MICROS - into_slot).expect("small");
                self.wait(Duration::from_micros(rest));
                self.panel.light()
            })
            .collect();
        let edges = (0..16).filter(|&slot| seen[slot] && !seen[(slot + 15) % 16]).count();
        let on = seen.iter().filter(|&&is_on| is_on).count();
        (edges, on)
    }

    fn phase(&mut self) -> FieldPhase {
        self.client.field().expect("answers").phase
    }

    /// What the calibration ends with, and how often the light flashed while the trial ran, at most.
    fn outcome(&mut self) -> (FieldOutcome, usize) {
        let (begin, mut most) = (self.client.line().elapsed(), 0);
        while self.client.line().elapsed() - begin < PATIENCE {
            let before = self.phase();
            let (flashes, _) = self.light();
            match (before, self.phase()) {
                (FieldPhase::Running { quarters: before }, FieldPhase::Running { quarters: after })
                    if before == after =>
                {
                    assert_eq!(flashes, usize::from(before) + 1);
                    most = most.max(flashes);
                }
                (_, FieldPhase::Idle) => {
                    let report = self.client.field().expect("answers");
                    return (report.last.expect("an outcome"), most);
                }
                _ => {}
            }
        }
        panic!("no outcome")
    }

    fn refusal(&mut self) -> FieldRefusal {
        match self.outcome() {
            (FieldOutcome::Refused(refusal), _) => {
                assert_eq!(self.light(), REFUSED);
                refusal
            }
            other => panic!("{other:?}"),
        }
    }

    /// The root mean square error of a known load in all directions, relative to it, as streamed wrenches tell it.
    fn error(&mut self, load: Load) -> f64 {
        let directions = [Vector3::x(), Vector3::y(), Vector3::z(), Vector3::new(1.0, 1.0, 1.0)];
        let mut squares = 0.0;
        for direction in directions.into_iter().flat_map(|direction| [direction, -direction]) {
            self.bench.with(|bench| {
                bench.hang(load);
                bench.hold(UnitVector3::new_normalize(direction));
            });
            self.wait(Duration::from_millis(50));
            self.client.stream(StreamKind::Wrench).expect("answers");
            let (mut sum, mut count) = (Vector3::zeros(), 0);
            while count < 200 {
                let frame = self.client.next_frame(Duration::from_secs(1)).expect("the line is sound");
                let Some(Frame::Wrench(sample)) = frame else { continue };
                if let Measured::Valid(wrench) = sample.measured {
                    let force = wrench.components();
                    sum += Vector3::from_fn(|axis, _| f64::from(force[axis]));
                    count += 1;
                }
            }
            self.client.stream(StreamKind::Off).expect("answers");
            let truth = self.bench.with(|bench| bench.true_wrench().force_newton);
            squares += (sum / f64::from(count) - truth).norm_squared() / truth.norm_squared();
        }
        (squares / 8.0).sqrt()
    }
}

fn force(seed: u64) -> Scenario {
    Scenario::new(ScenarioKind::Force, seed).expect("sizes fit")
}

/// What a calibration makes of loads of a sensor, beyond a common factor: C Sᵀ over its mean gain, less the identity.
fn shape_error(calibration: &CalibrationUpload, sensor: &SoftwareSensor) -> f64 {
    let gages = sensor.gages();
    let matrix = DMatrix::from_fn(3, gages, |row, gage| f64::from(calibration.matrix[row * gages + gage]));
    let product = matrix * sensor.shape().transpose();
    let mean = product.trace() / 3.0;
    (product / mean - DMatrix::identity(3, 3)).norm()
}

#[test]
fn a_drifted_sensor_is_renewed_and_measures_better() {
    SEEDS.for_each(is_renewed);
}

fn is_renewed(seed: u64) {
    let scenario = force(seed);
    let other = drifted(&scenario.sensor, 2, 1.005, 20_000.0);
    let mut bench = Bench::exchanged(&scenario, &other, seed);
    let before = upload(&scenario.sensor);
    let known = scenario.validation[0];
    let error_before = bench.error(known);
    bench.bench.with(|bench| {
        bench.hang(scenario.trials[0].load);
        turn(bench);
    });

    assert_eq!(bench.light(), DARK);
    bench.hold_down();
    let (outcome, flashes) = bench.outcome();
    let FieldOutcome::Renewed(Renewed::ShapeAndBias, found) = outcome else { panic!("{outcome:?}") };
    assert_eq!(flashes, 4);
    assert_eq!(bench.light(), RENEWED);
    assert_eq!((found.reference, found.gage), (before.identity, 2));
    assert!(f64::from(found.relative_uncertainty) <= 5e-4);
    assert!((f64::from(found.drift) - 0.005).abs() < OFF, "{found:?}");
    let newton = scenario.trials[0].load.mass_kg * ftcal::simulator::bench::STANDARD_GRAVITY;
    assert!((f64::from(found.load_newton) / newton - 1.0).abs() < OFF, "{found:?}");

    let renewed = bench.client.read_calibration().expect("answers").expect("calibrated");
    assert_ne!(renewed.identity, before.identity);
    let status = bench.client.status().expect("answers");
    assert_eq!(status.kept.current, KeptCalibration::Calibration(renewed.identity));
    assert_eq!(status.kept.previous, Some(before.identity));
    let (old, new) = (shape_error(&before, &other), shape_error(&renewed, &other));
    assert!(new < old, "{old} {new}");
    let error_after = bench.error(known);
    assert!(error_after < error_before, "{error_before} {error_after}");

    // The light goes out with a press, which does nothing else.
    assert_eq!(bench.light(), RENEWED);
    bench.tap();
    assert_eq!((bench.light(), bench.phase()), (DARK, FieldPhase::Idle));
    let origin = bench.client.field().expect("answers").origin;
    assert_eq!(origin, Some(CalibrationOrigin::Field(Renewed::ShapeAndBias, found)));
    bench.client.roll_back().expect("rolls back");
    assert_eq!(
        bench.client.read_calibration().expect("answers").map(|now| now.identity),
        Some(before.identity)
    );
    assert_eq!(bench.client.field().expect("answers").origin, Some(CalibrationOrigin::Uploaded));
}

#[test]
fn a_sensor_that_has_not_moved_keeps_its_calibration() {
    SEEDS.for_each(is_confirmed);
}

fn is_confirmed(seed: u64) {
    let scenario = force(seed);
    let mut bench = Bench::exchanged(&scenario, &scenario.sensor, seed);
    bench.hold_down();
    let (outcome, _) = bench.outcome();
    let FieldOutcome::Confirmed(found) = outcome else { panic!("{outcome:?}") };
    assert!(f64::from(found.drift) < OFF, "{found:?}");
    assert_eq!(bench.light(), CONFIRMED);
    let status = bench.client.status().expect("answers");
    assert_eq!((status.calibration, status.kept.previous), (Some(upload(&scenario.sensor).identity), None));
}

#[test]
fn too_large_a_drift_is_refused() {
    let scenario = force(SEED);
    let mut bench = Bench::exchanged(&scenario, &drifted(&scenario.sensor, 4, 0.95, 0.0), SEED);
    bench.hold_down();
    let refusal = bench.refusal();
    let FieldRefusal::Drifted { gage: 4, drift, limit } = refusal else { panic!("{refusal:?}") };
    assert!(drift > limit && drift < 0.1);
    let status = bench.client.status().expect("answers");
    assert_eq!((status.calibration, status.kept.previous), (Some(upload(&scenario.sensor).identity), None));
    // A press makes the light go out, and a long one begins anew, which another press ends.
    bench.tap();
    assert_eq!(bench.light(), DARK);
    bench.hold_down();
    bench.wait(Duration::from_secs(30));
    assert!(matches!(bench.phase(), FieldPhase::Running { .. }));
    bench.tap();
    let refusal = bench.refusal();
    assert!(matches!(refusal, FieldRefusal::Unfinished { quarters: 0..=1, need: 3 }), "{refusal:?}");
}

#[test]
fn a_planar_sensor_is_renewed_too() {
    let scenario = Scenario::new(ScenarioKind::Fingertip, SEED).expect("sizes fit");
    let other = drifted(&scenario.sensor, 1, 0.99, 0.0);
    let mut bench = Bench::exchanged(&scenario, &other, SEED);
    bench.hold_down();
    let (outcome, _) = bench.outcome();
    let FieldOutcome::Renewed(Renewed::ShapeAndBias, found) = outcome else { panic!("{outcome:?}") };
    assert_eq!(found.gage, 1);
}

#[test]
fn what_cannot_be_calibrated_in_the_field_is_refused_at_once() {
    let wrist = Scenario::new(ScenarioKind::Wrist, SEED).expect("sizes fit");
    let mut bench = Bench::exchanged(&wrist, &wrist.sensor, SEED);
    bench.hold_down();
    assert_eq!(bench.refusal(), FieldRefusal::MeasuresTorque);

    let force = force(SEED);
    let mut bench = Bench::new(&force.sensor, SimulatedFlash::default(), force.trials[0].load, SEED);
    bench.hold_down();
    assert_eq!(bench.refusal(), FieldRefusal::Uncalibrated);
    bench.client.upload_calibration(&upload(&force.sensor)).expect("answers");
    bench.hold_down();
    assert_eq!(bench.refusal(), FieldRefusal::CalibrationNotKept);
    bench.client.store_calibration().expect("stores");
    bench.client.configure_adc(DataRate::Hz1000, Gain::X64).expect("the converter starts");
    bench.hold_down();
    assert_eq!(bench.refusal(), FieldRefusal::GainChanged);
    bench.client.configure_adc(DataRate::Hz1000, Gain::X128).expect("the converter starts");
    bench.client.start_trial(3).expect("starts");
    bench.hold_down();
    assert_eq!(bench.refusal(), FieldRefusal::Busy(Rejection::TrialBusy));
    assert_eq!(bench.client.trial_status().expect("answers").phase, TrialPhase::Running);
}

#[test]
fn a_load_that_does_not_turn_through_all_directions_has_no_answer() {
    let scenario = force(SEED);
    let mut bench = Bench::exchanged(&scenario, &scenario.sensor, SEED);
    bench.bench.with(|bench| {
        bench.hold(UnitVector3::new_normalize(Vector3::new(0.0, -1.0, 0.0)));
        bench.turn_in_plane(ftcal::simulator::motion::Turning::Counterclockwise);
    });
    bench.hold_down();
    bench.wait(Duration::from_mins(1));
    assert_eq!(bench.phase(), FieldPhase::Running { quarters: 0 });
    assert_eq!(bench.light(), (1, 1));
    bench.tap();
    assert!(matches!(bench.refusal(), FieldRefusal::Trial(_)));
}

#[test]
fn a_host_has_precedence() {
    let scenario = force(SEED);
    let other = drifted(&scenario.sensor, 2, 1.01, 0.0);
    let mut bench = Bench::exchanged(&scenario, &other, SEED);
    bench.hold_down();
    let begun = bench.client.start_trial(3);
    assert!(matches!(begun, Err(ClientError::Rejected(Rejection::TrialBusy))), "{begun:?}");
    bench.client.stop_trial().expect("a host may stop it");
    assert_eq!(bench.refusal(), FieldRefusal::TakenOver);

    // Another calibration is no longer the one to be oriented to.
    bench.hold_down();
    bench.client.upload_calibration(&upload(&other)).expect("answers");
    assert_eq!(bench.refusal(), FieldRefusal::CalibrationChanged);
    bench.client.roll_back().expect_err("there is none before it");

    // Under whoever streams, nothing is changed.
    bench.client.upload_calibration(&upload(&scenario.sensor)).expect("answers");
    bench.hold_down();
    bench.client.stream(StreamKind::Wrench).expect("answers");
    let begin = bench.client.line().elapsed();
    while bench.phase() != FieldPhase::Storing {
        bench.wait(Duration::from_secs(1));
        assert!(bench.client.line().elapsed() - begin < PATIENCE);
    }
    assert_eq!(bench.light(), WORKING);
    let identity = upload(&scenario.sensor).identity;
    assert_eq!(bench.client.status().expect("answers").calibration, Some(identity));
    bench.client.stream(StreamKind::Off).expect("answers");
    let (outcome, _) = bench.outcome();
    assert!(matches!(outcome, FieldOutcome::Renewed(..)), "{outcome:?}");
    assert_ne!(bench.client.status().expect("answers").calibration, Some(identity));
}

#[test]
fn a_reset_costs_no_more_than_since_the_last_checkpoint() {
    let scenario = force(SEED);
    let other = drifted(&scenario.sensor, 0, 1.01, 0.0);
    let (flash, load) = (SimulatedFlash::default(), scenario.trials[0].load);
    let mut bench = Bench::new(&scenario.sensor, flash.clone(), load, SEED);
    bench.client.upload_calibration(&upload(&scenario.sensor)).expect("answers");
    bench.client.store_calibration().expect("stores");
    let mut bench = Bench::new(&other, flash.clone(), load, SEED);
    bench.hold_down();
    // The first checkpoint is due after ten seconds.
    bench.wait(Duration::from_secs(11));
    assert!(matches!(bench.phase(), FieldPhase::Running { .. }));
    drop(bench);
    let mut bench = Bench::new(&other, flash, load, SEED);
    assert!(matches!(bench.phase(), FieldPhase::Running { .. }));
    assert!(bench.client.trial_status().expect("answers").checkpointed > 0);
    let (outcome, _) = bench.outcome();
    assert!(matches!(outcome, FieldOutcome::Renewed(Renewed::ShapeAndBias, _)), "{outcome:?}");
}
