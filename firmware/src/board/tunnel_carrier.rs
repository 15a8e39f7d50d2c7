//! The converter behind the tunnel: USART2 instead of SPI2, for an emulator that has no converter. For the protocol see
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
use ftcal_firmware::tunnel::{
    ANSWER_MICROS, FLASH_ATTEMPTS, FlashAction, FlashAnswer, FlashBytes, FlashQuestion, FromBoard,
    FromConverter, Transfer, gather, scatter,
};
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::frame::{Decoder, encode};
use stm32f4xx_hal::gpio::PushPull;
use stm32f4xx_hal::gpio::alt::usart2;
use stm32f4xx_hal::pac::{EXTI, Interrupt, SPI2, SYSCFG, TIM5, USART2, interrupt};
use stm32f4xx_hal::prelude::_fugit_ExtU32;
use stm32f4xx_hal::rcc::{Clocks, Rcc};
use stm32f4xx_hal::serial::config::Config;
use stm32f4xx_hal::serial::{Rx, RxListen, SerialExt, Tx};
use stm32f4xx_hal::time::{Bps, Hertz};
use stm32f4xx_hal::timer::{CounterMs, Event, TimerExt};
use stm32f4xx_hal::{ClearFlags, Listen};

use super::time_base;

/// The emulator does not care.
const BAUD: u32 = 921_600;

/// How often the line is asked to take a byte. The emulator's always does.
const ATTEMPTS: u32 = 1000;

/// Whoever waits looks at the clock at least this often.
const ALARM_MILLIS: u32 = 20;

/// The line, which the serial interrupt shares with both parts below.
static LINE: Mutex<RefCell<Option<Line>>> = Mutex::new(RefCell::new(None));

struct Line {
    tx: Tx<USART2>,
    rx: Rx<USART2>,
    decoder: Decoder,
    answer: Option<Transfer>,
    flash_answer: Option<FlashAnswer>,
    /// When the data-ready line fell, as long as it stands low.
    announced: Option<DeviceTime>,
    /// The other end has not heard yet that its announcement was handled.
    is_waited_for: bool,
    /// The button at the other end.
    is_pressed: bool,
    alarm: CounterMs<TIM5>,
}

/// The tunnel's two wires.
pub(crate) struct Pins {
    pub(crate) tx: usart2::Tx<PushPull>,
    pub(crate) rx: usart2::Rx<PushPull>,
}

/// The converter's bus.
pub struct Converter {
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
        with_line(|line| {
            line.answer = None;
            // The first clock edge releases the data-ready line.
            line.announced = None;
        });
        send(&FromBoard::Transfer(Transfer { number: self.number, bytes }))?;
        let answer = wait_for(|| {
            let answer = with_line(|line| line.answer.take()).flatten();
            answer.filter(|answer| answer.number == self.number)
        })?;
        if answer.bytes.len() != length {
            return Err(TunnelError::NoAnswer);
        }
        scatter(&answer.bytes, operations);
        Ok(())
    }
}

impl DataReady {
    /// Does something about an announcement, given when the line fell by the converter's own clock. `None` where it does
    /// not stand low any more. (`_now` is what the real board takes for that time.)
    pub(crate) fn handle<T>(&mut self, _now: DeviceTime, act: impl FnOnce(DeviceTime) -> T) -> Option<T> {
        let () = self.connected;
        with_line(|line| line.announced).flatten().map(act)
    }
}

/// Tells the converter to go on. To be called when nothing is left of what it has announced but what is in the line's queue: an emulator
/// that is slower than a board has its samples as complete as a board has them.
pub(crate) fn catch_up() {
    if with_line(|line| core::mem::take(&mut line.is_waited_for)) == Some(true) {
        // Where this is lost, the converter goes on later.
        let _ = critical_section::with(|_| send(&FromBoard::Handled));
    }
}

/// Whether the button at the other end is pressed.
pub(super) fn is_pressed() -> bool {
    with_line(|line| line.is_pressed) == Some(true)
}

/// Has the light at the other end on or off; whether that was sent. Not to be called by whoever may interrupt the sample path, which
/// may be in the middle of a frame.
pub(super) fn show_light(is_lit: bool) -> bool {
    critical_section::with(|_| send(&FromBoard::Light { is_lit })).is_ok()
}

/// Asks the flash at the other end. To be called from the background only, whose questions the sample path may interrupt, but not
/// in the middle of a frame.
pub(super) fn ask_flash(number: u8, action: FlashAction) -> Result<FlashBytes, TunnelError> {
    let question = FromBoard::Flash(FlashQuestion { number, action });
    for _ in 0..FLASH_ATTEMPTS {
        with_line(|line| line.flash_answer = None);
        critical_section::with(|_| send(&question))?;
        let answer = wait_for(|| {
            let answer = with_line(|line| line.flash_answer.take()).flatten();
            answer.filter(|answer| answer.number == number)
        });
        if let Ok(answer) = answer {
            return answer.bytes.ok_or(TunnelError::NoAnswer);
        }
    }
    Err(TunnelError::NoAnswer)
}

fn send(message: &FromBoard) -> Result<(), TunnelError> {
    let frame = encode(message).map_err(|_| TunnelError::TooLong)?;
    for &byte in &frame {
        let is_taken = (0..ATTEMPTS).any(|_| with_line(|line| line.tx.write(byte).is_ok()) == Some(true));
        if !is_taken {
            return Err(TunnelError::NoAnswer);
        }
    }
    Ok(())
}

/// Looks for something, for at most [`ANSWER_MICROS`], and sleeps until the next interrupt where it is not there: an emulator that spins
/// takes the time away from whoever is to answer.
fn wait_for<T>(look: impl Fn() -> Option<T>) -> Result<T, TunnelError> {
    let begin = time_base::now().as_micros();
    loop {
        // What comes between look and sleep is held back, and ends the sleep.
        let found = critical_section::with(|_| {
            let found = look();
            if found.is_none() {
                cortex_m::asm::wfi();
            }
            found
        });
        if let Some(found) = found {
            return Ok(found);
        }
        if time_base::now().as_micros() - begin > ANSWER_MICROS {
            return Err(TunnelError::NoAnswer);
        }
    }
}

/// The rate of TIM2 before it divides: the emulator's timers count nanoseconds, whatever the clock.
pub(super) fn timer_clock(_clocks: &Clocks) -> Hertz {
    Hertz::from_raw(1_000_000_000)
}

/// Connects the tunnel. (The bus and the pin's interrupt are the other carrier's.)
pub(super) fn connect(
    _spi: SPI2,
    usart: USART2,
    pins: Pins,
    _exti: EXTI,
    _syscfg: SYSCFG,
    timer: TIM5,
    rcc: &mut Rcc,
) -> (Converter, DataReady) {
    let config = Config::default().baudrate(Bps(BAUD));
    let Ok(serial) = usart.serial((pins.tx, pins.rx), config, rcc) else {
        unreachable!("the baud rate is below an eighth of either bus clock");
    };
    let (tx, mut rx) = serial.split();
    rx.listen();
    let mut alarm = timer.counter_ms(rcc);
    alarm.listen(Event::Update);
    if alarm.start(ALARM_MILLIS.millis()).is_err() {
        unreachable!("the timer counts milliseconds up to a minute");
    }
    critical_section::with(|section| {
        LINE.replace(
            section,
            Some(Line {
                tx,
                rx,
                decoder: Decoder::new(),
                answer: None,
                flash_answer: None,
                announced: None,
                is_waited_for: false,
                is_pressed: false,
                alarm,
            }),
        );
    });
    listen_to_interrupts();
    (Converter { number: 0 }, DataReady { connected: () })
}

#[expect(unsafe_code, reason = "the interrupts are not among those that RTIC switches on")]
fn listen_to_interrupts() {
    // SAFETY: the handlers share nothing with RTIC's tasks but what is behind a critical section. Their priority is the
    // highest, at which it was since the reset.
    unsafe {
        NVIC::unmask(Interrupt::USART2);
        NVIC::unmask(Interrupt::TIM5);
    }
}

fn with_line<T>(act: impl FnOnce(&mut Line) -> T) -> Option<T> {
    critical_section::with(|section| LINE.borrow_ref_mut(section).as_mut().map(act))
}

#[interrupt]
fn USART2() {
    with_line(|line| {
        let Ok(byte) = line.rx.read() else { return };
        match line.decoder.push::<FromConverter>(byte) {
            Some(Ok(FromConverter::Transferred(answer))) => line.answer = Some(answer),
            Some(Ok(FromConverter::DataReady(time))) => {
                line.announced = Some(time);
                line.is_waited_for = true;
                NVIC::pend(Interrupt::EXTI9_5);
            }
            Some(Ok(FromConverter::Flash(answer))) => line.flash_answer = Some(answer),
            Some(Ok(FromConverter::Button { is_pressed })) => line.is_pressed = is_pressed,
            Some(Err(_)) | None => {}
        }
    });
}

/// Wakes whoever waits for an answer that does not come.
#[interrupt]
fn TIM5() {
    with_line(|line| line.alarm.clear_all_flags());
}
