//! The simulated board: the firmware's own application, fed by the bench instead of by hardware.
//!
//! ```text
//! bench ──data ready──► Acquisition ──readings──► Sensor ──moments──► Batcher ──frames──► line ──► client
//!   ▲──── SPI bytes ─────┘                          ▲──requests── Session ◄─────────────────────────┘
//! ```
//!
//! It does what the real board does, in virtual time: one conversion after the other, a tick every few milliseconds, a
//! serial line with a rate that can be changed and a buffer before it. A sample of the stream that finds its queue full is
//! dropped and counted, as on the board; a response always finds room. A trial is solved, and the memory written, between two
//! conversions; neither takes virtual time.
//!
//! Everything follows from the bench and from what is received when: the same calls give the same bytes.

use std::collections::VecDeque;
use std::time::Duration;

use embedded_hal::delay::DelayNs;
use ftcal_firmware::baud::{DEFAULT_BAUD, divisor};
use ftcal_firmware::polled::PolledSensor;
use ftcal_firmware::sensor::{LinkCounters, Reaction};
use ftcal_firmware::session::{Order, Session, Ticket};
use ftcal_firmware::storage::job::StoreJob;
use ftcal_firmware::storage::keeper::Keeper;
use ftcal_firmware::stream::{Batcher, Moment};
use ftcal_firmware::trial::SolveJob;
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::frame::MAX_FRAME;
use ftcal_shared::wire::{ClockSource, Diagnosis, Rejection, Request, ResetCause, Response};
use thiserror::Error;

use super::bench::Bench;
use super::bus::SharedBench;
use super::flash::SimulatedFlash;
use super::line::Line;
use super::panel::SharedPanel;
use super::scenario::Scenario;
use super::sensor::SoftwareSensor;
use crate::link::transport::{Transport, TransportError};

/// Time between two ticks.
const TICK_MICROS: u64 = 2_000;
/// Bytes that wait for the line at most, beside responses.
const LINE_BUFFER: usize = 640;
/// Samples of the stream that wait at most.
const MOMENT_QUEUE: usize = 16;
/// What the simulated serial port divides its rates from, as on the real board.
const LINE_CLOCK_HERTZ: u32 = 42_000_000;
/// What a byte becomes at the wrong rate, at either end, whatever it was.
const GARBLED: u8 = 0xE0;

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

    /// The rate of the board's serial port.
    fn baud(&self) -> u32;

    /// Has its counters soon begin at zero again.
    fn count_on(&mut self);
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
    panel: SharedPanel,
    /// The rate at the host's end.
    baud: u32,
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
        let panel = SharedPanel::default();
        let (on, at) = (bench.clone(), panel.clone());
        let board: Box<dyn Board> = match gages {
            2 => Box::new(GageBoard::<2, { higher_moment_count(2) }>::new(on, at, flash)),
            3 => Box::new(GageBoard::<3, { higher_moment_count(3) }>::new(on, at, flash)),
            4 => Box::new(GageBoard::<4, { higher_moment_count(4) }>::new(on, at, flash)),
            5 => Box::new(GageBoard::<5, { higher_moment_count(5) }>::new(on, at, flash)),
            6 => Box::new(GageBoard::<6, { higher_moment_count(6) }>::new(on, at, flash)),
            7 => Box::new(GageBoard::<7, { higher_moment_count(7) }>::new(on, at, flash)),
            8 => Box::new(GageBoard::<8, { higher_moment_count(8) }>::new(on, at, flash)),
            _ => return Err(UnsupportedGages { gages }),
        };
        Ok(Self { board, bench, panel, baud: DEFAULT_BAUD })
    }

    /// The same board, whose counters soon begin at zero again.
    ///
    /// # Errors
    ///
    /// [`UnsupportedGages`].
    pub fn about_to_wrap(sensor: SoftwareSensor, seed: u64) -> Result<Self, UnsupportedGages> {
        let mut board = Self::new(sensor, seed)?;
        board.board.count_on();
        Ok(board)
    }

    /// The bench under the board: to hang loads, turn the sensor and play faults while a client talks to the board.
    pub fn bench(&self) -> SharedBench {
        self.bench.clone()
    }

    /// The button and the light of the board: to press the one and to see the other while a client talks to the board.
    pub fn panel(&self) -> SharedPanel {
        self.panel.clone()
    }

    /// The board alone.
    pub fn into_board(self) -> Box<dyn Board> {
        self.board
    }
}

/// The line of a simulated board: waiting for bytes is what makes its time pass.
impl Transport for SimulatedBoard {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        if self.baud == self.board.baud() {
            self.board.receive(bytes);
        } else {
            self.board.receive(&vec![GARBLED; bytes.len()]);
        }
        Ok(())
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<Duration, TransportError> {
        let before = received.len();
        loop {
            self.board.take_sent(received);
            if self.baud != self.board.baud() {
                received.iter_mut().skip(before).for_each(|byte| *byte = GARBLED);
            }
            if received.len() > before || self.elapsed() >= deadline {
                return Ok(self.elapsed());
            }
            self.board.advance();
        }
    }

    fn elapsed(&self) -> Duration {
        Duration::from_micros(self.board.now().as_micros())
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
        self.baud = baud;
        Ok(())
    }
}

type Store<const GAGES: usize, const HIGHER: usize> = Box<Bins<GAGES, HIGHER>>;

/// A board with `GAGES` gages.
struct GageBoard<const GAGES: usize, const HIGHER: usize> {
    bench: SharedBench,
    polled: PolledSensor<SharedBench, Store<GAGES, HIGHER>, GAGES, HIGHER>,
    session: Session,
    keeper: Keeper<SimulatedFlash>,
    solving: Option<(Ticket, SolveJob<Store<GAGES, HIGHER>, GAGES, HIGHER>)>,
    storing: Option<(Ticket, StoreJob)>,
    next_tick: DeviceTime,
    moments: VecDeque<Moment>,
    dropped_samples: u32,
    batcher: Batcher,
    line: Line,
    panel: SharedPanel,
}

impl<const GAGES: usize, const HIGHER: usize> GageBoard<GAGES, HIGHER> {
    fn new(bench: SharedBench, panel: SharedPanel, flash: SimulatedFlash) -> Self {
        let store = Box::new(Bins::new());
        let mut keeper = Keeper::new(flash);
        let mut polled = PolledSensor::new(bench.clone(), store, ClockSource::Simulated);
        let found = keeper.start(&mut polled.sensor);
        polled.sensor.restore(found);
        Self {
            polled,
            bench,
            session: Session::new(),
            keeper,
            solving: None,
            storing: None,
            next_tick: DeviceTime::default(),
            moments: VecDeque::new(),
            dropped_samples: 0,
            batcher: Batcher::new(),
            line: Line::new(),
            panel,
        }
    }

    fn on_order(&mut self, order: Order) {
        match order {
            Order::Send(message) => self.line.send(&message),
            Order::Serve(ticket, request) => self.on_request(ticket, request),
            Order::ChangeRate(ticket, baud) if divisor(LINE_CLOCK_HERTZ, baud).is_some() => {
                self.respond(ticket, Response::Done);
                self.change_rate(baud);
            }
            Order::ChangeRate(ticket, _) => {
                self.respond(ticket, Response::Rejected(Rejection::UnsupportedRate));
            }
        }
    }

    fn respond(&mut self, ticket: Ticket, response: Response) {
        if let Some(message) = self.session.answer(ticket, response) {
            self.line.send(&message);
        }
    }

    /// Changes the line's rate when all that waits has left.
    fn change_rate(&mut self, baud: u32) {
        self.line.change_rate(baud);
        self.session.rate_changed(baud, self.now());
    }

    /// Ends what a host that has gone has left running.
    fn watch_host(&mut self, now: DeviceTime) {
        let silence = self.session.watch(now);
        if silence.end_stream {
            self.polled.sensor.abandon_stream();
        }
        if silence.fall_back {
            self.change_rate(DEFAULT_BAUD);
        }
    }

    fn on_request(&mut self, ticket: Ticket, request: Request) {
        let counters = LinkCounters {
            dropped_samples: self.dropped_samples,
            broken_frames: self.session.broken_frames(),
        };
        if matches!(request, Request::Stream(_)) {
            // What of the stream before has not gone yet is not sent any more.
            self.moments.clear();
            self.batcher.clear();
        }
        match self.polled.sensor.answer(request, self.now(), counters) {
            Reaction::Respond(response) => self.respond(ticket, response),
            Reaction::Solve(job) => self.solving = Some((ticket, job)),
            Reaction::Diagnose => self.respond(ticket, Response::Diagnosis(DIAGNOSIS)),
            Reaction::Store(job) => self.storing = Some((ticket, job)),
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
        while !self.line.is_changing_rate() && self.line.waiting() + MAX_FRAME <= LINE_BUFFER {
            let line_is_idle = self.line.waiting() == 0;
            let due = self.batcher.next(now, line_is_idle, || self.moments.pop_front());
            let Some(message) = due else { return };
            self.line.send(&message);
        }
    }
}

impl<const GAGES: usize, const HIGHER: usize> Board for GageBoard<GAGES, HIGHER> {
    fn receive(&mut self, bytes: &[u8]) {
        let now = self.now();
        for &byte in bytes {
            if let Some(order) = self.session.on_byte(byte, now) {
                self.on_order(order);
            }
        }
    }

    fn advance(&mut self) {
        if self.now() >= self.next_tick {
            let now = self.now();
            self.next_tick = DeviceTime::from_micros(now.as_micros() + TICK_MICROS);
            let moment = self.polled.tick(now, &mut VirtualDelay { bench: &self.bench });
            self.stream(moment);
            self.panel.set_light(self.polled.sensor.attend_panel(now, self.panel.is_pressed()));
            self.watch_host(now);
        }
        if let Some((ticket, mut job)) = self.solving.take() {
            let response = job.response();
            self.polled.sensor.finish_solving(job);
            self.respond(ticket, response);
        }
        if let Some((ticket, job)) = self.storing.take() {
            let response = self.polled.sensor.finish_storing(self.keeper.run(&job));
            self.respond(ticket, response);
        }
        if let Some(task) = self.polled.sensor.field_task(self.now()) {
            let done = task.run(&mut self.keeper);
            self.polled.sensor.finish_field(done, self.now());
        }
        if let Some(job) = self.polled.sensor.housekeeping(self.now()) {
            // It was nobody's request.
            let _ = self.polled.sensor.finish_storing(self.keeper.run(&job));
        }
        self.keeper.attend(self.now(), &mut self.polled.sensor);
        let announced = self.bench.with(Bench::next_conversion);
        let now = self.now();
        if announced {
            let moment = self.polled.on_data_ready(now, now);
            self.stream(moment);
        }
        self.line.carry_until(now);
        self.feed_line();
    }

    fn take_sent(&mut self, sent: &mut Vec<u8>) {
        self.line.take_carried(sent);
    }

    fn now(&self) -> DeviceTime {
        self.bench.with(|bench| bench.now())
    }

    fn baud(&self) -> u32 {
        self.line.baud()
    }

    fn count_on(&mut self) {
        self.polled.count_on();
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
mod tests;
