//! What survives a reset: calibrations, settings, name and counters, and the sums of a trial, in the flash that the processor has.
//!
//! # The promise
//!
//! Whenever the power fails, in the middle of a write or of an erase, the sensor comes up with what was valid before or with what
//! was to replace it: never with neither, and never with a mixture. It never makes up a calibration: where none is found
//! that is whole, the sensor is uncalibrated, says why, and streams raw codes.
//!
//! # How
//!
//! | layer | what it does against what |
//! |---|---|
//! | `pages` | an erase that was cut short is finished before anything is read |
//! | `sequential-storage` | a map that only ever appends; a torn item is skipped, the one before it is found |
//! | `record` | format number and checksum of each item; each is read back after it was written |
//! | [`checkpoint`] | the sums of a trial have sectors of their own; the newest record that is whole counts |
//! | [`memory`] | a new calibration is written to a place of its own, then one word of the roster makes it the current one |
//!
//! Two calibrations are kept, the current one and the one before it; [`memory::Memory::roll_back`] swaps them. There are
//! three places for them, so that a new one is complete before an old one goes. The roster, which says which is which, is there
//! twice; and it knows each calibration by its identity, the checksum of its numbers, so that what another roster meant is
//! not taken for it.
//!
//! # Time
//!
//! The processor executes from this very flash and stands still while it is being written: 16 µs a word, about 2 ms for a
//! calibration. It stands still for one or two seconds while a sector is being erased, which is due once in some
//! 250 stores. So nothing is stored while samples are streamed or a trial runs; see [`job`].

pub mod checkpoint;
pub mod items;
pub mod job;
pub mod keeper;
pub mod layout;
pub mod memory;
mod pages;
mod record;
mod words;

#[cfg(test)]
mod mock;
#[cfg(test)]
mod tests;

pub use record::Missing;
