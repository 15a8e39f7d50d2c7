//! Quantities that must not be confused with bare numbers.
//!
//! Scalars with one obvious unit carry it in their name instead (`mass_kg`, `force_newton`, `noise_counts`).

mod code;
mod converter;
mod decimation;
mod dof;
mod rank;
mod time;

pub use code::AdcCode;
pub use converter::{DataRate, Gain};
pub use decimation::Decimation;
pub use dof::{Axis, Dof};
pub use rank::{MAX_RANK, Rank};
pub use time::{DeviceTime, SampleIndex};

/// The most gage channels that one sensor may have.
pub const MAX_GAGES: usize = 12;

/// The most degrees of freedom that one sensor may have: three forces and three torques.
pub const MAX_DOF: usize = 6;
