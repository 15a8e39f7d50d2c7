//! Somebody at the bench: what they can be told to do, one line of text each.
//!
//! ```text
//! hang MASS_KG [AX AY [AZ]]    hang this mass at this moment arm (metre, sensor frame)
//! unload                       take it off
//! hold X Y [Z]                 hold still, the force along this direction of the sensor frame
//! turn                         turn through all directions
//! press SECONDS                hold the sensor's button down
//! fault NAME …                 see FAULTS
//! ```

use std::str::{FromStr, SplitWhitespace};
use std::thread;
use std::time::Duration;

use nalgebra::{UnitVector3, Vector3};
use thiserror::Error;

use super::bench::{Bench, Load};
use super::bus::SharedBench;
use super::fault::{Fault, Rail};
use super::motion::Turning;
use super::panel::SharedPanel;

/// What somebody at the bench understands.
pub const HELP: &str = "\
hang MASS_KG [AX AY [AZ]]              hang this mass on the sensor at this moment arm (metre, sensor frame)
unload                                 take the mass off
hold X Y [Z]                           hold still, with the force along this direction of the sensor frame
turn                                   turn through all directions (a planar sensor: in the plane, counterclockwise)
press SECONDS                          hold the sensor's button down for so long; what its light shows is told
fault stuck CHANNEL                    the channel repeats its reading
fault open CHANNEL                     the gage's wire is broken
fault saturated CHANNEL                the channel stands at the end of its range
fault drifting CHANNEL COUNTS_PER_S    the gage's zero drifts
fault debonded CHANNEL KEPT            the gage has come off: it keeps this share of its signal, 0 to 1
fault dead CHANNEL                     the gage has no supply
fault noisy CHANNEL COUNTS             the channel has this much more noise
fault bit-errors P                     bits flip on the converter's bus with this probability
fault no-data-ready P                  conversions are not announced with this probability
fault late-reply                       the converter's replies come one frame late
fault identity                         the converter says that it is another part
fault missing                          there is no converter
fault none                             take back every fault";

/// Something to do at the bench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Hang a load on the sensor.
    Hang(Load),
    /// Take it off.
    Unload,
    /// Hold still with the force along this direction.
    Hold(UnitVector3<f64>),
    /// Turn through all directions.
    Turn,
    /// Hold the button down for so long.
    Press(Duration),
    /// Let a fault act.
    Inject(Fault),
    /// Take back every fault.
    ClearFaults,
}

/// Why a line is no order.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum OrderError {
    /// The first word, or the name of the fault, means nothing.
    #[error("not understood")]
    Unknown,
    /// A number is missing, is none, or is not possible here.
    #[error("expected {0}")]
    Expected(&'static str),
    /// There is more on the line than belongs there.
    #[error("too many words")]
    TooMany,
}

/// How long the button is held down at most, seconds.
const LONGEST_PRESS_S: f64 = 60.0;

/// Between two looks at the clock.
const LOOK: Duration = Duration::from_millis(1);

/// What another part than an ADS131M08 has in its identity register: an ADS131M04.
const OTHER_PART: u16 = 0x2400;

impl FromStr for Order {
    type Err = OrderError;

    fn from_str(line: &str) -> Result<Self, OrderError> {
        let mut words = line.split_whitespace();
        let order = match words.next() {
            Some("hang") => Self::Hang(load(&mut words)?),
            Some("unload") => Self::Unload,
            Some("hold") => Self::Hold(direction(&mut words)?),
            Some("turn") => Self::Turn,
            Some("press") => Self::Press(press_time(&mut words)?),
            Some("fault") => fault(&mut words)?,
            _ => return Err(OrderError::Unknown),
        };
        if words.next().is_none() { Ok(order) } else { Err(OrderError::TooMany) }
    }
}

impl Order {
    /// Does it. To press the button takes as long as it says, by the clock of the bench, which somebody else lets pass meanwhile.
    pub fn carry_out(self, bench: &SharedBench, panel: &SharedPanel) {
        match self {
            Self::Hang(load) => bench.with(|bench| bench.hang(load)),
            Self::Unload => bench.with(Bench::unload),
            Self::Hold(direction) => bench.with(|bench| bench.hold(direction)),
            Self::Turn => bench.with(turn),
            Self::Press(time) => press(time, bench, panel),
            Self::Inject(fault) => bench.with(|bench| bench.inject(fault)),
            Self::ClearFaults => bench.with(Bench::clear_faults),
        }
    }
}

fn press(time: Duration, bench: &SharedBench, panel: &SharedPanel) {
    let now = || Duration::from_micros(bench.with(|bench| bench.now()).as_micros());
    let end = now() + time;
    panel.press(true);
    while now() < end {
        thread::sleep(LOOK);
    }
    panel.press(false);
}

/// Turns the sensor as its trials demand: in space, or in the plane, from the direction of the paper's stage downwards.
pub fn turn(bench: &mut Bench) {
    if bench.sensor().dof().trial_rank() == 2 {
        bench.hold(-Vector3::y_axis());
        bench.turn_in_plane(Turning::Counterclockwise);
    } else {
        bench.turn();
    }
}

fn load(words: &mut SplitWhitespace) -> Result<Load, OrderError> {
    const EXPECTED: OrderError =
        OrderError::Expected("a mass in kilogram and, if it has one, an arm in metre");
    let mass_kg = number(words)?.filter(|&mass| mass > 0.0).ok_or(EXPECTED)?;
    let arm_m = vector(words)?.unwrap_or_default();
    Ok(Load { mass_kg, arm_m })
}

fn press_time(words: &mut SplitWhitespace) -> Result<Duration, OrderError> {
    const EXPECTED: OrderError = OrderError::Expected("seconds, 60 at most");
    let seconds = number(words)?.filter(|&seconds| seconds > 0.0 && seconds <= LONGEST_PRESS_S);
    seconds.map(Duration::from_secs_f64).ok_or(EXPECTED)
}

fn direction(words: &mut SplitWhitespace) -> Result<UnitVector3<f64>, OrderError> {
    const EXPECTED: OrderError = OrderError::Expected("a direction: two or three numbers, not all zero");
    let vector = vector(words)?.ok_or(EXPECTED)?;
    UnitVector3::try_new(vector, f64::MIN_POSITIVE.sqrt()).ok_or(EXPECTED)
}

fn fault(words: &mut SplitWhitespace) -> Result<Order, OrderError> {
    Ok(Order::Inject(match words.next() {
        Some("stuck") => Fault::StuckChannel { channel: channel(words)? },
        Some("open") => Fault::OpenChannel { channel: channel(words)? },
        Some("saturated") => Fault::SaturatedChannel { channel: channel(words)?, rail: Rail::High },
        Some("drifting") => {
            let channel = channel(words)?;
            let counts_per_second = number(words)?.ok_or(OrderError::Expected("counts a second"))?;
            Fault::DriftingChannel { channel, counts_per_second }
        }
        Some("debonded") => {
            let channel = channel(words)?;
            Fault::DebondedChannel { channel, kept: probability(words)? }
        }
        Some("dead") => Fault::DeadChannel { channel: channel(words)? },
        Some("noisy") => {
            let channel = channel(words)?;
            let noise_counts = number(words)?.filter(|&counts| counts >= 0.0);
            Fault::NoisyChannel { channel, noise_counts: noise_counts.ok_or(OrderError::Expected("counts"))? }
        }
        Some("bit-errors") => Fault::BusBitErrors { probability: probability(words)? },
        Some("no-data-ready") => Fault::DataReadyLost { probability: probability(words)? },
        Some("late-reply") => Fault::LateReply,
        Some("identity") => Fault::WrongIdentity { id: OTHER_PART },
        Some("missing") => Fault::ConverterMissing,
        Some("none") => return Ok(Order::ClearFaults),
        _ => return Err(OrderError::Unknown),
    }))
}

fn channel(words: &mut SplitWhitespace) -> Result<usize, OrderError> {
    let channel = words.next().and_then(|word| word.parse().ok());
    channel.filter(|&channel| channel < 8).ok_or(OrderError::Expected("a channel from 0 to 7"))
}

fn probability(words: &mut SplitWhitespace) -> Result<f64, OrderError> {
    let probability = number(words)?.filter(|p| (0.0..=1.0).contains(p));
    probability.ok_or(OrderError::Expected("a probability from 0 to 1"))
}

/// Two or three numbers, or none.
fn vector(words: &mut SplitWhitespace) -> Result<Option<Vector3<f64>>, OrderError> {
    let Some(x) = number(words)? else { return Ok(None) };
    let y = number(words)?.ok_or(OrderError::Expected("two or three numbers"))?;
    let z = number(words)?.unwrap_or(0.0);
    Ok(Some(Vector3::new(x, y, z)))
}

/// The next word as a number; `None` at the end of the line.
fn number(words: &mut SplitWhitespace) -> Result<Option<f64>, OrderError> {
    let Some(word) = words.next() else { return Ok(None) };
    let number = word.parse().ok().filter(|number: &f64| number.is_finite());
    number.map(Some).ok_or(OrderError::Expected("a number"))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use std::thread;
    use std::time::Duration;

    use super::{Bench, HELP, Order, OrderError, SharedBench, SharedPanel};
    use crate::simulator::bench::{Load, STANDARD_GRAVITY};
    use crate::simulator::scenario::{Scenario, ScenarioKind};

    fn bench() -> SharedBench {
        let sensor = Scenario::new(ScenarioKind::Wrist, 1).expect("sizes fit").sensor;
        SharedBench::new(Bench::new(sensor, 1))
    }

    #[test]
    fn the_button_is_held_down_by_the_clock_of_the_bench() {
        let (bench, panel) = (bench(), SharedPanel::default());
        let (at, on) = (bench.clone(), panel.clone());
        let pressing = thread::spawn(move || Order::Press(Duration::from_secs(2)).carry_out(&at, &on));
        while !panel.is_pressed() {
            thread::sleep(Duration::from_millis(1));
        }
        // No time passes at the bench.
        thread::sleep(Duration::from_millis(50));
        assert!(panel.is_pressed());
        while bench.with(|bench| bench.now().as_micros()) < 2_000_000 {
            bench.with(Bench::next_conversion);
        }
        pressing.join().expect("does not panic");
        assert!(!panel.is_pressed());
    }

    #[test]
    fn orders_are_carried_out_on_the_bench() {
        let (bench, panel) = (bench(), SharedPanel::default());
        let tell = |line: &str| {
            line.parse::<Order>().expect("understood").carry_out(&bench, &panel);
            bench.with(|bench| bench.true_wrench())
        };
        tell("hang 2 0.1 0 0.05");
        let wrench = tell(" hold 0 3  0 ");
        assert!((wrench.force_newton - Vector3::new(0.0, 2.0 * STANDARD_GRAVITY, 0.0)).norm() < 1e-9);
        assert!((wrench.torque_newton_metre.z - 0.2 * STANDARD_GRAVITY).abs() < 1e-9);
        assert_eq!(tell("unload").force_newton, Vector3::zeros());
        assert_eq!(
            "hang 0.5".parse(),
            Ok(Order::Hang(Load { mass_kg: 0.5, arm_m: Vector3::zeros() })),
            "force sensors need no arm"
        );
    }

    #[test]
    fn every_line_of_the_help_is_understood() {
        for line in HELP.lines() {
            let (usage, _) = line.split_once("  ").expect("usage and meaning are apart");
            let line = usage.replace(['[', ']'], "");
            let filled: Vec<&str> = line
                .split_whitespace()
                .map(|word| match word {
                    "CHANNEL" => "3",
                    "P" => "0.5",
                    _ if word.chars().all(|letter| letter.is_uppercase() || letter == '_') => "0.25",
                    _ => word,
                })
                .collect();
            assert!(filled.join(" ").parse::<Order>().is_ok(), "{filled:?}");
        }
    }

    #[test]
    fn what_is_not_understood_says_so() {
        for line in [
            "",
            "dance",
            "fault",
            "fault gremlins",
            "hang",
            "hang 0",
            "hang nan",
            "hang 1 0.1",
            "hold",
            "hold 0 0 0",
            "press",
            "press -1",
            "press 1e9",
        ] {
            assert!(line.parse::<Order>().is_err(), "{line}");
        }
        assert!(matches!("fault stuck 8".parse::<Order>(), Err(OrderError::Expected(_))));
        assert_eq!("turn left".parse::<Order>(), Err(OrderError::TooMany));
    }
}
