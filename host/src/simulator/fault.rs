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

/// Noise of a channel without signal, counts: the converter's own.
const CONVERTER_NOISE: f64 = 80.0;

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
    /// A gage's zero drifts.
    DriftingChannel {
        /// The channel.
        channel: usize,
        /// How fast, counts a second.
        counts_per_second: f64,
    },
    /// A gage has come off its body, in part or whole: it feels less of every load.
    DebondedChannel {
        /// The channel.
        channel: usize,
        /// The share of the load that it still feels.
        kept: f64,
    },
    /// A gage's supply is broken: its input is zero, but for the converter's own noise.
    DeadChannel {
        /// The channel.
        channel: usize,
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
    drifted_counts: [f64; CHANNELS],
    previous_reply: Vec<u8>,
}

impl ActiveFaults {
    pub(super) fn none(seed: u64) -> Self {
        Self {
            active: Vec::new(),
            random: random_sequence(seed, Purpose::Faults),
            stuck_volts: [None; CHANNELS],
            wander: [0.0; CHANNELS],
            drifted_counts: [0.0; CHANNELS],
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
        self.drifted_counts = [0.0; CHANNELS];
    }

    pub(super) fn converter_missing(&self) -> bool {
        self.active.contains(&Fault::ConverterMissing)
    }

    /// Changes the voltages at the pins; `felt` is what of them is the load, `seconds` is the time of this conversion, `period`
    /// since the last one.
    pub(super) fn disturb_inputs(
        &mut self,
        volts: &mut [f64; CHANNELS],
        felt: &[f64; CHANNELS],
        seconds: f64,
        period: f64,
    ) {
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
                Fault::DriftingChannel { channel, counts_per_second } => {
                    if let (Some(volts), Some(drifted)) =
                        (volts.get_mut(channel), self.drifted_counts.get_mut(channel))
                    {
                        *drifted += counts_per_second * period;
                        *volts += volts_of_counts(*drifted);
                    }
                }
                Fault::DebondedChannel { channel, kept } => {
                    if let (Some(volts), Some(felt)) = (volts.get_mut(channel), felt.get(channel)) {
                        *volts -= (1.0 - kept) * felt;
                    }
                }
                Fault::DeadChannel { channel } => {
                    if let Some(volts) = volts.get_mut(channel) {
                        let draw: f64 = StandardNormal.sample(&mut self.random);
                        *volts = volts_of_counts(CONVERTER_NOISE * draw);
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
mod tests;
