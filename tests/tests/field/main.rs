//! Calibration in the field with a button, a light and no host, on the simulated board: the firmware's own application on the simulated
//! converter, in virtual time.
//!
//! A sensor that was calibrated exactly is exchanged, under the same memory, for one that has drifted.

mod rig;

use std::ops::Range;
use std::time::Duration;

use ftcal::link::error::ClientError;
use ftcal::link::transport::Transport;
use ftcal::simulator::bench::STANDARD_GRAVITY;
use ftcal::simulator::flash::SimulatedFlash;
use ftcal::simulator::motion::Turning;
use ftcal::simulator::operator::turn;
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use ftcal_shared::estimation::reorientation::MODEL_ERROR;
use ftcal_shared::units::{DataRate, Gain};
use ftcal_shared::wire::{
    CalibrationOrigin, FieldOutcome, FieldPhase, FieldRefusal, KeptCalibration, Rejection, Renewed,
    StreamKind, TrialPhase,
};
use nalgebra::{UnitVector3, Vector3};

use rig::{CONFIRMED, DARK, PATIENCE, RENEWED, Rig, WORKING, drifted};

use ftcal_tests::truth::{shape_error, true_calibration};

const SEED: u64 = 5;
/// The sensors and hands of those tests in which it matters.
const SEEDS: Range<u64> = 1..6;

/// What the answer of a gage may be off by, relative to it, that is no drift: three standard deviations of what the trial has to
/// predict before it ends by itself, and of what no linear shape explains.
const OFF: f32 = 3.0 * (5e-4 + MODEL_ERROR);

fn force(seed: u64) -> Scenario {
    Scenario::new(ScenarioKind::Force, seed).expect("sizes fit")
}

#[test]
fn a_drifted_sensor_is_renewed_and_measures_better() {
    SEEDS.for_each(is_renewed);
}

fn is_renewed(seed: u64) {
    let scenario = force(seed);
    let other = drifted(&scenario.sensor, 2, 1.005, 20_000.0);
    let mut rig = Rig::exchanged(&scenario, &other, seed);
    let before = true_calibration(&scenario.sensor);
    let known = scenario.validation[0];
    let error_before = rig.error(known);
    rig.bench.with(|bench| {
        bench.hang(scenario.trials[0].load);
        turn(bench);
    });

    assert_eq!(rig.light(), DARK);
    rig.hold_down();
    let (outcome, flashes) = rig.outcome();
    let FieldOutcome::Renewed(Renewed::ShapeAndBias, found) = outcome else { panic!("{outcome:?}") };
    assert_eq!(flashes, 4);
    assert_eq!(rig.light(), RENEWED);
    assert_eq!((found.reference, found.gage), (before.identity, 2));
    assert!(found.relative_uncertainty <= 5e-4);
    assert!((found.drift - 0.005).abs() < OFF, "{found:?}");
    let newton = scenario.trials[0].load.mass_kg * STANDARD_GRAVITY;
    assert!((f64::from(found.load_newton) / newton - 1.0).abs() < f64::from(OFF), "{found:?}");

    let renewed = rig.client.read_calibration().expect("answers").expect("calibrated");
    assert_ne!(renewed.identity, before.identity);
    let status = rig.client.status().expect("answers");
    assert_eq!(status.kept.current, KeptCalibration::Calibration(renewed.identity));
    assert_eq!(status.kept.previous, Some(before.identity));
    let (old, new) = (shape_error(&before, &other), shape_error(&renewed, &other));
    assert!(new < old, "{old} {new}");
    let error_after = rig.error(known);
    assert!(error_after < error_before, "{error_before} {error_after}");

    // The light goes out with a press, which does nothing else.
    assert_eq!(rig.light(), RENEWED);
    rig.tap();
    assert_eq!((rig.light(), rig.phase()), (DARK, FieldPhase::Idle));
    let origin = rig.client.field().expect("answers").origin;
    assert_eq!(origin, Some(CalibrationOrigin::Field(Renewed::ShapeAndBias, found)));
    rig.client.roll_back().expect("rolls back");
    assert_eq!(
        rig.client.read_calibration().expect("answers").map(|now| now.identity),
        Some(before.identity)
    );
    assert_eq!(rig.client.field().expect("answers").origin, Some(CalibrationOrigin::Uploaded));
}

#[test]
fn a_sensor_that_has_not_moved_keeps_its_calibration() {
    SEEDS.for_each(is_confirmed);
}

fn is_confirmed(seed: u64) {
    let scenario = force(seed);
    let mut rig = Rig::exchanged(&scenario, &scenario.sensor, seed);
    rig.hold_down();
    let (outcome, _) = rig.outcome();
    let FieldOutcome::Confirmed(found) = outcome else { panic!("{outcome:?}") };
    assert!(found.drift < OFF, "{found:?}");
    assert_eq!(rig.light(), CONFIRMED);
    let status = rig.client.status().expect("answers");
    assert_eq!(
        (status.calibration, status.kept.previous),
        (Some(true_calibration(&scenario.sensor).identity), None)
    );
}

#[test]
fn too_large_a_drift_is_refused() {
    let scenario = force(SEED);
    let mut rig = Rig::exchanged(&scenario, &drifted(&scenario.sensor, 4, 0.95, 0.0), SEED);
    rig.hold_down();
    let refusal = rig.refusal();
    let FieldRefusal::Drifted { gage: 4, drift, limit } = refusal else { panic!("{refusal:?}") };
    assert!(drift > limit && drift < 0.1);
    let status = rig.client.status().expect("answers");
    assert_eq!(
        (status.calibration, status.kept.previous),
        (Some(true_calibration(&scenario.sensor).identity), None)
    );
    // A press makes the light go out, and a long one begins anew, which another press ends.
    rig.tap();
    assert_eq!(rig.light(), DARK);
    rig.hold_down();
    rig.wait(Duration::from_secs(30));
    assert!(matches!(rig.phase(), FieldPhase::Running { .. }));
    rig.tap();
    let refusal = rig.refusal();
    assert!(matches!(refusal, FieldRefusal::Unfinished { quarters: 0..=1, need: 3 }), "{refusal:?}");
}

#[test]
fn a_planar_sensor_is_renewed_too() {
    let scenario = Scenario::new(ScenarioKind::Fingertip, SEED).expect("sizes fit");
    let other = drifted(&scenario.sensor, 1, 0.99, 0.0);
    let mut rig = Rig::exchanged(&scenario, &other, SEED);
    rig.hold_down();
    let (outcome, _) = rig.outcome();
    let FieldOutcome::Renewed(Renewed::ShapeAndBias, found) = outcome else { panic!("{outcome:?}") };
    assert_eq!(found.gage, 1);
}

#[test]
fn what_cannot_be_calibrated_in_the_field_is_refused_at_once() {
    let wrist = Scenario::new(ScenarioKind::Wrist, SEED).expect("sizes fit");
    let mut rig = Rig::exchanged(&wrist, &wrist.sensor, SEED);
    rig.hold_down();
    assert_eq!(rig.refusal(), FieldRefusal::MeasuresTorque);

    let force = force(SEED);
    let mut rig = Rig::new(&force.sensor, SimulatedFlash::default(), force.trials[0].load, SEED);
    rig.hold_down();
    assert_eq!(rig.refusal(), FieldRefusal::Uncalibrated);
    rig.client.upload_calibration(&true_calibration(&force.sensor)).expect("answers");
    rig.hold_down();
    assert_eq!(rig.refusal(), FieldRefusal::CalibrationNotKept);
    rig.client.store_calibration().expect("stores");
    rig.client.configure_adc(DataRate::Hz1000, Gain::X64).expect("the converter starts");
    rig.hold_down();
    assert_eq!(rig.refusal(), FieldRefusal::GainChanged);
    rig.client.configure_adc(DataRate::Hz1000, Gain::X128).expect("the converter starts");
    rig.client.start_trial(3).expect("starts");
    rig.hold_down();
    assert_eq!(rig.refusal(), FieldRefusal::Busy(Rejection::TrialBusy));
    assert_eq!(rig.client.trial_status().expect("answers").phase, TrialPhase::Running);
}

#[test]
fn a_load_that_does_not_turn_through_all_directions_has_no_answer() {
    let scenario = force(SEED);
    let mut rig = Rig::exchanged(&scenario, &scenario.sensor, SEED);
    rig.bench.with(|bench| {
        bench.hold(UnitVector3::new_normalize(Vector3::new(0.0, -1.0, 0.0)));
        bench.turn_in_plane(Turning::Counterclockwise);
    });
    rig.hold_down();
    rig.wait(Duration::from_mins(1));
    assert_eq!(rig.phase(), FieldPhase::Running { quarters: 0 });
    assert_eq!(rig.light(), (1, 1));
    rig.tap();
    assert!(matches!(rig.refusal(), FieldRefusal::Trial(_)));
}

#[test]
fn a_host_has_precedence() {
    let scenario = force(SEED);
    let other = drifted(&scenario.sensor, 2, 1.01, 0.0);
    let mut rig = Rig::exchanged(&scenario, &other, SEED);
    rig.hold_down();
    let begun = rig.client.start_trial(3);
    assert!(matches!(begun, Err(ClientError::Rejected(Rejection::TrialBusy))), "{begun:?}");
    rig.client.stop_trial().expect("a host may stop it");
    assert_eq!(rig.refusal(), FieldRefusal::TakenOver);

    // Another calibration is no longer the one to be oriented to.
    rig.hold_down();
    rig.client.upload_calibration(&true_calibration(&other)).expect("answers");
    assert_eq!(rig.refusal(), FieldRefusal::CalibrationChanged);
    rig.client.roll_back().expect_err("there is none before it");

    // Under whoever streams, nothing is changed.
    rig.client.upload_calibration(&true_calibration(&scenario.sensor)).expect("answers");
    rig.hold_down();
    rig.client.stream(StreamKind::Wrench).expect("answers");
    let end = rig.client.line().elapsed() + PATIENCE;
    while rig.phase() != FieldPhase::Storing {
        rig.wait(Duration::from_secs(1));
        assert!(rig.client.line().elapsed() < end);
    }
    assert_eq!(rig.light(), WORKING);
    let identity = true_calibration(&scenario.sensor).identity;
    assert_eq!(rig.client.status().expect("answers").calibration, Some(identity));
    rig.client.stream(StreamKind::Off).expect("answers");
    let (outcome, _) = rig.outcome();
    assert!(matches!(outcome, FieldOutcome::Renewed(..)), "{outcome:?}");
    assert_ne!(rig.client.status().expect("answers").calibration, Some(identity));
}

#[test]
fn a_reset_costs_no_more_than_since_the_last_checkpoint() {
    let scenario = force(SEED);
    let other = drifted(&scenario.sensor, 0, 1.01, 0.0);
    let (flash, load) = (SimulatedFlash::default(), scenario.trials[0].load);
    let mut rig = Rig::new(&scenario.sensor, flash.clone(), load, SEED);
    rig.client.upload_calibration(&true_calibration(&scenario.sensor)).expect("answers");
    rig.client.store_calibration().expect("stores");
    let mut rig = Rig::new(&other, flash.clone(), load, SEED);
    rig.hold_down();
    // The first checkpoint is due after ten seconds.
    rig.wait(Duration::from_secs(11));
    assert!(matches!(rig.phase(), FieldPhase::Running { .. }));
    drop(rig);
    let mut rig = Rig::new(&other, flash, load, SEED);
    assert!(matches!(rig.phase(), FieldPhase::Running { .. }));
    assert!(rig.client.trial_status().expect("answers").checkpointed > 0);
    let (outcome, _) = rig.outcome();
    assert!(matches!(outcome, FieldOutcome::Renewed(Renewed::ShapeAndBias, _)), "{outcome:?}");
}
