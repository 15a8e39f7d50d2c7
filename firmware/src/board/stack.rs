//! The stack: how much of it has been in use, and whether it has overflowed.
//!
//! It stands below everything else in memory (`memory.x`), so that a stack that grows too large runs into addresses where there
//! is nothing, and the processor stops it, instead of into the variables, where it would go on with wrong numbers. The run-time
//! paints it before anything runs (`paint-stack`): the paint that is left shows how far it has ever been.

#![expect(unsafe_code, reason = "the memory below the stack pointer belongs to nobody and is only read")]

use core::ptr::{addr_of, read_volatile};

/// What `cortex-m-rt` paints with.
const PAINT: u32 = 0xcccc_cccc;

unsafe extern "C" {
    /// Where the stack begins: its highest address.
    static _stack_start: u32;
    /// Its lowest.
    static _stack_end: u32;
}

/// Where the stack begins.
pub(super) fn top() -> u32 {
    address(addr_of!(_stack_start))
}

/// Whether this address is one of the stack.
pub(super) fn contains(at: u32) -> bool {
    (address(addr_of!(_stack_end))..top()).contains(&at)
}

/// Bytes of the stack.
pub(super) fn size() -> u32 {
    top() - address(addr_of!(_stack_end))
}

/// Bytes of it that have ever been in use. Takes some ten instructions for each four bytes that have not.
pub(super) fn used() -> u32 {
    let (mut at, top) = (addr_of!(_stack_end), addr_of!(_stack_start));
    // SAFETY: both symbols are the linker's, aligned to words, and all between them is memory.
    while at < top && unsafe { read_volatile(at) } == PAINT {
        at = at.wrapping_add(1);
    }
    address(top) - address(at)
}

#[expect(clippy::cast_possible_truncation, reason = "the processor has 32 bits")]
fn address(of: *const u32) -> u32 {
    of.addr() as u32
}
