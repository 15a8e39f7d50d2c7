//! Refinement on the host: its error against the bound and against the device's path on the same trials, and whether it knows.

use ftcal::calibration::refinement::refine;
use ftcal::calibration::trial::{Gating, TrialShape, solve};
use ftcal::recording::Recording;
use ftcal_shared::units::AdcCode;
use ftcal_tests::{KnownSensor, random};
use nalgebra::{DMatrix, SMatrix, SVector};

use crate::bound::Information;
use crate::limit::{Honesty, HonestySums, REPETITIONS, trial};
use crate::setting::{Setting, procrustes};

/// RMS errors of S.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RefinedError {
    /// Refined, over the bound.
    pub(crate) over_bound: f64,
    /// Refined, over that of the start.
    pub(crate) over_start: f64,
}

/// The same trials as [`crate::limit::error_over_bound`], refined. Every one must be solved.
pub(crate) fn refined_error<const GAGES: usize, const RANK: usize>(setting: Setting) -> RefinedError {
    let (mut refined, mut started, mut least) = (0.0, 0.0, 0.0);
    for repetition in 0..REPETITIONS {
        let mut rng = random(repetition);
        let sensor: KnownSensor<GAGES, RANK> = setting.sensor(&mut rng);
        let mut information = Information::new(&sensor);
        let codes = trial(&sensor, setting.samples, &mut rng, |direction| information.add(direction));
        let recording = recording(&codes);
        let Ok(start) = solve(&recording, RANK, Gating::Off) else {
            return RefinedError { over_bound: f64::INFINITY, over_start: f64::INFINITY };
        };
        started += shape_error(&sensor, &start).norm_squared();
        refined += shape_error(&sensor, &refine(&recording, &start).trial).norm_squared();
        least += information.least_shape_error();
    }
    let rms_ratio = |to: f64| (refined / to).sqrt();
    RefinedError { over_bound: rms_ratio(least), over_start: rms_ratio(started) }
}

/// As [`crate::limit::honesty`], of refined trials.
pub(crate) fn refined_honesty<const GAGES: usize, const RANK: usize>(setting: Setting) -> Honesty {
    let mut rng = random(1);
    let sensor: KnownSensor<GAGES, RANK> = setting.sensor(&mut rng);
    let mut sums = HonestySums::new((RANK + 1) * GAGES);
    for _ in 0..REPETITIONS {
        let recording = recording(&trial(&sensor, setting.samples, &mut rng, |_| ()));
        let Ok(start) = solve(&recording, RANK, Gating::Off) else { continue };
        let answer = refine(&recording, &start).trial;
        let shape_errors = shape_error(&sensor, &answer);
        let bias_errors = (0..GAGES).map(|gage| answer.bias_counts[gage] - sensor.bias[gage]);
        let (shape_deviations, bias_deviations) = deviations(&sensor, &answer);
        let errors = shape_errors.iter().copied().chain(bias_errors);
        sums.add(errors.zip(shape_deviations.iter().copied().chain(bias_deviations)));
    }
    sums.honesty()
}

fn recording<const GAGES: usize>(codes: &[[AdcCode; GAGES]]) -> Recording {
    let times = (0..codes.len()).map(|sample| sample as f64).collect();
    Recording::from_codes(GAGES, times, codes.as_flattened().to_vec())
}

fn shape_of<const GAGES: usize, const RANK: usize>(answer: &TrialShape) -> SMatrix<f64, RANK, GAGES> {
    SMatrix::from_fn(|row, gage| answer.shape_counts_per_load[(row, gage)])
}

/// R Ŝ − S, R by orthogonal Procrustes.
fn shape_error<const GAGES: usize, const RANK: usize>(
    truth: &KnownSensor<GAGES, RANK>,
    answer: &TrialShape,
) -> SMatrix<f64, RANK, GAGES> {
    let shape = shape_of(answer);
    procrustes(&truth.shape, &shape) * shape - truth.shape
}

/// The standard deviations that the answer predicts for R Ŝ, as [`ftcal_shared::estimation::uncertainty`] has it, and for b.
fn deviations<const GAGES: usize, const RANK: usize>(
    truth: &KnownSensor<GAGES, RANK>,
    answer: &TrialShape,
) -> (SMatrix<f64, RANK, GAGES>, Vec<f64>) {
    let shape: SMatrix<f64, RANK, GAGES> = shape_of(answer);
    let turn = procrustes(&truth.shape, &shape);
    let gains = SVector::<f64, RANK>::from_fn(|a, _| shape.row(a).norm_squared());
    let (along, across) = (answer.covariance.gains(), answer.covariance.redundant());
    let position = |a: usize, b: usize| {
        let (row, column) = (a.min(b), a.max(b));
        row * RANK - row * (row + 1) / 2 + column
    };
    let deviations = SMatrix::from_fn(|row, gage| {
        let mut gradient = DMatrix::zeros(along.nrows(), 1);
        let mut regression = 0.0;
        for a in 0..RANK {
            for b in 0..RANK {
                let turned = 2.0 * gains[a] / (gains[a] + gains[b]);
                gradient[position(a, b)] += turn[(row, a)] * turned * shape[(b, gage)];
                regression += turn[(row, a)] * across[(a, b)] * turn[(row, b)];
            }
        }
        let spanned: f64 = (0..RANK).map(|a| shape[(a, gage)] * shape[(a, gage)] / gains[a]).sum();
        (gradient.dot(&(&along * &gradient)) + regression * (1.0 - spanned)).sqrt()
    });
    let bias = answer.covariance.bias(&answer.shape_counts_per_load);
    (deviations, bias.diagonal().iter().map(|variance| variance.sqrt()).collect())
}
