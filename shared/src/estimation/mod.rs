//! Shape from motion, one step of the paper a file.
//!
//! ```text
//! codes ──► moments ──► basis ──► projection ──► metric ──► shape ──► calibration ──► application
//!           ZᵀZ and     eq. 7–9   moments in     eq. 13     eq. 11    eq. 5           eq. 1
//!           beyond                r dimensions              S, b      C = [Sᵀ]⁺       C(z − b)
//! ```
//!
//! | module | step | source |
//! |---|---|---|
//! | [`gate`] | which samples are measurements, and how quiet the load was | design § 5 |
//! | [`moments`], [`code_sums`] | one pass over the codes: exact sums, Gram matrix, sums of degree 3 and 4 | design § 2 |
//! | [`rest_noise`] | the noise of the channels, while the load hangs still | design § 3.1 |
//! | [`basis`] | the p×p eigenproblem in place of the SVD of Z; noise from the redundant eigenvalues | eq. 7–9, design § 3.1 |
//! | [`projection`], [`motion_moments`] | the moments in the r coordinates of the basis | design § 3.2 |
//! | [`coordinates`] | vectors, matrices and tensors in these coordinates, r being known at run time | |
//! | [`metric`] | the constraint |m| = 1, with free centre | eq. 13, design § 3.3 |
//! | [`shape`] | shape and bias of one trial | eq. 10, 11, design § 3.4 |
//! | [`bins`] | sums by quietness, and how much of them to solve from | design § 5 |
//! | [`expectation`] | what a trial that was solved once expects of its samples | design § 5, § 8 |
//! | [`directions`] | where the load has been | |
//! | [`uncertainty`] | how well shape and bias are known | design § 4 |
//! | [`coverage`] | what is still to be seen, and which way to turn the load for it | design § 4 |
//! | [`calibration`] | calibration matrix of a shape | eq. 5 |
//! | [`reorientation`] | a new trial in the frame of the calibration that there is | design § 8 |
//! | [`application`] | raw codes to wrench, in real time | eq. 1 |
//! | [`parity`] | whether the gages agree, which one does not, and the wrench without it | design § 8 |
//!
//! A model throughout: `z = b + Sᵀ m + e` with codes z and bias b (p counts), shape S (r × p, counts per unit load) and
//! a load direction m with |m| = 1.

pub mod application;
pub mod basis;
pub mod bins;
pub mod calibration;
pub mod code_sums;
pub mod coordinates;
pub mod coverage;
pub mod directions;
mod eigen;
pub mod expectation;
pub mod gate;
pub mod metric;
pub mod moments;
mod monomials;
pub mod motion_moments;
pub mod parity;
pub mod projection;
mod quadric;
pub mod reorientation;
pub mod rest_noise;
pub mod shape;
mod square;
pub mod uncertainty;
mod words;
