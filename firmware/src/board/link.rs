//! The host link, byte by byte: USART3 with a queue in either direction.
//!
//! The interrupt does nothing but move bytes between the line and the queues ([`Link::serve`]); it is the most urgent
//! of all, for the line keeps a single byte and the next is there 11 µs later. What the bytes mean is the business of a task
//! that nothing waits for. A byte that is damaged, or finds its queue full, is lost; its frame's checksum tells.
//!
//! The rate changes between two frames: the session asks for it ([`Outbox::change_rate`]), and the interrupt sees to it when the last
//! bit has left, so that no byte is ever sent at two rates.
//!
//! To send, fill the [`Outbox`] and trigger the interrupt by hand; it keeps itself going until the queue is empty. (The
//! emulator raises no interrupt for an empty transmit register, and needs none: there, every byte is gone at once.)

use core::sync::atomic::{AtomicU32, Ordering};

use embedded_hal_nb::serial::{Read, Write};
use ftcal_firmware::baud::{DEFAULT_BAUD, Divisor, divisor};
use ftcal_shared::wire::ToHost;
use ftcal_shared::wire::frame::{FrameBytes, encode};
use heapless::spsc::{Consumer, Producer};
use stm32f4xx_hal::gpio::PushPull;
use stm32f4xx_hal::gpio::alt::usart3;
use stm32f4xx_hal::pac::USART3;
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::serial::config::Config;
use stm32f4xx_hal::serial::{Rx, RxListen, SerialExt, Tx, TxListen};
use stm32f4xx_hal::time::Bps;

/// The divisor to change to, as [`packed`]; zero where there is none.
static NEXT_DIVISOR: AtomicU32 = AtomicU32::new(0);

/// The interrupt's ends of the queues.
pub(crate) struct LinkQueues {
    /// Bytes from the host.
    pub(crate) received: Producer<'static, u8>,
    /// Bytes to the host.
    pub(crate) to_send: Consumer<'static, u8>,
}

/// The line's two wires.
pub(crate) struct Pins {
    pub(crate) tx: usart3::Tx<PushPull>,
    pub(crate) rx: usart3::Rx<PushPull>,
}

/// The line's end of the link.
pub(crate) struct Link {
    rx: Rx<USART3>,
    tx: Tx<USART3>,
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
    pub(super) fn new(usart: USART3, pins: Pins, queues: LinkQueues, rcc: &mut Rcc) -> Self {
        let config = Config::default().baudrate(Bps(DEFAULT_BAUD));
        let Ok(serial) = usart.serial((pins.tx, pins.rx), config, rcc) else {
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
        let changed = change_rate();
        Served { received, sent_all: waiting || changed }
    }
}

/// Changes the rate where that was asked for and the last bit has left; whether it has.
#[expect(unsafe_code, reason = "the HAL sets the rate once and for all")]
fn change_rate() -> bool {
    let next = NEXT_DIVISOR.load(Ordering::Acquire);
    if next == 0 {
        return false;
    }
    // SAFETY: this is the only place where the USART's registers are written, beside those of `Link`, which calls it.
    let usart = unsafe { &*USART3::ptr() };
    if usart.sr().read().tc().bit_is_clear() {
        return false;
    }
    usart.cr1().modify(|_, w| w.ue().clear_bit().over8().bit(next & EIGHT_SAMPLES != 0));
    // SAFETY: every value of the lower 16 bits is a divisor.
    usart.brr().write(|w| unsafe { w.bits((next & 0xffff) as _) });
    usart.cr1().modify(|_, w| w.ue().set_bit());
    NEXT_DIVISOR.store(0, Ordering::Release);
    true
}

/// Above the register's 16 bits.
const EIGHT_SAMPLES: u32 = 1 << 16;

/// A divisor as one number, which is never zero.
const fn packed(divisor: Divisor) -> u32 {
    divisor.register as u32 | if divisor.eight_samples { EIGHT_SAMPLES } else { 0 }
}

/// The frame that is on its way into the queue to the host.
pub(crate) struct Outbox {
    /// What the USART counts before it divides.
    clock_hertz: u32,
    queue: Producer<'static, u8>,
    frame: FrameBytes,
    queued: usize,
}

impl Outbox {
    /// An empty outbox that fills this queue.
    pub(crate) const fn new(queue: Producer<'static, u8>, clock_hertz: u32) -> Self {
        Self { clock_hertz, queue, frame: FrameBytes::new(), queued: 0 }
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

    /// Whether the board has this rate.
    pub(crate) fn has_rate(&self, baud: u32) -> bool {
        divisor(self.clock_hertz, baud).is_some()
    }

    /// Has the line change to this rate, which the board has, when all that was put has left. Nothing may be put meanwhile.
    pub(crate) fn change_rate(&self, baud: u32) {
        let divisor = divisor(self.clock_hertz, baud).map_or(0, packed);
        NEXT_DIVISOR.store(divisor, Ordering::Release);
    }

    /// Takes the next message. The one before must have been flushed: what is left of it is dropped.
    pub(crate) fn put(&mut self, message: &ToHost) {
        // Every message of the protocol fits into a frame; one that does not is not answered, which the host notices.
        self.frame = encode(message).unwrap_or_default();
        self.queued = 0;
    }
}

/// Whether the line has yet to change its rate.
pub(crate) fn is_changing_rate() -> bool {
    NEXT_DIVISOR.load(Ordering::Acquire) != 0
}
