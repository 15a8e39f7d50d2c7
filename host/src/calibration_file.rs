//! The calibration file: a calibration as JSON, with units, frame and sign convention in words and a checksum.
//!
//! Numbers are written with as many digits as reading them back exactly needs. The checksum is the CRC-32 (ISO-HDLC, as
//! in zip) of the file's canonical form: the same object without the checksum, in this order of fields, without white
//! space, as [`serde_json`] prints it. Layout and order of the file itself may thus change, and no number may.
//!
//! Everything is checked on reading: format, fields, dimensions, that every number is finite, that matrix and shape
//! belong together, and the checksum. Nothing is ever filled in.

mod layout;

#[cfg(test)]
mod tests;

use std::io::{self, Write};
use std::path::Path;

use crc::{CRC_32_ISO_HDLC, Crc};
use ftcal_shared::units::{Dof, Gain, MAX_GAGES};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::calibration::drift::Drift;
use crate::calibration::joint::uncertainty::Uncertainty;
use crate::calibration::linearity::CheckRecord;
use crate::calibration::wrench_uncertainty::WrenchUncertainty;
use crate::calibration::{BiasOrigin, Calibration, Handedness, Method, TrialRecord};
use crate::gain;
use crate::recording::{MIN_GAGES, shown};

/// Name and version of the format.
pub const FORMAT: &str = "ftcal-calibration-1";

/// The frame in words.
pub const FRAME: &str = "sensor frame, right-handed: the frame in which the session states directions and arms; \
                         forces in newton along its axes, torques in newton metre about its origin";

/// The sign convention in words.
pub const SIGN_CONVENTION: &str = "wrench = matrix * (codes - bias_counts) is what acts on the sensor: a force along \
                                   +x reads positive on x; torque = arm x force";

/// How far matrix · shapeᵀ may be from the identity.
const LARGEST_MISMATCH: f64 = 1e-6;

const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Why a file is not a calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationFileError {
    /// The file cannot be read at all.
    #[error("{file}: cannot be read: {reason}")]
    Unreadable {
        /// The file.
        file: String,
        /// What the system said.
        reason: io::Error,
    },
    /// The file is not JSON, or a field is missing, unknown or of another type.
    #[error("{file}: expected a calibration file: {reason}")]
    Malformed {
        /// The file.
        file: String,
        /// What was expected and found, with line and column.
        reason: serde_json::Error,
    },
    /// Another format, or a later version.
    #[error("{file}: field `format`: expected `{FORMAT}`, found `{found}`")]
    Format {
        /// The file.
        file: String,
        /// What stands there.
        found: String,
    },
    /// The numbers are not those that were written.
    #[error(
        "{file}: field `checksum`: expected `{expected}` for these contents, found `{found}`: the file was changed"
    )]
    Checksum {
        /// The file.
        file: String,
        /// The checksum of what the file holds.
        expected: String,
        /// The checksum that it states.
        found: String,
    },
    /// The contents contradict themselves.
    #[error("{file}: field `{field}`: expected {expected}, found {found}")]
    Inconsistent {
        /// The file.
        file: String,
        /// The field.
        field: &'static str,
        /// What belongs there.
        expected: String,
        /// What stands there.
        found: String,
    },
}

/// The file as it is spelled.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: String,
    dof: Dof,
    method: Method,
    gages: usize,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    gain: Option<i64>,
    gravity: f64,
    matrix: Vec<Vec<f64>>,
    bias_counts: Vec<f64>,
    bias: BiasOrigin,
    shape: Vec<Vec<f64>>,
    frame: String,
    sign_convention: String,
    handedness: Handedness,
    fusion_residual: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    uncertainty: Option<UncertaintyRecord>,
    trials: Vec<TrialRecord>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    checks: Vec<CheckRecord>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    drift: Option<Drift>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    checksum: Option<String>,
}

/// Standard deviations, as they are spelled.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct UncertaintyRecord {
    matrix: Vec<Vec<f64>>,
    per_axis_full_load: Vec<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    wrench: Option<WrenchRecord>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    gravity_accuracy: Option<f64>,
}

/// How the variance of each component follows the wrench, as it is spelled.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WrenchRecord {
    unloaded: Vec<f64>,
    with_bias: Vec<Vec<f64>>,
    by_load: Vec<Vec<Vec<f64>>>,
}

/// Only what tells whether the rest can be understood.
#[derive(Deserialize)]
struct Header {
    format: String,
}

/// Writes a calibration.
///
/// # Errors
///
/// Those of the destination.
pub fn write(calibration: &Calibration, mut out: impl Write) -> io::Result<()> {
    let file = File {
        format: FORMAT.to_owned(),
        dof: calibration.dof,
        method: calibration.method,
        gages: calibration.gages(),
        gain: calibration.gain.map(|gain| gain.factor().into()),
        gravity: calibration.gravity,
        matrix: rows(&calibration.matrix),
        bias_counts: calibration.bias_counts.iter().copied().collect(),
        bias: calibration.bias,
        shape: rows(&calibration.shape),
        frame: FRAME.to_owned(),
        sign_convention: SIGN_CONVENTION.to_owned(),
        handedness: calibration.handedness,
        fusion_residual: calibration.fusion_residual,
        uncertainty: calibration.uncertainty.as_ref().map(|uncertainty| UncertaintyRecord {
            matrix: rows(&uncertainty.matrix),
            per_axis_full_load: uncertainty.per_axis_full_load.iter().copied().collect(),
            wrench: uncertainty.wrench.as_ref().map(|wrench| WrenchRecord {
                unloaded: wrench.unloaded.iter().copied().collect(),
                with_bias: wrench.with_bias.iter().map(|vector| vector.iter().copied().collect()).collect(),
                by_load: wrench.by_load.iter().map(rows).collect(),
            }),
            gravity_accuracy: uncertainty.gravity_accuracy,
        }),
        trials: calibration.trials.clone(),
        checks: calibration.checks.clone(),
        drift: calibration.drift.clone(),
        checksum: None,
    };
    let checksum = Some(file.checksum().map_err(io::Error::from)?);
    layout::write(&File { checksum, ..file }, &mut out)
}

/// Reads a calibration from a file.
///
/// # Errors
///
/// [`CalibrationFileError`].
pub fn read(path: &Path) -> Result<Calibration, CalibrationFileError> {
    let file = shown(path);
    let bytes = std::fs::read(path)
        .map_err(|reason| CalibrationFileError::Unreadable { file: file.clone(), reason })?;
    parse(&bytes, &file)
}

/// Reads a calibration from the bytes of a file; `name` names it in errors.
///
/// # Errors
///
/// [`CalibrationFileError`].
pub fn parse(bytes: &[u8], name: &str) -> Result<Calibration, CalibrationFileError> {
    let malformed = |reason| CalibrationFileError::Malformed { file: name.to_owned(), reason };
    let Header { format } = serde_json::from_slice(bytes).map_err(malformed)?;
    if format != FORMAT {
        return Err(CalibrationFileError::Format { file: name.to_owned(), found: format });
    }
    let file: File = serde_json::from_slice(bytes).map_err(malformed)?;
    let expected = file.checksum().map_err(malformed)?;
    match &file.checksum {
        Some(found) if *found == expected => {}
        found => {
            let found = found.clone().unwrap_or_else(|| "nothing".to_owned());
            return Err(CalibrationFileError::Checksum { file: name.to_owned(), expected, found });
        }
    }
    file.calibration().map_err(|Inconsistency { field, expected, found }| {
        CalibrationFileError::Inconsistent { file: name.to_owned(), field, expected, found }
    })
}

/// A contradiction, before the file's name is known.
struct Inconsistency {
    field: &'static str,
    expected: String,
    found: String,
}

impl File {
    /// The checksum of the canonical form.
    fn checksum(&self) -> serde_json::Result<String> {
        let canonical = serde_json::to_vec(&Self { checksum: None, ..self.clone() })?;
        Ok(format!("crc32:{:08x}", CHECKSUM.checksum(&canonical)))
    }

    fn calibration(self) -> Result<Calibration, Inconsistency> {
        let (components, gages) = (self.dof.count(), self.gages);
        let fewest = components.max(MIN_GAGES);
        if !(fewest..=MAX_GAGES).contains(&gages) {
            let expected = format!("{fewest} to {MAX_GAGES}");
            return Err(Inconsistency { field: "gages", expected, found: gages.to_string() });
        }
        let pulls = self.gravity > 0.0;
        if !pulls {
            let expected = "a positive number".to_owned();
            return Err(Inconsistency { field: "gravity", expected, found: self.gravity.to_string() });
        }
        let gain = self.gain.map(checked_gain).transpose()?;
        let bias_counts = checked_vector("bias_counts", &self.bias_counts, gages)?;
        let matrix = checked_matrix("matrix", &self.matrix, components, gages)?;
        let shape = checked_matrix("shape", &self.shape, components, gages)?;
        let product = &matrix * shape.transpose();
        let mismatch = (product - DMatrix::identity(components, components)).amax();
        let belong_together = mismatch <= LARGEST_MISMATCH;
        if !belong_together {
            return Err(Inconsistency {
                field: "shape",
                expected: "the shape whose pseudo-inverse is `matrix`".to_owned(),
                found: format!("one that is off by {mismatch:.3e}"),
            });
        }
        let uncertainty =
            self.uncertainty.as_ref().map(|record| record.uncertainty(components, gages)).transpose()?;
        Ok(Calibration {
            dof: self.dof,
            method: self.method,
            gain,
            gravity: self.gravity,
            matrix,
            bias_counts,
            bias: self.bias,
            shape,
            handedness: self.handedness,
            fusion_residual: self.fusion_residual,
            uncertainty,
            trials: self.trials,
            checks: self.checks,
            drift: self.drift,
        })
    }
}

impl UncertaintyRecord {
    fn uncertainty(&self, components: usize, gages: usize) -> Result<Uncertainty, Inconsistency> {
        let matrix = checked_matrix("uncertainty.matrix", &self.matrix, components, gages)?;
        let per_axis = "uncertainty.per_axis_full_load";
        let per_axis_full_load = checked_vector(per_axis, &self.per_axis_full_load, components)?;
        deviations("uncertainty.matrix", matrix.iter())?;
        deviations(per_axis, per_axis_full_load.iter())?;
        deviations("uncertainty.gravity_accuracy", self.gravity_accuracy.iter())?;
        Ok(Uncertainty {
            matrix,
            per_axis_full_load,
            wrench: self.wrench.as_ref().map(|record| record.wrench(components)).transpose()?,
            gravity_accuracy: self.gravity_accuracy,
        })
    }
}

impl WrenchRecord {
    fn wrench(&self, components: usize) -> Result<WrenchUncertainty, Inconsistency> {
        let field = "uncertainty.wrench.by_load";
        if self.by_load.len() != components {
            let expected = format!("{components} matrices");
            return Err(Inconsistency { field, expected, found: self.by_load.len().to_string() });
        }
        let each = self.by_load.iter().map(|matrix| checked_matrix(field, matrix, components, components));
        let with_bias =
            checked_matrix("uncertainty.wrench.with_bias", &self.with_bias, components, components)?;
        let wrench = WrenchUncertainty {
            by_load: each.collect::<Result<_, _>>()?,
            with_bias: with_bias.row_iter().map(|row| row.transpose()).collect(),
            unloaded: checked_vector("uncertainty.wrench.unloaded", &self.unloaded, components)?,
        };
        if wrench.is_possible() {
            return Ok(wrench);
        }
        let expected = "covariances: symmetric, and no variance negative".to_owned();
        Err(Inconsistency { field: "uncertainty.wrench", expected, found: "others".to_owned() })
    }
}

fn deviations<'a>(
    field: &'static str,
    mut values: impl Iterator<Item = &'a f64>,
) -> Result<(), Inconsistency> {
    match values.find(|value| **value < 0.0) {
        None => Ok(()),
        Some(found) => {
            let expected = "standard deviations, none of them negative".to_owned();
            Err(Inconsistency { field, expected, found: found.to_string() })
        }
    }
}

fn checked_gain(factor: i64) -> Result<Gain, Inconsistency> {
    gain::of_factor(factor).ok_or_else(|| Inconsistency {
        field: "gain",
        expected: gain::possible(),
        found: factor.to_string(),
    })
}

fn checked_vector(field: &'static str, values: &[f64], count: usize) -> Result<DVector<f64>, Inconsistency> {
    if values.len() == count {
        return Ok(DVector::from_column_slice(values));
    }
    Err(Inconsistency { field, expected: format!("{count} numbers"), found: values.len().to_string() })
}

fn checked_matrix(
    field: &'static str,
    rows: &[Vec<f64>],
    components: usize,
    gages: usize,
) -> Result<DMatrix<f64>, Inconsistency> {
    let inconsistent =
        |expected: String, found: usize| Inconsistency { field, expected, found: found.to_string() };
    if rows.len() != components {
        return Err(inconsistent(format!("{components} rows"), rows.len()));
    }
    if let Some(row) = rows.iter().find(|row| row.len() != gages) {
        return Err(inconsistent(format!("{gages} numbers a row"), row.len()));
    }
    Ok(DMatrix::from_row_iterator(components, gages, rows.iter().flatten().copied()))
}

/// The rows of a matrix.
pub fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}
