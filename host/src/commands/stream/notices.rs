//! What is said in words while wrenches are streamed: each trouble once, when it comes and when it goes.

use std::io::{self, Write};

use ftcal_shared::wire::health::{StatusBit, StatusWord};

use crate::link::frame::{Measured, NoWrench, WrenchSample};
use crate::link::{health_words, words};

/// How long a bit of the status word is to be away before that is said, seconds: what comes with every other sample is said once.
const AWAY_S: f64 = 1.0;

/// What was told last.
#[derive(Default)]
pub(super) struct Notices {
    trouble: Option<NoWrench>,
    /// The bits that were told of, and when each was last set.
    told: Vec<(StatusBit, f64)>,
    invalid: u64,
}

impl Notices {
    /// Samples that were no wrench.
    pub(super) const fn invalid_samples(&self) -> u64 {
        self.invalid
    }

    /// Says what has changed with this sample.
    ///
    /// # Errors
    ///
    /// Those of the destination.
    pub(super) fn tell(
        &mut self,
        time_s: f64,
        sample: &WrenchSample,
        measured: &Measured,
        out: &mut dyn Write,
    ) -> io::Result<()> {
        self.tell_status(time_s, sample.status, out)?;
        let trouble = match measured {
            Measured::Valid(_) => None,
            Measured::Invalid(cause) => {
                self.invalid += u64::from(sample.stride > 0);
                Some(*cause)
            }
        };
        if trouble != self.trouble {
            match trouble {
                Some(cause) => writeln!(out, "{time_s} s: no wrench: {}", words::no_wrench(cause))?,
                None => writeln!(out, "{time_s} s: wrenches again")?,
            }
        }
        self.trouble = trouble;
        Ok(())
    }

    fn tell_status(&mut self, time_s: f64, status: StatusWord, out: &mut dyn Write) -> io::Result<()> {
        for bit in status.set_bits().filter(|&bit| !is_told_as_trouble(bit)) {
            if let Some((_, last_s)) = self.told.iter_mut().find(|(told, _)| *told == bit) {
                *last_s = time_s;
            } else {
                let (meaning, _) = health_words::status(bit);
                writeln!(out, "{time_s} s: {}: {meaning}", bit.name())?;
                self.told.push((bit, time_s));
            }
        }
        for (bit, last_s) in self.told.extract_if(.., |(_, last_s)| time_s - *last_s >= AWAY_S) {
            writeln!(out, "{time_s} s: {} no more since {last_s} s", bit.name())?;
        }
        Ok(())
    }
}

/// Whether samples with this bit are no wrenches, which is said with more detail.
const fn is_told_as_trouble(bit: StatusBit) -> bool {
    matches!(
        bit,
        StatusBit::Saturated
            | StatusBit::OpenInput
            | StatusBit::AdcFault
            | StatusBit::GagesContradict
            | StatusBit::Uncalibrated
            | StatusBit::GainChanged
            | StatusBit::SelfTest
    )
}

#[cfg(test)]
mod tests {
    use ftcal_shared::wire::health::{StatusBit, StatusWord};

    use super::Notices;

    /// What is said of samples with these status words, ten a second.
    fn said(words: &[StatusWord]) -> String {
        let mut notices = Notices::default();
        let mut said = Vec::new();
        for (step, &status) in (0_u32..).zip(words) {
            notices.tell_status(f64::from(step) / 10.0, status, &mut said).expect("memory takes everything");
        }
        String::from_utf8(said).expect("words")
    }

    #[test]
    fn a_bit_is_told_when_it_comes_and_when_it_has_gone() {
        let carry_on = StatusBit::CarryOn.word();
        let mut words = vec![StatusWord::NONE; 3];
        // It flickers for a second, and is off for more than that.
        words.extend([carry_on, StatusWord::NONE].repeat(5));
        words.extend([StatusWord::NONE; 20]);
        assert_eq!(
            said(&words),
            "0.3 s: carry-on: measuring without one gage\n2.1 s: carry-on no more since 1.1 s\n"
        );
    }

    #[test]
    fn what_makes_a_sample_no_wrench_is_not_told_twice() {
        let said = said(&[StatusBit::Saturated.word(), StatusBit::Overload.word()]);
        assert!(!said.contains("saturated") && said.contains("overload"), "{said}");
    }
}
