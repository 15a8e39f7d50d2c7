//! The session file: what was hung on the sensor, at which arm, and which loads are known.
//!
//! ```toml
//! dof = "spatial-force-torque"    # or planar-force, spatial-force, planar-force-torque
//! gain = 128                      # the converter's, where the recordings do not say it themselves
//! gravity = 9.812                 # local, m/s²; 9.80665 where nothing is said, which is a guess within 0.015
//! gravity_accuracy = 0.001        # one standard deviation; half a unit of the last decimal where nothing is said
//!
//! [[trial]]
//! recording = "arm1.csv"          # relative to this file
//! mass_kg = 1.2                   # all that hangs on the sensor: the fixture turns with gravity too
//! arm_m = [0.05, 0.0, 0.1]        # in the sensor frame; absent for force sensors
//! arm_accuracy_m = 0.0002         # one standard deviation of each component; this is the default
//! mass_accuracy_kg = 0.0012       # one standard deviation; 0.1 % of the mass where nothing is said
//! turning = "counterclockwise"    # planar sensors only, optional: how the force turned in the sensor frame
//! role = "fit"                    # the default; "check" for a trial at another mass that is compared, never fitted
//!
//! [[trial.known_load]]
//! window_s = [3.0, 5.0]           # a rest within the trial, or recording = "rest.csv"
//! direction = [0.0, 0.0, -1.0]    # of the force acting on the sensor, in the sensor frame
//! accuracy_deg = 0.1              # one standard deviation of that direction; 1 where nothing is said; 30: "about that way"
//! ```
//!
//! Unknown fields are errors. Every error names line, column, what was expected and what stood there. What is read here
//! is plain and checked; the module `raw` holds the file as it is spelled.

mod raw;

use std::path::{Path, PathBuf};

use ftcal_shared::units::{Dof, Gain};
use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::gravity::Gravity;
use crate::place::Place;
use crate::recording::shown;

pub use crate::gravity::STANDARD_GRAVITY;

/// A checked session.
#[derive(Clone, Debug)]
pub struct Session {
    /// The file it was read from, which the words of errors name.
    pub file: PathBuf,
    /// What the sensor measures.
    pub dof: Dof,
    /// The converter's gain in every recording, where the session says it.
    pub gain: Option<Gain>,
    /// Local gravity, where the session says anything of it.
    pub gravity: Option<Gravity>,
    /// The trials, at least one.
    pub trials: Vec<SessionTrial>,
}

/// One trial of a session.
#[derive(Clone, Debug)]
pub struct SessionTrial {
    /// The trial's recording.
    pub recording: PathBuf,
    /// The mass that hangs on the sensor, kilogram.
    pub mass_kg: f64,
    /// Where it hangs, metre, in the sensor frame; two or three components, none for force sensors.
    pub arm_m: DVector<f64>,
    /// Standard deviation of each component of the arm, metre.
    pub arm_accuracy_m: f64,
    /// Standard deviation of the mass, kilogram.
    pub mass_accuracy_kg: f64,
    /// How the force turned in the sensor frame.
    pub turning: Option<Turning>,
    /// The loads whose direction is known.
    pub known_loads: Vec<SessionKnownLoad>,
    /// What the trial is for.
    pub role: Role,
    /// Where the trial's recording is named.
    pub place: Place,
}

/// What a trial is for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// The calibration is made from it.
    #[default]
    Fit,
    /// The calibration is compared with it: another mass shows whether the sensor is linear.
    Check,
}

/// One rest at a known load.
#[derive(Clone, Debug)]
pub struct SessionKnownLoad {
    /// The rest.
    pub rest: Rest,
    /// Direction of the force acting on the sensor: a unit vector of two or three components in the sensor frame.
    pub direction: DVector<f64>,
    /// Standard deviation of that direction, degrees.
    pub accuracy_deg: f64,
    /// Where the rest is named.
    pub place: Place,
}

/// Where the codes of a rest are.
#[derive(Clone, Debug, PartialEq)]
pub enum Rest {
    /// The whole of another recording.
    Recording(PathBuf),
    /// A part of the trial's recording, in seconds.
    Window {
        /// Start of the rest.
        from_s: f64,
        /// End of the rest.
        to_s: f64,
    },
}

/// The sense in which the force turned in the sensor frame, seen with x to the right and y up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Turning {
    /// From x towards y.
    Counterclockwise,
    /// From y towards x.
    Clockwise,
}

/// Why a file is not a session.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The file cannot be read at all.
    #[error("{file}: cannot be read: {reason}")]
    Unreadable {
        /// The file.
        file: String,
        /// What the system said.
        reason: std::io::Error,
    },
    /// The file is not TOML, or not the TOML of a session.
    #[error("{file}: {place}: {message}")]
    Malformed {
        /// The file.
        file: String,
        /// Where.
        place: Place,
        /// What was expected and found.
        message: String,
    },
    /// A value is of the right type but makes no sense.
    #[error("{file}: {place}: expected {expected}, found {found}")]
    Unexpected {
        /// The file.
        file: String,
        /// Where.
        place: Place,
        /// What belongs there.
        expected: String,
        /// What stands there.
        found: String,
    },
}

impl Session {
    /// Reads and checks a session file. The recordings it names are not opened.
    ///
    /// # Errors
    ///
    /// [`SessionError`].
    pub fn read(path: &Path) -> Result<Self, SessionError> {
        let bytes =
            std::fs::read(path).map_err(|reason| SessionError::Unreadable { file: shown(path), reason })?;
        Self::parse(&bytes, path)
    }

    /// Reads and checks the text of a session file at `path`, whose folder the recordings are relative to.
    ///
    /// # Errors
    ///
    /// [`SessionError::Malformed`] and [`SessionError::Unexpected`].
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, SessionError> {
        let file = shown(path);
        let text = std::str::from_utf8(bytes).map_err(|error| SessionError::Malformed {
            file: file.clone(),
            place: place(&String::from_utf8_lossy(bytes), error.valid_up_to()),
            message: "expected text in UTF-8, found bytes that are no text".to_owned(),
        })?;
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let raw: raw::Session = toml::from_str(text).map_err(|error| SessionError::Malformed {
            file: file.clone(),
            place: place(text, error.span().map_or(0, |span| span.start)),
            message: error.message().to_owned(),
        })?;
        raw.checked(path, text).map_err(|raw::Unexpected { offset, expected, found }| {
            SessionError::Unexpected { file, place: place(text, offset), expected, found }
        })
    }
}

/// The line and column of a byte offset.
fn place(text: &str, offset: usize) -> Place {
    let before =
        text.char_indices().take_while(|(position, _)| *position < offset).map(|(_, character)| character);
    before.fold(Place { line: 1, column: 1 }, |Place { line, column }, character| {
        if character == '\n' {
            Place { line: line + 1, column: 1 }
        } else {
            Place { line, column: column + 1 }
        }
    })
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use ftcal_shared::units::{Dof, Gain};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::{Gravity, Rest, Role, Session, SessionError, Turning};
    use crate::place::Place;

    const WRIST: &str = r#"dof = "spatial-force-torque"
[[trial]]
recording = "arm1.csv"
mass_kg = 2
arm_m = [0.05, 0, 0.1]
[[trial.known_load]]
window_s = [3.0, 5]
direction = [0, 0, -2.0]
accuracy_deg = 0.1
"#;

    const FINGERTIP: &str = r#"dof = "planar-force"
gravity = 9.81
gain = 64
[[trial]]
recording = "/data/turn.csv"
mass_kg = 0.1114
turning = "clockwise"
[[trial.known_load]]
recording = "rests/down.csv"
direction = [0.0, -1.0, 0]
accuracy_deg = 0.2
"#;

    fn parse(text: &str) -> Result<Session, SessionError> {
        Session::parse(text.as_bytes(), Path::new("folder/session.toml"))
    }

    fn place_of_error(text: &str) -> Place {
        match parse(text) {
            Err(SessionError::Malformed { place, .. } | SessionError::Unexpected { place, .. }) => place,
            Err(error @ SessionError::Unreadable { .. }) => panic!("{error}"),
            Ok(session) => panic!("accepted: {session:?}\n{text}"),
        }
    }

    #[test]
    fn a_session_is_read_as_the_contract_says() {
        let session = parse(WRIST).expect("a session");
        assert_eq!(session.dof, Dof::SpatialForceTorque);
        assert_eq!((session.gain, session.gravity), (None, None));
        let [trial] = session.trials.as_slice() else { panic!("one trial") };
        assert_eq!(trial.recording, PathBuf::from("folder/arm1.csv"));
        assert_eq!(trial.arm_m.as_slice(), [0.05, 0.0, 0.1]);
        let [load] = trial.known_loads.as_slice() else { panic!("one known load") };
        assert_eq!(load.rest, Rest::Window { from_s: 3.0, to_s: 5.0 });
        assert_eq!(load.direction.as_slice(), [0.0, 0.0, -1.0]);
    }

    #[test]
    fn a_planar_direction_may_be_spelled_in_space() {
        let session = parse(FINGERTIP).expect("a session");
        let [trial] = session.trials.as_slice() else { panic!("one trial") };
        assert_eq!(session.gain, Some(Gain::X64));
        assert_eq!(trial.recording, PathBuf::from("/data/turn.csv"));
        assert_eq!(trial.turning, Some(Turning::Clockwise));
        assert!(trial.arm_m.is_empty());
        let [load] = trial.known_loads.as_slice() else { panic!("one known load") };
        assert_eq!(load.rest, Rest::Recording(PathBuf::from("folder/rests/down.csv")));
        assert_eq!(load.direction.as_slice(), [0.0, -1.0]);
    }

    #[test]
    fn every_error_says_where() {
        let cases: [(&str, &str, &str, (usize, usize)); 29] = [
            (WRIST, "\"spatial-force-torque\"", "\"six-axis\"", (1, 7)),
            (WRIST, "\"spatial-force-torque\"", "3", (1, 7)),
            (WRIST, "mass_kg = 2", "mass_kg = 0", (4, 11)),
            (WRIST, "mass_kg = 2", "mass_kg = -2.5", (4, 11)),
            (WRIST, "mass_kg = 2", "mass_kg = nan", (4, 11)),
            (WRIST, "mass_kg = 2", "mass_kg = \"2\"", (4, 11)),
            (WRIST, "mass_kg = 2", "mass = 2", (4, 1)),
            (WRIST, "arm_m = [0.05, 0, 0.1]", "arm_m = [0.05, 0]", (5, 9)),
            (WRIST, "arm_m = [0.05, 0, 0.1]", "arm_m = [0.05, 0, inf]", (5, 9)),
            (WRIST, "arm_m = [0.05, 0, 0.1]", "arm_m = [50.0, 0, 0.1]", (5, 9)),
            (WRIST, "arm_m = [0.05, 0, 0.1]\n", "", (3, 13)),
            (WRIST, "arm_m", "turning = \"clockwise\"\narm_m", (5, 11)),
            (WRIST, "[3.0, 5]", "[5.0, 3.0]", (7, 12)),
            (WRIST, "[3.0, 5]", "[5.0]", (7, 12)),
            (WRIST, "window_s = [3.0, 5]", "#", (8, 13)),
            (WRIST, "window_s = [3.0, 5]", "recording = \"a\"\nwindow_s = [3.0, 5]", (8, 12)),
            (WRIST, "[0, 0, -2.0]", "[0, 0, 0.0]", (8, 13)),
            (WRIST, "[0, 0, -2.0]", "[0, 1]", (8, 13)),
            (WRIST, "accuracy_deg = 0.1", "accuracy_deg = 90", (9, 16)),
            (WRIST, "accuracy_deg = 0.1", "accuracy_deg = -0.1", (9, 16)),
            (WRIST, "recording = \"arm1.csv\"", "recording = \"\"", (3, 13)),
            (FINGERTIP, "gain = 64", "gain = 65", (3, 8)),
            (FINGERTIP, "9.81", "981", (2, 11)),
            (FINGERTIP, "9.81", "9.81\ngravity_accuracy = -0.1", (3, 20)),
            (FINGERTIP, "9.81", "9.81\ngravity_accuracy = 9.81", (3, 20)),
            (FINGERTIP, "9.81", "9.81\ngravity_accuracy = nan", (3, 20)),
            (FINGERTIP, "[0.0, -1.0, 0]", "[0.0, -1.0, 0.1]", (10, 13)),
            (FINGERTIP, "mass_kg = 0.1114", "mass_kg = 0.1114\narm_m = [0.0, 0.1]", (7, 9)),
            (FINGERTIP, "\"clockwise\"", "\"left\"", (7, 11)),
        ];
        for (text, good, bad, (line, column)) in cases {
            assert!(text.contains(good));
            assert_eq!(place_of_error(&text.replacen(good, bad, 1)), Place { line, column }, "{bad}");
        }
    }

    #[test]
    fn a_check_is_a_trial_with_no_known_load_beside_one_that_is_fitted() {
        let check = "[[trial]]\nrecording = \"b.csv\"\nmass_kg = 4\narm_m = [0, 0, 0.1]\nrole = \"check\"\n";
        let session = parse(&format!("{WRIST}{check}")).expect("a session");
        assert_eq!(
            session.trials.iter().map(|trial| trial.role).collect::<Vec<_>>(),
            [Role::Fit, Role::Check]
        );
        place_of_error(&format!("dof = \"spatial-force-torque\"\n{check}"));
        place_of_error(&WRIST.replace("mass_kg = 2", "mass_kg = 2\nrole = \"check\""));
        place_of_error(&WRIST.replace("mass_kg = 2", "mass_kg = 2\nrole = \"other\""));
    }

    #[test]
    fn gravity_and_its_accuracy_come_as_they_are_stated() {
        let of = |lines: &str| {
            let text = WRIST.replacen("[[trial]]", &format!("{lines}\n[[trial]]"), 1);
            parse(&text).expect("a session").gravity
        };
        assert_eq!(of(""), None);
        assert_eq!(of("gravity = 9.81"), Some(Gravity::stated(9.81, None)));
        let both = Some(Gravity { magnitude: 9.81, accuracy: 0.002 });
        assert_eq!(of("gravity = 9.81\ngravity_accuracy = 0.002"), both);
        // Of standard gravity, too, somebody may know how far he is from it.
        let near = Some(Gravity { magnitude: Gravity::ASSUMED.magnitude, accuracy: 0.002 });
        assert_eq!(of("gravity_accuracy = 0.002"), near);
    }

    #[test]
    fn another_dof_is_told_which_there_are() {
        for dof in ["3", "\"six-axis\"", "[1]"] {
            let error =
                parse(&WRIST.replacen("\"spatial-force-torque\"", dof, 1)).expect_err("no such sensor");
            for name in ["planar-force", "spatial-force", "planar-force-torque", "spatial-force-torque"] {
                assert!(error.to_string().contains(&format!("`{name}`")), "{error}");
            }
        }
    }

    #[test]
    fn a_session_without_trials_is_none() {
        place_of_error("");
        place_of_error("dof = \"planar-force\"\n");
        place_of_error("dof = \"planar-force\"\ntrial = []\n");
    }

    #[test]
    fn no_damage_to_a_session_makes_the_reader_panic() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..2000 {
            let mut bytes = WRIST.as_bytes().to_vec();
            for _ in 0..random.random_range(1..4) {
                if bytes.is_empty() {
                    break;
                }
                let at = random.random_range(0..bytes.len());
                match random.random_range(0..3) {
                    0 => bytes[at] = random.random(),
                    1 => drop(bytes.remove(at)),
                    _ => bytes.truncate(at),
                }
            }
            let _ = Session::parse(&bytes, Path::new("s.toml"));
        }
    }

    #[test]
    fn bytes_that_are_no_text_are_located() {
        let error =
            Session::parse(b"dof = \"planar-force\"\n# \xff", Path::new("s.toml")).expect_err("not text");
        assert!(error.to_string().starts_with("s.toml: line 2, column 3: "), "{error}");
    }
}
