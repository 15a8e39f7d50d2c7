//! `ftcal solve`: shape and bias of one trial, from its recording alone.

use std::io::{self, Write};
use std::path::PathBuf;

use clap::Args;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::Gain;
use ftcal_shared::wire;
use serde::Serialize;

use super::{Failure, Streams, print_json};
use crate::calibration::coverage::TrialCoverage;
use crate::calibration::linearity::require_linear;
use crate::calibration::motion::{Magnitude, recover};
use crate::calibration::refinement::Refining;
use crate::calibration::samples::SampleCounts;
use crate::calibration::trial::{Gating, TrialShape, solve};
use crate::calibration_file::rows;
use crate::recording::Recording;
use crate::remedy;

/// Solve one trial: shape and bias from its recording alone, in an arbitrary orientation
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// The recording (CSV)
    pub recording: PathBuf,
    /// Directions that the load spans: 2 for a planar sensor, 3 for a spatial one
    #[arg(long, value_parser = clap::value_parser!(u8).range(2..=3))]
    pub rank: u8,
    /// Leave out samples during which the load moved too much, where that serves the answer, and those of a converter that
    /// repeats itself
    #[arg(long, value_enum, default_value = "on")]
    pub gate: Gating,
    /// Take the trial as the sensor itself would solve it
    #[arg(long)]
    pub no_refine: bool,
    /// Solve a sensor that is not linear as if it were
    #[arg(long)]
    pub allow_nonlinear: bool,
    /// Print refusals as JSON, too, and no summary
    #[arg(long)]
    pub json: bool,
}

/// What `solve` prints.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Rank r of the trial.
    pub rank: usize,
    /// Gages p.
    pub gages: usize,
    /// The converter's gain that the counts are of; `null` where the recording does not say it.
    pub gain: Option<u8>,
    /// Samples recorded, used, and rejected by cause.
    pub samples: SampleCounts,
    /// Eigenvalues of the covariance of the codes (p), descending, counts².
    pub eigenvalues: Vec<f64>,
    /// Noise of one channel, counts; `null` at p = r, where nothing redundant tells it.
    pub noise_counts: Option<f64>,
    /// b (p), counts.
    pub bias_counts: Vec<f64>,
    /// S (r rows of p), counts per unit load.
    pub shape_counts_per_load: Vec<Vec<f64>>,
    /// Length of the recovered load over the samples used, per unit load.
    pub magnitude: Magnitude,
    /// Standard deviations, whatever the orientation.
    pub uncertainty: Uncertainty,
    /// What the motion has covered.
    pub coverage: Coverage,
}

/// Standard deviations of bias and shape.
#[derive(Debug, Serialize)]
pub struct Uncertainty {
    /// Of b (p), counts.
    pub bias_counts: Vec<f64>,
    /// Of S (r rows of p), counts per unit load.
    pub shape_counts_per_load: Vec<Vec<f64>>,
}

/// What the motion has covered.
#[derive(Debug, Serialize)]
pub struct Coverage {
    /// The share of all directions that the load has been through, 0 to 1.
    pub fraction: f64,
    /// Which way to turn the load to learn most, in words.
    pub weakest_direction: String,
    /// The largest standard deviation of a gain, cross-talk or offset, relative to the load.
    pub worst_relative_uncertainty: f64,
}

impl From<&TrialCoverage> for Coverage {
    fn from(coverage: &TrialCoverage) -> Self {
        Self {
            fraction: coverage.fraction,
            weakest_direction: coverage.weakest_direction(),
            worst_relative_uncertainty: coverage.worst_relative_uncertainty,
        }
    }
}

impl From<&wire::Coverage> for Uncertainty {
    fn from(covered: &wire::Coverage) -> Self {
        let counts = |deviations: &[f32]| deviations.iter().map(|&counts| counts.into()).collect();
        let gages = covered.bias_deviation_counts.len().max(1);
        Self {
            bias_counts: counts(&covered.bias_deviation_counts),
            shape_counts_per_load: covered
                .shape_deviation_counts_per_load
                .chunks(gages)
                .map(counts)
                .collect(),
        }
    }
}

impl Report {
    fn new(recording: &Recording, trial: TrialShape) -> Result<Self, Refusal> {
        let magnitude = recover(recording, &trial)?.magnitude().ok_or(Refusal::NonFinite)?;
        let (rank, gages) = (trial.rank(), trial.gages());
        let uncertainty = Uncertainty {
            bias_counts: trial.bias_deviation_counts().iter().copied().collect(),
            shape_counts_per_load: rows(&trial.shape_deviation_counts_per_load()),
        };
        let coverage = Coverage::from(&trial.coverage);
        let TrialShape { samples, eigenvalues, noise_counts, bias_counts, shape_counts_per_load, .. } = trial;
        Ok(Self {
            rank,
            gages,
            gain: recording.gain().map(Gain::factor),
            samples,
            eigenvalues: eigenvalues.iter().copied().collect(),
            noise_counts,
            bias_counts: bias_counts.iter().copied().collect(),
            shape_counts_per_load: rows(&shape_counts_per_load),
            magnitude,
            uncertainty,
            coverage,
        })
    }

    /// Writes a summary that a person can read.
    ///
    /// # Errors
    ///
    /// Those of the destination.
    pub fn summarise(&self, out: &mut dyn Write) -> io::Result<()> {
        write!(out, "{} of {} samples used", self.samples.used, self.samples.total)?;
        for (cause, count) in &self.samples.rejected {
            write!(out, ", {count} {}", cause.in_words())?;
        }
        writeln!(out)?;
        match self.gain {
            Some(gain) => writeln!(out, "gain         {gain}")?,
            None => writeln!(out, "gain         unknown: the recording does not say it")?,
        }
        match self.noise_counts {
            Some(noise) => writeln!(out, "noise        {noise:.2} counts a channel")?,
            None => writeln!(out, "noise        unknown: as many gages as directions")?,
        }
        writeln!(out, "magnitude    {:.5} ± {:.5} of the load", self.magnitude.mean, self.magnitude.std)?;
        let Coverage { fraction, weakest_direction, worst_relative_uncertainty } = &self.coverage;
        writeln!(out, "uncertainty  {:.3} % of the load at worst", 100.0 * worst_relative_uncertainty)?;
        writeln!(out, "coverage     {:.0} % of all directions", 100.0 * fraction)?;
        writeln!(out, "to learn most, {weakest_direction}")?;
        writeln!(out, "gage         bias (counts)     ±   sensitivity (counts per load)     ±")?;
        for (gage, bias) in self.bias_counts.iter().enumerate() {
            let squares: f64 = self
                .shape_counts_per_load
                .iter()
                .filter_map(|row| row.get(gage))
                .map(|count| count * count)
                .sum();
            let (bias_deviation, deviation) = self.deviations(gage);
            writeln!(
                out,
                "ch{gage:<2} {bias:21.2} {bias_deviation:5.2} {:31.2} {deviation:5.2}",
                squares.sqrt()
            )?;
        }
        Ok(())
    }

    /// Standard deviations of a gage's bias (counts) and of its sensitivity (counts per load), that of its least certain
    /// component.
    fn deviations(&self, gage: usize) -> (f64, f64) {
        let uncertainty = &self.uncertainty;
        let components = uncertainty.shape_counts_per_load.iter().filter_map(|row| row.get(gage));
        let bias = uncertainty.bias_counts.get(gage).copied().unwrap_or_default();
        (bias, components.copied().fold(0.0, f64::max))
    }
}

/// Solves a trial and prints one JSON object.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let recording = Recording::read(&arguments.recording).map_err(Failure::input)?;
    let refining = if arguments.no_refine { Refining::Off } else { Refining::On };
    let refused = |refusal| Failure::Refused(remedy::estimation(&refusal));
    let start = solve(&recording, usize::from(arguments.rank), arguments.gate).map_err(refused)?;
    if !arguments.allow_nonlinear {
        require_linear(0, &start, &[]).map_err(|refusal| Failure::Refused(remedy::calibration(&refusal)))?;
    }
    let report = Report::new(&recording, refining.of(&recording, start)).map_err(refused)?;
    if !arguments.json {
        report.summarise(streams.words)?;
    }
    Ok(print_json(&report, streams.data)?)
}
