//! Every fault of the converter and of its wiring is flagged in time, and no frame that is called valid carries its effect.

use ftcal::simulator::bench::Bench;
use ftcal::simulator::fault::{Fault, Rail};
use ftcal::simulator::scenario::ScenarioKind;
use ftcal_firmware::stream::Measurement;
use ftcal_shared::estimation::moments::higher_moment_count;
use ftcal_shared::units::DataRate;
use ftcal_shared::wire::health::{StatusBit, StatusWord};
use ftcal_shared::wire::{AdcState, InvalidCause, Request, Response};
use nalgebra::DVector;

use super::FLAGGED_MICROS;
use super::rig::{Rig, assert_near, scenario};

/// The faults of the converter and of its wiring, and the bits one of which must tell of each.
fn converter_faults(gage: usize) -> Vec<(Fault, &'static [StatusBit])> {
    vec![
        (Fault::StuckChannel { channel: gage }, &[StatusBit::OpenInput]),
        (Fault::OpenChannel { channel: gage }, &[StatusBit::GagesContradict]),
        (Fault::SaturatedChannel { channel: gage, rail: Rail::High }, &[StatusBit::Saturated]),
        (Fault::SaturatedChannel { channel: gage, rail: Rail::Low }, &[StatusBit::Saturated]),
        (Fault::NoisyChannel { channel: gage, noise_counts: 200_000.0 }, &[StatusBit::GagesContradict]),
        (Fault::BusBitErrors { probability: 0.01 }, &[StatusBit::ReplyDisturbed, StatusBit::AdcFault]),
        (Fault::DataReadyLost { probability: 1.0 }, &[StatusBit::AdcFault]),
        (Fault::DataReadyLost { probability: 0.5 }, &[StatusBit::ConversionsLost, StatusBit::AdcFault]),
        // Where it meets a question, the answer to it is missing, and that is a fault.
        (Fault::LateReply, &[StatusBit::ReplyDisturbed, StatusBit::AdcFault]),
        (Fault::WrongIdentity { id: 0x2400 }, &[StatusBit::AdcFault]),
        (Fault::ConverterMissing, &[StatusBit::AdcFault]),
    ]
}

/// How long a fault acts.
const ACTING_MICROS: u64 = 300_000;

/// A thousand times a second, every so many conversions the converter is asked who it is.
const BETWEEN_QUESTIONS: u32 = 8;

/// Plays every fault at every conversion between two questions to the converter.
fn check_faults<const GAGES: usize, const HIGHER: usize>(kind: ScenarioKind, seed: u64, rate: DataRate) {
    for waiting in 0..BETWEEN_QUESTIONS {
        check_faults_after::<GAGES, HIGHER>(waiting, kind, seed, rate);
    }
}

fn check_faults_after<const GAGES: usize, const HIGHER: usize>(
    waiting: u32,
    kind: ScenarioKind,
    seed: u64,
    rate: DataRate,
) {
    let scenario = scenario(kind, seed);
    for gage in 0..GAGES {
        // Of those that concern no gage once is enough.
        for (fault, bits) in converter_faults(gage).into_iter().take(if gage == 0 { 11 } else { 5 }) {
            let mut rig = Rig::<GAGES, HIGHER>::of(&scenario, seed, rate);
            for _ in 0..waiting {
                rig.step();
            }
            rig.bench.with(|bench| bench.inject(fault));
            let begin = rig.now_micros();
            let what = format!("{kind:?} {fault:?} at {} /s, {waiting} conversions later", rate.hertz());
            let noise = rig.noise() * 6.0;
            let answer = rig.matrix().column(gage).abs();
            let mut flagged = None;
            let mut before = Vec::new();
            while rig.now_micros() < begin + ACTING_MICROS {
                let step = rig.step();
                let elapsed = rig.now_micros() - begin;
                if flagged.is_none() && bits.iter().any(|&bit| step.word.contains(bit)) {
                    flagged = Some(elapsed);
                }
                let off = match fault {
                    // At most three conversions old.
                    Fault::StuckChannel { channel } => {
                        let counts = |truth: &DVector<f64>| rig.truth.shape().column(channel).dot(truth);
                        let now = counts(&step.truth);
                        let change = before.iter().rev().take(3).map(|then| (counts(then) - now).abs());
                        change.fold(0.0, f64::max) + 12.0 * rig.truth.noise_counts()[channel]
                    }
                    Fault::OpenChannel { channel } | Fault::NoisyChannel { channel, .. } => {
                        rig.largest_hidden(channel, &step.truth)
                    }
                    _ => 0.0,
                };
                let allowed = &noise + &answer * off;
                for measurement in step.measurements {
                    if let Measurement::Valid { wrench, .. } = measurement {
                        assert_near(&wrench, &step.truth, &allowed, &what);
                    }
                }
                before.push(step.truth);
            }
            let flagged = flagged.unwrap_or_else(|| panic!("{what}: not flagged"));
            assert!(flagged <= FLAGGED_MICROS, "{what}: flagged after {flagged} µs");
        }
    }
}

#[test]
fn every_fault_of_the_converter_is_flagged_within_ten_milliseconds_and_reaches_no_valid_frame() {
    check_faults::<4, { higher_moment_count(4) }>(ScenarioKind::Fingertip, 1, DataRate::Hz1000);
    check_faults::<6, { higher_moment_count(6) }>(ScenarioKind::Force, 2, DataRate::Hz1000);
    check_faults::<4, { higher_moment_count(4) }>(ScenarioKind::Planar, 3, DataRate::Hz1000);
    check_faults::<8, { higher_moment_count(8) }>(ScenarioKind::Wrist, 4, DataRate::Hz1000);
    check_faults::<8, { higher_moment_count(8) }>(ScenarioKind::Wrist, 5, DataRate::Hz4000);
}

/// While it is at fault, the converter's state and the status word agree.
#[test]
fn a_silent_converter_is_told_at_every_tick_until_it_is_heard() {
    let scenario = scenario(ScenarioKind::Force, 51);
    let mut rig = Rig::<6, { higher_moment_count(6) }>::of(&scenario, 51, DataRate::Hz1000);
    rig.bench.with(|bench| bench.inject(Fault::DataReadyLost { probability: 1.0 }));
    rig.run(0.02);
    for _ in 0..20 {
        let step = rig.step();
        assert!(step.word.contains(StatusBit::AdcFault));
        assert!(step.measurements.iter().all(|it| matches!(it, Measurement::Invalid(InvalidCause::Adc(_)))));
    }
    let Response::Status(status) = rig.ask(Request::Status) else { panic!("a status") };
    assert!(matches!(status.adc, AdcState::Faulty(_)));
    rig.bench.with(Bench::clear_faults);
    rig.run(0.7);
    assert_eq!(rig.polled.sensor.status_word(), StatusWord::NONE);
}
