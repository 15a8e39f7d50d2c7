//! What can be wrong with the converter, one cause each, as the sensor reports it.

use serde::{Deserialize, Serialize};

/// A fault of the analog-to-digital converter or of the bus to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AdcFault {
    /// The bus itself reported an error.
    Bus,
    /// No converter answered: every byte read was the same, all zeros or all ones.
    NotResponding,
    /// A device answered, but it is not an ADS131M08.
    WrongIdentity {
        /// The ID register as read.
        id: u16,
    },
    /// The converter did not acknowledge its reset.
    ResetNotAcknowledged,
    /// A register read back differs from what was written.
    RegisterMismatch {
        /// Address of the register.
        address: u8,
    },
    /// The reply's checksum is wrong.
    ReplyCorrupted,
    /// The converter reported that a command reached it with a wrong checksum.
    CommandCorrupted,
    /// The converter acknowledged something else than what was sent.
    UnexpectedReply,
    /// The converter was reset without being asked to: its settings are lost.
    UnexpectedReset,
    /// A conversion was announced, but what was read is not marked as new.
    StaleConversion,
    /// No conversion was announced for several conversion periods.
    DataReadyLost,
}
