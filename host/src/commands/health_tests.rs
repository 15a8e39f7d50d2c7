//! The commands about the sensor's health against a simulated board behind a pseudo-terminal.

use std::fs;

use nalgebra::Vector3;
use serde_json::{Value, json};

use super::device_tests::{Outcome, ftcal, pass, true_calibration};
use crate::simulator::bench::Bench;
use crate::simulator::fault::Fault;
use crate::simulator::scenario::ScenarioKind;
use crate::simulator::served_board::ServedBoard;

/// A board that has its own truth for calibration and has learned its noise, at rest.
fn calibrated(kind: ScenarioKind) -> ServedBoard {
    let board = ServedBoard::new(kind);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("calibration.json");
    true_calibration(&board, &path);
    board.bench.with(|bench| bench.hold(Vector3::x_axis()));
    assert!(ftcal(&board, &["upload", &path.display().to_string()]).has_code(0));
    fs::remove_file(path).expect("a folder of our own");
    pass(&board, 600);
    board
}

fn health(board: &ServedBoard) -> Value {
    let outcome = ftcal(board, &["health", "--json"]);
    assert!(outcome.has_code(0), "{}", outcome.words);
    outcome.json()
}

fn names(bits: &Value) -> Vec<&str> {
    bits.as_array().expect("a list").iter().filter_map(Value::as_str).collect()
}

#[test]
fn the_gage_that_is_off_is_named_and_can_be_done_without() {
    let board = calibrated(ScenarioKind::Force);
    assert_eq!(health(&board)["live"], json!([]));
    let noise = board.bench.with(|bench| bench.sensor().noise_counts().mean());
    let measured = health(&board)["parity"]["noise_counts"].as_f64().expect("it has been learned");
    assert!((measured / noise - 1.0).abs() < 0.3, "{measured} for about {noise}");

    board.bench.with(|bench| bench.inject(Fault::DriftingChannel { channel: 4, counts_per_second: 1e6 }));
    pass(&board, 1000);
    let report = health(&board);
    assert!(names(&report["live"]).contains(&"gage-suspect"), "{report}");
    assert_eq!(report["parity"]["suspects"], json!([4]), "{report}");
    let words = ftcal(&board, &["health"]);
    assert!(words.data.contains("suspect: ch4, off by about "), "{}", words.data);
    assert!(words.data.contains("--without GAGE"), "{}", words.data);

    assert!(ftcal(&board, &["health", "--without", "9"]).words.contains("no-such-gage"));
    let without = ftcal(&board, &["health", "--without", "4"]);
    assert!(without.data.contains("measuring without ch4"), "{}", without.data);
    pass(&board, 700);
    let report = health(&board);
    assert_eq!(report["live"], json!(["carry-on"]));
    assert!(names(&report["latched"]).contains(&"gage-suspect"));
    let stream = ftcal(&board, &["stream", "--samples", "20"]);
    assert!(stream.words.contains("20 samples, 0 of them no wrench"), "{}", stream.words);

    board.bench.with(Bench::clear_faults);
    assert!(ftcal(&board, &["health", "--with-all", "--clear"]).has_code(0));
    pass(&board, 700);
    assert_eq!(health(&board)["carrying_on_without"], Value::Null);
    assert_eq!(health(&board)["live"], json!([]));
    assert!(ftcal(&board, &["info"]).data.contains("status       0x00000000"));
}

#[test]
fn a_tare_is_set_shown_and_cleared() {
    let board = ServedBoard::new(ScenarioKind::Fingertip);
    let refused = ftcal(&board, &["tare", "set"]);
    assert!(refused.has_code(3) && refused.words.contains("uncalibrated"), "{}", refused.words);

    let board = calibrated(ScenarioKind::Fingertip);
    assert_eq!(ftcal(&board, &["tare", "show"]).data, "none\n");
    let set = ftcal(&board, &["tare", "set", "--samples", "200"]);
    assert!(set.has_code(0) && set.data.starts_with("fx ") && set.data.contains(" N\nfy "), "{}", set.data);
    assert_eq!(ftcal(&board, &["tare", "show"]).data, set.data);
    assert_eq!(health(&board)["live"], json!(["tare-active"]));
    let streamed = ftcal(&board, &["stream", "--samples", "10"]);
    let weight = board.bench.with(|bench| bench.true_wrench().force_newton.norm());
    for line in streamed.data.lines().skip(1) {
        let force: f64 = line.split(',').nth(1).expect("fx").parse().expect("a number");
        assert!(force.abs() < 0.05 * weight, "{line}");
    }
    board.bench.with(|bench| {
        bench.hold(Vector3::x_axis());
        bench.turn();
    });
    let moving = ftcal(&board, &["tare", "set", "--samples", "2000"]);
    assert!(moving.has_code(3) && moving.words.contains("tare-moving"), "{}", moving.words);
    assert_eq!(ftcal(&board, &["tare", "show"]).data, set.data, "it stays as it was");
    assert_eq!(ftcal(&board, &["tare", "clear"]).data, "none\n");
    assert_eq!(health(&board)["live"], json!([]));
}

#[test]
fn limits_are_set_by_axis_and_their_transgression_is_told() {
    let board = ServedBoard::new(ScenarioKind::Planar);
    assert!(ftcal(&board, &["limits"]).has_code(2), "without calibration there are no components");
    let board = calibrated(ScenarioKind::Planar);
    let shown = |arguments: &[&str]| -> Outcome {
        let outcome = ftcal(&board, &[&["limits"], arguments].concat());
        assert!(outcome.has_code(0), "{}", outcome.words);
        outcome
    };
    assert!(shown(&[]).data.contains("fx largest none, threshold none less 0 (N)"));
    // The load of half a kilogram hangs along x.
    let set =
        shown(&["--largest", "fx=3", "--largest", "tz=10", "--combined", "1.5", "--threshold", "fx=4:1"]);
    assert!(set.data.contains("fx largest 3, threshold 4 less 1 (N)") && set.data.contains("combined 1.5"));
    assert!(ftcal(&board, &["limits", "--largest", "fz=3"]).has_code(2), "it has no such axis");
    pass(&board, 50);
    let live = health(&board)["live"].clone();
    assert_eq!(names(&live), ["overload", "threshold", "overload-fx", "overload-combined"]);
    let peak = health(&board)["peak_ever"][0].as_f64().expect("a number");
    assert!((4.8..5.1).contains(&peak), "half a kilogram: {peak}");
    shown(&["--largest", "fx=none", "--combined", "none", "--threshold", "fx=none"]);
    pass(&board, 50);
    assert_eq!(health(&board)["live"], json!([]));
    assert!(names(&health(&board)["latched"]).contains(&"overload-fx"), "what was is remembered");
    ftcal(&board, &["health", "--clear"]);
    assert_eq!(health(&board)["latched"], json!([]));
}

#[test]
fn a_self_test_prints_what_it_found_and_fails_where_that_is_not_all() {
    let board = calibrated(ScenarioKind::Wrist);
    let outcome = ftcal(&board, &["selftest"]);
    assert!(outcome.has_code(0), "{}{}", outcome.data, outcome.words);
    assert_eq!(outcome.data.lines().count(), 13);
    for line in [
        "positive test signal     right: ",
        "late reply               found after ",
        "jumping gage             found",
    ] {
        assert!(outcome.data.contains(line), "{}", outcome.data);
    }
    pass(&board, 600);
    assert_eq!(health(&board)["live"], json!([]));
    board.bench.with(|bench| bench.inject(Fault::ConverterMissing));
    let outcome = ftcal(&board, &["selftest"]);
    assert!(outcome.has_code(3) && outcome.words.contains("self-test-failed"), "{}", outcome.words);
    assert!(outcome.data.contains("NOT PLAYED"), "{}", outcome.data);
}
