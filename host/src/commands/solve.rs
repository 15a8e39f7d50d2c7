//! `ftcal solve`: shape and bias of one trial, from its recording alone.

use std::io::{self, Write};
use std::path::PathBuf;

use clap::Args;
use ftcal_shared::refusal::Refusal;
use serde::Serialize;

use super::{Failure, Streams, print_json};
use crate::calibration::motion::{Magnitude, recover};
use crate::calibration::trial::{SampleCounts, TrialShape, solve};
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
}

impl Report {
    fn new(recording: &Recording, rank: usize) -> Result<Self, Refusal> {
        let trial = solve(recording, rank)?;
        let magnitude = recover(recording, &trial)?.magnitude().ok_or(Refusal::NonFinite)?;
        let (rank, gages) = (trial.rank(), trial.gages());
        let TrialShape { samples, eigenvalues, noise_counts, bias_counts, shape_counts_per_load, .. } = trial;
        Ok(Self {
            rank,
            gages,
            samples,
            eigenvalues: eigenvalues.iter().copied().collect(),
            noise_counts,
            bias_counts: bias_counts.iter().copied().collect(),
            shape_counts_per_load: rows(&shape_counts_per_load),
            magnitude,
        })
    }

    /// Writes a summary that a person can read.
    ///
    /// # Errors
    ///
    /// Those of the destination.
    pub fn summarise(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{} of {} samples used", self.samples.used, self.samples.total)?;
        match self.noise_counts {
            Some(noise) => writeln!(out, "noise        {noise:.2} counts a channel")?,
            None => writeln!(out, "noise        unknown: as many gages as directions")?,
        }
        writeln!(out, "magnitude    {:.5} ± {:.5} of the load", self.magnitude.mean, self.magnitude.std)?;
        writeln!(out, "gage         bias (counts)   sensitivity (counts per load)")?;
        for (gage, bias) in self.bias_counts.iter().enumerate() {
            let squares: f64 = self
                .shape_counts_per_load
                .iter()
                .filter_map(|row| row.get(gage))
                .map(|count| count * count)
                .sum();
            writeln!(out, "ch{gage:<2} {bias:21.2} {:31.2}", squares.sqrt())?;
        }
        Ok(())
    }
}

/// Solves a trial and prints one JSON object.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let recording = Recording::read(&arguments.recording).map_err(Failure::input)?;
    let report = Report::new(&recording, usize::from(arguments.rank))
        .map_err(|refusal| Failure::Refused(remedy::estimation(&refusal)))?;
    if !arguments.json {
        report.summarise(streams.words)?;
    }
    Ok(print_json(&report, streams.data)?)
}
