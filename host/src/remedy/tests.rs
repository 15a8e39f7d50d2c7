use std::collections::BTreeSet;

use ftcal_shared::refusal::Refusal;

use super::{Explained, calibration, estimation, gage_suspect, verification_failed};
use crate::calibration::CalibrationRefusal;
use crate::calibration::turning::Swept;

fn estimation_refusals() -> Vec<Refusal> {
    vec![
        Refusal::TooFewSamples { have: 3, need: 18 },
        Refusal::RankNotReached { have: 2, need: 3 },
        Refusal::RankNotReached { have: 1, need: 3 },
        Refusal::NoEigenvalueGap { ratio: 1.5, need: 10.0 },
        Refusal::MotionDoesNotSpan { relative_uncertainty: 0.3, need: 0.1 },
        Refusal::MetricNotPositiveDefinite,
        Refusal::NonFinite,
        Refusal::Saturated { samples: 100 },
        Refusal::OverflowAhead { samples: 1 << 32 },
        Refusal::PivotsDiffer,
        Refusal::UnsupportedDimensions { gages: 2, rank: 3 },
    ]
}

fn calibration_refusals() -> Vec<CalibrationRefusal> {
    let trial = 0;
    vec![
        CalibrationRefusal::NoKnownLoad { trial },
        CalibrationRefusal::KnownLoadsDoNotOrient { trial, loads: 1, uncertainty_deg: f64::INFINITY },
        CalibrationRefusal::KnownLoadsContradict { trial, load: 1, angle_deg: 20.0 },
        CalibrationRefusal::KnownLoadMagnitude { trial, load: 1, magnitude: 1.3 },
        CalibrationRefusal::KnownLoadNotAtRest { trial, load: 1, drift_deg: 3.0 },
        CalibrationRefusal::KnownLoadSaturated { trial, load: 1 },
        CalibrationRefusal::TurningUnclear { trial, swept: Swept::default() },
        CalibrationRefusal::TurningContradicts { trial },
        CalibrationRefusal::HandednessNotSettled { trials: vec![0, 2], margin: 0.0, need: 25.0 },
        CalibrationRefusal::LoadsInPlaneOfArms { trials: vec![1] },
        CalibrationRefusal::TooManyUndecided { trials: vec![0, 1] },
        CalibrationRefusal::TrialsContradict { residual: 0.2, ratio: 30.0 },
        CalibrationRefusal::MassesContradict { trial, ratio: 1.1 },
        CalibrationRefusal::TooFewArms { have: 2, need: 3 },
        CalibrationRefusal::ArmsEqual { arms: 3, spread_m: 1e-4 },
        CalibrationRefusal::ArmsCollinear { arms: 3 },
        CalibrationRefusal::FusionUncertain { wrench_error: 0.5, need: 0.25 },
        CalibrationRefusal::BiasesDisagree { trial, counts: 1e4, signal_counts: 1e5 },
        CalibrationRefusal::TooFewGages { gages: 4, need: 6 },
        CalibrationRefusal::ShapeRankDeficient,
        CalibrationRefusal::TooFewKnownLoads { have: 5, need: 6 },
        CalibrationRefusal::KnownLoadsDoNotSpan { have: 5, need: 6 },
        CalibrationRefusal::KnownLoadsNotLinear { residual: 0.5, need: 0.2 },
        CalibrationRefusal::NotLinear {
            trial,
            redundant_counts: 100.0,
            rest_counts: 1.0,
            signal_counts: 1e4,
        },
        CalibrationRefusal::ReferenceDiffers { trial, drift: 0.4, other_hand: 1.5, scale: 2.0, need: 0.1 },
        CalibrationRefusal::GagesDiffer { trial, gages: 6, stored: 8 },
    ]
}

#[test]
fn every_cause_has_an_identifier_of_its_own_and_every_remedy_is_a_sentence() {
    let explained: Vec<Explained> = estimation_refusals()
        .iter()
        .map(estimation)
        .chain(calibration_refusals().iter().map(calibration))
        .chain([verification_failed(9.0, 10.0, 0.1), gage_suspect(3, 20.0)])
        .collect();
    let causes: BTreeSet<&str> = explained.iter().map(|explained| explained.cause).collect();
    assert_eq!(causes.len(), explained.len());
    for Explained { cause, detail, remedy } in &explained {
        assert!(cause.chars().all(|character| character.is_ascii_lowercase() || character == '-'), "{cause}");
        assert!(remedy.ends_with('.') && remedy.starts_with(char::is_uppercase), "{remedy}");
        assert!(!detail.is_empty() && !detail.contains("NaN") && !detail.contains("  "), "{detail}");
    }
}

#[test]
fn a_refused_trial_is_named_and_keeps_its_cause() {
    for refusal in estimation_refusals() {
        let explained = calibration(&CalibrationRefusal::Trial { trial: 2, refusal });
        assert_eq!(explained.cause, estimation(&refusal).cause);
        assert!(explained.detail.starts_with("trial 3: "));
    }
}
