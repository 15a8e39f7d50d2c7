//! Loads that no calibration has seen: other masses at other arms, measured with both calibrations (paper, section 4).
//!
//! The bench now states the load exactly: what is measured here is the calibration, not the workmanship.

use std::io::Write;

use ftcal_shared::wire::StreamKind;
use nalgebra::{DVector, Unit, UnitVector3, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::trials::next_frame;
use super::{DemoError, Stage};
use crate::calibration::Calibration;
use crate::link::frame::{Frame, Measured};
use crate::recording::Recording;
use crate::simulator::bench::Load;
use crate::simulator::scenario::Scenario;

/// Orientations in which each load is measured.
const ORIENTATIONS: usize = 60;

/// Samples averaged in each orientation.
const SAMPLES: usize = 50;

/// One load in all its orientations.
pub struct MeasuredLoad {
    /// The load.
    pub load: Load,
    /// One entry an orientation.
    pub orientations: Vec<Orientation>,
}

/// One load in one orientation; every wrench (m) in newton and newton metre.
pub struct Orientation {
    /// What acted on the sensor.
    pub truth: DVector<f64>,
    /// Shape from motion: applied and streamed by the sensor itself.
    pub shape_from_motion: DVector<f64>,
    /// Least squares: applied by the host.
    pub least_squares: DVector<f64>,
}

/// Measures the scenario's validation loads.
///
/// # Errors
///
/// [`DemoError`].
pub fn measure(
    stage: &mut Stage,
    scenario: &Scenario,
    calibration: &Calibration,
    least_squares: &Calibration,
    progress: &mut dyn Write,
) -> Result<Vec<MeasuredLoad>, DemoError> {
    let dof = scenario.sensor.dof();
    let mut measured = Vec::with_capacity(scenario.validation.len());
    for &load in &scenario.validation {
        writeln!(
            progress,
            "Measuring {:.4} kg, never used before, in {ORIENTATIONS} orientations …",
            load.mass_kg
        )?;
        let mut orientations = Vec::with_capacity(ORIENTATIONS);
        for _ in 0..ORIENTATIONS {
            let direction = any_direction(dof.trial_rank(), &mut stage.chance);
            stage.hold_exactly(load, direction)?;
            let truth = stage.bench.with(|bench| bench.true_wrench()).components(dof);
            let shape_from_motion = streamed_mean(stage, calibration.dof.count())?;
            let codes = stage.record(SAMPLES)?;
            orientations.push(Orientation {
                truth,
                shape_from_motion,
                least_squares: applied_mean(least_squares, &codes),
            });
        }
        measured.push(MeasuredLoad { load, orientations });
    }
    Ok(measured)
}

fn any_direction(rank: usize, chance: &mut ChaCha8Rng) -> UnitVector3<f64> {
    let mut vector: Vector3<f64> = Vector3::from_fn(|_, _| StandardNormal.sample(chance));
    if rank == 2 {
        vector.z = 0.0;
    }
    Unit::new_normalize(vector)
}

/// The mean of the wrenches that the sensor streams.
fn streamed_mean(stage: &mut Stage, components: usize) -> Result<DVector<f64>, DemoError> {
    stage.client.stream(StreamKind::Wrench)?;
    let mut sum = DVector::zeros(components);
    let mut samples = 0;
    while samples < SAMPLES {
        let Frame::Wrench(sample) = next_frame(&mut stage.client)? else { continue };
        match sample.at_any_age() {
            Measured::Valid(wrench) => {
                let wrench = wrench.components().iter().map(|&value| f64::from(value));
                sum += DVector::from_iterator(components, wrench);
                samples += 1;
            }
            Measured::Invalid(cause) => return Err(DemoError::NoWrench(cause)),
        }
    }
    stage.client.stream(StreamKind::Off)?;
    Ok(sum / SAMPLES as f64)
}

fn applied_mean(calibration: &Calibration, codes: &Recording) -> DVector<f64> {
    let sum: DVector<f64> =
        codes.samples().map(|(_, sample)| calibration.wrench(&codes.counts(sample))).sum();
    sum / codes.len() as f64
}
