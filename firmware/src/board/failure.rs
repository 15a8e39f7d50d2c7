//! When the firmware itself fails: keep what happened, say it in the log, and start afresh.
//!
//! A panic, a fault of the processor and an interrupt that nobody serves end in a reset. A sensor that stands still would
//! leave its last state on the line for ever; one that was reset answers again within milliseconds, with its uptime near
//! zero, which no host can mistake. What happened is kept in memory that a reset does not clear ([`ftcal_firmware::black_box`]),
//! and told with the next diagnosis. A failure that comes back at once shows as a sensor that resets again and again.

#![expect(
    unsafe_code,
    reason = "the run-time demands it of the handlers of faults, and memory that it does not clear"
)]

use core::arch::naked_asm;
use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use ftcal_firmware::black_box::{RECORD_BYTES, Record, open, seal};
use ftcal_shared::wire::Failure;

#[cfg(not(feature = "emulated"))]
use defmt_rtt as _;
#[cfg(feature = "emulated")]
use defmt_semihosting as _;

use super::stack;

/// Where the program counter stands in what the processor puts on the stack for an exception, in words.
const PROGRAM_COUNTER: u32 = 6;

/// Memory that outlives a reset.
struct Kept(UnsafeCell<MaybeUninit<Record>>);

// SAFETY: written where nothing else runs any more, and read before anything else runs.
unsafe impl Sync for Kept {}

#[unsafe(link_section = ".uninit.BLACK_BOX")]
static BLACK_BOX: Kept = Kept(UnsafeCell::new(MaybeUninit::uninit()));

/// The failure before the last reset, if there was one; the next reset tells it no more. To be called once, first of all.
pub(super) fn take() -> Option<Failure> {
    // SAFETY: any bytes are a record, if a wrong one; nothing else runs yet.
    let record: Record = unsafe { BLACK_BOX.0.get().cast::<Record>().read_volatile() };
    keep([0; RECORD_BYTES]);
    open(&record)
}

fn keep(record: Record) {
    // SAFETY: nothing else runs, yet or any more.
    unsafe { BLACK_BOX.0.get().cast::<Record>().write_volatile(record) };
}

fn give_up(failure: &Failure) -> ! {
    keep(seal(failure));
    SCB::sys_reset()
}

#[panic_handler]
fn panic(information: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    let (file, line) = information.location().map_or(("", 0), |place| (place.file(), place.line()));
    defmt::error!("panic at {=str}:{=u32}", file, line);
    give_up(&Failure::panic(file, line))
}

/// A fault of the processor. A stack that has overflowed is none to work with, not even for a function's first instruction; so the stack is
/// given up before anything else is done, but for the address of what the processor has put there.
// SAFETY: called by the processor alone; it leaves by a reset, so what it interrupted does not matter, and the whole stack is free.
#[unsafe(naked)]
#[unsafe(export_name = "HardFault")]
#[unsafe(link_section = ".HardFault.ftcal")]
unsafe extern "C" fn hard_fault() -> ! {
    naked_asm!(
        "mrs r0, msp",
        "movw r1, :lower16:_stack_start",
        "movt r1, :upper16:_stack_start",
        "msr msp, r1",
        "b {fault}",
        fault = sym fault,
    )
}

extern "C" fn fault(frame: u32) -> ! {
    let counter = frame.wrapping_add(4 * PROGRAM_COUNTER);
    if !stack::contains(frame) {
        give_up(&Failure::StackOverflow);
    }
    // SAFETY: what the processor has put there is inside of the stack.
    let at = unsafe { (counter as usize as *const u32).read_volatile() };
    give_up(&Failure::ProcessorFault { at })
}

// SAFETY: called by the processor alone; it leaves by a reset.
#[exception]
unsafe fn DefaultHandler(interrupt: i16) {
    give_up(&Failure::UnservedInterrupt { number: interrupt })
}
