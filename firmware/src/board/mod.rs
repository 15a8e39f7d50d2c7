//! The board: an STM32F405 and what is wired to it. All registers, all pins and all `unsafe` code are here.
//!
//! | pin | function | goes to |
//! |---|---|---|
//! | PA2 | USART2 TX, 921600 baud, 8N1 | host: RX of a USB serial adapter, 3.3 V |
//! | PA3 | USART2 RX | host: TX |
//! | PB13 | SPI2 SCK, mode 1, 21 MHz | ADS131M08 SCLK |
//! | PB14 | SPI2 MISO | ADS131M08 DOUT |
//! | PB15 | SPI2 MOSI | ADS131M08 DIN |
//! | PB9 | chip select, active low | ADS131M08 C̅S̅ |
//! | PB8 | EXTI line 8, falling edge | ADS131M08 D̅R̅D̅Y̅ |
//! | PB10, PB11 | USART3 TX, RX: the tunnel, in the emulated image only | host end of the tunnel |
//! | PH0, PH1 | crystal, [`clocks::CRYSTAL_HERTZ`] | |
//!
//! The converter's SYNC/RESET is tied high. Only peripherals of the slower bus, APB1, are in use: the emulator has no others
//! that work. All of the above is free on an Olimex STM32-H405, whose crystal this image expects. An Adafruit Feather
//! STM32F405 has another crystal and does not bring out PA2 and PA3.
//!
//! | module | holds |
//! |---|---|
//! | [`clocks`] | 168 MHz from the crystal, or a fall-back that is told |
//! | [`time_base`] | microseconds since the start |
//! | [`link`] | bytes from and to the host |
//! | `carrier` | the converter's bus and data-ready line: the only file in which the emulated image differs |
//! | [`failure`] | what happens after a panic or a fault of the processor |

pub(crate) mod clocks;
mod failure;
pub(crate) mod link;
pub(crate) mod time_base;

/// The converter's bus and data-ready line.
#[cfg_attr(feature = "emulated", path = "tunnel_carrier.rs")]
#[cfg_attr(not(feature = "emulated"), path = "spi_carrier.rs")]
mod carrier;

pub(crate) use carrier::{Converter, DataReady};

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use ftcal_shared::wire::ClockSource;
use stm32f4xx_hal::gpio::GpioExt;
use stm32f4xx_hal::pac::Peripherals;
use stm32f4xx_hal::rcc::Rcc;

use link::{Link, LinkQueues};

/// Ticks a second: enough to miss a silent converter within 10 ms. In the emulator they come more often than that anyway.
const TICK_HERTZ: u32 = if cfg!(feature = "emulated") { 100 } else { 500 };

/// The board, set up: every part to be handed to whoever works with it.
pub(crate) struct Board {
    /// Where the processor's clock comes from.
    pub(crate) clock: ClockSource,
    /// The host link.
    pub(crate) link: Link,
    /// The converter's bus.
    pub(crate) converter: Converter,
    /// The converter's data-ready line.
    pub(crate) data_ready: DataReady,
}

/// Sets everything up. Takes at most the time that the crystal is given to start; nothing here waits for the converter or the
/// host.
pub(crate) fn set_up(device: Peripherals, mut systick: SYST, queues: LinkQueues) -> Board {
    let (mut rcc, clock) = clocks::start(device.RCC, &mut systick);
    time_base::start(device.TIM2, carrier::timer_clock(&rcc.clocks), &mut rcc);
    let gpioa = device.GPIOA.split(&mut rcc);
    let gpiob = device.GPIOB.split(&mut rcc);
    let link = Link::new(device.USART2, gpioa.pa2, gpioa.pa3, queues, &mut rcc);
    let (converter, data_ready) =
        carrier::connect(device.SPI2, device.USART3, gpiob, device.EXTI, device.SYSCFG, &mut rcc);
    start_ticking(systick, &rcc);
    Board { clock, link, converter, data_ready }
}

/// An interrupt every 2 ms. (The emulator's processor clock is not the one that [`clocks`] finds, so there it comes ten times as
/// often; whoever is ticked goes by the time base.)
fn start_ticking(mut systick: SYST, rcc: &Rcc) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(rcc.clocks.hclk().raw() / TICK_HERTZ - 1);
    systick.clear_current();
    systick.enable_counter();
    systick.enable_interrupt();
}
