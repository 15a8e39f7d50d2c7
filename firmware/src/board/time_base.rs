//! Microseconds since the start: TIM2, a 32-bit counter at 1 MHz, extended to 64 bits by [`long_count`].
//!
//! Reading it takes no lock and is right at every priority. It serves as the delay of drivers, too. Its overflow needs no
//! interrupt: the tick, many times a second, follows it.
//!
//! Why this counter: it is the longest that the chip has, and it counts in the emulator, too, which has no cycle counter and no
//! timer compare flags. The rate at which it does so there is known to the carrier.

use core::sync::atomic::{AtomicU32, Ordering};

use embedded_hal::delay::DelayNs;
use ftcal_firmware::long_count;
use ftcal_shared::units::DeviceTime;
use stm32f4xx_hal::pac::TIM2;
use stm32f4xx_hal::rcc::{Enable, Rcc, Reset};
use stm32f4xx_hal::time::Hertz;

/// Completed halves of the counter's range.
static HALVES: AtomicU32 = AtomicU32::new(0);

/// Where the counter starts for a soak: a minute later it begins at zero again.
const LATE: u32 = u32::MAX - 60_000_000;

/// Starts the clock at zero, where it stands until then; `timer_clock` is what the timer counts before it divides.
#[expect(clippy::needless_pass_by_value, reason = "taken for good: from here on nobody writes this timer")]
pub(super) fn start(tim2: TIM2, timer_clock: Hertz, rcc: &mut Rcc) {
    TIM2::enable(rcc);
    TIM2::reset(rcc);
    let divisor = timer_clock.raw() / 1_000_000;
    tim2.psc().write(|w| w.psc().set(u16::try_from(divisor - 1).unwrap_or(u16::MAX)));
    tim2.arr().write(|w| w.arr().set(u32::MAX));
    // The prescaler takes effect at an update.
    tim2.egr().write(|w| w.ug().set_bit());
    if cfg!(feature = "soak") {
        tim2.cnt().write(|w| w.cnt().set(LATE));
        HALVES.store(1, Ordering::Relaxed);
    }
    tim2.cr1().write(|w| w.cen().set_bit());
}

/// Time since the start.
pub(crate) fn now() -> DeviceTime {
    // In this order: halves that are read late could be ahead of the counter.
    let halves = HALVES.load(Ordering::Relaxed);
    DeviceTime::from_micros(long_count::extend(halves, counter()))
}

/// Keeps count of the counter's overflows: to be called at least once in 35 minutes, always by the same task.
pub(crate) fn follow() {
    HALVES.store(long_count::follow(HALVES.load(Ordering::Relaxed), counter()), Ordering::Relaxed);
}

/// Waits in the processor, for at least as long as asked and at most two microseconds longer.
#[derive(Clone, Copy)]
pub(crate) struct Delay;

impl DelayNs for Delay {
    fn delay_ns(&mut self, nanoseconds: u32) {
        let begin = counter();
        // The counter may be about to count: one more than asked for.
        let micros = nanoseconds.div_ceil(1000) + 1;
        while counter().wrapping_sub(begin) < micros {}
    }
}

#[expect(unsafe_code, reason = "a register is read that everybody may read at any time")]
fn counter() -> u32 {
    // SAFETY: reading the counter has no side effect, and nobody writes it once it was started.
    unsafe { (*TIM2::ptr()).cnt().read().cnt().bits() }
}

defmt::timestamp!("{=u64:us}", now().as_micros());
