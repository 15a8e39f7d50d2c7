//! The gain of the converter, from the recording to the wrench: counts of one gain are never taken for counts of another.

use std::fs;

use ftcal_shared::units::Gain;
use serde_json::Value;

use super::offline_tests::{Bench, code, ftcal, text, wrist};
use crate::calibration_file;
use crate::recording::Recording;

/// Has these recordings of the bench say that they are of these gains.
fn state(bench: &Bench, gains: &[(&str, Option<Gain>)]) {
    for (name, gain) in gains {
        let recording = Recording::read(&bench.path(name)).expect("a recording");
        bench.save(name, &recording.at_gain(*gain));
    }
}

fn gain_of_calibration(bench: &Bench) -> Option<Gain> {
    calibration_file::read(&bench.path("calibration.json")).expect("a calibration").gain
}

#[test]
fn a_calibration_is_of_the_gain_that_all_its_recordings_say() {
    let bench = wrist(11);
    state(&bench, &[("a.csv", Some(Gain::X32)), ("b.csv", Some(Gain::X32)), ("c.csv", Some(Gain::X32))]);
    let outcome = bench.calibrate(&[]);
    assert_eq!(outcome.code, code(0), "{}", outcome.words);
    assert!(outcome.words.contains("the counts are of gain 32"), "{}", outcome.words);
    assert_eq!(gain_of_calibration(&bench), Some(Gain::X32));

    // One that does not say it may be of another.
    state(&bench, &[("b.csv", None)]);
    let outcome = bench.calibrate(&["--method", "least-squares"]);
    assert_eq!(outcome.code, code(0), "{}", outcome.words);
    assert!(outcome.words.contains("the gain is unknown"), "{}", outcome.words);
    assert_eq!(gain_of_calibration(&bench), None);
}

#[test]
fn recordings_of_different_gains_make_no_calibration() {
    let mut bench = wrist(12);
    state(&bench, &[("a.csv", Some(Gain::X128)), ("c.csv", Some(Gain::X64))]);
    let outcome = bench.calibrate(&[]);
    assert_eq!((outcome.code, outcome.data.as_str()), (code(2), ""), "{}", outcome.words);
    assert!(
        outcome.words.contains("expected a recording at gain 128 as an earlier one, found one at gain 64")
            && outcome.words.contains("`ftcal record --gain 128`"),
        "{}",
        outcome.words
    );
    // What the session says, a recording may contradict, too.
    state(&bench, &[("c.csv", None)]);
    bench.session = format!("gain = 16\n{}", bench.session);
    let outcome = bench.calibrate(&[]);
    assert_eq!(outcome.code, code(2), "{}", outcome.words);
    let expected = "expected a recording at gain 16 as the session says, found one at gain 128";
    assert!(outcome.words.contains(expected), "{}", outcome.words);
    state(&bench, &[("a.csv", None)]);
    assert_eq!(bench.calibrate(&[]).code, code(0));
    assert_eq!(gain_of_calibration(&bench), Some(Gain::X16));
}

#[test]
fn a_stored_calibration_wants_recordings_of_its_own_gain() {
    let mut bench = wrist(13);
    state(&bench, &[("a.csv", Some(Gain::X64)), ("b.csv", Some(Gain::X64)), ("c.csv", Some(Gain::X64))]);
    assert_eq!(bench.calibrate(&[]).code, code(0));
    let stored = bench.path("stored.json");
    fs::copy(bench.path("calibration.json"), &stored).expect("a folder of our own");
    let with_reference = ["--reference", text(&stored)];

    // The same response is that of the same gain.
    state(&bench, &[("a.csv", None), ("b.csv", None), ("c.csv", None)]);
    let outcome = bench.calibrate(&with_reference);
    assert_eq!(outcome.code, code(0), "{}", outcome.words);
    assert_eq!(gain_of_calibration(&bench), Some(Gain::X64));

    state(&bench, &[("b.csv", Some(Gain::X128))]);
    let outcome = bench.calibrate(&with_reference);
    assert_eq!(outcome.code, code(2), "{}", outcome.words);
    let expected = "at gain 64 as the stored calibration was made at, found one at gain 128";
    assert!(outcome.words.contains(expected), "{}", outcome.words);
    bench.session = format!("gain = 128\n{}", bench.session);
    let outcome = bench.calibrate(&with_reference);
    assert_eq!(outcome.code, code(2), "{}", outcome.words);
    let expected = "field `gain`: expected 64 as the stored calibration was made at, found 128";
    assert!(outcome.words.contains(expected), "{}", outcome.words);
}

#[test]
fn a_calibration_is_not_applied_to_counts_of_another_gain() {
    let bench = wrist(14);
    state(&bench, &[("a.csv", Some(Gain::X64)), ("b.csv", Some(Gain::X64)), ("c.csv", Some(Gain::X64))]);
    assert_eq!(bench.calibrate(&[]).code, code(0));
    let (calibration, recording) = (bench.path("calibration.json"), bench.path("a.csv"));
    let (calibration, recording) = (text(&calibration), text(&recording));
    let commands: [&[&str]; 3] = [
        &["apply", calibration, recording],
        &["eval", calibration, recording, "--mass-kg", "2"],
        &["verify", calibration, recording, "--mass-kg", "2"],
    ];
    for gain in [Some(Gain::X64), None] {
        state(&bench, &[("a.csv", gain)]);
        let outcome = ftcal(commands[0]);
        assert_eq!(outcome.code, code(0), "{}", outcome.words);
    }
    state(&bench, &[("a.csv", Some(Gain::X128))]);
    for command in commands {
        let outcome = ftcal(command);
        assert_eq!((outcome.code, outcome.data.as_str()), (code(2), ""), "{}", outcome.words);
        assert!(
            outcome.words.contains(
                "a.csv: expected a recording at gain 64 as the calibration was made at, found one at gain 128"
            ),
            "{}",
            outcome.words
        );
    }
}

#[test]
fn a_solved_trial_says_the_gain_of_its_counts() {
    let bench = wrist(15);
    for (gain, expected) in [(Some(Gain::X4), Value::from(4)), (None, Value::Null)] {
        state(&bench, &[("a.csv", gain)]);
        let outcome = ftcal(&["solve", text(&bench.path("a.csv")), "--rank", "3"]);
        let report: Value = serde_json::from_str(&outcome.data).expect("one JSON object");
        assert_eq!(report["gain"], expected, "{}", outcome.words);
    }
}
