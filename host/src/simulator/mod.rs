//! A sensor without hardware: gages, load, hand and converter in virtual time, all from one seed.
//!
//! ```text
//! scenario ─► bench: motion ─► load ─► software sensor ─► volts ─► ADS131M08 model ─► SPI bytes
//!                       (hand)  (eq. 16, 19)  (eq. 4, 6)    ▲ channel faults     ▲ bus faults
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`sensor`] | true shape, bias and noise: wrench in, counts out |
//! | [`scenario`] | the four systems of the paper, each with its trials, known loads and validation loads |
//! | [`motion`] | hand-like turning with rests, and the accelerations that turning causes |
//! | [`ads131m08`] | the converter at the level of its SPI bytes |
//! | [`fault`] | what can go wrong, from a stuck gage to a missing converter |
//! | [`mod@bench`] | all of these together, one conversion at a time |
//! | [`bus`] | the bench as a driver sees it: an SPI device |
//! | [`board`] | the firmware's application on top of the bench |
//! | [`panel`] | the board's button and light |
//! | [`light`] | what the light shows, told from when it is on |
//! | [`flash`] | what the board keeps across a reset, in a file if need be |
//! | `line` | the serial line between that board and the host |
//! | [`tunnel`] | bench, flash and panel as the emulator's |
//! | [`emulator`] | the firmware's image in QEMU |
//! | [`operator`] | somebody who hangs loads, turns the sensor, plays faults and presses the button on demand |
//! | [`pseudo_terminal`] | a board behind a serial port that other programs can open |

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

pub mod ads131m08;
pub mod bench;
pub mod board;
pub mod bus;
#[cfg(unix)]
pub mod emulator;
pub mod fault;
pub mod flash;
pub mod light;
mod line;
pub mod motion;
pub mod operator;
pub mod panel;
#[cfg(unix)]
pub mod pseudo_terminal;
pub mod scenario;
pub mod sensor;
#[cfg(all(unix, test))]
pub(crate) mod served_board;
pub mod tunnel;

/// What a random sequence is for. Each purpose has its own, so that playing a fault, say, changes no noise sample.
#[derive(Clone, Copy)]
enum Purpose {
    Sensor,
    Noise,
    Motion,
    Faults,
}

/// The random sequence of this seed for this purpose.
fn random_sequence(seed: u64, purpose: Purpose) -> ChaCha8Rng {
    let mut sequence = ChaCha8Rng::seed_from_u64(seed);
    sequence.set_stream(match purpose {
        Purpose::Sensor => 0,
        Purpose::Noise => 1,
        Purpose::Motion => 2,
        Purpose::Faults => 3,
    });
    sequence
}
