//! How far a sensor has moved since its stored calibration, and how far it would seem to have moved if it had not.
//!
//! The stored shape S̃₀ and the new one S̃ differ in each gage by the length of a column of S̃ − S̃₀, and in each component by what
//! the stored matrix makes of a unit load along it: column k of C₀S̃ᵀ − I. Both lengths are never negative, so that an unmoved sensor
//! shows some, too: about the standard deviation given with each. That is made of the new shape's covariance, and, roughly, of what
//! the stored calibration promises ([`super::accuracy`]). Local gravity is not in it: at one place it changes nothing.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::Calibration;
use super::accuracy::wrench_deviation;

/// How many standard deviations are a movement.
const MOVED: f64 = 3.0;

/// How far the sensor has moved since its stored calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Change of each gage's response (p), percent of it.
    pub gage_percent: Vec<f64>,
    /// What would be seen of an unmoved one (p), percent, one standard deviation.
    pub gage_uncertainty_percent: Vec<f64>,
    /// How far each component (m) would be off if the stored calibration were still used, percent of a load along it.
    pub axis_percent: Vec<f64>,
    /// What would be seen of an unmoved sensor (m), percent, one standard deviation.
    pub axis_uncertainty_percent: Vec<f64>,
    /// How many of the m components the arms see; the others are as they were.
    pub components_seen: u64,
}

/// Relative standard deviations of a new shape.
#[derive(Clone, Debug)]
pub struct ShapeDeviation {
    /// Of the response of each gage (p).
    pub gages: DVector<f64>,
    /// Of the response to a load along each component (m).
    pub components: DVector<f64>,
}

/// How far the shape has moved from the stored one, both with rows divided by `lengths`, so that all are of one unit.
pub fn drift(
    stored: &Calibration,
    (before, after): (&DMatrix<f64>, &DMatrix<f64>),
    lengths: &DVector<f64>,
    deviation: &ShapeDeviation,
    components_seen: usize,
) -> Drift {
    let percent = |part: f64| 100.0 * part;
    let gages = before.column_iter().zip(after.column_iter());
    let mut inverse = stored.matrix.clone();
    for (mut row, &length) in inverse.row_iter_mut().zip(lengths) {
        row /= length;
    }
    let error = inverse * after.transpose() - DMatrix::identity(before.nrows(), before.nrows());
    let before_that = wrench_deviation(stored).unwrap_or(0.0);
    let uncertain = |own: &DVector<f64>| own.iter().map(|&own| percent(own.hypot(before_that))).collect();
    Drift {
        gage_percent: gages.map(|(before, after)| percent((after - before).norm() / before.norm())).collect(),
        gage_uncertainty_percent: uncertain(&deviation.gages),
        axis_percent: error.column_iter().map(|column| percent(column.norm())).collect(),
        axis_uncertainty_percent: uncertain(&deviation.components),
        components_seen: components_seen as u64,
    }
}

impl Drift {
    /// The change of each gage and what would be seen of an unmoved one, percent.
    pub fn gages(&self) -> impl Iterator<Item = Moved> {
        moved(&self.gage_percent, &self.gage_uncertainty_percent)
    }

    /// The change of each component and what would be seen of an unmoved sensor, percent.
    pub fn axes(&self) -> impl Iterator<Item = Moved> {
        moved(&self.axis_percent, &self.axis_uncertainty_percent)
    }
}

/// A change beside what chance makes of none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moved {
    /// The change, percent.
    pub percent: f64,
    /// Its standard deviation if there is none, percent.
    pub uncertainty_percent: f64,
}

impl Moved {
    /// Whether chance does not explain it.
    pub fn is_real(self) -> bool {
        self.percent > MOVED * self.uncertainty_percent
    }
}

fn moved(percent: &[f64], uncertainty_percent: &[f64]) -> impl Iterator<Item = Moved> {
    let both = percent.iter().zip(uncertainty_percent);
    both.map(|(&percent, &uncertainty_percent)| Moved { percent, uncertainty_percent })
}
