//! Emulated boards that live through something: cuts of their power, failures of their own, a calibration in the field, a long time. Several
//! at once, for they wait most of it.
#![cfg(unix)]

mod failures;
mod field;
mod power_cuts;
mod soak;
