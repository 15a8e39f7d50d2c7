//! Where conversion results wait for the host (datasheet section 8.5.1.9.1).
//!
//! Two conversions fit. They leave oldest first, and the data-ready flags stay set until both have left: a host that
//! missed a conversion reads results one conversion late until it reads twice in a row. When both places are taken, a
//! new result displaces the older one. A frame that asks for more than there is repeats the last result.
//!
//! With data ready announced as a pulse, an unread result costs the next conversion, which is skipped without a pulse.

use std::collections::VecDeque;

use ftcal_shared::units::AdcCode;

use super::CHANNELS;

/// Conversions that wait at most.
const DEPTH: usize = 2;

/// Results on their way to the host.
#[derive(Clone, Debug)]
pub(super) struct ResultBuffer {
    waiting: VecDeque<[AdcCode; CHANNELS]>,
    last_read: [AdcCode; CHANNELS],
    pulse_skipped: bool,
}

impl ResultBuffer {
    /// Nothing converted yet.
    pub(super) fn empty() -> Self {
        Self {
            waiting: VecDeque::with_capacity(DEPTH),
            last_read: [AdcCode::ZERO; CHANNELS],
            pulse_skipped: false,
        }
    }

    /// Whether a result waits.
    pub(super) fn has_new(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Takes a result in and says whether data ready announces it; a conversion that is skipped leaves no result.
    pub(super) fn put(&mut self, codes: [AdcCode; CHANNELS], announced_by_pulse: bool) -> bool {
        if announced_by_pulse && self.has_new() && !self.pulse_skipped {
            self.pulse_skipped = true;
            return false;
        }
        self.pulse_skipped = false;
        if self.waiting.len() == DEPTH {
            self.waiting.pop_front();
        }
        self.waiting.push_back(codes);
        true
    }

    /// What the next frame carries.
    pub(super) fn next(&self) -> [AdcCode; CHANNELS] {
        self.waiting.front().copied().unwrap_or(self.last_read)
    }

    /// That frame has been read.
    pub(super) fn mark_read(&mut self) {
        if let Some(codes) = self.waiting.pop_front() {
            self.last_read = codes;
        }
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::AdcCode;

    use super::ResultBuffer;

    fn codes(value: i64) -> [AdcCode; 8] {
        [AdcCode::saturating(value); 8]
    }

    fn read(buffer: &mut ResultBuffer) -> [AdcCode; 8] {
        let next = buffer.next();
        buffer.mark_read();
        next
    }

    #[test]
    fn read_in_time_every_result_comes_once() {
        for pulse in [false, true] {
            let mut buffer = ResultBuffer::empty();
            for value in 1..10 {
                assert!(buffer.put(codes(value), pulse));
                assert_eq!(read(&mut buffer), codes(value));
                assert!(!buffer.has_new());
            }
        }
    }

    #[test]
    fn after_a_pause_the_last_two_wait_and_the_last_repeats() {
        let mut buffer = ResultBuffer::empty();
        for value in 1..=5 {
            assert!(buffer.put(codes(value), false), "a level announces every conversion");
        }
        assert_eq!([(); 4].map(|()| read(&mut buffer)), [4, 5, 5, 5].map(codes));
    }

    #[test]
    fn a_missed_result_delays_all_that_follow() {
        let mut buffer = ResultBuffer::empty();
        buffer.put(codes(1), false);
        for value in 2..10 {
            buffer.put(codes(value), false);
            assert_eq!(read(&mut buffer), codes(value - 1));
            assert!(buffer.has_new());
        }
    }

    #[test]
    fn an_unread_pulse_costs_the_next_conversion() {
        let mut buffer = ResultBuffer::empty();
        assert_eq!(
            [1, 2, 3, 4, 5].map(|value| buffer.put(codes(value), true)),
            [true, false, true, false, true]
        );
        assert_eq!([read(&mut buffer), read(&mut buffer)], [3, 5].map(codes));
    }
}
