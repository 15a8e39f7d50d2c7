//! Emulated boards on busy machines, which stand still for seconds.

use std::fmt::Display;
use std::time::{Duration, Instant};

use ftcal::link::client::Client;
use ftcal::link::serial::SerialTransport;
use ftcal::simulator::emulator::Emulator;

/// How long anything may take on a busy machine.
pub const PATIENCE: Duration = Duration::from_mins(1);

/// Asks again where there is no answer, or none of use, for at most [`PATIENCE`].
///
/// # Panics
///
/// Where there is none then.
pub fn patiently<Answer, Problem: Display>(mut ask: impl FnMut() -> Result<Answer, Problem>) -> Answer {
    let begin = Instant::now();
    loop {
        match ask() {
            Ok(answer) => return answer,
            Err(error) => assert!(begin.elapsed() < PATIENCE, "{error}"),
        }
    }
}

/// Connects to an emulated board.
///
/// # Panics
///
/// Where its port cannot be opened, or it does not answer in time.
pub fn connect(emulator: &Emulator) -> Client<SerialTransport> {
    let path = emulator.link().to_str().expect("QEMU names it in ASCII");
    patiently(|| Client::connect(SerialTransport::open(path).expect("nobody else has it open")))
}
