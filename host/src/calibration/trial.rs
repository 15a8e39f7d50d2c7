//! From the recording of one trial to its shape: the shared estimator, with dimensions known only at run time.
//!
//! The estimator of [`ftcal_shared::estimation`] is generic over the number of gages p and the rank r of the trial; this
//! module picks the instance (p = 2 … 12, r = 2, 3), feeds it the codes, and brings the result back into the counts of
//! the recording. Samples with a channel at an end of the converter's range are no measurements: they are rejected and
//! counted.

use std::collections::BTreeMap;

use ftcal_shared::estimation::moments::{Moments, higher_moment_count};
use ftcal_shared::estimation::shape::{TrialSolution, solve_trial};
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::AdcCode;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::coverage::TrialQuality;
use crate::recording::{Recording, is_saturated};

/// Why a sample takes no part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rejection {
    /// A channel stood at an end of the converter's range.
    Saturated,
}

/// How many samples took part.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SampleCounts {
    /// Samples recorded.
    pub total: u64,
    /// Samples used.
    pub used: u64,
    /// Samples not used, by cause.
    pub rejected: BTreeMap<Rejection, u64>,
}

impl SampleCounts {
    /// The counts of so many samples, some of them saturated.
    pub fn new(total: u64, saturated: u64) -> Self {
        let rejected = (saturated > 0).then_some((Rejection::Saturated, saturated));
        Self { total, used: total.saturating_sub(saturated), rejected: rejected.into_iter().collect() }
    }
}

/// Shape and bias of one trial, in counts and per unit load, its orientation arbitrary (eq. 11).
#[derive(Clone, Debug, PartialEq)]
pub struct TrialShape {
    /// How many samples took part.
    pub samples: SampleCounts,
    /// Eigenvalues of the covariance of the codes (p), descending, counts².
    pub eigenvalues: DVector<f64>,
    /// Standard deviation of one channel's noise, counts; `None` at p = r, where nothing redundant tells it.
    pub noise_counts: Option<f64>,
    /// b (p), counts.
    pub bias_counts: DVector<f64>,
    /// S (r × p), counts per unit load: z = b + Sᵀm with |m| = 1, up to a rotation and a mirror image.
    pub shape_counts_per_load: DMatrix<f64>,
    /// How well it is known; `None` where the sensor solved it, which does not tell.
    pub quality: Option<TrialQuality>,
}

impl TrialShape {
    /// The rank r of the trial.
    pub fn rank(&self) -> usize {
        self.shape_counts_per_load.nrows()
    }

    /// The number of gages, p.
    pub fn gages(&self) -> usize {
        self.shape_counts_per_load.ncols()
    }
}

/// Solves one trial of proper rank `rank`.
///
/// # Errors
///
/// Every refusal of the estimator; [`Refusal::Saturated`] where no sample is left but saturated ones.
pub fn solve(recording: &Recording, rank: usize) -> Result<TrialShape, Refusal> {
    match rank {
        2 => solve_rank::<2>(recording),
        3 => solve_rank::<3>(recording),
        _ => Err(unsupported(recording.gages(), rank)),
    }
}

fn solve_rank<const RANK: usize>(recording: &Recording) -> Result<TrialShape, Refusal> {
    match recording.gages() {
        2 => solve_gages::<2, { higher_moment_count(2) }, RANK>(recording),
        3 => solve_gages::<3, { higher_moment_count(3) }, RANK>(recording),
        4 => solve_gages::<4, { higher_moment_count(4) }, RANK>(recording),
        5 => solve_gages::<5, { higher_moment_count(5) }, RANK>(recording),
        6 => solve_gages::<6, { higher_moment_count(6) }, RANK>(recording),
        7 => solve_gages::<7, { higher_moment_count(7) }, RANK>(recording),
        8 => solve_gages::<8, { higher_moment_count(8) }, RANK>(recording),
        9 => solve_gages::<9, { higher_moment_count(9) }, RANK>(recording),
        10 => solve_gages::<10, { higher_moment_count(10) }, RANK>(recording),
        11 => solve_gages::<11, { higher_moment_count(11) }, RANK>(recording),
        12 => solve_gages::<12, { higher_moment_count(12) }, RANK>(recording),
        gages => Err(unsupported(gages, RANK)),
    }
}

fn solve_gages<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    recording: &Recording,
) -> Result<TrialShape, Refusal> {
    let mut moments: Option<Box<Moments<GAGES, HIGHER>>> = None;
    let (mut total, mut saturated) = (0, 0);
    for (_, codes) in recording.samples() {
        total += 1;
        if is_saturated(codes) {
            saturated += 1;
            continue;
        }
        let codes = <&[AdcCode; GAGES]>::try_from(codes).map_err(|_| unsupported(codes.len(), RANK))?;
        // The first sample used is the pivot.
        moments.get_or_insert_with(|| Box::new(Moments::new(*codes))).push(codes)?;
    }
    let Some(mut moments) = moments else {
        return Err(match saturated {
            0 => Refusal::TooFewSamples { have: 0, need: 1 },
            samples => Refusal::Saturated { samples },
        });
    };
    moments.settle();
    let solution = solve_trial::<GAGES, HIGHER, RANK>(&moments)?;
    in_counts(&solution, recording, SampleCounts::new(total, saturated))
}

/// The solution in the counts of the recording.
fn in_counts<const GAGES: usize, const RANK: usize>(
    solution: &TrialSolution<GAGES, RANK>,
    recording: &Recording,
    samples: SampleCounts,
) -> Result<TrialShape, Refusal> {
    let quantisation = recording.quantisation();
    let step = quantisation.counts_per_code();
    let bias_codes = DVector::from_column_slice(solution.bias_counts.as_slice());
    let shape_codes = DMatrix::from_column_slice(RANK, GAGES, solution.shape_counts_per_load.as_slice());
    let shape = TrialShape {
        samples,
        eigenvalues: DVector::from_column_slice(solution.eigenvalues.as_slice()) * (step * step),
        noise_counts: solution.noise_variance.map(|variance| variance.max(0.0).sqrt() * step),
        bias_counts: bias_codes * step + quantisation.offset_counts(),
        shape_counts_per_load: shape_codes * step,
        quality: Some(TrialQuality::new(solution, quantisation)?),
    };
    let numbers = shape.eigenvalues.iter().chain(&shape.bias_counts).chain(&shape.shape_counts_per_load);
    if numbers.chain(&shape.noise_counts).all(|number| number.is_finite()) {
        Ok(shape)
    } else {
        Err(Refusal::NonFinite)
    }
}

/// Dimensions beyond what the report holds are reported as the most it holds.
fn unsupported(gages: usize, rank: usize) -> Refusal {
    let small = |dimension: usize| u8::try_from(dimension).unwrap_or(u8::MAX);
    Refusal::UnsupportedDimensions { gages: small(gages), rank: small(rank) }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::refusal::Refusal;
    use ftcal_shared::units::{AdcCode, Dof};
    use nalgebra::DVector;

    use super::{Rejection, SampleCounts, solve};
    use crate::calibration::synthetic::{Sensor, sphere, turn};
    use crate::recording::Recording;

    fn counts_of(recording: &Recording) -> (Vec<f64>, Vec<f64>) {
        let times = recording.samples().map(|(time, _)| time).collect();
        let counts = recording
            .samples()
            .flat_map(|(_, codes)| recording.counts(codes).iter().copied().collect::<Vec<_>>());
        (times, counts.collect())
    }

    #[test]
    fn every_number_of_gages_finds_its_instance() {
        for gages in 2..=12 {
            let mut planar = Sensor::new(Dof::PlanarForce, gages, 1);
            let trial = solve(&planar.record(1.0, &[], &turn(500, 2.0)), 2).expect("the motion spans");
            assert_eq!((trial.rank(), trial.gages()), (2, gages));
            assert_eq!(trial.noise_counts.is_some(), gages > 2);
            if gages > 2 {
                let mut spatial = Sensor::new(Dof::SpatialForce, gages, 1);
                let trial = solve(&spatial.record(1.0, &[], &sphere(500)), 3).expect("the motion spans");
                assert_eq!((trial.rank(), trial.gages()), (3, gages));
            }
        }
        let mut sensor = Sensor::new(Dof::PlanarForce, 4, 1);
        let recording = sensor.record(1.0, &[], &turn(100, 1.0));
        assert_eq!(solve(&recording, 4), Err(Refusal::UnsupportedDimensions { gages: 4, rank: 4 }));
    }

    #[test]
    fn the_answer_follows_the_unit_and_the_zero_of_the_codes() {
        let mut sensor = Sensor::new(Dof::SpatialForce, 6, 2);
        let recording = sensor.record(1.0, &[], &sphere(800));
        let plain = solve(&recording, 3).expect("the motion spans");
        let (times, counts) = counts_of(&recording);
        for (scale, shift) in
            [(1.0 / 3.0, 0.0), (1e-9, 0.0), (1000.0, 1e9), (2.0_f64.powi(-40), 1e-3), (0.7, -12.345)]
        {
            let scaled: Vec<f64> = counts.iter().map(|count| count * scale + shift).collect();
            let other =
                solve(&Recording::from_counts(6, times.clone(), &scaled), 3).expect("the motion spans");
            // The quantisation is finer than the codes, so noise decides; rounding to codes moves it by a trifle.
            let unit = scale * plain.shape_counts_per_load.norm();
            let gram = |shape: &nalgebra::DMatrix<f64>| shape.transpose() * shape;
            let moved = gram(&other.shape_counts_per_load) - gram(&(&plain.shape_counts_per_load * scale));
            assert!(moved.norm() < 1e-5 * unit * unit, "shape at {scale}");
            let bias = &plain.bias_counts * scale + DVector::from_element(6, shift);
            assert!((&other.bias_counts - bias).norm() < 1e-5 * unit, "bias at {scale}");
            let (noise, expected) =
                (other.noise_counts.unwrap_or(0.0), plain.noise_counts.unwrap_or(0.0) * scale);
            assert!((noise - expected).abs() < 0.02 * expected, "noise at {scale}: {noise} for {expected}");
        }
    }

    #[test]
    fn saturated_samples_are_counted_and_change_nothing() {
        let mut sensor = Sensor::new(Dof::PlanarForce, 3, 3);
        let recording = sensor.record(1.0, &[], &turn(400, 2.0));
        let clean = solve(&recording, 2).expect("the motion spans");
        let mut codes: Vec<AdcCode> = recording.samples().flat_map(|(_, codes)| codes.to_vec()).collect();
        for overload in
            [[AdcCode::MAX, AdcCode::ZERO, AdcCode::ZERO], [AdcCode::ZERO, AdcCode::MIN, AdcCode::MAX]]
        {
            codes.splice(0..0, overload);
        }
        let times = (0..402).map(f64::from).collect();
        let trial = solve(&Recording::from_codes(3, times, codes), 2).expect("the motion spans");
        assert_eq!(trial.samples, SampleCounts::new(402, 2));
        assert_eq!(trial.samples.used, 400);
        assert_eq!(trial.samples.rejected.get(&Rejection::Saturated), Some(&2));
        assert_eq!(trial.shape_counts_per_load, clean.shape_counts_per_load);

        let nothing_else = Recording::from_codes(3, vec![0.0; 5], vec![AdcCode::MAX; 15]);
        assert_eq!(solve(&nothing_else, 2), Err(Refusal::Saturated { samples: 5 }));
        assert!(matches!(
            solve(&Recording::from_codes(3, vec![], vec![]), 2),
            Err(Refusal::TooFewSamples { .. })
        ));
    }
}
