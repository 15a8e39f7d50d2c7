//! The device commands against a simulated board behind a pseudo-terminal, through the same entry as the process.

use std::fs;
use std::path::Path;
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use clap::Parser;
use ftcal_shared::units::{AdcCode, Gain};
use nalgebra::{UnitVector3, Vector3};
use serde_json::Value;

use super::Streams;
use crate::calibration::matrix::matrix_of_shape;
use crate::calibration::{BiasOrigin, Calibration, Handedness, Method};
use crate::calibration_file;
use crate::cli::{self, Cli};
use crate::recording::Recording;
use crate::recording::parse::parse;
use crate::simulator::bench::Bench;
use crate::simulator::fault::{Fault, Rail};
use crate::simulator::scenario::ScenarioKind;
use crate::simulator::served_board::ServedBoard;

/// What a command left behind.
pub(super) struct Outcome {
    code: ExitCode,
    pub(super) data: String,
    pub(super) words: String,
}

impl Outcome {
    pub(super) fn has_code(&self, number: u8) -> bool {
        self.code == ExitCode::from(number)
    }

    pub(super) fn json(&self) -> Value {
        serde_json::from_str(&self.data).expect("one JSON value")
    }
}

/// Runs a command on this board.
pub(super) fn ftcal(board: &ServedBoard, arguments: &[&str]) -> Outcome {
    let all = [&["ftcal"], arguments, &["--port", &board.path]].concat();
    let cli = Cli::try_parse_from(all).expect("the usage is right");
    let (mut data, mut words) = (Vec::new(), Vec::new());
    let code = cli::run(&cli, &mut Streams { data: &mut data, words: &mut words });
    let text = |bytes| String::from_utf8(bytes).expect("output is UTF-8");
    Outcome { code, data: text(data), words: text(words) }
}

/// Waits until so much time has passed on the board, which on a busy machine lags behind the clock.
pub(super) fn pass(board: &ServedBoard, milliseconds: u64) {
    let now = || board.bench.with(|bench| bench.now().as_micros());
    let end = now() + 1000 * milliseconds;
    while now() < end {
        thread::sleep(Duration::from_millis(1));
    }
}

/// A calibration that is the truth of this board's sensor.
pub(super) fn true_calibration(board: &ServedBoard, path: &Path) -> Calibration {
    let sensor = board.bench.with(|bench| bench.sensor().clone());
    let calibration = Calibration {
        dof: sensor.dof(),
        method: Method::Sfm,
        gain: Some(Gain::X128),
        gravity: 9.80665,
        matrix: matrix_of_shape(sensor.shape()).expect("of full rank"),
        bias_counts: sensor.bias_counts().clone(),
        bias: BiasOrigin::Estimated,
        shape: sensor.shape().clone(),
        handedness: Handedness::Proven,
        fusion_residual: 0.0,
        uncertainty: None,
        trials: Vec::new(),
        checks: Vec::new(),
        drift: None,
    };
    write_calibration(&calibration, path);
    calibration
}

fn write_calibration(calibration: &Calibration, path: &Path) {
    let mut file = Vec::new();
    calibration_file::write(calibration, &mut file).expect("memory takes everything");
    fs::write(path, file).expect("a folder of our own");
}

#[test]
fn a_recording_holds_what_was_asked_for() {
    let board = ServedBoard::new(ScenarioKind::Force);
    let whole = |outcome: &Outcome| -> Recording {
        assert!(outcome.has_code(0), "{}", outcome.words);
        parse(outcome.data.as_bytes(), "stdout").expect("a recording")
    };
    let outcome = ftcal(&board, &["record", "--samples", "50", "--rate", "500", "--gain", "64"]);
    assert!(outcome.data.starts_with("# converter gain: 64\nt_s,ch0,ch1,ch2,ch3,ch4,ch5\n"));
    assert!(outcome.words.starts_with("50 samples in 0.098 s, no gap, none saturated"), "{}", outcome.words);
    let recording = whole(&outcome);
    assert_eq!((recording.gages(), recording.len(), recording.gain()), (6, 50, Some(Gain::X64)));
    for (sample, (time_s, _)) in recording.samples().enumerate() {
        assert!((time_s - sample as f64 / 500.0).abs() < 1e-9);
    }

    // Half an open interval: the sample at 0.1 s belongs to the next one.
    let recording = whole(&ftcal(&board, &["record", "--seconds", "0.1"]));
    assert_eq!(
        (recording.len(), recording.gain()),
        (50, Some(Gain::X64)),
        "rate and gain stay as they were set"
    );

    board.bench.with(|bench| bench.inject(Fault::SaturatedChannel { channel: 1, rail: Rail::Low }));
    board.bench.with(|bench| bench.inject(Fault::DataReadyLost { probability: 0.3 }));
    let outcome = ftcal(&board, &["record", "--samples", "100"]);
    assert!(
        outcome.words.contains("100 saturated") && outcome.words.contains(" gaps ("),
        "{}",
        outcome.words
    );
    assert!(whole(&outcome).samples().all(|(_, codes)| codes.get(1) == Some(&AdcCode::MIN)));
}

#[test]
fn a_recording_to_a_file_is_complete_or_not_there() {
    let board = ServedBoard::new(ScenarioKind::Fingertip);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("trial.csv");
    let path_text = path.display().to_string();
    let record = ["record", "--samples", "20", "-o", &path_text];
    board.bench.with(|bench| bench.inject(Fault::ConverterMissing));
    let outcome = ftcal(&board, &record);
    assert!(outcome.has_code(3) && outcome.words.contains("converter"), "{}", outcome.words);
    assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 0);

    board.bench.with(Bench::clear_faults);
    // The sensor tries its converter again twice a second.
    pass(&board, 700);
    assert!(ftcal(&board, &record).has_code(0));
    assert_eq!(Recording::read(&path).expect("a recording").len(), 20);
}

#[test]
fn a_trial_is_solved_on_the_sensor() {
    let board = ServedBoard::new(ScenarioKind::Fingertip);
    assert!(ftcal(&board, &["trial", "coverage"]).has_code(3), "there is none");
    let refused = ftcal(&board, &["trial", "solve", "--json"]);
    assert!(refused.has_code(3));
    assert_eq!(refused.json()["refused"]["cause"], "no-trial");

    assert!(ftcal(&board, &["trial", "start", "--rank", "2"]).has_code(0));
    assert!(ftcal(&board, &["trial", "start", "--rank", "2"]).has_code(3), "one is running");
    pass(&board, 100);
    assert!(ftcal(&board, &["trial", "stop"]).data.starts_with("stopped, rank 2, "));
    let refused = ftcal(&board, &["trial", "solve", "--json"]);
    assert!(refused.has_code(3), "nothing has turned");
    for field in ["cause", "detail", "remedy"] {
        assert!(refused.json()["refused"][field].is_string(), "{}", refused.data);
    }

    // The load hangs in the plane from the first sample on.
    board.bench.with(|bench| bench.hold(Vector3::x_axis()));
    ftcal(&board, &["trial", "start", "--rank", "2"]);
    for step in 0..16 {
        let (y, x) = (std::f64::consts::TAU * f64::from(step) / 16.0).sin_cos();
        board.bench.with(|bench| bench.hold(UnitVector3::new_normalize(Vector3::new(x, y, 0.0))));
        pass(&board, 30);
    }
    assert!(ftcal(&board, &["trial", "status"]).data.starts_with("running, rank 2, "));
    let covered = ftcal(&board, &["trial", "coverage", "--json"]);
    assert!(covered.has_code(0), "{}{}", covered.data, covered.words);
    let covered = covered.json();
    let (fraction, progress) = (&covered["coverage"]["fraction"], &covered["progress"]);
    // All around; how long in each direction is up to this machine's clock. Half of the circle would be a half.
    assert!((0.5..=1.0).contains(&fraction.as_f64().expect("a number")), "{covered}");
    assert!((0.0..=1.0).contains(&progress.as_f64().expect("a number")), "{covered}");
    assert!(ftcal(&board, &["trial", "coverage"]).data.contains("turn the load so that ch"));
    assert!(ftcal(&board, &["trial", "status"]).data.starts_with("running, rank 2, "), "it goes on");
    ftcal(&board, &["trial", "stop"]);
    let solved = ftcal(&board, &["trial", "solve"]);
    assert!(solved.has_code(0), "{}", solved.words);
    let solution = solved.json();
    assert_eq!((&solution["rank"], &solution["gages"]), (&Value::from(2), &Value::from(4)));
    assert_eq!(solution["samples"]["total"], solution["samples"]["used"]);
    let length = |field: &str| solution[field].as_array().map_or(0, Vec::len);
    assert_eq!((length("eigenvalues"), length("bias_counts"), length("shape_counts_per_load")), (4, 4, 2));
    assert_eq!(solution["shape_counts_per_load"][1].as_array().map_or(0, Vec::len), 4);
    // The truth: bias within the noise of a few hundred samples.
    let (bias, noise) =
        board.bench.with(|bench| (bench.sensor().bias_counts().clone(), bench.sensor().noise_counts().max()));
    for gage in 0..4 {
        let found = solution["bias_counts"][gage].as_f64().expect("a number");
        assert!((found - bias[gage]).abs() < noise, "gage {gage}: {found} for {}", bias[gage]);
        let deviation = solution["uncertainty"]["bias_counts"][gage].as_f64().expect("a number");
        // More than five standard deviations happen less than once in a million.
        assert!(
            (found - bias[gage]).abs() < 5.0 * deviation && deviation < noise,
            "gage {gage}: ±{deviation}"
        );
    }
    let deviations = &solution["uncertainty"]["shape_counts_per_load"];
    assert_eq!(
        (deviations.as_array().map_or(0, Vec::len), deviations[1].as_array().map_or(0, Vec::len)),
        (2, 4)
    );
    assert!(solution["coverage"]["worst_relative_uncertainty"].as_f64().is_some_and(|worst| worst > 0.0));
}

#[test]
fn uploaded_and_streamed_wrenches_are_the_truth_or_empty() {
    let board = ServedBoard::new(ScenarioKind::Planar);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.json");
    let refused = ftcal(&board, &["stream", "--samples", "3"]);
    assert!(refused.has_code(3) && refused.words.contains("uncalibrated"), "{}", refused.words);

    let calibration = true_calibration(&board, &path);
    let outcome = ftcal(&board, &["upload", &path.display().to_string()]);
    assert!(outcome.has_code(0), "{}", outcome.words);
    let outcome = ftcal(&board, &["stream", "--seconds", "0.2"]);
    assert!(outcome.has_code(0), "{}", outcome.words);
    let mut lines = outcome.data.lines();
    assert_eq!(lines.next(), Some("t_s,fx_n,fy_n,tz_nm,parity_chi2,status"));
    let truth = board.bench.with(|bench| bench.true_wrench()).components(calibration.dof);
    let noise = board.bench.with(|bench| bench.sensor().noise_counts().max());
    let mut samples = 0;
    for line in lines {
        let fields: Vec<&str> = line.split(',').collect();
        assert_eq!(fields.len(), 6, "{line}");
        let numbers: Vec<f64> = fields.iter().take(4).map(|field| field.parse().expect("a number")).collect();
        for (axis, row) in calibration.matrix.row_iter().enumerate() {
            // Eight standard deviations of the noise, and single precision.
            let bound = 8.0 * noise * row.norm() + 1e-5 * truth.amax();
            assert!((numbers[axis + 1] - truth[axis]).abs() < bound, "{line}: {truth}");
        }
        samples += 1;
    }
    assert_eq!(samples, 200);

    board.bench.with(|bench| bench.inject(Fault::SaturatedChannel { channel: 2, rail: Rail::High }));
    pass(&board, 50);
    let outcome = ftcal(&board, &["stream", "--samples", "5"]);
    for line in outcome.data.lines().skip(1) {
        assert!(line.contains(",,,,") && line.contains("saturated"), "{line}");
    }
    assert_eq!(
        outcome.words.matches("ch2 at the end of the converter's range").count(),
        1,
        "{}",
        outcome.words
    );
    assert!(outcome.words.contains("5 of them no wrench"), "{}", outcome.words);

    board.bench.with(|bench| bench.inject(Fault::ConverterMissing));
    // Moments at which there is none are no samples: two seconds of them, and no more is to be waited for.
    let outcome = ftcal(&board, &["stream", "--samples", "1000"]);
    assert!(outcome.has_code(3), "{}", outcome.words);
    assert!(outcome.words.contains("no wrench: no converter answers"), "{}", outcome.words);
    assert!(outcome.words.contains("converter-fault"), "{}", outcome.words);
    let outcome = ftcal(&board, &["stream", "--seconds", "2.5"]);
    assert!(outcome.has_code(0) && outcome.words.contains("0 samples, 0 of them"), "{}", outcome.words);
}

#[test]
fn a_stream_says_its_rate_and_what_the_sensor_says_of_itself() {
    let board = ServedBoard::new(ScenarioKind::Wrist);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.json");
    true_calibration(&board, &path);
    assert!(ftcal(&board, &["upload", &path.display().to_string()]).has_code(0));
    assert!(ftcal(&board, &["settings", "--rate", "2000"]).has_code(0));

    let filtered = ftcal(&board, &["stream", "--samples", "10", "--output-rate", "250"]);
    assert!(filtered.words.contains("250 samples/s of 2000 conversions/s"), "{}", filtered.words);
    assert!(filtered.words.contains("comes 23.5 ms later"), "{}", filtered.words);
    let never = ["stream", "--samples", "10", "--output-rate", "250", "--max-age-ms", "23"];
    assert!(ftcal(&board, &never).has_code(2), "the filter takes longer");

    // The rate that was asked for is gone with the stream.
    let all = ftcal(&board, &["stream", "--samples", "10"]);
    assert!(all.words.contains("2000 samples/s: every conversion"), "{}", all.words);
    let times: Vec<f64> = all
        .data
        .lines()
        .skip(1)
        .map(|line| line.split(',').next().and_then(|time| time.parse().ok()).expect("a time"))
        .collect();
    assert_eq!(times, [0.0, 0.0005, 0.001, 0.0015, 0.002, 0.0025, 0.003, 0.0035, 0.004, 0.0045]);

    assert!(ftcal(&board, &["health", "--without", "3"]).has_code(0));
    let outcome = ftcal(&board, &["stream", "--samples", "10"]);
    for line in outcome.data.lines().skip(1) {
        assert!(line.rsplit(',').next().is_some_and(|status| status.contains("carry-on")), "{line}");
    }
    let told = outcome.words.matches("carry-on: measuring without one gage").count();
    assert_eq!(told, 1, "{}", outcome.words);
}

#[test]
fn a_calibration_holds_at_its_own_gain_and_at_no_other() {
    let board = ServedBoard::new(ScenarioKind::Planar);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.json");
    let calibration = true_calibration(&board, &path);
    let file = path.display().to_string();
    assert!(ftcal(&board, &["upload", &file]).words.contains("gain 128), verified"));
    let is_valid = || !ftcal(&board, &["stream", "--samples", "3"]).words.contains("3 of them no wrench");
    assert!(is_valid());
    assert!(ftcal(&board, &["record", "--samples", "3", "--gain", "64"]).has_code(0));
    assert!(!is_valid());
    let info = ftcal(&board, &["info", "--json"]).json();
    assert_eq!((&info["converter"]["gain"], &info["calibration_gain"]), (&64.into(), &128.into()));
    let health = ftcal(&board, &["health"]);
    assert!(health.data.contains("`ftcal settings --gain N`"), "{}", health.data);

    // While a trial runs, the gain stays, and no wrench is valid; afterwards, the upload brings its gain along.
    assert!(ftcal(&board, &["trial", "start", "--rank", "2"]).has_code(0));
    let outcome = ftcal(&board, &["upload", &file]);
    assert!(
        outcome.has_code(0)
            && outcome.words.contains("CAUTION: no wrench is valid")
            && outcome.words.contains("a trial is running")
            && outcome.words.contains("`ftcal settings --gain 128`"),
        "{}",
        outcome.words
    );
    assert!(!is_valid());
    assert!(ftcal(&board, &["trial", "stop"]).has_code(0));
    let outcome = ftcal(&board, &["upload", &file, "--store"]);
    assert!(outcome.words.contains("was at gain 64; it is set to gain 128"), "{}", outcome.words);
    assert!(outcome.words.contains("`ftcal settings --store`"), "{}", outcome.words);
    assert!(is_valid());

    // One that is of nobody knows which gain is not guessed at; one that is of another gain is another one.
    write_calibration(&Calibration { gain: None, ..calibration }, &path);
    let outcome = ftcal(&board, &["upload", &file]);
    assert!(outcome.has_code(2) && outcome.words.contains("add `--gain N`"), "{}", outcome.words);
    let outcome = ftcal(&board, &["upload", &file, "--gain", "32", "--store"]);
    assert!(outcome.words.contains("set to gain 32"), "{}", outcome.words);
    let outcome = ftcal(&board, &["rollback"]);
    assert!(outcome.words.contains("was at gain 32; it is set to gain 128"), "{}", outcome.words);
    assert!(is_valid());
    true_calibration(&board, &path);
    let outcome = ftcal(&board, &["upload", &file, "--gain", "32"]);
    assert!(outcome.has_code(2) && outcome.words.contains("leave `--gain` away"), "{}", outcome.words);
}

#[test]
fn a_calibration_that_does_not_fit_is_refused() {
    let board = ServedBoard::new(ScenarioKind::Fingertip);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.json");
    true_calibration(&ServedBoard::new(ScenarioKind::Force), &path);
    let upload = ["upload", &path.display().to_string()];
    let outcome = ftcal(&board, &upload);
    assert!(outcome.has_code(3) && outcome.words.contains("wrong-dimensions"), "{}", outcome.words);
    fs::write(&path, "{}").expect("a folder of our own");
    assert!(ftcal(&board, &upload).has_code(2));
    assert_eq!(ftcal(&board, &["info", "--json"]).json()["calibration"], Value::Null);
}

#[test]
fn a_stored_calibration_is_kept_and_the_one_before_brought_back() {
    let board = ServedBoard::new(ScenarioKind::Wrist);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.json");
    let mut calibration = true_calibration(&board, &path);
    let file = path.display().to_string();
    let outcome = ftcal(&board, &["upload", &file]);
    assert!(outcome.words.contains("lost with the next reset"), "{}", outcome.words);
    let info = ftcal(&board, &["info", "--json"]).json();
    let first = info["calibration"].clone();
    assert_eq!((&info["memory"]["calibration"], &info["memory"]["problem"]), (&Value::Null, &"none".into()));
    let outcome = ftcal(&board, &["rollback"]);
    assert!(outcome.has_code(3) && outcome.words.contains("no-such-calibration"), "{}", outcome.words);

    assert!(ftcal(&board, &["upload", &file, "--store"]).has_code(0));
    calibration.bias_counts[0] += 1.0;
    write_calibration(&calibration, &path);
    let outcome = ftcal(&board, &["upload", &file, "--store"]);
    let restorable = format!("brings {} back", first.as_str().expect("calibrated"));
    assert!(outcome.words.contains(&restorable), "{}", outcome.words);
    assert!(ftcal(&board, &["rollback"]).has_code(0));
    assert!(ftcal(&board, &["name", "left wrist"]).has_code(0));
    assert!(ftcal(&board, &["name", &"x".repeat(33)]).has_code(2));
    assert!(
        ftcal(&board, &["settings", "--gain", "64", "--store"]).words.contains("gain 64, also after a reset")
    );
    let info = ftcal(&board, &["info", "--json"]).json();
    assert_eq!((&info["calibration"], &info["memory"]["calibration"]), (&first, &first));
    assert_eq!((&info["name"], &info["memory"]["stores"]), (&"left wrist".into(), &3.into()));
    assert!(ftcal(&board, &["info"]).data.contains("kept across resets\n"));
}

#[test]
fn info_names_what_is_wrong() {
    let board = ServedBoard::new(ScenarioKind::Wrist);
    assert!(ftcal(&board, &["record", "--samples", "1"]).has_code(0));
    let healthy = ftcal(&board, &["info"]);
    assert!(healthy.data.contains("converter    running\n"), "{}", healthy.data);
    for (fault, words) in [
        (Fault::ConverterMissing, "no converter answers"),
        (Fault::BusBitErrors { probability: 0.05 }, "checksum"),
    ] {
        board.bench.with(|bench| bench.inject(fault));
        // Longer than the sensor takes to find a silent converter and to try it once more.
        pass(&board, 800);
        let outcome = ftcal(&board, &["info"]);
        assert!(
            outcome.has_code(0) && outcome.data.contains("FAULT: ") && outcome.data.contains(words),
            "{}",
            outcome.data
        );
        let state = &ftcal(&board, &["info", "--json"]).json()["converter"]["state"];
        assert_eq!(state, "faulty");
        board.bench.with(Bench::clear_faults);
        pass(&board, 700);
        assert_eq!(ftcal(&board, &["info", "--json"]).json()["converter"]["state"], "running");
    }
}

#[test]
fn a_port_without_a_sensor_is_unusable_input() {
    let cli =
        Cli::try_parse_from(["ftcal", "info", "--port", "/dev/no-such-port"]).expect("the usage is right");
    let (mut data, mut words) = (Vec::new(), Vec::new());
    let code = cli::run(&cli, &mut Streams { data: &mut data, words: &mut words });
    assert_eq!(code, ExitCode::from(2));
    assert!(data.is_empty() && !words.is_empty());
    for usage in [
        ["record", "--samples=0"].as_slice(),
        &["record"],
        &["record", "--seconds=1", "--samples=1"],
        &["record", "--seconds=nan"],
        &["record", "--samples=1", "--rate=100"],
        &["trial", "start", "--rank=4"],
    ] {
        assert!(Cli::try_parse_from([&["ftcal"], usage].concat()).is_err(), "{usage:?}");
    }
}
