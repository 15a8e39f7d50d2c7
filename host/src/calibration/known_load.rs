//! Known loads: rests of the sensor under a load whose direction is known.
//!
//! A rest enters as the mean of its codes. How far the mean of its second half is from that of its first says whether it
//! was a rest at all.

use nalgebra::{DMatrix, DVector};

use crate::recording::Recording;

/// One rest at a known load.
#[derive(Clone, Debug)]
pub struct KnownLoad {
    /// Direction of the force acting on the sensor: a unit vector (r) in the sensor frame.
    pub direction: DVector<f64>,
    /// Standard deviation of that direction, radian.
    pub accuracy_rad: f64,
    /// The codes of the rest.
    pub rest: RestCounts,
}

/// What hung on the sensor in one trial, and the loads of it whose direction is known.
#[derive(Clone, Debug)]
pub struct LoadCase {
    /// The name of the trial's recording, for the calibration file.
    pub name: String,
    /// The mass, kilogram.
    pub mass_kg: f64,
    /// The moment arm, metre, in the sensor frame: r components, none for force sensors.
    pub arm_m: DVector<f64>,
    /// Standard deviation of each component of the arm, metre.
    pub arm_accuracy_m: f64,
    /// Standard deviation of the mass, kilogram.
    pub mass_accuracy_kg: f64,
    /// The known loads.
    pub known_loads: Vec<KnownLoad>,
}

/// The codes of a rest.
#[derive(Clone, Debug, PartialEq)]
pub struct RestCounts {
    /// Mean of each channel (p), counts.
    pub mean: DVector<f64>,
    /// Mean of the second half less the mean of the first (p), counts.
    pub drift: DVector<f64>,
    /// Variance of the noise of one channel, from the differences of successive samples, so that a drift does not count;
    /// counts².
    pub noise_variance: f64,
    /// Samples that took part.
    pub samples: u64,
}

/// Averages a rest, leaving out saturated samples; `None` where no other is left.
pub fn average(rest: &Recording) -> Option<RestCounts> {
    let samples: Vec<DVector<f64>> = rest.unsaturated().map(|(_, codes)| rest.counts(codes)).collect();
    let (first, second) = samples.split_at(samples.len() / 2);
    let mean = |part: &[DVector<f64>]| {
        (!part.is_empty()).then(|| part.iter().sum::<DVector<f64>>() / part.len() as f64)
    };
    let drift = match (mean(first), mean(second)) {
        (Some(first), Some(second)) => second - first,
        _ => DVector::zeros(rest.gages()),
    };
    // Two samples differ by twice the variance of one.
    let steps = samples.windows(2).filter_map(|pair| match pair {
        [before, after] => Some((after - before).norm_squared()),
        _ => None,
    });
    let differences = 2 * samples.len().saturating_sub(1).max(1) * rest.gages().max(1);
    let noise_variance = steps.sum::<f64>() / differences as f64;
    Some(RestCounts { mean: mean(&samples)?, drift, noise_variance, samples: samples.len() as u64 })
}

/// The squashing matrix [I Xᵀ] (r × m) of a load at this arm: force to wrench, as rows (eq. 14, 16, 19).
///
/// Its row k is the wrench of a unit force along axis k: that force, and its torque arm × eₖ. For a force sensor, which
/// has no arm, it is the identity.
pub fn squashing_matrix(rank: usize, arm_m: &DVector<f64>) -> DMatrix<f64> {
    let torque: DMatrix<f64> = match *arm_m.as_slice() {
        [x, y] => DMatrix::from_row_slice(2, 1, &[-y, x]),
        [x, y, z] => DMatrix::from_row_slice(3, 3, &[0.0, z, -y, -z, 0.0, x, y, -x, 0.0]),
        _ => DMatrix::zeros(rank, 0),
    };
    let forces = DMatrix::identity(rank, rank + torque.ncols());
    let mut squashing: DMatrix<f64> = forces;
    squashing.columns_mut(rank, torque.ncols()).copy_from(&torque);
    squashing
}

/// ⟨wwᵀ⟩ (m × m) over loads in all directions of the r-dimensional space, newton and newton metre: of each load its arm (metre)
/// and its weight (newton).
pub fn mean_square_load(
    rank: usize,
    components: usize,
    loads: impl ExactSizeIterator<Item = (DVector<f64>, f64)>,
) -> DMatrix<f64> {
    let count = loads.len().max(1) as f64;
    let mut sum = DMatrix::zeros(components, components);
    for (arm_m, newton) in loads {
        let squashing = squashing_matrix(rank, &arm_m);
        sum += squashing.transpose() * &squashing * (newton * newton / rank as f64);
    }
    sum / count
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::AdcCode;
    use nalgebra::{DVector, Vector3};

    use super::{average, squashing_matrix};
    use crate::recording::Recording;

    #[test]
    fn the_squashing_matrix_is_force_and_arm_cross_force() {
        let (arm, force) = (Vector3::new(0.3, -0.2, 0.7), Vector3::new(1.5, 2.5, -0.5));
        let wrench = squashing_matrix(3, &DVector::from_column_slice(arm.as_slice())).transpose() * force;
        let torque = arm.cross(&force);
        assert!((wrench.rows(0, 3) - force).amax() < 1e-15);
        assert!((wrench.rows(3, 3) - torque).amax() < 1e-15);

        let flat = DVector::from_column_slice(&[0.3, -0.2]);
        let planar = squashing_matrix(2, &flat).transpose() * DVector::from_column_slice(&[1.5, 2.5]);
        let in_space = Vector3::new(0.3, -0.2, 0.0).cross(&Vector3::new(1.5, 2.5, 0.0));
        assert!((planar[2] - in_space.z).abs() < 1e-15);
    }

    #[test]
    fn a_rest_is_its_mean_and_its_drift() {
        let codes = [10, 0, 14, 0, 20, 0, 1 << 23, 0].map(AdcCode::saturating).to_vec();
        let rest = average(&Recording::from_codes(2, vec![0.0; 4], codes)).expect("three samples are good");
        assert_eq!(rest.samples, 3);
        assert!((rest.mean[0] - 44.0 / 3.0).abs() < 1e-12);
        assert!((rest.drift[0] - 7.0).abs() < 1e-12);
        // Steps of 4 and 6 on one of two channels.
        assert!((rest.noise_variance - 52.0 / 8.0).abs() < 1e-12);
    }

    #[test]
    fn a_rest_with_nothing_but_saturated_samples_is_none() {
        let codes = vec![AdcCode::MAX; 4];
        assert_eq!(average(&Recording::from_codes(2, vec![0.0; 2], codes)), None);
    }
}
