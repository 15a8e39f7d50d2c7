//! Writing a recording as CSV, a sample at a time or all at once.

use std::fmt::Display;
use std::io::{self, Write};

use ftcal_shared::units::{AdcCode, Gain};

use super::Recording;
use super::parse::GAIN;

/// Writes a recording while it is being made.
#[derive(Debug)]
pub struct RecordingWriter<W: Write> {
    out: W,
}

impl<W: Write> RecordingWriter<W> {
    /// Begins a recording of this many gages at this gain, where it is known: writes the header.
    ///
    /// # Errors
    ///
    /// Those of the destination.
    pub fn new(mut out: W, gages: usize, gain: Option<Gain>) -> io::Result<Self> {
        if let Some(gain) = gain {
            writeln!(out, "# {GAIN} {}", gain.factor())?;
        }
        write!(out, "t_s")?;
        for gage in 0..gages {
            write!(out, ",ch{gage}")?;
        }
        writeln!(out)?;
        Ok(Self { out })
    }

    /// Adds a comment; each of its lines becomes a comment line.
    ///
    /// # Errors
    ///
    /// Those of the destination.
    pub fn comment(&mut self, words: &str) -> io::Result<()> {
        words.lines().try_for_each(|line| writeln!(self.out, "# {line}"))
    }

    /// Adds one sample of codes as the converter delivered them.
    ///
    /// # Errors
    ///
    /// Those of the destination.
    pub fn sample(&mut self, time_s: f64, codes: &[AdcCode]) -> io::Result<()> {
        self.row(time_s, codes.iter().map(|code| code.counts()))
    }

    fn row(&mut self, time_s: f64, values: impl Iterator<Item = impl Display>) -> io::Result<()> {
        write!(self.out, "{time_s}")?;
        for value in values {
            write!(self.out, ",{value}")?;
        }
        writeln!(self.out)
    }

    /// Ends the recording.
    ///
    /// # Errors
    ///
    /// Those of the destination.
    pub fn finish(mut self) -> io::Result<W> {
        self.out.flush()?;
        Ok(self.out)
    }
}

/// Writes a whole recording.
///
/// # Errors
///
/// Those of the destination.
pub fn write(recording: &Recording, out: impl Write) -> io::Result<()> {
    let mut writer = RecordingWriter::new(out, recording.gages(), recording.gain())?;
    for (time_s, codes) in recording.samples() {
        if recording.quantisation().is_exact() || AdcCode::any_is_saturated(codes) {
            writer.sample(time_s, codes)?;
        } else {
            writer.row(time_s, recording.counts(codes).iter())?;
        }
    }
    writer.finish().map(drop)
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{AdcCode, Gain};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::{RecordingWriter, write};
    use crate::recording::Recording;
    use crate::recording::parse::parse;

    #[test]
    fn what_is_written_reads_back_the_same() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        for gages in 2..=12_usize {
            let times: Vec<f64> = (0..50).map(|i| f64::from(i) / 3.0).collect();
            let codes = (0..50 * gages).map(|_| AdcCode::saturating(random.random::<i32>().into())).collect();
            // Two gages know no gain, three the smallest, four the next.
            let gain = gages.checked_sub(3).and_then(|number| Gain::ALL.get(number).copied());
            let recording = Recording::from_codes(gages, times, codes).at_gain(gain);
            let mut file = Vec::new();
            write(&recording, &mut file).expect("memory takes everything");
            assert_eq!(parse(&file, "written").expect("a recording"), recording);
        }
    }

    #[test]
    fn decimals_read_back_within_a_step() {
        let counts = [0.125, -7.75, 1000.0, 3.5, 8_388_607.0, 0.0];
        let recording = Recording::from_counts(2, vec![0.0, 1.0, 2.0], &counts);
        let mut file = Vec::new();
        write(&recording, &mut file).expect("memory takes everything");
        let back = parse(&file, "written").expect("a recording");
        let step = recording.quantisation().counts_per_code();
        for ((_, before), (_, after)) in recording.unsaturated().zip(back.unsaturated()) {
            assert!((recording.counts(before) - back.counts(after)).amax() <= 2.0 * step);
        }
        assert_eq!(back.unsaturated().count(), 2, "the overload stays an overload");
    }

    #[test]
    fn comments_are_no_samples() {
        let mut writer = RecordingWriter::new(Vec::new(), 2, None).expect("memory takes everything");
        writer.comment("first\nsecond").expect("memory takes everything");
        writer.sample(0.0, &[AdcCode::ZERO; 2]).expect("memory takes everything");
        let file = writer.finish().expect("memory takes everything");
        assert_eq!(parse(&file, "written").expect("a recording").len(), 1);
    }
}
