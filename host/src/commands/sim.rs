//! `ftcal sim`: a simulated sensor behind a pseudo-terminal.

use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use std::{io, thread};

use anyhow::{Context, anyhow};
use clap::Args;
use ftcal_firmware::storage::memory::Memory;
use ftcal_shared::units::DataRate;
use ftcal_shared::wire::frame::encode;
use ftcal_shared::wire::{Request, ToDevice};

use super::record::data_rate;
use super::{Failure, Streams};
use crate::link::transport::Transport;
use crate::recording::shown;
use crate::simulator::bench::Bench;
use crate::simulator::board::SimulatedBoard;
use crate::simulator::bus::SharedBench;
use crate::simulator::emulator::Emulator;
use crate::simulator::flash::SimulatedFlash;
use crate::simulator::light::{LightWatch, in_words};
use crate::simulator::operator::{HELP, Order, turn};
use crate::simulator::panel::SharedPanel;
use crate::simulator::pseudo_terminal::{PortLink, PseudoTerminal};
use crate::simulator::scenario::{Scenario, ScenarioKind};
use crate::simulator::tunnel::Pace;

/// The arguments of `ftcal sim`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// Which of the paper's systems
    #[arg(long, value_enum, default_value = "wrist")]
    scenario: ScenarioKind,
    /// Seed of everything random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Data rate at the start, samples per second: 250, 500, 1000, 2000, 4000, 8000, 16000 or 32000; without it, that which its
    /// memory keeps, and 1000 where it keeps none
    #[arg(long, value_name = "HZ", value_parser = data_rate)]
    rate: Option<DataRate>,
    /// Make a symbolic link to the port here
    #[arg(long, value_name = "PATH")]
    link: Option<PathBuf>,
    /// Run this image of the firmware in QEMU instead of the firmware's code compiled for this machine
    #[arg(long, value_name = "IMAGE", conflicts_with = "rate")]
    emulator: Option<PathBuf>,
    /// Write what the image logs to this file; `ftcal logs` puts it into words
    #[arg(long, value_name = "FILE", requires = "emulator")]
    logs: Option<PathBuf>,
    /// What the sensor keeps across resets is in this file, which is made where there is none
    #[arg(long, value_name = "FILE")]
    flash: Option<PathBuf>,
}

/// How often a running emulator looks whether it is to stop.
const LOOK: Duration = Duration::from_millis(50);

/// Between two looks at the light, whose patterns change in eighths of a second.
const GLANCE: Duration = Duration::from_millis(10);

/// Gages of the firmware's image.
const IMAGE_GAGES: usize = 8;

/// Serves until `quit` is typed, or until the process is ended.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let scenario = Scenario::new(arguments.scenario, arguments.seed).map_err(Failure::input)?;
    match &arguments.emulator {
        None => serve_board(arguments, &scenario, streams),
        Some(image) => run_image(arguments, &scenario, image, streams),
    }
}

/// Serves the firmware's application, compiled for this machine.
fn serve_board(arguments: &Arguments, scenario: &Scenario, streams: &mut Streams) -> Result<(), Failure> {
    let board = switched_on(scenario, arguments.seed, flash(arguments)?, arguments.rate)?;
    let (bench, panel) = (board.bench(), board.panel());
    let mut board = board.into_board();
    let mut terminal = PseudoTerminal::open().context("no pseudo-terminal can be made")?;
    let _link = announce(arguments, scenario, &bench, terminal.path(), streams)?;
    let stop = operate(bench, panel)?;
    Ok(terminal.serve(board.as_mut(), &stop).context("the pseudo-terminal cannot be served")?)
}

/// A board with this flash, which is switched on and told to go at this rate, if at any; all else is as the flash keeps it.
fn switched_on(
    scenario: &Scenario,
    seed: u64,
    flash: SimulatedFlash,
    rate: Option<DataRate>,
) -> Result<SimulatedBoard, Failure> {
    let kept = Memory::new(flash.clone()).read().ok().and_then(|kept| kept.settings).unwrap_or_default();
    let mut board =
        SimulatedBoard::with_flash(scenario.sensor.clone(), seed, flash).map_err(Failure::input)?;
    if let Some(rate) = rate {
        let configure = ToDevice::Request(0, Request::ConfigureAdc(rate, kept.gain));
        let frame = encode(&configure).map_err(|_| anyhow!("the request does not fit into a frame"))?;
        board.write(&frame).context("the simulated line takes no bytes")?;
    }
    Ok(board)
}

/// The flash in the file, or one that is as new.
fn flash(arguments: &Arguments) -> Result<SimulatedFlash, Failure> {
    let Some(path) = &arguments.flash else { return Ok(SimulatedFlash::default()) };
    Ok(SimulatedFlash::in_file(path).with_context(|| shown(path))?)
}

/// Runs the firmware's image in QEMU.
fn run_image(
    arguments: &Arguments,
    scenario: &Scenario,
    image: &Path,
    streams: &mut Streams,
) -> Result<(), Failure> {
    let bench = SharedBench::new(Bench::new(scenario.sensor.clone(), arguments.seed));
    let emulator = Emulator::start_with(
        image,
        bench.clone(),
        flash(arguments)?,
        Pace::RealTime,
        arguments.logs.as_deref(),
    )
    .map_err(Failure::input)?;
    let _link = announce(arguments, scenario, &bench, emulator.link(), streams)?;
    let gages = scenario.sensor.gages();
    if gages < IMAGE_GAGES {
        writeln!(
            streams.words,
            "The image has {IMAGE_GAGES} gages: ch{gages} to ch{} are connected to nothing.",
            IMAGE_GAGES - 1
        )?;
    }
    let stop = operate(bench, emulator.panel())?;
    while !stop.load(Ordering::Relaxed) {
        thread::sleep(LOOK);
    }
    Ok(())
}

/// Hangs the first trial's load on the sensor, says so, and prints the port's path. The link lives as long as what is
/// returned.
fn announce(
    arguments: &Arguments,
    scenario: &Scenario,
    bench: &SharedBench,
    port: &Path,
    streams: &mut Streams,
) -> Result<Option<PortLink>, Failure> {
    let link = match &arguments.link {
        None => None,
        Some(at) => {
            let cannot_link = || format!("{}: no link can be made there", shown(at));
            Some(PortLink::new(port, at).with_context(cannot_link)?)
        }
    };
    let sensor = &scenario.sensor;
    writeln!(streams.words, "A simulated sensor of {} gages, seed {}.", sensor.gages(), arguments.seed)?;
    if let Some(trial) = scenario.trials.first() {
        let (load, arm) = (trial.load, trial.load.arm_m);
        bench.with(|bench| {
            bench.hang(load);
            turn(bench);
        });
        write!(streams.words, "It is being turned with {} kg", load.mass_kg)?;
        if sensor.dof().has_torque() {
            write!(streams.words, " at the arm ({}, {}, {}) m", arm.x, arm.y, arm.z)?;
        }
        writeln!(streams.words, ". Type `help` for what else can be done at the bench.")?;
    }
    writeln!(streams.data, "{}", arguments.link.as_deref().unwrap_or(port).display())?;
    streams.data.flush()?;
    Ok(link)
}

/// Has what is typed carried out at the bench from now on, and says what the light shows. What is returned turns true when it says to stop, and when the
/// process is told to end: QEMU and the link are to go with it.
fn operate(bench: SharedBench, panel: SharedPanel) -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let interrupted = Arc::clone(&stop);
    ctrlc::set_handler(move || interrupted.store(true, Ordering::Relaxed))
        .context("the end of the process cannot be waited for")?;
    let watched = panel.clone();
    thread::spawn(move || watch_light(&watched));
    let told_to_stop = Arc::clone(&stop);
    // Not waited for in the end: it may be waiting for a line that never comes.
    thread::spawn(move || carry_out_lines(&bench, &panel, &told_to_stop));
    Ok(stop)
}

/// Says what the light shows, whenever that changes.
fn watch_light(panel: &SharedPanel) {
    let (mut watch, begin) = (LightWatch::default(), Instant::now());
    loop {
        if let Some(light) = watch.look(begin.elapsed(), panel.light()) {
            eprintln!("light: {}", in_words(light));
        }
        thread::sleep(GLANCE);
    }
}

/// Carries out what is typed. At the end of the input the board goes on being served.
fn carry_out_lines(bench: &SharedBench, panel: &SharedPanel, stop: &AtomicBool) {
    for line in io::stdin().lock().lines() {
        let Ok(line) = line else { return };
        match line.trim() {
            "" => {}
            "quit" | "exit" => {
                stop.store(true, Ordering::Relaxed);
                return;
            }
            "help" => eprintln!("{HELP}\nquit                        end the simulation"),
            line => match line.parse::<Order>() {
                Ok(order) => order.carry_out(bench, panel),
                Err(error) => eprintln!("{line}: {error}; type `help`"),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{DataRate, Gain};

    use super::{Scenario, ScenarioKind, SimulatedFlash, switched_on};
    use crate::link::client::Client;
    use crate::simulator::board::SimulatedBoard;

    #[test]
    fn what_the_flash_keeps_holds_unless_a_rate_is_asked_for() {
        let scenario = Scenario::new(ScenarioKind::Force, 1).expect("sizes fit");
        let flash = SimulatedFlash::default();
        let on = |rate| -> Client<SimulatedBoard> {
            let board = switched_on(&scenario, 1, flash.clone(), rate).expect("sizes fit");
            Client::connect(board).expect("answers")
        };
        let set = |client: &mut Client<SimulatedBoard>| {
            let status = client.wait_for_converter().expect("the converter starts");
            (status.data_rate, status.gain)
        };
        let mut client = on(None);
        assert_eq!(set(&mut client), (DataRate::Hz1000, Gain::X128));
        client.configure_adc(DataRate::Hz500, Gain::X64).expect("the converter starts");
        client.store_settings().expect("stores");
        assert_eq!(set(&mut on(None)), (DataRate::Hz500, Gain::X64));
        assert_eq!(set(&mut on(Some(DataRate::Hz2000))), (DataRate::Hz2000, Gain::X64));
    }
}
