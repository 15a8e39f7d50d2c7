//! The degrees of freedom a sensor can have (paper, section 3), and their axes.

use serde::{Deserialize, Serialize};

/// One component of a wrench, in the sensor frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Axis {
    /// Force along x, newton.
    ForceX,
    /// Force along y, newton.
    ForceY,
    /// Force along z, newton.
    ForceZ,
    /// Torque about x, newton metre.
    TorqueX,
    /// Torque about y, newton metre.
    TorqueY,
    /// Torque about z, newton metre.
    TorqueZ,
}

/// Which components of the wrench a sensor measures: the four systems of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Dof {
    /// Two forces in a plane: the fingertip (paper, figure 3).
    PlanarForce,
    /// Three forces (paper, "3-DOF Force Sensor").
    SpatialForce,
    /// Two forces and the torque about their plane's normal (paper, eq. 14).
    PlanarForceTorque,
    /// Three forces and three torques (paper, eq. 19).
    SpatialForceTorque,
}

impl Dof {
    /// The components in the order of the calibration matrix's rows.
    pub const fn axes(self) -> &'static [Axis] {
        match self {
            Self::PlanarForce => &[Axis::ForceX, Axis::ForceY],
            Self::SpatialForce => &[Axis::ForceX, Axis::ForceY, Axis::ForceZ],
            Self::PlanarForceTorque => &[Axis::ForceX, Axis::ForceY, Axis::TorqueZ],
            Self::SpatialForceTorque => {
                &[Axis::ForceX, Axis::ForceY, Axis::ForceZ, Axis::TorqueX, Axis::TorqueY, Axis::TorqueZ]
            }
        }
    }

    /// The number of components, m.
    pub const fn count(self) -> usize {
        self.axes().len()
    }

    /// The proper rank r of one trial: a load at one constant moment arm spans only its force directions (eq. 15).
    pub const fn trial_rank(self) -> usize {
        match self {
            Self::PlanarForce | Self::PlanarForceTorque => 2,
            Self::SpatialForce | Self::SpatialForceTorque => 3,
        }
    }

    /// Whether the sensor measures torque, so that the moment arm matters.
    pub const fn has_torque(self) -> bool {
        matches!(self, Self::PlanarForceTorque | Self::SpatialForceTorque)
    }
}
