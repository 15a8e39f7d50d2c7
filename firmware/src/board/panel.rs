//! What somebody at the sensor can press and see: a button and a light.

use stm32f4xx_hal::gpio::{AnyPin, Input, Output, Pin, PinState};

/// Button and light.
pub(crate) struct Panel {
    pub(crate) button: Button,
    pub(crate) light: Light,
}

/// A button.
pub(crate) struct Button {
    pin: AnyPin<Input>,
    pressed: PinState,
}

impl Button {
    /// The button on this pin, which has this state while the button is pressed, and by its resistor the other one otherwise.
    pub(super) fn new<const PORT: char, const NUMBER: u8>(pin: Pin<PORT, NUMBER>, pressed: PinState) -> Self {
        Self { pin: pin.erase(), pressed }
    }

    /// Whether it is pressed at this moment, bounces and all.
    pub(crate) fn is_pressed(&self) -> bool {
        self.pin.is_high() == (self.pressed == PinState::High)
    }
}

/// A light.
pub(crate) struct Light {
    pin: AnyPin<Output>,
    lit: PinState,
}

impl Light {
    /// The light on this pin, which is lit while the pin has this state: dark for now.
    pub(super) fn new<const PORT: char, const NUMBER: u8>(pin: Pin<PORT, NUMBER>, lit: PinState) -> Self {
        Self { pin: pin.into_push_pull_output_in_state(!lit).erase(), lit }
    }

    /// Switches it on or off.
    pub(crate) fn set(&mut self, on: bool) {
        self.pin.set_state(if on { self.lit } else { !self.lit });
    }
}
