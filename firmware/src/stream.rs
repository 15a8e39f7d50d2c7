//! The stream: samples on their way into frames.
//!
//! ```text
//! sample path ── Moment ──► queue ── Batcher ── frame ──► line
//! ```
//!
//! The sample path hands over one [`Moment`] after the other and is done. Below it, where time does not press, a [`Batcher`]
//! puts moments together that may share a frame, and says when the frame is to go:
//!
//! | the frame goes | why |
//! |---|---|
//! | when it holds [`MAX_RUN`] samples | it is full |
//! | when the next moment does not belong to it | another validity, cause, calibration or stride, a gap, a pause |
//! | before its oldest sample is older than [`LONGEST_WAIT_MICROS`] | latency stays bounded |
//! | at once, where samples are [`EAGER_PERIOD_NANOS`] apart or more and the line is idle | at low rates nothing is gained by waiting |
//!
//! That a frame is due is found out when a moment or a tick comes. While samples come, none waits for longer than the bound;
//! the last ones before the samples end wait for the next tick at most.

use ftcal_shared::units::{DeviceTime, MAX_DOF, SampleIndex};
use ftcal_shared::wire::{CodesFrame, InvalidCause, MAX_RUN, PackedWrenches, Run, ToHost, WrenchFrame};

/// How long a sample waits for others at most, while samples come.
pub const LONGEST_WAIT_MICROS: u64 = 5_000;

/// Samples that are this far apart do not wait for each other while the line is idle: a frame of one takes 0.8 ms at 921 600
/// baud.
pub const EAGER_PERIOD_NANOS: u32 = 1_000_000;

/// What the sample path has to say at one moment.
#[derive(Clone, Debug, PartialEq)]
pub enum Moment {
    /// A raw sample.
    Codes(CodesFrame),
    /// A wrench, or why this sample is none.
    Wrench(WrenchMoment),
    /// Why there are no samples at all.
    Silence(SilentMoment),
}

/// One sample of the stream of wrenches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchMoment {
    /// Number of the conversion that completed it.
    pub index: SampleIndex,
    /// What the number grows by from one sample to the next.
    pub stride: u8,
    /// When it was taken.
    pub time: DeviceTime,
    /// What the board's clock said when its conversion was announced.
    pub announced: DeviceTime,
    /// Nominal time to the next sample.
    pub period_nanos: u32,
    /// The low 16 bits of the status word.
    pub status: u16,
    /// χ² of the parity channels; `None` where there are none.
    pub parity: Option<f32>,
    /// A number that changes with whatever wrenches are made of: calibration, gages in use, tare.
    pub basis: u8,
    /// The wrench, or why there is none.
    pub measurement: Measurement,
}

/// The converter is at fault and produces nothing to be numbered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SilentMoment {
    /// The number that the next conversion will have.
    pub next: SampleIndex,
    /// Now.
    pub time: DeviceTime,
    /// The low 16 bits of the status word.
    pub status: u16,
    /// What is wrong.
    pub cause: InvalidCause,
}

/// A wrench that cannot be read where there is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Measurement {
    /// A wrench.
    Valid {
        /// Newton and newton metre in the sensor frame, in the order of the calibration's axes; zero beyond them.
        wrench: [f32; MAX_DOF],
        /// How many axes the calibration has.
        axes: u8,
        /// Identity of the calibration.
        calibration: u32,
    },
    /// No wrench.
    Invalid(InvalidCause),
}

/// What a run of samples has in common besides its place in the sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Valid { axes: u8, calibration: u32 },
    Invalid(InvalidCause),
}

impl Measurement {
    const fn kind(&self) -> Kind {
        match *self {
            Self::Valid { axes, calibration, .. } => Kind::Valid { axes, calibration },
            Self::Invalid(cause) => Kind::Invalid(cause),
        }
    }
}

/// A run that may grow.
#[derive(Clone, Copy, Debug)]
struct OpenRun {
    kind: Kind,
    first: WrenchMoment,
    last: WrenchMoment,
    samples: u8,
    status: u16,
    parity: Option<f32>,
}

impl OpenRun {
    /// Whether this sample comes right after the last one, and is of its kind.
    fn is_continued_by(&self, sample: &WrenchMoment) -> bool {
        let Self { last, .. } = self;
        let pause = 1000 * micros_since(sample.time, last.time);
        let period = u64::from(last.period_nanos);
        sample.measurement.kind() == self.kind
            && sample.basis == last.basis
            && sample.stride == last.stride
            && sample.index.since(last.index) == u32::from(last.stride)
            && sample.period_nanos == last.period_nanos
            && sample.time >= last.time
            && 2 * pause.abs_diff(period) <= period
    }
}

/// What has been accepted and not yet taken.
#[derive(Clone, Debug, Default)]
enum Waiting {
    #[default]
    Nothing,
    Codes(CodesFrame),
    Silence(SilentMoment),
    Run(OpenRun),
}

/// Puts samples together into frames.
#[derive(Clone, Debug, Default)]
pub struct Batcher {
    waiting: Waiting,
    wrenches: heapless::Vec<[f32; MAX_DOF], MAX_RUN>,
    /// What does not belong to what waits.
    held: Option<Moment>,
}

impl Batcher {
    /// A batcher with nothing in it.
    pub const fn new() -> Self {
        Self { waiting: Waiting::Nothing, wrenches: heapless::Vec::new(), held: None }
    }

    /// The next message that is due, made of what `moments` gives, in that order; `None` where that has to wait.
    pub fn next(
        &mut self,
        now: DeviceTime,
        line_is_idle: bool,
        mut moments: impl FnMut() -> Option<Moment>,
    ) -> Option<ToHost> {
        while !self.is_due(now, line_is_idle) {
            let moment = self.held.take().or_else(&mut moments)?;
            if !self.accept(&moment) {
                self.held = Some(moment);
                break;
            }
        }
        self.take(now)
    }

    /// Forgets what waits: a stream that is asked for begins with what comes after.
    pub fn clear(&mut self) {
        self.waiting = Waiting::Nothing;
        self.held = None;
    }

    /// Takes a moment in, unless it needs a frame of its own while something else waits.
    fn accept(&mut self, moment: &Moment) -> bool {
        match (&mut self.waiting, moment) {
            (Waiting::Nothing, Moment::Codes(frame)) => self.waiting = Waiting::Codes(frame.clone()),
            (Waiting::Nothing, Moment::Silence(silence)) => self.waiting = Waiting::Silence(*silence),
            (Waiting::Nothing, Moment::Wrench(sample)) => {
                self.wrenches.clear();
                self.waiting = Waiting::Run(OpenRun {
                    kind: sample.measurement.kind(),
                    first: *sample,
                    last: *sample,
                    samples: 1,
                    status: sample.status,
                    parity: sample.parity,
                });
                self.keep(sample);
            }
            (Waiting::Run(run), Moment::Wrench(sample)) if run.is_continued_by(sample) => {
                run.last = *sample;
                run.samples += 1;
                run.status |= sample.status;
                run.parity = larger(run.parity, sample.parity);
                self.keep(sample);
            }
            _ => return false,
        }
        true
    }

    /// Whether what waits is to go now.
    fn is_due(&self, now: DeviceTime, line_is_idle: bool) -> bool {
        match &self.waiting {
            Waiting::Nothing => false,
            Waiting::Codes(_) | Waiting::Silence(_) => true,
            Waiting::Run(run) => {
                let at_next_sample =
                    micros_since(now, run.first.announced) + u64::from(run.last.period_nanos / 1000);
                usize::from(run.samples) >= MAX_RUN
                    || at_next_sample > LONGEST_WAIT_MICROS
                    || (line_is_idle && run.last.period_nanos >= EAGER_PERIOD_NANOS)
            }
        }
    }

    /// Takes what waits, as a message.
    fn take(&mut self, now: DeviceTime) -> Option<ToHost> {
        match core::mem::take(&mut self.waiting) {
            Waiting::Nothing => None,
            Waiting::Codes(frame) => Some(ToHost::Codes(frame)),
            Waiting::Silence(SilentMoment { next, time, status, cause }) => {
                Some(ToHost::Wrench(WrenchFrame {
                    first: next,
                    stride: 1,
                    time,
                    span_micros: 0,
                    age_micros: narrowed(micros_since(now, time)),
                    status,
                    temperature_centi_celsius: None,
                    run: Run::Invalid { cause, samples: 0 },
                }))
            }
            Waiting::Run(run) => self.pack(&run, now).map(ToHost::Wrench),
        }
    }

    fn keep(&mut self, sample: &WrenchMoment) {
        if let Measurement::Valid { wrench, .. } = sample.measurement {
            // A run that is full is due, so there is room.
            let _ = self.wrenches.push(wrench);
        }
    }

    fn pack(&self, run: &OpenRun, now: DeviceTime) -> Option<WrenchFrame> {
        let OpenRun { first, last, samples, .. } = *run;
        Some(WrenchFrame {
            first: first.index,
            stride: first.stride,
            time: first.time,
            span_micros: narrowed(micros_since(last.time, first.time)),
            age_micros: narrowed(micros_since(now, last.announced)),
            status: run.status,
            temperature_centi_celsius: None,
            run: match run.kind {
                Kind::Invalid(cause) => Run::Invalid { cause, samples },
                Kind::Valid { axes, calibration } => Run::Valid {
                    calibration,
                    parity: run.parity,
                    wrenches: PackedWrenches::pack(usize::from(axes), &self.wrenches)?,
                },
            },
        })
    }
}

/// The larger one, where there are any; what is not a number counts as larger than all.
pub(crate) fn larger(one: Option<f32>, other: Option<f32>) -> Option<f32> {
    match (one, other) {
        (Some(one), Some(other)) => Some(if one >= other || one.is_nan() { one } else { other }),
        (one, other) => one.or(other),
    }
}

fn narrowed(micros: u64) -> u32 {
    u32::try_from(micros).unwrap_or(u32::MAX)
}

const fn micros_since(now: DeviceTime, earlier: DeviceTime) -> u64 {
    now.as_micros().saturating_sub(earlier.as_micros())
}

#[cfg(test)]
mod tests;
