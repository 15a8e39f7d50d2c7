//! The converter on its bus: SPI2, chip select, and data-ready by interrupt.

use core::convert::Infallible;

use embedded_hal::spi::{ErrorType, MODE_1, Operation, SpiDevice};
use embedded_hal_bus::spi::{DeviceError, ExclusiveDevice};
use ftcal_shared::units::DeviceTime;
use stm32f4xx_hal::gpio::gpiob::Parts;
use stm32f4xx_hal::gpio::{Edge, ExtiPin, Input, Output, PB8, PB9, Speed};
use stm32f4xx_hal::pac::{EXTI, SPI2, SYSCFG, TIM2, USART3};
use stm32f4xx_hal::rcc::{BusClock, BusTimerClock, Clocks, Rcc};
use stm32f4xx_hal::spi::{self, Spi, SpiExt};
use stm32f4xx_hal::syscfg::SysCfgExt;
use stm32f4xx_hal::time::Hertz;

use super::time_base::Delay;

/// The converter takes 25 MHz; the nearest below that the bus can do is half of its clock: 21 MHz at full speed.
const FASTEST: Hertz = Hertz::from_raw(25_000_000);

/// The converter's bus.
pub struct Converter {
    device: Device,
}

/// The bus with its one chip select.
type Device = ExclusiveDevice<Spi<SPI2>, PB9<Output>, Delay>;

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
    line: PB8<Input>,
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

/// The rate of TIM2 before it divides: 84 MHz at full speed, 16 MHz on the internal oscillator.
pub(super) fn timer_clock(clocks: &Clocks) -> Hertz {
    TIM2::timer_clock(clocks)
}

/// Connects the converter. (The serial line is the emulated carrier's.)
pub(super) fn connect(
    spi: SPI2,
    _usart: USART3,
    pins: Parts,
    mut exti: EXTI,
    syscfg: SYSCFG,
    rcc: &mut Rcc,
) -> (Converter, DataReady) {
    let clock = pins.pb13.into_alternate::<5>().speed(Speed::VeryHigh);
    let miso = pins.pb14.into_alternate::<5>().speed(Speed::VeryHigh);
    let mosi = pins.pb15.into_alternate::<5>().speed(Speed::VeryHigh);
    // The bus divides its clock by two at least.
    let hertz = FASTEST.min(SPI2::clock(&rcc.clocks) / 2);
    let bus = spi.spi((Some(clock), Some(miso), Some(mosi)), MODE_1, hertz, rcc);
    let mut select = pins.pb9.into_push_pull_output();
    select.set_high();
    let Ok(device) = ExclusiveDevice::new(bus, select, Delay);

    // Pulled up, so that a converter that is not there does not announce anything.
    let mut line = pins.pb8.into_pull_up_input();
    line.make_interrupt_source(&mut syscfg.constrain(rcc));
    line.trigger_on_edge(&mut exti, Edge::Falling);
    line.enable_interrupt(&mut exti);
    (Converter { device }, DataReady { line })
}
