//! What a conversation with a sensor has counted.

/// Counts since the conversation began.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    /// Samples that are missing between those that were taken, since the stream was started last.
    pub(super) lost_samples: u64,
    /// Samples that came and were dropped because nobody took them in time.
    pub(super) dropped_samples: u64,
    pub(super) received_bytes: u64,
    /// Frames that came broken.
    pub(super) broken_frames: u64,
    /// How often no answer came in time, and the question was asked again or given up.
    pub(super) repetitions: u64,
}
