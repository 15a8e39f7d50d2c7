//! The offline commands from files to files, through the same entry as the process, on simulated sensors.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use clap::Parser;
use ftcal_shared::units::Dof;
use nalgebra::DVector;
use serde_json::Value;
use tempfile::TempDir;

use super::Streams;
use crate::calibration::synthetic::{Sensor, flat, spatial, sphere, turn};
use crate::cli::{self, Cli};
use crate::recording::{Recording, writer};

/// What a command left behind.
pub(super) struct Outcome {
    /// The exit code, as it is shown.
    pub(super) code: String,
    pub(super) data: String,
    pub(super) words: String,
}

pub(super) fn ftcal(arguments: &[&str]) -> Outcome {
    let cli = Cli::try_parse_from([&["ftcal"], arguments].concat()).expect("the usage is right");
    let (mut data, mut words) = (Vec::new(), Vec::new());
    let code = cli::run(&cli, &mut Streams { data: &mut data, words: &mut words });
    let text = |bytes| String::from_utf8(bytes).expect("words are UTF-8");
    Outcome { code: format!("{code:?}"), data: text(data), words: text(words) }
}

pub(super) fn code(number: u8) -> String {
    format!("{:?}", std::process::ExitCode::from(number))
}

/// A folder with a session in it.
pub(super) struct Bench {
    folder: TempDir,
    sensor: Sensor,
    pub(super) session: String,
}

impl Bench {
    fn new(sensor: Sensor, dof: &str) -> Self {
        let folder = TempDir::new().expect("a folder");
        Self { folder, sensor, session: format!("dof = \"{dof}\"\n") }
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(super) fn save(&self, name: &str, recording: &Recording) {
        let file = File::create(self.path(name)).expect("the folder is writable");
        writer::write(recording, file).expect("the folder is writable");
    }

    /// Adds a trial that turns all round, then rests at each known load, all in one recording.
    fn trial(&mut self, name: &str, mass_kg: f64, arm_m: &[f64], loads: &[DVector<f64>], extra: &str) {
        let motion = if self.sensor.dof.trial_rank() == 2 { turn(1000, 2.0) } else { sphere(1000) };
        let mut directions = motion;
        for load in loads {
            directions.extend(vec![load.clone(); 100]);
        }
        let recording = self.sensor.record(mass_kg, arm_m, &directions);
        self.save(name, &recording);
        let out = &mut self.session;
        let arm = if arm_m.is_empty() { String::new() } else { format!("arm_m = {arm_m:?}\n") };
        writeln!(out, "[[trial]]\nrecording = {name:?}\nmass_kg = {mass_kg}\n{arm}{extra}").expect("text");
        for (load, direction) in loads.iter().enumerate() {
            let from_s = 10.0 + load as f64;
            writeln!(
                out,
                "[[trial.known_load]]\nwindow_s = [{from_s}, {}]\ndirection = {:?}\naccuracy_deg = 0.05",
                from_s + 0.985,
                direction.as_slice()
            )
            .expect("text");
        }
    }

    pub(super) fn calibrate(&self, extra: &[&str]) -> Outcome {
        fs::write(self.path("session.toml"), &self.session).expect("the folder is writable");
        let (session, output) = (self.path("session.toml"), self.path("calibration.json"));
        ftcal(&[&["calibrate", text(&session), "-o", text(&output)], extra].concat())
    }
}

pub(super) fn text(path: &Path) -> &str {
    path.to_str().expect("the path is UTF-8")
}

fn three() -> Vec<DVector<f64>> {
    vec![spatial(0.0, 0.0, -1.0), spatial(1.0, 0.2, 0.0), spatial(-0.1, 1.0, 0.3)]
}

pub(super) fn wrist(seed: u64) -> Bench {
    // Each direction with its opposite, so that least squares finds the bias well.
    let loads: Vec<DVector<f64>> = three().into_iter().flat_map(|load| [-&load, load]).collect();
    let mut bench = Bench::new(Sensor::new(Dof::SpatialForceTorque, 8, seed), "spatial-force-torque");
    for (name, arm) in
        [("a.csv", [0.1, 0.0, 0.05]), ("b.csv", [0.0, 0.1, 0.05]), ("c.csv", [-0.05, -0.05, 0.12])]
    {
        bench.trial(name, 2.0, &arm, &loads, "");
    }
    bench
}

#[test]
fn a_session_becomes_a_calibration_that_measures_loads_it_never_saw() {
    let mut bench = wrist(1);
    for method in ["sfm", "least-squares"] {
        let outcome = bench.calibrate(&["--json", "--method", method]);
        assert_eq!(outcome.code, code(0), "{}", outcome.words);
        let printed: Value = serde_json::from_str(&outcome.data).expect("JSON on standard output");
        let file = fs::read(bench.path("calibration.json")).expect("the file was written");
        assert_eq!(printed, serde_json::from_slice::<Value>(&file).expect("JSON in the file"));
        assert_eq!(printed["handedness"], "proven");
        assert_eq!(printed["method"], method);

        let arm = [0.02, -0.07, 0.1];
        let directions: Vec<DVector<f64>> = (0..200).map(|_| bench.sensor.unit()).collect();
        let recording = bench.sensor.record(1.3, &arm, &directions);
        bench.save("load.csv", &recording);
        let (calibration, load) = (bench.path("calibration.json"), bench.path("load.csv"));

        let outcome = ftcal(&["apply", text(&calibration), text(&load)]);
        assert_eq!(outcome.code, code(0), "{}", outcome.words);
        let mut lines = outcome.data.lines();
        assert_eq!(lines.next(), Some("t_s,fx_n,fy_n,fz_n,tx_nm,ty_nm,tz_nm"));
        let weight_n = 1.3 * 9.80665;
        for (line, direction) in lines.zip(&directions) {
            let numbers: Vec<f64> = line.split(',').map(|field| field.parse().expect("a number")).collect();
            let force = direction * weight_n;
            let torque = nalgebra::Vector3::from(arm).cross(&force.fixed_rows::<3>(0).into_owned());
            for axis in 0..3 {
                assert!((numbers[1 + axis] - force[axis]).abs() < 0.02 * weight_n, "{method}");
                assert!((numbers[4 + axis] - torque[axis]).abs() < 0.02 * 0.1 * weight_n);
            }
        }
        let outcome = ftcal(&["eval", text(&calibration), text(&load), "--mass-kg", "1.3", "--json"]);
        let report: Value = serde_json::from_str(&outcome.data).expect("JSON on standard output");
        assert!((report["mean_n"].as_f64().expect("a number") - weight_n).abs() < 0.01 * weight_n);
        assert!(report["error_percent"].as_f64().expect("a number") < 1.0);
        assert!(report["std_n"].as_f64().expect("a number") < 0.02 * weight_n);
    }
}

#[test]
fn a_wrench_is_given_with_its_uncertainty_where_the_calibration_knows_it() {
    let mut bench = wrist(1);
    assert_eq!(bench.calibrate(&[]).code, code(0));
    let directions: Vec<DVector<f64>> = (0..50).map(|_| bench.sensor.unit()).collect();
    let (light, heavy) = (
        bench.sensor.record(0.2, &[0.1, 0.0, 0.05], &directions),
        bench.sensor.record(2.0, &[0.1, 0.0, 0.05], &directions),
    );
    bench.save("light.csv", &light);
    bench.save("heavy.csv", &heavy);
    let calibration = bench.path("calibration.json");
    let numbers = |load: &Path| {
        let outcome = ftcal(&["apply", text(&calibration), text(load), "--uncertainty"]);
        assert_eq!(outcome.code, code(0), "{}", outcome.words);
        let mut lines = outcome.data.lines();
        let header = "t_s,fx_n,fy_n,fz_n,tx_nm,ty_nm,tz_nm,deviation_fx_n,deviation_fy_n,deviation_fz_n,deviation_tx_nm,\
                      deviation_ty_nm,deviation_tz_nm";
        assert_eq!(lines.next(), Some(header));
        let fields =
            |line: &str| line.split(',').map(|field| field.parse().expect("a number")).collect::<Vec<f64>>();
        lines.map(fields).collect::<Vec<_>>()
    };
    let stated: Value = serde_json::from_slice(&fs::read(&calibration).expect("written")).expect("JSON");
    let full_load = &stated["uncertainty"]["per_axis_full_load"];
    let (light, heavy) = (numbers(&bench.path("light.csv")), numbers(&bench.path("heavy.csv")));
    let mean_square = |lines: &[Vec<f64>], field: usize| {
        lines.iter().map(|line| line[field].powi(2)).sum::<f64>() / lines.len() as f64
    };
    for axis in 0..6 {
        let (of_light, of_heavy) = (mean_square(&light, 7 + axis), mean_square(&heavy, 7 + axis));
        assert!(of_light > 0.0 && of_light < of_heavy, "axis {axis}");
        // The trials had this mass, at arms as long.
        let stated = full_load[axis].as_f64().expect("a number");
        assert!(
            (0.5..2.0).contains(&(of_heavy.sqrt() / stated)),
            "axis {axis}: {} of {stated}",
            of_heavy.sqrt()
        );
    }

    let outcome = bench.calibrate(&["--method", "least-squares"]);
    assert_eq!(outcome.code, code(0), "{}", outcome.words);
    let outcome = ftcal(&["apply", text(&calibration), text(&bench.path("light.csv")), "--uncertainty"]);
    assert_eq!((outcome.code, outcome.data.as_str()), (code(2), ""));
    assert!(outcome.words.contains("uncertainty.wrench"), "{}", outcome.words);
}

#[test]
fn an_unproven_handedness_is_refused_in_words_and_in_json() {
    let mut bench = Bench::new(Sensor::new(Dof::PlanarForce, 4, 2), "planar-force");
    bench.trial("turn.csv", 0.5, &[], &[flat(-1.5)], "");
    let outcome = bench.calibrate(&["--json"]);
    assert_eq!(outcome.code, code(3));
    let report: Value = serde_json::from_str(&outcome.data).expect("JSON on standard output");
    assert_eq!(report["refused"]["cause"], "handedness-not-settled");
    assert!(report["refused"]["remedy"].as_str().is_some_and(|remedy| remedy.contains("turning")));
    assert!(!bench.path("calibration.json").exists(), "nothing is written");

    let outcome = bench.calibrate(&[]);
    assert_eq!((outcome.code, outcome.data.as_str()), (code(3), ""));
    assert!(outcome.words.contains("handedness-not-settled"), "{}", outcome.words);

    let mut bench = Bench::new(Sensor::new(Dof::PlanarForce, 4, 2), "planar-force");
    bench.trial("turn.csv", 0.5, &[], &[flat(-1.5)], "turning = \"counterclockwise\"");
    let outcome = bench.calibrate(&[]);
    assert_eq!(outcome.code, code(0), "{}", outcome.words);
}

#[test]
fn what_a_session_names_wrongly_is_located_in_it() {
    for (good, bad, expected) in [
        ("\"b.csv\"", "\"missing.csv\"", "session.toml: line 32, column 13"),
        ("[10, ", "[1000.0, ", "session.toml: line 8, column 12"),
        ("mass_kg = 2", "mass_kg = -2", "session.toml: line 4, column 11"),
        ("mass_kg", "weight", "session.toml: line 4, column 1"),
    ] {
        let mut bench = wrist(3);
        assert!(bench.session.contains(good), "{}", bench.session);
        bench.session = bench.session.replacen(good, bad, 1).replace("[1000.0, 10.985]", "[1000.0, 1001.0]");
        let outcome = bench.calibrate(&[]);
        assert_eq!((outcome.code, outcome.data.as_str()), (code(2), ""), "{}", outcome.words);
        assert!(outcome.words.contains(expected), "{} for {expected}", outcome.words);
    }
}

#[test]
fn recordings_of_another_number_of_gages_are_unusable() {
    let mut bench = wrist(4);
    let mut other = Sensor::new(Dof::SpatialForceTorque, 6, 4);
    let recording = other.record(1.0, &[0.0, 0.0, 0.0], &sphere(100));
    bench.save("b.csv", &recording);
    let outcome = bench.calibrate(&[]);
    assert_eq!(outcome.code, code(2));
    assert!(outcome.words.contains("8 gages") && outcome.words.contains("6 gages"), "{}", outcome.words);
    bench = wrist(4);
    assert_eq!(bench.calibrate(&[]).code, code(0));
    bench.save("six.csv", &recording);
    let outcome = ftcal(&["apply", text(&bench.path("calibration.json")), text(&bench.path("six.csv"))]);
    assert_eq!((outcome.code, outcome.data.as_str()), (code(2), ""), "{}", outcome.words);
}

#[test]
fn saturated_samples_get_no_numbers() {
    let mut bench = Bench::new(Sensor::new(Dof::SpatialForce, 4, 5), "spatial-force");
    bench.trial("turn.csv", 2.0, &[], &three(), "");
    assert_eq!(bench.calibrate(&[]).code, code(0));
    fs::write(bench.path("load.csv"), "t_s,ch0,ch1,ch2,ch3\n0,1,2,3,8388607\n1,1,2,3,4\n").expect("writable");
    let (calibration, load) = (bench.path("calibration.json"), bench.path("load.csv"));
    let outcome = ftcal(&["apply", text(&calibration), text(&load)]);
    assert_eq!(outcome.code, code(0));
    assert_eq!(outcome.data.lines().nth(1), Some("0,,,"));
    assert!(outcome.words.starts_with("1 of 2 samples"), "{}", outcome.words);

    fs::write(bench.path("load.csv"), "t_s,ch0,ch1,ch2,ch3\n0,1,2,3,-8388608\n").expect("writable");
    let outcome = ftcal(&["eval", text(&calibration), text(&load), "--mass-kg", "1", "--json"]);
    let report: Value = serde_json::from_str(&outcome.data).expect("JSON on standard output");
    assert_eq!((outcome.code, &report["refused"]["cause"]), (code(3), &Value::from("saturated")));
}

#[test]
fn a_calibration_is_checked_at_another_mass_verified_in_the_field_and_made_anew_from_itself() {
    let mut bench = wrist(9);
    bench.trial("heavier.csv", 4.0, &[0.02, 0.03, 0.1], &[], "role = \"check\"\n");
    let outcome = bench.calibrate(&["--json"]);
    assert_eq!(outcome.code, code(0), "{}{}", outcome.data, outcome.words);
    let printed: Value = serde_json::from_str(&outcome.data).expect("JSON on standard output");
    assert_eq!(printed["trials"].as_array().map_or(0, Vec::len), 3, "a check is not fitted");
    let check = &printed["checks"][0];
    assert_eq!(check["mass_kg"], 4.0);
    assert!((check["scale"].as_f64().expect("a number") - 1.0).abs() < 5e-3, "{check}");
    assert!(check["residual"].as_f64().expect("a number") < 5e-3, "{check}");

    let (calibration, load) = (bench.path("calibration.json"), bench.path("load.csv"));
    let directions: Vec<DVector<f64>> = (0..200).map(|_| bench.sensor.unit()).collect();
    let recording = bench.sensor.record(1.3, &[0.02, -0.07, 0.1], &directions);
    bench.save("load.csv", &recording);
    let verify = |mass: &str, extra: &[&str]| {
        ftcal(&[&["verify", text(&calibration), text(&load), "--mass-kg", mass], extra].concat())
    };
    let passed = verify("1.3", &["--json"]);
    assert_eq!(passed.code, code(0), "{}{}", passed.data, passed.words);
    let report: Value = serde_json::from_str(&passed.data).expect("JSON on standard output");
    assert_eq!(report["magnitude_passed"], true);
    assert_eq!(report["parity"]["passed"], true);
    let failed = verify("1.5", &["--json"]);
    assert_eq!(failed.code, code(3), "{}", failed.data);
    let report: Value = serde_json::from_str(&failed.data).expect("JSON on standard output");
    assert_eq!(report["refused"]["cause"], "verification-failed");
    assert!(verify("1.5", &[]).words.contains("verification-failed"));

    // The same sensor again, with no known load.
    let stored = bench.path("stored.json");
    fs::rename(&calibration, &stored).expect("the folder is writable");
    bench.session = "dof = \"spatial-force-torque\"\n".to_owned();
    for (name, arm) in
        [("d.csv", [0.1, 0.0, 0.05]), ("e.csv", [0.0, 0.1, 0.05]), ("f.csv", [-0.05, -0.05, 0.12])]
    {
        bench.trial(name, 1.0, &arm, &[], "");
    }
    assert_eq!(bench.calibrate(&[]).code, code(3), "nothing orients it");
    let again = bench.calibrate(&["--reference", text(&stored)]);
    assert_eq!(again.code, code(0), "{}", again.words);
    assert!(
        again.words.contains("moved since the stored calibration (6 of 6 components seen"),
        "{}",
        again.words
    );
    let verified = verify("1.3", &[]);
    assert_eq!(verified.code, code(0), "{}{}", verified.data, verified.words);
}

#[test]
fn solve_reports_what_the_contract_lists() {
    let mut bench = Bench::new(Sensor::new(Dof::SpatialForce, 5, 6), "spatial-force");
    bench.trial("turn.csv", 2.0, &[], &three(), "");
    let path = bench.path("turn.csv");
    let outcome = ftcal(&["solve", text(&path), "--rank", "3"]);
    assert_eq!(outcome.code, code(0), "{}", outcome.words);
    assert!(outcome.words.contains("1300 of 1300 samples used"), "{}", outcome.words);
    let report: Value = serde_json::from_str(&outcome.data).expect("one JSON object");
    let mut fields: Vec<&str> = report.as_object().expect("an object").keys().map(String::as_str).collect();
    fields.sort_unstable();
    let mut contract = [
        "rank",
        "gages",
        "gain",
        "samples",
        "eigenvalues",
        "noise_counts",
        "bias_counts",
        "shape_counts_per_load",
        "magnitude",
        "uncertainty",
        "coverage",
    ];
    contract.sort_unstable();
    assert_eq!(fields, contract);
    assert_eq!(report["samples"], serde_json::json!({ "total": 1300, "used": 1300, "rejected": {} }));
    let noise = report["noise_counts"].as_f64().expect("p > r tells it");
    assert!((noise / bench.sensor.noise_counts - 1.0).abs() < 0.1);
    assert!((report["magnitude"]["mean"].as_f64().expect("a number") - 1.0).abs() < 1e-3);
    let uncertainty = &report["uncertainty"];
    assert_eq!(uncertainty["bias_counts"].as_array().map_or(0, Vec::len), 5);
    assert_eq!(uncertainty["shape_counts_per_load"].as_array().map_or(0, Vec::len), 3);
    assert_eq!(uncertainty["shape_counts_per_load"][2].as_array().map_or(0, Vec::len), 5);
    let coverage = &report["coverage"];
    assert!((0.5..=1.0).contains(&coverage["fraction"].as_f64().expect("a number")), "{coverage}");
    assert!(coverage["worst_relative_uncertainty"].as_f64().expect("a number") > 0.0, "{coverage}");
    let words = coverage["weakest_direction"].as_str().expect("words");
    assert!(words.starts_with("turn the load so that ch") && outcome.words.contains(words), "{words}");

    let outcome = ftcal(&["solve", text(&path), "--rank", "2", "--json"]);
    assert_eq!(outcome.code, code(3), "{}", outcome.data);
    let report: Value = serde_json::from_str(&outcome.data).expect("one JSON object");
    assert!(report["refused"]["detail"].is_string());
}

/// A magnetometer turned in the earth's field: shape from motion with p = r = 3. Other people's data, so not part of the
/// project; the reference is an independent implementation's.
#[test]
fn a_real_recording_gives_the_reference_of_its_readme() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/hmc5883l_full_sphere.csv");
    if !file.exists() {
        println!("skipped: {} is not there", file.display());
        return;
    }
    let outcome = ftcal(&["solve", text(&file), "--rank", "3", "--json"]);
    assert_eq!(outcome.code, code(0), "{}", outcome.data);
    let report: Value = serde_json::from_str(&outcome.data).expect("one JSON object");
    let bias = report["bias_counts"].as_array().expect("a list");
    for (found, reference) in bias.iter().zip([-7.01, -114.94, 22.08]) {
        assert!((found.as_f64().expect("a number") - reference).abs() < 0.5, "{bias:?}");
    }
    let magnitude = &report["magnitude"];
    assert!(magnitude["std"].as_f64().expect("a number") <= 0.0047, "{magnitude}");
    assert!((magnitude["mean"].as_f64().expect("a number") - 1.0).abs() < 1e-3, "{magnitude}");
    assert!(report["noise_counts"].is_null(), "p = r: nothing redundant tells the noise");
}
