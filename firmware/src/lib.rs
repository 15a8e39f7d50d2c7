//! The sensor's application: portable, runtime-free and hardware-free.
//!
//! ```text
//!            data ready                                    bytes from the host
//!                │                                                │
//!        [`acquisition`] ─readings──► [`sensor`] ◄── request ── [`session`]
//!          [`adc`] driver  ▲ [`trial`], calibration, [`health`]   │
//!                │    [`handover`]  [`decimator`]                  │
//!                │                        │                       │
//!           any SPI bus                 moments                responses
//!                                          │                       │
//!                                     [`stream`] ──── frames ────► line
//! ```
//!
//! The board, the in-process simulator and the tests feed the same code; what differs is who calls it:
//!
//! | call | when | on the board |
//! |---|---|---|
//! | [`acquisition::Acquisition::on_data_ready`] | the converter announces a conversion | data-ready interrupt |
//! | [`acquisition::Acquisition::tick`] | every few milliseconds | timer |
//! | [`sensor::Sensor::take_in`] | a conversion was read | below those |
//! | [`sensor::Sensor::tick`] | every few milliseconds | below those |
//! | [`session::Session::on_byte`] | a byte came from the host | below the sample path |
//! | [`sensor::Sensor::answer`] | a request is complete | below the sample path |
//! | [`session::Session::watch`] | every few milliseconds | below the sample path |
//! | [`stream::Batcher`] | samples wait for the line | below the sample path |
//! | [`trial::SolveJob::solve`] | a trial is to be solved | lowest priority, in the background |
//! | [`sensor::Sensor::attend_panel`] | every few milliseconds | below those |
//! | [`sensor::Sensor::housekeeping`] | nothing else is to be done | lowest priority, in the background |
//! | [`field::FieldTask::run`] | a calibration in the field has something to compute or to store | lowest priority, in the background |
//! | [`storage::keeper::Keeper::run`] | something is to be stored | lowest priority, in the background |
#![no_std]

pub mod acquisition;
pub mod adc;
pub mod baud;
pub mod black_box;
pub mod decimator;
pub mod field;
pub mod handover;
pub mod health;
pub mod long_count;
pub mod polled;
pub mod sensor;
pub mod session;
pub mod storage;
pub mod stream;
pub mod trial;
pub mod tunnel;
pub mod vitality;
