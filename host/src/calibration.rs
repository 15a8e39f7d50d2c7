//! From trials to a calibration: what the host adds to the estimator (paper, figure 2 and eq. 14–20).
//!
//! ```text
//! recordings ─► trial ─► joint solution ─► matrix ─► calibration
//!               shape    arms orient,      eq. 5
//!                        known loads choose
//! ```
//!
//! | module | step |
//! |---|---|
//! | [`samples`] | what becomes of the samples of a recording |
//! | [`trial`] | shape and bias of one trial, by the shared estimator |
//! | [`covariance`] | how certain that is |
//! | [`coverage`] | what a trial has covered, and which way to turn it next |
//! | [`motion`] | the recovered motion |
//! | [`refinement`] | the same from the recording itself, a little better |
//! | [`known_load`] | rests at known loads; arms as squashing matrices |
//! | [`alignment`] | orientation from known loads |
//! | [`turning`] | orientation from the sense of turning |
//! | [`joint`] | orientations, true shape, arms and masses from all trials at once |
//! | [`staged`] | the paper's way instead: trial by trial, then stacked |
//! | [`consistency`] | there: what trials allow each other |
//! | [`cause`] | there: why a hand is not settled |
//! | [`handedness`] | there, and for force sensors: rotation or mirror image, proven or refused |
//! | [`fusion`] | true shape from oriented trials at several arms |
//! | [`procrustes`] | the turn from one shape onto another |
//! | [`mod@reference`] | orientation from a stored calibration |
//! | [`drift`] | how far the sensor has moved since |
//! | [`linearity`] | whether the sensor is linear, at one load and from one to another |
//! | [`accuracy`] | what a calibration promises of the loads it measures |
//! | [`verification`], [`parity`] | the check of a calibration in the field: its magnitude, its gages |
//! | [`bias`] | the sensor's bias from those of its trials |
//! | [`wrench_uncertainty`] | how certain any one wrench is |
//! | [`rest`] | which samples of a recording are at rest |
//! | [`matrix`] | calibration matrix of a shape |
//! | [`singular`] | the decomposition that several of these rest on |
//! | [`least_squares`] | the paper's reference: known loads alone (eq. 3) |
//! | [`refusal`] | why there is no calibration |
//! | [`evidence`] | all of this from a session file |
//! | [`upload`] | the calibration as the sensor takes it |
//!
//! Frames: a trial's own frame is arbitrary (orthogonal to the sensor frame, perhaps mirrored); everything oriented is
//! in the sensor frame. Torques are about the origin of the sensor frame, torque = arm × force.

pub mod accuracy;
pub mod alignment;
pub mod bias;
pub mod cause;
pub mod consistency;
pub mod covariance;
pub mod coverage;
pub mod drift;
pub mod evidence;
pub mod fusion;
pub mod handedness;
pub mod joint;
pub mod known_load;
pub mod least_squares;
pub mod linearity;
pub mod matrix;
pub mod motion;
pub mod parity;
pub mod procrustes;
pub mod reference;
pub mod refinement;
pub mod refusal;
pub mod rest;
pub mod samples;
pub mod singular;
pub mod staged;
pub mod trial;
pub mod turning;
pub mod upload;
pub mod verification;
pub mod wrench_uncertainty;

#[cfg(test)]
mod end_to_end;
#[cfg(test)]
pub(crate) mod synthetic;

use ftcal_shared::estimation::metric::LARGEST_RELATIVE_UNCERTAINTY;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::{Dof, Gain};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use self::bias::{bias_covariance, common_bias};
use self::drift::Drift;
use self::joint::uncertainty::{Premises, Propagated, Uncertainty, propagate};
use self::known_load::LoadCase;
use self::linearity::CheckRecord;
use self::matrix::matrix_of_shape;
use self::samples::SampleCounts;
use self::singular::Singular;
use self::trial::TrialShape;
use self::turning::Turned;
use crate::gravity::Gravity;

pub use self::refusal::CalibrationRefusal;

/// The largest predicted error of a wrench, relative, that is still a calibration.
const LARGEST_WRENCH_ERROR: f64 = 0.15;

/// The weakest response of the gages over the strongest below which it is the sensor that makes a wrench uncertain.
const LEAST_RESPONSE: f64 = 0.02;

/// One trial, solved: all that the host needs of it.
#[derive(Clone, Debug)]
pub struct SolvedTrial {
    /// What hung on the sensor.
    pub case: LoadCase,
    /// The shape found, by the host or by the device.
    pub shape: TrialShape,
    /// The sense of turning, where the session states one.
    pub turned: Option<Turned>,
}

/// A complete calibration, in the sensor frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// What the sensor measures.
    pub dof: Dof,
    /// How it was found.
    pub method: Method,
    /// The converter's gain that its counts are counts at; `None` where nobody says.
    pub gain: Option<Gain>,
    /// Local gravity, m/s².
    pub gravity: f64,
    /// C (m × p): newton and newton metre per count.
    pub matrix: DMatrix<f64>,
    /// b (p), counts.
    pub bias_counts: DVector<f64>,
    /// Where the bias comes from.
    pub bias: BiasOrigin,
    /// S̃ (m × p): counts per newton and per newton metre.
    pub shape: DMatrix<f64>,
    /// That the sensor frame is no mirror image.
    pub handedness: Handedness,
    /// The part of the trials' shapes that the fused shape does not explain, relative; zero for a single trial.
    pub fusion_residual: f64,
    /// Standard deviations, where the method tells them.
    pub uncertainty: Option<Uncertainty>,
    /// The trials.
    pub trials: Vec<TrialRecord>,
    /// How the calibration fits trials at other loads, which it was not made from.
    pub checks: Vec<CheckRecord>,
    /// How far the sensor has moved since the calibration that oriented this one, if one did.
    pub drift: Option<Drift>,
}

/// How a calibration is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Shape from motion, all trials jointly.
    Sfm,
    /// Shape from motion, trial by trial as the paper does it: oriented by known loads, then stacked (eq. 18, 20).
    SfmPaper,
    /// Least squares on the known loads alone (eq. 3).
    LeastSquares,
}

/// Where the bias of a calibration comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BiasOrigin {
    /// Estimated with the shape.
    Estimated,
    /// Least squares on loads that do not determine it: the mean of the trials', from their motion.
    OfMotion,
    /// Taken as zero: the known loads alone do not determine it.
    TakenAsZero,
}

/// Whether the calibration may be a mirror image. There is one value, because a calibration that may be is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Handedness {
    /// The evidence leaves no other handedness.
    Proven,
}

/// What proved the handedness of one trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HandednessEvidence {
    /// Its known loads.
    KnownLoads,
    /// The sense in which the load turned.
    Turning,
    /// That it fits together with the other trials in this way only.
    Fusion,
    /// The stored calibration of the same sensor.
    Reference,
}

/// What a calibration file keeps of one trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrialRecord {
    /// The recording, as the session names it.
    pub recording: String,
    /// The mass, kilogram.
    pub mass_kg: f64,
    /// The moment arm, metre; empty for force sensors.
    pub arm_m: Vec<f64>,
    /// How many known loads took part.
    pub known_loads: u64,
    /// What the trial's motion told; absent where only its known loads were used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub solution: Option<SolutionRecord>,
}

/// What the motion of one trial told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SolutionRecord {
    /// How many samples took part.
    pub samples: SampleCounts,
    /// Eigenvalues of the covariance of the codes (p), descending, counts².
    pub eigenvalues: Vec<f64>,
    /// Noise of one channel, counts; `null` where nothing redundant tells it.
    pub noise_counts: Option<f64>,
    /// The trial's own bias (p), counts.
    pub bias_counts: Vec<f64>,
    /// Root mean square angle between known and recovered directions, degrees.
    pub alignment_residual_deg: f64,
    /// What proved that the trial is no mirror image.
    pub handedness: HandednessEvidence,
}

/// Calibrates by shape from motion, all trials jointly.
///
/// # Errors
///
/// Every [`CalibrationRefusal`] but those of least squares.
pub fn calibrate(
    dof: Dof,
    gravity: impl Into<Gravity>,
    trials: &[SolvedTrial],
) -> Result<Calibration, CalibrationRefusal> {
    require_gages(dof, trials)?;
    require_motion(trials)?;
    let gravity = gravity.into();
    let solved =
        joint::solve(dof, gravity.magnitude, trials).map_err(|refusal| cause::named(refusal, trials))?;
    let (calibration, _) = of_joint_solution(dof, gravity, trials, &solved)?;
    Ok(calibration)
}

/// The calibration that a joint solution gives, and what is known of its uncertainty.
fn of_joint_solution(
    dof: Dof,
    gravity: Gravity,
    trials: &[SolvedTrial],
    solved: &joint::Solved,
) -> Result<(Calibration, Option<Propagated>), CalibrationRefusal> {
    let bias_counts = common_bias(trials)?;
    let shape = solved.shape();
    let newtons: Vec<f64> = trials.iter().map(|trial| trial.case.mass_kg * gravity.magnitude).collect();
    let bias = &bias_covariance(trials, gravity.magnitude);
    let premises = Premises { gravity, newtons: &newtons, bias, strain: solved.strain };
    let propagated = propagate(&solved.problem, &solved.answer.fit, &premises);
    let wrench_error = propagated.as_ref().map_or(f64::INFINITY, |propagated| propagated.wrench_error);
    require_certain(&solved.answer.fit.state.shape, wrench_error)?;
    let matrix = matrix_of_shape(&shape).map_err(|_| CalibrationRefusal::ShapeRankDeficient)?;
    let records = trials
        .iter()
        .zip(&solved.evidence)
        .enumerate()
        .map(|(index, (trial, &evidence))| trial.record(solved.alignment_residual_deg(index), evidence));
    let calibration = Calibration {
        dof,
        method: Method::Sfm,
        gain: None,
        gravity: gravity.magnitude,
        matrix,
        bias_counts,
        bias: BiasOrigin::Estimated,
        shape,
        handedness: Handedness::Proven,
        fusion_residual: solved.residual(),
        uncertainty: propagated.as_ref().map(|propagated| propagated.uncertainty.clone()),
        trials: records.collect(),
        checks: Vec::new(),
        drift: None,
    }
    .finite()?;
    Ok((calibration, propagated))
}

impl Calibration {
    /// The number of gages, p.
    pub fn gages(&self) -> usize {
        self.matrix.ncols()
    }

    /// The wrench C(z − b) of one sample in counts: newton and newton metre, in the order of the DOF's axes.
    pub fn wrench(&self, counts: &DVector<f64>) -> DVector<f64> {
        &self.matrix * (counts - &self.bias_counts)
    }

    fn finite(self) -> Result<Self, CalibrationRefusal> {
        let numbers =
            self.matrix.iter().chain(&self.shape).chain(&self.bias_counts).chain([&self.fusion_residual]);
        let certain = self.uncertainty.as_ref().is_none_or(Uncertainty::is_finite);
        if certain && numbers.copied().all(f64::is_finite) {
            Ok(self)
        } else {
            Err(CalibrationRefusal::NonFinite)
        }
    }
}

impl LoadCase {
    fn record(&self) -> TrialRecord {
        TrialRecord {
            recording: self.name.clone(),
            mass_kg: self.mass_kg,
            arm_m: self.arm_m.iter().copied().collect(),
            known_loads: self.known_loads.len() as u64,
            solution: None,
        }
    }
}

fn require_gages(dof: Dof, trials: &[SolvedTrial]) -> Result<(), CalibrationRefusal> {
    let gages = trials.first().map_or(0, |trial| trial.shape.gages());
    if gages < dof.count() {
        return Err(CalibrationRefusal::TooFewGages { gages, need: dof.count() });
    }
    Ok(())
}

/// Refuses a trial whose motion leaves its gains open: nothing that follows would be right for the right reason.
fn require_motion(trials: &[SolvedTrial]) -> Result<(), CalibrationRefusal> {
    for (trial, solved) in trials.iter().enumerate() {
        // A principal value of the constraint is a gain squared, off by twice as much.
        let relative_uncertainty = 2.0 * solved.shape.covariance.gain_deviation();
        let spans = relative_uncertainty <= LARGEST_RELATIVE_UNCERTAINTY;
        if !spans {
            #[expect(clippy::cast_possible_truncation, reason = "for words, not for numbers")]
            let refusal = Refusal::MotionDoesNotSpan {
                relative_uncertainty: relative_uncertainty as f32,
                need: LARGEST_RELATIVE_UNCERTAINTY as f32,
            };
            return Err(CalibrationRefusal::Trial { trial, refusal });
        }
    }
    Ok(())
}

/// Refuses a shape (torque rows times the characteristic arm length) whose wrenches would be too uncertain. Either the
/// gages hardly respond to some component of the load, or the evidence is too rough for the arms.
fn require_certain(scaled_shape: &DMatrix<f64>, wrench_error: f64) -> Result<(), CalibrationRefusal> {
    if wrench_error <= LARGEST_WRENCH_ERROR {
        Ok(())
    } else if Singular::of(scaled_shape).condition() > LEAST_RESPONSE {
        Err(CalibrationRefusal::FusionUncertain { wrench_error, need: LARGEST_WRENCH_ERROR })
    } else {
        Err(CalibrationRefusal::ShapeRankDeficient)
    }
}

impl SolvedTrial {
    fn record(&self, alignment_residual_deg: f64, handedness: HandednessEvidence) -> TrialRecord {
        TrialRecord {
            solution: Some(SolutionRecord {
                samples: self.shape.samples.clone(),
                eigenvalues: self.shape.eigenvalues.iter().copied().collect(),
                noise_counts: self.shape.noise_counts,
                bias_counts: self.shape.bias_counts.iter().copied().collect(),
                alignment_residual_deg,
                handedness,
            }),
            ..self.case.record()
        }
    }
}
