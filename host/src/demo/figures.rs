//! The demonstration in pictures, after the paper's figures 5, 6, 8 and 9.

use std::path::{Path, PathBuf};

use nalgebra::DVector;

use super::report::{angle_milliradian, force};
use super::trials::{AcquiredTrial, GRAVITY};
use super::validation::MeasuredLoad;
use crate::calibration::Calibration;
use crate::plots::PlotError;
use crate::plots::angular_error::{self, KnownLoadError};
use crate::plots::magnitude::{self, MagnitudeSample};
use crate::plots::polar::{self, PlanarLoad};
use crate::plots::sphere::{self, SpatialLoad};

/// Points beyond this only blacken a picture.
const MOST_POINTS: usize = 1500;

/// Known loads of the paper's figure 9.
const KNOWN_LOADS: usize = 10;

/// One picture.
pub struct Figure {
    /// What it shows.
    pub caption: &'static str,
    /// The file.
    pub path: PathBuf,
}

/// Draws the figures into `folder`.
///
/// # Errors
///
/// [`PlotError`].
pub fn draw(
    acquired: &[AcquiredTrial],
    calibration: &Calibration,
    measured: &[MeasuredLoad],
    folder: &Path,
) -> Result<Vec<Figure>, PlotError> {
    let dof = calibration.dof;
    let mut figures = Vec::new();
    let mut add = |caption, name: &str| {
        let path = folder.join(name);
        figures.push(Figure { caption, path: path.clone() });
        path
    };
    if let Some(trial) = acquired.first() {
        let motion = in_sensor_frame(trial, calibration);
        if dof.trial_rank() == 2 {
            let path = add("Recovered motion of the first trial (figure 5)", "figure5_motion_polar.svg");
            polar::draw(
                &motion
                    .iter()
                    .map(|m| PlanarLoad { x_unit_loads: m[0], y_unit_loads: m[1] })
                    .collect::<Vec<_>>(),
                &path,
            )?;
        } else {
            let path = add(
                "Magnitude over azimuth of the first trial's motion (figure 5)",
                "figure5_motion_polar.svg",
            );
            polar::draw(&motion.iter().map(magnitude_over_azimuth).collect::<Vec<_>>(), &path)?;
            let path = add("Recovered motion of the first trial (figure 6)", "figure6_motion_sphere.svg");
            let points: Vec<_> = motion
                .iter()
                .map(|m| SpatialLoad { x_unit_loads: m[0], y_unit_loads: m[1], z_unit_loads: m[2] })
                .collect();
            sphere::draw(&points, &path)?;
        }
    }
    if let Some(load) = measured.first() {
        let samples: Vec<_> = load
            .orientations
            .iter()
            .map(|orientation| MagnitudeSample {
                shape_from_motion_newton: force(&orientation.shape_from_motion, dof).norm(),
                least_squares_newton: force(&orientation.least_squares, dof).norm(),
            })
            .collect();
        let path = add("Force magnitude as the orientation changes (figure 8)", "figure8_magnitude.svg");
        magnitude::draw(&samples, load.load.mass_kg * GRAVITY, &path)?;
    }
    if let Some(load) = measured.last() {
        let errors: Vec<_> = load
            .orientations
            .iter()
            .take(KNOWN_LOADS)
            .map(|orientation| KnownLoadError {
                shape_from_motion_milliradian: angle_milliradian(
                    orientation,
                    &orientation.shape_from_motion,
                    dof,
                ),
                least_squares_milliradian: angle_milliradian(orientation, &orientation.least_squares, dof),
            })
            .collect();
        let path = add("Angular error at ten known loads (figure 9)", "figure9_angular_error.svg");
        angular_error::draw(&errors, &path)?;
    }
    Ok(figures)
}

/// The recovered motion of a trial per unit load, in the sensor frame, thinned to what a picture can show.
fn in_sensor_frame(trial: &AcquiredTrial, calibration: &Calibration) -> Vec<DVector<f64>> {
    let dof = calibration.dof;
    let load_newton = trial.solved.case.mass_kg * GRAVITY;
    let every = trial.recording.len().div_ceil(MOST_POINTS).max(1);
    trial
        .recording
        .unsaturated()
        .step_by(every)
        .map(|(_, codes)| force(&calibration.wrench(&trial.recording.counts(codes)), dof) / load_newton)
        .collect()
}

/// A direction in space as a point at its own azimuth in the xy plane, as far out as it is long.
fn magnitude_over_azimuth(direction: &DVector<f64>) -> PlanarLoad {
    let azimuth = direction[1].atan2(direction[0]);
    let magnitude = direction.norm();
    PlanarLoad { x_unit_loads: magnitude * azimuth.cos(), y_unit_loads: magnitude * azimuth.sin() }
}
