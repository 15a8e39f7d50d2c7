//! The image in the emulator, calibrated in the field with its button and its light and no host.
//!
//! A sensor that was calibrated exactly is exchanged, under the same memory, for one that has drifted. The light is looked at as somebody
//! does who stands before it, by a clock on the wall; so is the button pressed.
#![cfg(unix)]

use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use ftcal::link::client::Client;
use ftcal::link::serial::SerialTransport;
use ftcal::simulator::bench::{Bench, Load};
use ftcal::simulator::board::SimulatedBoard;
use ftcal::simulator::bus::SharedBench;
use ftcal::simulator::emulator::Emulator;
use ftcal::simulator::flash::SimulatedFlash;
use ftcal::simulator::light::LightWatch;
use ftcal::simulator::panel::SharedPanel;
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use ftcal::simulator::sensor::SoftwareSensor;
use ftcal::simulator::tunnel::Pace;
use ftcal_firmware::field::light::Light;
use ftcal_shared::units::{DataRate, Dof, Gain};
use ftcal_shared::wire::{CalibrationOrigin, CalibrationUpload, FieldOutcome, FieldPhase, KeptCalibration};
use nalgebra::Vector3;

use ftcal_tests::image;
use ftcal_tests::patience::{connect, patiently};
use ftcal_tests::truth::{shape_error, true_calibration};

/// What hangs on the sensor: no matter where, as it feels no torque.
const LOAD: Load = Load { mass_kg: 2.0, arm_m: Vector3::new(0.0, 0.0, 0.0) };

/// How long the whole calibration may take: the load is to be turned for a minute and a half, by the board's clock.
const PATIENCE: Duration = Duration::from_mins(5);

/// How long anything else may take on a busy machine.
const SOON: Duration = Duration::from_mins(2);

/// Between two looks at the light.
const GLANCE: Duration = Duration::from_millis(10);

/// A force sensor of as many gages as the image has: what the wrist sensor's gages feel of forces.
fn force_sensor() -> SoftwareSensor {
    let wrist = Scenario::new(ScenarioKind::Wrist, 1).unwrap().sensor;
    let shape = wrist.shape().rows(0, 3).into_owned();
    SoftwareSensor::new(Dof::SpatialForce, shape, wrist.bias_counts().clone(), wrist.noise_counts().clone())
        .unwrap()
}

/// The same, one gage of which answers more and has another bias.
fn drifted(sensor: &SoftwareSensor) -> SoftwareSensor {
    let (mut shape, mut bias) = (sensor.shape().clone(), sensor.bias_counts().clone());
    shape.column_mut(2).scale_mut(1.01);
    bias[2] += 20_000.0;
    SoftwareSensor::new(sensor.dof(), shape, bias, sensor.noise_counts().clone()).unwrap()
}

/// Stores what the sensor is to know before.
fn prepare(flash: &Path, sensor: &SoftwareSensor, calibration: &CalibrationUpload) {
    let flash = SimulatedFlash::in_file(flash).unwrap();
    let board = SimulatedBoard::with_flash(sensor.clone(), 1, flash).unwrap();
    let mut client = Client::connect(board).unwrap();
    // A rate at which the emulator keeps up.
    client.configure_adc(DataRate::Hz250, Gain::X128).unwrap();
    client.store_settings().unwrap();
    client.upload_calibration(calibration).unwrap();
    client.store_calibration().unwrap();
}

fn emulate(flash: &Path, sensor: &SoftwareSensor) -> Emulator {
    let mut bench = Bench::new(sensor.clone(), 1);
    bench.hang(LOAD);
    bench.turn();
    let flash = SimulatedFlash::in_file(flash).unwrap();
    Emulator::start_with_flash(
        &image::path("ftcal-emulated.elf"),
        SharedBench::new(bench),
        flash,
        Pace::AsHandled,
    )
    .unwrap()
}

/// Connects to a board that has read its memory, and whose converter runs.
fn connect_when_ready(emulator: &Emulator) -> Client<SerialTransport> {
    let (mut client, begin) = (connect(emulator), Instant::now());
    while patiently(|| client.status()).kept.current == KeptCalibration::Unread {
        assert!(begin.elapsed() < SOON);
        client.wait(GLANCE).unwrap();
    }
    patiently(|| client.wait_for_converter());
    client
}

fn press(panel: &SharedPanel, time: Duration) {
    panel.press(true);
    thread::sleep(time);
    panel.press(false);
}

/// Looks at the light until it shows one of these; what it has shown, but that it is at work, which takes no time to speak of.
fn look_until(panel: &SharedPanel, ends: &[Light], patience: Duration) -> Vec<Light> {
    let (mut watch, mut shown, begin) = (LightWatch::default(), Vec::new(), Instant::now());
    loop {
        if let Some(light) =
            watch.look(begin.elapsed(), panel.light()).filter(|&light| light != Light::Working)
        {
            shown.push(light);
            if ends.contains(&light) {
                return shown;
            }
        }
        assert!(begin.elapsed() < patience, "{shown:?}");
        thread::sleep(GLANCE);
    }
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn the_image_is_calibrated_with_its_button_and_keeps_the_new_calibration() {
    let sensor = force_sensor();
    let other = drifted(&sensor);
    let before = true_calibration(&sensor);
    let folder = tempfile::tempdir().unwrap();
    let flash = folder.path().join("flash");
    prepare(&flash, &sensor, &before);

    let emulator = emulate(&flash, &other);
    let mut client = connect_when_ready(&emulator);
    assert_eq!(patiently(|| client.read_calibration()).as_ref(), Some(&before));
    assert_eq!(patiently(|| client.field()).phase, FieldPhase::Idle);
    drop(client);

    let panel = emulator.panel();
    press(&panel, Duration::from_millis(2500));
    let quarters = |quarters| Light::Running { quarters };
    let running = look_until(&panel, &[quarters(3), Light::Refused], PATIENCE);
    assert_eq!((running.first(), running.last()), (Some(&quarters(0)), Some(&quarters(3))), "{running:?}");
    // A press stops it now, with an answer.
    press(&panel, Duration::from_millis(300));
    let ended = look_until(&panel, &[Light::Renewed, Light::Confirmed, Light::Refused], SOON);
    let mut client = connect_when_ready(&emulator);
    let report = patiently(|| client.field());
    assert_eq!(ended.last(), Some(&Light::Renewed), "{report:?}");

    let Some(FieldOutcome::Renewed(renewed, found)) = report.last else { panic!("{report:?}") };
    assert_eq!((found.reference, found.gage), (before.identity, 2));
    assert_eq!(report.origin, Some(CalibrationOrigin::Field(renewed, found)));
    let after = patiently(|| client.read_calibration()).unwrap();
    assert_ne!(after.identity, before.identity);
    let (old, new) = (shape_error(&before, &other), shape_error(&after, &other));
    assert!(new < old, "{old} {new}");
    drop(client);
    drop(emulator);

    let emulator = emulate(&flash, &other);
    let mut client = connect_when_ready(&emulator);
    assert_eq!(patiently(|| client.read_calibration()), Some(after.clone()));
    let kept = patiently(|| client.status()).kept;
    assert_eq!(kept.current, KeptCalibration::Calibration(after.identity));
    assert_eq!(kept.previous, Some(before.identity));
    assert_eq!(patiently(|| client.field()).origin, Some(CalibrationOrigin::Field(renewed, found)));
}
