//! The serial protocol between sensor and host.
//!
//! ```text
//! message ──postcard──► payload ──CRC-32──► payload ‖ crc ──COBS──► bytes without zero ──► … ‖ 0x00
//! ```
//!
//! A frame ends with a zero byte and holds no other, so a receiver that has lost its place finds it again at the next
//! frame. Wrenches travel in runs ([`WrenchFrame`]). postcard is positional: the meaning of a byte depends on the version
//! of the protocol, which [`Hello`] tells.
//!
//! **Compatibility.** The bytes of [`ToDevice::Hello`] and of [`ToHost::Hello`] never change. Every other message may change
//! with [`PROTOCOL_VERSION`]; a host speaks only to a device of its own version, and says so otherwise. Variants are
//! numbered by their position: new ones go to the end.

mod diagnosis;
mod field;
pub mod frame;
pub mod health;
mod health_message;
mod memory;
mod message;
mod report;
mod wrench;

pub use diagnosis::{Diagnosis, Failure, MAX_FILE_NAME, ResetCause};
pub use field::{
    CalibrationOrigin, FieldComparison, FieldOutcome, FieldPhase, FieldRefusal, FieldReport, Renewed,
};
pub use health_message::{
    Found, HealthReport, HealthRequest, HealthResponse, LoadLimits, LoadThreshold, MAX_OUTCOMES,
    ParityReport, PlayedFault, SelfTestOutcome, SelfTestPhase, SelfTestReport, TarePhase, TareRefusal,
    TareReport,
};
pub use memory::{Identity, KeptCalibration, KeptCalibrations, LONGEST_NAME, MemoryRequest, SensorName};
pub use message::{
    CalibrationUpload, GageList, Hello, PRODUCT, PROTOCOL_VERSION, Rejection, Request, RequestId, Response,
    StreamKind, ToDevice, ToHost,
};
pub use report::{
    AdcState, ClockSource, CodesFrame, Coverage, GageTarget, InvalidCause, Output, Resumption, Solution,
    Status, TrialPhase, TrialStatus,
};
pub use wrench::{MAX_RUN, PackedWrenches, Run, WrenchFrame};
