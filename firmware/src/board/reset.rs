//! What the last reset came from, as the processor's flags say.

use ftcal_shared::wire::ResetCause;
use stm32f4xx_hal::pac::RCC;

/// Reads the flags and clears them, so that the next reset is not taken for this one. To be called once.
///
/// Every reset but that by the pin pulls the pin, too, and power that comes looks like a brown-out: the most particular cause is
/// looked for first.
pub(super) fn take_cause(rcc: &RCC) -> ResetCause {
    let flags = rcc.csr().read();
    rcc.csr().modify(|_, w| w.rmvf().set_bit());
    if flags.wdgrstf().bit_is_set() || flags.wwdgrstf().bit_is_set() {
        ResetCause::Watchdog
    } else if flags.sftrstf().bit_is_set() {
        ResetCause::Software
    } else if flags.porrstf().bit_is_set() {
        ResetCause::PowerOn
    } else if flags.borrstf().bit_is_set() {
        ResetCause::BrownOut
    } else if flags.padrstf().bit_is_set() {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}
