//! What differs from board to board: one file each, chosen by the feature of the same name.
//!
//! A file says what the log calls the board, which crystal it has, and what is wired to which pin. It may choose among
//!
//! | signal | pins |
//! |---|---|
//! | host link, USART3 | TX: PB10 or PC10; RX: PB11 or PC11 |
//! | converter's bus, SPI2 | SCK: PB13, or PB10; MISO: PB14 or PC2; MOSI: PB15 or PC3 |
//! | chip select | any of ports A, B and C |
//! | data-ready | numbers 5 to 9 of these ports |
//! | button, light | any of these ports, either way round; both are needed |
//!
//! A pin that cannot do what it is given for does not compile.

use super::panel::Panel;
use super::{carrier, link};

#[cfg_attr(feature = "emulated", path = "wiring/emulated.rs")]
#[cfg_attr(feature = "feather-stm32f405", path = "wiring/feather_stm32f405.rs")]
#[cfg_attr(feature = "olimex-stm32-h405", path = "wiring/olimex_stm32_h405.rs")]
mod chosen;

pub(crate) use chosen::{CRYSTAL_HERTZ, NAME, pins};

/// What goes to the pins of a board.
pub(crate) struct Pins {
    pub(crate) link: link::Pins,
    pub(crate) converter: carrier::Pins,
    pub(crate) panel: Panel,
}
