//! Tare: a wrench that is subtracted from every other, set, cleared and read by request, never by itself.
//!
//! # Why a wrench and not a bias
//!
//! To move the bias of the gages would give the same numbers, and hide what the gages say of themselves: a gage that has drifted
//! would be tared away, and the parity of the codes with it. A wrench, in newton and newton metre, can be read and understood, takes
//! six numbers, means the same when the sensor carries on without a gage, and leaves overload and peaks to the whole load. A
//! new calibration clears it: it was a measurement of the old one's.
//!
//! # How it is set
//!
//! From the mean of the next so many samples. One that is no wrench refuses it, and so does a load that moves: the variance over all
//! samples must not exceed [`LARGEST_RATIO`] times half the mean squared difference of successive ones (von Neumann's ratio), as it does
//! where the wrench has travelled by six standard deviations of its noise. Until all have come, and after a refusal, the tare is what
//! it was.

use ftcal_shared::units::MAX_DOF;
use ftcal_shared::wire::{Rejection, TarePhase, TareRefusal, TareReport};

/// Variance over half the mean squared difference of successive samples: one for noise alone, 1 + (travel/σ)²/12 on the way.
const LARGEST_RATIO: f32 = 4.0;

/// Of few samples the ratio of noise alone may be that large by chance.
const LEAST_SAMPLES: u16 = 16;

/// What is subtracted, and what is being averaged.
pub(super) struct Tare {
    /// Zero where there is none.
    offset: [f32; MAX_DOF],
    active: bool,
    phase: Phase,
}

/// What is being done about it.
enum Phase {
    Settled,
    Averaging(Averaging),
    Refused(TareRefusal),
}

/// Sums about the first sample.
struct Averaging {
    samples: u16,
    left: u16,
    store: bool,
    first: [f32; MAX_DOF],
    last: [f32; MAX_DOF],
    sum: [f32; MAX_DOF],
    squares: [f32; MAX_DOF],
    differences: [f32; MAX_DOF],
}

/// What came of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Averaged {
    /// Nothing yet, or nothing was asked for.
    Nothing,
    /// The tare is set.
    Set {
        /// It is to be kept across resets.
        store: bool,
    },
}

impl Tare {
    pub(super) const fn new() -> Self {
        Self { offset: [0.0; MAX_DOF], active: false, phase: Phase::Settled }
    }

    /// Subtracts this from now on, or nothing.
    pub(super) fn put(&mut self, wrench: Option<[f32; MAX_DOF]>) {
        *self = Self { offset: wrench.unwrap_or_default(), active: wrench.is_some(), phase: Phase::Settled };
    }

    pub(super) fn report(&self) -> TareReport {
        TareReport {
            phase: match &self.phase {
                Phase::Settled => TarePhase::Settled,
                Phase::Averaging(averaging) => TarePhase::Averaging { left: averaging.left },
                Phase::Refused(refusal) => TarePhase::Refused(*refusal),
            },
            wrench: self.active.then_some(self.offset),
        }
    }

    /// Begins to average.
    pub(super) fn start(&mut self, samples: u16, store: bool) -> Result<(), Rejection> {
        if samples == 0 {
            return Err(Rejection::UnusableLimit);
        }
        let none = [0.0; MAX_DOF];
        self.phase = Phase::Averaging(Averaging {
            samples: samples.max(LEAST_SAMPLES),
            left: samples.max(LEAST_SAMPLES),
            store,
            first: none,
            last: none,
            sum: none,
            squares: none,
            differences: none,
        });
        Ok(())
    }

    /// The wrench less the tare.
    #[inline]
    pub(super) fn subtracted(&self, load: &[f32; MAX_DOF]) -> [f32; MAX_DOF] {
        let ([a, b, c, d, e, f], [of_a, of_b, of_c, of_d, of_e, of_f]) = (load, &self.offset);
        [a - of_a, b - of_b, c - of_c, d - of_d, e - of_e, f - of_f]
    }

    /// Whether samples are being averaged.
    #[inline]
    pub(super) const fn is_averaging(&self) -> bool {
        matches!(self.phase, Phase::Averaging(_))
    }

    /// Takes in the whole load of one sample, or that it is no wrench.
    pub(super) fn offer(&mut self, load: Option<&[f32; MAX_DOF]>) -> Averaged {
        let Phase::Averaging(averaging) = &mut self.phase else { return Averaged::Nothing };
        let Some(load) = load else {
            self.phase = Phase::Refused(TareRefusal::NoWrench);
            return Averaged::Nothing;
        };
        averaging.push(load);
        if averaging.left > 0 {
            return Averaged::Nothing;
        }
        let store = averaging.store;
        if averaging.is_moving() {
            self.phase = Phase::Refused(TareRefusal::Moving);
            return Averaged::Nothing;
        }
        let mean = averaging.mean();
        self.put(Some(mean));
        Averaged::Set { store }
    }
}

impl Averaging {
    fn push(&mut self, load: &[f32; MAX_DOF]) {
        if self.left == self.samples {
            (self.first, self.last) = (*load, *load);
        }
        for component in 0..MAX_DOF {
            let value = load[component] - self.first[component];
            let difference = load[component] - self.last[component];
            self.sum[component] += value;
            self.squares[component] += value * value;
            self.differences[component] += difference * difference;
        }
        self.last = *load;
        self.left -= 1;
    }

    fn mean(&self) -> [f32; MAX_DOF] {
        core::array::from_fn(|component| {
            self.first[component] + self.sum[component] / f32::from(self.samples)
        })
    }

    fn is_moving(&self) -> bool {
        let samples = f32::from(self.samples);
        (0..MAX_DOF).any(|component| {
            let sum = self.sum[component];
            let spread = self.squares[component] - sum * sum / samples;
            let noise = self.differences[component] / 2.0;
            // What rounding alone leaves of a still wrench is no motion.
            let rounding = f32::EPSILON * f32::EPSILON * self.first[component] * self.first[component];
            spread > LARGEST_RATIO * (noise + samples * rounding)
        })
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::MAX_DOF;
    use ftcal_shared::wire::{Rejection, TarePhase, TareRefusal};

    use super::{Averaged, LEAST_SAMPLES, Tare};

    const LOAD: [f32; MAX_DOF] = [10.0, -200.0, 30.0, 0.4, 0.0, -6.0];

    /// Noise of about one, always the same.
    fn noise(sample: u16, component: u16) -> f32 {
        let mixed = (u32::from(sample) * 6 + u32::from(component) + 1).wrapping_mul(2_654_435_761);
        let mixed = (mixed ^ mixed >> 15).wrapping_mul(2_246_822_519);
        3.5 * (((mixed ^ mixed >> 13) >> 8) as f32 / 16_777_216.0 - 0.5)
    }

    fn sample(sample: u16, travel: f32, samples: u16) -> [f32; MAX_DOF] {
        let way = travel * f32::from(sample) / f32::from(samples);
        let mut components = 0..;
        LOAD.map(|load| load + way + noise(sample, components.next().unwrap_or(0)))
    }

    /// Averages so many samples of a load that travels so far, and says what came of the last one.
    fn average(tare: &mut Tare, samples: u16, travel: f32, store: bool) -> Averaged {
        assert_eq!(tare.start(samples, store), Ok(()));
        let mut averaged = Averaged::Nothing;
        for at in 0..samples {
            assert_eq!(averaged, Averaged::Nothing);
            assert_eq!(tare.report().phase, TarePhase::Averaging { left: samples - at });
            averaged = tare.offer(Some(&sample(at, travel, samples)));
        }
        averaged
    }

    #[test]
    fn the_mean_is_subtracted_until_it_is_cleared() {
        let mut tare = Tare::new();
        assert_eq!(tare.report().wrench, None);
        assert_eq!(tare.subtracted(&LOAD), LOAD);
        for samples in [LEAST_SAMPLES, 100, 4000] {
            assert_eq!(average(&mut tare, samples, 0.0, true), Averaged::Set { store: true });
            let report = tare.report();
            assert_eq!(report.phase, TarePhase::Settled);
            for (found, load) in report.wrench.unwrap().iter().zip(&LOAD) {
                // Five standard errors of a noise of about one.
                assert!((found - load).abs() < 5.0 / f32::from(samples).sqrt());
            }
            assert!(tare.subtracted(&LOAD).iter().all(|rest| rest.abs() < 5.0 / f32::from(samples).sqrt()));
        }
        tare.put(None);
        assert_eq!(tare.report().wrench, None);
        assert_eq!(tare.subtracted(&LOAD), LOAD);
    }

    #[test]
    fn a_load_that_moves_is_refused_and_the_tare_stays() {
        let mut tare = Tare::new();
        tare.put(Some(LOAD));
        for travel in [9.0, -20.0, 1000.0] {
            assert_eq!(average(&mut tare, 200, travel, false), Averaged::Nothing, "{travel}");
            assert_eq!(tare.report().phase, TarePhase::Refused(TareRefusal::Moving));
            assert_eq!(tare.report().wrench, Some(LOAD));
        }
        assert_eq!(
            average(&mut tare, 200, 2.0, false),
            Averaged::Set { store: false },
            "a creep is no motion"
        );
    }

    #[test]
    fn a_sample_that_is_no_wrench_refuses_it() {
        let mut tare = Tare::new();
        tare.start(100, false).unwrap();
        tare.offer(Some(&LOAD));
        assert_eq!(tare.offer(None), Averaged::Nothing);
        assert_eq!(tare.report().phase, TarePhase::Refused(TareRefusal::NoWrench));
        assert_eq!(tare.report().wrench, None);
        assert_eq!(tare.offer(Some(&LOAD)), Averaged::Nothing);
    }

    #[test]
    fn a_wrench_without_any_noise_is_at_rest() {
        let mut tare = Tare::new();
        tare.start(50, false).unwrap();
        let last = (0..50).map(|_| tare.offer(Some(&LOAD))).last();
        assert_eq!(last, Some(Averaged::Set { store: false }));
        assert_eq!(tare.report().wrench, Some(LOAD));
    }

    #[test]
    fn of_no_sample_there_is_no_mean() {
        assert_eq!(Tare::new().start(0, false), Err(Rejection::UnusableLimit));
    }
}
