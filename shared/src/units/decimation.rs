//! How many conversions make one sample of the stream.

use serde::{Deserialize, Serialize};

/// One wrench is streamed for this many conversions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Decimation {
    /// The converter's own rate, unfiltered.
    #[default]
    By1,
    /// Half of it.
    By2,
    /// A quarter of it.
    By4,
    /// An eighth of it.
    By8,
    /// A sixteenth of it.
    By16,
    /// A 32nd of it.
    By32,
    /// A 64th of it.
    By64,
    /// A 128th of it: 250 samples/s of 32 000 conversions/s.
    By128,
}

impl Decimation {
    /// Every decimation, the least first.
    pub const ALL: [Self; 8] =
        [Self::By1, Self::By2, Self::By4, Self::By8, Self::By16, Self::By32, Self::By64, Self::By128];

    /// Conversions a sample.
    pub const fn factor(self) -> u8 {
        1 << self as u8
    }

    /// The decimation by this factor, or `None` where there is none.
    pub fn from_factor(factor: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|decimation| u32::from(decimation.factor()) == factor)
    }
}
