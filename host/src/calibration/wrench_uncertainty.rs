//! How certain one wrench is: the error of the calibration itself, which stays the same from sample to sample. The noise of a
//! sample comes on top of it, and shows by how much the wrenches of a load at rest scatter.
//!
//! A wrench w is wrong by −C δA w − C δb ([`super::joint::uncertainty`]), so that the variance of its component i is
//! σᵢ² = wᵀEᵢw + gᵢᵀw + zᵢ². The part in the middle is what the errors of shape and bias have in common: where the trials' loads have been
//! on one side only, wrenches on that side are known better than those on the other.

use nalgebra::{DMatrix, DVector};

/// What is rounding in a covariance that was brought to a diagonal of ones.
const ROUNDING: f64 = 1e-9;

/// The variance of each component of a wrench, as it follows the wrench.
#[derive(Clone, Debug, PartialEq)]
pub struct WrenchUncertainty {
    /// Eᵢ of each component (m of m × m), in the units of σᵢ² over those of the components that it is multiplied with.
    pub by_load: Vec<DMatrix<f64>>,
    /// gᵢ of each component (m of m), in the units of σᵢ² over those of the components that it is multiplied with.
    pub with_bias: Vec<DVector<f64>>,
    /// zᵢ, of the unloaded sensor (m), newton and newton metre.
    pub unloaded: DVector<f64>,
}

impl WrenchUncertainty {
    /// Standard deviation of each component of this wrench (m), newton and newton metre; `wrench` (m) in the same.
    pub fn of(&self, wrench: &DVector<f64>) -> DVector<f64> {
        DVector::from_fn(self.unloaded.len(), |component, _| {
            let of_load = wrench.dot(&(&self.by_load[component] * wrench));
            let variance = of_load + self.with_bias[component].dot(wrench) + self.unloaded[component].powi(2);
            // Rounding of a variance that is all but zero; what is not a number stays what it is.
            if variance < 0.0 { 0.0 } else { variance.sqrt() }
        })
    }

    /// The mean of the variances (m) over loads that are as often in one direction as in the opposite one, and of which
    /// `mean_square` (m × m) is ⟨wwᵀ⟩.
    pub fn mean_variance(&self, mean_square: &DMatrix<f64>) -> DVector<f64> {
        DVector::from_fn(self.unloaded.len(), |component, _| {
            self.by_load[component].component_mul(mean_square).sum() + self.unloaded[component].powi(2)
        })
    }

    /// The same with no more in common to shape and bias than both can have: their covariances are told by two roads, which round
    /// differently, and no variance may come out negative.
    #[must_use]
    pub fn bounded(mut self) -> Self {
        for component in 0..self.unloaded.len() {
            let explained = self.by_load[component]
                .clone()
                .cholesky()
                .map(|factor| self.with_bias[component].dot(&factor.solve(&self.with_bias[component])) / 4.0);
            let most = self.unloaded[component].powi(2);
            let share = match explained {
                Some(explained) if explained <= most => 1.0,
                Some(explained) => (most / explained).sqrt(),
                None => 0.0,
            };
            self.with_bias[component] *= share;
        }
        self
    }

    /// Every number in it.
    pub fn numbers(&self) -> impl Iterator<Item = &f64> {
        let by_load = self.by_load.iter().flat_map(|matrix| matrix.iter());
        by_load.chain(self.with_bias.iter().flat_map(|vector| vector.iter())).chain(&self.unloaded)
    }

    /// Whether no wrench has a negative variance: whether [Eᵢ, gᵢ/2; gᵢᵀ/2, zᵢ²] is symmetric and positive semidefinite for every
    /// component. Brought to a diagonal of ones first: newton and newton metre are of different size.
    pub fn is_possible(&self) -> bool {
        let whole = |component: usize| {
            let (matrix, mixed) = (&self.by_load[component], &self.with_bias[component]);
            let size = matrix.nrows();
            DMatrix::from_fn(size + 1, size + 1, |a, b| match (a == size, b == size) {
                (false, false) => matrix[(a, b)],
                (true, false) => mixed[b] / 2.0,
                (false, true) => mixed[a] / 2.0,
                (true, true) => self.unloaded[component].powi(2),
            })
        };
        (0..self.unloaded.len()).map(whole).all(|covariance| is_covariance(&covariance))
            && self.unloaded.iter().all(|&deviation| deviation >= 0.0)
    }
}

fn is_covariance(matrix: &DMatrix<f64>) -> bool {
    let scale = matrix.diagonal().map(|variance| if variance > 0.0 { variance.sqrt().recip() } else { 1.0 });
    let scaled =
        DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |a, b| matrix[(a, b)] * scale[a] * scale[b]);
    let symmetric = (&scaled - scaled.transpose()).amax() <= ROUNDING;
    symmetric && scaled.symmetric_eigenvalues().min() >= -ROUNDING * matrix.nrows() as f64
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;
    use nalgebra::{DMatrix, DVector};

    use super::WrenchUncertainty;
    use crate::calibration::known_load::{KnownLoad, LoadCase, average};
    use crate::calibration::synthetic::{Sensor, spatial, sphere};
    use crate::calibration::trial::{Gating, solve};
    use crate::calibration::{SolvedTrial, calibrate};
    use crate::gravity::Gravity;
    use crate::session_file::STANDARD_GRAVITY;

    /// A trial whose load has been above `lowest` only, with known loads that leave its orientation in no doubt.
    fn cap(sensor: &mut Sensor, lowest: f64) -> SolvedTrial {
        let motion: Vec<DVector<f64>> =
            sphere(4000).into_iter().filter(|direction| direction[2] > lowest).collect();
        let recording = sensor.record(1.0, &[], &motion);
        let known =
            [spatial(0.0, 0.0, 1.0), spatial(1.0, 0.0, 0.0), spatial(0.0, 1.0, 0.0)].map(|direction| {
                let rest = sensor.record(1.0, &[], &vec![direction.clone(); 2000]);
                KnownLoad {
                    direction,
                    accuracy_rad: 1e-5,
                    rest: average(&rest).expect("nothing is saturated"),
                }
            });
        let case = LoadCase {
            name: "cap.csv".to_owned(),
            mass_kg: 1.0,
            arm_m: DVector::zeros(0),
            arm_accuracy_m: 1e-6,
            mass_accuracy_kg: 1e-6,
            known_loads: known.to_vec(),
        };
        let shape = solve(&recording, 3, Gating::Off).expect("the motion spans");
        SolvedTrial { case, shape, turned: None }
    }

    #[test]
    fn a_load_that_was_on_one_side_only_leaves_wrenches_on_the_other_less_certain() {
        let sensors = 60;
        for lowest in [-1.0, -0.3, 0.0] {
            // Loads at the pole that the motion has covered, at the opposite one, and none.
            let poles =
                [STANDARD_GRAVITY, -STANDARD_GRAVITY, 0.0].map(|z| DVector::from_vec(vec![0.0, 0.0, z]));
            let (mut squares, mut stated) = ([0.0; 3], [0.0; 3]);
            for seed in 0..sensors {
                let mut sensor = Sensor::new(Dof::SpatialForce, 6, 300 + seed);
                sensor.noise_counts *= 3.0;
                let trial = cap(&mut sensor, lowest);
                let gravity = Gravity { magnitude: STANDARD_GRAVITY, accuracy: 0.0 };
                let calibration = calibrate(sensor.dof, gravity, &[trial]).expect("the evidence is good");
                let uncertainty = calibration.uncertainty.clone().and_then(|uncertainty| uncertainty.wrench);
                let uncertainty = uncertainty.expect("the joint solution tells it");
                assert!(uncertainty.is_possible());
                for (pole, load) in poles.iter().enumerate() {
                    let codes = &sensor.bias_counts + sensor.shape.transpose() * load;
                    let deviation = uncertainty.of(load)[2];
                    squares[pole] += ((calibration.wrench(&codes)[2] - load[2]) / deviation).powi(2);
                    stated[pole] += deviation / f64::from(u32::try_from(sensors).expect("sixty"));
                }
            }
            for (pole, sum) in squares.iter().enumerate() {
                // Sixty errors: their root mean square is known within 9 %, three times that.
                let ratio = (sum / sensors as f64).sqrt();
                assert!((0.73..1.27).contains(&ratio), "above {lowest}, pole {pole}: {ratio}");
            }
            if lowest > -1.0 {
                assert!(2.0 * stated[0] < stated[1], "above {lowest}: {stated:?}");
            }
        }
    }

    #[test]
    fn what_no_covariance_can_be_is_told_from_what_one_can() {
        let possible = WrenchUncertainty {
            by_load: vec![DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 2.0]); 2],
            with_bias: vec![DVector::from_vec(vec![1.0, -1.0]); 2],
            unloaded: DVector::from_element(2, 1.0),
        };
        assert!(possible.is_possible());
        let mut changed = possible.clone();
        changed.unloaded[1] = -1.0;
        assert!(!changed.is_possible());
        let mut changed = possible.clone();
        changed.by_load[1][(0, 1)] = 1.1;
        assert!(!changed.is_possible(), "not symmetric");
        let mut changed = possible.clone();
        changed.by_load[0] = -changed.by_load[0].clone();
        assert!(!changed.is_possible());
        let mut changed = possible;
        changed.with_bias[0] *= 10.0;
        assert!(!changed.is_possible(), "more in common than both have");
        assert!(changed.bounded().is_possible());
    }
}
