//! The simulated board: the firmware's own application, fed by the bench instead of by hardware.
//!
//! ```text
//! bench ──data ready──► Sensor ──moments──► Batcher ──frames──► line ──► client
//!   ▲──── SPI bytes ─────┘ ▲──requests── Session ◄─────────────────────────┘
//! ```
//!
//! It does what the real board does, in virtual time: one conversion after the other, a tick every few milliseconds, a
//! serial line of [`BAUD_RATE`] with a buffer before it. A sample of the stream that finds its queue full is dropped and
//! counted, as on the board; a response always finds room. A trial is solved, and the memory written, between two
//! conversions; neither takes virtual time.
//!
//! Everything follows from the bench and from what is received when: the same calls give the same bytes.

use std::collections::VecDeque;
use std::time::Duration;

use embedded_hal::delay::DelayNs;
use ftcal_firmware::sensor::{LinkCounters, Reaction, Sensor};
use ftcal_firmware::session::{Session, hello};
use ftcal_firmware::storage::job::StoreJob;
use ftcal_firmware::storage::keeper::Keeper;
use ftcal_firmware::stream::{Batcher, Moment};
use ftcal_firmware::trial::SolveJob;
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::frame::{MAX_FRAME, encode};
use ftcal_shared::wire::{
    ClockSource, Diagnosis, Request, RequestId, ResetCause, Response, ToDevice, ToHost,
};
use thiserror::Error;

use super::bench::Bench;
use super::bus::SharedBench;
use super::flash::SimulatedFlash;
use super::scenario::Scenario;
use super::sensor::SoftwareSensor;
use crate::link::serial::BAUD_RATE;
use crate::link::transport::{Transport, TransportError};

/// Time between two ticks.
const TICK_MICROS: u64 = 5_000;
/// Bytes that wait for the line at most, beside responses.
const LINE_BUFFER: usize = 768;
/// Samples of the stream that wait at most.
const MOMENT_QUEUE: usize = 32;
/// Bits on the line for each byte: a start bit, eight of data, a stop bit.
const BITS_PER_BYTE: u64 = 10;

/// What a simulated board knows of itself: it never fails, and its stack is that of the simulator.
const DIAGNOSIS: Diagnosis =
    Diagnosis { reset: ResetCause::Unknown, failure: None, stack_used_bytes: 0, stack_bytes: 0 };

/// A board of any number of gages.
pub trait Board: Send {
    /// Takes in bytes from the host.
    fn receive(&mut self, bytes: &[u8]);

    /// Lives through one conversion period.
    fn advance(&mut self);

    /// Appends the bytes that the line has carried to the host by now.
    fn take_sent(&mut self, sent: &mut Vec<u8>);

    /// Virtual time since the board was switched on.
    fn now(&self) -> DeviceTime;
}

/// Why a sensor cannot be put on a board.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("the simulated board has 2 to 8 gages, not {gages}")]
pub struct UnsupportedGages {
    /// The sensor's gages.
    pub gages: usize,
}

/// A board with the bench it stands on.
pub struct SimulatedBoard {
    board: Box<dyn Board>,
    bench: SharedBench,
}

impl SimulatedBoard {
    /// A board with this scenario's sensor, just switched on for the first time.
    ///
    /// # Errors
    ///
    /// Never for the scenarios that there are.
    pub fn for_scenario(scenario: &Scenario, seed: u64) -> Result<Self, UnsupportedGages> {
        Self::new(scenario.sensor.clone(), seed)
    }

    /// A board with this sensor, just switched on for the first time.
    ///
    /// # Errors
    ///
    /// [`UnsupportedGages`].
    pub fn new(sensor: SoftwareSensor, seed: u64) -> Result<Self, UnsupportedGages> {
        Self::with_flash(sensor, seed, SimulatedFlash::default())
    }

    /// A board with this sensor and this flash, just switched on.
    ///
    /// # Errors
    ///
    /// [`UnsupportedGages`].
    pub fn with_flash(
        sensor: SoftwareSensor,
        seed: u64,
        flash: SimulatedFlash,
    ) -> Result<Self, UnsupportedGages> {
        let gages = sensor.gages();
        let bench = SharedBench::new(Bench::new(sensor, seed));
        let board: Box<dyn Board> = match gages {
            2 => Box::new(GageBoard::<2, { higher_moment_count(2) }>::new(bench.clone(), flash)),
            3 => Box::new(GageBoard::<3, { higher_moment_count(3) }>::new(bench.clone(), flash)),
            4 => Box::new(GageBoard::<4, { higher_moment_count(4) }>::new(bench.clone(), flash)),
            5 => Box::new(GageBoard::<5, { higher_moment_count(5) }>::new(bench.clone(), flash)),
            6 => Box::new(GageBoard::<6, { higher_moment_count(6) }>::new(bench.clone(), flash)),
            7 => Box::new(GageBoard::<7, { higher_moment_count(7) }>::new(bench.clone(), flash)),
            8 => Box::new(GageBoard::<8, { higher_moment_count(8) }>::new(bench.clone(), flash)),
            _ => return Err(UnsupportedGages { gages }),
        };
        Ok(Self { board, bench })
    }

    /// The bench under the board: to hang loads, turn the sensor and play faults while a client talks to the board.
    pub fn bench(&self) -> SharedBench {
        self.bench.clone()
    }

    /// The board alone.
    pub fn into_board(self) -> Box<dyn Board> {
        self.board
    }
}

/// The line of a simulated board: waiting for bytes is what makes its time pass.
impl Transport for SimulatedBoard {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        self.board.receive(bytes);
        Ok(())
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<(), TransportError> {
        let before = received.len();
        loop {
            self.board.take_sent(received);
            if received.len() > before || self.elapsed() >= deadline {
                return Ok(());
            }
            self.board.advance();
        }
    }

    fn elapsed(&self) -> Duration {
        Duration::from_micros(self.board.now().as_micros())
    }
}

type Store<const GAGES: usize, const HIGHER: usize> = Box<Bins<GAGES, HIGHER>>;

/// A board with `GAGES` gages.
struct GageBoard<const GAGES: usize, const HIGHER: usize> {
    bench: SharedBench,
    sensor: Sensor<SharedBench, Store<GAGES, HIGHER>, GAGES, HIGHER>,
    session: Session,
    keeper: Keeper<SimulatedFlash>,
    solving: Option<(RequestId, SolveJob<Store<GAGES, HIGHER>, GAGES, HIGHER>)>,
    storing: Option<(RequestId, StoreJob)>,
    next_tick: DeviceTime,
    moments: VecDeque<Moment>,
    dropped_samples: u32,
    batcher: Batcher,
    line: Line,
}

impl<const GAGES: usize, const HIGHER: usize> GageBoard<GAGES, HIGHER> {
    fn new(bench: SharedBench, flash: SimulatedFlash) -> Self {
        let store = Box::new(Bins::new());
        let mut keeper = Keeper::new(flash);
        let mut sensor = Sensor::new(bench.clone(), store, ClockSource::Simulated);
        let found = keeper.start(&mut sensor);
        sensor.restore(found);
        Self {
            sensor,
            bench,
            session: Session::new(),
            keeper,
            solving: None,
            storing: None,
            next_tick: DeviceTime::default(),
            moments: VecDeque::new(),
            dropped_samples: 0,
            batcher: Batcher::new(),
            line: Line::default(),
        }
    }

    fn on_message(&mut self, message: ToDevice) {
        match message {
            ToDevice::Hello => self.line.send(&ToHost::Hello(hello())),
            ToDevice::Request(id, request) => self.on_request(id, request),
        }
    }

    fn on_request(&mut self, id: RequestId, request: Request) {
        let counters = LinkCounters {
            dropped_samples: self.dropped_samples,
            broken_frames: self.session.broken_frames(),
        };
        if matches!(request, Request::Stream(_)) {
            // What of the stream before has not gone yet is not sent any more.
            self.moments.clear();
            self.batcher.clear();
        }
        match self.sensor.answer(request, self.now(), counters) {
            Reaction::Respond(response) => self.line.send(&ToHost::Response(id, response)),
            Reaction::Solve(job) => self.solving = Some((id, job)),
            Reaction::Diagnose => self.line.send(&ToHost::Response(id, Response::Diagnosis(DIAGNOSIS))),
            Reaction::Store(job) => self.storing = Some((id, job)),
        }
    }

    fn stream(&mut self, moment: Option<Moment>) {
        let Some(moment) = moment else { return };
        if self.moments.len() < MOMENT_QUEUE {
            self.moments.push_back(moment);
        } else {
            self.dropped_samples = self.dropped_samples.wrapping_add(1);
        }
    }

    /// Puts what of the stream is due into the line's buffer, as far as there is room.
    fn feed_line(&mut self) {
        let now = self.now();
        while self.line.waiting.len() + MAX_FRAME <= LINE_BUFFER {
            let line_is_idle = self.line.waiting.is_empty();
            let due = self.batcher.next(now, line_is_idle, || self.moments.pop_front());
            let Some(message) = due else { return };
            self.line.send(&message);
        }
    }
}

impl<const GAGES: usize, const HIGHER: usize> Board for GageBoard<GAGES, HIGHER> {
    fn receive(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            if let Some(message) = self.session.on_byte(byte) {
                self.on_message(message);
            }
        }
    }

    fn advance(&mut self) {
        if self.now() >= self.next_tick {
            let now = self.now();
            self.next_tick = DeviceTime::from_micros(now.as_micros() + TICK_MICROS);
            let moment = self.sensor.tick(now, &mut VirtualDelay { bench: &self.bench });
            self.stream(moment);
        }
        if let Some((id, mut job)) = self.solving.take() {
            let response = job.response();
            self.sensor.finish_solving(job);
            self.line.send(&ToHost::Response(id, response));
        }
        if let Some((id, job)) = self.storing.take() {
            let response = self.sensor.finish_storing(self.keeper.run(&job));
            self.line.send(&ToHost::Response(id, response));
        }
        self.keeper.attend(self.now(), &mut self.sensor);
        let announced = self.bench.with(Bench::next_conversion);
        let now = self.now();
        if announced {
            let moment = self.sensor.on_data_ready(now, now);
            self.stream(moment);
        }
        self.line.carry_until(now);
        self.feed_line();
    }

    fn take_sent(&mut self, sent: &mut Vec<u8>) {
        sent.append(&mut self.line.carried);
    }

    fn now(&self) -> DeviceTime {
        self.bench.with(|bench| bench.now())
    }
}

/// The serial line towards the host: bytes leave the buffer at the line's speed.
#[derive(Default)]
struct Line {
    waiting: VecDeque<u8>,
    carried: Vec<u8>,
    carried_until: DeviceTime,
    /// What the line could have carried beyond whole bytes, in bit times of a million microseconds.
    remainder: u64,
}

impl Line {
    fn send(&mut self, message: &ToHost) {
        // Every message of the protocol fits into a frame, which the golden bytes of the largest ones attest.
        if let Ok(bytes) = encode(message) {
            self.waiting.extend(bytes);
        }
    }

    fn carry_until(&mut self, now: DeviceTime) {
        let micros = now.as_micros().saturating_sub(self.carried_until.as_micros());
        self.carried_until = now;
        // Microseconds times bits a second: a byte takes ten million of these.
        let per_byte = BITS_PER_BYTE * 1_000_000;
        let capacity = micros * u64::from(BAUD_RATE) + self.remainder;
        let bytes = usize::try_from(capacity / per_byte).unwrap_or(usize::MAX).min(self.waiting.len());
        self.remainder = if self.waiting.len() > bytes { capacity % per_byte } else { 0 };
        self.carried.extend(self.waiting.drain(..bytes));
    }
}

/// Waiting lets the bench's time pass; conversions that end meanwhile are announced to nobody.
struct VirtualDelay<'a> {
    bench: &'a SharedBench,
}

impl DelayNs for VirtualDelay<'_> {
    fn delay_ns(&mut self, nanoseconds: u32) {
        self.bench.with(|bench| {
            let end = bench.now().as_micros() + u64::from(nanoseconds).div_ceil(1000);
            while bench.now().as_micros() < end {
                bench.next_conversion();
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use ftcal_shared::units::{DataRate, Dof, Gain};
    use ftcal_shared::wire::StreamKind;
    use nalgebra::{DMatrix, DVector};

    use super::{Bench, LINE_BUFFER, MOMENT_QUEUE, SimulatedBoard, UnsupportedGages};
    use crate::link::client::Client;
    use crate::link::serial::BAUD_RATE;
    use crate::link::transport::Transport;
    use crate::simulator::scenario::{Scenario, ScenarioKind};
    use crate::simulator::sensor::SoftwareSensor;

    fn board(kind: ScenarioKind) -> SimulatedBoard {
        SimulatedBoard::for_scenario(&Scenario::new(kind, 7).expect("sizes fit"), 7).expect("sizes fit")
    }

    #[test]
    fn the_same_calls_give_the_same_frames() {
        let run = || {
            let board = board(ScenarioKind::Wrist);
            board.bench().with(Bench::turn);
            let mut client = Client::connect(board).expect("answers");
            client.wait_for_converter().expect("the converter starts");
            client.stream(StreamKind::Codes).expect("answers");
            let next = |_| client.next_frame(Duration::from_secs(1)).expect("the line is sound");
            (0..500).map(next).collect::<Vec<_>>()
        };
        assert_eq!(run(), run());
    }

    #[test]
    fn what_does_not_fit_on_the_line_is_dropped_and_counted_and_responses_get_through() {
        let mut client = Client::connect(board(ScenarioKind::Wrist)).expect("answers");
        client.configure_adc(DataRate::Hz32000, Gain::X128).expect("the converter starts");
        client.stream(StreamKind::Codes).expect("answers");
        let before = client.status().expect("answers");
        let lost_before = client.lost_samples();
        let mut streamed = 0_u32;
        let begin = client.line().elapsed();
        while client.line().elapsed() < begin + Duration::from_secs(1) {
            streamed +=
                u32::from(client.next_frame(Duration::from_secs(1)).expect("the line is sound").is_some());
        }
        let status = client.status().expect("answers");
        let dropped = status.dropped_samples - before.dropped_samples;
        let converted = status.conversions - before.conversions;
        // A frame of eight codes has 30 bytes at least, so the line cannot carry more than these.
        let waiting = u32::try_from(LINE_BUFFER / 30 + MOMENT_QUEUE).expect("fits");
        let room = BAUD_RATE / 10 / 30 + waiting;
        assert!(streamed <= room, "{streamed}");
        // What was neither streamed nor dropped was waiting at either end of the second.
        assert!(converted.abs_diff(streamed + dropped) <= 2 * waiting, "{converted} {streamed} {dropped}");
        // The host has noticed what it did not get, but for what is missing between the samples that are waiting.
        let lost = client.lost_samples() - lost_before;
        let unnoticed = 2 * waiting * converted.div_ceil(streamed);
        assert!(lost.abs_diff(u64::from(dropped)) <= u64::from(unnoticed), "{lost} {dropped}");
    }

    #[test]
    fn a_board_has_two_to_eight_gages() {
        for gages in 1..=8 {
            let shape = DMatrix::from_element(2, gages, 1.0);
            let zeros = DVector::zeros(gages);
            let sensor =
                SoftwareSensor::new(Dof::PlanarForce, shape, zeros.clone(), zeros).expect("sizes fit");
            match SimulatedBoard::new(sensor, 1) {
                Ok(board) => {
                    let mut client = Client::connect(board).expect("answers");
                    assert_eq!(usize::from(client.status().expect("answers").gages), gages);
                }
                Err(error) => assert_eq!((error, gages), (UnsupportedGages { gages: 1 }, 1)),
            }
        }
    }
}
