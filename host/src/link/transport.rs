//! What the client needs of a line to the sensor: bytes out, bytes in, and a clock to give up by.
//!
//! The clock belongs to the line because the simulated board lives in virtual time: there a deadline of ten seconds
//! passes in milliseconds, and the same call always gives the same bytes.

use std::io;
use std::time::Duration;

use thiserror::Error;

/// A line to a sensor.
pub trait Transport {
    /// Sends all of these bytes.
    ///
    /// # Errors
    ///
    /// [`TransportError`]; some of the bytes may have been sent.
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError>;

    /// Appends to `received` what has come at one time, and answers when that was; what came later is left for the next read.
    /// Where nothing has come yet, waits for it until the clock says `deadline`, and then returns with nothing appended.
    ///
    /// # Errors
    ///
    /// [`TransportError`]; bytes that came before the error are delivered first.
    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<Duration, TransportError>;

    /// Time on this line's own clock, which never goes backwards.
    fn elapsed(&self) -> Duration;

    /// Changes the baud rate of this end. A line that has none, as a pseudo-terminal has not, carries all.
    ///
    /// # Errors
    ///
    /// [`TransportError::NoSuchRate`]; the rate is then as it was.
    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError>;
}

/// Why a line carries nothing any more.
#[derive(Debug, Error)]
pub enum TransportError {
    /// The other end is gone: unplugged, or the simulator was closed.
    #[error("the port has vanished")]
    Vanished,
    /// The other end takes no bytes.
    #[error("the port does not take the bytes that are to be sent")]
    Stalled,
    /// The port cannot be set to a baud rate.
    #[error("the port cannot be set to {baud} baud")]
    NoSuchRate {
        /// The rate.
        baud: u32,
    },
    /// The operating system reports something else.
    #[error("the port failed")]
    Failed(#[source] io::Error),
}

impl<T: Transport + ?Sized> Transport for Box<T> {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        (**self).write(bytes)
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<Duration, TransportError> {
        (**self).read(received, deadline)
    }

    fn elapsed(&self) -> Duration {
        (**self).elapsed()
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
        (**self).set_baud(baud)
    }
}
