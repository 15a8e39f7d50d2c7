//! The host side of ftcal, as a library: everything that the `ftcal` command does.

pub mod calibration;
pub mod calibration_file;
pub mod cli;
pub mod commands;
pub mod component;
pub mod demo;
pub mod flash;
pub mod gain;
pub mod gravity;
pub mod link;
pub mod logs;
pub mod place;
pub mod plots;
pub mod recording;
pub mod remedy;
pub mod session_file;
pub mod simulator;
