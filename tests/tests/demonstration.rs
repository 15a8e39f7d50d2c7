//! The demonstration, for each of the paper's systems: the whole job by the firmware's own code, judged by the truth.

use std::path::Path;

use clap::Parser;
use ftcal::calibration_file;
use ftcal::cli::{self, Cli};
use ftcal::commands::Streams;
use ftcal::demo::{self, Options};
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use nalgebra::DMatrix;

fn demonstrate(scenario: ScenarioKind, seed: u64, folder: &Path, keep_recordings: bool) -> String {
    let options = Options { scenario, seed, folder: folder.to_owned(), keep_recordings };
    let (mut out, mut progress) = (Vec::new(), Vec::new());
    demo::run(&options, &mut out, &mut progress).expect("the demonstration runs");
    String::from_utf8(out).expect("words")
}

/// How far C S̃ᵀ is from the identity, with torques in units of a tenth of a newton metre, as the arms make them.
fn matrix_error(folder: &Path, scenario: &Scenario) -> f64 {
    let calibration = calibration_file::read(&folder.join("calibration.json")).expect("a calibration file");
    let components = calibration.dof.count();
    let error =
        &calibration.matrix * scenario.sensor.shape().transpose() - DMatrix::identity(components, components);
    let forces = calibration.dof.trial_rank();
    let scale = |index: usize| if index < forces { 1.0 } else { 0.1 };
    DMatrix::from_fn(components, components, |row, column| error[(row, column)] * scale(column) / scale(row))
        .amax()
}

/// The bench states directions to 1 mrad (the fingertip's 3.5 mrad) and magnitudes to 0.02 N of 5 … 20 N: a few times that, for the
/// arms' leverage, is what the paper's way can reach.
#[test]
fn every_system_of_the_paper_is_calibrated() {
    for kind in ScenarioKind::ALL {
        for seed in [1, 2, 3] {
            let folder = tempfile::tempdir().expect("a folder");
            let tables = demonstrate(kind, seed, folder.path(), false);
            assert!(!tables.contains("NaN") && !tables.contains("inf"), "{tables}");
            let scenario = Scenario::new(kind, seed).expect("a scenario");
            let error = matrix_error(folder.path(), &scenario);
            assert!(error < 0.02, "{kind:?}, seed {seed}: {error}");
            let figures = if scenario.sensor.dof().trial_rank() == 2 { 3 } else { 4 };
            let drawn = std::fs::read_dir(folder.path())
                .expect("the folder")
                .filter(|entry| {
                    entry.as_ref().is_ok_and(|file| file.path().extension().is_some_and(|end| end == "svg"))
                })
                .count();
            assert_eq!(drawn, figures, "{kind:?}");
        }
    }
}

/// What the demonstration keeps, `ftcal calibrate` calibrates: to the same matrix, from the same codes, if it goes about it as
/// the sensor does.
#[test]
fn the_kept_session_gives_the_same_calibration() {
    for kind in ScenarioKind::ALL {
        let folder = tempfile::tempdir().expect("a folder");
        demonstrate(kind, 1, folder.path(), true);
        let (session, output) = (folder.path().join("session.toml"), folder.path().join("again.json"));
        let [session, again] = [&session, &output].map(|path| path.display().to_string());
        let cli =
            Cli::parse_from(["ftcal", "calibrate", &session, "--gate", "once", "--no-refine", "-o", &again]);
        let (mut data, mut words) = (Vec::new(), Vec::new());
        cli::run(&cli, &mut Streams { data: &mut data, words: &mut words });
        assert!(output.exists(), "{kind:?}: {}", String::from_utf8_lossy(&words));
        let first =
            calibration_file::read(&folder.path().join("calibration.json")).expect("a calibration file");
        let second = calibration_file::read(&output).expect("a calibration file");
        let difference = (&first.matrix - &second.matrix).norm() / first.matrix.norm();
        assert!(difference < 1e-6, "{kind:?}: {difference}");
    }
}

/// One seed, one outcome, to the last digit.
#[test]
fn a_seed_repeats_itself() {
    let [first, second] = [(), ()].map(|()| {
        let folder = tempfile::tempdir().expect("a folder");
        demonstrate(ScenarioKind::Planar, 7, folder.path(), false);
        std::fs::read(folder.path().join("calibration.json")).expect("a calibration file")
    });
    assert_eq!(first, second);
}
