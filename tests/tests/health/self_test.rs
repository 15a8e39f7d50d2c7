//! The self-test finds every fault, says so where it cannot, and leaves the sensor as it was.

use ftcal::simulator::fault::Fault;
use ftcal::simulator::scenario::ScenarioKind;
use ftcal_firmware::stream::Measurement;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::units::{DataRate, Gain};
use ftcal_shared::wire::health::{StatusBit, StatusWord};
use ftcal_shared::wire::{
    Found, HealthRequest, HealthResponse, PlayedFault, Rejection, Request, Response, SelfTestPhase,
};

use super::FLAGGED_MICROS;
use super::rig::{Rig, assert_near, scenario};

fn self_test<const GAGES: usize, const HIGHER: usize>(
    rig: &mut Rig<GAGES, HIGHER>,
) -> Vec<(PlayedFault, Found)> {
    let mut response = rig.ask(Request::Health(HealthRequest::StartSelfTest));
    for _ in 0..60_000 {
        let Response::Health(HealthResponse::SelfTest(report)) = response else { panic!("{response:?}") };
        if report.phase == SelfTestPhase::Done {
            return report.outcomes.iter().map(|outcome| (outcome.played, outcome.found)).collect();
        }
        let step = rig.step();
        assert!(step.measurements.iter().all(|it| matches!(it, Measurement::Invalid(_))));
        response = rig.ask(Request::Health(HealthRequest::ReadSelfTest));
    }
    panic!("a self-test ends");
}

#[test]
fn a_self_test_finds_every_fault_and_leaves_the_sensor_as_it_was() {
    let scenario = scenario(ScenarioKind::Wrist, 31);
    let mut rig = Rig::<8, { higher_moment_count(8) }>::of(&scenario, 31, DataRate::Hz1000);
    rig.run(0.1);
    let before = rig.health(HealthRequest::Read);
    let begin = rig.now_micros();
    let outcomes = self_test(&mut rig);
    assert!(rig.now_micros() - begin < 3_000_000, "a few seconds");
    assert_eq!(outcomes.len(), 13);
    for (played, found) in outcomes {
        match found {
            Found::After { micros } => {
                assert!(u64::from(micros) <= FLAGGED_MICROS, "{played:?}: {micros} µs");
            }
            Found::Within { off_counts, .. } => {
                assert_eq!(off_counts, 0, "{played:?}: the model's are exact");
            }
            _ => panic!("{played:?}: {found:?}"),
        }
    }
    let after = rig.health(HealthRequest::Read);
    let with_self_test = before.latched.with(StatusBit::SelfTest, true).with(StatusBit::AdcFault, true);
    assert_eq!(after.latched.bits() & !with_self_test.bits(), 0, "{:?}", after.latched);
    assert_eq!((after.peak_since_start, after.carrying_on_without), (before.peak_since_start, None));
    rig.run(0.5);
    assert_eq!(rig.polled.sensor.status_word(), StatusWord::NONE);
    let step = rig.step();
    let allowed = rig.noise() * 6.0;
    for measurement in step.measurements {
        let Measurement::Valid { wrench, .. } = measurement else { panic!("{measurement:?}") };
        assert_near(&wrench, &step.truth, &allowed, "after the self-test");
    }
}

#[test]
fn a_self_test_of_a_broken_sensor_says_so() {
    let scenario = scenario(ScenarioKind::Fingertip, 32);
    let mut rig = Rig::<4, { higher_moment_count(4) }>::of(&scenario, 32, DataRate::Hz1000);
    rig.bench.with(|bench| bench.inject(Fault::ConverterMissing));
    rig.run(0.2);
    let outcomes = self_test(&mut rig);
    assert!(outcomes.iter().all(|(_, found)| matches!(found, Found::NotWell(Some(_)))), "{outcomes:?}");
}

#[test]
fn trials_and_self_tests_keep_out_of_each_other_s_way() {
    let scenario = scenario(ScenarioKind::Fingertip, 33);
    let mut rig = Rig::<4, { higher_moment_count(4) }>::of(&scenario, 33, DataRate::Hz1000);
    rig.ask(Request::StartTrial { rank: 2 });
    assert!(rig.step().word.contains(StatusBit::TrialRunning));
    let start = Request::Health(HealthRequest::StartSelfTest);
    assert_eq!(rig.ask(start.clone()), Response::Rejected(Rejection::TrialBusy));
    rig.ask(Request::StopTrial);
    rig.ask(start.clone());
    let running = Response::Rejected(Rejection::SelfTestRunning);
    assert_eq!(rig.ask(start), running);
    assert_eq!(rig.ask(Request::StartTrial { rank: 2 }), running);
    assert_eq!(rig.ask(Request::ConfigureAdc(DataRate::Hz250, Gain::X1)), running);
    let upload = rig.upload();
    assert_eq!(rig.ask(Request::UploadCalibration(upload)), running);
}
