//! `ftcal eval`: how well a calibration measures a known mass, whatever its direction (paper, tables 1 and 2).

use std::path::PathBuf;

use clap::Args;
use ftcal_shared::refusal::Refusal;
use serde::Serialize;

use super::{Failure, Streams, apply, print_json};
use crate::calibration::Calibration;
use crate::calibration::motion::magnitude;
use crate::recording::Recording;
use crate::remedy;

/// Measure a known mass in any direction and compare the force's magnitude with its weight
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// The calibration file (JSON)
    pub calibration: PathBuf,
    /// A recording of the mass (CSV)
    pub recording: PathBuf,
    /// The mass that hangs on the sensor, kilogram
    #[arg(long, value_name = "M", value_parser = positive)]
    pub mass_kg: f64,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// What `eval` finds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Mean magnitude of the force, newton.
    pub mean_n: f64,
    /// How far the mean is from the weight, percent of the weight, never negative.
    pub error_percent: f64,
    /// Standard deviation of the magnitude, newton.
    pub std_n: f64,
}

impl Report {
    /// Compares the force's magnitude with the weight of a mass. Saturated samples take no part.
    ///
    /// # Errors
    ///
    /// [`Refusal::Saturated`] where no other sample is left; [`Refusal::NonFinite`].
    pub fn new(calibration: &Calibration, recording: &Recording, mass_kg: f64) -> Result<Self, Refusal> {
        let forces = calibration.dof.trial_rank();
        let magnitudes: Vec<f64> = recording
            .unsaturated()
            .map(|(_, codes)| calibration.wrench(&recording.counts(codes)).rows(0, forces).norm())
            .collect();
        let magnitude = magnitude(magnitudes.iter().copied())
            .ok_or(Refusal::Saturated { samples: recording.len() as u64 })?;
        let weight_n = mass_kg * calibration.gravity;
        let error_percent = 100.0 * ((magnitude.mean - weight_n) / weight_n).abs();
        let report = Self { mean_n: magnitude.mean, error_percent, std_n: magnitude.std };
        let finite = [report.mean_n, report.error_percent, report.std_n].into_iter().all(f64::is_finite);
        if finite { Ok(report) } else { Err(Refusal::NonFinite) }
    }
}

/// Evaluates a calibration on a recording of a known mass.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let (calibration, recording) = apply::read(&arguments.calibration, &arguments.recording)?;
    let report = Report::new(&calibration, &recording, arguments.mass_kg)
        .map_err(|refusal| Failure::Refused(remedy::estimation(&refusal)))?;
    let saturated = recording.len() - recording.unsaturated().count();
    if saturated > 0 {
        writeln!(streams.words, "{saturated} of {} samples are saturated and left out", recording.len())?;
    }
    if arguments.json {
        print_json(&report, streams.data)?;
    } else {
        let Report { mean_n, error_percent, std_n } = report;
        writeln!(
            streams.data,
            "mean {mean_n:.4} N, off by {error_percent:.2} %, standard deviation {std_n:.4} N"
        )?;
    }
    Ok(())
}

/// Reads a positive number of kilograms.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(mass_kg) if mass_kg > 0.0 && mass_kg.is_finite() => Ok(mass_kg),
        _ => Err("expected a positive number of kilograms".to_owned()),
    }
}
