//! Emulated boards on busy machines, which stand still for seconds.

use std::fmt::Display;
use std::time::{Duration, Instant};

/// How long anything may take on a busy machine.
pub const PATIENCE: Duration = Duration::from_mins(1);

/// Asks again where there is no answer, or none of use, for at most [`PATIENCE`].
///
/// # Panics
///
/// Where there is none then.
pub fn patiently<Answer, Problem: Display>(mut ask: impl FnMut() -> Result<Answer, Problem>) -> Answer {
    let begin = Instant::now();
    loop {
        match ask() {
            Ok(answer) => return answer,
            Err(error) => assert!(begin.elapsed() < PATIENCE, "{error}"),
        }
    }
}
