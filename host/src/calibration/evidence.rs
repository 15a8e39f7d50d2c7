//! From a session file to solved trials: opens the recordings it names, cuts out the rests, solves each trial.

use std::path::Path;

use super::known_load::{KnownLoad, LoadCase, average};
use super::linearity::{self, Linearity};
use super::motion;
use super::turning::{Turned, swept};
use super::{Calibration, CalibrationRefusal, Method, SolvedTrial, least_squares, reference, trial};
use crate::place::Place;
use crate::recording::{Recording, RecordingError, WindowError, shown};
use crate::session_file::{Rest, Role, Session, SessionError, SessionTrial};

/// Why a session gives no calibration.
#[derive(Debug)]
pub enum CalibrationFailure {
    /// A file is not what it should be.
    Input(EvidenceError),
    /// The evidence does not settle the answer.
    Refused(CalibrationRefusal),
}

/// Why the evidence that a session names cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum EvidenceError {
    /// The session file.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A recording.
    #[error("{error} (named in {session}: {place})")]
    Recording {
        /// The session file.
        session: String,
        /// Where it names the recording.
        place: Place,
        /// What is wrong with it.
        error: Box<RecordingError>,
    },
    /// A window of a recording.
    #[error("{session}: {place}: expected a part of the trial's recording, found {error}")]
    Window {
        /// The session file.
        session: String,
        /// Where it names the window.
        place: Place,
        /// What is wrong with it.
        error: WindowError,
    },
    /// Recordings of one sensor have different numbers of gages.
    #[error(
        "{session}: {place}: expected a recording of {expected} gages as the first one, found {found} gages"
    )]
    Gages {
        /// The session file.
        session: String,
        /// Where it names the recording.
        place: Place,
        /// Gages of the first recording.
        expected: usize,
        /// Gages of this one.
        found: usize,
    },
}

impl From<EvidenceError> for CalibrationFailure {
    fn from(error: EvidenceError) -> Self {
        Self::Input(error)
    }
}

impl From<CalibrationRefusal> for CalibrationFailure {
    fn from(refusal: CalibrationRefusal) -> Self {
        Self::Refused(refusal)
    }
}

/// Calibrates a sensor from a session.
///
/// # Errors
///
/// [`CalibrationFailure`]: unreadable evidence, or a refusal.
pub fn calibrate(
    session: &Session,
    method: Method,
    linearity: Linearity,
) -> Result<Calibration, CalibrationFailure> {
    let mut reader = Reader { session, gages: None };
    let calibration = match method {
        Method::Sfm => {
            let trials = reader.solved_trials(Role::Fit, linearity)?;
            super::calibrate(session.dof, session.gravity, &trials)?
        }
        Method::LeastSquares => {
            let mut cases = Vec::with_capacity(session.trials.len());
            for (index, trial) in
                session.trials.iter().enumerate().filter(|(_, trial)| trial.role == Role::Fit)
            {
                cases.push(reader.case(index, trial, &mut None)?);
            }
            least_squares::calibrate(session.dof, session.gravity, &cases)?
        }
    };
    reader.checked(calibration)
}

/// Calibrates a sensor from a session and the calibration that it has: no known load is needed, and none is used.
///
/// # Errors
///
/// [`CalibrationFailure`]: unreadable evidence, or a refusal.
pub fn recalibrate(
    session: &Session,
    stored: &Calibration,
    linearity: Linearity,
) -> Result<Calibration, CalibrationFailure> {
    let mut reader = Reader { session, gages: None };
    let trials = reader.solved_trials(Role::Fit, linearity)?;
    let calibration = reference::recalibrate(stored, session.gravity, &trials)?;
    reader.checked(calibration)
}

/// Opens recordings and sees to it that all have the same number of gages.
struct Reader<'a> {
    session: &'a Session,
    gages: Option<usize>,
}

impl Reader<'_> {
    /// The trials of this role, solved.
    fn solved_trials(
        &mut self,
        role: Role,
        linearity: Linearity,
    ) -> Result<Vec<SolvedTrial>, CalibrationFailure> {
        let mut solved_trials = Vec::with_capacity(self.session.trials.len());
        let session = self.session;
        for (index, trial) in session.trials.iter().enumerate().filter(|(_, trial)| trial.role == role) {
            let solved = self.solved(index, trial)?;
            if linearity == Linearity::Required {
                linearity::require_linear(index, &solved)?;
            }
            solved_trials.push(solved);
        }
        Ok(solved_trials)
    }

    /// The calibration, compared with the trials that are there for it.
    fn checked(&mut self, mut calibration: Calibration) -> Result<Calibration, CalibrationFailure> {
        let checks = self.solved_trials(Role::Check, Linearity::Assumed)?;
        calibration.checks = checks.iter().map(|trial| linearity::check(&calibration, trial)).collect();
        Ok(calibration)
    }

    fn open(&mut self, path: &Path, place: Place) -> Result<Recording, EvidenceError> {
        let session = || shown(&self.session.file);
        let recording = Recording::read(path).map_err(|error| EvidenceError::Recording {
            session: session(),
            place,
            error: Box::new(error),
        })?;
        let (found, expected) = (recording.gages(), *self.gages.get_or_insert(recording.gages()));
        if found == expected {
            Ok(recording)
        } else {
            Err(EvidenceError::Gages { session: session(), place, expected, found })
        }
    }

    fn solved(&mut self, index: usize, trial: &SessionTrial) -> Result<SolvedTrial, CalibrationFailure> {
        let mut opened = None;
        let recording = opened.insert(self.open(&trial.recording, trial.place)?);
        let refused = |refusal| CalibrationRefusal::Trial { trial: index, refusal };
        let shape = trial::solve(recording, self.session.dof.trial_rank()).map_err(refused)?;
        let motion = motion::recover(recording, &shape).map_err(refused)?;
        let uncertainty = motion.uncertainty().ok_or(CalibrationRefusal::TrialUncertain { trial: index })?;
        let turned = trial.turning.map(|claimed| Turned { claimed, swept: swept(&motion) });
        let case = self.case(index, trial, &mut opened)?;
        Ok(SolvedTrial { case, shape, uncertainty, turned })
    }

    /// What hung on the sensor. The trial's recording is opened where a window of it is asked for and nobody has yet.
    fn case(
        &mut self,
        index: usize,
        trial: &SessionTrial,
        opened: &mut Option<Recording>,
    ) -> Result<LoadCase, CalibrationFailure> {
        let mut known_loads = Vec::with_capacity(trial.known_loads.len());
        for (load, known) in trial.known_loads.iter().enumerate() {
            let rest = match &known.rest {
                Rest::Recording(path) => self.open(path, known.place)?,
                Rest::Window { from_s, to_s } => {
                    let recording = match opened {
                        Some(recording) => recording,
                        None => opened.insert(self.open(&trial.recording, trial.place)?),
                    };
                    recording.window(*from_s, *to_s).map_err(|error| EvidenceError::Window {
                        session: shown(&self.session.file),
                        place: known.place,
                        error,
                    })?
                }
            };
            let rest = average(&rest).ok_or(CalibrationRefusal::KnownLoadSaturated { trial: index, load })?;
            known_loads.push(KnownLoad {
                direction: known.direction.clone(),
                accuracy_rad: known.accuracy_deg.to_radians(),
                rest,
            });
        }
        let folder = self.session.file.parent().unwrap_or(Path::new(""));
        let name = trial.recording.strip_prefix(folder).unwrap_or(&trial.recording);
        Ok(LoadCase { name: shown(name), mass_kg: trial.mass_kg, arm_m: trial.arm_m.clone(), known_loads })
    }
}
