//! The session file as it is spelled, and the checks that make it a [`super::Session`].
//!
//! Each value that can be wrong carries its place in the text (`Spanned`), so that the complaint can point at it.

use std::path::Path;

use ftcal_shared::units::{Dof, Gain};
use nalgebra::DVector;
use serde::Deserialize;
use toml::Spanned;

use crate::calibration::consistency::{ARM_ACCURACY_M, MASS_ACCURACY};
use crate::gain;
use crate::gravity::{Gravity, POSSIBLE};

use super::{Rest, Role, SessionKnownLoad, SessionTrial, Turning, place};

/// Mass and arm outside these are slips of the unit, not sensors; kg and m.
const MASS_KG: std::ops::RangeInclusive<f64> = 1e-6..=1e5;
const LONGEST_ARM_M: f64 = 5.0;

/// The sensors that there are.
const SENSORS: &str = "`planar-force`, `spatial-force`, `planar-force-torque` or `spatial-force-torque`";

/// Of a direction whose accuracy nobody states: set up by eye.
const ASSUMED_ACCURACY_DEG: f64 = 1.0;

/// No direction is believed to be better than this, whatever is stated: 0.2 mrad.
const BEST_ACCURACY_DEG: f64 = 0.01;

/// Accuracies beyond these are none, m and m/s², and none is believed to be better than these: a micrometre, a millionth.
const ROUGHEST_ARM_M: f64 = 0.1;
const ROUGHEST_GRAVITY: f64 = 1.0;
const BEST_ARM_ACCURACY_M: f64 = 1e-6;
const ROUGHEST_MASS: f64 = 0.5;
const BEST_MASS_ACCURACY: f64 = 1e-6;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Session {
    dof: Spanned<toml::Value>,
    gain: Option<Spanned<i64>>,
    gravity: Option<Spanned<f64>>,
    gravity_accuracy: Option<Spanned<f64>>,
    #[serde(default)]
    trial: Vec<Trial>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Trial {
    recording: Spanned<String>,
    mass_kg: Spanned<f64>,
    arm_m: Option<Spanned<Vec<f64>>>,
    arm_accuracy_m: Option<Spanned<f64>>,
    mass_accuracy_kg: Option<Spanned<f64>>,
    turning: Option<Spanned<Turning>>,
    role: Option<Spanned<Role>>,
    #[serde(default)]
    known_load: Vec<KnownLoad>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KnownLoad {
    recording: Option<Spanned<String>>,
    window_s: Option<Spanned<Vec<f64>>>,
    direction: Spanned<Vec<f64>>,
    accuracy_deg: Option<Spanned<f64>>,
}

/// A value that makes no sense, at a byte offset of the text.
pub(super) struct Unexpected {
    pub(super) offset: usize,
    pub(super) expected: String,
    pub(super) found: String,
}

impl Unexpected {
    fn at<T>(value: &Spanned<T>, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { offset: value.span().start, expected: expected.into(), found: found.into() }
    }
}

impl Session {
    pub(super) fn checked(self, path: &Path, text: &str) -> Result<super::Session, Unexpected> {
        let (dof, gain, gravity) = (self.dof()?, self.gain()?, self.gravity()?);
        if self.trial.is_empty() {
            return Err(Unexpected {
                offset: text.len(),
                expected: "at least one [[trial]]".to_owned(),
                found: "none".to_owned(),
            });
        }
        if self.trial.iter().all(|trial| trial.role() == Role::Check) {
            return Err(Unexpected {
                offset: text.len(),
                expected: "at least one [[trial]] that is fitted".to_owned(),
                found: "checks alone".to_owned(),
            });
        }
        let context = Context { dof, folder: path.parent().unwrap_or(Path::new("")), text };
        let trials = self.trial.iter().map(|trial| trial.checked(&context)).collect::<Result<_, _>>()?;
        Ok(super::Session { file: path.to_owned(), dof, gain, gravity, trials })
    }

    fn dof(&self) -> Result<Dof, Unexpected> {
        let value = self.dof.as_ref();
        Dof::deserialize(value.clone()).map_err(|_| Unexpected::at(&self.dof, SENSORS, value.to_string()))
    }

    /// The converter's gain; `None` where the session says nothing of it.
    fn gain(&self) -> Result<Option<Gain>, Unexpected> {
        let checked = |stated: &Spanned<i64>| {
            let factor = *stated.as_ref();
            let impossible = || Unexpected::at(stated, gain::possible(), factor.to_string());
            gain::of_factor(factor).ok_or_else(impossible)
        };
        self.gain.as_ref().map(checked).transpose()
    }

    /// Local gravity; `None` where the session says nothing of it.
    fn gravity(&self) -> Result<Option<Gravity>, Unexpected> {
        if let Some(gravity) = self.gravity.as_ref().filter(|gravity| !POSSIBLE.contains(gravity.as_ref())) {
            let expected = format!("gravity from {} to {} m/s²", POSSIBLE.start(), POSSIBLE.end());
            return Err(Unexpected::at(gravity, expected, gravity.as_ref().to_string()));
        }
        let possible = 0.0..=ROUGHEST_GRAVITY;
        if let Some(accuracy) =
            self.gravity_accuracy.as_ref().filter(|accuracy| !possible.contains(accuracy.as_ref()))
        {
            let expected = format!("an accuracy from 0 to {ROUGHEST_GRAVITY} m/s²");
            return Err(Unexpected::at(accuracy, expected, accuracy.as_ref().to_string()));
        }
        let accuracy = self.gravity_accuracy.as_ref().map(|accuracy| *accuracy.as_ref());
        Ok(match (&self.gravity, accuracy) {
            (None, None) => None,
            (Some(gravity), accuracy) => Some(Gravity::stated(*gravity.as_ref(), accuracy)),
            (None, accuracy) => Some(Gravity::stated(Gravity::ASSUMED.magnitude, accuracy)),
        })
    }
}

/// What the checks of a trial need to know.
struct Context<'a> {
    dof: Dof,
    folder: &'a Path,
    text: &'a str,
}

impl Trial {
    fn checked(&self, context: &Context) -> Result<SessionTrial, Unexpected> {
        if let Some(turning) = self.turning.as_ref().filter(|_| context.dof.trial_rank() != 2) {
            return Err(Unexpected::at(turning, "no `turning`: only planar sensors have one", "one"));
        }
        if !MASS_KG.contains(self.mass_kg.as_ref()) {
            let expected = format!("a mass from {} to {} kg", MASS_KG.start(), MASS_KG.end());
            return Err(Unexpected::at(&self.mass_kg, expected, self.mass_kg.as_ref().to_string()));
        }
        if let Some(role) =
            self.role.as_ref().filter(|_| self.role() == Role::Check && !self.known_load.is_empty())
        {
            return Err(Unexpected::at(
                role,
                "no known load of a check: it is compared, never fitted",
                "one",
            ));
        }
        Ok(SessionTrial {
            role: self.role(),
            recording: context.folder.join(file_name(&self.recording)?),
            mass_kg: *self.mass_kg.as_ref(),
            arm_m: self.arm(context.dof)?,
            arm_accuracy_m: self.arm_accuracy(context.dof)?,
            mass_accuracy_kg: self.mass_accuracy()?,
            turning: self.turning.as_ref().map(|turning| *turning.as_ref()),
            known_loads: self
                .known_load
                .iter()
                .map(|load| load.checked(context))
                .collect::<Result<_, _>>()?,
            place: place(context.text, self.recording.span().start),
        })
    }

    fn arm_accuracy(&self, dof: Dof) -> Result<f64, Unexpected> {
        match &self.arm_accuracy_m {
            None => Ok(ARM_ACCURACY_M),
            Some(accuracy) if !dof.has_torque() => {
                let expected = "no `arm_accuracy_m`: the sensor measures no torque";
                Err(Unexpected::at(accuracy, expected, "one"))
            }
            Some(accuracy) if (0.0..=ROUGHEST_ARM_M).contains(accuracy.as_ref()) => {
                Ok(accuracy.as_ref().max(BEST_ARM_ACCURACY_M))
            }
            Some(accuracy) => {
                let expected = format!("an accuracy from 0 to {ROUGHEST_ARM_M} m");
                Err(Unexpected::at(accuracy, expected, accuracy.as_ref().to_string()))
            }
        }
    }

    fn mass_accuracy(&self) -> Result<f64, Unexpected> {
        let mass_kg = *self.mass_kg.as_ref();
        match &self.mass_accuracy_kg {
            None => Ok(MASS_ACCURACY * mass_kg),
            Some(accuracy) if (0.0..=ROUGHEST_MASS * mass_kg).contains(accuracy.as_ref()) => {
                Ok(accuracy.as_ref().max(BEST_MASS_ACCURACY * mass_kg))
            }
            Some(accuracy) => {
                let expected = format!("an accuracy from 0 to {} kg, half the mass", ROUGHEST_MASS * mass_kg);
                Err(Unexpected::at(accuracy, expected, accuracy.as_ref().to_string()))
            }
        }
    }

    fn role(&self) -> Role {
        self.role.as_ref().map(|role| *role.as_ref()).unwrap_or_default()
    }

    fn arm(&self, dof: Dof) -> Result<DVector<f64>, Unexpected> {
        let components = dof.trial_rank();
        match &self.arm_m {
            None if dof.has_torque() => Err(Unexpected::at(
                &self.recording,
                "an `arm_m` for this trial: the sensor measures torque",
                "none",
            )),
            None => Ok(DVector::zeros(0)),
            Some(arm) if !dof.has_torque() => {
                Err(Unexpected::at(arm, "no `arm_m`: the sensor measures no torque", "one"))
            }
            Some(arm) => {
                let numbers = in_plane(arm.as_ref(), components);
                let sane = |number: &f64| number.abs() <= LONGEST_ARM_M;
                if numbers.len() == components && numbers.iter().all(sane) {
                    Ok(DVector::from_column_slice(numbers))
                } else {
                    let expected = format!("{components} numbers in metres, each within ±{LONGEST_ARM_M}");
                    Err(Unexpected::at(arm, expected, format!("{numbers:?}")))
                }
            }
        }
    }
}

impl KnownLoad {
    fn checked(&self, context: &Context) -> Result<SessionKnownLoad, Unexpected> {
        let (rest, span) = match (&self.recording, &self.window_s) {
            (Some(file), None) => (Rest::Recording(context.folder.join(file_name(file)?)), file.span()),
            (None, Some(window)) => match window.as_ref().as_slice() {
                &[from_s, to_s] if from_s.is_finite() && to_s.is_finite() && from_s < to_s => {
                    (Rest::Window { from_s, to_s }, window.span())
                }
                other => {
                    let expected = "[from, to] in seconds, from before to";
                    return Err(Unexpected::at(window, expected, format!("{other:?}")));
                }
            },
            (Some(_), Some(window)) => {
                return Err(Unexpected::at(
                    window,
                    "either `recording` or `window_s` for this known load",
                    "both",
                ));
            }
            (None, None) => {
                let expected = "`recording` or `window_s` for this known load";
                return Err(Unexpected::at(&self.direction, expected, "neither"));
            }
        };
        let accuracy_deg = match &self.accuracy_deg {
            None => ASSUMED_ACCURACY_DEG,
            Some(accuracy) if (0.0..90.0).contains(accuracy.as_ref()) => {
                accuracy.as_ref().max(BEST_ACCURACY_DEG)
            }
            Some(accuracy) => {
                let expected = "an accuracy from 0 to below 90 degrees";
                return Err(Unexpected::at(accuracy, expected, accuracy.as_ref().to_string()));
            }
        };
        Ok(SessionKnownLoad {
            rest,
            direction: self.direction(context.dof)?,
            accuracy_deg,
            place: place(context.text, span.start),
        })
    }

    /// The direction as a unit vector.
    fn direction(&self, dof: Dof) -> Result<DVector<f64>, Unexpected> {
        let components = dof.trial_rank();
        let numbers = self.direction.as_ref();
        let direction = DVector::from_column_slice(in_plane(numbers, components));
        // Scaled first, so that the squares of the norm neither overflow nor vanish.
        let scaled = &direction / direction.amax();
        if direction.len() == components && scaled.iter().all(|component| component.is_finite()) {
            Ok(scaled.normalize())
        } else {
            let expected = format!("{components} finite numbers, not all zero");
            Err(Unexpected::at(&self.direction, expected, format!("{numbers:?}")))
        }
    }
}

/// The components that a planar sensor has of a vector that is spelled in space, with z = 0; any other as it is.
fn in_plane(numbers: &[f64], components: usize) -> &[f64] {
    match numbers {
        [plane @ .., z] if components == 2 && plane.len() == 2 && *z == 0.0 => plane,
        _ => numbers,
    }
}

fn file_name(name: &Spanned<String>) -> Result<&str, Unexpected> {
    if name.as_ref().is_empty() {
        return Err(Unexpected::at(name, "the name of a recording", "nothing"));
    }
    Ok(name.as_ref())
}
