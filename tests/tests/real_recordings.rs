//! Real recordings through `ftcal solve`, where they are at hand: they are other people's data and not part of the project.

use std::path::{Path, PathBuf};

use clap::Parser;
use ftcal::cli::{self, Cli};
use ftcal::commands::Streams;
use serde_json::Value;

/// The recording, or `None` with a word where the folder is absent.
fn recording(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data").join(name);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: {name} is not at hand (it belongs into ../shared/data, beside the repository)");
    None
}

fn solve(recording: &Path) -> Value {
    let path = recording.display().to_string();
    let cli = Cli::parse_from(["ftcal", "solve", path.as_str(), "--rank", "3", "--json"]);
    let (mut data, mut words) = (Vec::new(), Vec::new());
    cli::run(&cli, &mut Streams { data: &mut data, words: &mut words });
    serde_json::from_slice(&data).expect("one JSON object")
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(|number| number.as_f64().expect("a number")).collect()
}

/// The reference of an independent implementation: bias −7.01, −114.94, 22.08; gains 592.72, 629.79, 525.17.
#[test]
fn a_magnetometer_in_the_field_of_the_earth() {
    let Some(path) = recording("hmc5883l_full_sphere.csv") else { return };
    let solution = solve(&path);
    for (bias, reference) in numbers(&solution["bias_counts"]).iter().zip([-7.01, -114.94, 22.08]) {
        assert!((bias - reference).abs() < 0.5, "{bias} for {reference}");
    }
    let shape: Vec<Vec<f64>> =
        solution["shape_counts_per_load"].as_array().expect("rows").iter().map(numbers).collect();
    for (gage, reference) in [592.72, 629.79, 525.17].into_iter().enumerate() {
        let gain = shape.iter().map(|row| row[gage].powi(2)).sum::<f64>().sqrt();
        assert!((gain / reference - 1.0).abs() < 1e-3, "{gain} for {reference}");
    }
    let magnitude = &solution["magnitude"];
    assert!(magnitude["std"].as_f64().expect("a number") <= 0.0047);
    assert!((magnitude["mean"].as_f64().expect("a number") - 1.0).abs() < 1e-3);
    assert_eq!(solution["samples"]["total"], 8190);
}

/// An accelerometer that never rests: every sample carries the hand's own acceleration. The gate leaves out enough of it to
/// bring the scatter of what is used from 0.045 to below 0.03, and not so much that the motion no longer spans.
#[test]
fn an_accelerometer_that_never_rests() {
    let Some(path) = recording("mpu6050_full_sphere.csv") else { return };
    let solution = solve(&path);
    let shape: Vec<Vec<f64>> =
        solution["shape_counts_per_load"].as_array().expect("rows").iter().map(numbers).collect();
    for (gage, reference) in [16484.0, 16577.0, 16696.0].into_iter().enumerate() {
        let gain = shape.iter().map(|row| row[gage].powi(2)).sum::<f64>().sqrt();
        assert!((gain / reference - 1.0).abs() < 0.02, "{gain} for {reference}");
    }
    let scatter = solution["magnitude"]["std"].as_f64().expect("a number");
    assert!(scatter <= 0.03, "{scatter}");
    let samples = &solution["samples"];
    let moving = samples["rejected"]["moving"].as_u64().expect("a count");
    assert!(moving > 0);
    assert_eq!(samples["used"].as_u64().map(|used| used + moving), Some(10528));
}
