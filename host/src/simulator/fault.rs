//! What can go wrong between the gages and the driver.
//!
//! Channel faults change the voltage at the converter's pins, bus faults the bytes of a chip-select frame or the
//! data-ready signal. Several may act at once, in the order in which they were injected. They draw on a random sequence
//! of their own, so the same bench with and without a fault reads the same noise.
//!
//! An *open* gage leaves its input floating. What it then reads depends on leakage and wiring; the model is a slow
//! Gaussian wander about mid-range (30 % of full scale, correlated over two seconds) with mains hum (5 %) on
//! top. It stays mostly within the range, so nothing but its content gives it away.

use std::f64::consts::TAU;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::ads131m08::CHANNELS;
use super::sensor::{FULL_SCALE_COUNTS, volts_of_counts};
use super::{Purpose, random_sequence};

/// Standard deviation of an open input's wander, as a fraction of full scale.
const OPEN_WANDER: f64 = 0.3;
/// Correlation time of that wander, second.
const OPEN_SECONDS: f64 = 2.0;
/// Amplitude of the hum that an open input picks up, as a fraction of full scale.
const OPEN_HUM: f64 = 0.05;
/// Frequency of that hum, hertz.
const MAINS_HERTZ: f64 = 50.0;

/// What an undriven bus reads: the line is pulled up.
const IDLE_BYTE: u8 = 0xFF;

/// The end of the range at which a saturated channel stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rail {
    /// The most negative code.
    Low,
    /// The most positive code.
    High,
}

/// A fault; channels are counted from zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// A channel repeats its next reading for ever.
    StuckChannel {
        /// The channel.
        channel: usize,
    },
    /// A gage's wire is broken: its input floats.
    OpenChannel {
        /// The channel.
        channel: usize,
    },
    /// A channel stands at one end of its range.
    SaturatedChannel {
        /// The channel.
        channel: usize,
        /// Which end.
        rail: Rail,
    },
    /// A channel carries more noise.
    NoisyChannel {
        /// The channel.
        channel: usize,
        /// Standard deviation of the noise that comes on top, counts.
        noise_counts: f64,
    },
    /// Bits flip on the bus, in both directions.
    BusBitErrors {
        /// Probability for each bit, 0 to 1.
        probability: f64,
    },
    /// Conversions are not announced; their results are there all the same.
    DataReadyLost {
        /// Probability for each conversion, 0 to 1.
        probability: f64,
    },
    /// Every reply comes one frame later than it should.
    LateReply,
    /// The part answers like an ADS131M08 and says that it is something else.
    WrongIdentity {
        /// What its identity register reads.
        id: u16,
    },
    /// There is no converter on the bus.
    ConverterMissing,
}

/// The faults at work, and what they have to remember.
#[derive(Clone, Debug)]
pub(super) struct ActiveFaults {
    active: Vec<Fault>,
    random: ChaCha8Rng,
    stuck_volts: [Option<f64>; CHANNELS],
    wander: [f64; CHANNELS],
    previous_reply: Vec<u8>,
}

impl ActiveFaults {
    pub(super) fn none(seed: u64) -> Self {
        Self {
            active: Vec::new(),
            random: random_sequence(seed, Purpose::Faults),
            stuck_volts: [None; CHANNELS],
            wander: [0.0; CHANNELS],
            previous_reply: Vec::new(),
        }
    }

    pub(super) fn inject(&mut self, fault: Fault) {
        self.active.push(fault);
    }

    pub(super) fn clear(&mut self) {
        self.active.clear();
        self.stuck_volts = [None; CHANNELS];
        self.wander = [0.0; CHANNELS];
    }

    pub(super) fn converter_missing(&self) -> bool {
        self.active.contains(&Fault::ConverterMissing)
    }

    /// Changes the voltages at the pins; `seconds` is the time of this conversion, `period` since the last one.
    pub(super) fn disturb_inputs(&mut self, volts: &mut [f64; CHANNELS], seconds: f64, period: f64) {
        for fault in &self.active {
            match *fault {
                Fault::StuckChannel { channel } => {
                    if let (Some(volts), Some(stuck)) =
                        (volts.get_mut(channel), self.stuck_volts.get_mut(channel))
                    {
                        *volts = *stuck.get_or_insert(*volts);
                    }
                }
                Fault::OpenChannel { channel } => {
                    if let (Some(volts), Some(wander)) =
                        (volts.get_mut(channel), self.wander.get_mut(channel))
                    {
                        let kept = (-period / OPEN_SECONDS).exp();
                        let draw: f64 = StandardNormal.sample(&mut self.random);
                        *wander = kept * *wander + (1.0 - kept * kept).sqrt() * OPEN_WANDER * draw;
                        let hum = OPEN_HUM * (TAU * MAINS_HERTZ * seconds).sin();
                        *volts = volts_of_counts((*wander + hum) * FULL_SCALE_COUNTS);
                    }
                }
                Fault::SaturatedChannel { channel, rail } => {
                    if let Some(volts) = volts.get_mut(channel) {
                        *volts = match rail {
                            Rail::Low => f64::NEG_INFINITY,
                            Rail::High => f64::INFINITY,
                        };
                    }
                }
                Fault::NoisyChannel { channel, noise_counts } => {
                    if let Some(volts) = volts.get_mut(channel) {
                        let draw: f64 = StandardNormal.sample(&mut self.random);
                        *volts += volts_of_counts(noise_counts * draw);
                    }
                }
                _ => {}
            }
        }
    }

    /// Whether this conversion's data-ready signal is lost.
    pub(super) fn loses_data_ready(&mut self) -> bool {
        let mut lost = false;
        for fault in &self.active {
            if let Fault::DataReadyLost { probability } = *fault {
                lost |= happens(&mut self.random, probability);
            }
        }
        lost
    }

    /// Changes the bytes on their way to the converter.
    pub(super) fn disturb_command(&mut self, bytes: &mut [u8]) {
        self.flip_bits(bytes);
    }

    /// Changes the bytes on their way to the host.
    pub(super) fn disturb_reply(&mut self, bytes: &mut [u8]) {
        if self.converter_missing() {
            bytes.fill(IDLE_BYTE);
            return;
        }
        let on_time = bytes.to_vec();
        if self.active.contains(&Fault::LateReply) {
            let late = self.previous_reply.iter().copied().chain(std::iter::repeat(0));
            for (byte, late) in bytes.iter_mut().zip(late) {
                *byte = late;
            }
        }
        self.previous_reply = on_time;
        self.flip_bits(bytes);
    }

    fn flip_bits(&mut self, bytes: &mut [u8]) {
        for fault in &self.active {
            if let Fault::BusBitErrors { probability } = *fault {
                for byte in bytes.iter_mut() {
                    for bit in 0..8 {
                        *byte ^= u8::from(happens(&mut self.random, probability)) << bit;
                    }
                }
            }
        }
    }
}

/// Whether something of this probability happens; beyond 0 and 1 it never or always does, and for no number never.
fn happens(random: &mut ChaCha8Rng, probability: f64) -> bool {
    random.random::<f64>() < probability
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::AdcCode;
    use nalgebra::Vector3;

    use super::{ActiveFaults, Fault, Rail};
    use crate::simulator::bench::tests::{bench, codes, frame, write};
    use crate::simulator::bench::{Bench, Load};
    use crate::simulator::scenario::ScenarioKind;
    use crate::simulator::sensor::FULL_SCALE_COUNTS;

    fn turning_bench() -> Bench {
        let mut bench = bench(ScenarioKind::Force, 11);
        bench.hang(Load { mass_kg: 1.5, arm_m: Vector3::zeros() });
        bench.turn();
        bench
    }

    /// Channel 2 of a bench with this fault beside the same channel without; every other channel must be untouched.
    fn with_and_without(fault: Fault, conversions: usize) -> Vec<(AdcCode, AdcCode)> {
        let (mut faulty, mut healthy) = (turning_bench(), turning_bench());
        faulty.inject(fault);
        (0..conversions)
            .map(|_| {
                let (with, without) = (codes(&mut faulty), codes(&mut healthy));
                for channel in (0..8).filter(|&channel| channel != 2) {
                    assert_eq!(with[channel], without[channel]);
                }
                (with[2], without[2])
            })
            .collect()
    }

    #[test]
    fn a_stuck_channel_repeats_one_reading() {
        let pairs = with_and_without(Fault::StuckChannel { channel: 2 }, 1000);
        assert!(pairs.iter().all(|&(with, _)| with == pairs[0].1));
    }

    #[test]
    fn a_saturated_channel_stands_at_its_rail() {
        for (rail, end) in [(Rail::Low, AdcCode::MIN), (Rail::High, AdcCode::MAX)] {
            let pairs = with_and_without(Fault::SaturatedChannel { channel: 2, rail }, 100);
            assert!(pairs.iter().all(|&(with, _)| with == end));
        }
    }

    #[test]
    fn a_noisy_channel_carries_that_much_more_noise() {
        let noise_counts = 20_000.0;
        let pairs = with_and_without(Fault::NoisyChannel { channel: 2, noise_counts }, 5000);
        let n = pairs.len() as f64;
        let squares = pairs.iter().map(|(with, without)| {
            let extra = f64::from(with.counts() - without.counts());
            extra * extra
        });
        let variance = squares.sum::<f64>() / n;
        let expected = noise_counts * noise_counts;
        assert!((variance - expected).abs() < 5.0 * 2.0_f64.sqrt() * expected / n.sqrt());
    }

    #[test]
    fn an_open_channel_wanders_whatever_the_load() {
        let pairs = with_and_without(Fault::OpenChannel { channel: 2 }, 60_000);
        let relative = pairs.iter().map(|(with, _)| f64::from(with.counts()) / FULL_SCALE_COUNTS);
        let (low, high) = relative.clone().fold((1.0, -1.0), |(low, high), x| (x.min(low), x.max(high)));
        assert!(low < -0.3 && high > 0.3, "{low} to {high}");
        let inside = pairs.iter().filter(|(with, _)| !with.is_saturated()).count();
        assert!(inside > 59_000, "{inside}");
    }

    #[test]
    fn bits_flip_at_their_rate_in_both_directions() {
        let probability = 0.01;
        let mut faults = ActiveFaults::none(12);
        faults.inject(Fault::BusBitErrors { probability });
        let (mut command, mut reply) = (vec![0x5A_u8; 10_000], vec![0x5A; 10_000]);
        faults.disturb_command(&mut command);
        faults.disturb_reply(&mut reply);
        assert_ne!(command, reply);
        for bytes in [command, reply] {
            let flipped: u32 = bytes.iter().map(|byte| (byte ^ 0x5A).count_ones()).sum();
            // Five standard deviations of the binomial distribution.
            let expected = 80_000.0 * probability;
            assert!((f64::from(flipped) - expected).abs() < 5.0 * expected.sqrt(), "{flipped} of {expected}");
        }
    }

    #[test]
    fn bit_errors_reach_the_frames_and_end() {
        let (mut faulty, mut healthy) = (turning_bench(), turning_bench());
        faulty.inject(Fault::BusBitErrors { probability: 0.5 });
        assert_ne!(frame(&mut faulty), frame(&mut healthy));
        faulty.clear_faults();
        assert_eq!(codes(&mut faulty), codes(&mut healthy));
    }

    #[test]
    fn data_ready_is_lost_as_often_as_asked_and_the_data_are_not() {
        let mut bench = turning_bench();
        bench.inject(Fault::DataReadyLost { probability: 0.25 });
        let n = 10_000;
        let announced = (0..n).filter(|_| bench.next_conversion()).count();
        // Five standard deviations of the binomial distribution.
        assert!((announced as f64 - 7500.0).abs() < 5.0 * (10_000.0_f64 * 0.25 * 0.75).sqrt());
        bench.inject(Fault::DataReadyLost { probability: 1.0 });
        assert!((0..100).all(|_| !bench.next_conversion()));
        assert_ne!(codes(&mut bench)[0], AdcCode::ZERO);
    }

    #[test]
    fn a_late_reply_is_the_one_before() {
        let (mut late, mut prompt) = (turning_bench(), turning_bench());
        let mut previous = frame(&mut late);
        assert_eq!(frame(&mut prompt), previous);
        late.inject(Fault::LateReply);
        for _ in 0..50 {
            assert_eq!(frame(&mut late), previous);
            previous = frame(&mut prompt);
        }
    }

    #[test]
    fn a_wrong_identity_reads_until_cleared() {
        let mut bench = turning_bench();
        bench.inject(Fault::WrongIdentity { id: 0x2400 });
        write(&mut bench, &[0xA000]);
        assert_eq!(frame(&mut bench)[0], [0x24, 0x00, 0]);
        bench.clear_faults();
        write(&mut bench, &[0xA000]);
        assert_eq!(frame(&mut bench)[0][0], 0x28);
    }

    #[test]
    fn a_missing_converter_is_a_silent_bus() {
        let mut bench = turning_bench();
        bench.inject(Fault::ConverterMissing);
        assert!((0..10).all(|_| !bench.next_conversion()));
        assert!(frame(&mut bench).as_flattened().iter().all(|&byte| byte == 0xFF));
        bench.clear_faults();
        assert!(bench.next_conversion());
    }

    #[test]
    fn a_channel_that_does_not_exist_disturbs_nothing() {
        let (mut faulty, mut healthy) = (turning_bench(), turning_bench());
        faulty.inject(Fault::SaturatedChannel { channel: 8, rail: Rail::High });
        assert_eq!(codes(&mut faulty), codes(&mut healthy));
    }
}
