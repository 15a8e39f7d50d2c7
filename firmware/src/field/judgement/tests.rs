//! What is kept, what is confirmed and what is refused, on shapes whose truth is known.

extern crate std;

use std::vec::Vec;

use ftcal_shared::estimation::reorientation::{Rows, dual};
use ftcal_shared::units::{Dof, Gain};
use ftcal_shared::wire::{
    CalibrationOrigin, CalibrationUpload, Coverage, FieldRefusal, GageList, Renewed, Solution,
};

use super::{Judgement, LARGEST_DRIFT, judge};
use crate::storage::items::StoredCalibration;

const GAGES: usize = 6;
/// What hangs on the sensor.
const NEWTON: f32 = 15.0;
/// What a gage answers at most, counts per newton.
const ANSWER: f32 = 1e5;
const UNCERTAINTY: f32 = 5e-4;

/// Six struts, inclined to the mounting plane.
fn struts() -> Rows<GAGES> {
    let gage = |gage: usize| core::f32::consts::FRAC_PI_3 * gage as f32;
    let along = core::array::from_fn(|k| 0.8 * ANSWER * libm::cosf(gage(k)));
    [along, core::array::from_fn(|k| 0.8 * ANSWER * libm::sinf(gage(k))), [0.6 * ANSWER; GAGES]]
}

fn bias() -> GageList<f64> {
    (0..6_u8).map(|gage| 1e5 * f64::from(gage) - 2e5).collect()
}

fn stored(shape: &Rows<GAGES>) -> StoredCalibration {
    let matrix = dual(3, shape).unwrap().iter().flatten().copied().collect();
    let mut upload = CalibrationUpload {
        dof: Dof::SpatialForce,
        gain: Gain::X128,
        bias_counts: bias(),
        matrix,
        identity: 0,
    };
    upload.identity = upload.identity_of_numbers();
    StoredCalibration { upload, origin: CalibrationOrigin::Uploaded }
}

/// What a trial makes of a sensor of this shape, in a frame of its own, which is mirrored.
fn solved(shape: &Rows<GAGES>) -> (Solution, Coverage) {
    let (sine, cosine) = (0.6, 0.8);
    let turned = |gage: usize| {
        let [x, y, z] = [shape[0][gage], shape[1][gage], shape[2][gage]];
        [cosine * x - sine * z, -y, sine * x + cosine * z].map(|component| f64::from(NEWTON * component))
    };
    let columns: Vec<[f64; 3]> = (0..GAGES).map(turned).collect();
    let solution = Solution {
        rank: 3,
        shape_counts_per_load: (0..3).flat_map(|row| columns.iter().map(move |gage| gage[row])).collect(),
        bias_counts: bias(),
        eigenvalues: GageList::new(),
        noise_counts: None,
        samples: 1000,
    };
    let deviation = UNCERTAINTY * ANSWER * NEWTON;
    let coverage = Coverage {
        samples: 1000,
        fraction: 1.0,
        worst_relative_uncertainty: 5e-4,
        targets: heapless::Vec::new(),
        bias_deviation_counts: core::iter::repeat_n(deviation, GAGES).collect(),
        // Of a column of three, √3 times as much.
        shape_deviation_counts_per_load: core::iter::repeat_n(deviation / 1.733, 3 * GAGES).collect(),
    };
    (solution, coverage)
}

/// The shape with one gage whose gain is off.
fn with_gain(gage: usize, gain: f32) -> Rows<GAGES> {
    let mut shape = struts();
    for row in &mut shape {
        row[gage] *= gain;
    }
    shape
}

fn judged(shape: &Rows<GAGES>) -> Result<Judgement, FieldRefusal> {
    let (solution, coverage) = solved(shape);
    judge::<GAGES>(&stored(&struts()), &solution, &coverage)
}

#[test]
fn a_sensor_that_has_not_moved_is_confirmed() {
    let Ok(Judgement::Confirmed(found)) = judged(&struts()) else { panic!("confirmed") };
    // All is in single precision.
    assert!(found.drift < 1e-5 && found.bias_shift_newton == 0.0, "{found:?}");
    assert!((found.load_newton / NEWTON - 1.0).abs() < 1e-5, "{found:?}");
    assert_eq!(found.reference, stored(&struts()).upload.identity);
    // A scale cannot be told: it is a lighter load.
    let lighter = struts().map(|row| row.map(|element| 0.9 * element));
    let Ok(Judgement::Confirmed(found)) = judged(&lighter) else { panic!("confirmed") };
    assert!((found.load_newton / (0.9 * NEWTON) - 1.0).abs() < 1e-5, "{found:?}");
}

/// What moves by less than three standard deviations is chance, by more is not: with what of it the others take along, at most
/// two standard deviations' pull, there is a gap between the two.
#[test]
fn a_drifted_gage_is_told_and_mended() {
    for gage in 0..GAGES {
        assert!(matches!(judged(&with_gain(gage, 1.0 + 2.0 * UNCERTAINTY)), Ok(Judgement::Confirmed(_))));
        let drifted = with_gain(gage, 0.99);
        let Ok(Judgement::Renewed(new)) = judged(&drifted) else { panic!("renewed") };
        let CalibrationOrigin::Field(Renewed::ShapeAndBias, found) = new.origin else { panic!("the shape") };
        assert_eq!(usize::from(found.gage), gage);
        assert_eq!(new.upload.identity, new.upload.identity_of_numbers());
        // What remains is the pull of the gage that is off, two of its standard deviations, of which the others take a part;
        // before, it was 1 % of that gage.
        let exact = dual(3, &drifted).unwrap();
        let exact = exact.iter().flatten();
        let (mut error, mut size) = (0.0, 0.0);
        for (&new, exact) in new.upload.matrix.iter().zip(exact) {
            error += (new - exact) * (new - exact);
            size += exact * exact;
        }
        assert!(libm::sqrtf(error / size) < 2.0 * UNCERTAINTY, "{}", libm::sqrtf(error / size));
    }
}

#[test]
fn a_gage_that_has_moved_too_far_is_refused() {
    for change in [-0.5, -0.05, 0.05, 0.5, -1.0] {
        let outcome = judged(&with_gain(2, 1.0 + change));
        let Err(FieldRefusal::Drifted { gage: 2, drift, .. }) = outcome else { panic!("{outcome:?}") };
        assert!(drift > LARGEST_DRIFT && drift < 2.0 * f32::abs(change));
    }
}

#[test]
fn a_bias_alone_leaves_the_matrix_as_it_was() {
    let (mut solution, coverage) = solved(&struts());
    solution.bias_counts[3] += f64::from(4.0 * UNCERTAINTY * ANSWER * NEWTON);
    let reference = stored(&struts());
    let Ok(Judgement::Renewed(new)) = judge::<GAGES>(&reference, &solution, &coverage) else {
        panic!("renewed")
    };
    assert!(matches!(new.origin, CalibrationOrigin::Field(Renewed::Bias, _)));
    assert_eq!(new.upload.matrix, reference.upload.matrix);
    assert_eq!(new.upload.bias_counts, solution.bias_counts);
    assert_ne!(new.upload.identity, reference.upload.identity);
}

#[test]
fn what_makes_no_sense_is_refused() {
    let (solution, coverage) = solved(&struts());
    let reference = stored(&struts());
    let unusable = |reference: &StoredCalibration, solution: &Solution, coverage: &Coverage| {
        let refusal = judge::<GAGES>(reference, solution, coverage);
        assert_eq!(refusal, Err(FieldRefusal::UnusableNumbers));
    };
    for wrong in [f64::NAN, f64::INFINITY] {
        let mut broken = solution.clone();
        broken.shape_counts_per_load[5] = wrong;
        unusable(&reference, &broken, &coverage);
        let mut broken = solution.clone();
        broken.bias_counts[0] = wrong;
        unusable(&reference, &broken, &coverage);
    }
    let mut nothing = solution.clone();
    nothing.shape_counts_per_load.fill(0.0);
    unusable(&reference, &nothing, &coverage);
    let mut fewer = solution.clone();
    fewer.shape_counts_per_load.pop();
    unusable(&reference, &fewer, &coverage);
    unusable(&reference, &Solution { rank: 2, ..solution.clone() }, &coverage);
    let mut flat = reference.clone();
    flat.upload.matrix[2 * GAGES..].fill(0.0);
    unusable(&flat, &solution, &coverage);
    let broken = Coverage {
        shape_deviation_counts_per_load: core::iter::repeat_n(f32::NAN, 3 * GAGES).collect(),
        ..coverage
    };
    unusable(&reference, &solution, &broken);
}
