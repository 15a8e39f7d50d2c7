//! The host's end of the link to a sensor.
//!
//! | module | holds |
//! |---|---|
//! | [`transport`] | what a line is: bytes out, bytes in, a clock |
//! | [`serial`] | a serial port or pseudo-terminal as a line |
//! | [`client`] | what a sensor can be asked |
//! | `conversation` | requests with their responses, whatever is lost, and the stream between them |
//! | [`frame`] | samples as the host sees them: a wrench that is not there cannot be read as a number |
//! | `continuity` | what is missing between samples |
//! | [`error`] | what can go wrong, the link's troubles apart from the sensor's own |
//! | [`words`] | what a sensor reports, in words |
//! | [`health_words`] | the same of its health: status word, tare, self-test |
//! | [`field_words`] | the same of calibrations in the field |
//! | [`remedy`] | what to do about each error |

pub mod client;
mod continuity;
mod conversation;
pub mod error;
pub mod field_words;
pub mod frame;
pub mod health_words;
pub mod remedy;
pub mod serial;
mod tally;
pub mod transport;
pub mod words;
