//! How certain one wrench is: the error of the calibration itself, which stays the same from sample to sample. The noise of a
//! sample comes on top of it, and shows by how much the wrenches of a load at rest scatter.
//!
//! A wrench is wrong by −C δA w + C δb ([`super::joint::uncertainty`]), so that the variance of its component i is a quadratic form of the
//! wrench, and that of the bias: σᵢ² = wᵀ Eᵢ w + zᵢ².

use nalgebra::{DMatrix, DVector};

/// The variance of each component of a wrench, as it follows the wrench.
#[derive(Clone, Debug, PartialEq)]
pub struct WrenchUncertainty {
    /// Eᵢ of each component (m of m × m), in the units of σᵢ² over those of the components that it is multiplied with.
    pub by_load: Vec<DMatrix<f64>>,
    /// zᵢ, of the unloaded sensor (m), newton and newton metre.
    pub unloaded: DVector<f64>,
}

impl WrenchUncertainty {
    /// Standard deviation of each component of this wrench (m), newton and newton metre; `wrench` (m) in the same.
    pub fn of(&self, wrench: &DVector<f64>) -> DVector<f64> {
        DVector::from_fn(self.unloaded.len(), |component, _| {
            let of_load = wrench.dot(&(&self.by_load[component] * wrench));
            (of_load.max(0.0) + self.unloaded[component].powi(2)).sqrt()
        })
    }

    /// The mean of the variances (m) over loads of which `mean_square` (m × m) is ⟨wwᵀ⟩.
    pub fn mean_variance(&self, mean_square: &DMatrix<f64>) -> DVector<f64> {
        DVector::from_fn(self.unloaded.len(), |component, _| {
            let of_loads = self.by_load[component].component_mul(mean_square).sum();
            of_loads.max(0.0) + self.unloaded[component].powi(2)
        })
    }
}
