//! Whatever comes over the line, the sensor goes on: it panics nowhere, what it sends is whole, and a greeting is answered.
#![no_main]

mod framed;

use ftcal_firmware::polled::{EmptyBus, NoDelay, PolledSensor};
use ftcal_firmware::sensor::{LinkCounters, Reaction};
use ftcal_firmware::session::{Order, Session};
use ftcal_firmware::storage::job::{StoreJob, Stored};
use ftcal_firmware::storage::memory::StorageError;
use ftcal_firmware::stream::Batcher;
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::frame::encode;
use ftcal_shared::wire::{ClockSource, Response, ToDevice, ToHost};
use libfuzzer_sys::fuzz_target;

const GAGES: usize = 4;
const HIGHER: usize = higher_moment_count(GAGES);

struct Board {
    polled: PolledSensor<EmptyBus, Box<Bins<GAGES, HIGHER>>, GAGES, HIGHER>,
    session: Session,
    batcher: Batcher,
    now: DeviceTime,
}

impl Board {
    fn new() -> Self {
        Self {
            polled: PolledSensor::new(EmptyBus, Box::new(Bins::new()), ClockSource::Simulated),
            session: Session::new(),
            batcher: Batcher::new(),
            now: DeviceTime::default(),
        }
    }

    /// What the board sends about this byte.
    fn receive(&mut self, byte: u8) -> Option<ToHost> {
        match self.session.on_byte(byte, self.now)? {
            Order::Send(message) => Some(message),
            Order::ChangeRate(ticket, baud) => {
                self.session.rate_changed(baud, self.now);
                self.session.answer(ticket, Response::Done)
            }
            Order::Serve(ticket, request) => {
                match self.polled.sensor.answer(request, self.now, LinkCounters::default()) {
                    Reaction::Respond(answer) => self.session.answer(ticket, answer),
                    Reaction::Diagnose => self.session.answer(ticket, Response::Done),
                    Reaction::Store(job) => {
                        // This sensor's memory is defective; a trial needs none.
                        let stored = match job {
                            StoreJob::PrepareTrial { rank, .. } => Stored::Prepared { rank },
                            _ => Stored::Failed(StorageError::Flash),
                        };
                        let answer = self.polled.sensor.finish_storing(stored);
                        self.session.answer(ticket, answer)
                    }
                    Reaction::Solve(mut job) => {
                        let answer = job.response();
                        self.polled.sensor.finish_solving(job);
                        self.session.answer(ticket, answer)
                    }
                }
            }
        }
    }

    fn live(&mut self, micros: u64) -> Option<ToHost> {
        self.now = DeviceTime::from_micros(self.now.as_micros() + micros);
        let mut moment = self.polled.tick(self.now, &mut NoDelay);
        if self.session.watch(self.now).end_stream {
            self.polled.sensor.abandon_stream();
        }
        self.batcher.next(self.now, true, || moment.take())
    }
}

fuzz_target!(|input: &[u8]| {
    let mut board = Board::new();
    let whole = |message: ToHost| assert!(encode(&message).is_ok(), "{message:?} does not fit into a frame");
    for (kind, bytes) in framed::pieces(input) {
        bytes.iter().filter_map(|&byte| board.receive(byte)).for_each(whole);
        // Up to a second and a half passes before the next.
        board.live(u64::from(kind >> 3) * 50_000).into_iter().for_each(whole);
    }
    let greeting = encode(&ToDevice::Hello).expect("it is short");
    let answers: Vec<_> = [0].iter().chain(&greeting).filter_map(|&byte| board.receive(byte)).collect();
    assert!(matches!(answers.last(), Some(ToHost::Hello(_))), "{answers:?}");
});
