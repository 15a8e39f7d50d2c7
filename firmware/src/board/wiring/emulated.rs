//! QEMU's `netduinoplus2`: the processor with its serial ports and timers, and nothing around it.
//!
//! | pin | goes to |
//! |---|---|
//! | PB10, PB11 | host: QEMU's third serial port |
//! | PA2, PA3 | the tunnel's other end, with converter, flash, button and light: QEMU's second serial port |

use stm32f4xx_hal::gpio::{gpioa, gpiob, gpioc};

use super::Pins;
use crate::board::panel::Panel;
use crate::board::{carrier, link};

/// What the log calls this board.
pub(crate) const NAME: &str = "emulated board";

/// Frequency of a crystal that never starts.
pub(crate) const CRYSTAL_HERTZ: u32 = 8_000_000;

/// What is wired to what.
pub(crate) fn pins(a: gpioa::Parts, b: gpiob::Parts, _c: gpioc::Parts) -> Pins {
    Pins {
        link: link::Pins { tx: b.pb10.into(), rx: b.pb11.into() },
        converter: carrier::Pins { tx: a.pa2.into(), rx: a.pa3.into() },
        panel: Panel::new(),
    }
}
