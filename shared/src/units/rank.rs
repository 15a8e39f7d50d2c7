//! The rank of a trial.

use core::ops::Range;

/// The largest rank that a trial can have.
pub const MAX_RANK: usize = 3;

/// The proper rank r of one trial: a load at one constant moment arm spans only its force directions (eq. 15).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rank {
    /// The load turns in a plane: r = 2.
    Planar,
    /// The load turns in space: r = 3.
    Spatial,
}

impl Rank {
    /// The rank of so many directions; no other than 2 and 3 is any trial's.
    pub const fn new(directions: usize) -> Option<Self> {
        match directions {
            2 => Some(Self::Planar),
            3 => Some(Self::Spatial),
            _ => None,
        }
    }

    /// r.
    pub const fn count(self) -> usize {
        match self {
            Self::Planar => 2,
            Self::Spatial => 3,
        }
    }

    /// The axes of the motion, counted from zero.
    pub const fn axes(self) -> Range<usize> {
        0..self.count()
    }
}
