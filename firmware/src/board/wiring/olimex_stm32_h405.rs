//! Olimex STM32-H405.
//!
//! | pin | on the board | goes to |
//! |---|---|---|
//! | PB10, PB11 | extension header | host |
//! | PB13, PB14, PB15 | extension header | ADS131M08 SCLK, DOUT, DIN |
//! | PB9 | extension header | ADS131M08 C̅S̅ |
//! | PB8 | extension header | ADS131M08 D̅R̅D̅Y̅ |
//! | PA0 | user button (WKUP) | 3.3 V when pressed, to ground through a resistor otherwise |
//! | PC12 | green LED | lit when low |

use stm32f4xx_hal::gpio::{PinState, gpioa, gpiob, gpioc};

use super::Pins;
use crate::board::panel::{Button, Light, Panel};
use crate::board::{carrier, link};

/// What the log calls this board.
pub(crate) const NAME: &str = "Olimex STM32-H405";

/// Frequency of the crystal.
pub(crate) const CRYSTAL_HERTZ: u32 = 8_000_000;

/// What is wired to what.
pub(crate) fn pins(a: gpioa::Parts, b: gpiob::Parts, c: gpioc::Parts) -> Pins {
    Pins {
        link: link::Pins { tx: b.pb10.into(), rx: b.pb11.into() },
        converter: carrier::Pins {
            clock: b.pb13.into(),
            miso: b.pb14.into(),
            mosi: b.pb15.into(),
            select: carrier::select(b.pb9),
            data_ready: carrier::data_ready(b.pb8),
        },
        panel: Panel {
            button: Button::new(a.pa0.into_pull_down_input(), PinState::High),
            light: Light::new(c.pc12, PinState::Low),
        },
    }
}
