//! The converter behind the tunnel: USART3 instead of SPI2, for an emulator that has no converter. For the protocol see
//! [`ftcal_firmware::tunnel`].
//!
//! The serial interrupt puts bytes together to messages, and raises the interrupt that the data-ready pin would raise. The
//! data-ready *line* is modelled with its level: it stands low from the announcement to the next transfer, so that a conversion
//! that was read meanwhile is not announced again.

use core::cell::RefCell;

use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use embedded_hal::spi::{Error, ErrorKind, ErrorType, Operation, SpiDevice};
use embedded_hal_nb::serial::{Read, Write};
use ftcal_firmware::tunnel::{ANSWER_MICROS, FromConverter, Transfer, gather, scatter};
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::frame::{Decoder, encode};
use stm32f4xx_hal::gpio::gpiob::Parts;
use stm32f4xx_hal::pac::{EXTI, Interrupt, SPI2, SYSCFG, USART3, interrupt};
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::serial::config::Config;
use stm32f4xx_hal::serial::{Rx, RxListen, SerialExt, Tx};
use stm32f4xx_hal::time::Bps;

use super::time_base;

/// The emulator does not care.
const BAUD: u32 = 921_600;

/// The receiving end, which the serial interrupt shares with both parts below.
static RECEIVER: Mutex<RefCell<Option<Receiver>>> = Mutex::new(RefCell::new(None));

struct Receiver {
    rx: Rx<USART3>,
    decoder: Decoder,
    answer: Option<Transfer>,
    /// When the data-ready line fell, as long as it stands low.
    announced: Option<DeviceTime>,
}

/// The converter's bus.
pub struct Converter {
    tx: Tx<USART3>,
    number: u8,
}

/// The converter's data-ready line.
pub(crate) struct DataReady {
    connected: (),
}

/// Why a transfer failed.
#[derive(Clone, Copy, Debug)]
pub enum TunnelError {
    /// The transaction is longer than the tunnel carries.
    TooLong,
    /// The other end did not answer in time, or not with as many bytes as it was sent.
    NoAnswer,
}

impl Error for TunnelError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for Converter {
    type Error = TunnelError;
}

impl SpiDevice for Converter {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), TunnelError> {
        let bytes = gather(operations).ok_or(TunnelError::TooLong)?;
        let length = bytes.len();
        self.number = self.number.wrapping_add(1);
        let question = encode(&Transfer { number: self.number, bytes }).map_err(|_| TunnelError::TooLong)?;
        with_receiver(|receiver| {
            receiver.answer = None;
            // The first clock edge releases the data-ready line.
            receiver.announced = None;
        });
        let begin = time_base::now().as_micros();
        let in_time = || time_base::now().as_micros() - begin < ANSWER_MICROS;
        for &byte in &question {
            while self.tx.write(byte).is_err() {
                if !in_time() {
                    return Err(TunnelError::NoAnswer);
                }
            }
        }
        while in_time() {
            let answer = with_receiver(|receiver| receiver.answer.take()).flatten();
            if let Some(answer) = answer.filter(|answer| answer.number == self.number) {
                if answer.bytes.len() != length {
                    return Err(TunnelError::NoAnswer);
                }
                scatter(&answer.bytes, operations);
                return Ok(());
            }
        }
        Err(TunnelError::NoAnswer)
    }
}

impl DataReady {
    /// When the line fell, by the converter's own clock, if it still stands low. `_now` is what the real board answers.
    pub(crate) fn announced(&mut self, _now: DeviceTime) -> Option<DeviceTime> {
        let () = self.connected;
        with_receiver(|receiver| receiver.announced).flatten()
    }
}

/// Connects the tunnel. (The bus and the pin's interrupt are the other carrier's.)
pub(super) fn connect(
    _spi: SPI2,
    usart: USART3,
    pins: Parts,
    _exti: EXTI,
    _syscfg: SYSCFG,
    rcc: &mut Rcc,
) -> (Converter, DataReady) {
    let config = Config::default().baudrate(Bps(BAUD));
    let Ok(serial) = usart.serial((pins.pb10, pins.pb11), config, rcc) else {
        unreachable!("the baud rate is below an eighth of either bus clock");
    };
    let (tx, mut rx) = serial.split();
    rx.listen();
    critical_section::with(|section| {
        RECEIVER
            .replace(section, Some(Receiver { rx, decoder: Decoder::new(), answer: None, announced: None }));
    });
    listen_to_interrupt();
    (Converter { tx, number: 0 }, DataReady { connected: () })
}

#[expect(unsafe_code, reason = "the interrupt is not among those that RTIC switches on")]
fn listen_to_interrupt() {
    // SAFETY: the handler shares nothing with RTIC's tasks but what is behind a critical section. Its priority is the
    // highest, at which it was since the reset.
    unsafe { NVIC::unmask(Interrupt::USART3) };
}

fn with_receiver<T>(act: impl FnOnce(&mut Receiver) -> T) -> Option<T> {
    critical_section::with(|section| RECEIVER.borrow_ref_mut(section).as_mut().map(act))
}

#[interrupt]
fn USART3() {
    with_receiver(|receiver| {
        let Ok(byte) = receiver.rx.read() else { return };
        match receiver.decoder.push::<FromConverter>(byte) {
            Some(Ok(FromConverter::Transferred(answer))) => receiver.answer = Some(answer),
            Some(Ok(FromConverter::DataReady(time))) => {
                receiver.announced = Some(time);
                NVIC::pend(Interrupt::EXTI9_5);
            }
            Some(Err(_)) | None => {}
        }
    });
}
