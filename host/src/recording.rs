//! A recording: the raw codes of every gage over time, in memory and as a CSV file.
//!
//! # The file
//!
//! ```text
//! # any number of comment lines, anywhere
//! # converter gain: 128
//! t_s,ch0,ch1,…,ch{p-1}
//! 0.000,-1203,88121,…
//! ```
//!
//! Two to twelve gages; the codes are integers or decimals, in counts. The gain that they are counts at stands in a line that
//! other programs take for a comment; a recording without it is of an unknown gain. The [`parse`] module reads the file, the
//! [`writer`] module writes it.
//!
//! # Codes
//!
//! The estimator takes 24-bit codes and nothing else. Integer recordings within 24 bits pass through unchanged; all
//! others are re-quantised to 24 bits as [`quantisation`] says, and what is estimated from the codes is scaled back to
//! the recording's own counts. Everything outside this module is in counts of the recording.

pub mod parse;
pub mod quantisation;
pub mod writer;

use std::path::Path;

use ftcal_shared::units::{AdcCode, Gain};
use nalgebra::DVector;

use self::quantisation::Quantisation;

pub use self::parse::RecordingError;

/// The fewest gages a recording may have: fewer than two cannot tell any two directions apart.
pub const MIN_GAGES: usize = 2;

/// The raw codes of every gage over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    gages: usize,
    gain: Option<Gain>,
    times_s: Vec<f64>,
    /// One row of `gages` codes a sample.
    codes: Vec<AdcCode>,
    quantisation: Quantisation,
}

/// Why a part of a recording cannot be cut out.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum WindowError {
    /// No sample lies in the window.
    #[error("no sample between {from_s} s and {to_s} s: the recording runs from {first_s} s to {last_s} s")]
    Empty {
        /// Start of the window asked for, seconds.
        from_s: f64,
        /// End of the window asked for, seconds.
        to_s: f64,
        /// Time of the first sample, seconds.
        first_s: f64,
        /// Time of the last sample, seconds.
        last_s: f64,
    },
    /// Time goes backwards, so that a span of time may stand for several parts of the recording.
    #[error("time goes backwards at sample {sample}, so a window of the recording is not one stretch of it")]
    TimeGoesBackwards {
        /// Number of the first sample that is earlier than the one before it, counted from one.
        sample: usize,
    },
}

impl Recording {
    /// Reads a CSV file.
    ///
    /// # Errors
    ///
    /// [`RecordingError`], which names file, line, column, what was expected and what stood there.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        parse::read(path)
    }

    /// A recording of codes as the converter delivered them, at a gain that is not known: one time and one row of `gages` codes a
    /// sample.
    ///
    /// Trailing codes that fill no row, and times without a row, are left out.
    pub fn from_codes(gages: usize, times_s: Vec<f64>, codes: Vec<AdcCode>) -> Self {
        Self::assemble(gages, times_s, codes, Quantisation::exact(gages))
    }

    /// A recording of counts that may be decimals or wider than 24 bits, at a gain that is not known: one time and one row of
    /// `gages` values each.
    pub fn from_counts(gages: usize, times_s: Vec<f64>, counts: &[f64]) -> Self {
        let quantisation = Quantisation::of(gages, counts);
        let codes = quantisation.quantise(counts);
        Self::assemble(gages, times_s, codes, quantisation)
    }

    fn assemble(
        gages: usize,
        mut times_s: Vec<f64>,
        mut codes: Vec<AdcCode>,
        quantisation: Quantisation,
    ) -> Self {
        let samples = times_s.len().min(codes.len().checked_div(gages).unwrap_or(0));
        times_s.truncate(samples);
        codes.truncate(samples * gages);
        Self { gages, gain: None, times_s, codes, quantisation }
    }

    /// The same codes, known to be of this gain.
    #[must_use]
    pub fn at_gain(self, gain: Option<Gain>) -> Self {
        Self { gain, ..self }
    }

    /// The gain of the converter that the codes are counts at; `None` where nobody says.
    pub const fn gain(&self) -> Option<Gain> {
        self.gain
    }

    /// The number of gages, p.
    pub const fn gages(&self) -> usize {
        self.gages
    }

    /// The number of samples.
    pub const fn len(&self) -> usize {
        self.times_s.len()
    }

    /// Whether there is no sample.
    pub const fn is_empty(&self) -> bool {
        self.times_s.is_empty()
    }

    /// How codes and counts of this recording belong together.
    pub const fn quantisation(&self) -> &Quantisation {
        &self.quantisation
    }

    /// Every sample: its time in seconds and its p codes.
    pub fn samples(&self) -> impl Iterator<Item = (f64, &[AdcCode])> {
        self.times_s.iter().copied().zip(self.codes.chunks_exact(self.gages.max(1)))
    }

    /// The samples that are measurements: those with no code at an end of the converter's range.
    pub fn unsaturated(&self) -> impl Iterator<Item = (f64, &[AdcCode])> {
        self.samples().filter(|(_, codes)| !AdcCode::any_is_saturated(codes))
    }

    /// The p codes of one sample in counts of the recording.
    pub fn counts(&self, codes: &[AdcCode]) -> DVector<f64> {
        self.quantisation.counts(codes)
    }

    /// The number of the first sample (counted from one) that is earlier than the one before it: recordings put
    /// together from several pieces have one. A trial does not mind, a window of time does.
    pub fn time_goes_backwards_at(&self) -> Option<usize> {
        self.times_s
            .windows(2)
            .position(|pair| matches!(pair, [before, after] if after < before))
            .map(|i| i + 2)
    }

    /// The samples from `from_s` to `to_s` seconds, both included.
    ///
    /// # Errors
    ///
    /// [`WindowError`] where that is nothing, or not one stretch.
    pub fn window(&self, from_s: f64, to_s: f64) -> Result<Self, WindowError> {
        if let Some(sample) = self.time_goes_backwards_at() {
            return Err(WindowError::TimeGoesBackwards { sample });
        }
        let start = self.times_s.partition_point(|&time| time < from_s);
        let end = self.times_s.partition_point(|&time| time <= to_s).max(start);
        let times_s = self.times_s.get(start..end).unwrap_or_default().to_vec();
        if times_s.is_empty() {
            return Err(WindowError::Empty {
                from_s,
                to_s,
                first_s: self.times_s.first().copied().unwrap_or_default(),
                last_s: self.times_s.last().copied().unwrap_or_default(),
            });
        }
        let codes = self.codes.get(start * self.gages..end * self.gages).unwrap_or_default().to_vec();
        Ok(Self {
            gages: self.gages,
            gain: self.gain,
            times_s,
            codes,
            quantisation: self.quantisation.clone(),
        })
    }
}

/// A file, for the words of an error.
pub(crate) fn shown(path: &Path) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{AdcCode, Gain};

    use super::{Recording, WindowError};

    fn ramp(samples: usize) -> Recording {
        let times = (0..samples).map(|i| i as f64 * 0.1).collect();
        let codes = (0..).take(samples).flat_map(|i: i64| [i, -i].map(AdcCode::saturating)).collect();
        Recording::from_codes(2, times, codes).at_gain(Some(Gain::X32))
    }

    #[test]
    fn a_window_holds_the_samples_of_its_span_and_no_others() {
        let recording = ramp(100);
        for (from, to) in [(0.0, 9.9), (1.05, 1.05 + 3.0), (5.0, 5.0), (-3.0, 0.0), (9.9, 1e9)] {
            let window = recording.window(from, to).expect("the window holds samples");
            assert_eq!(window.gain(), recording.gain());
            let inside = recording.samples().filter(|(time, _)| (from..=to).contains(time));
            assert!(window.samples().eq(inside));
        }
    }

    #[test]
    fn a_window_without_samples_says_how_far_the_recording_runs() {
        for (from, to) in [(10.0, 11.0), (0.01, 0.09), (-2.0, -1.0), (5.0, 4.0)] {
            let error = ramp(100).window(from, to).expect_err("no sample lies there");
            assert!(matches!(error, WindowError::Empty { .. }), "{error}");
        }
    }

    #[test]
    fn a_window_is_refused_where_time_goes_backwards() {
        let codes = vec![AdcCode::ZERO; 6];
        let recording = Recording::from_codes(2, vec![0.0, 1.0, 0.5], codes);
        assert_eq!(recording.time_goes_backwards_at(), Some(3));
        assert_eq!(recording.window(0.0, 1.0), Err(WindowError::TimeGoesBackwards { sample: 3 }));
    }

    #[test]
    fn samples_at_an_end_of_the_range_are_no_measurements() {
        let codes = [[0, 5], [i64::MAX, 5], [7, i64::MIN], [(1 << 23) - 2, -(1 << 23) + 1]];
        let codes = codes.iter().flatten().map(|&code| AdcCode::saturating(code)).collect();
        let recording = Recording::from_codes(2, vec![0.0, 1.0, 2.0, 3.0], codes);
        let times: Vec<f64> = recording.unsaturated().map(|(time, _)| time).collect();
        assert_eq!(times, [0.0, 3.0]);
    }
}
