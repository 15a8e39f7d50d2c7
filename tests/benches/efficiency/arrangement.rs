//! Where loads hang and which way they pull: arms that span what they must, and directions seen from their plane (in the plane:
//! from their line).

use core::f64::consts::TAU;

use ftcal::calibration::singular::Singular;
use nalgebra::{DMatrix, DVector, Rotation3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::session::{across, unit};

/// How far the corners are from an equilateral triangle, over its side.
const JITTER: f64 = 0.1;

/// How far the middle of the arms is from the sensor, metre.
const OFFSET_M: f64 = 0.05;

/// Arms (r, metre) about the corners of a regular polygon whose neighbours are `side_m` apart: as many as a sensor of this rank
/// needs, a triangle in space and a line in the plane.
pub(crate) fn spread(rank: usize, side_m: f64, rng: &mut ChaCha8Rng) -> Vec<DVector<f64>> {
    let centre = unit(rank, rng) * OFFSET_M;
    let turn = Rotation3::new(Vector3::from_fn(|_, _| rng.random_range(-3.0..3.0)));
    let radius = side_m / (2.0 * (TAU / (2 * rank) as f64).sin());
    let start = rng.random_range(0.0..TAU);
    (0..rank)
        .map(|corner| {
            let (sine, cosine) = (start + TAU * corner as f64 / rank as f64).sin_cos();
            let flat = Vector3::new(cosine, sine, 0.0) * radius;
            let placed = if rank == 3 { turn * flat } else { flat };
            &centre
                + DVector::from_column_slice(&placed.as_slice()[..rank])
                + unit(rank, rng) * (JITTER * side_m)
        })
        .collect()
}

/// The unit normal (r) of the plane of arms, or of their line.
pub(crate) fn normal_of(arms_m: &[DVector<f64>]) -> DVector<f64> {
    let mean = arms_m.iter().sum::<DVector<f64>>() / arms_m.len() as f64;
    let rank = mean.len();
    let offsets: Vec<DVector<f64>> = arms_m.iter().map(|arm| arm - &mean).collect();
    // As many columns as rows at least, so that the normal is among the vectors on the left.
    let square = DMatrix::from_columns(&offsets).resize_horizontally(arms_m.len().max(rank), 0.0);
    Singular::of(&square).left.column(rank - 1).into_owned()
}

/// The root mean square distance of the arms from their middle, metre.
pub(crate) fn characteristic_length(arms_m: &[DVector<f64>]) -> f64 {
    let mean = arms_m.iter().sum::<DVector<f64>>() / arms_m.len() as f64;
    let squares: f64 = arms_m.iter().map(|arm| (arm - &mean).norm_squared()).sum();
    (squares / arms_m.len() as f64).sqrt()
}

/// A direction at this angle above or below the plane of the arms, or their line.
pub(crate) fn elevated(normal: &DVector<f64>, elevation_rad: f64, rng: &mut ChaCha8Rng) -> DVector<f64> {
    let side = if rng.random() { 1.0 } else { -1.0 };
    across(normal, rng) * elevation_rad.cos() + normal * (side * elevation_rad.sin())
}
