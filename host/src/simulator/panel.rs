//! The button and the light of a simulated board.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A button and a light; clones are the same ones.
#[derive(Clone, Debug, Default)]
pub struct SharedPanel {
    is_pressed: Arc<AtomicBool>,
    is_lit: Arc<AtomicBool>,
}

impl SharedPanel {
    /// Presses the button, or releases it.
    pub fn press(&self, is_pressed: bool) {
        self.is_pressed.store(is_pressed, Ordering::Relaxed);
    }

    /// Whether the light is on.
    pub fn light(&self) -> bool {
        self.is_lit.load(Ordering::Relaxed)
    }

    pub(super) fn is_pressed(&self) -> bool {
        self.is_pressed.load(Ordering::Relaxed)
    }

    pub(super) fn set_light(&self, is_lit: bool) {
        self.is_lit.store(is_lit, Ordering::Relaxed);
    }
}
