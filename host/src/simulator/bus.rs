//! The bench as a driver sees it: an SPI device of the `embedded-hal` traits.
//!
//! The driver owns its bus while somebody else moves the bench's time, hangs loads on it and injects faults; both hold
//! the same bench. One transaction is one chip-select frame: whatever it writes, reads and transfers is clocked in one
//! piece, with zeros to the converter during reads.

use std::sync::{Arc, Mutex, PoisonError};

use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use ftcal_firmware::tunnel::{gather, scatter};

use super::bench::Bench;

/// One bench in several hands.
#[derive(Clone, Debug)]
pub struct SharedBench {
    bench: Arc<Mutex<Bench>>,
}

impl SharedBench {
    /// Shares this bench.
    pub fn new(bench: Bench) -> Self {
        Self { bench: Arc::new(Mutex::new(bench)) }
    }

    /// Does something with the bench while nobody else can.
    pub fn with<T>(&self, act: impl FnOnce(&mut Bench) -> T) -> T {
        // Every state of a bench is a valid one, also that in which a panicking thread left it.
        act(&mut self.bench.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl ErrorType for SharedBench {
    /// The transaction is longer than any frame of the converter.
    type Error = ErrorKind;
}

impl SpiDevice<u8> for SharedBench {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        let from_host = gather(operations).ok_or(ErrorKind::Other)?;
        let mut to_host = from_host.clone();
        to_host.fill(0);
        self.with(|bench| bench.exchange(&from_host, &mut to_host));
        scatter(&to_host, operations);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use embedded_hal::spi::{Operation, SpiDevice};

    use super::SharedBench;
    use crate::simulator::bench::Bench;
    use crate::simulator::scenario::{Scenario, ScenarioKind};

    fn bus() -> SharedBench {
        let sensor = Scenario::new(ScenarioKind::Fingertip, 1).expect("sizes fit").sensor;
        SharedBench::new(Bench::new(sensor, 1))
    }

    /// Reads the identity: a command frame, then a frame with its response.
    const READ_ID: [u8; 30] = {
        let mut frame = [0; 30];
        frame[0] = 0xA0;
        frame
    };

    #[test]
    fn operations_of_one_transaction_are_one_frame() {
        let mut whole = bus();
        let mut in_pieces = bus();
        let mut expected = READ_ID;
        whole.transfer_in_place(&mut expected).expect("short enough");
        let (mut middle, mut end) = ([0; 7], [0; 20]);
        let mut start = [0xA0, 0, 0];
        in_pieces
            .transaction(&mut [
                Operation::TransferInPlace(&mut start),
                Operation::DelayNs(1000),
                Operation::Transfer(&mut middle, &[0; 3]),
                Operation::Read(&mut end),
            ])
            .expect("short enough");
        assert_eq!([start.as_slice(), &middle, &end].concat(), expected);

        whole.write(&READ_ID).expect("short enough");
        whole.read(&mut expected).expect("short enough");
        assert_eq!(expected[0], 0x28);
    }

    #[test]
    fn separate_transactions_are_separate_frames() {
        let mut bus = bus();
        bus.write(&READ_ID[..3]).expect("short enough");
        let mut response = [0; 3];
        bus.read(&mut response).expect("short enough");
        assert_eq!(response[0], 0x28);
    }

    #[test]
    fn a_clone_is_the_same_bench() {
        let bus = bus();
        let other = bus.clone();
        let before = other.with(|bench| bench.now());
        bus.with(Bench::next_conversion);
        assert!(other.with(|bench| bench.now()) > before);
    }
}
