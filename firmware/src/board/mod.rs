//! The board: an STM32F405 and what is wired to it. All registers, all pins and all `unsafe` code are here.
//!
//! | signal | |
//! |---|---|
//! | host link | USART3, 921600 baud until told otherwise, 8N1 |
//! | converter's bus | SPI2, mode 1, 21 MHz, with a chip select, active low |
//! | converter's data-ready | EXTI line 5 to 9, falling edge |
//! | the tunnel, in the emulated image instead of these two | USART2, TIM5 |
//!
//! Which pins these are on a board is in [`wiring`]. The converter's SYNC/RESET is tied high. Only peripherals of the slower bus,
//! APB1, are in use: the emulator has no others that work.
//!
//! | module | holds |
//! |---|---|
//! | [`wiring`] | the board's crystal and pins: the one file to write for another board |
//! | [`clocks`] | 168 MHz from the crystal, or a fall-back that is told |
//! | [`time_base`] | microseconds since the start |
//! | [`link`] | bytes from and to the host |
//! | `carrier` | the converter's bus and data-ready line |
//! | `flash` | the sectors after the image |
//! | [`panel`] | button and light; this file, the two before and its wiring are all in which the emulated image differs |
//! | [`failure`] | what happens after a panic or a fault of the processor |
//! | [`reset`] | what the last reset came from |
//! | [`stack`] | how much of the stack is in use, and what happens where it is too small |
//! | [`watchdog`] | a reset for a board that hangs |

pub(crate) mod clocks;
mod failure;
pub(crate) mod link;
mod reset;
mod stack;
pub(crate) mod time_base;
pub(crate) mod watchdog;
pub(crate) mod wiring;

/// The converter's bus and data-ready line.
#[cfg_attr(feature = "emulated", path = "tunnel_carrier.rs")]
#[cfg_attr(not(feature = "emulated"), path = "spi_carrier.rs")]
mod carrier;

/// The sectors after the image.
#[cfg_attr(feature = "emulated", path = "tunnel_flash.rs")]
#[cfg_attr(not(feature = "emulated"), path = "internal_flash.rs")]
mod flash;

/// Button and light.
#[cfg_attr(feature = "emulated", path = "tunnel_panel.rs")]
pub(crate) mod panel;

pub(crate) use carrier::{Converter, DataReady, catch_up};
pub(crate) use flash::Flash;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use ftcal_shared::wire::{ClockSource, Diagnosis, Failure, ResetCause};
use stm32f4xx_hal::gpio::GpioExt;
use stm32f4xx_hal::pac::Peripherals;
use stm32f4xx_hal::rcc::Rcc;

use link::{Link, LinkQueues};
use panel::Panel;
use watchdog::Watchdog;

/// Ticks a second: enough to miss a silent converter within 10 ms. In the emulator they come more often than that anyway.
const TICK_HERTZ: u32 = if cfg!(feature = "emulated") { 100 } else { 500 };

/// The board, set up: every part to be handed to whoever works with it.
pub(crate) struct Board {
    /// Where the processor's clock comes from.
    pub(crate) clock: ClockSource,
    /// The host link.
    pub(crate) link: Link,
    /// What the link's rates are divided from.
    pub(crate) link_clock_hertz: u32,
    /// The converter's bus.
    pub(crate) converter: Converter,
    /// The converter's data-ready line.
    pub(crate) data_ready: DataReady,
    /// The sectors after the image. The emulated one is silent until interrupts are on.
    pub(crate) flash: Flash,
    /// Button and light.
    pub(crate) panel: Panel,
    /// Running already.
    pub(crate) watchdog: Watchdog,
    /// Why the board has started.
    pub(crate) start: Start,
}

/// Why the board has started.
#[derive(Clone, Debug)]
pub(crate) struct Start {
    reset: ResetCause,
    failure: Option<Failure>,
}

impl Start {
    /// What the board knows of itself by now.
    pub(crate) fn diagnosis(&self) -> Diagnosis {
        Diagnosis {
            reset: self.reset,
            failure: self.failure.clone(),
            stack_used_bytes: stack::used(),
            stack_bytes: stack::size(),
        }
    }
}

/// Sets everything up. Takes at most the time that the crystal is given to start; nothing here waits for the converter or the
/// host.
pub(crate) fn set_up(device: Peripherals, mut systick: SYST, queues: LinkQueues) -> Board {
    let start = Start { reset: reset::take_cause(&device.RCC), failure: failure::take() };
    let watchdog = Watchdog::start(device.IWDG);
    let (mut rcc, clock) = clocks::start(device.RCC, &mut systick);
    time_base::start(device.TIM2, carrier::timer_clock(&rcc.clocks), &mut rcc);
    let (a, b) = (device.GPIOA.split(&mut rcc), device.GPIOB.split(&mut rcc));
    let pins = wiring::pins(a, b, device.GPIOC.split(&mut rcc));
    let link = Link::new(device.USART3, pins.link, queues, &mut rcc);
    let (converter, data_ready) = carrier::connect(
        device.SPI2,
        device.USART2,
        pins.converter,
        device.EXTI,
        device.SYSCFG,
        device.TIM5,
        &mut rcc,
    );
    start_ticking(systick, &rcc);
    let link_clock_hertz = rcc.clocks.pclk1().raw();
    let flash = Flash::new(device.FLASH);
    Board { clock, link, link_clock_hertz, converter, data_ready, flash, panel: pins.panel, watchdog, start }
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
