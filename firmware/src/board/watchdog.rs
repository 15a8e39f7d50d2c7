//! The independent watchdog: a clock of its own, which nothing but a reset stops.

use stm32f4xx_hal::pac::IWDG;
use stm32f4xx_hal::prelude::_fugit_ExtU32;
use stm32f4xx_hal::watchdog::IndependentWatchdog;

/// Longer than anything takes that is in order: solving a trial beside a converter at full rate, or erasing the two sectors of a flash
/// that is new, which stops the processor for up to two seconds each. Its oscillator may run at 17 to 47 kHz instead of 32: this is
/// 5.4 to 15 seconds.
const PERIOD_MILLISECONDS: u32 = 8_000;

/// The watchdog.
pub(crate) struct Watchdog {
    watchdog: IndependentWatchdog,
}

impl Watchdog {
    /// Starts it, for good.
    pub(super) fn start(iwdg: IWDG) -> Self {
        let mut watchdog = IndependentWatchdog::new(iwdg);
        watchdog.start(PERIOD_MILLISECONDS.millis());
        Self { watchdog }
    }

    /// All is well for another period.
    pub(crate) fn feed(&mut self) {
        self.watchdog.feed();
    }
}
