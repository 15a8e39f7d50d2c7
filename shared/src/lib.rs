//! What the sensor and the host have in common: units, the wire protocol, and the estimator.
//!
//! Everything here is `no_std`, allocates nothing and knows no hardware, so that the very same functions run on the
//! sensor's microcontroller, in the in-process simulator, on the host and in the tests.
//!
//! | module | holds | may import |
//! |---|---|---|
//! | [`units`] | raw codes, degrees of freedom, time, data rates | nothing |
//! | [`refusal`] | why an estimate is refused, one cause each | [`units`] |
//! | [`fault`] | what can be wrong with the converter | nothing |
//! | [`wire`] | the versioned serial protocol | [`units`], [`refusal`] |
//! | [`estimation`] | shape from motion, step by step | [`units`], [`refusal`] |
#![no_std]

pub mod estimation;
pub mod fault;
pub mod refusal;
pub mod units;
pub mod wire;
