//! From the recording of one trial to its shape: the shared estimator, with dimensions known only at run time.
//!
//! The estimator of [`ftcal_shared::estimation`] is generic over the number of gages p and the rank r of the trial; this
//! module picks the instance (p = 2 … 12, r = 2, 3), feeds it the codes, and brings the result back into the counts of
//! the recording. Samples with a channel at an end of the converter's range, and those of a converter that repeats itself, are
//! no measurements; samples during which the load moved too much are left out where that serves the answer. Where the answer does not
//! expect some of the samples, it is found again without them. Gate and sums are the sensor's own code.

use clap::ValueEnum;
use ftcal_shared::estimation::bins::{Bins, QuietSolution};
use ftcal_shared::estimation::expectation::Expectation;
use ftcal_shared::estimation::gate::Quietness;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::units::{AdcCode, Rank};
use nalgebra::{DMatrix, DVector};

use super::covariance::TrialCovariance;
use super::coverage::TrialCoverage;
use super::samples::{Outcome, Rejection, SampleCounts, gated, rejected, ungated};
use crate::recording::Recording;

/// Whether restless samples may be left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Gating {
    /// What repeats itself is rejected, and what moves where that serves the answer; so is what contradicts the answer, which is
    /// then found again.
    #[default]
    On,
    /// The same in one pass, as the sensor does it: with no answer yet to compare the samples with.
    Once,
    /// Every sample counts that is not saturated.
    Off,
}

/// How often a recording is gone through: each pass but the first compares the samples with what the one before found. It is
/// settled when that changes nothing, after the second pass as a rule.
const MOST_PASSES: usize = 4;

/// Shape and bias of one trial, in counts and per unit load, its orientation arbitrary (eq. 11).
#[derive(Clone, Debug, PartialEq)]
pub struct TrialShape {
    /// How many samples took part.
    pub samples: SampleCounts,
    /// Which samples of the recording took part.
    pub taken: Vec<bool>,
    /// Eigenvalues of the covariance of the codes (p), descending, counts².
    pub eigenvalues: DVector<f64>,
    /// Standard deviation of one channel's noise, counts; `None` at p = r, where nothing redundant tells it.
    pub noise_counts: Option<f64>,
    /// Standard deviation of one channel's noise in the quietest tenth of the samples, counts; `None` of too few.
    pub quietest_noise_counts: Option<f64>,
    /// b (p), counts.
    pub bias_counts: DVector<f64>,
    /// S (r × p), counts per unit load: z = b + Sᵀm with |m| = 1, up to a rotation and a mirror image.
    pub shape_counts_per_load: DMatrix<f64>,
    /// How certain shape and bias are.
    pub covariance: TrialCovariance,
    /// What the motion has covered.
    pub coverage: TrialCoverage,
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

    /// Standard deviations of the bias (p), counts.
    pub fn bias_deviation_counts(&self) -> DVector<f64> {
        self.covariance.bias(&self.shape_counts_per_load).diagonal().map(|variance| variance.max(0.0).sqrt())
    }

    /// Standard deviations of the shape (r × p), counts per unit load, up to its orientation.
    pub fn shape_deviation_counts_per_load(&self) -> DMatrix<f64> {
        self.covariance.shape(&self.shape_counts_per_load)
    }
}

/// Solves one trial of proper rank `rank`.
///
/// # Errors
///
/// Every refusal of the estimator; [`Refusal::Saturated`] where no sample is left but saturated ones.
pub fn solve(recording: &Recording, rank: usize, gating: Gating) -> Result<TrialShape, Refusal> {
    let unsupported = unsupported(recording.gages(), rank);
    let rank = Rank::new(rank).ok_or(unsupported)?;
    match recording.gages() {
        2 => solve_gages::<2, { higher_moment_count(2) }>(recording, rank, gating),
        3 => solve_gages::<3, { higher_moment_count(3) }>(recording, rank, gating),
        4 => solve_gages::<4, { higher_moment_count(4) }>(recording, rank, gating),
        5 => solve_gages::<5, { higher_moment_count(5) }>(recording, rank, gating),
        6 => solve_gages::<6, { higher_moment_count(6) }>(recording, rank, gating),
        7 => solve_gages::<7, { higher_moment_count(7) }>(recording, rank, gating),
        8 => solve_gages::<8, { higher_moment_count(8) }>(recording, rank, gating),
        9 => solve_gages::<9, { higher_moment_count(9) }>(recording, rank, gating),
        10 => solve_gages::<10, { higher_moment_count(10) }>(recording, rank, gating),
        11 => solve_gages::<11, { higher_moment_count(11) }>(recording, rank, gating),
        12 => solve_gages::<12, { higher_moment_count(12) }>(recording, rank, gating),
        _ => Err(unsupported),
    }
}

fn solve_gages<const GAGES: usize, const HIGHER: usize>(
    recording: &Recording,
    rank: Rank,
    gating: Gating,
) -> Result<TrialShape, Refusal> {
    let mut pass =
        Pass::<GAGES>::new::<HIGHER>(recording, rank, gating, None, first_look::<GAGES>(recording, gating))?;
    for _ in 1..MOST_PASSES {
        let Some(expected) = Expectation::new(&pass.quiet.solution)?.filter(|_| gating == Gating::On) else {
            break;
        };
        let outcomes = gated(recording, Some(&expected));
        if outcomes == pass.outcomes {
            break;
        }
        pass = Pass::new::<HIGHER>(recording, rank, gating, Some(expected), outcomes)?;
    }
    in_counts(&pass, recording)
}

/// What becomes of the samples before there is an answer to compare them with.
fn first_look<const GAGES: usize>(recording: &Recording, gating: Gating) -> Vec<Outcome> {
    match gating {
        Gating::On | Gating::Once => gated::<GAGES>(recording, None),
        Gating::Off => ungated(recording),
    }
}

/// All samples of a recording, taken once.
struct Pass<const GAGES: usize> {
    outcomes: Vec<Outcome>,
    off_magnitude: u32,
    quietest_variance: Option<f64>,
    quiet: QuietSolution<GAGES>,
}

impl<const GAGES: usize> Pass<GAGES> {
    /// Sums the samples up, which have these outcomes, and solves.
    fn new<const HIGHER: usize>(
        recording: &Recording,
        rank: Rank,
        gating: Gating,
        expectation: Option<Expectation<GAGES>>,
        outcomes: Vec<Outcome>,
    ) -> Result<Self, Refusal> {
        let mut bins = Box::new(Bins::<GAGES, HIGHER>::new());
        bins.expect(expectation);
        for (_, codes) in recording.samples() {
            let codes =
                <&[AdcCode; GAGES]>::try_from(codes).map_err(|_| unsupported(codes.len(), rank.count()))?;
            match gating {
                Gating::On | Gating::Once => bins.offer(codes),
                Gating::Off => bins.offer_ungated(codes),
            }?;
        }
        bins.finish();
        let quiet = bins.solve(rank).map_err(|refusal| {
            match (refusal, rejected(&outcomes, Rejection::Saturated)) {
                (Refusal::TooFewSamples { .. }, samples @ 1..) => Refusal::Saturated { samples },
                (other, _) => other,
            }
        })?;
        Ok(Self {
            outcomes,
            off_magnitude: bins.off_magnitude(),
            quietest_variance: bins.quietest_variance().filter(|_| gating != Gating::Off),
            quiet,
        })
    }

    fn counts(&self) -> SampleCounts {
        let count = |cause| (cause, rejected(&self.outcomes, cause));
        let measured = self.outcomes.iter().filter(|outcome| matches!(outcome, Outcome::Measured(_))).count();
        let left_out = (measured as u64).saturating_sub(self.quiet.solution.samples);
        let magnitude = if self.quiet.up_to < Quietness::Fast { u64::from(self.off_magnitude) } else { 0 };
        SampleCounts::new(
            self.outcomes.len() as u64,
            &[
                count(Rejection::Saturated),
                (Rejection::Moving, left_out.saturating_sub(magnitude)),
                count(Rejection::Repeated),
                count(Rejection::Parity),
                (Rejection::Magnitude, magnitude),
            ],
        )
    }

    /// Which samples took part.
    fn taken(&self) -> Vec<bool> {
        let takes = |outcome: &Outcome| matches!(outcome, Outcome::Measured(quietness) if *quietness <= self.quiet.up_to);
        self.outcomes.iter().map(takes).collect()
    }
}

/// The solution in the counts of the recording.
fn in_counts<const GAGES: usize>(pass: &Pass<GAGES>, recording: &Recording) -> Result<TrialShape, Refusal> {
    let solution = &pass.quiet.solution;
    let quantisation = recording.quantisation();
    let step = quantisation.counts_per_code();
    let bias_codes = DVector::from_column_slice(solution.bias_counts.as_slice());
    let shape_codes = DMatrix::from_fn(solution.rank.count(), GAGES, |row, gage| {
        solution.shape_counts_per_load[(row, gage)]
    });
    let shape = TrialShape {
        samples: pass.counts(),
        taken: pass.taken(),
        eigenvalues: DVector::from_column_slice(solution.eigenvalues.as_slice()) * (step * step),
        quietest_noise_counts: pass.quietest_variance.map(|variance| variance.max(0.0).sqrt() * step),
        noise_counts: solution.noise_variance.map(|variance| variance.max(0.0).sqrt() * step),
        bias_counts: bias_codes * step + quantisation.offset_counts(),
        shape_counts_per_load: shape_codes * step,
        covariance: TrialCovariance::new(&solution.uncertainty, &solution.redundant_noise, step),
        coverage: TrialCoverage::new(solution, quantisation)?,
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

    use super::{Gating, solve};
    use crate::calibration::samples::{Rejection, SampleCounts};
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
            let trial =
                solve(&planar.record(1.0, &[], &turn(500, 2.0)), 2, Gating::On).expect("the motion spans");
            assert_eq!((trial.rank(), trial.gages()), (2, gages));
            assert_eq!(trial.noise_counts.is_some(), gages > 2);
            if gages > 2 {
                let mut spatial = Sensor::new(Dof::SpatialForce, gages, 1);
                let trial =
                    solve(&spatial.record(1.0, &[], &sphere(500)), 3, Gating::On).expect("the motion spans");
                assert_eq!((trial.rank(), trial.gages()), (3, gages));
            }
        }
        let mut sensor = Sensor::new(Dof::PlanarForce, 4, 1);
        let recording = sensor.record(1.0, &[], &turn(100, 1.0));
        assert_eq!(
            solve(&recording, 4, Gating::On),
            Err(Refusal::UnsupportedDimensions { gages: 4, rank: 4 })
        );
    }

    #[test]
    fn the_answer_follows_the_unit_and_the_zero_of_the_codes() {
        let mut sensor = Sensor::new(Dof::SpatialForce, 6, 2);
        let recording = sensor.record(1.0, &[], &sphere(800));
        let plain = solve(&recording, 3, Gating::On).expect("the motion spans");
        let (times, counts) = counts_of(&recording);
        for (scale, shift) in
            [(1.0 / 3.0, 0.0), (1e-9, 0.0), (1000.0, 1e9), (2.0_f64.powi(-40), 1e-3), (0.7, -12.345)]
        {
            let scaled: Vec<f64> = counts.iter().map(|count| count * scale + shift).collect();
            let other = solve(&Recording::from_counts(6, times.clone(), &scaled), 3, Gating::On)
                .expect("the motion spans");
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
        let clean = solve(&recording, 2, Gating::On).expect("the motion spans");
        let mut codes: Vec<AdcCode> = recording.samples().flat_map(|(_, codes)| codes.to_vec()).collect();
        for overload in
            [[AdcCode::MAX, AdcCode::ZERO, AdcCode::ZERO], [AdcCode::ZERO, AdcCode::MIN, AdcCode::MAX]]
        {
            codes.splice(0..0, overload);
        }
        let times = (0..402).map(f64::from).collect();
        let trial = solve(&Recording::from_codes(3, times, codes), 2, Gating::On).expect("the motion spans");
        assert_eq!(trial.samples, SampleCounts::new(402, &[(Rejection::Saturated, 2)]));
        assert_eq!(trial.samples.used, 400);
        assert_eq!(trial.samples.rejected.get(&Rejection::Saturated), Some(&2));
        assert_eq!(trial.shape_counts_per_load, clean.shape_counts_per_load);

        let nothing_else = Recording::from_codes(3, vec![0.0; 5], vec![AdcCode::MAX; 15]);
        assert_eq!(solve(&nothing_else, 2, Gating::On), Err(Refusal::Saturated { samples: 5 }));
        assert!(matches!(
            solve(&Recording::from_codes(3, vec![], vec![]), 2, Gating::On),
            Err(Refusal::TooFewSamples { .. })
        ));
    }
}
