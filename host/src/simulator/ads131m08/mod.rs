//! A software model of the ADS131M08 at the level of its SPI bytes.
//!
//! The Texas Instruments ADS131M08 converts eight channels at once to signed 24-bit codes (datasheet SBAS950B). The
//! model answers chip-select frames byte by byte as the part does, so that a driver cannot tell the two apart by what
//! this list names:
//!
//! | what | where | datasheet |
//! |---|---|---|
//! | registers, their reset values, which bits can be written | `registers` | section 8.6 |
//! | words, commands, the layout of frames | `frame` | sections 8.5.1.7 and 8.5.1.10 |
//! | checksums in both directions | `checksum` | section 8.3.12 |
//! | input selection, gain, clipping, offset and gain correction | `input` | sections 8.3.2, 8.3.3, 8.3.9, 8.3.11 |
//! | the two-deep buffer of results | `buffer` | section 8.5.1.9.1 |
//! | the reply one frame late, lock, standby, reset, status | `model` | sections 8.4, 8.5 |
//!
//! It was written from the datasheet alone. It shares no code with the driver that it is there to check: what both get
//! right, they get right independently.
//!
//! Left out, because nothing here depends on it: word lengths other than the default 24 bits, the digital filter with
//! its settling, phase delays, global chopping, current detection, the DC block filter, the register-map checksum
//! (its register reads zero and its fault flag stays clear), and the SYNC/RESET pin.

mod buffer;
mod checksum;
mod frame;
mod input;
mod model;
mod registers;

pub use input::REFERENCE_VOLTS;
pub use model::Ads131m08Model;

/// The number of input channels.
pub const CHANNELS: usize = 8;
