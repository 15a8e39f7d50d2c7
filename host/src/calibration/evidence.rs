//! From a session file to solved trials: opens the recordings it names, cuts out the rests, solves each trial.

use std::fmt::{self, Display, Formatter};
use std::path::Path;

use ftcal_shared::units::Gain;
use nalgebra::DVector;

use super::known_load::{KnownLoad, LoadCase, average};
use super::linearity::{self, Linearity};
use super::motion;
use super::refinement::Refining;
use super::trial::Gating;
use super::turning::{Turned, swept};
use super::{Calibration, CalibrationRefusal, Method, SolvedTrial, least_squares, reference, staged, trial};
use crate::gravity::Gravity;
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
    /// A recording is of another gain than the rest of the evidence: its counts are of another size.
    #[error(
        "{session}: {place}: expected a recording at gain {} {source_of_gain}, found one at gain {}; record it again with \
         `ftcal record --gain {0}`",
        .expected.factor(),
        .found.factor()
    )]
    Gain {
        /// The session file.
        session: String,
        /// Where it names the recording.
        place: Place,
        /// The gain of the rest.
        expected: Gain,
        /// Who says so.
        source_of_gain: GainSource,
        /// The gain of this one.
        found: Gain,
    },
    /// The session states another gain than the stored calibration.
    #[error(
        "{session}: field `gain`: expected {} as the stored calibration was made at, found {}; record the session again with \
         `ftcal record --gain {0}`, or calibrate anew with known loads",
        .expected.factor(),
        .found.factor()
    )]
    ReferenceGain {
        /// The session file.
        session: String,
        /// The gain of the stored calibration.
        expected: Gain,
        /// The gain that the session states.
        found: Gain,
    },
}

/// Who says at which gain the recordings of a session have to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GainSource {
    /// The session.
    Session,
    /// Another recording of the session.
    Recording,
    /// The calibration that the session is compared with.
    StoredCalibration,
}

impl Display for GainSource {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Session => "as the session says",
            Self::Recording => "as an earlier one",
            Self::StoredCalibration => "as the stored calibration was made at",
        })
    }
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
    approach: Approach,
) -> Result<Calibration, CalibrationFailure> {
    let mut reader = Reader::new(session, approach);
    let (dof, local) = (session.dof, session.gravity.unwrap_or(Gravity::ASSUMED));
    let gravity = local.magnitude;
    let calibration = match method {
        Method::Sfm => super::calibrate(dof, local, &reader.fitted()?),
        Method::SfmPaper => staged::calibrate(dof, gravity, &reader.fitted()?),
        Method::LeastSquares => {
            let mut cases = Vec::with_capacity(session.trials.len());
            let mut biases = Vec::new();
            for (index, trial) in
                session.trials.iter().enumerate().filter(|(_, trial)| trial.role == Role::Fit)
            {
                let mut opened = None;
                cases.push(reader.case(index, trial, &mut opened)?);
                biases.extend(reader.bias_of_motion(trial, opened)?);
            }
            let trials = biases.len() as f64;
            let bias = (!biases.is_empty()).then(|| biases.iter().sum::<DVector<f64>>() / trials);
            least_squares::calibrate(dof, gravity, &cases, bias.as_ref())
        }
    };
    reader.checked(calibration)
}

/// Calibrates a sensor from a session and the calibration that it has: no known load is needed, and none orients it. Of local
/// gravity the stored calibration knows where the session says nothing.
///
/// # Errors
///
/// [`CalibrationFailure`]: unreadable evidence, or a refusal.
pub fn recalibrate(
    session: &Session,
    stored: &Calibration,
    approach: Approach,
) -> Result<Calibration, CalibrationFailure> {
    let mut reader = Reader::new(session, approach).of_gain_of(stored)?;
    let gravity = session.gravity.unwrap_or_else(|| gravity_of(stored));
    let calibration = reference::recalibrate(stored, gravity, &reader.fitted()?);
    reader.checked(calibration)
}

/// Local gravity where a calibration was made.
fn gravity_of(stored: &Calibration) -> Gravity {
    let accuracy = stored.uncertainty.as_ref().and_then(|uncertainty| uncertainty.gravity_accuracy);
    Gravity::stated(stored.gravity, accuracy)
}

/// How the trials of a session are taken.
#[derive(Clone, Copy, Debug)]
pub struct Approach {
    /// Whether restless samples may be left out.
    pub gating: Gating,
    /// Whether a sensor that is not linear is refused.
    pub linearity: Linearity,
    /// Whether each trial is refined.
    pub refining: Refining,
}

/// Opens recordings and sees to it that all have the same number of gages, and are of the same gain as far as they say it.
struct Reader<'a> {
    session: &'a Session,
    approach: Approach,
    gages: Option<usize>,
    gain: Option<(Gain, GainSource)>,
    /// A recording was opened that does not say its gain.
    has_unknown_gain: bool,
}

impl<'a> Reader<'a> {
    fn new(session: &'a Session, approach: Approach) -> Self {
        let gain = session.gain.map(|gain| (gain, GainSource::Session));
        Self { session, approach, gages: None, gain, has_unknown_gain: false }
    }

    /// Has every recording to be of the gain of this calibration, if that is known.
    fn of_gain_of(self, stored: &Calibration) -> Result<Self, EvidenceError> {
        let Some(expected) = stored.gain else { return Ok(self) };
        match self.session.gain {
            Some(found) if found != expected => {
                Err(EvidenceError::ReferenceGain { session: shown(&self.session.file), expected, found })
            }
            _ => Ok(Self { gain: Some((expected, GainSource::StoredCalibration)), ..self }),
        }
    }

    /// The gain of all that was opened, where the session or a stored calibration says it, or every single recording.
    fn gain(&self) -> Option<Gain> {
        match self.gain {
            Some((_, GainSource::Recording)) if self.has_unknown_gain => None,
            known => known.map(|(gain, _)| gain),
        }
    }

    /// The trials that the calibration is made from, solved.
    fn fitted(&mut self) -> Result<Vec<SolvedTrial>, CalibrationFailure> {
        let trials = self.solved_trials(Role::Fit)?;
        if self.approach.linearity == Linearity::Required {
            for (number, trial) in trials.iter().enumerate() {
                linearity::require_linear(number, &trial.shape, &trial.case.known_loads)
                    .map_err(|refusal| self.refused(refusal))?;
            }
        }
        Ok(trials)
    }

    fn solved_trials(&mut self, role: Role) -> Result<Vec<SolvedTrial>, CalibrationFailure> {
        let session = self.session;
        let trials = session.trials.iter().enumerate().filter(|(_, trial)| trial.role == role);
        trials.map(|(index, trial)| self.solved(index, trial)).collect()
    }

    /// The calibration, compared with the trials that are there for it.
    fn checked(
        &mut self,
        calibration: Result<Calibration, CalibrationRefusal>,
    ) -> Result<Calibration, CalibrationFailure> {
        let mut calibration = calibration.map_err(|refusal| self.refused(refusal))?;
        let checks = self.solved_trials(Role::Check)?;
        calibration.checks = checks.iter().map(|trial| linearity::check(&calibration, trial)).collect();
        calibration.gain = self.gain();
        Ok(calibration)
    }

    /// A refusal counts the trials that are fitted; the user counts those of the session.
    fn refused(&self, refusal: CalibrationRefusal) -> CalibrationFailure {
        let trials = self.session.trials.iter().enumerate();
        let fitted: Vec<usize> =
            trials.filter(|(_, trial)| trial.role == Role::Fit).map(|(index, _)| index).collect();
        CalibrationFailure::Refused(refusal.renumbered(|trial| fitted.get(trial).copied().unwrap_or(trial)))
    }

    fn open(&mut self, path: &Path, place: Place) -> Result<Recording, EvidenceError> {
        let session = || shown(&self.session.file);
        let recording = Recording::read(path).map_err(|error| EvidenceError::Recording {
            session: session(),
            place,
            error: Box::new(error),
        })?;
        let (found, expected) = (recording.gages(), *self.gages.get_or_insert(recording.gages()));
        if found != expected {
            return Err(EvidenceError::Gages { session: session(), place, expected, found });
        }
        let Some(found) = recording.gain() else {
            self.has_unknown_gain = true;
            return Ok(recording);
        };
        let (expected, source_of_gain) = *self.gain.get_or_insert((found, GainSource::Recording));
        if found != expected {
            return Err(EvidenceError::Gain { session: session(), place, expected, source_of_gain, found });
        }
        Ok(recording)
    }

    fn solved(&mut self, index: usize, trial: &SessionTrial) -> Result<SolvedTrial, CalibrationFailure> {
        let mut opened = None;
        let recording = opened.insert(self.open(&trial.recording, trial.place)?);
        let refused = |refusal| CalibrationRefusal::Trial { trial: index, refusal };
        let start =
            trial::solve(recording, self.session.dof.trial_rank(), self.approach.gating).map_err(refused)?;
        let shape = self.approach.refining.of(recording, start);
        let turned = match trial.turning {
            Some(claimed) => {
                let motion = motion::recover(recording, &shape).map_err(refused)?;
                Some(Turned { claimed, swept: swept(&motion) })
            }
            None => None,
        };
        let case = self.case(index, trial, &mut opened)?;
        Ok(SolvedTrial { case, shape, turned })
    }

    /// The bias that a trial's motion tells, or `None` where its recording is no motion that tells one.
    fn bias_of_motion(
        &mut self,
        trial: &SessionTrial,
        opened: Option<Recording>,
    ) -> Result<Option<DVector<f64>>, EvidenceError> {
        let recording = match opened {
            Some(recording) => recording,
            None => self.open(&trial.recording, trial.place)?,
        };
        Ok(trial::solve(&recording, self.session.dof.trial_rank(), self.approach.gating)
            .ok()
            .map(|solved| solved.bias_counts))
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
        Ok(LoadCase {
            name: shown(name),
            mass_kg: trial.mass_kg,
            arm_m: trial.arm_m.clone(),
            arm_accuracy_m: trial.arm_accuracy_m,
            mass_accuracy_kg: trial.mass_accuracy_kg,
            known_loads,
        })
    }
}
