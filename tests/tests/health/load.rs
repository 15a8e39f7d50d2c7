//! Tare.

use ftcal::simulator::scenario::ScenarioKind;
use ftcal_firmware::stream::Measurement;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::units::DataRate;
use ftcal_shared::wire::health::StatusBit;
use ftcal_shared::wire::{HealthRequest, HealthResponse, Request, Response, TarePhase};
use nalgebra::Vector3;

use super::rig::{Rig, assert_near, scenario};

fn tare<const GAGES: usize, const HIGHER: usize>(
    rig: &mut Rig<GAGES, HIGHER>,
    request: HealthRequest,
) -> (TarePhase, Option<[f32; 6]>) {
    match rig.ask(Request::Health(request)) {
        Response::Health(HealthResponse::Tare(report)) => (report.phase, report.wrench),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_tare_is_subtracted_flagged_and_gone_with_the_calibration() {
    let scenario = scenario(ScenarioKind::Wrist, 41);
    let mut rig = Rig::<8, { higher_moment_count(8) }>::of(&scenario, 41, DataRate::Hz1000);
    let set = HealthRequest::SetTare { samples: 400, store: false };
    tare(&mut rig, set);
    rig.run(0.5);
    let (phase, wrench) = tare(&mut rig, HealthRequest::ReadTare);
    assert!(matches!(phase, TarePhase::Refused(_)) && wrench.is_none(), "the load is turning: {phase:?}");

    rig.bench.with(|bench| bench.hold(-Vector3::z_axis()));
    rig.run(0.1);
    tare(&mut rig, set);
    rig.run(0.5);
    let (phase, wrench) = tare(&mut rig, HealthRequest::ReadTare);
    assert_eq!(phase, TarePhase::Settled);
    let at_rest = rig.step().truth;
    assert_near(&wrench.expect("it rests"), &at_rest, &(rig.noise() * (6.0 / 20.0)), "the tare");
    rig.bench.with(|bench| bench.hold(Vector3::x_axis()));
    let step = rig.step();
    assert!(step.word.contains(StatusBit::TareActive));
    let allowed = rig.noise() * 7.0;
    for measurement in step.measurements {
        let Measurement::Valid { wrench, .. } = measurement else { panic!("{measurement:?}") };
        assert_near(&wrench, &(&step.truth - &at_rest), &allowed, "tared");
    }

    let upload = rig.upload();
    rig.ask(Request::UploadCalibration(upload.clone()));
    assert!(rig.step().word.contains(StatusBit::TareActive), "the same calibration once more");
    let mut other = upload;
    other.bias_counts[0] += 1.0;
    other.identity = other.identity_of_numbers();
    rig.ask(Request::UploadCalibration(other));
    assert!(!rig.step().word.contains(StatusBit::TareActive));
    assert_eq!(tare(&mut rig, HealthRequest::ReadTare), (TarePhase::Settled, None));
}
