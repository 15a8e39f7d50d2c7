//! The gate on a real recording that never rests: an accelerometer turned by hand. It belongs to other people and is read where it is at
//! hand.

use std::path::Path;

use ftcal::calibration::motion::recover;
use ftcal::calibration::trial::{Gating, solve};
use ftcal::recording::Recording;

/// Sensitivities by the reference beside the recording: an independent implementation, all samples.
const REFERENCE: [f64; 3] = [16484.0, 16577.0, 16696.0];

/// What the gate makes of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gated {
    /// The largest relative difference of a sensitivity from the reference.
    pub(crate) off: f64,
    /// The relative standard deviation of the load's magnitude over the samples used.
    pub(crate) scatter: f64,
}

/// Whether the recordings are at hand.
pub(crate) fn is_at_hand() -> bool {
    folder().exists()
}

/// `None` where there is no answer.
pub(crate) fn gated() -> Option<Gated> {
    let recording = Recording::read(&folder().join("mpu6050_full_sphere.csv")).ok()?;
    let trial = solve(&recording, 3, Gating::On).ok()?;
    let magnitude = recover(&recording, &trial).ok()?.magnitude()?;
    let sensitivities = trial.shape_counts_per_load.column_iter().map(|column| column.norm());
    let off = sensitivities.zip(REFERENCE).map(|(found, reference)| (found / reference - 1.0).abs());
    Some(Gated { off: off.fold(0.0, f64::max), scatter: magnitude.std })
}

fn folder() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data")
}
