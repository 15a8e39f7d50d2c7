//! The converter on its bus: SPI2, chip select, and data-ready by interrupt.

use core::convert::Infallible;

use embedded_hal::spi::{ErrorType, MODE_1, Operation, SpiDevice};
use embedded_hal_bus::spi::{DeviceError, ExclusiveDevice};
use ftcal_shared::units::DeviceTime;
use stm32f4xx_hal::gpio::alt::spi2;
use stm32f4xx_hal::gpio::{AnyPin, Edge, ExtiPin, Input, Output, Pin, PinSpeed, PinState, Speed};
use stm32f4xx_hal::pac::{EXTI, SPI2, SYSCFG, TIM2, TIM5, USART2};
use stm32f4xx_hal::rcc::{BusClock, BusTimerClock, Clocks, Rcc};
use stm32f4xx_hal::spi::{self, Spi, SpiExt};
use stm32f4xx_hal::syscfg::SysCfgExt;
use stm32f4xx_hal::time::Hertz;

use super::time_base::Delay;

/// The converter takes 25 MHz; the nearest below that the bus can do is half of its clock: 21 MHz at full speed.
const FASTEST: Hertz = Hertz::from_raw(25_000_000);

/// The wires to the converter.
pub(crate) struct Pins {
    pub(crate) clock: spi2::Sck,
    pub(crate) miso: spi2::Miso,
    pub(crate) mosi: spi2::Mosi,
    /// As [`select`] makes it.
    pub(crate) select: AnyPin<Output>,
    /// As [`data_ready`] makes it.
    pub(crate) data_ready: AnyPin<Input>,
}

/// A pin, not yet in use, as chip select: high at once, so that the converter ignores the bus until it is spoken to.
pub(super) fn select<const PORT: char, const NUMBER: u8>(pin: Pin<PORT, NUMBER>) -> AnyPin<Output> {
    pin.into_push_pull_output_in_state(PinState::High).erase()
}

/// A pin, not yet in use, as data-ready line: pulled up, so that a converter that is not there does not announce anything.
pub(super) fn data_ready<const PORT: char, const NUMBER: u8>(pin: Pin<PORT, NUMBER>) -> AnyPin<Input> {
    const { assert!(5 <= NUMBER && NUMBER <= 9, "data-ready is served by EXTI9_5: pins 5 to 9 of any port") };
    pin.into_pull_up_input().erase()
}

/// The converter's bus.
pub struct Converter {
    device: Device,
}

/// The bus with its one chip select.
type Device = ExclusiveDevice<Spi<SPI2>, AnyPin<Output>, Delay>;

impl ErrorType for Converter {
    type Error = DeviceError<spi::Error, Infallible>;
}

impl SpiDevice for Converter {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
        self.device.transaction(operations)
    }
}

/// The converter's data-ready line.
pub(crate) struct DataReady {
    line: AnyPin<Input>,
}

impl DataReady {
    /// Acknowledges the interrupt and does something about it, given when the line fell. `None` where it does not stand low any
    /// more: then the conversion was read meanwhile, as happens while the converter is being started, and this interrupt is
    /// an echo of it.
    pub(crate) fn handle<T>(&mut self, now: DeviceTime, act: impl FnOnce(DeviceTime) -> T) -> Option<T> {
        self.line.clear_interrupt_pending_bit();
        self.line.is_low().then(|| act(now))
    }
}

/// Nothing: this converter goes on by itself. (The emulated one waits until the board has caught up with it.)
pub(crate) const fn catch_up() {}

/// The rate of TIM2 before it divides: 84 MHz at full speed, 16 MHz on the internal oscillator.
pub(super) fn timer_clock(clocks: &Clocks) -> Hertz {
    TIM2::timer_clock(clocks)
}

/// Connects the converter. (The serial line and the timer are the emulated carrier's.)
pub(super) fn connect(
    spi: SPI2,
    _usart: USART2,
    mut pins: Pins,
    mut exti: EXTI,
    syscfg: SYSCFG,
    _timer: TIM5,
    rcc: &mut Rcc,
) -> (Converter, DataReady) {
    pins.clock.set_speed(Speed::VeryHigh);
    pins.mosi.set_speed(Speed::VeryHigh);
    // The bus divides its clock by two at least.
    let hertz = FASTEST.min(SPI2::clock(&rcc.clocks) / 2);
    let bus = spi.spi((Some(pins.clock), Some(pins.miso), Some(pins.mosi)), MODE_1, hertz, rcc);
    let Ok(device) = ExclusiveDevice::new(bus, pins.select, Delay);

    let mut line = pins.data_ready;
    line.make_interrupt_source(&mut syscfg.constrain(rcc));
    line.trigger_on_edge(&mut exti, Edge::Falling);
    line.enable_interrupt(&mut exti);
    (Converter { device }, DataReady { line })
}
