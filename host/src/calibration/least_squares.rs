//! The least-squares calibration (eq. 2, 3): known loads alone, no motion. The paper's reference, kept for comparison.
//!
//! Every known load is a wrench mₖ (from mass, arm and direction) with its mean codes zₖ. Cᵀ = Z⁺M, the pseudo-inverse
//! truncated at the proper rank m: the directions of Z beyond it hold noise only, whose inverse would swamp the answer.
//!
//! The bias is found first, from Z = [M 1][S; bᵀ], where the loads allow, that is where [M 1] has rank m + 1: the loads
//! must differ by more than a plane through all of them. Otherwise it is the one that the trials' motion tells (the centre
//! of eq. 13), if there is motion; and else it is taken as zero, which the calibration says.

use ftcal_shared::units::Dof;
use nalgebra::{DMatrix, DVector};

use super::known_load::{LoadCase, squashing_matrix};
use super::singular::Singular;
use super::{BiasOrigin, Calibration, CalibrationRefusal, Handedness, Method};

/// The least singular value over the greatest, with columns brought to one length, that counts as spanned.
const LEAST_SPAN: f64 = 0.02;

/// The least singular value of the signals over the greatest below which the gages do not respond to some component.
const LEAST_RESPONSE: f64 = 1e-9;

/// The largest part of the loads, relative, that the matrix may leave unexplained.
const LARGEST_RESIDUAL: f64 = 0.1;

/// The largest change of the force from the first half of a rest to the second, as a share of the load.
const LARGEST_DRIFT: f64 = 0.02;

/// Calibrates by least squares on the known loads.
///
/// # Errors
///
/// [`CalibrationRefusal::TooFewKnownLoads`], [`CalibrationRefusal::TooFewGages`],
/// [`CalibrationRefusal::KnownLoadsDoNotSpan`], [`CalibrationRefusal::ShapeRankDeficient`],
/// [`CalibrationRefusal::KnownLoadsNotLinear`], [`CalibrationRefusal::KnownLoadNotAtRest`],
/// [`CalibrationRefusal::NonFinite`].
pub fn calibrate(
    dof: Dof,
    gravity: f64,
    cases: &[LoadCase],
    bias_of_motion: Option<&DVector<f64>>,
) -> Result<Calibration, CalibrationRefusal> {
    let components = dof.count();
    let pairs: Vec<(DVector<f64>, &DVector<f64>)> = cases
        .iter()
        .flat_map(|case| case.known_loads.iter().map(move |load| (case, load)))
        .map(|(case, load)| {
            let force = &load.direction * (case.mass_kg * gravity);
            (squashing_matrix(dof.trial_rank(), &case.arm_m).transpose() * force, &load.rest.mean)
        })
        .collect();
    let gages = pairs.first().map_or(0, |(_, codes)| codes.len());
    if pairs.len() < components {
        return Err(CalibrationRefusal::TooFewKnownLoads { have: pairs.len(), need: components });
    }
    if gages < components {
        return Err(CalibrationRefusal::TooFewGages { gages, need: components });
    }
    let loads = DMatrix::from_fn(pairs.len(), components, |row, column| pairs[row].0[column]);
    let codes = DMatrix::from_fn(pairs.len(), gages, |row, column| pairs[row].1[column]);
    let spanned = columns_spanned(&loads);
    if spanned < components {
        return Err(CalibrationRefusal::KnownLoadsDoNotSpan { have: spanned, need: components });
    }

    let (bias_counts, bias_origin) = match (bias(&loads, &codes), bias_of_motion) {
        (Some(estimated), _) => (estimated, BiasOrigin::Estimated),
        (None, Some(of_motion)) => (of_motion.clone(), BiasOrigin::OfMotion),
        (None, None) => (DVector::zeros(gages), BiasOrigin::TakenAsZero),
    };
    let mut signals = codes;
    for mut row in signals.row_iter_mut() {
        row -= bias_counts.transpose();
    }
    let matrix = (truncated_inverse(&signals, components)? * &loads).transpose();
    let residual = (&signals * matrix.transpose() - &loads).norm() / loads.norm();
    let linear = residual <= LARGEST_RESIDUAL;
    if !linear {
        return Err(CalibrationRefusal::KnownLoadsNotLinear { residual, need: LARGEST_RESIDUAL });
    }
    require_rest(dof, gravity, cases, &matrix)?;
    // C = [Sᵀ]⁺, so Sᵀ = C⁺; the pseudo-inverse of C is that of a shape, transposed.
    let shape = super::matrix_of_shape(&matrix).map_err(|_| CalibrationRefusal::ShapeRankDeficient)?;
    Calibration {
        dof,
        method: Method::LeastSquares,
        gain: None,
        gravity,
        matrix,
        bias_counts,
        bias: bias_origin,
        shape,
        handedness: Handedness::Proven,
        fusion_residual: residual,
        uncertainty: None,
        trials: cases.iter().map(LoadCase::record).collect(),
        checks: Vec::new(),
        drift: None,
    }
    .finite()
}

/// Refuses rests during which the force changed: they are no known loads.
fn require_rest(
    dof: Dof,
    gravity: f64,
    cases: &[LoadCase],
    matrix: &DMatrix<f64>,
) -> Result<(), CalibrationRefusal> {
    for (trial, case) in cases.iter().enumerate() {
        for (load, known) in case.known_loads.iter().enumerate() {
            let change = (matrix * &known.rest.drift).rows(0, dof.trial_rank()).norm();
            let drift_rad = change / (case.mass_kg * gravity);
            if drift_rad > LARGEST_DRIFT {
                return Err(CalibrationRefusal::KnownLoadNotAtRest {
                    trial,
                    load,
                    drift_deg: drift_rad.to_degrees(),
                });
            }
        }
    }
    Ok(())
}

/// b (p) from Z = [M 1][S; bᵀ], or `None` where the loads do not determine it.
fn bias(loads: &DMatrix<f64>, codes: &DMatrix<f64>) -> Option<DVector<f64>> {
    let with_ones = loads.clone().insert_column(loads.ncols(), 1.0);
    if columns_spanned(&with_ones) < with_ones.ncols() {
        return None;
    }
    let (scaled, lengths) = unit_columns(&with_ones);
    let last = loads.ncols();
    let solution = Singular::of(&scaled).pseudo_inverse(last + 1) * codes;
    Some(solution.row(last).transpose() / lengths[last])
}

/// Z⁺ of the part of Z of rank `rank`.
fn truncated_inverse(signals: &DMatrix<f64>, rank: usize) -> Result<DMatrix<f64>, CalibrationRefusal> {
    let decomposition = Singular::of(signals);
    if decomposition.rank(LEAST_RESPONSE) < rank {
        return Err(CalibrationRefusal::ShapeRankDeficient);
    }
    Ok(decomposition.pseudo_inverse(rank))
}

/// How many directions the columns span, each brought to length one.
fn columns_spanned(matrix: &DMatrix<f64>) -> usize {
    Singular::of(&unit_columns(matrix).0).rank(LEAST_SPAN)
}

/// The columns at length one (those of zeros stay), and their lengths.
fn unit_columns(matrix: &DMatrix<f64>) -> (DMatrix<f64>, Vec<f64>) {
    let lengths: Vec<f64> = matrix.column_iter().map(|column| column.norm()).collect();
    let mut unit = matrix.clone();
    for (mut column, &length) in unit.column_iter_mut().zip(&lengths) {
        if length > 0.0 {
            column /= length;
        }
    }
    (unit, lengths)
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;
    use nalgebra::DVector;

    use super::calibrate;
    use crate::calibration::known_load::{KnownLoad, LoadCase, RestCounts, squashing_matrix};
    use crate::calibration::synthetic::{Sensor, spatial};
    use crate::calibration::{BiasOrigin, CalibrationRefusal};
    use crate::session_file::STANDARD_GRAVITY;

    /// Exact known loads in these directions at each of these arms.
    fn cases(sensor: &Sensor, arms: &[[f64; 3]], directions: &[DVector<f64>]) -> Vec<LoadCase> {
        let mass_kg = 2.0;
        arms.iter()
            .map(|arm| {
                let arm_m = DVector::from_column_slice(arm);
                let seen =
                    (squashing_matrix(3, &arm_m) * &sensor.shape).transpose() * (mass_kg * STANDARD_GRAVITY);
                let known_loads = directions
                    .iter()
                    .map(|direction| KnownLoad {
                        direction: direction.clone(),
                        accuracy_rad: 1e-3,
                        rest: RestCounts {
                            mean: &sensor.bias_counts + &seen * direction,
                            drift: DVector::zeros(sensor.shape.ncols()),
                            noise_variance: 0.0,
                            samples: 1,
                        },
                    })
                    .collect();
                LoadCase {
                    name: String::new(),
                    mass_kg,
                    arm_m,
                    arm_accuracy_m: 0.0,
                    mass_accuracy_kg: 0.0,
                    known_loads,
                }
            })
            .collect()
    }

    fn directions() -> Vec<DVector<f64>> {
        vec![spatial(1., 0., 0.), spatial(0., 1., 0.), spatial(0., 0., 1.), spatial(-1., -1., 0.)]
    }

    const ARMS: [[f64; 3]; 3] = [[0.1, 0.0, 0.05], [0.0, 0.1, 0.05], [-0.05, -0.05, 0.12]];

    #[test]
    fn exact_known_loads_give_the_exact_matrix_and_bias() {
        for seed in 0..5 {
            let sensor = Sensor::new(Dof::SpatialForceTorque, 8, seed);
            let calibration =
                calibrate(sensor.dof, STANDARD_GRAVITY, &cases(&sensor, &ARMS, &directions()), None)
                    .expect("twelve known loads span everything");
            assert!(sensor.error_of(&calibration.matrix) < 1e-9);
            assert_eq!(calibration.bias, BiasOrigin::Estimated);
            assert!((&calibration.bias_counts - &sensor.bias_counts).amax() < 1e-4);
            let identity = &calibration.matrix * calibration.shape.transpose();
            assert!((identity - nalgebra::DMatrix::identity(6, 6)).amax() < 1e-9);
        }
    }

    #[test]
    fn a_bias_that_the_loads_do_not_determine_is_taken_as_zero_and_said_so() {
        let mut sensor = Sensor::new(Dof::SpatialForceTorque, 8, 6);
        sensor.bias_counts.fill(0.0);
        // Six loads for six components: nothing is left for the bias.
        let [x, y, z] = [spatial(1., 0., 0.), spatial(0., 1., 0.), spatial(0., 0., 1.)];
        let loads = [[x.clone(), y.clone()], [y, z.clone()], [z, x]];
        let cases: Vec<LoadCase> =
            ARMS.iter().zip(&loads).flat_map(|(&arm, loads)| cases(&sensor, &[arm], loads)).collect();
        let calibration =
            calibrate(sensor.dof, STANDARD_GRAVITY, &cases, None).expect("six known loads span everything");
        assert_eq!(calibration.bias, BiasOrigin::TakenAsZero);
        assert!(sensor.error_of(&calibration.matrix) < 1e-9);
    }

    #[test]
    fn known_loads_that_are_too_few_or_do_not_span_are_refused() {
        let sensor = Sensor::new(Dof::SpatialForceTorque, 8, 7);
        let refusal = |arms: &[[f64; 3]], directions: &[DVector<f64>]| {
            calibrate(sensor.dof, STANDARD_GRAVITY, &cases(&sensor, arms, directions), None)
                .expect_err("not determined")
        };
        assert_eq!(
            refusal(&ARMS, &directions()[..1]),
            CalibrationRefusal::TooFewKnownLoads { have: 3, need: 6 }
        );
        let two_arms = refusal(&ARMS[..2], &directions());
        assert_eq!(two_arms, CalibrationRefusal::KnownLoadsDoNotSpan { have: 5, need: 6 });
    }
}
