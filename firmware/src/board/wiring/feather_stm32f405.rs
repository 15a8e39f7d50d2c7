//! Adafruit Feather STM32F405 Express (product 4382, schematic revision B).
//!
//! | pin | on the board | goes to |
//! |---|---|---|
//! | PB10, PB11 | TX, RX | host |
//! | PB13, PB14, PB15 | SCK, MISO, MOSI (MO, MI) | ADS131M08 SCLK, DOUT, DIN |
//! | PB9 | D10 | ADS131M08 C̅S̅ |
//! | PB8 | D9 | ADS131M08 D̅R̅D̅Y̅ |
//! | PC7 | D5 | a button to ground; the board has none |
//! | PC1 | red LED, D13 | lit when high |

use stm32f4xx_hal::gpio::{PinState, gpioa, gpiob, gpioc};

use super::Pins;
use crate::board::panel::{Button, Light, Panel};
use crate::board::{carrier, link};

/// What the log calls this board.
pub(crate) const NAME: &str = "Adafruit Feather STM32F405";

/// Frequency of the crystal.
pub(crate) const CRYSTAL_HERTZ: u32 = 12_000_000;

/// What is wired to what.
pub(crate) fn pins(_a: gpioa::Parts, b: gpiob::Parts, c: gpioc::Parts) -> Pins {
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
            button: Button::new(c.pc7.into_pull_up_input(), PinState::Low),
            light: Light::new(c.pc1, PinState::High),
        },
    }
}
