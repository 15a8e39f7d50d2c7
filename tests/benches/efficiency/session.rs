//! Whole sessions whose truth is known: a sensor of several degrees of freedom, loads at several arms, and their recordings.
//!
//! S̃ (m × p) is random: orthonormal rows, distorted by 30 %, so that torques answer at [`TORQUE_LENGTH_M`] as forces do.

use core::f64::consts::FRAC_PI_6;

use ftcal::calibration::known_load::{KnownLoad, LoadCase, average, squashing_matrix};
use ftcal::calibration::matrix::matrix_of_shape;
use ftcal::calibration::singular::Singular;
use ftcal::calibration::trial::{self, Gating};
use ftcal::calibration::{Calibration, SolvedTrial};
use ftcal::recording::Recording;
use ftcal::session_file::STANDARD_GRAVITY;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::{AdcCode, Dof};
use nalgebra::{DMatrix, DVector};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Torques answer as forces do at this arm, metre.
pub(crate) const TORQUE_LENGTH_M: f64 = 0.05;

/// "About that way": within 30°.
pub(crate) const ROUGH_RAD: f64 = FRAC_PI_6;

const COUNTS_PER_NEWTON: f64 = 2e4;
const DISTORTION: f64 = 0.3;

/// Samples of the rest at a known load.
const REST_SAMPLES: usize = 100;

/// A linear sensor with noise.
#[derive(Clone, Debug)]
pub(crate) struct WrenchSensor {
    pub(crate) dof: Dof,
    /// S̃ (m × p), counts per newton and newton metre.
    pub(crate) shape: DMatrix<f64>,
    pub(crate) bias_counts: DVector<f64>,
    /// Standard deviation of the noise of each channel, counts.
    pub(crate) noise_counts: f64,
}

/// What truly hangs on the sensor in one trial.
#[derive(Clone, Debug)]
pub(crate) struct Hung {
    pub(crate) mass_kg: f64,
    /// r components, none for force sensors.
    pub(crate) arm_m: DVector<f64>,
}

impl Hung {
    fn newton(&self) -> f64 {
        self.mass_kg * STANDARD_GRAVITY
    }
}

/// A direction as the session states it, and as it is.
#[derive(Clone, Debug)]
pub(crate) struct Direction {
    pub(crate) stated: DVector<f64>,
    pub(crate) truth: DVector<f64>,
    pub(crate) accuracy_rad: f64,
}

impl WrenchSensor {
    /// A random sensor, without noise.
    pub(crate) fn random(dof: Dof, gages: usize, rng: &mut ChaCha8Rng) -> Self {
        let rough = DMatrix::from_fn(gages, dof.count(), |_, _| normal(rng));
        let mut shape = rough.qr().q().transpose() * (COUNTS_PER_NEWTON * (gages as f64).sqrt());
        shape += DMatrix::from_fn(dof.count(), gages, |_, _| DISTORTION * COUNTS_PER_NEWTON * normal(rng));
        for torque in dof.trial_rank()..dof.count() {
            shape.row_mut(torque).scale_mut(1.0 / TORQUE_LENGTH_M);
        }
        let bias_counts = DVector::from_fn(gages, |_, _| COUNTS_PER_NEWTON * normal(rng));
        Self { dof, shape, bias_counts, noise_counts: 0.0 }
    }

    /// The shape (r × p) that a trial sees, counts per unit load.
    pub(crate) fn seen(&self, hung: &Hung) -> DMatrix<f64> {
        squashing_matrix(self.dof.trial_rank(), &hung.arm_m) * &self.shape * hung.newton()
    }

    /// Makes the noise this share of the RMS signal of a gage over all these trials in all directions.
    pub(crate) fn with_relative_noise(mut self, share: f64, hung: &[Hung]) -> Self {
        let mean_square = |hung: &Hung| {
            let seen = self.seen(hung);
            seen.norm_squared() / seen.len() as f64
        };
        let mean = hung.iter().map(mean_square).sum::<f64>() / hung.len() as f64;
        self.noise_counts = share * mean.sqrt();
        self
    }

    /// Multiplies the answer to one random wrench, torques taken at [`TORQUE_LENGTH_M`].
    pub(crate) fn deafen(&mut self, by: f64, rng: &mut ChaCha8Rng) {
        let torques = self.dof.trial_rank()..self.dof.count();
        for torque in torques.clone() {
            self.shape.row_mut(torque).scale_mut(TORQUE_LENGTH_M);
        }
        let wrench = unit(self.dof.count(), rng);
        let heard = self.shape.transpose() * &wrench;
        self.shape += &wrench * heard.transpose() * (by - 1.0);
        for torque in torques {
            self.shape.row_mut(torque).scale_mut(1.0 / TORQUE_LENGTH_M);
        }
    }

    /// The recording of a load in these directions.
    pub(crate) fn record(&self, hung: &Hung, directions: &[DVector<f64>], rng: &mut ChaCha8Rng) -> Recording {
        let seen = self.seen(hung).transpose();
        let mut codes = Vec::with_capacity(directions.len() * self.shape.ncols());
        for direction in directions {
            let counts = &self.bias_counts + &seen * direction;
            codes.extend(counts.iter().map(|count| {
                #[expect(clippy::cast_possible_truncation, reason = "rounded to whole counts")]
                AdcCode::saturating((count + self.noise_counts * normal(rng)).round() as i64)
            }));
        }
        let times = (0..directions.len()).map(|sample| sample as f64 * 0.004).collect();
        Recording::from_codes(self.shape.ncols(), times, codes)
    }

    /// Rests with the load in these directions.
    pub(crate) fn known_loads(
        &self,
        hung: &Hung,
        directions: &[Direction],
        rng: &mut ChaCha8Rng,
    ) -> Vec<KnownLoad> {
        directions
            .iter()
            .filter_map(|direction| {
                let rest = self.record(hung, &vec![direction.truth.clone(); REST_SAMPLES], rng);
                Some(KnownLoad {
                    direction: direction.stated.clone(),
                    accuracy_rad: direction.accuracy_rad,
                    rest: average(&rest)?,
                })
            })
            .collect()
    }

    /// Solves the trial of a recording as the product does by default.
    pub(crate) fn solved(&self, recording: &Recording, case: LoadCase) -> Result<SolvedTrial, Refusal> {
        let shape = trial::solve(recording, self.dof.trial_rank(), Gating::On)?;
        Ok(SolvedTrial { case, shape, turned: None })
    }

    /// D⁻¹(Ĉ S̃ᵀ − I)D of a calibration matrix: the error of a wrench, torques divided by `length_m`.
    pub(crate) fn error_of(&self, matrix: &DMatrix<f64>, length_m: f64) -> DMatrix<f64> {
        let mut error = matrix * self.shape.transpose() - DMatrix::identity(matrix.nrows(), matrix.nrows());
        for torque in self.dof.trial_rank()..self.dof.count() {
            error.row_mut(torque).scale_mut(1.0 / length_m);
            error.column_mut(torque).scale_mut(length_m);
        }
        error
    }

    /// The relative error of a wrench, RMS over random wrenches of length one, torques divided by `length_m`.
    pub(crate) fn wrench_error(&self, matrix: &DMatrix<f64>, length_m: f64) -> f64 {
        self.error_of(matrix, length_m).norm() / (self.dof.count() as f64).sqrt()
    }

    /// The relative error of the worst wrench.
    pub(crate) fn worst_error(&self, matrix: &DMatrix<f64>) -> f64 {
        Singular::of(&self.error_of(matrix, TORQUE_LENGTH_M)).values.max()
    }

    /// The largest error of an element of the calibration matrix over the standard deviation that the calibration itself
    /// predicts for it; not a number where that tells nothing.
    pub(crate) fn worst_deviation(&self, calibration: &Calibration) -> f64 {
        let (Ok(truth), Some(uncertainty)) = (matrix_of_shape(&self.shape), &calibration.uncertainty) else {
            return f64::NAN;
        };
        (&calibration.matrix - truth).component_div(&uncertainty.matrix).amax()
    }
}

/// What the session says of a trial: all of it true, and as accurate as it can be said.
pub(crate) fn exact_case(hung: &Hung, known_loads: Vec<KnownLoad>) -> LoadCase {
    LoadCase {
        name: "trial.csv".to_owned(),
        mass_kg: hung.mass_kg,
        arm_m: hung.arm_m.clone(),
        arm_accuracy_m: 1e-6,
        mass_accuracy_kg: 1e-6 * hung.mass_kg,
        known_loads,
    }
}

/// A random number of mean zero and variance one.
pub(crate) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// A random direction of r dimensions.
pub(crate) fn unit(rank: usize, rng: &mut ChaCha8Rng) -> DVector<f64> {
    DVector::from_fn(rank, |_, _| normal(rng)).normalize()
}

/// So many random directions.
pub(crate) fn all_round(rank: usize, samples: usize, rng: &mut ChaCha8Rng) -> Vec<DVector<f64>> {
    (0..samples).map(|_| unit(rank, rng)).collect()
}

/// A random direction at a right angle to this one.
pub(crate) fn across(direction: &DVector<f64>, rng: &mut ChaCha8Rng) -> DVector<f64> {
    let other = unit(direction.len(), rng);
    (&other - direction * direction.dot(&other)).normalize()
}

/// This direction, turned by an angle to a random side.
pub(crate) fn turned(direction: &DVector<f64>, angle: f64, rng: &mut ChaCha8Rng) -> DVector<f64> {
    direction * angle.cos() + across(direction, rng) * angle.sin()
}

/// Stated with this standard deviation, each of the turns that move it.
pub(crate) fn known(truth: &DVector<f64>, accuracy_rad: f64, rng: &mut ChaCha8Rng) -> Direction {
    let offset = DVector::from_fn(truth.len(), |_, _| accuracy_rad * normal(rng));
    let stated = (truth + &offset - truth * truth.dot(&offset)).normalize();
    Direction { stated, truth: truth.clone(), accuracy_rad }
}

/// Stated as about that way: off by this angle, within 30°.
pub(crate) fn rough(truth: &DVector<f64>, angle: f64, rng: &mut ChaCha8Rng) -> Direction {
    Direction { stated: turned(truth, angle, rng), truth: truth.clone(), accuracy_rad: ROUGH_RAD }
}
