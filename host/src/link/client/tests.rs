//! What the tests have in common: a simulated board, and lines that do something to what passes.

mod faults;
mod line;
mod requests;
mod stream;

use std::time::Duration;

use ftcal_shared::units::{Dof, Gain};
use ftcal_shared::wire::frame::{Decoder, encode};
use ftcal_shared::wire::{CalibrationUpload, GageList, Hello, PRODUCT, PROTOCOL_VERSION, ToDevice, ToHost};

use super::Client;
use crate::link::transport::{Transport, TransportError};
use crate::simulator::board::SimulatedBoard;
use crate::simulator::scenario::{Scenario, ScenarioKind};

fn board(kind: ScenarioKind) -> SimulatedBoard {
    let scenario = Scenario::new(kind, 1).expect("sizes fit");
    let board = SimulatedBoard::for_scenario(&scenario, 1).expect("sizes fit");
    board.bench().with(|bench| bench.hang(scenario.trials[0].load));
    board
}

fn client(kind: ScenarioKind) -> Client<SimulatedBoard> {
    Client::connect(board(kind)).expect("the simulated board answers")
}

/// A calibration that reads the first two gages as forces in the plane, in counts.
fn first_gages(gages: usize) -> CalibrationUpload {
    let mut matrix = heapless::Vec::new();
    for axis in 0..2 {
        for gage in 0..gages {
            matrix.push(if axis == gage { 1.0 } else { 0.0 }).expect("fits");
        }
    }
    let mut bias_counts = GageList::new();
    bias_counts.resize(gages, 0.0).expect("fits");
    let mut upload =
        CalibrationUpload { dof: Dof::PlanarForce, gain: Gain::default(), bias_counts, matrix, identity: 0 };
    upload.identity = upload.identity_of_numbers();
    upload
}

/// The calibration that the sensor of this client has in truth.
fn true_calibration(client: &Client<SimulatedBoard>) -> CalibrationUpload {
    let sensor = client.line().bench().with(|bench| bench.sensor().clone());
    let matrix = sensor.shape().transpose().pseudo_inverse(1e-12).expect("the tolerance is not negative");
    // Row by row; nalgebra stores column by column.
    let elements = matrix.transpose();
    #[expect(clippy::cast_possible_truncation, reason = "the sensor applies single precision")]
    let mut upload = CalibrationUpload {
        dof: sensor.dof(),
        gain: Gain::default(),
        bias_counts: GageList::from_slice(sensor.bias_counts().as_slice()).expect("fits"),
        matrix: elements.iter().map(|&element| element as f32).collect(),
        identity: 0,
    };
    upload.identity = upload.identity_of_numbers();
    upload
}

/// A line that does something to what passes over it.
struct Tampered<Tamper> {
    board: SimulatedBoard,
    tamper: Tamper,
    writes: usize,
}

impl<Tamper: FnMut(usize, &mut Vec<u8>)> Tampered<Tamper> {
    fn new(tamper: Tamper) -> Self {
        Self { board: board(ScenarioKind::Fingertip), tamper, writes: 0 }
    }
}

/// `tamper` sees the number of messages sent so far and what has come back.
impl<Tamper: FnMut(usize, &mut Vec<u8>)> Transport for Tampered<Tamper> {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        self.writes += usize::from(bytes.len() > 1);
        self.board.write(bytes)
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<Duration, TransportError> {
        let mut passing = Vec::new();
        let arrived = self.board.read(&mut passing, deadline)?;
        (self.tamper)(self.writes, &mut passing);
        received.append(&mut passing);
        Ok(arrived)
    }

    fn elapsed(&self) -> Duration {
        self.board.elapsed()
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
        self.board.set_baud(baud)
    }
}

/// A line whose other end answers as told.
struct Scripted<Answer> {
    answer: Answer,
    decoder: Decoder,
    pending: Vec<u8>,
    now: Duration,
}

impl<Answer: FnMut(ToDevice) -> Option<ToHost>> Scripted<Answer> {
    fn new(answer: Answer) -> Self {
        Self { answer, decoder: Decoder::new(), pending: Vec::new(), now: Duration::ZERO }
    }
}

impl<Answer: FnMut(ToDevice) -> Option<ToHost>> Transport for Scripted<Answer> {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        for &byte in bytes {
            if let Some(message) = self.decoder.push(byte)
                && let Some(answer) = (self.answer)(message.expect("the client sends whole frames"))
            {
                self.pending.extend(encode(&answer).expect("fits"));
            }
        }
        Ok(())
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<Duration, TransportError> {
        if self.pending.is_empty() {
            self.now = self.now.max(deadline);
        }
        received.append(&mut self.pending);
        Ok(self.now)
    }

    fn elapsed(&self) -> Duration {
        self.now
    }

    fn set_baud(&mut self, _baud: u32) -> Result<(), TransportError> {
        Ok(())
    }
}

const HELLO: Hello =
    Hello { product: PRODUCT, protocol_version: PROTOCOL_VERSION, firmware_version: [1, 2, 3] };
