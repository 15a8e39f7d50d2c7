//! The processor's clock: 168 MHz from the crystal, or the best there is, found with bounded waits.
//!
//! The HAL waits for an oscillator as long as it takes. A board whose crystal does not start would be dead, and a sensor
//! that says "my crystal is broken" is worth more. So each clock is first tried here, for at most [`CRYSTAL_START_MICROS`] and
//! [`PLL_LOCK_MICROS`], and the HAL is then asked for one that is known to start:
//!
//! | tried | processor | reported as |
//! |---|---|---|
//! | crystal and PLL | 168 MHz | [`ClockSource::Crystal`] |
//! | internal oscillator and PLL | 168 MHz ± 1 % | [`ClockSource::InternalFallback`] |
//! | internal oscillator | 16 MHz ± 1 % | [`ClockSource::InternalFallback`] |
//!
//! The last needs no ready bit at all: the processor runs on it since its reset. The emulator, which models no ready bits, ends
//! there.

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use ftcal_shared::wire::ClockSource;
use stm32f4xx_hal::pac::RCC;
use stm32f4xx_hal::rcc::{Config, HSI, Rcc, RccExt};
use stm32f4xx_hal::time::Hertz;

use super::wiring::CRYSTAL_HERTZ;

const _: () = assert!(
    4_000_000 <= CRYSTAL_HERTZ && CRYSTAL_HERTZ <= 26_000_000,
    "the processor takes crystals of 4 to 26 MHz"
);

/// The fastest that the chip allows.
const PROCESSOR_HERTZ: u32 = 168_000_000;

/// How long the crystal may take. Its data sheet says 2 ms, typically; ST's own library gives it as long as this.
const CRYSTAL_START_MICROS: u32 = 100_000;

/// How long the PLL may take: 300 µs at most, by the data sheet.
const PLL_LOCK_MICROS: u32 = 1_000;

/// The most at the PLL's input; it takes 1 to 2 MHz.
const PLL_INPUT_HERTZ: u32 = 2_000_000;

/// Sets the clocks up, and says where they come from.
pub(super) fn start(rcc: RCC, systick: &mut SYST) -> (Rcc, ClockSource) {
    let full_speed = Hertz::from_raw(PROCESSOR_HERTZ);
    let (config, source) = if crystal_starts(&rcc, systick) && pll_locks(&rcc, systick, true) {
        (Config::hse(Hertz::from_raw(CRYSTAL_HERTZ)).sysclk(full_speed), ClockSource::Crystal)
    } else if pll_locks(&rcc, systick, false) {
        (Config::hsi().sysclk(full_speed), ClockSource::InternalFallback)
    } else {
        (Config::hsi(), ClockSource::InternalFallback)
    };
    (rcc.freeze(config), source)
}

/// Leaves the crystal on if it does start.
fn crystal_starts(rcc: &RCC, systick: &mut SYST) -> bool {
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    let starts = happens_within(systick, CRYSTAL_START_MICROS, || rcc.cr().read().hserdy().bit_is_set());
    if !starts {
        rcc.cr().modify(|_, w| w.hseon().clear_bit());
    }
    starts
}

/// Leaves the PLL off, for it to be set up and started by the HAL.
fn pll_locks(rcc: &RCC, systick: &mut SYST, from_crystal: bool) -> bool {
    let source_hertz = if from_crystal { CRYSTAL_HERTZ } else { HSI };
    #[expect(clippy::cast_possible_truncation, reason = "13 at most")]
    let divisor = source_hertz.div_ceil(PLL_INPUT_HERTZ) as u8;
    #[expect(unsafe_code, reason = "the register takes divisors from 2 to 63, which its type does not say")]
    rcc.pllcfgr().modify(|_, w| {
        // The other fields keep their reset values: the oscillator runs at the input times 192, within its range.
        // SAFETY: the divisor is in the register's range, and the PLL is off.
        unsafe { w.pllsrc().bit(from_crystal).pllm().bits(divisor) }
    });
    rcc.cr().modify(|_, w| w.pllon().set_bit());
    let locks = happens_within(systick, PLL_LOCK_MICROS, || rcc.cr().read().pllrdy().bit_is_set());
    rcc.cr().modify(|_, w| w.pllon().clear_bit());
    let stops = happens_within(systick, PLL_LOCK_MICROS, || rcc.cr().read().pllrdy().bit_is_clear());
    locks && stops
}

/// Waits for something, by the processor's own timer, which counts the internal oscillator until the clocks are set up.
fn happens_within(systick: &mut SYST, micros: u32, condition: impl Fn() -> bool) -> bool {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(micros * (HSI / 1_000_000));
    systick.clear_current();
    systick.enable_counter();
    while !condition() && !systick.has_wrapped() {}
    systick.disable_counter();
    condition()
}
