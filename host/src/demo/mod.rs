//! The demonstration: the whole job once, on a simulated board, by the code that runs on a real one.
//!
//! ```text
//! bench (mass, arm, hand) ─► converter model ─► driver and firmware ─► protocol ─► this
//! ```
//!
//! 1. [`trials`]: hang the mass at each arm, turn the sensor at random, let the sensor solve its own trial; then hold it at a
//!    few known directions.
//! 2. solve all trials jointly: the arms orient the frame, the known loads choose ([`crate::calibration`]); write the calibration file; upload it.
//! 3. [`mod@reference`]: the same sensor calibrated by least squares (eq. 3) on 13 known loads.
//! 4. [`validation`]: loads that neither calibration has seen, measured with both.
//! 5. [`report`] and [`figures`]: tables against the truth, and the paper's figures 5, 6, 8, 9.
//!
//! The bench is not kinder to one method than to the other: whoever states the direction or the magnitude of a load
//! is wrong by the same [`Workmanship`].

pub mod figures;
pub mod kept;
pub mod reference;
pub mod report;
pub mod trials;
pub mod validation;

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use ftcal_shared::units::{DataRate, Gain};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::calibration::upload::UploadError;
use crate::calibration::{Calibration, CalibrationRefusal, calibrate};
use crate::calibration_file;
use crate::link::client::Client;
use crate::link::error::ClientError;
use crate::link::frame::NoWrench;
use crate::plots::PlotError;
use crate::simulator::board::{SimulatedBoard, UnsupportedGages};
use crate::simulator::bus::SharedBench;
use crate::simulator::scenario::{Scenario, ScenarioKind};
use crate::simulator::sensor::SensorError;

/// What to demonstrate, and where to put the results.
#[derive(Clone, Debug)]
pub struct Options {
    /// Which of the paper's systems.
    pub scenario: ScenarioKind,
    /// The sensor, the hand, the noise and the errors of the bench all follow from this number.
    pub seed: u64,
    /// The folder for calibration file and figures; made where it does not exist.
    pub folder: PathBuf,
    /// Whether to keep the recordings, too, with the session file that calibrates from them.
    pub keep_recordings: bool,
}

/// How exactly a person applies a known load on this bench (paper, section 4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Workmanship {
    /// Standard deviation of its direction, radian.
    pub direction_rad: f64,
    /// Standard deviation of its magnitude, newton.
    pub force_newton: f64,
}

impl Workmanship {
    /// The paper's own figures: 1 mrad and 0.02 N for its six-axis sensor; 0.2° at the stage of the fingertip, whose
    /// weights of about 100 g are taken to be good to 0.1 g.
    pub const fn of(scenario: ScenarioKind) -> Self {
        match scenario {
            ScenarioKind::Fingertip => Self { direction_rad: 0.0035, force_newton: 0.001 },
            ScenarioKind::Force | ScenarioKind::Planar | ScenarioKind::Wrist => {
                Self { direction_rad: 0.001, force_newton: 0.02 }
            }
        }
    }
}

/// Why a demonstration ended early.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// The scenario's sensor makes no sense.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// The scenario's sensor fits on no board.
    #[error(transparent)]
    Board(#[from] UnsupportedGages),
    /// The conversation with the board failed, or the board refused.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// The calibration was refused.
    #[error("the calibration was refused: {0:?}")]
    Refused(CalibrationRefusal),
    /// The board streamed a sample without a wrench, though nothing on the bench is at fault.
    #[error("the simulated board gave no wrench: {0:?}")]
    NoWrench(NoWrench),
    /// The calibration does not fit the sensor's form.
    #[error(transparent)]
    Upload(#[from] UploadError),
    /// A figure could not be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// A file could not be written.
    #[error("{path}: cannot be written: {source}")]
    File {
        /// The file.
        path: String,
        /// What the system said.
        source: io::Error,
    },
    /// What is to be shown could not be written.
    #[error("cannot write: {0}")]
    Output(#[from] io::Error),
}

impl From<CalibrationRefusal> for DemoError {
    fn from(refusal: CalibrationRefusal) -> Self {
        Self::Refused(refusal)
    }
}

/// The converter's gain in all of the demonstration.
const GAIN: Gain = Gain::X128;

/// The bench and the board on it, with a client that talks to the board.
pub struct Stage {
    /// The loads, their turning, and the random errors of whoever works on the bench.
    pub bench: SharedBench,
    /// The conversation with the board.
    pub client: Client<SimulatedBoard>,
    /// Chance on the bench, apart from the sensor's own.
    pub chance: ChaCha8Rng,
    /// How exactly loads are applied.
    pub workmanship: Workmanship,
}

/// Runs the demonstration: tables to `out`, progress to `progress`, files into the folder.
///
/// # Errors
///
/// [`DemoError`].
pub fn run(options: &Options, out: &mut dyn Write, progress: &mut dyn Write) -> Result<(), DemoError> {
    let scenario = Scenario::new(options.scenario, options.seed)?;
    let board = SimulatedBoard::for_scenario(&scenario, options.seed)?;
    let mut stage = Stage {
        bench: board.bench(),
        client: Client::connect(board)?,
        chance: ChaCha8Rng::seed_from_u64(options.seed),
        workmanship: Workmanship::of(options.scenario),
    };
    let status = stage.client.configure_adc(DataRate::Hz1000, GAIN)?;
    writeln!(
        progress,
        "The sensor: {}, {} gages at {} samples/s, on a simulated board.",
        report::in_words(scenario.sensor.dof()),
        status.gages,
        status.data_rate.hertz()
    )?;

    let acquired = trials::acquire(&mut stage, &scenario, progress)?;
    let solved: Vec<_> = acquired.iter().map(|trial| trial.solved.clone()).collect();
    let of_trials = calibrate(scenario.sensor.dof(), trials::GRAVITY, &solved)?;
    let calibration = Calibration { gain: Some(GAIN), ..of_trials };
    match solved.len() {
        1 => writeln!(progress, "Oriented by its known loads, handedness proven.")?,
        trials => writeln!(
            progress,
            "Solved jointly: {trials} arms orient each other, handedness proven; they agree to {:.2} %.",
            100.0 * calibration.fusion_residual
        )?,
    }

    std::fs::create_dir_all(&options.folder).map_err(file_error(&options.folder))?;
    let file = options.folder.join("calibration.json");
    write_calibration(&calibration, &file)?;
    if options.keep_recordings {
        kept::keep(&acquired, scenario.sensor.dof(), &options.folder)?;
    }
    let upload = calibration.upload()?;
    stage.client.upload_calibration(&upload)?;
    writeln!(progress, "Uploaded as {:08x} and read back.", upload.identity)?;

    let least_squares = reference::calibrate(&mut stage, &scenario, progress)?;
    let measured = validation::measure(&mut stage, &scenario, &calibration, &least_squares, progress)?;

    report::write(&scenario, &calibration, &least_squares, &measured, out)?;
    let drawn = figures::draw(&acquired, &calibration, &measured, &options.folder)?;
    writeln!(out, "\nCalibration file: {}", file.display())?;
    for figure in drawn {
        writeln!(out, "{}: {}", figure.caption, figure.path.display())?;
    }
    if options.keep_recordings {
        writeln!(out, "Session with its recordings: {}", options.folder.join(kept::SESSION).display())?;
    }
    Ok(())
}

fn write_calibration(calibration: &Calibration, path: &Path) -> Result<(), DemoError> {
    let mut bytes = Vec::new();
    calibration_file::write(calibration, &mut bytes)?;
    std::fs::write(path, bytes).map_err(file_error(path))
}

/// Names the file in an error of the system.
pub(super) fn file_error(path: &Path) -> impl FnOnce(io::Error) -> DemoError {
    let path = path.display().to_string();
    move |source| DemoError::File { path, source }
}
