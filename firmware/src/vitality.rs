//! Vitality: which tasks have run since the watchdog was last fed.
//!
//! The watchdog resets a sensor that hangs. One that is fed by a timer alone would watch over nothing but the timer, so it is
//! fed only when every task has reported. The sample path has a watch of its own: a converter that falls silent is started again
//! ([`crate::acquisition`]), which is no reason for a reset, and a sample path that hangs keeps every task below it from running.

use core::sync::atomic::{AtomicU8, Ordering};

/// A task that must keep running.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// The tick, which watches over the converter.
    Tick,
    /// The sample path below the interrupt that reads the converter.
    Process,
    /// The conversation with the host.
    Session,
    /// The background, which solves trials.
    Background,
}

/// Which tasks have reported. May be shared by all of them.
#[derive(Debug, Default)]
pub struct Vitality {
    reported: AtomicU8,
}

impl Vitality {
    const ALL: u8 = Task::Tick.bit() | Task::Process.bit() | Task::Session.bit() | Task::Background.bit();

    /// Nobody has reported yet.
    pub const fn new() -> Self {
        Self { reported: AtomicU8::new(0) }
    }

    /// This task has run.
    pub fn report(&self, task: Task) {
        self.reported.fetch_or(task.bit(), Ordering::Relaxed);
    }

    /// Whether all have run since this last was so.
    pub fn all_have_run(&self) -> bool {
        let all = self.reported.load(Ordering::Relaxed) == Self::ALL;
        if all {
            self.reported.store(0, Ordering::Relaxed);
        }
        all
    }
}

impl Task {
    const fn bit(self) -> u8 {
        1 << self as u8
    }
}

#[cfg(test)]
mod tests {
    use super::{Task, Vitality};

    const TASKS: [Task; 4] = [Task::Tick, Task::Process, Task::Session, Task::Background];

    #[test]
    fn whoever_stays_out_is_missed_whatever_the_others_do() {
        for missing in TASKS {
            let vitality = Vitality::new();
            for _ in 0..100 {
                TASKS.iter().filter(|task| **task != missing).for_each(|task| vitality.report(*task));
                assert!(!vitality.all_have_run(), "{missing:?}");
            }
            vitality.report(missing);
            assert!(vitality.all_have_run());
            assert!(!vitality.all_have_run(), "once is not for good");
        }
    }
}
