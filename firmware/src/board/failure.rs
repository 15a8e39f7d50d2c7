//! When the firmware itself fails: say what happened in the log, and start afresh.
//!
//! A panic, a fault of the processor and an interrupt that nobody serves end in a reset. A sensor that stands still would
//! leave its last state on the line for ever; one that was reset answers again within milliseconds, with its uptime near
//! zero and no calibration, which no host can mistake for a valid measurement. A failure that comes back at once shows as a
//! sensor that resets again and again, and its log says why.

#![expect(unsafe_code, reason = "the run-time demands it of the handlers of faults")]

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use defmt_rtt as _;

#[panic_handler]
fn panic(information: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    defmt::error!("{}", defmt::Display2Format(information));
    SCB::sys_reset()
}

// SAFETY of both handlers: called by the processor alone; they leave by a reset, so what they interrupted does not matter.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    defmt::error!("fault of the processor at {=u32:#010x}", frame.pc());
    SCB::sys_reset()
}

#[exception]
unsafe fn DefaultHandler(interrupt: i16) {
    defmt::error!("interrupt {=i16} has no handler", interrupt);
    SCB::sys_reset()
}
