//! From the converter's rate to a lower one, without aliases.
//!
//! Every D-th wrench alone would fold whatever vibrates above half the output rate into the band that is left. So each sample of
//! the output is a weighted mean of [`OVERLAP`]·D − 1 samples of the input around its time. The weights are a windowed sinc: the
//! ideal low-pass of half the output rate, under a Kaiser window of shape β = `SHAPE`. With f the output rate:
//!
//! | frequencies | |
//! |---|---|
//! | up to [`PASS_BAND`]·f | pass, within [`RIPPLE`] of their amplitude |
//! | f/2 | half of the amplitude |
//! | from (1 − [`PASS_BAND`])·f on, all that would fold into the pass band | attenuated to [`LEAKAGE`] (90 dB) and less |
//!
//! The weights are symmetric, so **every frequency is delayed by the same time, exactly [`group_delay`] conversions**, and the
//! samples that leave here bear the time that they are of: that of their last conversion less this delay. Steady loads pass
//! unaltered.
//!
//! # How
//!
//! At any time [`OVERLAP`] outputs are in the making. Each input is added to the sum of every one of them with its own weight, and
//! with the last input of an output its sum is complete. There is no history of samples to keep: the state is [`OVERLAP`] sums
//! an axis, and each input costs the same, some 300 instructions. (`idsp`, whose half-band cascades take fewer operations on
//! average, keeps the history of every stage for every axis, and does the work of all stages at once at every D-th input.)
//!
//! Weights for every D are taken from one table, the window sampled at `GRID` points an output period. Sums are in single
//! precision: n additions are off by at most n·2⁻²⁴ of the largest value.
//!
//! # What is not a wrench
//!
//! A sample that is invalid or missing, or made with another calibration or tare, empties the sums, and the output is invalid until it
//! is made of good samples alone again. Outputs stand at the conversions whose number is one less than a multiple of D, whatever
//! was lost, so that what is missing can be counted.

use ftcal_shared::units::{Decimation, DeviceTime, MAX_DOF, SampleIndex};
use ftcal_shared::wire::{InvalidCause, PackedWrenches};

use crate::stream::{Measurement, WrenchMoment, larger};

/// Output periods that the weights extend over.
pub const OVERLAP: u16 = 12;

/// As many sums as there are outputs in the making.
const SUMS: usize = OVERLAP as usize;

/// β of the Kaiser window: as large as the width of the pass band allows.
const SHAPE: f64 = 9.25;

/// Frequencies up to this fraction of the output rate pass.
pub const PASS_BAND: f64 = 0.25;

/// How far the amplitude of what passes may change, relative.
pub const RIPPLE: f64 = 1e-4;

/// What is left at most of the amplitude of what would fold into the pass band.
pub const LEAKAGE: f64 = 3.16e-5;

/// Points of the table an output period.
const GRID: usize = 128;

/// Points of the table on either side of its centre.
const HALF: usize = SUMS / 2 * GRID;

/// One half of the weights, from the centre on, before they are normalised.
static WEIGHTS: [f32; HALF + 1] = weights();

/// What the weights of each decimation add up to, inverted.
static NORMALISATION: [f32; Decimation::ALL.len()] = normalisation();

/// How many conversions the output lies behind the input.
pub const fn group_delay(decimation: Decimation) -> u16 {
    match decimation {
        Decimation::By1 => 0,
        decimation => OVERLAP / 2 * decimation.factor() as u16 - 1,
    }
}

/// The decimator of a stream of wrenches.
#[derive(Clone, Debug)]
pub struct Decimator {
    decimation: Decimation,
    /// Sums in the making; the one to be completed next is at `next`.
    sums: [[f32; MAX_DOF]; SUMS],
    next: usize,
    /// Good samples in a row, up to as many as an output takes.
    good: u16,
    /// The input before.
    last: Option<SampleIndex>,
    axes: u8,
    calibration: u32,
    basis: u8,
    /// Why the output is invalid until there are enough good samples.
    cause: InvalidCause,
    /// What has been true at any input since the last output.
    status: u16,
    parity: Option<f32>,
}

impl Decimator {
    /// A decimator that has seen nothing.
    pub const fn new(decimation: Decimation) -> Self {
        Self {
            decimation,
            sums: [[0.0; MAX_DOF]; SUMS],
            next: 0,
            good: 0,
            last: None,
            axes: 0,
            calibration: 0,
            basis: 0,
            cause: InvalidCause::Settling,
            status: 0,
            parity: None,
        }
    }

    /// The decimation.
    pub const fn decimation(&self) -> Decimation {
        self.decimation
    }

    /// Takes one sample of the input, and gives one of the output where this was the last that it is made of.
    pub fn push(&mut self, sample: &WrenchMoment) -> Option<WrenchMoment> {
        if self.decimation == Decimation::By1 {
            return Some(*sample);
        }
        if self.last.is_some_and(|last| sample.index != last.next()) {
            self.empty(InvalidCause::Settling);
        }
        self.last = Some(sample.index);
        self.status |= sample.status;
        self.parity = larger(self.parity, sample.parity);
        let factor = u32::from(self.decimation.factor());
        let phase = sample.index.get() % factor;
        match sample.measurement {
            Measurement::Invalid(cause) => self.empty(cause),
            Measurement::Valid { wrench, axes, calibration } => {
                if (axes, calibration, sample.basis) != (self.axes, self.calibration, self.basis) {
                    self.empty(InvalidCause::Settling);
                    (self.axes, self.calibration, self.basis) = (axes, calibration, sample.basis);
                }
                self.add(&wrench, phase);
            }
        }
        (phase + 1 == factor).then(|| self.output(sample))
    }

    /// Adds an input to every output in the making.
    fn add(&mut self, wrench: &[f32; MAX_DOF], phase: u32) {
        let step = GRID / usize::from(self.decimation.factor());
        let (later, sooner) = self.sums.split_at_mut(self.next);
        // The newest input of an output that is complete has the first weight, `step` from the beginning of the window; this one
        // comes `phase` before the last of its period.
        let mut point = GRID - phase as usize * step;
        for sum in sooner.iter_mut().chain(later) {
            let weight = WEIGHTS.get(point.abs_diff(HALF)).copied().unwrap_or(0.0);
            for (sum, component) in sum.iter_mut().zip(wrench) {
                *sum += weight * component;
            }
            point += GRID;
        }
        self.good = (self.good + 1).min(self.needed());
    }

    /// How many inputs an output is made of.
    const fn needed(&self) -> u16 {
        OVERLAP * self.decimation.factor() as u16 - 1
    }

    /// Completes the output that this input is the last of.
    fn output(&mut self, last: &WrenchMoment) -> WrenchMoment {
        let sum = self.sums.get_mut(self.next).map(core::mem::take).unwrap_or_default();
        self.next = (self.next + 1) % SUMS;
        let normalisation = NORMALISATION.get(self.decimation as usize).copied().unwrap_or(0.0);
        let wrench = sum.map(|component| component * normalisation);
        let measurement = if self.good < self.needed() {
            Measurement::Invalid(self.cause)
        } else if PackedWrenches::can_hold(&wrench) {
            Measurement::Valid { wrench, axes: self.axes, calibration: self.calibration }
        } else {
            Measurement::Invalid(InvalidCause::NonFinite)
        };
        let factor = self.decimation.factor();
        let delay = u64::from(group_delay(self.decimation)) * u64::from(last.period_nanos) / 1000;
        WrenchMoment {
            stride: factor,
            time: DeviceTime::from_micros(last.time.as_micros().saturating_sub(delay)),
            period_nanos: last.period_nanos * u32::from(factor),
            status: core::mem::take(&mut self.status),
            parity: self.parity.take(),
            measurement,
            ..*last
        }
    }

    /// Begins afresh, for this cause.
    fn empty(&mut self, cause: InvalidCause) {
        self.sums = [[0.0; MAX_DOF]; SUMS];
        self.good = 0;
        self.cause = cause;
    }
}

/// The window at each point from the centre on.
const fn weights() -> [f32; HALF + 1] {
    let mut weights = [0.0; HALF + 1];
    // The last one, at the very end of the window, is zero, so that no input belongs to more than [`OVERLAP`] outputs.
    let mut point = 0;
    while point < HALF {
        let along = point as f64 / HALF as f64;
        let window = bessel(SHAPE * SHAPE * (1.0 - along * along)) / bessel(SHAPE * SHAPE);
        #[expect(clippy::cast_possible_truncation, reason = "rounded to single precision")]
        {
            weights[point] = (sinc(point) * window) as f32;
        }
        point += 1;
    }
    weights
}

const fn normalisation() -> [f32; Decimation::ALL.len()] {
    let mut inverted = [1.0; Decimation::ALL.len()];
    let mut decimation = 1;
    while decimation < inverted.len() {
        let step = GRID >> decimation;
        let mut sum = WEIGHTS[0] as f64;
        let mut point = step;
        while point < HALF {
            sum += 2.0 * WEIGHTS[point] as f64;
            point += step;
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounded to single precision")]
        {
            inverted[decimation] = (1.0 / sum) as f32;
        }
        decimation += 1;
    }
    inverted
}

/// The modified Bessel function of the first kind and order zero of √`square`, by its power series; `square` up to 100.
const fn bessel(square: f64) -> f64 {
    let (mut term, mut sum, mut order) = (1.0, 1.0, 1.0);
    while order < 40.0 {
        term *= square / (4.0 * order * order);
        sum += term;
        order += 1.0;
    }
    sum
}

/// sin(πt)/(πt) at t output periods from the centre, t = `point`/[`GRID`].
const fn sinc(point: usize) -> f64 {
    if point == 0 {
        return 1.0;
    }
    // The sine by its power series, within a quarter of its period.
    let (periods, into) = (point / GRID, point % GRID);
    let folded = if into > GRID / 2 { GRID - into } else { into };
    let x = core::f64::consts::PI * folded as f64 / GRID as f64;
    let (mut term, mut sine, mut order) = (x, x, 2.0);
    while order < 24.0 {
        term *= -x * x / (order * (order + 1.0));
        sine += term;
        order += 2.0;
    }
    let sign = if periods % 2 == 0 { 1.0 } else { -1.0 };
    sign * sine / (core::f64::consts::PI * point as f64 / GRID as f64)
}

#[cfg(test)]
mod tests;
