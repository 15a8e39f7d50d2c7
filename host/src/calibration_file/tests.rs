use ftcal_shared::units::{Dof, Gain};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{CalibrationFileError, parse, write};
use crate::calibration::drift::Drift;
use crate::calibration::joint::uncertainty::Uncertainty;
use crate::calibration::linearity::{CheckRecord, CheckVerdict};
use crate::calibration::matrix::matrix_of_shape;
use crate::calibration::samples::{Rejection, SampleCounts};
use crate::calibration::wrench_uncertainty::WrenchUncertainty;
use crate::calibration::{
    BiasOrigin, Calibration, Handedness, HandednessEvidence, Method, SolutionRecord, TrialRecord,
};

fn calibration(dof: Dof, gages: usize, seed: u64) -> Calibration {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut number = || random.random::<f64>() - 0.5;
    let shape = DMatrix::from_fn(dof.count(), gages, |_, _| 1e5 * number());
    Calibration {
        dof,
        method: Method::Sfm,
        gain: Gain::from_factor(1 << (seed % 8)),
        gravity: 9.81,
        matrix: matrix_of_shape(&shape).expect("random rows are independent"),
        bias_counts: DVector::from_fn(gages, |_, _| 1e4 * number()),
        bias: BiasOrigin::Estimated,
        shape,
        handedness: Handedness::Proven,
        fusion_residual: number().abs(),
        uncertainty: Some(Uncertainty {
            matrix: DMatrix::from_fn(dof.count(), gages, |_, _| number().abs()),
            per_axis_full_load: DVector::from_fn(dof.count(), |_, _| number().abs()),
            wrench: Some(wrench_uncertainty(dof.count(), &mut number)),
            gravity_accuracy: Some(number().abs()),
        }),
        trials: vec![TrialRecord {
            recording: "arm \"1\".csv".to_owned(),
            mass_kg: 1.0 / 3.0,
            arm_m: vec![0.1, -0.2, number()],
            known_loads: 2,
            solution: Some(SolutionRecord {
                samples: SampleCounts::new(1000, &[(Rejection::Saturated, 3), (Rejection::Moving, 70)]),
                eigenvalues: vec![number().abs(); gages],
                noise_counts: None,
                bias_counts: vec![number(); gages],
                alignment_residual_deg: number().abs(),
                handedness: HandednessEvidence::Fusion,
            }),
        }],
        checks: vec![CheckRecord {
            recording: "heavier.csv".to_owned(),
            mass_kg: 2.0,
            arm_m: Vec::new(),
            scale: 1.0 + number(),
            scale_uncertainty: Some(number().abs()),
            residual: number().abs(),
            residual_uncertainty: Some(number().abs()),
            verdict: Some(CheckVerdict::BeyondUncertainty),
        }],
        drift: Some(Drift {
            gage_percent: vec![number().abs(); gages],
            gage_uncertainty_percent: vec![number().abs(); gages],
            axis_percent: vec![number().abs(); dof.count()],
            axis_uncertainty_percent: vec![number().abs(); dof.count()],
            components_seen: dof.count() as u64,
        }),
    }
}

/// The uncertainty of wrenches of so many components: covariances of random numbers.
fn wrench_uncertainty(components: usize, number: &mut impl FnMut() -> f64) -> WrenchUncertainty {
    let zero = 3.0;
    let by_load = (0..components).map(|_| {
        let factor = DMatrix::from_fn(components, components, |_, _| number());
        &factor * factor.transpose() + DMatrix::identity(components, components)
    });
    WrenchUncertainty {
        by_load: by_load.collect(),
        with_bias: vec![DVector::from_element(components, 0.1); components],
        unloaded: DVector::from_element(components, zero),
    }
}

fn written(calibration: &Calibration) -> String {
    let mut bytes = Vec::new();
    write(calibration, &mut bytes).expect("memory takes everything");
    String::from_utf8(bytes).expect("JSON is UTF-8")
}

#[test]
fn what_is_written_reads_back_to_the_last_bit() {
    for (seed, (dof, gages)) in [
        (Dof::PlanarForce, 2),
        (Dof::SpatialForce, 5),
        (Dof::PlanarForceTorque, 4),
        (Dof::SpatialForceTorque, 12),
    ]
    .into_iter()
    .enumerate()
    {
        let calibration = calibration(dof, gages, seed as u64);
        assert_eq!(parse(written(&calibration).as_bytes(), "c.json").expect("a calibration"), calibration);
    }
}

#[test]
fn layout_and_order_of_fields_do_not_matter() {
    let calibration = calibration(Dof::SpatialForceTorque, 8, 5);
    let value: serde_json::Value = serde_json::from_str(&written(&calibration)).expect("JSON");
    let compact = value.to_string();
    assert_eq!(parse(compact.as_bytes(), "c.json").expect("a calibration"), calibration);
}

#[test]
fn a_changed_digit_anywhere_is_noticed() {
    let text = written(&calibration(Dof::SpatialForce, 4, 6));
    let checksum = text.find("\"checksum\"").expect("a checksum");
    for (at, _) in text.char_indices().filter(|&(at, character)| at < checksum && character.is_ascii_digit())
    {
        let digit = text.as_bytes()[at];
        let mut bytes = text.clone().into_bytes();
        bytes[at] = if digit == b'5' { b'6' } else { b'5' };
        // A last digit beyond the precision of f64 may read as the same number, which is no change.
        match parse(&bytes, "c.json") {
            Err(_) => {}
            Ok(read) => assert_eq!(written(&read), text),
        }
    }
}

#[test]
fn every_truncation_is_refused() {
    let text = written(&calibration(Dof::PlanarForce, 3, 7));
    let whole = text.trim_end().len();
    for end in 0..whole {
        assert!(parse(&text.as_bytes()[..end], "c.json").is_err(), "{end} of {whole}");
    }
}

#[test]
fn other_formats_and_contradictions_are_named() {
    let good = calibration(Dof::PlanarForce, 3, 8);
    let later = written(&good).replace("calibration-1", "calibration-2");
    assert!(matches!(parse(later.as_bytes(), "c"), Err(CalibrationFileError::Format { .. })));

    let field_of = |calibration: &Calibration| match parse(written(calibration).as_bytes(), "c") {
        Err(CalibrationFileError::Inconsistent { field, .. }) => field,
        other => panic!("{other:?}"),
    };
    assert_eq!(field_of(&Calibration { bias_counts: DVector::zeros(4), ..good.clone() }), "bias_counts");
    assert_eq!(field_of(&Calibration { matrix: DMatrix::zeros(2, 13), ..good.clone() }), "gages");
    assert_eq!(field_of(&Calibration { dof: Dof::SpatialForce, ..good.clone() }), "matrix");
    assert_eq!(field_of(&Calibration { shape: DMatrix::zeros(2, 2), ..good.clone() }), "shape");
    assert_eq!(field_of(&Calibration { shape: DMatrix::identity(2, 3), ..good.clone() }), "shape");
    assert_eq!(field_of(&Calibration { gravity: -1.0, ..good.clone() }), "gravity");

    let uncertain = |change: &dyn Fn(&mut Uncertainty)| {
        let mut changed = good.clone();
        change(changed.uncertainty.as_mut().expect("stated above"));
        changed
    };
    for (field, change) in [
        (
            "uncertainty.matrix",
            &(|stated: &mut Uncertainty| stated.matrix[(1, 2)] = -1.0) as &dyn Fn(&mut Uncertainty),
        ),
        ("uncertainty.per_axis_full_load", &|stated: &mut Uncertainty| stated.per_axis_full_load[0] = -1.0),
        ("uncertainty.gravity_accuracy", &|stated: &mut Uncertainty| stated.gravity_accuracy = Some(-1.0)),
        ("uncertainty.wrench", &|stated: &mut Uncertainty| {
            stated.wrench.as_mut().expect("stated").by_load[0][(0, 0)] = -1.0;
        }),
        ("uncertainty.wrench", &|stated: &mut Uncertainty| {
            stated.wrench.as_mut().expect("stated").unloaded[0] = -1.0;
        }),
    ] {
        assert_eq!(field_of(&uncertain(change)), field);
    }
    // What an earlier version of the tool wrote says nothing of single wrenches.
    let earlier = uncertain(&|stated: &mut Uncertainty| stated.wrench = None);
    assert_eq!(parse(written(&earlier).as_bytes(), "c").expect("complete"), earlier);

    // Nor of the gain.
    let earlier = Calibration { gain: None, ..good.clone() };
    let text = written(&earlier);
    assert!(!text.contains("\"gain\""), "{text}");
    assert_eq!(parse(text.as_bytes(), "c").expect("complete"), earlier);

    let unknown = written(&good).replacen("\"dof\"", "\"extra\": 1, \"dof\"", 1);
    assert!(matches!(parse(unknown.as_bytes(), "c"), Err(CalibrationFileError::Malformed { .. })));
    let infinite = Calibration { fusion_residual: f64::INFINITY, ..good };
    assert!(parse(written(&infinite).as_bytes(), "c").is_err(), "no infinity comes through");
}
