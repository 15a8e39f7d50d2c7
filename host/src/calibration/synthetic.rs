//! Small simulated sensors and trials for the tests of this crate's calibration.

use std::f64::consts::TAU;

use ftcal_shared::units::{AdcCode, Dof};
use nalgebra::{DMatrix, DVector, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::consistency::{ARM_ACCURACY_M, MASS_ACCURACY};
use super::known_load::{KnownLoad, LoadCase, average, squashing_matrix};
use super::singular::Singular;
use super::trial::Gating;
use super::turning::{Turned, swept};
use super::{SolvedTrial, motion, trial};
use crate::recording::Recording;
use crate::session_file::{STANDARD_GRAVITY, Turning};

/// Counts that a load of one newton makes, about.
const COUNTS_PER_NEWTON: f64 = 2e4;

/// Torques answer as forces do at this arm, metre.
const TORQUE_LENGTH_M: f64 = 0.05;

/// A linear sensor with noise.
#[derive(Debug)]
pub(crate) struct Sensor {
    pub(crate) dof: Dof,
    /// S̃ (m × p), counts per newton and newton metre.
    pub(crate) shape: DMatrix<f64>,
    pub(crate) bias_counts: DVector<f64>,
    pub(crate) noise_counts: f64,
    random: ChaCha8Rng,
}

/// A load as a test knows it: what is claimed, and how far the truth is from that.
#[derive(Clone, Debug)]
pub(crate) struct Rests {
    pub(crate) directions: Vec<DVector<f64>>,
    pub(crate) accuracy_rad: f64,
}

impl Sensor {
    pub(crate) fn new(dof: Dof, gages: usize, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        // Well-conditioned: orthonormal rows, distorted a little.
        let rough = DMatrix::from_fn(gages, dof.count(), |_, _| normal(&mut random));
        let mut shape = rough.qr().q().transpose() * (COUNTS_PER_NEWTON * (gages as f64).sqrt());
        shape += DMatrix::from_fn(dof.count(), gages, |_, _| 0.3 * COUNTS_PER_NEWTON * normal(&mut random));
        for torque in dof.trial_rank()..dof.count() {
            shape.row_mut(torque).scale_mut(1.0 / TORQUE_LENGTH_M);
        }
        let bias_counts = DVector::from_fn(gages, |_, _| COUNTS_PER_NEWTON * normal(&mut random));
        Self { dof, shape, bias_counts, noise_counts: 0.002 * COUNTS_PER_NEWTON, random }
    }

    pub(crate) fn unit(&mut self) -> DVector<f64> {
        let rank = self.dof.trial_rank();
        DVector::from_fn(rank, |_, _| normal(&mut self.random)).normalize()
    }

    /// A direction turned by a small random angle of this standard deviation.
    fn disturbed(&mut self, direction: &DVector<f64>, deviation_rad: f64) -> DVector<f64> {
        let rank = direction.len();
        let offset = DVector::from_fn(rank, |_, _| deviation_rad * normal(&mut self.random));
        (direction + &offset - direction * direction.dot(&offset)).normalize()
    }

    /// The recording of a load in these directions.
    pub(crate) fn record(&mut self, mass_kg: f64, arm_m: &[f64], directions: &[DVector<f64>]) -> Recording {
        let rank = self.dof.trial_rank();
        let arm = DVector::from_column_slice(arm_m);
        let seen = (squashing_matrix(rank, &arm) * &self.shape).transpose() * (mass_kg * STANDARD_GRAVITY);
        let mut codes = Vec::new();
        for direction in directions {
            let counts = &self.bias_counts + &seen * direction;
            for count in counts.iter() {
                #[expect(clippy::cast_possible_truncation, reason = "a few million")]
                let code = (count + self.noise_counts * normal(&mut self.random)).round() as i64;
                codes.push(AdcCode::saturating(code));
            }
        }
        let times = (0..directions.len()).map(|sample| sample as f64 * 0.01).collect();
        Recording::from_codes(self.shape.ncols(), times, codes)
    }

    /// A trial: the load turned all round, and rests at known loads with direction errors of the stated accuracy.
    pub(crate) fn trial(&mut self, mass_kg: f64, arm_m: &[f64], rests: &Rests) -> SolvedTrial {
        let motion: Vec<DVector<f64>> = match self.dof.trial_rank() {
            2 => turn(1500, 3.0),
            _ => sphere(1500),
        };
        let recording = self.record(mass_kg, arm_m, &motion);
        let known_loads = rests
            .directions
            .iter()
            .map(|direction| {
                let truth = self.disturbed(direction, rests.accuracy_rad);
                let rest = self.record(mass_kg, arm_m, &vec![truth; 100]);
                KnownLoad {
                    direction: direction.clone(),
                    accuracy_rad: rests.accuracy_rad,
                    rest: average(&rest).expect("nothing is saturated"),
                }
            })
            .collect();
        let case = LoadCase {
            name: "trial.csv".to_owned(),
            mass_kg,
            arm_m: DVector::from_column_slice(arm_m),
            arm_accuracy_m: ARM_ACCURACY_M,
            mass_accuracy_kg: MASS_ACCURACY * mass_kg,
            known_loads,
        };
        let shape = trial::solve(&recording, self.dof.trial_rank(), Gating::On).expect("the motion spans");
        SolvedTrial { case, shape, turned: None }
    }

    /// The same, with the sense of turning stated: these trials turn counterclockwise.
    pub(crate) fn turned_trial(
        &mut self,
        mass_kg: f64,
        arm_m: &[f64],
        rests: &Rests,
        claimed: Turning,
    ) -> SolvedTrial {
        let solved = self.trial(mass_kg, arm_m, rests);
        let recording = self.record(mass_kg, arm_m, &turn(1500, 3.0));
        let motion = motion::recover(&recording, &solved.shape).expect("invertible");
        SolvedTrial { turned: Some(Turned { claimed, swept: swept(&motion) }), ..solved }
    }

    /// How far a calibration matrix is off: the largest singular value of the error CS̃ᵀ − I, torques in newton at
    /// the length at which they answer as forces do.
    pub(crate) fn error_of(&self, matrix: &DMatrix<f64>) -> f64 {
        let mut error = matrix * self.shape.transpose() - DMatrix::identity(matrix.nrows(), matrix.nrows());
        for torque in self.dof.trial_rank()..self.dof.count() {
            error.row_mut(torque).scale_mut(1.0 / TORQUE_LENGTH_M);
            error.column_mut(torque).scale_mut(TORQUE_LENGTH_M);
        }
        Singular::of(&error).values.max()
    }
}

/// Directions of the plane, counterclockwise.
pub(crate) fn turn(samples: u32, turns: f64) -> Vec<DVector<f64>> {
    let angle = |sample: u32| TAU * turns * f64::from(sample) / f64::from(samples);
    (0..samples).map(|sample| flat(angle(sample))).collect()
}

/// The direction of the plane at this angle.
pub(crate) fn flat(angle: f64) -> DVector<f64> {
    DVector::from_column_slice(&[angle.cos(), angle.sin()])
}

/// A direction of space.
pub(crate) fn spatial(x: f64, y: f64, z: f64) -> DVector<f64> {
    DVector::from_column_slice(Vector3::new(x, y, z).normalize().as_slice())
}

/// Directions of space, evenly spread along a spiral.
pub(crate) fn sphere(samples: u32) -> Vec<DVector<f64>> {
    let golden = TAU * 0.618_033_988_749_895;
    (0..samples)
        .map(|sample| {
            let height = 1.0 - (2.0 * f64::from(sample) + 1.0) / f64::from(samples);
            let radius = (1.0 - height * height).sqrt();
            let angle = golden * f64::from(sample);
            spatial(radius * angle.cos(), radius * angle.sin(), height)
        })
        .collect()
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}
