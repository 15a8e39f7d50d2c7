//! The host link, byte by byte: USART2 with a queue in either direction.
//!
//! The interrupt does nothing but move bytes between the line and the queues ([`Link::serve`]); it is the most urgent
//! of all, for the line keeps a single byte and the next is there 11 µs later. What the bytes mean is the business of a task
//! that nothing waits for. A byte that is damaged, or finds its queue full, is lost; its frame's checksum tells.
//!
//! To send, fill the [`Outbox`] and trigger the interrupt by hand; it keeps itself going until the queue is empty. (The
//! emulator raises no interrupt for an empty transmit register, and needs none: there, every byte is gone at once.)

use embedded_hal_nb::serial::{Read, Write};
use ftcal_shared::wire::ToHost;
use ftcal_shared::wire::frame::{FrameBytes, encode};
use heapless::spsc::{Consumer, Producer};
use stm32f4xx_hal::gpio::{PA2, PA3};
use stm32f4xx_hal::pac::USART2;
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::serial::config::Config;
use stm32f4xx_hal::serial::{Rx, RxListen, SerialExt, Tx, TxListen};
use stm32f4xx_hal::time::Bps;

/// Bits a second. 0.9 % off at 42 MHz, 2.1 % at 16 MHz; both ends together may be off by 3.3 %.
const BAUD: u32 = 921_600;

/// The interrupt's ends of the queues.
pub(crate) struct LinkQueues {
    /// Bytes from the host.
    pub(crate) received: Producer<'static, u8>,
    /// Bytes to the host.
    pub(crate) to_send: Consumer<'static, u8>,
}

/// The line's end of the link.
pub(crate) struct Link {
    rx: Rx<USART2>,
    tx: Tx<USART2>,
    queues: LinkQueues,
}

/// What the interrupt has done.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct Served {
    /// A byte came from the host.
    pub(crate) received: bool,
    /// The last byte to be sent has left its queue.
    pub(crate) sent_all: bool,
}

impl Link {
    pub(super) fn new(usart: USART2, tx: PA2, rx: PA3, queues: LinkQueues, rcc: &mut Rcc) -> Self {
        let config = Config::default().baudrate(Bps(BAUD));
        let Ok(serial) = usart.serial((tx, rx), config, rcc) else {
            unreachable!("the baud rate is below an eighth of either bus clock");
        };
        let (tx, mut rx) = serial.split();
        rx.listen();
        Self { rx, tx, queues }
    }

    /// Moves bytes, as far as that goes without waiting.
    pub(crate) fn serve(&mut self) -> Served {
        let received = self.rx.read().is_ok_and(|byte| self.queues.received.enqueue(byte).is_ok());
        let waiting = self.queues.to_send.ready();
        while let Some(&byte) = self.queues.to_send.peek() {
            if self.tx.write(byte).is_err() {
                self.tx.listen();
                return Served { received, sent_all: false };
            }
            self.queues.to_send.dequeue();
        }
        self.tx.unlisten();
        Served { received, sent_all: waiting }
    }
}

/// The frame that is on its way into the queue to the host.
pub(crate) struct Outbox {
    queue: Producer<'static, u8>,
    frame: FrameBytes,
    queued: usize,
}

impl Outbox {
    /// An empty outbox that fills this queue.
    pub(crate) const fn new(queue: Producer<'static, u8>) -> Self {
        Self { queue, frame: FrameBytes::new(), queued: 0 }
    }

    /// Queues as much of the frame as there is room for; whether that was all of it.
    pub(crate) fn flush(&mut self) -> bool {
        for &byte in self.frame.iter().skip(self.queued) {
            if self.queue.enqueue(byte).is_err() {
                return false;
            }
            self.queued += 1;
        }
        true
    }

    /// Whether nothing waits for the line.
    pub(crate) fn is_idle(&self) -> bool {
        self.queued == self.frame.len() && self.queue.is_empty()
    }

    /// Takes the next message. The one before must have been flushed: what is left of it is dropped.
    pub(crate) fn put(&mut self, message: &ToHost) {
        // Every message of the protocol fits into a frame; one that does not is not answered, which the host notices.
        self.frame = encode(message).unwrap_or_default();
        self.queued = 0;
    }
}
