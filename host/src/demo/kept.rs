//! The recordings of a demonstration, kept, with the session file that calibrates from them.

use std::path::Path;

use ftcal_shared::units::Dof;
use serde::Serialize;

use super::trials::{AcquiredTrial, GRAVITY};
use super::{DemoError, file_error};
use crate::recording::{Recording, writer};
use crate::session_file::Turning;

/// Name of the session file.
pub const SESSION: &str = "session.toml";

/// The session file as it is spelled.
#[derive(Serialize)]
struct Session {
    dof: Dof,
    gravity: f64,
    gravity_accuracy: f64,
    trial: Vec<Trial>,
}

#[derive(Serialize)]
struct Trial {
    recording: String,
    mass_kg: f64,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    arm_m: Vec<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    arm_accuracy_m: Option<f64>,
    mass_accuracy_kg: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    turning: Option<Turning>,
    known_load: Vec<KnownLoad>,
}

#[derive(Serialize)]
struct KnownLoad {
    recording: String,
    direction: Vec<f64>,
    accuracy_deg: f64,
}

/// Writes the recordings and the session file into `folder`.
///
/// # Errors
///
/// [`DemoError::File`].
pub fn keep(acquired: &[AcquiredTrial], dof: Dof, folder: &Path) -> Result<(), DemoError> {
    let mut session = Session { dof, gravity: GRAVITY, gravity_accuracy: 0.0, trial: Vec::new() };
    for (index, trial) in acquired.iter().enumerate() {
        let case = &trial.solved.case;
        save(&trial.recording, &folder.join(&case.name))?;
        let mut known_load = Vec::new();
        for (load, (known, rest)) in case.known_loads.iter().zip(&trial.rests).enumerate() {
            let recording = format!("trial{}_known{}.csv", index + 1, load + 1);
            save(rest, &folder.join(&recording))?;
            known_load.push(KnownLoad {
                recording,
                direction: known.direction.iter().copied().collect(),
                accuracy_deg: known.accuracy_rad.to_degrees(),
            });
        }
        session.trial.push(Trial {
            recording: case.name.clone(),
            mass_kg: case.mass_kg,
            arm_m: case.arm_m.iter().copied().collect(),
            arm_accuracy_m: dof.has_torque().then_some(case.arm_accuracy_m),
            mass_accuracy_kg: case.mass_accuracy_kg,
            turning: trial.solved.turned.map(|turned| turned.claimed),
            known_load,
        });
    }
    let path = folder.join(SESSION);
    let text = toml::to_string(&session).map_err(std::io::Error::other).map_err(file_error(&path))?;
    std::fs::write(&path, text).map_err(file_error(&path))
}

fn save(recording: &Recording, path: &Path) -> Result<(), DemoError> {
    let mut bytes = Vec::new();
    writer::write(recording, &mut bytes)?;
    std::fs::write(path, bytes).map_err(file_error(path))
}
