//! Health, from the gage to the frame.

mod faults;
mod gages;
mod load;
mod rig;
mod self_test;

/// Within this time a fault is flagged.
const FLAGGED_MICROS: u64 = 10_000;
