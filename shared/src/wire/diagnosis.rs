//! Why the sensor started last, and how much room it has left: what its maker asks first.

use serde::{Deserialize, Serialize};

/// The most characters of a file's name that are kept, the last ones.
pub const MAX_FILE_NAME: usize = 40;

/// What the board knows of itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Diagnosis {
    /// What the last reset came from.
    pub reset: ResetCause,
    /// The failure of the firmware that the last reset ended, if it was one.
    pub failure: Option<Failure>,
    /// The most bytes of the stack that have been in use since the reset.
    pub stack_used_bytes: u32,
    /// Bytes of the stack.
    pub stack_bytes: u32,
}

/// What a reset came from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetCause {
    /// The processor does not say: in the emulator, or in the simulator.
    #[default]
    Unknown,
    /// Power came.
    PowerOn,
    /// The supply fell too low.
    BrownOut,
    /// The reset pin.
    Pin,
    /// A task had not run for too long.
    Watchdog,
    /// The firmware itself: after a failure, or because it was told to.
    Software,
}

/// What made the firmware give up.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Failure {
    /// A panic.
    Panic {
        /// The end of the file's name.
        file: heapless::String<MAX_FILE_NAME>,
        /// The line in it.
        line: u32,
    },
    /// A fault of the processor: a bus, a memory or a usage fault.
    ProcessorFault {
        /// Address of the instruction.
        at: u32,
    },
    /// The stack had no more room.
    StackOverflow,
    /// An interrupt came that nobody serves.
    UnservedInterrupt {
        /// Its number; negative for exceptions of the processor.
        number: i16,
    },
}

impl Failure {
    /// A panic at this place.
    pub fn panic(file: &str, line: u32) -> Self {
        let mut first = file.len().saturating_sub(MAX_FILE_NAME);
        while !file.is_char_boundary(first) {
            first += 1;
        }
        let end = file.get(first..).unwrap_or_default();
        Self::Panic { file: heapless::String::try_from(end).unwrap_or_default(), line }
    }
}
