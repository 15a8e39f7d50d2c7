//! Button and light behind the tunnel: the emulator's pins lead nowhere. For the protocol see [`ftcal_firmware::tunnel`].

use super::carrier::{is_pressed, show_light};

/// Button and light.
pub(crate) struct Panel {
    pub(crate) button: Button,
    pub(crate) light: Light,
}

impl Panel {
    /// Those at the other end, the light dark for now.
    pub(super) const fn new() -> Self {
        Self { button: Button { connected: () }, light: Light { is_lit: false } }
    }
}

/// A button.
pub(crate) struct Button {
    connected: (),
}

impl Button {
    /// Whether it is pressed at this moment.
    pub(crate) fn is_pressed(&self) -> bool {
        let () = self.connected;
        is_pressed()
    }
}

/// A light.
pub(crate) struct Light {
    /// As the other end was told last.
    is_lit: bool,
}

impl Light {
    /// Switches it on or off.
    pub(crate) fn set(&mut self, on: bool) {
        if on != self.is_lit && show_light(on) {
            self.is_lit = on;
        }
    }
}
